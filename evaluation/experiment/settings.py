"""What a run is asked for: every option of the command line and of the notebook, checked."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING

from evaluation.experiment.constants import MOST_SCENES
from evaluation.experiment.presets import PRESETS
from isac_track.config import StageSettings
from isac_track.errors import SettingsError, did_you_mean

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Settings:
    """A whole run. None means: as the preset, the lookup or the default folder says."""

    preset: str = "paper"
    dataset: str | None = None
    """Name of a known data set, or a path."""
    format: str | None = None
    fps: float | None = None
    unit: str | None = None
    """Of lengths in a file of one's own: m, cm or mm."""
    scenes: int | None = None
    """Attacked ones, and all."""
    seed: int = 0
    mechanisms: tuple[str, ...] | None = None
    """SPECs; they replace the preset's."""
    predictors: tuple[str, ...] | None = None
    """SPECs; they replace the preset's. Empty: no predictor."""
    attacks: tuple[str, ...] | None = None
    """SPECs, LINKER@RECONSTRUCTION among them; they replace the preset's. Empty: no attack."""
    tasks: tuple[str, ...] | None = None
    """Linkage tasks; they replace the preset's. Empty: nothing is linked."""
    stages: StageSettings = field(default_factory=StageSettings)
    jobs: int | None = None
    """Worker processes; None: as many as there are cores where the work is worth it."""
    cell_timeout_s: float | None = None
    """Longest time that a cell may take; one that takes longer is killed and left out."""
    executor: str = "local"
    """Or dask: the workers of a Dask cluster."""
    scheduler: str | None = None
    """Address of the cluster's scheduler."""
    keep_scores: bool = False
    """Whether the raw scores of everybody who links stay in the folder: some hundred MB."""
    out: Path | str | None = None
    fresh: bool = False

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            hint = did_you_mean(self.preset, PRESETS, quote="'") or f"; known: {', '.join(PRESETS)}"
            raise SettingsError(f"unknown preset {self.preset!r}{hint}")
        if self.scenes is not None and not 2 <= self.scenes <= MOST_SCENES:  # noqa: PLR2004 - one of each label
            raise SettingsError(
                f"a run needs at least 2 scenes (one of each label) and at most {MOST_SCENES:,}, "
                f"got {self.scenes}"
            )
        if self.seed < 0:
            raise SettingsError(f"the seed must not be negative, got {self.seed}")
        if self.jobs is not None and self.jobs < 1:
            raise SettingsError(f"jobs must be at least 1, got {self.jobs}")
        if self.cell_timeout_s is not None and not self.cell_timeout_s > 0:
            raise SettingsError(f"cell_timeout must be positive, got {self.cell_timeout_s:g} s")
        if self.fps is not None and not self.fps > 0:
            raise SettingsError(f"fps must be positive, got {self.fps:g}")
        self._check_executor()

    def _check_executor(self) -> None:
        if self.executor not in ("local", "dask"):
            raise SettingsError(f"the executor is local or dask, got {self.executor!r}")
        if self.executor == "local":
            if self.scheduler is not None:
                raise SettingsError("--scheduler ADDRESS goes with --executor dask")
            return
        if not self.scheduler:
            raise SettingsError(
                "--executor dask needs --scheduler ADDRESS, as tcp://host:8786; "
                "`dask scheduler` starts one and tells its address"
            )
        if self.jobs is not None:
            raise SettingsError("--jobs is of --executor local: a cluster has the workers it has")
        if self.cell_timeout_s is not None:
            raise SettingsError(
                "--cell-timeout is of --executor local: limits of a cluster are its own"
            )

    @property
    def n_scenes(self) -> int:
        """Scenes of the run that are attacked: the first of all."""
        return PRESETS[self.preset].scenes if self.scenes is None else self.scenes

    @property
    def n_utility_scenes(self) -> int:
        """All scenes of the run: what noise costs the robot is read in every one."""
        return PRESETS[self.preset].utility_scenes if self.scenes is None else self.scenes


def check_drawing() -> None:
    """Raise SettingsError if matplotlib would refuse to be imported: before a run, not after it."""
    if "MPLBACKEND" in os.environ:  # else there is nothing to ask, and the import takes its time
        try:
            import_module("matplotlib")
        except ValueError:
            raise SettingsError(
                f"matplotlib knows no backend {os.environ['MPLBACKEND']!r}; unset MPLBACKEND: "
                "figures need none"
            ) from None
