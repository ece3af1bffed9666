"""Frozen settings of each stage: a field for each parameter, its unit in the name.

A field marked *paper* is a value of the paper's table or text, *reading* settles what
the paper leaves open (``docs/explanation/reproduction.md``), *fitted* is an output of
``python scripts/calibrate.py``. ``--set STAGE.KEY=VALUE`` and the same keys in a TOML
file change them. A range reaches far beyond useful values, but only as far as
arithmetic and memory allow.
"""

from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields, replace
from math import inf
from numbers import Integral, Real
from typing import Any, Final, Literal, Self, TypeAlias, get_args

from isac_track.errors import SettingsError, did_you_mean, quoted

IntervalsOf: TypeAlias = Literal["segment", "trajectory"]
"""The sampling intervals that make up the duration of a leaked segment."""
Measurement: TypeAlias = Literal["scalar", "range_bearing"]
"""What a position is measured by.

``scalar``: the paper's error, with the same variance on both axes. ``range_bearing``:
an error ellipse that points to the base station.
"""
Scaling: TypeAlias = Literal["trace", "information"]
"""Quantity that an error ellipse shares with the scalar error of a sample.

``trace``: the mean squared error, so that only the shape differs. ``information``: the
mean Fisher information of both axes; the mean squared error then grows with the ratio r
of the axes by (r + 1/r)^2 / 4.
"""
_EMPTY: Final = "none"  # Text for an empty list of numbers.
_NUMBER_LIST: Final = tuple[float, ...]  # Type of a setting with several numbers.
LINK: Final = "link"  # Detection probability: from the link budget.
_NUMBER_OR_LINK: Final[Any] = float | Literal["link"]  # Type of that setting.


def _number(
    default: float | tuple[float, ...],
    low: float,
    high: float,
    *,
    is_open: bool = False,
    or_inf: bool = False,
) -> Any:  # noqa: ANN401 - a field of any type of number
    """Declare a field of one or several numbers, and their range.

    The ends belong to the range unless it `is_open`. With `or_inf` infinity is allowed
    as well.
    """
    return field(
        default=default, metadata={"range": (low, high), "open": is_open, "inf": or_inf}
    )


@dataclass(frozen=True, slots=True)
class _Stage:
    """Settings of a stage, which check the type and range of their fields."""

    def __post_init__(self) -> None:
        (stage,) = (
            item.name for item in fields(StageSettings) if item.type is type(self)
        )
        for item in fields(self):
            name, value = f"{stage}.{item.name}", getattr(self, item.name)
            if item.type == _NUMBER_LIST:
                numbers = _sort_numbers(name, value, item.metadata["range"])
                object.__setattr__(self, item.name, numbers)
            elif item.type is str:
                _check_spec(name, value)
            elif item.type == _NUMBER_OR_LINK:
                if value != LINK:
                    _check_number(name, value, item, beside=f", or be {LINK}")
            elif choices := get_args(item.type):
                if value not in choices:
                    wanted = f"be one of {', '.join(choices)}"
                    raise SettingsError(f"{name} must {wanted}, got {quoted(value)}")
            else:
                _check_number(name, value, item)


def _check_spec(name: str, value: object) -> None:
    """Raise SettingsError for a value that cannot be the SPEC of a plug-in."""
    if not isinstance(value, str) or not value or len(value.split()) != 1:
        raise SettingsError(
            f"{name} must be the SPEC of a plug-in, without spaces, got {quoted(value)}"
        )


def _check_number(
    name: str,
    value: Any,  # noqa: ANN401 - anything
    item: Field[Any],
    *,
    beside: str = "",
) -> None:
    """Raise SettingsError for a value of another type, or outside the field's range.

    `beside` says which other values the field takes.
    """
    kind, noun = (Integral, "whole number") if item.type is int else (Real, "number")
    if isinstance(value, bool) or not isinstance(value, kind):
        raise SettingsError(f"{name} must be a {noun}{beside}, got {quoted(value)}")
    low, high = item.metadata["range"]
    if item.metadata["open"]:
        fits, wanted = low < value < high, f"between {low:g} and {high:g}"
    else:
        fits, wanted = low <= value <= high, f"within {low:g} to {high:g}"
    if item.metadata["inf"]:
        fits, wanted = fits or value == inf, f"{wanted}, or be inf"
    if not fits:  # NaN does not fit either
        raise SettingsError(f"{name} must lie {wanted}{beside}, got {quoted(value)}")


def _sort_numbers(
    name: str, value: object, ends: tuple[float, float]
) -> tuple[float, ...]:
    """Return distinct numbers in ascending order; SettingsError for other values."""
    several = value if isinstance(value, tuple | list) else (value,)
    for number in several:
        is_number = isinstance(number, Real) and not isinstance(number, bool)
        # NaN lies within no range.
        if not is_number or not ends[0] <= number <= ends[1]:
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
"""Pairs of settings; the second of a pair may not be below the first."""


@dataclass(frozen=True, slots=True)
class ResampleSettings(_Stage):
    """Cubic interpolation of the recorded tracks and their adaptive sampling."""

    rate_min_hz: float = _number(8.0, 0.01, 1e3)  # paper: slowest update rate
    rate_max_hz: float = _number(16.0, 0.01, 1e3)  # paper: fastest update rate
    # reading: the rate is drawn anew after so much time of a track
    rate_hold_s: float = _number(1.0, 1e-3, 1e6)
    # reading: a shorter track is left out; this gives the 366 points
    min_duration_s: float = _number(21.6, 0.1, 1e6)
    # reading: a spline stays within this distance of the chord
    max_overshoot_m: float = _number(0.2, 0, 1e6)


@dataclass(frozen=True, slots=True)
class SceneSettings(_Stage):
    """How a scene is cut and placed."""

    agents: int = _number(4, 1, 100)  # paper: pedestrians per scene
    # paper: history's share of a track
    history_ratio: float = _number(0.7, 0, 1, is_open=True)
    # reading: centre of the robot's start square
    robot_x_m: float = _number(0.7, -1e8, 1e8)
    # reading: centre of the robot's start square
    robot_y_m: float = _number(0.65, -1e8, 1e8)
    # reading: half side of the start square
    robot_spread_m: float = _number(4.0, 0, 1e4)
    # reading: a near miss passes within this
    near_miss_max_m: float = _number(1.4, 1e-3, 1e4)
    # reading: the other agents stand at least this far from the robot
    ring_min_m: float = _number(2.0, 0, 1e4)
    ring_max_m: float = _number(6.0, 1e-3, 1e4)  # reading: ... and at most this far
    # reading: ... and stay at least this far from it over the horizon
    clearance_m: float = _number(1.5, 0, 1e4)
    # reading: draws of a place; the last draw is used and counted
    max_redraws: int = _number(100, 1, 10_000)


@dataclass(frozen=True, slots=True)
class SensingSettings(_Stage):
    """Link budget of the base station, and the step from the CRB to an error."""

    place: Literal["centred", "file"] = "centred"
    """reading: where a recording stands; `centred`: with the median of its people where
    the robots start (`isac_track.place`); `file`: at its own coordinates"""
    bs_x_m: float = _number(5.0, -1e8, 1e8)  # paper: base station
    bs_y_m: float = _number(30.0, -1e8, 1e8)  # paper: base station
    carrier_ghz: float = _number(3.5, 1e-3, 1e4)  # paper
    # paper: sensing bandwidth, taken as a flat spectrum
    bandwidth_mhz: float = _number(100.0, 1e-3, 1e6)
    n_paths: int = _number(4, 1, 1000)  # paper: multipath number N_p
    # paper: largest excess delay of a path
    delay_spread_s: float = _number(2e-7, 0, 1e-3)
    # paper: effective power in the beam, a^H Q a
    power_dbm: float = _number(30.0, -200, 200)
    noise_dbm: float = _number(-91.0, -300, 100)  # paper: noise floor N_0
    # paper: applied each way (reading: monostatic)
    path_loss_exponent: float = _number(2.7, 0.1, 10)
    # paper: N(0, 2) dB at each sample (reading: 2 is the standard deviation)
    beam_fluctuation_db: float = _number(2.0, 0, 50)
    # reading: radar cross-section of a pedestrian
    rcs_m2: float = _number(1.0, 1e-6, 1e6)
    resource_share: float = _number(1.0, 1e-6, 1e6)  # reading: m_s of eq. swarm_fi
    large_scale_db: float = _number(11.88, 0, 100)  # fitted: two-way log-normal spread
    decorrelation_m: float = _number(10.0, 0.1, 1e6, or_inf=True)
    """reading: distance walked over which the correlation of the large-scale gain falls
    to 1/e (Gudmundson, Electron. Lett. 27, 1991); inf: constant along a walk"""
    # fitted: the receiver's integration gain
    processing_gain_db: float = _number(32.39, -200, 200)
    # fitted: sigma_raw over sqrt(CRB), in 20 log10
    crb_gap_db: float = _number(13.27, -200, 200)
    # reading, fixed before the fit: caps sigma_raw
    sigma_cap_m: float = _number(2.0, 1e-6, 1e6)
    law: Literal["radial", "isotropic", "fixed_direction"] = "radial"
    """reading: law of the raw error; a mechanism takes the same by default"""
    measurement: Measurement = "scalar"
    """reading: `scalar`: the error has the same variance on both axes; `range_bearing`:
    it is an ellipse that points to the base station (`isac_track.measurement`)"""
    # antennas of the uniform linear array that measures the bearing
    n_antennas: int = _number(8, 2, 100_000)
    scaling: Scaling = "trace"
    """what a range and bearing error shares with the scalar error: `trace`: the mean
    squared error, so that only the shape differs; `information`: the mean Fisher
    information of both axes"""


@dataclass(frozen=True, slots=True)
class ConflictSettings(_Stage):
    """The robot's task."""

    robot_speed_mps: float = _number(1.4, 1e-3, 100)  # paper: v_r
    horizon_steps: int = _number(12, 1, 1000)  # paper: H
    horizons_s: tuple[float, ...] = _number((3.0,), 0.1, 60.0)
    """further horizons of conflicts besides the paper's; may be empty. The grid of a
    track then has 1 + round(horizon / its mean interval) steps"""
    window: int = _number(16, 2, 100_000)
    """paper: q, number of samples whose mean interval is the step of the prediction
    grid; how many samples a predictor uses is its own parameter, `least_squares:16`"""
    safety_radius_m: float = _number(0.9, 1e-3, 1e3)  # paper: d_safe
    # paper: `mean`; `probability` needs a covariance
    decision: Literal["mean", "probability"] = "mean"
    probability_threshold: float = _number(0.5, 0, 1, is_open=True)
    """with `probability`: a conflict is declared at or above it"""


@dataclass(frozen=True, slots=True)
class PrivacySettings(_Stage):
    """The leakage rule."""

    # paper: a sample that is closer to the truth leaks
    epsilon_m: float = _number(0.3, 1e-6, 1e4)
    intervals: IntervalsOf = "segment"
    """reading: the duration of a leaked segment is made of its own sampling intervals,
    or of the mean interval of its `trajectory`"""


@dataclass(frozen=True, slots=True)
class AttackSettings(_Stage):
    """Knowledge of an adversary who reconstructs walks."""

    # number of further releases of a walk, for adversaries that are granted REPEATS
    repeats: int = _number(2, 1, 100)


@dataclass(frozen=True, slots=True)
class LinkageSettings(_Stage):
    """Windows of walks that an adversary is to link (`attacks.tasks.build`)."""

    # length of a release in rerelease and new_traversal
    window_s: float = _number(12.0, 0.1, 1e6)
    rerelease_shift_s: float = _number(6.0, 0, 1e6)
    """the two releases of a walk start at most this far apart: they share at least 50 %
    of either window, 87 % on average (Students03)"""
    split_window_s: float = _number(5.0, 0.1, 1e6)  # length of either half in split
    # shortest gap between the halves; with them 12 s of a track
    split_gap_s: float = _number(2.0, 0, 1e6)
    # time between two rotations of all pseudonyms
    handover_period_s: float = _number(20.0, 0.1, 1e6)
    # longest window on either side of the gap
    handover_window_s: float = _number(5.0, 0.1, 1e6)
    # shortest stay of a candidate on its side
    handover_least_s: float = _number(1.0, 0.01, 1e6)
    # largest number of rotations, evenly spread
    handover_instants: int = _number(10_000, 1, 10_000)
    most_people: int = _number(1000, 1, 100_000)
    """largest number of people to link. From more people this many are drawn. In a
    handover instants are drawn until they hold this many people, so that the crowd does
    not get thinner"""
    candidates: int = _number(0, 0, 10_000)
    """how many candidates of the gallery a linker scores for each probe: those that a
    cheap linker ranks first; 0: all. With candidates, metrics of all pairs are refused
    and the loss at rank 1 is measured"""
    # spread of planted traits; a value other than 1 is simulated anew
    trait_strength: float = _number(1.0, 0, 10)


@dataclass(frozen=True, slots=True)
class PatrolSettings(_Stage):
    """Robots that walk through a whole recording and ask the network about people."""

    # robots of a fleet, which pools its answers in one log
    robots: int = _number(1, 1, 100)
    # fleets with routes of their own; an interval needs 20; 0: as the preset of a run says
    fleets: int = _number(20, 0, 1000)
    query_s: float = _number(1.0, 1e-3, 3600.0)  # time between two queries of a robot
    # reading: interval of the clock of all people
    scan_s: float = _number(0.0836, 1e-3, 60.0)
    segment_s: float = _number(inf, 0.0, 1e6, or_inf=True)
    """length of the part of a recording that is used, from its start; inf: all of it;
    0: as the preset of a run says"""
    # step of the instants at which a place may be known
    grid_s: float = _number(0.1, 1e-3, 60.0)
    errors: Literal["walk", "query"] = "walk"
    """reading: `walk`: a person and a sample have one error in all answers; `query`:
    the network senses and shares all history anew at every query"""
    pseudonyms: Literal["query", "encounter"] = "query"
    """reading: how long an answer's pseudonym lasts: for a query, or for an encounter,
    which is a run of queries of a robot that are answered about a person"""


@dataclass(frozen=True, slots=True)
class TrackingSettings(_Stage):
    """How the network associates its detections (`isac_track.tracking`)."""

    method: str = "oracle"
    """reading: SPEC of the tracker; `oracle`, perfect association, is the paper's, and
    adds no numbers to a run"""
    noise: Literal["after", "before"] = "after"
    """a mechanism acts along tracks, after tracking, or on detections, before it"""
    release: Literal["tracks", "detections"] = "tracks"
    """what is released: tracks of the network, or unlabelled points of its scans. A robot
    tracks these by the same method, an adversary by the strongest that it knows"""
    # of a person at a scan: a number, or `link`: from the link budget
    detection_probability: float | Literal["link"] = _number(0.9, 0, 1)
    # probability of a false alarm of the detector's threshold; counts with `link` only
    p_false_alarm: float = _number(1e-4, 0, 1, is_open=True)
    # mean number of detections of nobody in a scan
    clutter_per_scan: float = _number(3.0, 0, 1000)
    seeds: int = _number(
        5, 1, 100
    )  # draws of all sensing errors, of which intervals draw
    block_s: float = _number(
        10.0, 0.1, 1e6
    )  # length of a block, of which intervals draw


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
    tracking: TrackingSettings = field(default_factory=TrackingSettings)

    def __post_init__(self) -> None:
        values = self.flat()
        for lower, upper in _ORDERED:
            if values[upper] < values[lower]:
                raise SettingsError(
                    f"{upper} ({values[upper]:g}) is below {lower} ({values[lower]:g})"
                )
        if self.scenes.near_miss_max_m <= self.conflict.safety_radius_m:
            raise SettingsError(
                f"scenes.near_miss_max_m ({self.scenes.near_miss_max_m:g}) must exceed "
                f"conflict.safety_radius_m ({self.conflict.safety_radius_m:g}): "
                "a near miss would be a conflict"
            )
        if self.tracking.release == "detections" and self.tracking.noise == "after":
            raise SettingsError(
                "tracking.release=detections has no tracks to add noise along: add"
                " --set tracking.noise=before"
            )

    def changed(self, values: Mapping[str, Any]) -> Self:
        """Return settings with ``{"stage.key": value}`` applied.

        A value given as text is read as the field's type. SettingsError if a stage or
        key is unknown (it names the nearest) or a value is out of range.
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
            stage: replace(getattr(self, stage), **changes)
            for stage, changes in per_stage.items()
        }
        return replace(self, **changed)

    def flat(self) -> dict[str, Any]:
        """Return ``{"stage.key": value}`` of all settings; lists of numbers as text."""
        return {
            f"{stage.name}.{item.name}": _plain_value(
                getattr(getattr(self, stage.name), item.name)
            )
            for stage in fields(self)
            for item in fields(getattr(self, stage.name))
        }


def _plain_value(value: Any) -> Any:  # noqa: ANN401 - as many types as settings
    """Return a value as it is, and a list of numbers as the text that gives it."""
    if not isinstance(value, tuple):
        return value
    return ",".join(f"{number:.12g}" for number in value) or _EMPTY


def _parse(value: Any, kind: Any) -> Any:  # noqa: ANN401 - text, or TOML's types
    """Return the number that text means; other values as they are, for later checks."""
    if kind == _NUMBER_LIST:
        if not isinstance(value, str):
            return value
        numbers = () if value.strip() in ("", _EMPTY) else value.split(",")
        parsed = tuple(_parse(number, float) for number in numbers)
        return value if any(isinstance(number, str) for number in parsed) else parsed
    if kind == _NUMBER_OR_LINK:
        return value if value == LINK else _parse(value, float)
    if kind is str or get_args(kind) or isinstance(value, bool):
        return value
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return value
    return int(number) if kind is int and number.is_integer() else number
