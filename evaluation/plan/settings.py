"""The settings of a run: every option of the command line and of Python, checked."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from math import inf, nextafter
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np

from evaluation.plan.choices import Choice, parse_choice
from evaluation.plan.constants import MOST_JOBS, MOST_SCENES
from evaluation.plan.presets import DEFAULT, PRESETS
from isac_track.config import StageSettings
from isac_track.errors import SettingsError, did_you_mean, quoted
from isac_track.protocols import ADVERSARIES

OPTIONS: Final = {
    "mechanisms": "mechanism",
    "predictors": "predictor",
    "attacks": "attack",
    "tasks": "task",
    "policies": "policy",
}
"""By axis: the option of the command line that names its values."""
AXES: Final = (*OPTIONS,)


@dataclass(frozen=True, slots=True)
class _Kind:
    """The type of an option's values: those accepted, their conversion, and words."""

    accepted: Any  # As for `isinstance`.
    convert: type
    words: str  # With {} for the option's name.


_TEXT: Final = _Kind(str, str, "text")
_WHOLE_NUMBER: Final = _Kind(Integral, int, "a whole number, as {}=40")
_NUMBER: Final = _Kind(Real, float, "a number, as {}=2.5")
_FLAG: Final = _Kind((bool, np.bool_), bool, "True or False")
_KINDS: Final[Mapping[str, _Kind]] = {
    **dict.fromkeys(("scenes", "utility_scenes", "seed", "jobs"), _WHOLE_NUMBER),
    **dict.fromkeys(("fps", "cell_timeout_s", "drop_frozen"), _NUMBER),
    **dict.fromkeys(("precision", "pilot_half_width"), _NUMBER),
    **dict.fromkeys(("persistent_ids", "keep_scores", "keep_ids", "fresh"), _FLAG),
    **dict.fromkeys(("preset", "format", "executor", "scheduler"), _TEXT),
    **dict.fromkeys(("unit", "columns", "on_duplicate", "crs"), _TEXT),
    "confirming": _Kind(str, str, "the name of a session"),
    "out": _Kind((str, Path), Path, "the path of a folder"),
}
"""By option, but for lists, data sets and stages."""
_SCENES_WRONG = (
    "a run needs at least 2 scenes (one of each label) and at most {1:,}, got {0}"
)
_PRECISION_WRONG = (
    "--precision is the half-width of a missed-conflict rate's interval, between 0 and"
    " 0.5 (0.01: +- 1 %), got {0:g}"
)
_ADDRESS = re.compile(r"(inproc://.+)|(([\w-]+://)?[^/\s]+:(?P<port>[0-9]{1,5})/?)")
USUAL_STAGES: Final = StageSettings().changed(
    {"patrol.fleets": 0, "patrol.segment_s": 0.0}
)
"""A run has the fleets and the patrolled segment of its preset (`plan`)."""
TRACK_RELEASE: Final = ("tracking.method", "tracking.noise", "tracking.release")
"""Settings that the name of a release of tracks has: numbers of several stay apart."""
READING_OPTIONS: Final = ("columns", "on_duplicate", "crs", "drop_frozen")
"""Options of reading a file that are part of a run's identity only where given."""
NO_TRACKS: Final = {"tracking.method": "oracle"}  # Settings of a run without tracks.
_PORTS = range(1, 1 << 16)


class _Limit(NamedTuple):
    """The range of a number, and the message for a value outside of it."""

    above: float  # The value must be greater.
    most: float
    message: str  # With {0} for the value and {1} for the maximum.


_LIMITS: Final[Mapping[str, _Limit]] = {
    "scenes": _Limit(1, MOST_SCENES, _SCENES_WRONG),
    "seed": _Limit(-1, inf, "the seed must not be negative, got {0}"),
    "jobs": _Limit(0, MOST_JOBS, "jobs must be at least 1 and at most {1}, got {0}"),
    "cell_timeout_s": _Limit(0, inf, "cell_timeout must be positive, got {0:g} s"),
    "fps": _Limit(0, inf, "fps must be positive, got {0:g}"),
    "utility_scenes": _Limit(
        1, MOST_SCENES, "utility_scenes must be 2 to {1:,}, got {0}"
    ),
    "precision": _Limit(0, nextafter(0.5, 0.0), _PRECISION_WRONG),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """The settings of a run; None stands for the preset's value, or the default.

    Lists, a `Path` as `dataset` and ``stages={"privacy.epsilon_m": 0.5}`` are accepted
    as well.

    Attributes
    ----------
    preset : str
        Axes that a name stands for: ``quick``, ``smoke``, ``paper`` and others.
    dataset : str, Path or data frame, optional
        Name of a known data set, a path, or a frame (pandas, polars).
    format : str, optional
        Format of a user's file, if its name does not tell.
    fps : float, optional
        Frames per second of a user's file with frame numbers.
    unit : str, optional
        Unit of lengths in a user's file: ``m``, ``cm`` or ``mm``.
    sessions : tuple of str
        Paths of files that are sessions of one recording.
    confirming : str, optional
        Name of a session that is left aside, to confirm that people who come back are
        re-identified.
    persistent_ids : bool
        Whether ids are the same people in all sessions.
    columns : str, optional
        Names of a user's columns: ``t=time[ms],id=ped_id,x=pos_x,y=pos_y``.
    on_duplicate : str
        What to do with an id at two places at the same time: ``error``, ``first`` or
        ``mean``.
    crs : str, optional
        ``degrees``: longitude and latitude, projected to local metres. None: metres.
    drop_frozen : float, optional
        Length in s of stretches at exactly the same place that are dropped.
    scenes : int, optional
        All scenes, which are all attacked; at least 2.
    utility_scenes : int, optional
        All scenes; the attacked scenes stay the preset's first.
    precision : float, optional
        Half-width of missed-conflict rates, 0..0.5: finds `utility_scenes`.
    pilot_half_width : float, optional
        The widest half-width in the 250 scenes of the pilot.
    seed : int
        Base seed of every random stream, not negative.
    mechanisms : tuple, optional
        SPECs or objects of plug-ins. They replace the preset's, or add to them:
        ``+NAME``, or all that follows a ``+`` as the first entry. Empty: none.
    predictors : tuple, optional
        Robots' predictors, as above.
    attacks : tuple, optional
        Attacks, as above; LINKER@RECONSTRUCTION among them.
    tasks : tuple of str, optional
        What is to be linked, as above.
    policies : tuple, optional
        Disclosure policies of patrols, as the plug-ins above.
    adversaries : tuple of str
        Adversaries beside blind, informed and oracle.
    stages : StageSettings
        Settings of the stages, from sensing to privacy.
    jobs : int, optional
        Worker processes; None: a core each, where the work is worth it.
    cell_timeout_s : float, optional
        Time in s after which a cell is killed and left out.
    executor : str
        ``local``, or ``dask``: the workers of a Dask cluster.
    scheduler : str, optional
        Address of the cluster's scheduler.
    keep_scores : bool
        Whether to keep the raw scores of all linkers: some hundred MB.
    keep_ids : bool
        Whether the run's files have the recording's own ids, not pseudonyms.
    out : Path or str, optional
        Run folder, by default ``runs/DATASET-PRESET-SEED``.
    fresh : bool
        Whether to replace the run in the folder, not to continue it.

    Raises
    ------
    SettingsError
        For all that the command line refuses, too.
    """

    preset: str = DEFAULT
    dataset: Any = None
    format: str | None = None
    fps: float | None = None
    unit: str | None = None
    sessions: tuple[str, ...] = ()
    confirming: str | None = None
    persistent_ids: bool = False
    columns: str | None = None
    on_duplicate: str = "error"
    crs: str | None = None
    drop_frozen: float | None = None
    scenes: int | None = None
    utility_scenes: int | None = None
    precision: float | None = None
    pilot_half_width: float | None = None
    seed: int = 0
    mechanisms: tuple[str, ...] | None = None
    predictors: tuple[str, ...] | None = None
    attacks: tuple[str, ...] | None = None
    tasks: tuple[str, ...] | None = None
    policies: tuple[str, ...] | None = None
    adversaries: tuple[str, ...] = ()
    stages: StageSettings = field(default_factory=lambda: USUAL_STAGES)
    jobs: int | None = None
    cell_timeout_s: float | None = None
    executor: str = "local"
    scheduler: str | None = None
    keep_scores: bool = False
    keep_ids: bool = False
    out: Path | str | None = None
    fresh: bool = False

    def __post_init__(self) -> None:
        self._convert_types()
        for axis in AXES:
            self.choice(axis)
        _check_known("preset", (self.preset,), PRESETS)
        _check_known("adversary", self.adversaries, ADVERSARIES)
        for name, limit in _LIMITS.items():
            value = getattr(self, name)
            if value is not None and not limit.above < value <= limit.most:
                raise SettingsError(limit.message.format(value, limit.most))
        if self.precision is not None and self.scenes is not None:
            raise SettingsError(
                "--precision finds the number of scenes: leave out --scenes"
            )
        self._check_executor()

    def _check_executor(self) -> None:
        """Refuse an unknown executor, and options of another executor."""
        if self.executor not in ("local", "dask"):
            raise SettingsError(f"the executor is local or dask, got {self.executor!r}")
        is_dask = self.executor == "dask"
        if self.scheduler is not None and not is_dask:
            raise SettingsError("--scheduler ADDRESS goes with --executor dask")
        if is_dask and not self.scheduler:
            raise SettingsError(
                "--executor dask needs --scheduler ADDRESS, as tcp://host:8786; "
                "`dask scheduler` starts one and tells its address"
            )
        if is_dask and not _has_port(str(self.scheduler)):
            raise SettingsError(
                "a scheduler's address ends with its port, as tcp://host:8786; "
                f"got {quoted(self.scheduler)}"
            )
        if is_dask and self.jobs is not None:
            raise SettingsError(
                "--jobs is for --executor local: a cluster has its own workers"
            )
        if is_dask and self.cell_timeout_s is not None:
            raise SettingsError(
                "--cell-timeout is for --executor local: a cluster has its own"
            )

    def _convert_types(self) -> None:
        """Convert lists, mappings and numbers; refuse values of wrong types."""
        given: dict[str, Any] = {
            option.name: getattr(self, option.name) for option in fields(self)
        }
        if isinstance(given["stages"], Mapping):
            given["stages"] = USUAL_STAGES.changed(given["stages"])
        if isinstance(given["columns"], Mapping):
            given["columns"] = ",".join(
                f"{key}={name}" for key, name in given["columns"].items()
            )
        given["sessions"] = tuple(map(str, given["sessions"]))
        for axis in (*AXES, "adversaries"):
            values = given[axis]
            if isinstance(values, str) or not isinstance(values, Iterable | None):
                raise SettingsError(
                    f"{axis} takes a list: write {axis}=[{quoted(values)}]"
                )
            given[axis] = None if values is None else tuple(values)
            if "none" in (given[axis] or ()):
                raise SettingsError(f"'none' is of the command line: write {axis}=[]")
        for name, kind in _KINDS.items():
            if given[name] is not None:
                given[name] = _converted(name, given[name], kind)
        given["dataset"] = _dataset(given["dataset"])
        for name, value in given.items():
            object.__setattr__(self, name, value)

    def changed(self, **options: Any) -> Self:  # noqa: ANN401 - as many types as options
        """Return settings with other options; SettingsError for an unknown option."""
        _check_known("option", options, [field.name for field in fields(self)])
        return replace(self, **options)

    def choice(self, axis: str) -> Choice:
        """Return the choice on an axis, one of `AXES`.

        Raises SettingsError if values that add to the preset's are mixed with values
        that replace them.
        """
        return parse_choice(getattr(self, axis), axis=axis)

    @property
    def n_attacked_scenes(self) -> int:
        """The number of attacked scenes: the first of all."""
        usual = PRESETS[self.preset].scenes if self.scenes is None else self.scenes
        return usual if self.utility_scenes is None else min(usual, self.utility_scenes)

    @property
    def n_all_scenes(self) -> int:
        """The number of all scenes: the robot's utility is measured in every scene."""
        if self.utility_scenes is not None:
            return self.utility_scenes
        return (
            PRESETS[self.preset].utility_scenes if self.scenes is None else self.scenes
        )


def _converted(name: str, value: Any, kind: _Kind) -> Any:  # noqa: ANN401 - any option
    """Return the value of an option as its type; SettingsError for another type."""
    # A truth value is a whole number in Python, but none that is meant.
    is_wrong_bool = isinstance(value, bool) and kind is not _FLAG
    if not isinstance(value, kind.accepted) or is_wrong_bool:
        raise SettingsError(
            f"{name} must be {kind.words.format(name)}; got {quoted(value)}"
        )
    return kind.convert(value)


def _dataset(given: Any) -> Any:  # noqa: ANN401 - frames of any library
    """Return a name or path as text, and a data frame as it is.

    Raises SettingsError for anything else.
    """
    if given is None or isinstance(given, str | Path):
        return None if given is None else str(given)
    if hasattr(given, "to_pandas") or hasattr(given, "__dataframe__"):
        return given
    raise SettingsError(f"dataset must be text or a DataFrame; got {quoted(given)}")


def _check_known(kind: str, names: Iterable[str], known: Collection[str]) -> None:
    for name in names:
        if name not in known:
            hint = (
                did_you_mean(name, known, quote="'") or f"; known: {', '.join(known)}"
            )
            raise SettingsError(f"unknown {kind} {name!r}{hint}")


def patrol_values(stages: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that patrols alone depend on, ``{"stage.key": value}``.

    `stages` are all settings, as `StageSettings.flat` returns them. The network
    forecasts as far as the farthest horizon.
    """
    return {
        name: value
        for name, value in stages.items()
        if name.startswith("patrol.") or name == "conflict.horizons_s"
    }


def tracking_values(stages: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that tracks alone depend on, ``{"stage.key": value}``.

    What is released, by which tracker, is a part of the name of each number instead.
    """
    return {
        name: value
        for name, value in stages.items()
        if name.startswith("tracking.") and name not in TRACK_RELEASE
    }


def _has_port(address: str) -> bool:
    """Whether an address ends with a possible port, or needs none within a process."""
    match = _ADDRESS.fullmatch(address)
    return match is not None and (match["port"] is None or int(match["port"]) in _PORTS)


def parse_stage_values(texts: Iterable[str]) -> dict[str, str]:
    """Return the values of stage settings, written as STAGE.KEY=VALUE, by STAGE.KEY.

    Raises SettingsError for another form.
    """
    values = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise SettingsError(f"--set takes STAGE.KEY=VALUE, got {text!r}")
        values[name.strip()] = value.strip()
    return values
