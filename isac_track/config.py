"""Frozen settings per stage: the paper's table, one field a parameter, the unit in the name.

A field marked *paper* is a value of the paper's table or text, *reading* settles what the
paper leaves open (``docs/reproduction.md``), *fitted* is output of ``python -m
evaluation.calibrate``. ``--set STAGE.KEY=VALUE`` and the same keys in a TOML file change them,
within `RANGES`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from functools import cache
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Literal, get_args, get_type_hints

from isac_track.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping

RANGES: Mapping[str, tuple[float, float]] = {
    "resample.rate_min_hz": (0.01, 1e3),
    "resample.rate_max_hz": (0.01, 1e3),
    "resample.rate_hold_s": (1e-3, 1e6),
    "resample.min_duration_s": (0.1, 1e6),
    "scenes.agents": (1, 100),
    "scenes.history_ratio": (0, 1),
    "scenes.robot_x_m": (-1e6, 1e6),
    "scenes.robot_y_m": (-1e6, 1e6),
    "scenes.robot_spread_m": (0, 1e4),
    "scenes.near_miss_max_m": (1e-3, 1e4),
    "scenes.ring_min_m": (0, 1e4),
    "scenes.ring_max_m": (1e-3, 1e4),
    "scenes.clearance_m": (0, 1e4),
    "scenes.max_redraws": (1, 10_000),
    "sensing.bs_x_m": (-1e6, 1e6),
    "sensing.bs_y_m": (-1e6, 1e6),
    "sensing.carrier_ghz": (1e-3, 1e4),
    "sensing.bandwidth_mhz": (1e-3, 1e6),
    "sensing.n_paths": (1, 1000),
    "sensing.delay_spread_s": (0, 1e-3),
    "sensing.power_dbm": (-200, 200),
    "sensing.noise_dbm": (-300, 100),
    "sensing.path_loss_exponent": (0.1, 10),
    "sensing.beam_fluctuation_db": (0, 50),
    "sensing.rcs_m2": (1e-6, 1e6),
    "sensing.resource_share": (1e-6, 1e6),
    "sensing.large_scale_db": (0, 100),
    "sensing.processing_gain_db": (-200, 200),
    "sensing.crb_gap_db": (-200, 200),
    "sensing.sigma_cap_m": (1e-6, 1e6),
    "conflict.robot_speed_mps": (1e-3, 100),
    "conflict.horizon_steps": (1, 1000),
    "conflict.window": (2, 100_000),
    "conflict.safety_radius_m": (1e-3, 1e3),
    "conflict.probability_threshold": (0, 1),
    "privacy.epsilon_m": (1e-6, 1e4),
    "linkage.window_s": (0.1, 1e6),
    "linkage.rerelease_shift_s": (0, 1e6),
    "linkage.split_window_s": (0.1, 1e6),
    "linkage.split_gap_s": (0, 1e6),
    "linkage.handover_period_s": (0.1, 1e6),
    "linkage.handover_window_s": (0.1, 1e6),
    "linkage.handover_least_s": (0.01, 1e6),
    "linkage.handover_instants": (1, 10_000),
    "linkage.most_people": (1, 10_000),
    "linkage.trait_strength": (0, 10),
}
"""Smallest and largest value of every number: far beyond what is physical or of use, but within
what the arithmetic and the memory of a computer can take."""
_MOST_SHOWN = 60
_OPEN = {"scenes.history_ratio", "conflict.probability_threshold"}
"""Shares that may be neither end of their range."""


@dataclass(frozen=True, slots=True)
class ResampleSettings:
    """Cubic interpolation of the recorded tracks and their adaptive sampling."""

    rate_min_hz: float = 8.0
    """paper: slowest update rate"""
    rate_max_hz: float = 16.0
    """paper: fastest update rate"""
    rate_hold_s: float = 1.0
    """reading: a rate is drawn anew after this much of the track"""
    min_duration_s: float = 21.6
    """reading: shorter tracks are left out (gives the paper's 366 history points)"""

    def __post_init__(self) -> None:
        _check(self, "resample")
        if self.rate_max_hz < self.rate_min_hz:
            raise SettingsError(
                f"resample.rate_max_hz ({self.rate_max_hz:g}) is below "
                f"resample.rate_min_hz ({self.rate_min_hz:g})"
            )


@dataclass(frozen=True, slots=True)
class SceneSettings:
    """How a scene is cut and placed."""

    agents: int = 4
    """paper: pedestrians per scene"""
    history_ratio: float = 0.7
    """paper: share of a track that is shared history; the rest is hidden future"""
    robot_x_m: float = 0.7
    """reading: centre of the robot's start square"""
    robot_y_m: float = 0.65
    """reading: centre of the robot's start square"""
    robot_spread_m: float = 4.0
    """reading: half side of the start square"""
    near_miss_max_m: float = 1.4
    """reading: a near miss passes at conflict.safety_radius_m to this distance"""
    ring_min_m: float = 2.0
    """reading: the other agents stand at least this far from the robot now"""
    ring_max_m: float = 6.0
    """reading: ... and at most this far"""
    clearance_m: float = 1.5
    """reading: ... and stay this far from it over the horizon"""
    max_redraws: int = 100
    """reading: draws of a place before the last one is kept and counted"""

    def __post_init__(self) -> None:
        _check(self, "scenes")
        if self.ring_max_m < self.ring_min_m:
            raise SettingsError("scenes.ring_max_m is below scenes.ring_min_m")


@dataclass(frozen=True, slots=True)
class SensingSettings:
    """Link budget of the base station, and the step from the Cramer-Rao bound to an error."""

    bs_x_m: float = 5.0
    """paper: base station"""
    bs_y_m: float = 30.0
    """paper: base station"""
    carrier_ghz: float = 3.5
    """paper"""
    bandwidth_mhz: float = 100.0
    """paper: sensing bandwidth, taken as a flat spectrum"""
    n_paths: int = 4
    """paper: multipath number N_p"""
    delay_spread_s: float = 2e-7
    """paper: largest excess delay of a path"""
    power_dbm: float = 30.0
    """paper: effective power, as it arrives in the beam: a^H Q a"""
    noise_dbm: float = -91.0
    """paper: noise floor N_0"""
    path_loss_exponent: float = 2.7
    """paper; each way (reading: monostatic, two-way)"""
    beam_fluctuation_db: float = 2.0
    """paper: N(0, 2) dB per sample (reading: 2 dB is the standard deviation)"""
    rcs_m2: float = 1.0
    """reading: radar cross-section of a pedestrian"""
    resource_share: float = 1.0
    """reading: m_s of eq. swarm_fi"""
    large_scale_db: float = 11.79
    """fitted: two-way log-normal spread, drawn once per track"""
    processing_gain_db: float = 32.43
    """fitted: integration gain of the sensing receiver"""
    crb_gap_db: float = 13.27
    """fitted: sigma_raw over sqrt(CRB), in 20 log10"""
    sigma_cap_m: float = 2.0
    """reading, fixed before the fit: sigma_raw is capped here"""
    law: Literal["radial", "isotropic", "fixed_direction"] = "radial"
    """reading: law of the raw error; a mechanism takes the same unless told otherwise"""

    def __post_init__(self) -> None:
        _check(self, "sensing")


@dataclass(frozen=True, slots=True)
class ConflictSettings:
    """The robot's task."""

    robot_speed_mps: float = 1.4
    """paper: v_r"""
    horizon_steps: int = 12
    """paper: H"""
    window: int = 16
    """paper: q, samples whose mean interval is the step of the prediction grid; how many samples
    a predictor uses is its own parameter, `least_squares:16`"""
    safety_radius_m: float = 0.9
    """paper: d_safe"""
    decision: Literal["mean", "probability"] = "mean"
    """paper: `mean`, the predicted positions alone; `probability` needs a covariance"""
    probability_threshold: float = 0.5
    """with `probability`: a conflict is declared at or above it"""

    def __post_init__(self) -> None:
        _check(self, "conflict")


@dataclass(frozen=True, slots=True)
class PrivacySettings:
    """The leakage rule."""

    epsilon_m: float = 0.3
    """paper: a sample leaks when it lies closer than this to the truth"""

    def __post_init__(self) -> None:
        _check(self, "privacy")


@dataclass(frozen=True, slots=True)
class LinkageSettings:
    """What an adversary is given to link: windows of walks (`attacks.tasks.build`)."""

    window_s: float = 12.0
    """length of a release in rerelease and new_traversal, the same for everyone"""
    rerelease_shift_s: float = 6.0
    """the two releases of a walk start at most this far apart, so that most of it is shown twice"""
    split_window_s: float = 5.0
    """length of either half in split"""
    split_gap_s: float = 2.0
    """shortest gap between the halves; with the windows, 12 s of a track"""
    handover_period_s: float = 20.0
    """time between two instants at which all pseudonyms rotate"""
    handover_window_s: float = 5.0
    """how much of a walk an adversary sees on either side of the gap, at most"""
    handover_least_s: float = 1.0
    """who is there for less than this on one side of the gap is no candidate on that side"""
    handover_instants: int = 16
    """... and at most so many, evenly over the recording"""
    most_people: int = 300
    """people who are linked in the other tasks, at most: of more, so many are drawn"""
    trait_strength: float = 1.0
    """spread of the crowd's planted traits; 1 is the bundled one, another is simulated anew"""

    def __post_init__(self) -> None:
        _check(self, "linkage")
        if self.handover_least_s > self.handover_window_s:
            raise SettingsError("linkage.handover_least_s is above linkage.handover_window_s")


@dataclass(frozen=True, slots=True)
class StageSettings:
    """Everything that changes numbers and is not an axis of the matrix."""

    resample: ResampleSettings = field(default_factory=ResampleSettings)
    scenes: SceneSettings = field(default_factory=SceneSettings)
    sensing: SensingSettings = field(default_factory=SensingSettings)
    conflict: ConflictSettings = field(default_factory=ConflictSettings)
    privacy: PrivacySettings = field(default_factory=PrivacySettings)
    linkage: LinkageSettings = field(default_factory=LinkageSettings)

    def __post_init__(self) -> None:
        for item in fields(self):
            wanted, given = get_type_hints(StageSettings)[item.name], getattr(self, item.name)
            if not isinstance(given, wanted):
                raise SettingsError(
                    f"{item.name} must be {wanted.__name__}, got {type(given).__name__}"
                )
        if self.scenes.near_miss_max_m <= self.conflict.safety_radius_m:
            raise SettingsError(
                f"scenes.near_miss_max_m ({self.scenes.near_miss_max_m:g}) must exceed "
                f"conflict.safety_radius_m ({self.conflict.safety_radius_m:g}): "
                "a near miss would be a conflict"
            )

    def changed(self, values: Mapping[str, Any]) -> StageSettings:
        """Return settings with ``{"stage.key": value}`` applied; text is read as the field's type.

        Raises
        ------
        SettingsError
            For an unknown stage or key (with the nearest known one) or a value out of range.
        """
        per_stage: dict[str, dict[str, Any]] = {}
        known = setting_types()
        for name, value in values.items():
            if name not in known:
                near = get_close_matches(name, known, n=1)
                hint = f"; did you mean {near[0]}?" if near else "; `--list` names all settings"
                raise SettingsError(f"unknown setting {name!r}{hint}")
            stage, key = name.split(".")
            per_stage.setdefault(stage, {})[key] = _parse(name, value, known[name])
        stages = {
            stage: replace(getattr(self, stage), **changes) for stage, changes in per_stage.items()
        }
        return replace(self, **stages)

    def flat(self) -> dict[str, Any]:
        """Return ``{"stage.key": value}`` for every setting."""
        return {
            f"{stage.name}.{item.name}": getattr(getattr(self, stage.name), item.name)
            for stage in fields(self)
            for item in fields(getattr(self, stage.name))
        }


@cache
def setting_types() -> Mapping[str, Any]:
    """Return ``{"stage.key": type}`` for every setting."""
    return {
        f"{stage}.{key}": annotation
        for stage, kind in get_type_hints(StageSettings).items()
        if is_dataclass(kind)
        for key, annotation in get_type_hints(kind).items()
    }


def _parse(name: str, value: Any, annotation: Any) -> Any:  # noqa: ANN401 - text, or TOML's types
    """Return what text or another type of number stands for; `_check` looks at the rest."""
    if get_args(annotation):
        return value
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    except (TypeError, ValueError):
        raise SettingsError(f"{name} must be a number, got {_shown(value)}") from None
    if isinstance(value, bool) or not math.isfinite(number):
        raise SettingsError(f"{name} must be a finite number, got {_shown(value)}")
    if annotation is int:
        if number != int(number):
            raise SettingsError(f"{name} must be a whole number, got {_shown(value)}")
        return int(number)
    return number


def _check(settings: object, stage: str) -> None:
    """Check the type and the range of every field, however the settings were made."""
    for key in type(settings).__dataclass_fields__:  # type: ignore[attr-defined]  # all are
        name, value = f"{stage}.{key}", getattr(settings, key)
        annotation = setting_types()[name]
        choices = get_args(annotation)
        if choices:
            if value not in choices:
                raise SettingsError(
                    f"{name} must be one of {', '.join(choices)}, got {_shown(value)}"
                )
            continue
        kind, noun = (Integral, "whole number") if annotation is int else (Real, "number")
        fits = isinstance(value, kind) and not isinstance(value, bool)
        if not fits:
            raise SettingsError(f"{name} must be a {noun}, got {_shown(value)}")
        low, high = RANGES[name]
        inside = low < value < high if name in _OPEN else low <= value <= high  # False for NaN
        if not inside:
            raise SettingsError(f"{name} must {_wanted(name, value)}, got {_shown(value)}")


def _wanted(name: str, value: Any) -> str:  # noqa: ANN401 - any real number
    low, high = RANGES[name]
    if name in _OPEN:
        return f"lie between {low:g} and {high:g}"
    bounds = f"{low:g} to {high:g}"
    if low > 0 >= value:
        return f"be positive ({bounds})"
    if low == 0 > value:
        return f"not be negative ({bounds})"
    return f"lie within {bounds}"


def _shown(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write very long whole numbers
        return "a number with thousands of digits"
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."
