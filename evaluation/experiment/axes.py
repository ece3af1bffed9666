"""What a run crosses: the levels and consumers that its settings expand to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from evaluation.experiment.presets import BLOCK_SCENES, PRESETS, SHARED, WINDOWS
from isac_track import plugins
from isac_track.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from attacks.tasks.task_list import Task
    from evaluation.experiment.settings import Settings
    from isac_track.plugins import Plugin
    from isac_track.types import Knowledge


@dataclass(frozen=True, slots=True)
class Link:
    """A linkage attack, as it is or behind a reconstruction: smooth, then link."""

    linker: Plugin
    behind: Plugin | None = None

    @property
    def spec(self) -> str:
        """LINKER or LINKER@RECONSTRUCTION."""
        return self.linker.spec + ("" if self.behind is None else f"@{self.behind.spec}")

    @property
    def requires(self) -> frozenset[Knowledge]:
        """What either of the two cannot run without."""
        return frozenset().union(*(one.instance.requires for one in self._parts))

    @property
    def uses(self) -> frozenset[Knowledge]:
        """What either of the two takes if granted."""
        return frozenset().union(*(one.instance.uses for one in self._parts))

    @property
    def _parts(self) -> tuple[Plugin, ...]:
        return (self.linker,) if self.behind is None else (self.linker, self.behind)


@dataclass(frozen=True, slots=True)
class Consumer:
    """Who reads a release: a predictor, an adversary, or nobody (the descriptors as shared)."""

    kind: Literal["shared", "predictor", "attack", "linkage", "control", "windows"]
    plugin: Plugin | None = None
    knowledge: str = ""
    """Adversary that the row is named after: blind, informed or oracle."""
    granted: frozenset[Knowledge] = frozenset()
    task: str = ""
    """Of a linkage attack, a control, or the descriptors of what is linked."""
    behind: Plugin | None = None
    """Reconstruction that a linkage attack runs behind."""
    control: str = ""

    @property
    def spec(self) -> str:
        """As in the column `consumer`."""
        if self.kind == "control":
            return f"{self.task}/control-{self.control}"
        if self.kind == "windows":
            return f"{self.task}/{WINDOWS}"
        if self.plugin is None:
            return SHARED
        if self.kind == "linkage":
            return f"{self.task}/{Link(self.plugin, self.behind).spec}"
        return self.plugin.spec

    @property
    def is_slow(self) -> bool:
        """Whether it runs on the first release of each source track only."""
        return self.plugin is not None and bool(getattr(self.plugin.instance, "slow", False))

    @property
    def is_built_in(self) -> bool:
        """Whether an attack is one of the project's own."""
        return self.plugin is not None and self.plugin.origin.startswith("attacks.")

    @property
    def label(self) -> str:
        """For people: with the adversary."""
        return f"{self.spec} ({self.knowledge})" if self.knowledge else self.spec


@dataclass(frozen=True, slots=True)
class Axes:
    """What the run crosses: every mechanism level with every consumer."""

    mechanisms: tuple[Plugin, ...]
    predictors: tuple[Plugin, ...]
    attacks: tuple[Plugin, ...]
    """Reconstruction attacks."""
    links: tuple[tuple[Task, Link], ...] = ()
    """Who links in which task."""
    ceiling: Plugin | None = None
    """Mechanism without any error, at which every linkage attack must succeed."""
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Tasks of the preset that the recording is too small for, and why."""

    @property
    def consumers(self) -> tuple[Consumer, ...]:
        """All consumers of a block of scenes: the descriptors first, attacks by adversary."""
        from isac_track.protocols import grants  # noqa: PLC0415 - --help needs no numpy

        return (
            Consumer("shared"),
            *(Consumer("predictor", plugin) for plugin in self.predictors),
            *(
                Consumer("attack", plugin, knowledge=adversary, granted=granted)
                for plugin in self.attacks
                for adversary, granted in grants(plugin.instance).items()
            ),
        )

    @property
    def linked_mechanisms(self) -> tuple[Plugin, ...]:
        """Return the mechanisms of the linkage tasks: all, and the ceiling."""
        known = {plugin.spec for plugin in self.mechanisms}
        extra = () if self.ceiling is None or self.ceiling.spec in known else (self.ceiling,)
        return (*extra, *self.mechanisms)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Tasks in which somebody links."""
        return tuple(dict.fromkeys(task for task, _ in self.links))

    def readers(self, task: Task) -> tuple[Consumer, ...]:
        """Return all consumers of a task: the descriptors of its windows, then who links."""
        return (Consumer("windows", task=task.name), *self.linkers(task))

    def linkers(self, task: Task) -> tuple[Consumer, ...]:
        """Return who links in a task: the controls, then the attacks by adversary."""
        from attacks.tasks.controls import CONTROLS  # noqa: PLC0415 - as above
        from isac_track.protocols import grants  # noqa: PLC0415

        return (
            *(
                Consumer("control", task=task.name, control=name)
                for name, control in CONTROLS.items()
                if control.applies(task)
            ),
            *(
                Consumer(
                    "linkage",
                    link.linker,
                    knowledge=adversary,
                    granted=granted,
                    task=task.name,
                    behind=link.behind,
                )
                for where, link in self.links
                if where is task
                for adversary, granted in grants(
                    link, everyone=task.everyone, nobody=task.nobody
                ).items()
            ),
        )

    def without(self, task: Task, why: str) -> Axes:
        """Return the axes without a task that cannot be."""
        return replace(
            self,
            links=tuple(pair for pair in self.links if pair[0] is not task),
            skipped={**self.skipped, task.name: why},
        )


def axes(settings: Settings) -> Axes:
    """Return the plug-ins of a run, each once.

    Raises
    ------
    SettingsError
        If a SPEC is wrong, no mechanism is left, or a task and the attacks do not fit.
    PluginError
        If a named plug-in cannot be loaded.
    """
    preset = PRESETS[settings.preset]
    mechanisms = preset.mechanisms if settings.mechanisms is None else settings.mechanisms
    predictors = preset.predictors if settings.predictors is None else settings.predictors
    attacks, links = _attacks(preset.attacks if settings.attacks is None else settings.attacks)
    expanded = Axes(
        mechanisms=plugins.parse_all("mechanisms", mechanisms),
        predictors=plugins.parse_all("predictors", predictors),
        attacks=attacks,
        links=_linked(settings, links=links, tasks=_tasks(settings)),
    )
    if not expanded.mechanisms:
        raise SettingsError("nothing to run: the mechanism axis is empty; name one, such as raw")
    if expanded.links:
        (ceiling,) = plugins.parse("mechanisms", "clean")
        expanded = replace(expanded, ceiling=ceiling)
    return expanded


def _attacks(specs: tuple[str, ...]) -> tuple[tuple[Plugin, ...], tuple[Link, ...]]:
    """Return reconstruction attacks and linkage attacks, each once, in the order given."""
    if not specs:
        return (), ()
    from isac_track.protocols import kind_of  # noqa: PLC0415 - --help needs no numpy

    attacks: dict[str, Plugin] = {}
    links: dict[str, Link] = {}
    for spec in specs:
        name, at, behind_spec = spec.partition("@")
        if at and not (name.strip() and behind_spec.strip()):
            raise SettingsError(f"{spec!r}: expected LINKER@RECONSTRUCTION, as shape@radial_rts")
        for plugin in plugins.parse("attacks", name):
            links_people = kind_of(plugin.instance) == "linkage"
            if not at:
                if links_people:
                    links[plugin.spec] = Link(plugin)
                else:
                    attacks[plugin.spec] = plugin
                continue
            for behind in plugins.parse("attacks", behind_spec):
                if not links_people or kind_of(behind.instance) == "linkage":
                    raise SettingsError(
                        f"{spec!r}: left of @ stands a linkage attack, right of it the "
                        "reconstruction that it runs behind, as in shape@radial_rts"
                    )
                link = Link(plugin, behind)
                links[link.spec] = link
    return tuple(attacks.values()), tuple(links.values())


def _tasks(settings: Settings) -> tuple[Task, ...]:
    from attacks.tasks.task_list import task_named  # noqa: PLC0415 - --help needs no numpy

    names = PRESETS[settings.preset].tasks if settings.tasks is None else settings.tasks
    return tuple(task_named(name) for name in dict.fromkeys(names))


def _linked(
    settings: Settings, *, links: tuple[Link, ...], tasks: tuple[Task, ...]
) -> tuple[tuple[Task, Link], ...]:
    """Return who links in which task.

    Who needs the true frame links where it shows, the others where it does not; an attack that
    none of the tasks suits is run in every one that it can run in.
    """
    from isac_track.protocols import grants  # noqa: PLC0415 - --help needs no numpy
    from isac_track.types import Knowledge  # noqa: PLC0415

    chosen: dict[str, list[Task]] = {}
    for link in links:
        can = [task for task in tasks if grants(link, everyone=task.everyone, nobody=task.nobody)]
        needs_scene = Knowledge.SCENE in link.linker.instance.requires
        chosen[link.spec] = [task for task in can if task.shows_scene == needs_scene] or can
    pairs = [(task, link) for task in tasks for link in links if task in chosen[link.spec]]
    for link in links:
        if settings.attacks is not None and all(one is not link for _, one in pairs):
            asked = ", ".join(sorted(one.name for one in link.requires)) or "a task"
            where = ", ".join(task.name for task in tasks) or "none"
            raise SettingsError(
                f"attack {link.spec!r} has no task to run in (tasks: {where}); it requires {asked}"
            )
    for task in tasks:
        if settings.tasks is not None and all(one is not task for one, _ in pairs):
            raise SettingsError(
                f"task {task.name} has no attack that can run in it; name one with --attack"
            )
    return tuple(pairs)


def n_blocks(n_scenes: int) -> int:
    """Return how many blocks of scenes a run has."""
    return -(-n_scenes // BLOCK_SCENES)
