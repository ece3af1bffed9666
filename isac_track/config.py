"""Frozen settings per stage: the paper's table, one field a parameter, the unit in the name.

A field marked *paper* is a value of the paper's table or text, *reading* settles what the
paper leaves open (``docs/reproduction.md``), *fitted* is output of ``python -m
evaluation.calibrate``. ``--set STAGE.KEY=VALUE`` and the same keys in a TOML file change them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from isac_track.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping

from typing import Literal


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
        _positive(self, "resample", "rate_min_hz", "rate_max_hz", "rate_hold_s", "min_duration_s")
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
        _positive(self, "scenes", "agents", "near_miss_max_m", "ring_max_m", "max_redraws")
        _not_negative(self, "scenes", "robot_spread_m", "ring_min_m", "clearance_m")
        if not 0 < self.history_ratio < 1:
            raise SettingsError("scenes.history_ratio must lie between 0 and 1")
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
        _positive(
            self,
            "sensing",
            "carrier_ghz",
            "bandwidth_mhz",
            "n_paths",
            "path_loss_exponent",
            "rcs_m2",
            "resource_share",
            "sigma_cap_m",
        )
        _not_negative(self, "sensing", "delay_spread_s", "beam_fluctuation_db", "large_scale_db")


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
        if not 0 < self.probability_threshold < 1:
            raise SettingsError("conflict.probability_threshold must lie between 0 and 1")
        _positive(self, "conflict", "robot_speed_mps", "horizon_steps", "safety_radius_m")
        if self.window < 2:  # noqa: PLR2004 - an interval needs two samples
            raise SettingsError("conflict.window must be at least 2")


@dataclass(frozen=True, slots=True)
class PrivacySettings:
    """The leakage rule."""

    epsilon_m: float = 0.3
    """paper: a sample leaks when it lies closer than this to the truth"""

    def __post_init__(self) -> None:
        _positive(self, "privacy", "epsilon_m")


@dataclass(frozen=True, slots=True)
class LinkageSettings:
    """What an adversary is given to link: windows of walks (`attacks.linkage.tasks`)."""

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
        _positive(
            self,
            "linkage",
            "window_s",
            "split_window_s",
            "handover_period_s",
            "handover_window_s",
            "handover_least_s",
            "handover_instants",
            "most_people",
        )
        _not_negative(self, "linkage", "rerelease_shift_s", "split_gap_s", "trait_strength")
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


def setting_types() -> dict[str, Any]:
    """Return ``{"stage.key": type}`` for every setting."""
    return {
        f"{stage}.{key}": annotation
        for stage, kind in get_type_hints(StageSettings).items()
        if is_dataclass(kind)
        for key, annotation in get_type_hints(kind).items()
    }


def _parse(name: str, value: Any, annotation: Any) -> Any:  # noqa: ANN401 - text, or TOML's types
    choices = get_args(annotation)
    if choices:
        if value not in choices:
            raise SettingsError(f"{name} must be one of {', '.join(choices)}, got {value!r}")
        return value
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise SettingsError(f"{name} must be a number, got {value!r}") from None
    if isinstance(value, bool) or not math.isfinite(number):
        raise SettingsError(f"{name} must be a finite number, got {value!r}")
    if annotation is int:
        if number != int(number):
            raise SettingsError(f"{name} must be a whole number, got {value!r}")
        return int(number)
    return number


def _positive(settings: object, stage: str, *names: str) -> None:
    for name in names:
        if not getattr(settings, name) > 0:
            raise SettingsError(f"{stage}.{name} must be positive, got {getattr(settings, name)}")


def _not_negative(settings: object, stage: str, *names: str) -> None:
    for name in names:
        if not getattr(settings, name) >= 0:
            raise SettingsError(
                f"{stage}.{name} must not be negative, got {getattr(settings, name)}"
            )
