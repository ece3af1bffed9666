"""Frozen settings per stage: the paper's table, one field a parameter, the unit in the name.

A field marked *paper* is a value of the paper's table or text, *reading* settles what
the paper leaves open (``docs/reproduction.md``), *fitted* is output of ``python
scripts/calibrate.py``. ``--set STAGE.KEY=VALUE`` and the same keys in a TOML file
change them. A range ends far beyond what is of use, but within what arithmetic and
memory can take.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from math import inf
from numbers import Integral, Real
from typing import Any, Final, Literal, Self, TypeAlias, get_args

from isac_track.errors import SettingsError, did_you_mean, quoted

IntervalsOf: TypeAlias = Literal["segment", "trajectory"]
"""Whose sampling intervals the duration of a leaked segment is made of."""
_EMPTY: Final = "none"  # As a list without numbers is typed.
_SEVERAL: Final = tuple[float, ...]  # Type of a setting that is a list of numbers.


def _number(  # a field of any type of number
    default: float | tuple[float, ...],
    low: float,
    high: float,
    *,
    is_open: bool = False,
    or_inf: bool = False,
) -> Any:  # noqa: ANN401 - as said
    """Declare a number, or several, and their range, without its ends if it is open.

    Beyond the range infinity may be taken, too.
    """
    return field(
        default=default, metadata={"range": (low, high), "open": is_open, "inf": or_inf}
    )


@dataclass(frozen=True, slots=True)
class _Stage:
    """Settings that check the type and the range of their fields, however they were made."""

    def __post_init__(self) -> None:
        (stage,) = (one.name for one in fields(StageSettings) if one.type is type(self))
        for item in fields(self):
            name, value = f"{stage}.{item.name}", getattr(self, item.name)
            if item.type == _SEVERAL:
                object.__setattr__(
                    self, item.name, _ascending(name, value, item.metadata["range"])
                )
                continue
            if choices := get_args(item.type):
                if value not in choices:
                    wanted = f"be one of {', '.join(choices)}"
                    raise SettingsError(f"{name} must {wanted}, got {quoted(value)}")
                continue
            kind, noun = (
                (Integral, "whole number") if item.type is int else (Real, "number")
            )
            if isinstance(value, bool) or not isinstance(value, kind):
                raise SettingsError(f"{name} must be a {noun}, got {quoted(value)}")
            low, high = item.metadata["range"]
            if item.metadata["open"]:
                fits, wanted = low < value < high, f"between {low:g} and {high:g}"
            else:
                fits, wanted = low <= value <= high, f"within {low:g} to {high:g}"
            if item.metadata["inf"]:
                fits, wanted = fits or value == inf, f"{wanted}, or be inf"
            if not fits:  # nor does NaN
                raise SettingsError(f"{name} must lie {wanted}, got {quoted(value)}")


def _ascending(
    name: str, value: object, ends: tuple[float, float]
) -> tuple[float, ...]:
    """Return a list of numbers in ascending order, each once; SettingsError if it is none."""
    several = value if isinstance(value, tuple | list) else (value,)
    for number in several:
        is_number = isinstance(number, Real) and not isinstance(number, bool)
        if not is_number or not ends[0] <= number <= ends[1]:  # nor does NaN
            wanted = (
                f"numbers within {ends[0]:g} to {ends[1]:g}, such as 3 or 1.5,3, or"
                " none"
            )
            raise SettingsError(f"{name} must be {wanted}, got {quoted(value)}")
    return tuple(sorted({float(number) for number in several}))


_ORDERED = (
    ("resample.rate_min_hz", "resample.rate_max_hz"),
    ("scenes.ring_min_m", "scenes.ring_max_m"),
    ("linkage.handover_least_s", "linkage.handover_window_s"),
    ("patrol.scan_s", "patrol.query_s"),
)
"""Of either pair the second may not be below the first."""


@dataclass(frozen=True, slots=True)
class ResampleSettings(_Stage):
    """Cubic interpolation of the recorded tracks and their adaptive sampling."""

    rate_min_hz: float = _number(8.0, 0.01, 1e3)  # paper: slowest update rate
    rate_max_hz: float = _number(16.0, 0.01, 1e3)  # paper: fastest update rate
    rate_hold_s: float = _number(
        1.0, 1e-3, 1e6
    )  # reading: drawn anew after so much of a track
    min_duration_s: float = _number(
        21.6, 0.1, 1e6
    )  # reading: of a track; gives the 366 points
    max_overshoot_m: float = _number(
        0.2, 0, 1e6
    )  # reading: a spline leaves the chord no further


@dataclass(frozen=True, slots=True)
class SceneSettings(_Stage):
    """How a scene is cut and placed."""

    agents: int = _number(4, 1, 100)  # paper: pedestrians per scene
    history_ratio: float = _number(
        0.7, 0, 1, is_open=True
    )  # paper: history's share of a track
    robot_x_m: float = _number(
        0.7, -1e8, 1e8
    )  # reading: centre of the robot's start square
    robot_y_m: float = _number(
        0.65, -1e8, 1e8
    )  # reading: centre of the robot's start square
    robot_spread_m: float = _number(
        4.0, 0, 1e4
    )  # reading: half side of the start square
    near_miss_max_m: float = _number(
        1.4, 1e-3, 1e4
    )  # reading: a near miss passes within this
    ring_min_m: float = _number(
        2.0, 0, 1e4
    )  # reading: the others stand at least so far from it
    ring_max_m: float = _number(6.0, 1e-3, 1e4)  # reading: ... and at most this far
    clearance_m: float = _number(
        1.5, 0, 1e4
    )  # reading: ... and stay so far over the horizon
    max_redraws: int = _number(
        100, 1, 10_000
    )  # reading: of a place; the last is kept and counted


@dataclass(frozen=True, slots=True)
class SensingSettings(_Stage):
    """Link budget of the base station, and the step from the Cramer-Rao bound to an error."""

    place: Literal["centred", "file"] = "centred"
    """reading: where a recording stands; `centred`: the median of its people where the robots
    start (`isac_track.place`); `file`: as its own coordinates say"""
    bs_x_m: float = _number(5.0, -1e8, 1e8)  # paper: base station
    bs_y_m: float = _number(30.0, -1e8, 1e8)  # paper: base station
    carrier_ghz: float = _number(3.5, 1e-3, 1e4)  # paper
    bandwidth_mhz: float = _number(
        100.0, 1e-3, 1e6
    )  # paper: of sensing, taken as a flat spectrum
    n_paths: int = _number(4, 1, 1000)  # paper: multipath number N_p
    delay_spread_s: float = _number(
        2e-7, 0, 1e-3
    )  # paper: largest excess delay of a path
    power_dbm: float = _number(
        30.0, -200, 200
    )  # paper: effective, as it is in the beam: a^H Q a
    noise_dbm: float = _number(-91.0, -300, 100)  # paper: noise floor N_0
    path_loss_exponent: float = _number(
        2.7, 0.1, 10
    )  # paper; each way (reading: monostatic)
    beam_fluctuation_db: float = _number(
        2.0, 0, 50
    )  # paper: N(0, 2) dB a sample (reading: std)
    rcs_m2: float = _number(
        1.0, 1e-6, 1e6
    )  # reading: radar cross-section of a pedestrian
    resource_share: float = _number(1.0, 1e-6, 1e6)  # reading: m_s of eq. swarm_fi
    large_scale_db: float = _number(11.88, 0, 100)  # fitted: two-way log-normal spread
    decorrelation_m: float = _number(10.0, 0.1, 1e6, or_inf=True)
    """reading: over so much of a walk the large-scale gain's correlation falls to 1/e (Gudmundson,
    Electron. Lett. 27, 1991); inf: it is constant along a walk"""
    processing_gain_db: float = _number(
        32.39, -200, 200
    )  # fitted: the receiver's integration gain
    crb_gap_db: float = _number(
        13.27, -200, 200
    )  # fitted: sigma_raw over sqrt(CRB), in 20 log10
    sigma_cap_m: float = _number(
        2.0, 1e-6, 1e6
    )  # reading, fixed before the fit: caps sigma_raw
    law: Literal["radial", "isotropic", "fixed_direction"] = "radial"
    """reading: law of the raw error; a mechanism takes the same unless told otherwise"""


@dataclass(frozen=True, slots=True)
class ConflictSettings(_Stage):
    """The robot's task."""

    robot_speed_mps: float = _number(1.4, 1e-3, 100)  # paper: v_r
    horizon_steps: int = _number(12, 1, 1000)  # paper: H
    horizons_s: tuple[float, ...] = _number((3.0,), 0.1, 60.0)
    """further horizons at which conflicts are made and foreseen, besides the paper's; may be empty:
    a track's grid then has 1 + round(horizon / its mean interval) steps"""
    window: int = _number(16, 2, 100_000)
    """paper: q, samples whose mean interval is the step of the prediction grid; how many samples
    a predictor uses is its own parameter, `least_squares:16`"""
    safety_radius_m: float = _number(0.9, 1e-3, 1e3)  # paper: d_safe
    # paper: `mean`; the other needs a covariance
    decision: Literal["mean", "probability"] = "mean"
    probability_threshold: float = _number(0.5, 0, 1, is_open=True)
    """with `probability`: a conflict is declared at or above it"""


@dataclass(frozen=True, slots=True)
class PrivacySettings(_Stage):
    """The leakage rule."""

    epsilon_m: float = _number(
        0.3, 1e-6, 1e4
    )  # paper: a sample that is closer to the truth leaks
    intervals: IntervalsOf = "segment"
    """reading: whose intervals a leaked segment lasts, its own or the `trajectory`'s mean"""


@dataclass(frozen=True, slots=True)
class AttackSettings(_Stage):
    """What an adversary who rebuilds walks is granted."""

    repeats: int = _number(
        2, 1, 100
    )  # further releases of a walk, for who is granted REPEATS


@dataclass(frozen=True, slots=True)
class LinkageSettings(_Stage):
    """What an adversary is given to link: windows of walks (`attacks.tasks.build`)."""

    window_s: float = _number(
        12.0, 0.1, 1e6
    )  # length of a release in rerelease and new_traversal
    rerelease_shift_s: float = _number(6.0, 0, 1e6)
    """the two releases of a walk start at most this far apart: at least 50 % of either window is
    in both, 87 % on average (Students03)"""
    split_window_s: float = _number(5.0, 0.1, 1e6)  # length of either half in split
    split_gap_s: float = _number(
        2.0, 0, 1e6
    )  # shortest gap between them; in all 12 s of a track
    handover_period_s: float = _number(
        20.0, 0.1, 1e6
    )  # between two rotations of all pseudonyms
    handover_window_s: float = _number(
        5.0, 0.1, 1e6
    )  # seen on either side of the gap, at most
    handover_least_s: float = _number(
        1.0, 0.01, 1e6
    )  # shortest stay of a candidate on its side
    handover_instants: int = _number(
        10_000, 1, 10_000
    )  # ... and at most so many, evenly spread
    most_people: int = _number(1000, 1, 100_000)
    """people who are linked, at most: of more, so many are drawn; in a handover instants are, until
    so many people are there, lest the crowd get thinner"""
    candidates: int = _number(0, 0, 10_000)
    """how many of a gallery a linker scores for each probe, those that a cheap one puts first;
    0: all. Then metrics of all pairs are refused and the loss of rank 1 is measured"""
    trait_strength: float = _number(
        1.0, 0, 10
    )  # spread of planted traits; not 1: simulated anew


@dataclass(frozen=True, slots=True)
class PatrolSettings(_Stage):
    """Robots that walk through a whole recording and ask the network about people."""

    robots: int = _number(
        1, 1, 100
    )  # robots of a fleet, which pools its answers in one log
    fleets: int = _number(
        20, 1, 1000
    )  # fleets with routes of their own; an interval needs 20
    query_s: float = _number(1.0, 1e-3, 3600.0)  # time between two queries of a robot
    scan_s: float = _number(
        0.0836, 1e-3, 60.0
    )  # reading: interval of the clock of all people
    segment_s: float = _number(inf, 1.0, 1e6, or_inf=True)
    """length of the part of a recording that is walked, from its start; inf: all of it"""
    grid_s: float = _number(
        0.1, 1e-3, 60.0
    )  # step of the instants at which a place may be known


@dataclass(frozen=True, slots=True)
class StageSettings:
    """Everything that changes numbers and is not an axis of the matrix."""

    resample: ResampleSettings = field(default_factory=ResampleSettings)
    scenes: SceneSettings = field(default_factory=SceneSettings)
    sensing: SensingSettings = field(default_factory=SensingSettings)
    conflict: ConflictSettings = field(default_factory=ConflictSettings)
    privacy: PrivacySettings = field(default_factory=PrivacySettings)
    attacks: AttackSettings = field(default_factory=AttackSettings)
    linkage: LinkageSettings = field(default_factory=LinkageSettings)
    patrol: PatrolSettings = field(default_factory=PatrolSettings)

    def __post_init__(self) -> None:
        values = self.flat()
        for lower, upper in _ORDERED:
            if values[upper] < values[lower]:
                below = (
                    f"{upper} ({values[upper]:g}) is below {lower} ({values[lower]:g})"
                )
                raise SettingsError(below)
        if self.scenes.near_miss_max_m <= self.conflict.safety_radius_m:
            raise SettingsError(
                f"scenes.near_miss_max_m ({self.scenes.near_miss_max_m:g}) must exceed "
                f"conflict.safety_radius_m ({self.conflict.safety_radius_m:g}): "
                "a near miss would be a conflict"
            )

    def changed(self, values: Mapping[str, Any]) -> Self:
        """Return settings with ``{"stage.key": value}`` applied; text is read as the field's type.

        SettingsError if a stage or key is unknown (with the nearest) or a value out of
        range.
        """
        per_stage: dict[str, dict[str, Any]] = {}
        known = list(self.flat())
        for name, value in values.items():
            if name not in known:
                hint = did_you_mean(name, known) or "; `--list` names all settings"
                raise SettingsError(f"unknown setting {name!r}{hint}")
            stage, key = name.split(".")
            kind = type(getattr(self, stage)).__annotations__[key]
            per_stage.setdefault(stage, {})[key] = _parse(value, kind)
        changed = {
            one: replace(getattr(self, one), **some) for one, some in per_stage.items()
        }
        return replace(self, **changed)

    def flat(self) -> dict[str, Any]:
        """Return ``{"stage.key": value}`` for every setting; a list of numbers as it is typed."""
        return {
            f"{stage.name}.{item.name}": _written(
                getattr(getattr(self, stage.name), item.name)
            )
            for stage in fields(self)
            for item in fields(getattr(self, stage.name))
        }


def _written(value: Any) -> Any:  # noqa: ANN401 - as many types as settings
    if not isinstance(value, tuple):
        return value
    return ",".join(f"{number:.12g}" for number in value) or _EMPTY


def _parse(value: Any, kind: Any) -> Any:  # noqa: ANN401 - text, or TOML's types
    """Return the number that is meant; what is none as it is, for its stage to refuse."""
    if kind == _SEVERAL:
        if not isinstance(value, str):
            return value
        numbers = () if value.strip() in ("", _EMPTY) else value.split(",")
        parsed = tuple(_parse(number, float) for number in numbers)
        return value if any(isinstance(number, str) for number in parsed) else parsed
    if get_args(kind) or isinstance(value, bool):
        return value
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return value
    return int(number) if kind is int and number.is_integer() else number
