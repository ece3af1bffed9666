"""The glossary: a plain sentence for each name that a screen, table or figure shows.

The page takes its hover texts and its section of words from here.
`docs/reference/glossary.md` is made of it.
"""

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from markupsafe import Markup, escape

from attacks.tasks.task_list import ALL_TASKS
from evaluation.estimates.metrics import METRICS
from evaluation.plan.address import parse_consumer
from evaluation.reporting.names import ATTACK_NAMES, FAMILY_NAMES, ROBOT_NAMES
from isac_track.plugins import built_in_mechanisms

_WORDS: Final = {
    "ISAC": (
        "Integrated sensing and communication: a radio network that also senses"
        " objects."
    ),
    "FID": (
        "Fisher information density: how precisely the network can locate a point,"
        " 1/(m² s)."
    ),
    "eta": (
        "Threshold of FID noise, 1/(m² s): FID above it is brought down by added noise."
    ),
    "epsilon": (
        "Distance in m below which a shared or rebuilt position counts as known."
    ),
    "mechanism": "A rule that changes positions before the network shares them.",
    "level": "The strength of a mechanism: eta for FID noise, metres for most others.",
    "release": "Times, positions and fresh pseudonyms that a recipient gets at a time.",
    "pseudonym": "A random label of a track, new in every release.",
    "adding": "How added noise combines with the sensing error: linear or independent.",
    "linear": (
        "Adding rule of the paper: the standard deviations of both errors add up."
    ),
    "independent": "Adding rule of two unrelated errors: their variances add up.",
    "as shared": "Positions as the mechanism sends them, before any attack.",
    "after attack": "Positions that an attack has rebuilt from a release.",
    "law": "The direction of position errors: radial, isotropic or fixed_direction.",
    "radial": "Error law: a random distance in a uniformly random direction.",
    "isotropic": "Error law: the same normal error along both axes.",
    "fixed_direction": (
        "Error law: all errors of a track lie along one random direction."
    ),
    "white": (
        "Fixed noise with independent adding and isotropic errors, as a reference."
    ),
    "interval": (
        "95 % interval over people: 19 of 20 such intervals hold the true value."
    ),
    "candidates": "People among whom a linkage attack looks for the same person.",
    "missed conflict": (
        "A robot does not foresee that somebody comes inside the safety radius."
    ),
    "future conflict": "A conflict in which nobody is inside the safety radius yet.",
    "handover": (
        "Pseudonyms change after some seconds of silence; frame and clock stay true."
    ),
    "re-identified": (
        "A linkage attack ranks the same person first among all candidates."
    ),
    "singling out": (
        "Isolating the records of a person in a data set (Opinion 05/2014)."
    ),
    "linkability": "Linking two records of the same person (Opinion 05/2014).",
    "inference": (
        "Deducing an attribute of a person, probably correctly (Opinion 05/2014)."
    ),
    "front": (
        "Levels that no other level of the run beats in cost and privacy together."
    ),
    "patrol": "Robots that walk through a recording and ask where people are.",
    "policy": "A rule that chooses whom, and which samples, an answer discloses.",
    "tracker": "What joins a network's detections to tracks.",
    "detection": "A point that a network senses at a scan, without a label.",
    "clutter": "Detections of nobody.",
    "log": "All answers that a fleet of robots was given.",
    "map": "An adversary without a log, that knows where people stand most.",
    "model world": (
        "Simulated walks that follow the fitted motion, where the optimum is known."
    ),
    "optimum": "The exact best attack in a model world: no attack beats it on average.",
    "ceiling": (
        "The optimum of a genie, which also knows the scale of every error; attacks"
        " need not reach it."
    ),
    "clusters": (
        "People, or groups who walk together, that an interval is computed over."
    ),
    "control": (
        "A linker that must stay at chance; if it does not, the task leaks otherwise."
    ),
    "passage": "The whole track of a person, from entry to exit.",
    "returning people": "People with passages in several runs: the task returns.",
    "strongest control": (
        "Of each person, the control that names most of the other people."
    ),
    "shortcut": "A control that links people by something other than their walk.",
    "joint matching": (
        "All probes are matched to candidates at once, each candidate once."
    ),
    "rebuilt": "Computed from a release by a reconstruction attack.",
    "true": "Where the person was, without any error.",
    "shared": "What the network sent, as `as shared`.",
}

_MECHANISMS: Final = {name: cls.about for name, cls in built_in_mechanisms().items()}

_ATTACKS: Final = {
    "identity": "No attack: the positions as shared.",
    "moving_average": "Averages neighbouring positions.",
    "savgol": "Fits a parabola to each stretch of positions (Savitzky-Golay).",
    "kalman_rts": "Kalman smoother for steady walking with normal errors.",
    "radial_rts": "Kalman smoother that reweights positions for radial errors.",
    "ou_rts": "Smoother that models slowly changing noise beside the walk.",
    "gaussian_process": "Fits a smooth random curve to each track.",
    "averaging": "Averages several releases of the same walk.",
    "corrector": "Corrects the radial smoother by what it learnt on other people.",
}

_LINKERS: Final = {
    "shape": "Compares two paths after the best shift and rotation.",
    "profile": "Compares two profiles of speed and turning at the best time lag.",
    "dtw": "Compares two profiles of speed and turning with stretched time.",
    "behaviour": "Compares walking habits such as speed and its variation.",
    "gait": "Compares sway and steps in a metric learnt on other people.",
    "histogram": "Compares the distributions of speed and turning.",
    "kinematic": "Extrapolates a walk across the gap and compares position and speed.",
    "likelihood_ratio": (
        "Weighs how likely one person walked both paths against two people."
    ),
    "mean_distance": "Mean distance of two walks over the instants of both.",
    "fusion": "Sum of several linkers' log likelihood ratios, for returning people.",
}

_TASKS: Final = {name: task.sentence for name, task in ALL_TASKS.items()}

_PREDICTORS: Final = {
    "least_squares": "The paper's robot: a straight line through the last positions.",
    "constant_position": "A robot that expects everybody to stand still.",
    "kalman_cv": "A robot with a Kalman filter for steady walking.",
    "kalman_cv:aware=true": "The same robot, and it knows the mechanism's noise.",
    "kalman_ca": "A robot with a Kalman filter for steady acceleration.",
    "kalman_imm": "A robot that switches between walking on and turning or stopping.",
}

_ADVERSARIES: Final = {
    "blind": "Sees a release and knows nothing else.",
    "informed": "Also knows the mechanism and learns from other people's true walks.",
    "repeats": "Informed, and gets further releases of the same walks.",
    "anchor": "Informed, and knows one true position of each walk.",
    "companions": "Informed, and gets the tracks of people who walk along.",
    "insider": "Informed, and knows the true frame and clock.",
    "oracle": "Knows all of that and every standard deviation: a reference only.",
}

_POLICIES: Final = {
    "everything": "Policy that sends all history of everybody: the paper's sharing.",
    "near": "Policy that sends the last seconds of people near the robot.",
    "ahead": "Policy that sends people whom the network forecasts near the route.",
    "state": "Policy that sends a filtered position and velocity, no history.",
    "flag": "Policy that sends yes or no: is there a conflict ahead.",
    "random": "Policy that sends a random share of people: a control.",
}

_TRACKERS: Final = {
    "gnn": "Joins each scan by its most probable assignment (global nearest neighbour).",
    "jpda": "Weighs all assignments of a scan (joint probabilistic data association).",
    "genie": "A reference: assigns each scan given where everybody truly is.",
}

# Metrics of equal heads, such as those of two optima, share their sentence.
_METRICS: Final = {
    **{metric.head: metric.about for metric in METRICS.values()},
    "1 - Cllr_min": "Information in the scores after the best calibration, bit.",
}

GLOSSARY: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "Words": _WORDS,
        "Mechanisms": _MECHANISMS,
        "Reconstruction attacks": _ATTACKS,
        "Linkage attacks": _LINKERS,
        "Linkage tasks": _TASKS,
        "Robots": _PREDICTORS,
        "Adversaries": _ADVERSARIES,
        "Disclosure policies": _POLICIES,
        "Trackers": _TRACKERS,
        "Metrics": _METRICS,
    }
)
"""By section: names as a file, table or figure has them, each with its sentence."""

_PLAIN: Final[Mapping[str, str]] = MappingProxyType(
    {**FAMILY_NAMES, **ATTACK_NAMES, **ROBOT_NAMES}
)
"""By name in a file: the name that people read."""


def plain_name(name: str) -> str:
    """Return the name that people read for a name in a file; empty if equal."""
    plain = _PLAIN.get(name, "")
    return "" if plain == name else plain


def _definitions() -> dict[str, str]:
    """Return every known name, as in files and as people read it, with its sentence."""
    sentences: dict[str, str] = {}
    for section in GLOSSARY.values():
        sentences |= section
    plain_names = {plain: sentences[name] for name, plain in _PLAIN.items()}
    return plain_names | sentences


DEFINITIONS: Final[Mapping[str, str]] = MappingProxyType(_definitions())
"""By name, as in files or as people read it: one sentence."""

_COMMON: Final = frozenset(
    {"true", "shared", "level", "law", "linear", "split", "shape", "profile", "control"}
    | {*_POLICIES, "known", "followed", "withheld", "disclosed", "log", "map"}
)
"""Names that are everyday words: they get no hover text inside a sentence."""


def _pattern() -> re.Pattern[str]:
    """Return the pattern of a name as a word of its own; longer names come first."""
    names = sorted(set(DEFINITIONS) - _COMMON, key=len, reverse=True)
    return re.compile(rf"(?<![\w:])(?:{'|'.join(map(re.escape, names))})(?![\w:])")


_NAMES: Final = _pattern()


def definition(name: str) -> str:
    """Return the sentence of a name, or of its kind: a level has that of its mechanism.

    Parameters
    ----------
    name : str
        A name as a file, a table or a figure has it: `fid`, `FID noise, eta 1`,
        `rerelease/dtw@kalman_rts`, `radial_rts (informed)`.

    Returns
    -------
    str
        The sentence; empty for a name that the glossary does not have.
    """
    bare = name.strip()
    linker = parse_consumer(bare).plugin
    candidates = (
        bare,
        bare.partition(" (")[0],
        bare.partition(",")[0],
        linker,
        re.split(r"[,: ]", linker)[0],
    )
    for candidate in candidates:
        if candidate in DEFINITIONS:
            return DEFINITIONS[candidate]
    return ""


def hinted(text: str) -> Markup:
    """Return a text as HTML, with hover text at the first use of each known name."""
    seen: set[str] = set()

    def mark(match: re.Match[str]) -> str:
        name = match.group()
        if name in seen:
            return str(escape(name))
        seen.add(name)
        return f'<abbr title="{escape(DEFINITIONS[name])}">{escape(name)}</abbr>'

    parts, end = [], 0
    for match in _NAMES.finditer(text):
        parts += [str(escape(text[end : match.start()])), mark(match)]
        end = match.end()
    parts.append(str(escape(text[end:])))
    return Markup("".join(parts))  # noqa: S704 - each part is escaped


def glossary_page() -> str:
    """Return `docs/reference/glossary.md`: a table for each section."""
    lines = [
        "# Glossary",
        "",
        (
            "Every name that a screen, a table or a figure shows. The page of a run has"
            " the same list."
        ),
        "`python -m evaluation.report --docs OUT` writes this file from",
        "`evaluation/reporting/glossary.py`.",
    ]
    for section, entries in GLOSSARY.items():
        lines += ["", f"## {section}", "", "| name | in words | is |", "|---|---|---|"]
        lines += [
            f"| `{name}` | {plain_name(name)} | {text} |"
            for name, text in entries.items()
        ]
    return "\n".join(lines) + "\n"
