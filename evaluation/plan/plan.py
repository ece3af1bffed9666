"""The plan of a run, checked before it computes or writes: data, axes and cells."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from attacks.tasks.build import make_task_windows
from attacks.tasks.passages import MOST_SCORES, Passages, find_passages
from attacks.tasks.task_list import FUSED, RETURNS, Task
from attacks.tasks.windows import TaskWindows
from evaluation.plan import fingerprint
from evaluation.plan.axes import Axes, expand_axes
from evaluation.plan.constants import BLOCK_SCENES
from evaluation.plan.consumer import Consumer
from evaluation.plan.environment import check_threads
from evaluation.plan.presets import PRESETS, STRONGEST_ON_SLOW_NOISE
from evaluation.plan.settings import (
    READING_OPTIONS,
    TRACK_RELEASE,
    Settings,
    patrol_values,
    tracking_values,
)
from evaluation.plan.source_digest import ModuleFiles, code_hash, source_digest
from evaluation.plan.workers import choose_jobs
from evaluation.plan.world import OWN_WORLD, World
from isac_track import datasets, plugins
from isac_track.datasets import Dataset, crowd
from isac_track.errors import (
    DataError,
    PluginError,
    SettingsError,
    did_you_mean,
    error_text,
)
from isac_track.place import placed
from isac_track.plugins import Plugin
from isac_track.scenes import FEW_PEOPLE, Cut, cut, no_tracks, with_horizons
from isac_track.types import Tracks

_SCENE_AXES = ("predictors", "attacks", "tasks", "policies")
"""Axes whose values need scenes or windows of long tracks, but for the task returns."""
_OTHER_READING_OPTIONS = ("format", "fps", "unit", "sessions", "persistent_ids")


@dataclass(frozen=True, eq=False, slots=True)
class Unit:
    """The cells of one level, section and world, in one block or task; see the package."""

    # Tracking, a task's name, patrol, returns, reconstruction or sharing.
    section: str
    block: int  # Of scenes; 0 for a linkage task.
    mechanism: Plugin
    key: str  # A digest of all that its rows depend on, except the consumers.
    code_digests: Mapping[str, str]  # By module, of the code that computes it.
    consumers: Mapping[str, Consumer]  # By their keys.

    @property
    def world(self) -> World:
        """Its world, which all consumers share."""
        return next(iter(self.consumers.values())).world


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """A run that is ready to start: everything is checked, nothing is written."""

    settings: Settings
    dataset: Dataset
    recorded: Tracks  # All its tracks, placed where the network senses them.
    scene_tracks: Cut  # Those long enough for scenes, cut.
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
    fitted = _fit_to_data(run_axes, settings, dataset)
    run_axes, identity = fitted.axes, _identity(settings, dataset)
    units, code_digests = _units(run_axes, settings, identity=identity)
    jobs = choose_jobs(run_axes, settings)
    in_workers = settings.cell_timeout_s is not None or settings.scheduler is not None
    if in_workers or jobs > 1 or fingerprint.has_user_plugins(run_axes):
        _check_sendable(units)
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
        units=units,
        code_digests=code_digests,
        task_windows=fitted.task_windows,
        model_task_windows=_model_task_windows(
            run_axes, settings, fitted.task_windows, fitted.recorded
        ),
        passages=fitted.passages,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _FittedData:
    """The data of a run as its parts read them, and the axes that the data allow."""

    axes: Axes
    recorded: Tracks
    scene_tracks: Cut
    task_windows: tuple[TaskWindows, ...]
    passages: Passages | None


def _fit_to_data(run_axes: Axes, settings: Settings, dataset: Dataset) -> _FittedData:
    """Return the data of a run, and its axes without parts of too few people.

    Raises DataError if a user has named such a part.
    """
    recorded = placed(dataset.tracks, settings=settings.stages)
    run_axes, passages = _axes_with_passages(run_axes, settings, recorded)
    run_axes, tracks = _cut_for_scenes(run_axes, settings, recorded)
    if run_axes.horizons_s:
        # Horizons for which the recording has too few long tracks are left out.
        tracks = with_horizons(tracks, recorded, settings=settings.stages)
        run_axes = replace(run_axes, horizons_s=tuple(tracks.further))
    task_windows, skipped = _make_windows(run_axes, settings, dataset, recorded)
    tasks = {windows.task for windows in task_windows}
    run_axes = replace(
        run_axes,
        links=tuple((task, link) for task, link in run_axes.links if task in tasks),
        skipped={**run_axes.skipped, **skipped},
    )
    return _FittedData(run_axes, recorded, tracks, task_windows, passages)


def _axes_with_passages(
    run_axes: Axes, settings: Settings, recorded: Tracks
) -> tuple[Axes, Passages | None]:
    """Return the axes, and the passages of people who come back if there are any.

    DataError without any if the user has named the task or a session to confirm, or for
    a session of another name.
    """
    is_named = RETURNS.name in settings.choice("tasks").named
    if not run_axes.links_returns:
        if settings.confirming is not None:
            raise SettingsError(
                "--confirming is about the task returns, which the run leaves out; add"
                " --task +returns"
            )
        return run_axes, None
    try:
        passages = find_passages(recorded, most_scores=MOST_SCORES, seed=settings.seed)
    except DataError as error:
        if is_named or settings.confirming is not None:
            raise DataError(f"task {RETURNS.name}: {error}") from None
        skipped = dict(run_axes.skipped)
        if recorded.session is not None:  # Of a single session: no notice.
            skipped[RETURNS.name] = f"task {RETURNS.name}: {error}"
        return replace(run_axes, links_returns=False, skipped=skipped), None
    _check_confirming(settings.confirming, passages)
    if not passages.not_drawn:
        return run_axes, passages
    name = f"{passages.not_drawn:,} people of task {RETURNS.name}"
    why = f"linking all takes over {MOST_SCORES:,} scores at a level"
    return replace(
        run_axes, skipped={**run_axes.skipped, name: f"{name}: {why}"}
    ), passages


def _check_confirming(name: str | None, passages: Passages) -> None:
    """Raise SettingsError if no session has this name.

    DataError if nobody walks in two of the others: these alone decide.
    """
    if name is None:
        return
    if name not in passages.sessions:
        hint = did_you_mean(name, passages.sessions, quote="'")
        raise SettingsError(
            f"--confirming: no session is called {name!r}"
            f"{hint or '; sessions: ' + ', '.join(passages.sessions)}"
        )
    others = passages.session != passages.sessions.index(name)
    pairs = np.unique(np.stack([passages.person, passages.session])[:, others], axis=1)
    if not (np.bincount(pairs[0]) > 1).any():
        raise DataError(
            f"without session {name} nobody walks in two: --confirming takes a session"
            " beside at least two others"
        )


def _cut_for_scenes(
    run_axes: Axes, settings: Settings, recorded: Tracks
) -> tuple[Axes, Cut]:
    """Return the axes and the tracks of scenes.

    With fewer than `FEW_PEOPLE` tracks, which decide nothing, a run links people who
    come back alone. If nobody does, or the user has named anything that needs scenes,
    it has scenes all the same; DataError if there are fewer tracks than a scene needs.
    """
    needs_scenes = not run_axes.links_returns or _names_scenes(settings)
    try:
        tracks = cut(recorded, settings=settings.stages, seed=settings.seed)
    except DataError:
        if needs_scenes:
            raise
    else:
        if needs_scenes or len(tracks) >= FEW_PEOPLE:
            return run_axes, tracks
    no_track = no_tracks(recorded, settings=settings.stages)
    return run_axes.without_scenes(_why_no_scenes(no_track, settings)), no_track


def _names_scenes(settings: Settings) -> bool:
    """Whether the user has named anything that needs scenes, or their number."""
    named = {axis: settings.choice(axis).named for axis in _SCENE_AXES}
    # These run in the task of people who come back.
    for axis, run_there in (("tasks", (RETURNS.name,)), ("attacks", FUSED)):
        named[axis] = tuple(name for name in named[axis] if name not in run_there)
    sizes = (settings.scenes, settings.utility_scenes)
    return any(named.values()) or sizes != (None, None)


def _why_no_scenes(tracks: Cut, settings: Settings) -> str:
    """Return how many tracks are long enough, in short; `tracks` is empty."""
    # None of the long tracks was cut: all of them lack a future.
    n_long, n_recorded = tracks.no_future, tracks.no_future + tracks.too_short
    least_s = settings.stages.resample.min_duration_s
    if n_long >= FEW_PEOPLE:
        return f"too few of {n_long:,} tracks of {least_s:g} s cover the horizon"
    return f"{n_long:,} of {n_recorded:,} tracks last {least_s:g} s"


def _make_windows(
    run_axes: Axes, settings: Settings, dataset: Dataset, recorded: Tracks
) -> tuple[tuple[TaskWindows, ...], dict[str, str]]:
    """Return the sessions of each task, and the tasks of too few people with reasons.

    Raises DataError if a user has named such a task.
    """
    task_windows, skipped = [], dict[str, str]()
    for task in run_axes.tasks:
        try:
            task_windows.append(
                make_task_windows(
                    task, tracks=recorded, stages=settings.stages, seed=settings.seed
                )
            )
        except DataError as error:
            if task.name in settings.choice("tasks").named:
                raise
            if task.links_returning_people and dataset.tracks.session is None:
                continue  # a recording of a single session: no notice
            skipped[task.name] = str(error)
    return tuple(task_windows), skipped


def _model_task_windows(
    run_axes: Axes,
    settings: Settings,
    task_windows: Iterable[TaskWindows],
    recorded: Tracks,
) -> tuple[TaskWindows, ...]:
    """Return the sessions of tasks that are linked in model worlds: fewer people."""
    if not any(run_axes.linked_mechanisms_by_world.values()):
        return ()
    most = min(
        PRESETS[settings.preset].model_people, settings.stages.linkage.most_people
    )
    stages = settings.stages.changed({"linkage.most_people": most})
    return tuple(
        make_task_windows(
            windows.task, tracks=recorded, stages=stages, seed=settings.seed
        )
        for windows in task_windows
        if _is_linked_in_models(windows.task)
    )


def _is_linked_in_models(task: Task) -> bool:
    """Whether a model's walks suit a task: the same steps, without the scene."""
    return task.shows_same_steps and not task.shows_scene


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
    if not plan.axes.why_no_scenes and not settings.choice("attacks").replaces:
        stronger_adversaries = PRESETS[settings.preset].stronger_adversaries
    if not stronger_adversaries:
        wanted = set()
    run_axes = Axes(
        mechanisms=tuple(
            level for level in plan.axes.mechanisms if level.spec in wanted
        ),
        predictors=(),
        attacks=(plugins.parse("attacks", STRONGEST_ON_SLOW_NOISE)[0],),
        adversaries=stronger_adversaries,
        has_only_stronger=True,
    )
    units, code_digests = _units(run_axes, settings, identity=plan.identity)
    return replace(
        plan, axes=run_axes, units=units, code_digests=code_digests, task_windows=()
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


class _Crossing(NamedTuple):
    """Mechanisms, consumers and blocks that are all combined with each other."""

    mechanisms: tuple[Plugin, ...]
    consumers: tuple[Consumer, ...]
    blocks: Iterable[int]


def _crossings(run_axes: Axes, settings: Settings) -> list[_Crossing]:
    """Return the products whose parts are units: scenes and tasks, in all worlds."""
    n_attacked = -(-settings.n_attacked_scenes // BLOCK_SCENES)
    n_blocks = -(-settings.n_all_scenes // BLOCK_SCENES)
    attacked_blocks, all_blocks = range(n_attacked), range(n_blocks)
    utility = tuple(
        consumer
        for consumer in run_axes.consumers
        if consumer.spec in run_axes.utility_predictors
    )
    crossings = [
        _Crossing(run_axes.mechanisms, run_axes.consumers, attacked_blocks),
        _Crossing(run_axes.mechanisms, utility, all_blocks[n_attacked:]),
    ]
    for task in run_axes.tasks:
        consumers = run_axes.task_consumers(task)
        crossings.append(_Crossing(run_axes.linked_mechanisms, consumers, (0,)))
    for world, mechanisms in run_axes.mechanisms_by_world.items():
        consumers = run_axes.consumers_in(world)
        crossings.append(_Crossing(mechanisms, consumers, attacked_blocks))
    for horizon_s in run_axes.horizons_s:
        robots = run_axes.robots_at(horizon_s)
        crossings.append(_Crossing(run_axes.mechanisms, robots, all_blocks))
    crossings.append(
        _Crossing(run_axes.linked_mechanisms, run_axes.return_consumers, (0,))
    )
    worlds = [OWN_WORLD, *(World(horizon_s=seconds) for seconds in run_axes.horizons_s)]
    crossings += [
        _Crossing(run_axes.patrol_mechanisms, run_axes.patrol_consumers(world), (0,))
        for world in worlds
        if run_axes.patrol_mechanisms
    ]
    crossings += [
        _Crossing(run_axes.track_mechanisms, run_axes.track_consumers(world), (0,))
        for world in worlds
        if run_axes.track_mechanisms
    ]
    for world, mechanisms in run_axes.linked_mechanisms_by_world.items():
        for task in filter(_is_linked_in_models, run_axes.tasks):
            consumers = run_axes.task_consumers_in(world, task)
            crossings.append(_Crossing(mechanisms, consumers, (0,)))
    return crossings


@dataclass(frozen=True, slots=True)
class _CodeRead:
    """What a plan has read of the code: modules' digests, and the files behind them."""

    digests: dict[str, str]
    files: ModuleFiles


def _units(
    run_axes: Axes, settings: Settings, *, identity: Mapping[str, Any]
) -> tuple[tuple[Unit, ...], dict[str, str]]:
    """Return the units of work, and the digest of every module that they depend on."""
    code_read = _CodeRead({}, {})
    units = []
    for mechanisms, consumers, blocks in _crossings(run_axes, settings):
        by_section = _consumers_by_section(consumers, settings, code_read)
        for mechanism, section in product(mechanisms, by_section):
            code = _code_digests(section, mechanism, code_read=code_read)
            level_consumers = {
                key: consumer
                for key, consumer in by_section[section].items()
                if run_axes.reads_mechanism(consumer, mechanism)
            }
            key_parts = [BLOCK_SCENES, mechanism.spec, mechanism.origin]
            key_parts += filter(None, [mechanism.digest])
            key_parts += code.values()
            key_parts += _own_settings(section, settings)
            for block in blocks if level_consumers else ():
                key = fingerprint.digest([identity, section, block, *key_parts])
                units.append(
                    Unit(section, block, mechanism, key, code, level_consumers)
                )
    return tuple(units), code_read.digests


def _own_settings(section: str, settings: Settings) -> list[Any]:
    """Return the settings that only the cells of a section depend on."""
    values = settings.stages.flat()
    if section == fingerprint.PATROL:
        return [patrol_values(values)]
    if section == fingerprint.TRACKING:
        return [patrol_values(values), tracking_values(values)]
    if section == fingerprint.RETURNS and settings.confirming is not None:
        return [settings.confirming]
    return []


def _consumers_by_section(
    consumers: Iterable[Consumer], settings: Settings, code_read: _CodeRead
) -> dict[str, dict[str, Consumer]]:
    """Return consumers by section and key; `code_read` grows, as in `_code_digests`."""
    by_section: dict[str, dict[str, Consumer]] = {}
    for consumer in consumers:
        key = fingerprint.consumer_key(
            consumer,
            code=_code_digests("", *consumer.plugins, code_read=code_read).values(),
            keep_scores=settings.keep_scores,
        )
        by_section.setdefault(_section(consumer), {})[key] = consumer
    return by_section


def _code_digests(
    section: str, *used_plugins: Plugin, code_read: _CodeRead
) -> dict[str, str]:
    """Return the digests of the modules of a section and of plug-ins, by module.

    `code_read` holds those that are known by now; new digests are added to it.
    """
    modules = fingerprint.key_modules(section, *used_plugins)
    digests = code_read.digests
    for module in modules:
        if module not in digests:
            digest = source_digest(module, known=code_read.files)
            digests[module] = digest[:16]
    return {module: digests[module] for module in modules}


def _section(consumer: Consumer) -> str:
    """Return the section of a consumer.

    It is tracking, a task's name, patrol, returns, reconstruction or sharing.
    """
    if consumer.reads_tracks:
        return fingerprint.TRACKING
    if consumer.task:
        return consumer.task
    if consumer.policy:
        return fingerprint.PATROL
    if consumer.kind in {"attack", "bound"}:
        return fingerprint.RECONSTRUCTION
    return fingerprint.SHARING


def _check_sendable(units: Iterable[Unit]) -> None:
    """Raise PluginError for a plug-in that cannot be sent to another process."""
    from cloudpickle import dumps  # noqa: PLC0415 - only with workers

    plugins_by_spec: dict[str, Plugin] = {}
    for unit in units:
        for consumer in unit.consumers.values():
            for plugin in (unit.mechanism, *consumer.plugins):
                plugins_by_spec[plugin.spec] = plugin
    for plugin in plugins_by_spec.values():
        try:
            dumps(plugin)
        except Exception as error:  # noqa: BLE001 - a user's __reduce__ may do anything
            raise PluginError(
                f"{plugin.spec} cannot be sent to a worker ({error_text(error)}); "
                "leave out what cannot be pickled"
            ) from None
