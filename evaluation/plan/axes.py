"""What a run crosses: the levels and consumers that its settings expand to."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Final, Literal

from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import Task, task_named
from evaluation.plan.constants import (
    BLOCK_SCENES,
    BOUND,
    MODEL,
    ORACLE,
    OTHER_LAW,
    OTHER_LAW_WORLD,
    WINDOWS,
    WORLDS,
    horizon_world,
)
from evaluation.plan.presets import (
    BREAKER,
    PRESETS,
    SHARED,
    UTILITY_PREDICTORS,
    Preset,
)
from evaluation.plan.settings import AXES, Settings
from isac_track import plugins
from isac_track.errors import SettingsError, quoted
from isac_track.kalman.slow_errors import added_error
from isac_track.plugins import Plugin
from isac_track.protocols import USUAL, grants, kind_of
from isac_track.types import Knowledge

MOST_DEFAULT_JOBS: Final = 8  # Unless more are asked for: each takes a few hundred MB.
# Scenes times levels: fewer take less time than workers to start.
WORTH_WORKERS: Final = 5000
WORTH_WORKERS_LINKED: Final = 400  # Linkage cells: the same.


@dataclass(frozen=True, slots=True)
class Consumer:
    """Who reads a release: a predictor, an adversary, or nobody (the descriptors as shared)."""

    kind: Literal[
        "shared", "predictor", "attack", "bound", "linkage", "control", "windows"
    ]
    plugin: Plugin | None = None
    # Adversary that the row is named after: blind, informed or oracle.
    knowledge: str = ""
    granted: frozenset[Knowledge] = frozenset()
    # Of a linkage attack, a control, or the descriptors of what is linked.
    task: str = ""
    behind: Plugin | None = None  # Reconstruction that a linkage attack runs behind.
    control: str = ""
    world: str = ""  # Of `WORLDS`; empty: that of the run.

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """Whose code it is: its plug-in, and what that stands behind."""
        return tuple(one for one in (self.plugin, self.behind) if one is not None)

    @property
    def spec(self) -> str:
        """As in the column `consumer`."""
        own = "@".join(one.spec for one in self.plugins)
        of_kind = {
            "control": f"control-{self.control}",
            "windows": WINDOWS,
            "bound": BOUND,
        }
        name = of_kind.get(self.kind, own or (BOUND if self.kind == "linkage" else ""))
        return f"{self.task}/{name}" if self.task else name or SHARED

    @property
    def requires(self) -> frozenset[Knowledge]:
        """What none of its plug-ins can run without."""
        return frozenset().union(*(one.instance.requires for one in self.plugins))

    @property
    def uses(self) -> frozenset[Knowledge]:
        """What any of its plug-ins takes if granted."""
        return frozenset().union(*(one.instance.uses for one in self.plugins))

    @property
    def is_slow(self) -> bool:
        """Whether it runs on the first release of each source track only."""
        return self.plugin is not None and bool(
            getattr(self.plugin.instance, "slow", False)
        )

    @property
    def is_built_in(self) -> bool:
        """Whether an attack is one of the project's own."""
        return self.plugin is not None and self.plugin.origin.startswith("attacks.")

    @property
    def label(self) -> str:
        """For people: with the adversary, and the world if it is not the run's."""
        return consumer_label(self.spec, self.knowledge, self.world)


def consumer_label(consumer: str, knowledge: str, world: str) -> str:
    """Return what a consumer is called in the files of a run."""
    name = f"{consumer} ({knowledge})" if knowledge else consumer
    return f"{name}, {world}" if world else name


@dataclass(frozen=True, slots=True)
class Axes:
    """What the run crosses: every mechanism level with every consumer."""

    mechanisms: tuple[Plugin, ...]
    predictors: tuple[Plugin, ...]
    attacks: tuple[Plugin, ...]  # Reconstruction attacks.
    links: tuple[
        tuple[Task, Consumer], ...
    ] = ()  # Who links where; who it is, `readers` says.
    # Without any error: every linkage attack must succeed.
    ceiling: Plugin | None = None
    skipped: Mapping[str, str] = field(
        default_factory=dict
    )  # Tasks of too few people, and why.
    utility: frozenset[str] = (
        frozenset()
    )  # SPECs of predictors that are read in all scenes.
    worlds: Mapping[str, tuple[Plugin, ...]] = field(default_factory=dict)
    """Mechanisms of the scenes that are attacked in another of `WORLDS`, too."""
    slow_in_worlds: bool = False
    linked_in: Mapping[str, tuple[Plugin, ...]] = field(default_factory=dict)
    """Of the worlds those where people are linked, and behind which mechanisms."""
    horizons_s: tuple[float, ...] = ()
    """Further horizons: in a world of its own each, where only predictors read, in all scenes."""
    adversaries: tuple[str, ...] = ()  # Asked for beside the usual ones.
    trial: bool = False
    """Whether only the attacks of these adversaries read: on a few levels, after all others."""
    against_slow: frozenset[str] = frozenset()
    """SPECs of attacks that run only against mechanisms whose error changes slowly."""
    skips_oracle: bool = False
    """Whether the oracle attacks only where no lesser adversary can."""

    def _adversaries_of(
        self, granted: Mapping[str, frozenset[Knowledge]]
    ) -> list[tuple[str, frozenset[Knowledge]]]:
        """Return the adversaries that an attack runs for, with what each is granted.

        The oracle is a reference. A run may leave it out where a lesser adversary can
        attack.
        """
        is_left_out = self.skips_oracle and len(granted) > 1
        return [
            (name, known)
            for name, known in granted.items()
            if name != ORACLE or not is_left_out
        ]

    @property
    def consumers(self) -> tuple[Consumer, ...]:
        """All consumers of a block of scenes: the descriptors first, attacks by adversary."""
        attacks = tuple(
            Consumer("attack", plugin, knowledge=adversary, granted=granted)
            for plugin in self.attacks
            for adversary, granted in self._adversaries_of(
                grants(plugin.instance, asked=self.adversaries)
            )
            if not self.trial or adversary in self.adversaries
        )
        if self.trial:
            return attacks
        return (
            Consumer("shared"),
            *(Consumer("predictor", plugin) for plugin in self.predictors),
            *attacks,
            *([Consumer("bound")] if self.attacks else []),
        )

    def meets(self, consumer: Consumer, mechanism: Plugin) -> bool:
        """Return whether a consumer reads what a mechanism shares."""
        needs_slow = {
            "attack": consumer.spec in self.against_slow,
            "bound": all(one.spec in self.against_slow for one in self.attacks),
        }
        std_m, tau_s = added_error(mechanism.instance)
        return not needs_slow.get(consumer.kind, False) or (std_m > 0.0 and tau_s > 0.0)

    def consumers_in(self, world: str) -> tuple[Consumer, ...]:
        """Return the same in another world: of walks of a model nobody foresees conflicts."""
        return tuple(
            replace(one, world=world)
            for one in self.consumers
            if (self.slow_in_worlds or not one.is_slow)
            and (world == OTHER_LAW_WORLD or one.kind in {"attack", "bound"})
        )

    def robots_at(self, horizon_s: float) -> tuple[Consumer, ...]:
        """Return the predictors at a further horizon: those that are read in all scenes."""
        return tuple(
            replace(consumer, world=horizon_world(horizon_s))
            for consumer in self.consumers
            if consumer.kind == "predictor" and consumer.spec in self.utility
        )

    def readers_in(self, world: str, task: Task) -> tuple[Consumer, ...]:
        """Return who links in another world, and the optimum: who is told motion and errors."""
        linkers = [one for one in self.readers(task) if one.kind == "linkage"]
        linkers.append(Consumer("linkage", task=task.name))
        return tuple(replace(one, world=world) for one in linkers)

    @property
    def linked_mechanisms(self) -> tuple[Plugin, ...]:
        """Return the mechanisms of the linkage tasks: all, and the ceiling."""
        known = {plugin.spec for plugin in self.mechanisms}
        extra = (
            ()
            if self.ceiling is None or self.ceiling.spec in known
            else (self.ceiling,)
        )
        return (*extra, *self.mechanisms)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Tasks in which somebody links."""
        return tuple(dict.fromkeys(task for task, _ in self.links))

    def readers(self, task: Task) -> tuple[Consumer, ...]:
        """Return all consumers of a task: its windows, the controls, the attacks by adversary."""
        return (
            windows_of(task.name),
            *(
                Consumer("control", task=task.name, control=name)
                for name, control in CONTROLS.items()
                if control.applies(task)
            ),
            *(
                replace(one, knowledge=adversary, granted=granted, task=task.name)
                for where, one in self.links
                if where is task
                for adversary, granted in self._adversaries_of(
                    _granted(one, task, self.adversaries)
                )
            ),
        )


def _granted(
    link: Consumer, task: Task, asked: tuple[str, ...]
) -> dict[str, frozenset[Knowledge]]:
    return grants(link, everyone=task.everyone, nobody=task.nobody, asked=asked)


@cache
def windows_of(task: str) -> Consumer:
    """Return who reads what the windows of a task give away by themselves, smoothed or not."""
    # The smoother is one of ours that knows nothing: the same whatever else is in the
    # run.
    return Consumer(
        "windows", task=task, behind=plugins.parse("attacks", "radial_rts")[0]
    )


def axes(settings: Settings) -> Axes:
    """Return the plug-ins of a run, each once.

    Raises SettingsError if a SPEC is wrong, no mechanism is left, or a task and the
    attacks do not fit, and PluginError if a named plug-in cannot be loaded.
    """
    preset = PRESETS[settings.preset]
    chosen = {axis: settings.choice(axis) for axis in AXES}
    names = {
        axis: choice.values(getattr(preset, axis)) for axis, choice in chosen.items()
    }
    own_mechanisms, own_attacks = (
        chosen["mechanisms"].replaces,
        chosen["attacks"].replaces,
    )
    if not own_mechanisms:
        names["mechanisms"] += preset.protections
    # An attack that is named runs against every mechanism.
    named_attacks = chosen["attacks"].named
    against_slow = (
        ()
        if own_attacks
        else tuple(spec for spec in preset.against_slow if spec not in named_attacks)
    )
    names["attacks"] += against_slow
    asked = [name for name in settings.adversaries if name not in USUAL]
    if asked and not own_attacks:
        names["attacks"] += (BREAKER,)
        against_slow = tuple(one for one in against_slow if one != BREAKER)
    attacks, links = _attacks(names["attacks"])
    mechanisms = plugins.parse_all("mechanisms", names["mechanisms"])
    predictors = plugins.parse_all("predictors", names["predictors"])
    tasks = tuple(task_named(name) for name in dict.fromkeys(names["tasks"]))
    pairs = _linked(settings, links=links, tasks=tasks)
    if not mechanisms:
        raise SettingsError(
            "nothing to run: the mechanism axis is empty; name one, such as raw"
        )
    _check_laws(mechanisms, law=settings.stages.sensing.law)
    ceiling = plugins.parse("mechanisms", "clean")[0] if pairs else None
    asked_robots = plugins.parse_all("predictors", chosen["predictors"].named)
    utility = {plugin.spec for plugin in predictors}.intersection(UTILITY_PREDICTORS)
    utility |= {plugin.spec for plugin in asked_robots}
    # Who names mechanisms, or a law, has asked for these alone.
    law = settings.stages.sensing.law
    other = {
        OTHER_LAW_WORLD: preset.other_law,
        **dict.fromkeys(WORLDS[1:], preset.model),
    }
    worlds = {
        world: tuple(one for one in mechanisms if one.spec in specs)
        for world, specs in other.items()
        if not own_mechanisms
        and (attacks or pairs or world == OTHER_LAW_WORLD)
        and (law != OTHER_LAW or world == MODEL)
    }
    found = Axes(
        mechanisms,
        predictors,
        attacks,
        pairs,
        ceiling,
        utility=frozenset(utility),
        adversaries=_adversaries(settings, preset),
        skips_oracle=preset.skips_oracle and ORACLE not in settings.adversaries,
        horizons_s=settings.stages.conflict.horizons_s if utility else (),
        worlds=worlds,
        slow_in_worlds=settings.preset == "audit",
        against_slow=frozenset(
            one.spec for one in plugins.parse_all("attacks", against_slow)
        ),
        # One walk, and Gaussian errors: else the best that can be done is not known.
        linked_in={
            world: tuple(one for one in some if one.spec in preset.model_linked)
            for world, some in worlds.items()
            if MODEL in world and (OTHER_LAW_WORLD in world or law == OTHER_LAW)
        },
    )
    rows = (found.consumers, *map(found.readers, found.tasks))
    for name in sorted({*asked} - {one.knowledge for some in rows for one in some}):
        raise SettingsError(
            f"adversary {name}: no attack of the run uses its knowledge; name one that"
            f" does, such as --attack {BREAKER}"
        )
    return found


def _adversaries(settings: Settings, preset: Preset) -> tuple[str, ...]:
    """Return who attacks beside the usual adversaries: as asked, and the preset's own."""
    own = () if settings.choice("attacks").replaces else preset.adversaries
    return tuple(dict.fromkeys((*settings.adversaries, *own)))


def _check_laws(mechanisms: Iterable[Plugin], *, law: str) -> None:
    """Raise SettingsError for linear adding under another error law than that of the raw error."""
    for plugin in mechanisms:
        own = getattr(plugin.instance, "law", None)
        if plugin.adding == "linear" and isinstance(own, str) and own != law:
            raise SettingsError(
                f"{quoted(plugin.spec)}: linear adding scales the raw error, whose law"
                f" is {law}; write adding=independent, or --set sensing.law={own}"
            )


def most_workers(crossed: Axes, settings: Settings) -> int:
    """Return how many workers a run has work for: no more pieces are cut, finished or not."""
    n_blocks = -(-settings.n_utility_scenes // BLOCK_SCENES)
    worlds = [crossed.mechanisms, *crossed.worlds.values()]
    n_levels = sum(len(levels) for levels in worlds)
    n_linked = len(crossed.linked_mechanisms) + sum(
        len(levels) for levels in crossed.linked_in.values()
    )
    return max(n_blocks * n_levels + len(crossed.tasks) * n_linked, 1)


def jobs_of(crossed: Axes, settings: Settings) -> int:
    """Return how many workers to use: as asked, or as many as the work is worth and cores are."""
    if settings.jobs is not None:
        return min(settings.jobs, max(most_workers(crossed, settings), 2))
    n_levels = len(crossed.mechanisms)
    n_links = sum(len(crossed.readers(task)) - 1 for task in crossed.tasks)
    if (
        settings.n_utility_scenes * n_levels < WORTH_WORKERS
        and n_levels * n_links < WORTH_WORKERS_LINKED
    ):
        return 1
    return usual_jobs()


def usual_jobs() -> int:
    """Return how many workers a run with enough work starts: a core each, up to a limit."""
    cores = (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count()
    )
    return min(cores or 1, MOST_DEFAULT_JOBS)


def _attacks(specs: Iterable[Any]) -> tuple[tuple[Plugin, ...], tuple[Consumer, ...]]:
    """Return reconstruction attacks and linkage attacks, each once, in the order given."""
    attacks: dict[str, Plugin] = {}
    links: dict[str, Consumer] = {}
    for spec in specs:
        # Who links behind a reconstruction is two plug-ins, and named by SPECs.
        name, at, behind_spec = (
            spec.partition("@") if isinstance(spec, str) else (spec, "", "")
        )
        if at and not (name.strip() and behind_spec.strip()):
            raise SettingsError(
                f"{spec!r}: expected LINKER@RECONSTRUCTION, as shape@radial_rts"
            )
        for plugin in plugins.plugins_of("attacks", name):
            links_people = kind_of(plugin.instance) == "linkage"
            if not at and not links_people:
                attacks[plugin.spec] = plugin
                continue
            for behind in plugins.parse("attacks", behind_spec) if at else (None,):
                if behind and (
                    not links_people or kind_of(behind.instance) == "linkage"
                ):
                    raise SettingsError(
                        f"{spec!r}: write a linkage attack left of @ and a"
                        " reconstruction attack right of it, as in shape@radial_rts"
                    )
                link = Consumer("linkage", plugin, behind=behind)
                links[link.spec] = link
    return tuple(attacks.values()), tuple(links.values())


def _linked(
    settings: Settings, *, links: tuple[Consumer, ...], tasks: tuple[Task, ...]
) -> tuple[tuple[Task, Consumer], ...]:
    """Return who links in which task, or where an attack can run at all if none suits it.

    Who needs the true frame links where it shows, the others where it does not, and who
    needs ``one_stretch`` of a walk, or a gap to bridge (``across_gap``), where there is
    one.
    """
    chosen: dict[str, list[Task]] = {}
    _, named_links = _attacks(settings.choice("attacks").named)
    must_run = {link.spec for link in named_links}
    for link in links:
        can = [task for task in tasks if _granted(link, task, settings.adversaries)]
        linker = link.plugins[0].instance
        suited = [
            task
            for task in can
            if task.shows_scene == (Knowledge.SCENE in linker.requires)
        ]
        if getattr(linker, "one_stretch", False):
            suited = [task for task in suited if task.is_one_stretch]
        if getattr(linker, "across_gap", False):
            suited = [task for task in suited if task.is_open]
        chosen[link.spec] = suited or can
        if link.spec in must_run and not can:
            needs = ", ".join(sorted(one.name for one in link.requires)) or "a task"
            where = ", ".join(task.name for task in tasks) or "none"
            raise SettingsError(
                f"attack {link.spec!r} has no task to run in (tasks: {where}); it"
                f" requires {needs}"
            )
    must_link = settings.choice("tasks").named
    for task in tasks:
        if task.name in must_link and not any(task in some for some in chosen.values()):
            raise SettingsError(
                f"task {task.name} has no attack that can run in it; name one with"
                " --attack"
            )
    return tuple(
        (task, link) for task in tasks for link in links if task in chosen[link.spec]
    )
