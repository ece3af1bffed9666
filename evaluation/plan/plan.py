"""The plan of a run, checked before it computes or writes: data, axes and cells."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from attacks.tasks.passages import Passages
from attacks.tasks.windows import TaskWindows
from evaluation.plan.adversaries import Adversaries
from evaluation.plan.axes import Axes, expand_axes
from evaluation.plan.consumer import Consumer
from evaluation.plan.environment import check_threads
from evaluation.plan.fitted_data import fit_to_data
from evaluation.plan.presets import PRESETS, STRONGEST_ON_SLOW_NOISE
from evaluation.plan.scene_axes import SceneAxes
from evaluation.plan.settings import (
    READING_OPTIONS,
    TRACK_RELEASE,
    Settings,
    patrol_values,
    tracking_values,
)
from evaluation.plan.source_digest import code_hash
from evaluation.plan.units import Unit, check_sendable, plan_units
from evaluation.plan.user_plugins import has_user_plugins
from evaluation.plan.workers import choose_jobs
from isac_track import datasets, plugins
from isac_track.datasets import Dataset, crowd
from isac_track.plugins import Plugin
from isac_track.scenes import Cut
from isac_track.types import Tracks

_OTHER_READING_OPTIONS = ("format", "fps", "unit", "sessions", "persistent_ids")


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """A run that is ready to start: everything is checked, nothing is written."""

    settings: Settings
    dataset: Dataset
    recorded: Tracks  # All its tracks, placed where the network senses them.
    scene_tracks: Cut  # Those long enough for scenes, split into history and future.
    axes: Axes
    identity: dict[str, Any]
    code_hash: str  # Version of the code that computes the cells.
    jobs: int  # Worker processes.
    out: Path
    units: tuple[Unit, ...]
    code_digests: Mapping[str, str]  # Digest by module, of the code of every plug-in.
    task_windows: tuple[TaskWindows, ...]  # Of each linkage task.
    model_task_windows: tuple[TaskWindows, ...] = ()  # The same for walks of a model.
    passages: Passages | None = None  # Of people who come back, if any are linked.

    @property
    def n_cells(self) -> int:
        """Cells of the run, finished or not."""
        return sum(len(unit.consumers) for unit in self.units)

    @property
    def mechanism_consumers(self) -> tuple[tuple[Plugin, Consumer], ...]:
        """Every mechanism with each of its consumers: further blocks have no others."""
        first = (unit for unit in self.units if unit.block == 0)
        return tuple(
            (unit.mechanism, consumer)
            for unit in first
            for consumer in unit.consumers.values()
        )


def make_plan(settings: Settings, *, dataset: Dataset | None = None) -> Plan:
    """Check the settings, load the data set unless it is given, and lay out the cells.

    Raises IsacTrackError for anything that a user can mend.
    """
    check_threads()
    settings = _with_patrols(settings)
    run_axes = expand_axes(settings)
    options = (*_OTHER_READING_OPTIONS, *READING_OPTIONS)
    reading = {name: getattr(settings, name) for name in options}
    dataset = dataset or datasets.load(settings.dataset, **reading)
    fitted = fit_to_data(run_axes, settings, dataset)
    run_axes, identity = fitted.axes, _identity(settings, dataset)
    planned = plan_units(run_axes, settings, identity=identity)
    jobs = choose_jobs(run_axes, settings)
    in_workers = settings.cell_timeout_s is not None or settings.scheduler is not None
    if in_workers or jobs > 1 or has_user_plugins(run_axes):
        check_sendable(planned.units)
    out = Path("runs") / f"{dataset.name}-{settings.preset}-{settings.seed}"
    return Plan(
        settings=settings,
        dataset=dataset,
        recorded=fitted.recorded,
        scene_tracks=fitted.scene_tracks,
        axes=run_axes,
        identity=identity,
        code_hash=code_hash(),
        jobs=jobs,
        out=out if settings.out is None else Path(settings.out),
        units=planned.units,
        code_digests=planned.code_digests,
        task_windows=fitted.task_windows,
        model_task_windows=fitted.model_task_windows,
        passages=fitted.passages,
    )


def _identity(settings: Settings, dataset: Dataset) -> dict[str, Any]:
    """Return all that every cell of a run depends on; a folder has one identity."""
    # A task always uses the bundled crowd.
    bundled = b"".join(
        crowd.bundled_path(session).read_bytes() for session in crowd.FILES
    )
    identity: dict[str, Any] = {
        "dataset": dataset.name,
        "sha256": dataset.sha256,
        "format": dataset.format,
        "fps": settings.fps,
        "seed": settings.seed,
        "scenes": settings.n_attacked_scenes,
        "crowd": hashlib.sha256(bundled).hexdigest()[:16],
        **settings.stages.flat(),
    }
    # Axes: another horizon or tracker adds cells to a folder and changes no others, and
    # other patrols change those of patrols alone.
    values = settings.stages.flat()
    for name in (*patrol_values(values), *tracking_values(values), *TRACK_RELEASE):
        del identity[name]
    # Only what differs from the default: an option that is new keeps earlier folders.
    if settings.unit is not None:
        identity["unit"] = settings.unit
    if settings.keep_ids:
        identity["ids"] = "kept"
    if settings.persistent_ids:
        identity["persistent_ids"] = True
    identity |= _changed_reading_options(settings)
    if settings.n_all_scenes != settings.n_attacked_scenes:
        identity["scenes_utility"] = settings.n_all_scenes
    return identity


def plan_stronger(plan: Plan, *, specs: Iterable[str]) -> Plan:
    """Return a plan of the preset's stronger adversaries against some levels of a run.

    Its cells have the keys of the same run with `--adversary` and `--attack ou_rts`.
    The plan has no units without levels, or if the user named the attacks.
    """
    settings, wanted = plan.settings, set(specs)
    stronger_adversaries: tuple[str, ...] = ()
    has_scenes = not plan.axes.scenes.why_left_out
    if has_scenes and not settings.choice("attacks").replaces:
        stronger_adversaries = PRESETS[settings.preset].stronger_adversaries
    if not stronger_adversaries:
        wanted = set()
    run_axes = Axes(
        tuple(plugin for plugin in plan.axes.mechanisms if plugin.spec in wanted),
        scenes=SceneAxes(
            attacks=plugins.parse("attacks", STRONGEST_ON_SLOW_NOISE),
            adversaries=Adversaries(stronger_adversaries, has_only_further=True),
        ),
    )
    planned = plan_units(run_axes, settings, identity=plan.identity)
    return replace(
        plan,
        axes=run_axes,
        units=planned.units,
        code_digests=planned.code_digests,
        task_windows=(),
    )


def _changed_reading_options(settings: Settings) -> dict[str, Any]:
    """Return the options of reading a file that differ from their defaults."""
    usual = Settings()
    values = {name: getattr(settings, name) for name in READING_OPTIONS}
    return {
        name: value for name, value in values.items() if value != getattr(usual, name)
    }


def _with_patrols(settings: Settings) -> Settings:
    """Return settings with the preset's patrols, where they name no others."""
    preset, patrol = PRESETS[settings.preset], settings.stages.patrol
    values = {
        "patrol.fleets": patrol.fleets or preset.fleets,
        "patrol.segment_s": patrol.segment_s or preset.patrol_segment_s,
    }
    return settings.changed(stages=settings.stages.changed(values))
