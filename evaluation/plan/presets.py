"""The presets: named sets of axes."""

from dataclasses import dataclass, replace

from attacks.tasks.task_list import RETURNS
from evaluation.plan.constants import IDENTITY, SHARED

__all__ = [
    "BASELINE",
    "DEFAULT",
    "DISSOCIATION",
    "IDENTITY",
    "PRESETS",
    "PROTECTIONS",
    "PUBLISHED_LEVELS",
    "SHARED",
    "STRONGER_ADVERSARIES",
    "STRONGEST_ON_SLOW_NOISE",
    "UTILITY_PREDICTORS",
    "Preset",
]


@dataclass(frozen=True, slots=True)
class Preset:
    """A named set of axes."""

    scenes: int  # The attacked scenes.
    # All scenes: after the attacked scenes, those where only robots read.
    utility_scenes: int
    mechanisms: tuple[str, ...]
    predictors: tuple[str, ...]
    attacks: tuple[str, ...]
    tasks: tuple[str, ...]
    summary: str
    # Further mechanisms, beside the panel of the verdict.
    protections: tuple[str, ...] = ()
    # Further attacks, where the error changes slowly: elsewhere they equal others.
    slow_error_attacks: tuple[str, ...] = ()
    # Mechanisms shared, predicted and reconstructed under `OTHER_LAW`, too.
    other_law_mechanisms: tuple[str, ...] = ()
    # Mechanisms reconstructed on walks of the fitted motion, too, under both laws.
    model_mechanisms: tuple[str, ...] = ()
    # Those of `model_mechanisms` that are linked there, where errors are Gaussian.
    model_linked_mechanisms: tuple[str, ...] = ()
    # Adversaries with more knowledge, tried on the levels that would be proposed.
    stronger_adversaries: tuple[str, ...] = ()
    adversaries: tuple[str, ...] = ()  # The same, tried on every level from the start.
    policies: tuple[str, ...] = ()  # Disclosure policies on patrols; none: no patrols.
    # Mechanisms with which patrols are shared, of those of the run.
    patrol_mechanisms: tuple[str, ...] = ("raw", "fid:1")
    fleets: int = 20  # Fleets of patrols, with routes of their own.
    patrol_segment_s: float = 300.0  # They walk through so much of a recording.
    has_informed_log: bool = True
    """Whether an adversary who knows routes and policy follows people, too."""
    skips_oracle: bool = False
    """Whether the oracle, a reference, attacks only where no lesser adversary can."""
    oracle_meets_named_attacks: bool = False
    """Whether it attacks all the same where a user names the attacks of a run."""
    # At most so many people in a task of a model: the optimum takes all pairs and lags.
    model_people: int = 100


PUBLISHED_LEVELS = ("raw", "fid:1", "fid:1000", "fixed:0.7", "fixed:1")
"""The levels that the paper gives numbers for."""
_BOTH_RULES = (
    *PUBLISHED_LEVELS,
    *(f"{level},adding=independent" for level in PUBLISHED_LEVELS[1:]),
)
_LEVEL_SWEEPS = ("fid:1..1000/10", "fid:1e4", "fid:1e5", "fid:1e6", "fixed:0.1..1/10")
_SWEEP = (
    "raw",
    *_LEVEL_SWEEPS,
    *(f"{sweep},adding=independent" for sweep in _LEVEL_SWEEPS),
)
# Mechanisms that separate the descriptors from linkability. The levels were chosen by
# PLR, AEL and MEL as shared alone, before any linkage: those of correlated and offset
# lie within the range from raw to fixed:1 (offset:0.4 does not). In a thinned track a
# sample stands for longer.
DISSOCIATION = (
    "correlated:0.75",
    "correlated:0.75,adding=independent",
    "offset:0.3",
    "thin:4",
    "thin:4,d_sigma=0.75",
    "thin:4,d_sigma=0.75,adding=independent",
)
"""Controls for the question whether a descriptor shows how linkable people are."""
PROTECTIONS = (
    "ou:0.2",
    "ou:0.4",
    "laplace:1",
    "fixed:1,adding=independent,law=isotropic",
)
"""Noise that may survive a filter, and the white noise for comparison."""
_WHITE = ("fixed", ",adding=independent,law=isotropic")
# By name and parameters: the levels.
_LEVELS = {
    _WHITE: "0.1 0.3 0.45 0.6 0.75 0.9 0.97 1.05 1.12 1.2 1.4 1.6",
    ("ou", ""): "0.08 0.14 0.18 0.22 0.26 0.28 0.3 0.32 0.34 0.36 0.38 0.42 0.46",
    ("ou", ",tau_s=1"): "0.1 0.2 0.28 0.36 0.42 0.48 0.54 0.6",
    ("ou", ",tau_s=2"): "0.1 0.18 0.24 0.3 0.35 0.4 0.45 0.5",
    ("ou", ",tau_s=10"): "0.1 0.16 0.22 0.28 0.34 0.4 0.46",
    ("ou", ",tau_s=20"): "0.1 0.16 0.22 0.28 0.34 0.4 0.46",
    ("ou_fid", ""): "3e4 1e5 2e5 4e5 1e6",
    ("laplace", ""): "0.1 0.3 0.5 0.7 0.9 1.1 1.3 1.5",
    ("forecast", ""): "0.05 0.12 0.18 0.24 0.3 0.36 0.44",
    ("thin", ""): "2 4 6 8 10 12 16 20",
    ("fid", ",adding=independent"): "1 1e4",
    ("fid", ",adding=independent,alpha=1.5"): "1 1e4 1e5 3e5 1e6",
    ("offset", ""): "0.1 0.2 0.26 0.32 0.38 0.44 0.5 0.6",
}
"""Levels at which a Kalman robot misses up to 12 points more conflicts (Students03)."""
_FRONTIER = (
    "raw",
    *(
        f"{name}:{level}{parameters}"
        for (name, parameters), levels in _LEVELS.items()
        for level in levels.split()
    ),
)
_AUDITED = (*_BOTH_RULES, "ou:0.4", "laplace:1")
STRONGEST_ON_SLOW_NOISE = "ou_rts"
"""Attack that uses all that `--adversary` grants; every run with the option has it."""
STRONGER_ADVERSARIES = ("repeats", "anchor")
"""Adversaries that undo a slow error: every proposed level is tried against them."""
BASELINE = "constant_position"
"""Predictor of standing people, in every preset: no useful robot is worse."""
_ROBOTS = ("least_squares", "kalman_cv", "kalman_cv:aware=true")
UTILITY_PREDICTORS = (*_ROBOTS, BASELINE)
"""A preset's predictors that read all scenes, at every horizon: the cheapest."""
_SMOOTHERS = (
    "identity",
    "moving_average",
    "savgol",
    "kalman_rts",
    "radial_rts",
    "averaging",
)
"""All built-in reconstruction attacks but the slow: gaussian_process, when named."""
_LINKERS = (
    # Every linker alone, and behind the stronger smoother where that gains more than it
    # costs. Others run when named: shape@kalman_rts, dtw@radial_rts.
    "shape",
    "shape@radial_rts",
    "profile",
    "profile@radial_rts",
    "dtw",
    "likelihood_ratio",
    "behaviour",
    "histogram",
    "kinematic",
    "kinematic@radial_rts",
    "mean_distance",
    "likelihood_ratio:one_to_one=true",
)
_SMOKE = Preset(
    scenes=40,
    utility_scenes=40,
    mechanisms=PUBLISHED_LEVELS,
    predictors=("least_squares", "kalman_cv", "kalman_ca", "kalman_imm", BASELINE),
    # The cheap smoothers, and for each kind of task a linker that links most people.
    attacks=(*_SMOOTHERS, "shape", "shape@radial_rts", "kinematic@radial_rts"),
    # In split and new_traversal no linker of `paper` beats guessing on plaza; the
    # longer silences repeat the shortest. A single session has no cross_session,
    # and no returns.
    tasks=("rerelease", "handover-1s", "cross_session", RETURNS.name),
    skips_oracle=True,
    oracle_meets_named_attacks=True,
    summary="40 scenes, the 5 levels that the paper gives numbers for",
)
_POLICIES = ("everything", "window:4", "near:3.5", "ahead:2", "state:2", "flag")
"""Everything, as the paper shares, and five ways to share less."""
_PAPER_TASKS = (
    "rerelease",
    "rerelease-framed",
    "split",
    "handover-1s",
    "handover-2s",
    "handover-5s",
    "new_traversal",
    "cross_session",
    RETURNS.name,
)
_PAPER = replace(
    _SMOKE,
    scenes=500,
    utility_scenes=2000,
    mechanisms=(*_SWEEP, *DISSOCIATION),
    attacks=(*_SMOOTHERS, *_LINKERS),
    tasks=_PAPER_TASKS,
    skips_oracle=False,
    protections=PROTECTIONS,
    slow_error_attacks=("ou_rts",),
    other_law_mechanisms=PUBLISHED_LEVELS,
    model_mechanisms=(*PUBLISHED_LEVELS, "ou:0.4"),
    model_linked_mechanisms=("fid:1",),
    stronger_adversaries=STRONGER_ADVERSARIES,
    policies=_POLICIES,
    summary=(
        "2,000 scenes (500 attacked), raw, 13 eta, 10 fixed errors, both rules, 6"
        " controls, 4 levels of slow, Laplace and white noise"
    ),
)
_QUICK_PROTECTIONS = ("ou:0.4", "ou:0.8")
"""Slow noise: the level next to a recommendation in `paper`, and a qualifying level."""
_QUICK = Preset(
    scenes=250,
    utility_scenes=2000,
    # Fixed noise on either side of eta 1, so that both can be read at equal missed
    # conflicts.
    mechanisms=(
        "raw",
        "fid:1",
        "fixed:0.7",
        "fixed:1",
        *(f"{name},adding=independent" for name in ("fid:1", "fixed:0.7", "fixed:1")),
        *_QUICK_PROTECTIONS,
    ),
    predictors=("least_squares", "kalman_cv", BASELINE),
    # The strongest of each kind, by re-releases and handovers of Students03 and plaza.
    attacks=("radial_rts", "kinematic@radial_rts", "likelihood_ratio:one_to_one=true"),
    slow_error_attacks=("ou_rts",),
    adversaries=STRONGER_ADVERSARIES,
    skips_oracle=True,
    tasks=("rerelease", "handover-1s", "handover-5s", RETURNS.name),
    policies=("everything", "near:3.5", "ahead:2", "state:2"),
    fleets=4,
    patrol_segment_s=200.0,
    has_informed_log=False,
    summary="2,000 scenes (250 attacked), 9 levels, the strongest attack of each kind",
)
DEFAULT = "quick"
"""Preset of a run that names none."""
PRESETS = {
    "quick": _QUICK,
    "smoke": _SMOKE,
    "paper": _PAPER,
    "full": replace(
        _PAPER,
        scenes=5000,
        utility_scenes=5000,
        other_law_mechanisms=_BOTH_RULES,
        summary="the axes of paper on 5,000 scenes",
    ),
    "frontier": Preset(
        scenes=500,
        utility_scenes=5000,
        mechanisms=_FRONTIER,
        predictors=UTILITY_PREDICTORS,
        attacks=(
            "radial_rts",
            "ou_rts",
            "shape",
            "shape@radial_rts",
            "shape@ou_rts",
            "likelihood_ratio",
        ),
        tasks=("rerelease",),
        stronger_adversaries=STRONGER_ADVERSARIES,
        summary=(
            "5,000 scenes (500 attacked), 99 levels of all families, plain and aware"
            " robots"
        ),
    ),
    "audit": Preset(
        scenes=750,
        utility_scenes=750,
        mechanisms=_AUDITED,
        predictors=("kalman_cv", BASELINE),
        attacks=(
            "identity",
            "kalman_rts",
            "radial_rts",
            "ou_rts",
            "gaussian_process",
            "shape",
            "shape@radial_rts",
            "dtw",
            "likelihood_ratio",
        ),
        tasks=("rerelease",),
        model_mechanisms=_AUDITED,
        model_linked_mechanisms=_BOTH_RULES,
        model_people=300,
        summary=(
            "750 scenes, 11 levels, the slow attack too: how far attacks are from the optimum"
            " in worlds of walks that follow the model"
        ),
    ),
}
