"""What a run is asked for: every option of the command line and of the notebook, checked."""

import os
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from math import inf, nextafter
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final, Self

from evaluation.plan.choices import Choice, choice_of
from evaluation.plan.constants import MOST_JOBS, MOST_SCENES
from evaluation.plan.presets import DEFAULT, PRESETS
from isac_track.config import StageSettings
from isac_track.errors import SettingsError, did_you_mean, quoted
from isac_track.protocols import ADVERSARIES

AXES: Final = ("mechanisms", "predictors", "attacks", "tasks")
_KINDS: dict[str, tuple[Any, type, str]] = {
    **dict.fromkeys(
        ("scenes", "utility_scenes", "seed", "jobs"),
        (Integral, int, "a whole number, as {}=40"),
    ),
    **dict.fromkeys(
        ("fps", "cell_timeout_s", "precision", "drop_frozen"),
        (Real, float, "a number, as {}=2.5"),
    ),
    **dict.fromkeys(("preset", "format", "executor", "scheduler"), (str, str, "text")),
    **dict.fromkeys(("unit", "columns", "on_duplicate", "crs"), (str, str, "text")),
    "out": ((str, Path), Path, "the path of a folder"),
}
"""What an option must be, what it becomes, and how that is said."""
_SCENES_WRONG = (
    "a run needs at least 2 scenes (one of each label) and at most {1:,}, got {0}"
)
_PRECISION_WRONG = (
    "--precision is the half-width of a missed-conflict rate's interval, between 0 and"
    " 0.5 (0.01: +- 1 %), got {0:g}"
)
_ADDRESS = re.compile(r"(inproc://.+)|(([\w-]+://)?[^/\s]+:(?P<port>[0-9]{1,5})/?)")
_PORTS = range(1, 1 << 16)
_LIMITS: dict[str, tuple[float, float, str]] = {
    "scenes": (1, MOST_SCENES, _SCENES_WRONG),
    "seed": (-1, inf, "the seed must not be negative, got {0}"),
    "jobs": (0, MOST_JOBS, "jobs must be at least 1 and at most {1}, got {0}"),
    "cell_timeout_s": (0, inf, "cell_timeout must be positive, got {0:g} s"),
    "fps": (0, inf, "fps must be positive, got {0:g}"),
    "utility_scenes": (1, MOST_SCENES, "utility_scenes must be 2 to {1:,}, got {0}"),
    "precision": (0, nextafter(0.5, 0.0), _PRECISION_WRONG),
}
"""Above and up to what a number must be, and how that is said."""


@dataclass(frozen=True, slots=True)
class Settings:
    """A whole run. None means: as the preset, the lookup or the default folder says.

    Lists, a `Path` as `dataset` and `stages={"privacy.epsilon_m": 0.5}` are taken as
    well. SettingsError for what the command line refuses, too.
    """

    preset: str = DEFAULT
    # Name of a known data set, a path, or a data frame (pandas, polars).
    dataset: Any = None
    format: str | None = None
    fps: float | None = None
    unit: str | None = None  # Of lengths in a file of one's own: m, cm or mm.
    sessions: tuple[str, ...] = ()  # Paths of files that are sessions of one recording.
    persistent_ids: bool = False  # Whether ids are the same people in all sessions.
    # Of a table of one's own: t=time[ms],id=ped_id,x=pos_x,y=pos_y.
    columns: str | None = None
    # Or first, or mean: of an id at two places at one time.
    on_duplicate: str = "error"
    # Or degrees: longitude and latitude, projected to local metres.
    crs: str | None = None
    # Stretches of so many s at exactly one place are dropped.
    drop_frozen: float | None = None
    scenes: int | None = None  # Attacked ones, and all.
    # All, where the attacked ones stay the preset's first.
    utility_scenes: int | None = None
    # Half-width of missed-conflict rates: finds `utility_scenes`.
    precision: float | None = None
    # The widest in the 250 scenes that found them.
    pilot_half_width: float | None = None
    seed: int = 0
    # These replace the preset's, or add to them: `+NAME`, or all that follows a "+" of
    # its own. Empty: no predictor, no attack, nothing is linked.
    mechanisms: tuple[str, ...] | None = None  # SPECs, or objects of plug-ins.
    predictors: tuple[str, ...] | None = None
    attacks: tuple[str, ...] | None = None  # SPECs, LINKER@RECONSTRUCTION among them.
    tasks: tuple[str, ...] | None = None
    adversaries: tuple[str, ...] = ()  # Beside blind, informed and oracle.
    stages: StageSettings = field(default_factory=StageSettings)
    # Worker processes; None: the cores, where the work is worth it.
    jobs: int | None = None
    # A cell that takes longer is killed and left out.
    cell_timeout_s: float | None = None
    executor: str = "local"  # Or dask: the workers of a Dask cluster.
    scheduler: str | None = None  # Address of the cluster's scheduler.
    keep_scores: bool = False  # Of everybody who links, raw: some hundred MB.
    # The recording's own ids in the run's files, not pseudonyms.
    keep_ids: bool = False
    out: Path | str | None = None
    fresh: bool = False

    def __post_init__(self) -> None:
        self._check_types()
        for axis in AXES:
            self.choice(axis)
        _check_known("preset", (self.preset,), PRESETS)
        _check_known("adversary", self.adversaries, ADVERSARIES)
        for name, (above, most, wrong) in _LIMITS.items():
            value = getattr(self, name)
            if value is not None and not above < value <= most:
                raise SettingsError(wrong.format(value, most))
        if self.precision is not None and self.scenes is not None:
            raise SettingsError(
                "--precision finds the number of scenes: leave out --scenes"
            )
        self._check_executor()

    def _check_executor(self) -> None:
        """Refuse an executor that is unknown, and options that are another's."""
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

    def _check_types(self) -> None:
        """Refuse what only Python lets one write, and take lists and mappings for what they are."""
        given: dict[str, Any] = {
            one.name: getattr(self, one.name) for one in fields(self)
        }
        if isinstance(given["stages"], Mapping):
            given["stages"] = StageSettings().changed(given["stages"])
        if isinstance(given["columns"], Mapping):
            given["columns"] = ",".join(
                f"{key}={name}" for key, name in given["columns"].items()
            )
        given["sessions"] = tuple(map(str, given["sessions"]))
        for axis in (*AXES, "adversaries"):
            some = given[axis]
            if isinstance(some, str) or not isinstance(some, Iterable | None):
                raise SettingsError(
                    f"{axis} takes a list: write {axis}=[{quoted(some)}]"
                )
            given[axis] = None if some is None else tuple(some)
            if "none" in (given[axis] or ()):
                raise SettingsError(f"'none' is of the command line: write {axis}=[]")
        for name, (kind, becomes, what) in _KINDS.items():
            value = given[name]
            if value is not None:
                if not isinstance(value, kind) or isinstance(value, bool):
                    raise SettingsError(
                        f"{name} must be {what.format(name)}; got {quoted(value)}"
                    )
                given[name] = becomes(value)
        given["dataset"] = _dataset(given["dataset"])
        for name, value in given.items():
            object.__setattr__(self, name, value)

    def changed(self, **options: Any) -> Self:  # noqa: ANN401 - as many types as options
        """Return settings with other options; SettingsError if one is unknown."""
        _check_known("option", options, [one.name for one in fields(self)])
        return replace(self, **options)

    def choice(self, axis: str) -> Choice:
        """Return the choice on an axis: mechanisms, predictors, attacks or tasks.

        SettingsError if values that add to the preset's are mixed with values that
        replace them.
        """
        return choice_of(getattr(self, axis), axis=axis)

    @property
    def n_scenes(self) -> int:
        """Scenes of the run that are attacked: the first of all."""
        usual = PRESETS[self.preset].scenes if self.scenes is None else self.scenes
        return usual if self.utility_scenes is None else min(usual, self.utility_scenes)

    @property
    def n_utility_scenes(self) -> int:
        """All scenes of the run: what noise costs the robot is read in every one."""
        if self.utility_scenes is not None:
            return self.utility_scenes
        return (
            PRESETS[self.preset].utility_scenes if self.scenes is None else self.scenes
        )


def _dataset(given: Any) -> Any:  # noqa: ANN401 - frames of any library
    """Return a name or path as text, and a data frame as it is; SettingsError for all else."""
    if given is None or isinstance(given, str | Path):
        return None if given is None else str(given)
    if hasattr(given, "to_pandas") or hasattr(given, "__dataframe__"):
        return given
    raise SettingsError(f"dataset must be text or a DataFrame; got {quoted(given)}")


def _check_known(what: str, names: Iterable[str], known: Collection[str]) -> None:
    for name in names:
        if name not in known:
            hint = (
                did_you_mean(name, known, quote="'") or f"; known: {', '.join(known)}"
            )
            raise SettingsError(f"unknown {what} {name!r}{hint}")


def check_drawing() -> None:
    """Raise SettingsError if matplotlib would refuse to be imported: before a run, not after it."""
    if (
        "MPLBACKEND" in os.environ
    ):  # else there is nothing to ask, and the import takes its time
        try:
            import_module("matplotlib")
        except ValueError:
            raise SettingsError(
                f"matplotlib knows no backend {os.environ['MPLBACKEND']!r}; unset"
                " MPLBACKEND: figures need none"
            ) from None


def _has_port(address: str) -> bool:
    """Whether an address ends with a port that there can be, or needs none within a process."""
    match = _ADDRESS.fullmatch(address)
    return match is not None and (match["port"] is None or int(match["port"]) in _PORTS)


def check_threads() -> None:
    """Raise SettingsError if numba would refuse to be imported: before a run, not within it."""
    text = os.environ.get("NUMBA_NUM_THREADS", "1")
    try:
        fits = int(text) > 0
    except ValueError:  # numba would warn, with a traceback
        fits = False
    if not fits:
        raise SettingsError(
            f"NUMBA_NUM_THREADS must be at least 1, got {text[:40]!r}; unset it"
        )
