"""What a run will do, checked before anything is computed or written: data, axes and cells."""

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from attacks.tasks.build import sessions_of
from attacks.tasks.sessions import Sessions
from evaluation.plan import fingerprint
from evaluation.plan.axes import Axes, Consumer, axes, jobs_of
from evaluation.plan.constants import BLOCK_SCENES
from evaluation.plan.presets import BREAKER, PRESETS
from evaluation.plan.settings import Settings, check_threads
from isac_track import datasets, plugins
from isac_track.config import PatrolSettings
from isac_track.datasets import Dataset, crowd
from isac_track.errors import DataError, PluginError, SettingsError, told
from isac_track.place import placed
from isac_track.plugins import Plugin
from isac_track.scenes import Cut, cut, with_horizons
from isac_track.types import Tracks

_ASKED = (
    "columns",
    "on_duplicate",
    "crs",
    "drop_frozen",
)  # Of the identity where they are given.
_HOW_TO_READ = ("format", "fps", "unit", "sessions", "persistent_ids", *_ASKED)


@dataclass(frozen=True, eq=False, slots=True)
class Unit:
    """A unit of work: one level, one block, one stage. It leaves a file of all its consumers."""

    stage: str
    block: int  # Of scenes; 0 for what is linked.
    mechanism: Plugin
    key: str  # All that its rows depend on but who the consumers are.
    code: Mapping[str, str]  # Digest by module, of the code that computes it.
    consumers: Mapping[str, Consumer]  # By their keys.

    @property
    def world(self) -> str:
        """Of which world it is; empty: that of the run. It is the same for all consumers."""
        return next(iter(self.consumers.values())).world

    @property
    def file(self) -> str:
        """Name of the file that all of its consumers are written to at once."""
        slug = re.sub(r"[^A-Za-z0-9.=]+", "-", f"{self.mechanism.spec}_{self.stage}")[
            :80
        ]
        digest = fingerprint.digest([self.key, *self.consumers])
        return f"{slug}_{self.block:05d}_{digest}.parquet"


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """A run that is ready to start: everything is checked, nothing is written."""

    settings: Settings
    dataset: Dataset
    recorded: Tracks  # Its tracks, where they are sensed.
    tracks: Cut
    axes: Axes
    identity: dict[str, Any]
    code: str  # Version of the code that computes the cells.
    jobs: int  # Worker processes.
    out: Path
    units: tuple[Unit, ...]
    code_of: Mapping[str, str]  # Digest by module, of the code of every plug-in.
    sessions: tuple[Sessions, ...]  # What is linked, by task.
    model_sessions: tuple[Sessions, ...] = ()  # The same of walks of a model.

    @property
    def n_cells(self) -> int:
        """Cells of the run, finished or not."""
        return sum(len(unit.consumers) for unit in self.units)

    @property
    def pairs(self) -> tuple[tuple[Plugin, Consumer], ...]:
        """Every mechanism with each of its consumers."""
        first = (unit for unit in self.units if unit.block == 0)
        return tuple(
            (unit.mechanism, one) for unit in first for one in unit.consumers.values()
        )


def plan(settings: Settings, *, dataset: Dataset | None = None) -> Plan:
    """Check the settings, find the data set, unless it was read before, and lay out the cells.

    Raises IsacTrackError for anything that a user can mend.
    """
    check_threads()
    _check_patrols(settings)
    crossed = axes(settings)
    how = {name: getattr(settings, name) for name in _HOW_TO_READ}
    dataset = dataset or datasets.load(settings.dataset, **how)
    recorded = placed(dataset.tracks, settings=settings.stages)
    tracks = cut(recorded, settings=settings.stages, seed=settings.seed)
    if crossed.horizons_s:
        tracks = with_horizons(tracks, recorded, settings=settings.stages)
        crossed = replace(crossed, horizons_s=tuple(tracks.further))
    identity = _identity(settings, dataset)
    linked = partial(sessions_of, tracks=recorded, seed=settings.seed)
    sessions, skipped = [], dict[str, str]()
    for task in crossed.tasks:
        try:
            sessions.append(linked(task, stages=settings.stages))
        except DataError as error:
            if task.name in settings.choice("tasks").named:  # so that it must be
                raise
            if task.comes_back and dataset.tracks.session is None:
                continue  # of one session nobody expects it
            skipped[task.name] = str(error)
    left = {one.task for one in sessions}
    links = tuple((task, link) for task, link in crossed.links if task in left)
    crossed = replace(crossed, links=links, skipped=skipped)
    units, code_of = _units(crossed, settings, identity=identity)
    jobs = jobs_of(crossed, settings)
    is_apart = settings.cell_timeout_s is not None or settings.scheduler is not None
    if is_apart or jobs > 1 or fingerprint.has_strangers(crossed):
        _check_sendable(units)
    most = min(
        PRESETS[settings.preset].model_people, settings.stages.linkage.most_people
    )
    few = settings.stages.changed({"linkage.most_people": most})
    out = Path("runs") / f"{dataset.name}-{settings.preset}-{settings.seed}"
    return Plan(
        settings=settings,
        dataset=dataset,
        recorded=recorded,
        tracks=tracks,
        axes=crossed,
        identity=identity,
        code=fingerprint.code_hash(),
        jobs=jobs,
        out=out if settings.out is None else Path(settings.out),
        units=units,
        code_of=code_of,
        sessions=tuple(sessions),
        model_sessions=tuple(
            linked(one.task, stages=few)
            for one in sessions
            if one.task.is_one_stretch
            and not one.task.shows_scene
            and any(crossed.linked_in.values())
        ),
    )


def _identity(settings: Settings, dataset: Dataset) -> dict[str, Any]:
    """Return what all cells of a run depend on; a folder takes cells of one identity alone."""
    # One task always uses the bundled crowd.
    bundled = b"".join(
        crowd.bundled_path(session).read_bytes() for session in crowd.FILES
    )
    identity: dict[str, Any] = {
        "dataset": dataset.name,
        "sha256": dataset.sha256,
        "format": dataset.format,
        "fps": settings.fps,
        "seed": settings.seed,
        "scenes": settings.n_scenes,
        "crowd": hashlib.sha256(bundled).hexdigest()[:16],
        **settings.stages.flat(),
    }
    # An axis: another horizon adds cells to a folder and changes no other.
    del identity["conflict.horizons_s"]
    if settings.unit is not None:
        identity["unit"] = settings.unit
    if settings.keep_ids:
        identity["ids"] = "kept"
    if settings.persistent_ids:
        identity["persistent_ids"] = True
    identity |= asked_of_file(settings)
    if settings.n_utility_scenes != settings.n_scenes:
        identity["scenes_utility"] = settings.n_utility_scenes
    return identity


def trial(ready: Plan, *, specs: Iterable[str]) -> Plan:
    """Return a plan that tries the preset's breakers on some levels of a run, in its folder.

    Its cells are those of the same run with `--adversary` and `--attack ou_rts`: keyed
    alike. No units without levels, or where attacks were named.
    """
    settings, wanted = ready.settings, set(specs)
    breakers = (
        () if settings.choice("attacks").replaces else PRESETS[settings.preset].breakers
    )
    some = tuple(
        level for level in ready.axes.mechanisms if level.spec in wanted and breakers
    )
    attacks = (plugins.parse("attacks", BREAKER)[0],)
    crossed = Axes(some, (), attacks, adversaries=breakers, trial=True)
    units, code_of = _units(crossed, settings, identity=ready.identity)
    return replace(ready, axes=crossed, units=units, code_of=code_of, sessions=())


def asked_of_file(settings: Settings) -> dict[str, Any]:
    """Return what a user says of a file that is not as usual."""
    usual = Settings()
    asked = {name: getattr(settings, name) for name in _ASKED}
    return {
        name: value for name, value in asked.items() if value != getattr(usual, name)
    }


def _check_patrols(settings: Settings) -> None:
    """Raise SettingsError for settings of patrols: a run does not read them."""
    if settings.stages.patrol != PatrolSettings():
        raise SettingsError(
            "patrol.* settings change nothing in a run: examples/need_to_know.py reads"
            " them"
        )


def _units(
    crossed: Axes, settings: Settings, *, identity: Mapping[str, Any]
) -> tuple[tuple[Unit, ...], dict[str, str]]:
    """Return the units of work, and the digest of every module that they depend on."""
    known: dict[str, str] = {}

    def code(stage: str, *plugins: Plugin) -> dict[str, str]:
        modules = fingerprint.sources(stage, *plugins)
        missing = (one for one in modules if one not in known)
        known.update((one, fingerprint.source_digest(one)[:16]) for one in missing)
        return {module: known[module] for module in modules}

    units = []
    numbers = settings.n_scenes, settings.n_utility_scenes
    attacked, every = (range(-(-n_scenes // BLOCK_SCENES)) for n_scenes in numbers)
    utility = tuple(one for one in crossed.consumers if one.spec in crossed.utility)
    for mechanisms, consumers, blocks in (
        (crossed.mechanisms, crossed.consumers, attacked),
        (crossed.mechanisms, utility, every[len(attacked) :]),
        *(
            (crossed.linked_mechanisms, crossed.readers(task), (0,))
            for task in crossed.tasks
        ),
        *(
            (some, crossed.consumers_in(world), attacked)
            for world, some in crossed.worlds.items()
        ),
        *(
            (crossed.mechanisms, crossed.robots_at(horizon_s), every)
            for horizon_s in crossed.horizons_s
        ),
        *(
            (some, crossed.readers_in(world, task), (0,))
            for world, some in crossed.linked_in.items()
            for task in crossed.tasks
            if task.is_one_stretch and not task.shows_scene
        ),
    ):
        by_stage: dict[str, dict[str, Consumer]] = {}
        for consumer in consumers:
            own = code("", *consumer.plugins).values()
            key = fingerprint.consumer_key(
                consumer, code=own, keep_scores=settings.keep_scores
            )
            is_rebuilt = consumer.kind in {"attack", "bound"}
            of_block = fingerprint.RECONSTRUCTION if is_rebuilt else fingerprint.SHARING
            by_stage.setdefault(consumer.task or of_block, {})[key] = consumer
        for mechanism in mechanisms:
            about = [BLOCK_SCENES, mechanism.spec, mechanism.origin]
            about += filter(None, [mechanism.digest])
            for stage, of_stage in by_stage.items():
                met = {
                    key: one
                    for key, one in of_stage.items()
                    if crossed.meets(one, mechanism)
                }
                made_by = code(stage, mechanism)
                for block in blocks if met else ():
                    key = fingerprint.digest(
                        [identity, stage, block, *about, *made_by.values()]
                    )
                    units.append(Unit(stage, block, mechanism, key, made_by, met))
    return tuple(units), known


def _check_sendable(units: Iterable[Unit]) -> None:
    """Raise PluginError for a plug-in that no other process can be given."""
    from cloudpickle import dumps  # noqa: PLC0415 - only with workers

    whose = (
        (unit.mechanism, *of.plugins)
        for unit in units
        for of in unit.consumers.values()
    )
    for plugin in {one.spec: one for some in whose for one in some}.values():
        try:
            dumps(plugin)
        except Exception as error:  # noqa: BLE001 - a stranger's __reduce__ may do anything
            raise PluginError(
                f"{plugin.spec} cannot be sent to a worker ({told(error)}); "
                "leave out what cannot be pickled"
            ) from None
