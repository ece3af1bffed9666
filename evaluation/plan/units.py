"""Units of work: every level crossed with its consumers, and the keys of their cells."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from evaluation.plan import fingerprint
from evaluation.plan.axes import Axes
from evaluation.plan.constants import BLOCK_SCENES
from evaluation.plan.consumer import Consumer
from evaluation.plan.settings import Settings, patrol_values, tracking_values
from evaluation.plan.source_digest import ModuleFiles, short_digest
from evaluation.plan.world import OWN_WORLD, World
from isac_track.errors import PluginError, error_text
from isac_track.plugins import Plugin


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


@dataclass(frozen=True, slots=True)
class PlannedUnits:
    """All units of a plan, and the code that their cells depend on."""

    units: tuple[Unit, ...]
    code_digests: Mapping[str, str]  # By module.


def plan_units(
    run_axes: Axes, settings: Settings, *, identity: Mapping[str, Any]
) -> PlannedUnits:
    """Return the units of a run; `identity` is what every cell of it depends on."""
    code = _CodeReader()
    units = []
    for crossing in _crossings(run_axes, settings):
        if not crossing.mechanisms:
            continue  # No code of its consumers is part of the plan.
        by_section = _consumers_by_section(crossing.consumers, settings, code)
        for mechanism, section in product(crossing.mechanisms, by_section):
            code_digests = code.read(
                fingerprint.section_modules(section)
                + fingerprint.plugin_modules([mechanism])
            )
            consumers = {
                key: consumer
                for key, consumer in by_section[section].items()
                if run_axes.scenes.reads_mechanism(consumer, mechanism)
            }
            key_parts = [BLOCK_SCENES, mechanism.spec, mechanism.origin]
            key_parts += filter(None, [mechanism.digest])
            key_parts += code_digests.values()
            key_parts += _own_settings(section, settings)
            for block in crossing.blocks if consumers else ():
                key = fingerprint.digest([identity, section, block, *key_parts])
                units.append(
                    Unit(section, block, mechanism, key, code_digests, consumers)
                )
    return PlannedUnits(tuple(units), code.digests)


@dataclass(frozen=True, slots=True)
class _Crossing:
    """Mechanisms, consumers and blocks that are all combined with each other."""

    mechanisms: tuple[Plugin, ...]
    consumers: tuple[Consumer, ...]
    blocks: Iterable[int] = (0,)  # Of scenes; a task or a patrol has a single block.


def _crossings(run_axes: Axes, settings: Settings) -> list[_Crossing]:
    """Return all crossings of a run; their order is that of its cells in the files."""
    scenes, linkage = run_axes.scenes, run_axes.linkage
    patrols, tracks = run_axes.patrols, run_axes.tracks
    n_attacked = -(-settings.n_attacked_scenes // BLOCK_SCENES)
    n_blocks = -(-settings.n_all_scenes // BLOCK_SCENES)
    attacked_blocks, all_blocks = range(n_attacked), range(n_blocks)
    horizons = [World(horizon_s=horizon_s) for horizon_s in run_axes.horizons_s]
    return [
        _Crossing(run_axes.mechanisms, scenes.consumers, attacked_blocks),
        _Crossing(
            run_axes.mechanisms, scenes.utility_consumers, all_blocks[n_attacked:]
        ),
        *(
            _Crossing(linkage.mechanisms, linkage.consumers(task))
            for task in linkage.tasks
        ),
        *(
            _Crossing(mechanisms, scenes.consumers_in(world), attacked_blocks)
            for world, mechanisms in scenes.mechanisms_by_world.items()
        ),
        *(
            _Crossing(run_axes.mechanisms, scenes.consumers_at(horizon), all_blocks)
            for horizon in horizons
        ),
        _Crossing(linkage.mechanisms, linkage.return_consumers),
        *(
            _Crossing(patrols.mechanisms, patrols.consumers(world))
            for world in (OWN_WORLD, *horizons)
        ),
        *(
            _Crossing(tracks.mechanisms, tracks.consumers(world))
            for world in (OWN_WORLD, *horizons)
        ),
        *(
            _Crossing(mechanisms, linkage.model_consumers(world, task))
            for world, mechanisms in linkage.mechanisms_by_world.items()
            for task in linkage.model_tasks
        ),
    ]


@dataclass(frozen=True, slots=True)
class _CodeReader:
    """Digests of modules; it holds all that it has read, for the making of one plan."""

    digests: dict[str, str] = field(default_factory=dict)  # By module.
    files: ModuleFiles = field(default_factory=dict)

    def read(self, modules: Sequence[str]) -> dict[str, str]:
        """Return the digests of modules by name, in their order."""
        for module in modules:
            if module not in self.digests:
                self.digests[module] = short_digest(module, known=self.files)
        return {module: self.digests[module] for module in modules}


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
    consumers: Iterable[Consumer], settings: Settings, code: _CodeReader
) -> dict[str, dict[str, Consumer]]:
    """Return consumers by section and key."""
    by_section: dict[str, dict[str, Consumer]] = {}
    for consumer in consumers:
        key = fingerprint.consumer_key(
            consumer,
            code=code.read(fingerprint.plugin_modules(consumer.plugins)).values(),
            keep_scores=settings.keep_scores,
        )
        by_section.setdefault(_section(consumer), {})[key] = consumer
    return by_section


def _section(consumer: Consumer) -> str:
    """Return the section of a consumer, as in `Unit`."""
    if consumer.reads_tracks:
        return fingerprint.TRACKING
    if consumer.task:
        return consumer.task
    if consumer.policy:
        return fingerprint.PATROL
    if consumer.kind in {"attack", "bound"}:
        return fingerprint.RECONSTRUCTION
    return fingerprint.SHARING


def check_sendable(units: Iterable[Unit]) -> None:
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
