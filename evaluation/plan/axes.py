"""What a run crosses: the levels and consumers that its settings expand to."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import FUSED, RETURNS, Task, task_named
from evaluation.plan.address import (
    Address,
    control_name,
    policy_text,
    track_release_text,
)
from evaluation.plan.constants import (
    BLOCK_SCENES,
    BOUND,
    ORACLE,
    OTHER_LAW,
    WINDOWS,
)
from evaluation.plan.presets import (
    PRESETS,
    SHARED,
    STRONGEST_ON_SLOW_NOISE,
    UTILITY_PREDICTORS,
    Preset,
)
from evaluation.plan.settings import AXES, Settings
from evaluation.plan.world import OTHER_LAW_WORLD, OWN_WORLD, WORLDS, World
from isac_track import plugins
from isac_track.errors import SettingsError, quoted
from isac_track.kalman.slow_errors import added_error
from isac_track.patrols import forecast_instants
from isac_track.plugins import Plugin
from isac_track.policies.query import check_reach
from isac_track.policies.samples import Ahead
from isac_track.policies.summaries import State
from isac_track.protocols import USUAL, attack_kind, grants, links_same_stretch
from isac_track.types import Knowledge

MOST_DEFAULT_JOBS: Final = 8  # Unless more are asked for: each takes a few hundred MB.
# Scenes times levels: fewer take less time than workers to start.
WORTH_WORKERS: Final = 5000
WORTH_WORKERS_LINKED: Final = 400  # Linkage cells: the same.
FUSION: Final = "fusion"  # Of all linkers of people who come back.
LOG: Final = "log"  # Consumer of the answers that a fleet of robots was given.
TRACKER: Final = "tracker"  # Consumer of tracks: how well they are associated.
PERFECT: Final = "oracle"  # Tracker that knows who is behind each detection.
PATROL_KINDS: Final = ("patrol", "log")  # Kinds of consumer that read answers.
TRACK_KINDS: Final = ("tracks", "tracked", "track_log", "track_link")
"""Kinds of consumer that read tracks, or what a policy answers from them."""
_NAMES: Final = {
    "shared": SHARED,
    "windows": WINDOWS,
    "bound": BOUND,
    "link_bound": BOUND,
    "log": LOG,
    "track_log": LOG,
    "returns": FUSION,
    "tracks": TRACKER,
}
"""Names of consumers without a plug-in, by kind."""
HANDOVER: Final = "handover"  # Family of the tasks in which tracks are linked.
_FEWER_LOGS: Final = ("blind", ORACLE)
LOG_ADVERSARIES: Final = ("blind", "informed", ORACLE)
"""Adversaries with a log: the informed knows routes and policy, the oracle knows
which answers are about the same person."""


@dataclass(frozen=True, slots=True)
class Consumer:
    """A reader of a release: a predictor, an adversary, or the plain descriptors."""

    kind: Literal[
        "shared",
        "predictor",
        "attack",
        "bound",
        "linkage",
        "link_bound",
        "control",
        "windows",
        "patrol",
        "log",
        "returns",
        "tracks",
        "tracked",
        "track_log",
        "track_link",
    ]
    plugin: Plugin | None = None
    # Name of its adversary, as in the column `knowledge`; "" for a robot.
    adversary: str = ""
    granted: frozenset[Knowledge] = frozenset()
    # Of a linkage attack, a control, or the descriptors of windows.
    task: str = ""
    # The attack whose positions a linkage attack reads.
    reconstruction: Plugin | None = None
    control: str = ""
    world: World = OWN_WORLD
    # Tracker of the tracks that it reads, by the SPEC of their release.
    track_release: Plugin | None = None
    # What answers to a robot on patrol, or to a log, disclose. None beside a release of
    # tracks: all tracks.
    policy: Plugin | None = None

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """Its plug-in, the reconstruction in front of that, its tracker and policy."""
        own = (*self._reading_plugins, self.track_release, self.policy)
        return tuple(plugin for plugin in own if plugin is not None)

    @property
    def _reading_plugins(self) -> tuple[Plugin, ...]:
        """Its plug-ins that read a release."""
        own = (self.plugin, self.reconstruction)
        return tuple(plugin for plugin in own if plugin is not None)

    @property
    def spec(self) -> str:
        """As in the column `consumer`."""
        return self.address.consumer

    @property
    def address(self) -> Address:
        """Where its numbers belong, at every level."""
        reconstruction = None
        if self.control:
            name = control_name(self.control)
        elif self.plugin is not None:
            name, reconstruction = self.plugin.spec, self.reconstruction
        else:
            name = _NAMES[self.kind]
        return Address(
            world=self.world,
            policy=policy_text(
                track_release=self.track_release.spec if self.track_release else "",
                policy=self.policy.spec if self.policy else "",
            ),
            task=self.task,
            plugin=name,
            reconstruction=reconstruction.spec if reconstruction else "",
            adversary=self.adversary,
        )

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that any of its plug-ins cannot run without."""
        needs = (plugin.instance.requires for plugin in self._reading_plugins)
        return frozenset().union(*needs)

    @property
    def uses(self) -> frozenset[Knowledge]:
        """Knowledge that any of its plug-ins takes if granted."""
        uses = [plugin.instance.uses for plugin in self._reading_plugins]
        return frozenset().union(*uses)

    @property
    def reads_patrols(self) -> bool:
        """Whether it reads patrols: answers of a policy, or tracks of detections."""
        return self.track_release is not None or self.policy is not None

    @property
    def reads_tracks(self) -> bool:
        """Whether it reads tracks of detections."""
        return self.kind in TRACK_KINDS

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
    def kind_in_files(self) -> str:
        """As in a manifest, where the optimum of a linkage task is a linkage cell."""
        return "linkage" if self.kind == "link_bound" else self.kind

    @property
    def label(self) -> str:
        """Name for people: with the adversary, and the world if it is not the run's."""
        return self.address.cell_label


@dataclass(frozen=True, slots=True)
class Axes:
    """The axes of a run, which crosses every mechanism level with every consumer."""

    mechanisms: tuple[Plugin, ...]
    predictors: tuple[Plugin, ...]
    attacks: tuple[Plugin, ...]  # Reconstruction attacks.
    # Linkers by task; `task_consumers` adds the adversaries.
    links: tuple[tuple[Task, Consumer], ...] = ()
    # A mechanism without any error: every linkage attack must succeed.
    ceiling: Plugin | None = None
    # Tasks of too few people, with the reasons.
    skipped: Mapping[str, str] = field(default_factory=dict)
    # SPECs of predictors that are read in all scenes.
    utility: frozenset[str] = frozenset()
    worlds: Mapping[World, tuple[Plugin, ...]] = field(default_factory=dict)
    """Mechanisms whose scenes are attacked in others of `WORLDS`, too."""
    slow_in_worlds: bool = False
    linked_in: Mapping[World, tuple[Plugin, ...]] = field(default_factory=dict)
    """The worlds where people are linked, and the mechanisms there."""
    horizons_s: tuple[float, ...] = ()
    """Further horizons, a world each, where predictors alone read, in all scenes."""
    adversaries: tuple[str, ...] = ()  # Beside the usual adversaries.
    only_stronger: bool = False
    """Whether only `adversaries` read: on a few levels, after all others."""
    against_slow: frozenset[str] = frozenset()
    """SPECs of attacks that run only against mechanisms whose error changes slowly."""
    skips_oracle: bool = False
    """Whether the oracle attacks only where no lesser adversary can."""
    policies: tuple[Plugin, ...] = ()  # Disclosure policies on patrols.
    patrol_mechanisms: tuple[Plugin, ...] = ()
    """Mechanisms that patrols are shared with."""
    follows_informed: bool = True
    """Whether an informed adversary reads the logs of patrols, too."""
    no_scenes: str = ""  # Why a run has none: too few tracks are long enough.
    links_returns: bool = False
    """Whether people who come back are linked, wherever a recording has any."""
    track_releases: tuple[Plugin, ...] = ()
    """Trackers of a network's detections; the SPEC is that of the release."""
    tracked: tuple[Plugin, ...] = ()  # Mechanisms of these releases.
    track_policies: tuple[Plugin, ...] = ()  # Policies that answer from tracks, too.
    track_tasks: tuple[str, ...] = ()  # Tasks in which tracks are linked, too.

    def _attacking(
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
        """Consumers of a block of scenes: descriptors first, attacks by adversary."""
        attacks = tuple(
            Consumer("attack", plugin, adversary=adversary, granted=granted)
            for plugin in self.attacks
            for adversary, granted in self._attacking(
                grants(plugin.instance, asked=self.adversaries)
            )
            if not self.only_stronger or adversary in self.adversaries
        )
        if self.only_stronger or self.no_scenes:
            return attacks
        robots = tuple(Consumer("predictor", plugin) for plugin in self.predictors)
        bound = (Consumer("bound"),) if self.attacks else ()
        return (Consumer("shared"), *robots, *attacks, *bound)

    def meets(self, consumer: Consumer, mechanism: Plugin) -> bool:
        """Whether a consumer reads the releases of a mechanism."""
        needs_slow = False
        if consumer.kind == "attack":
            needs_slow = consumer.spec in self.against_slow
        elif consumer.kind == "bound":
            needs_slow = all(
                attack.spec in self.against_slow for attack in self.attacks
            )
        std_m, tau_s = added_error(mechanism.instance)
        return not needs_slow or (std_m > 0.0 and tau_s > 0.0)

    def consumers_in(self, world: World) -> tuple[Consumer, ...]:
        """Return the consumers in another world: no robot predicts a model's walks."""
        return tuple(
            replace(consumer, world=world)
            for consumer in self.consumers
            if (self.slow_in_worlds or not consumer.is_slow)
            and (world == OTHER_LAW_WORLD or consumer.kind in {"attack", "bound"})
        )

    def robots_at(self, horizon_s: float) -> tuple[Consumer, ...]:
        """Return the predictors at a further horizon: those read in all scenes."""
        return tuple(
            replace(consumer, world=World(horizon_s=horizon_s))
            for consumer in self.consumers
            if consumer.kind == "predictor" and consumer.spec in self.utility
        )

    def patrol_consumers(self, world: World = OWN_WORLD) -> tuple[Consumer, ...]:
        """Return the consumers of patrols in a world: robots, and adversaries with a log.

        The robots are the predictors that are read in all scenes. Logs belong to no
        further horizon.
        """
        robots = [
            Consumer("patrol", plugin, world=world)
            for plugin in self.predictors
            if plugin.spec in self.utility
        ]
        adversaries = LOG_ADVERSARIES if self.follows_informed else _FEWER_LOGS
        logs = [Consumer("log", adversary=name) for name in adversaries]
        consumers = robots if world else robots + logs
        return tuple(
            replace(consumer, policy=policy)
            for policy in self.policies
            for consumer in consumers
        )

    def track_consumers(self, world: World = OWN_WORLD) -> tuple[Consumer, ...]:
        """Return the consumers of tracks in a world: metrics of tracks, and robots.

        The robots are those of patrols. A policy's answers from tracks are read by robots
        and by an adversary with a log. Linkers link tracks across a rotation of
        pseudonyms. Only robots have further horizons.
        """
        robots = [
            Consumer("tracked", plugin, world=world)
            for plugin in self.predictors
            if plugin.spec in self.utility
        ]
        log = Consumer("track_log", adversary=ORACLE)
        consumers = [
            replace(consumer, track_release=release)
            for release in self.track_releases
            for consumer in (robots if world else [Consumer("tracks"), *robots])
        ]
        consumers += [
            replace(consumer, track_release=release, policy=policy)
            for release in self.track_releases
            for policy in self.track_policies
            for consumer in (robots if world else [log, *robots])
        ]
        linkers = [
            replace(linker, kind="track_link")
            for task in self.tasks
            if task.name in self.track_tasks and not world
            for linker in self.task_consumers(task)
            if linker.kind != "windows"
        ]
        consumers += [
            replace(linker, track_release=release)
            for release in self.track_releases
            for linker in linkers
        ]
        return tuple(consumers)

    def task_consumers_in(self, world: World, task: Task) -> tuple[Consumer, ...]:
        """Return the linkers in another world, and the optimum that knows the model."""
        linkers = [
            consumer
            for consumer in self.task_consumers(task)
            if consumer.kind == "linkage"
        ]
        linkers.append(Consumer("link_bound", task=task.name))
        return tuple(replace(consumer, world=world) for consumer in linkers)

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
    def return_consumers(self) -> tuple[Consumer, ...]:
        """Consumer of people who come back: all linkers and controls at once."""
        consumer = Consumer("returns", task=RETURNS.name, adversary="informed")
        return (consumer,) if self.links_returns else ()

    def without_scenes(self, why: str) -> "Axes":
        """Return the axes of people who come back alone: no scene, window or patrol."""
        return Axes(
            self.mechanisms,
            predictors=(),
            attacks=(),
            ceiling=self.ceiling,
            skipped=self.skipped,
            links_returns=self.links_returns,
            no_scenes=why,
        )

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Tasks that have a linker."""
        return tuple(dict.fromkeys(task for task, _ in self.links))

    def task_consumers(self, task: Task) -> tuple[Consumer, ...]:
        """Return all consumers of a task: windows, controls, attacks by adversary."""
        return (
            windows_consumer(task.name),
            *(
                Consumer("control", task=task.name, control=name)
                for name, control in CONTROLS.items()
                if control.applies(task)
            ),
            *(
                replace(link, adversary=adversary, granted=granted, task=task.name)
                for link_task, link in self.links
                if link_task is task
                for adversary, granted in self._attacking(
                    _granted(link, task, self.adversaries)
                )
            ),
        )


def _granted(
    link: Consumer, task: Task, asked: tuple[str, ...]
) -> dict[str, frozenset[Knowledge]]:
    return grants(link, everyone=task.everyone, nobody=task.nobody, asked=asked)


def windows_consumer(task: str) -> Consumer:
    """Return the consumer of a task's windows: their descriptors, smoothed or not."""
    # The built-in smoother, with no knowledge: the same whatever else is in the run.
    return Consumer(
        "windows", task=task, reconstruction=plugins.parse("attacks", "radial_rts")[0]
    )


def axes(settings: Settings) -> Axes:
    """Return the plug-ins of a run, each once.

    Raises SettingsError if a SPEC is wrong, no mechanism is left, or a task and the
    attacks do not fit, and PluginError if a named plug-in cannot be loaded.
    """
    preset = PRESETS[settings.preset]
    names = _axis_names(settings, preset)
    further_attacks, against_slow = _further_attacks(settings, preset)
    attacks, links = _parse_attacks(names["attacks"] + further_attacks)
    mechanisms = plugins.parse_all("mechanisms", names["mechanisms"])
    predictors = plugins.parse_all("predictors", names["predictors"])
    tasks = tuple(task_named(name) for name in dict.fromkeys(names["tasks"]))
    pairs = _assign_links(settings, links=links, asked=tasks)
    if not mechanisms:
        raise SettingsError(
            "nothing to run: the mechanism axis is empty; name one, such as raw"
        )
    law = settings.stages.sensing.law
    _check_laws(mechanisms, law=law)
    links_people = bool(pairs) or RETURNS in tasks
    ceiling = plugins.parse("mechanisms", "clean")[0] if links_people else None
    utility = _utility_predictors(settings, predictors)
    policies = plugins.parse_all("policies", names["policies"])
    _check_policies(policies, settings)
    worlds: dict[World, tuple[Plugin, ...]] = {}
    # A user who names mechanisms has asked for these alone.
    if not settings.choice("mechanisms").replaces:
        worlds = _worlds(
            mechanisms, preset, law=law, has_attacks=bool(attacks or pairs)
        )
    run_axes = Axes(
        mechanisms,
        predictors,
        attacks,
        pairs,
        ceiling,
        utility=utility,
        adversaries=_stronger_adversaries(settings, preset),
        skips_oracle=_skips_oracle(settings, preset),
        horizons_s=settings.stages.conflict.horizons_s if utility else (),
        worlds=worlds,
        slow_in_worlds=settings.preset == "audit",
        against_slow=frozenset(
            plugin.spec for plugin in plugins.parse_all("attacks", against_slow)
        ),
        linked_in=_linked_in(worlds, preset, law=law),
        policies=policies,
        patrol_mechanisms=_patrol_mechanisms(settings, preset, mechanisms, policies),
        follows_informed=preset.follows_informed,
        links_returns=RETURNS in tasks,
    )
    _check_adversaries_used(run_axes, settings)
    return _with_tracks(run_axes, settings, preset)


def _axis_names(settings: Settings, preset: Preset) -> dict[str, tuple[Any, ...]]:
    """Return the plug-ins and tasks of each axis as they are named: SPECs or objects.

    A preset's protections are mechanisms that a user's own replace.
    """
    chosen = {axis: settings.choice(axis) for axis in AXES}
    names = {
        axis: choice.values(getattr(preset, axis)) for axis, choice in chosen.items()
    }
    if not chosen["mechanisms"].replaces:
        names["mechanisms"] += preset.protections
    return names


def _utility_predictors(
    settings: Settings, predictors: Iterable[Plugin]
) -> frozenset[str]:
    """Return the SPECs of predictors that are read in all scenes."""
    named = plugins.parse_all("predictors", settings.choice("predictors").named)
    specs = {plugin.spec for plugin in predictors}.intersection(UTILITY_PREDICTORS)
    return frozenset(specs.union(plugin.spec for plugin in named))


def _with_tracks(run_axes: Axes, settings: Settings, preset: Preset) -> Axes:
    """Return axes with the tracks of a run's tracker; as they are without a tracker."""
    releases = _track_releases(settings)
    if not releases:
        return run_axes
    return replace(
        run_axes,
        track_releases=releases,
        tracked=_tracked(settings, preset, run_axes.mechanisms),
        track_policies=_track_policies(settings),
        track_tasks=_track_tasks(settings),
    )


def _skips_oracle(settings: Settings, preset: Preset) -> bool:
    """Whether the oracle attacks only where no lesser adversary can."""
    if not preset.skips_oracle or ORACLE in settings.adversaries:
        return False
    return not (preset.named_meet_oracle and settings.choice("attacks").replaces)


def _check_policies(policies: Iterable[Plugin], settings: Settings) -> None:
    """Raise SettingsError for a policy that looks farther than the network forecasts."""
    ahead_s = forecast_instants(settings.stages)
    for policy in policies:
        instance = policy.instance
        # A state of everybody asks for no forecast.
        if isinstance(instance, Ahead | State) and instance.metres is not None:
            try:
                check_reach(instance.horizon_s, ahead_s=ahead_s)
            except ValueError as error:
                raise SettingsError(f"policy {policy.spec}: {error}") from None


def _patrol_mechanisms(
    settings: Settings,
    preset: Preset,
    mechanisms: Iterable[Plugin],
    policies: Sequence[Plugin],
) -> tuple[Plugin, ...]:
    """Return the mechanisms of a run that patrols are shared with; none without policy.

    They are those of the preset's, and those that a user names together with a policy.
    A mechanism that withholds samples is left out: on patrols that is a policy's part.
    """
    if not policies:
        return ()
    takes_named = bool(settings.choice("policies").named)
    return _walked_through(settings, preset, mechanisms, takes_named=takes_named)


def _walked_through(
    settings: Settings,
    preset: Preset,
    mechanisms: Iterable[Plugin],
    *,
    takes_named: bool,
) -> tuple[Plugin, ...]:
    """Return the mechanisms of patrolled recordings: the preset's, and those named."""
    specs = set(preset.patrol_mechanisms)
    if takes_named:
        named = plugins.parse_all("mechanisms", settings.choice("mechanisms").named)
        specs.update(plugin.spec for plugin in named)
    return tuple(
        plugin
        for plugin in mechanisms
        if plugin.spec in specs and not getattr(plugin.instance, "withholds", False)
    )


def _track_releases(settings: Settings) -> tuple[Plugin, ...]:
    """Return the trackers of a run, each with the SPEC of its release.

    The oracle is beside every other tracker, as a reference. Alone it adds nothing:
    perfect association is what all other numbers assume.
    """
    rules = settings.stages.tracking
    (oracle,) = plugins.parse("trackers", PERFECT)
    trackers = plugins.parse("trackers", rules.method)
    if trackers == (oracle,):
        return ()
    is_before = rules.release == "tracks" and rules.noise == "before"
    return tuple(
        replace(
            plugin,
            spec=track_release_text(
                rules.release, plugin.spec, has_noise_before=is_before
            ),
        )
        for plugin in (oracle, *trackers)
    )


def _track_policies(settings: Settings) -> tuple[Plugin, ...]:
    """Return the policies that answer from tracks: those that a user names.

    Unlabelled detections have none, since a policy chooses people.
    """
    if settings.stages.tracking.release != "tracks":
        return ()
    return plugins.parse_all("policies", settings.choice("policies").named)


def _track_tasks(settings: Settings) -> tuple[str, ...]:
    """Return the tasks in which tracks are linked: handovers that a user names.

    Unlabelled detections have no pseudonyms that rotate.
    """
    if settings.stages.tracking.release != "tracks":
        return ()
    named = settings.choice("tasks").named
    return tuple(name for name in named if task_named(name).family == HANDOVER)


def _tracked(
    settings: Settings, preset: Preset, mechanisms: Iterable[Plugin]
) -> tuple[Plugin, ...]:
    """Return the mechanisms of a run that tracks are shared with.

    They are those of the preset's patrols, and those that a user names. A mechanism
    that withholds samples is left out.
    """
    return _walked_through(settings, preset, mechanisms, takes_named=True)


def _further_attacks(
    settings: Settings, preset: Preset
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the SPECs of attacks beside the named attacks and the preset's own.

    The second tuple has those that run only against a slow error. A user who names the
    attacks of a run gets no others.
    """
    choice = settings.choice("attacks")
    if choice.replaces:
        return (), ()
    # An attack that is named runs against every mechanism.
    against_slow = tuple(
        spec for spec in preset.against_slow if spec not in choice.named
    )
    if not _asked_stronger(settings):
        return against_slow, against_slow
    return (
        (*against_slow, STRONGEST_ON_SLOW_NOISE),
        tuple(spec for spec in against_slow if spec != STRONGEST_ON_SLOW_NOISE),
    )


def _asked_stronger(settings: Settings) -> list[str]:
    """Return the adversaries that a user names beside the usual three."""
    return [name for name in settings.adversaries if name not in USUAL]


def _worlds(
    mechanisms: Iterable[Plugin], preset: Preset, *, law: str, has_attacks: bool
) -> dict[World, tuple[Plugin, ...]]:
    """Return the mechanisms that are computed in other worlds, by world.

    A run under `OTHER_LAW` has no other law.
    """
    specs_by_world = {
        OTHER_LAW_WORLD: preset.other_law,
        **dict.fromkeys(WORLDS[1:], preset.model),
    }
    return {
        world: tuple(plugin for plugin in mechanisms if plugin.spec in specs)
        for world, specs in specs_by_world.items()
        if (has_attacks or world == OTHER_LAW_WORLD)
        and (law != OTHER_LAW or not world.law)
    }


def _linked_in(
    worlds: Mapping[World, tuple[Plugin, ...]], preset: Preset, *, law: str
) -> dict[World, tuple[Plugin, ...]]:
    """Return the mechanisms that are linked in other worlds, by world.

    Only walks of a model with Gaussian errors: else the optimum is not known.
    """
    return {
        world: tuple(plugin for plugin in levels if plugin.spec in preset.model_linked)
        for world, levels in worlds.items()
        if world.is_model and (world.law or law) == OTHER_LAW
    }


def _check_adversaries_used(run_axes: Axes, settings: Settings) -> None:
    """Raise SettingsError for an adversary whose knowledge no attack uses."""
    consumers = list(run_axes.consumers)
    for task in run_axes.tasks:
        consumers += run_axes.task_consumers(task)
    attacking = {consumer.adversary for consumer in consumers}
    for name in sorted(set(_asked_stronger(settings)) - attacking):
        raise SettingsError(
            f"adversary {name}: no attack of the run uses its knowledge; name one that"
            f" does, such as --attack {STRONGEST_ON_SLOW_NOISE}"
        )


def _stronger_adversaries(settings: Settings, preset: Preset) -> tuple[str, ...]:
    """Return the adversaries beside the usual three: as asked, and the preset's own."""
    own = () if settings.choice("attacks").replaces else preset.adversaries
    return tuple(dict.fromkeys((*settings.adversaries, *own)))


def _check_laws(mechanisms: Iterable[Plugin], *, law: str) -> None:
    """Raise SettingsError for linear adding under another law than the raw error's."""
    for plugin in mechanisms:
        own = getattr(plugin.instance, "law", None)
        if plugin.adding == "linear" and isinstance(own, str) and own != law:
            raise SettingsError(
                f"{quoted(plugin.spec)}: linear adding scales the raw error, whose law"
                f" is {law}; write adding=independent, or --set sensing.law={own}"
            )


def most_workers(run_axes: Axes, settings: Settings) -> int:
    """Return the number of workers that a run has work for, finished or not."""
    n_scenes = 0 if run_axes.no_scenes else settings.n_utility_scenes
    n_blocks = -(-n_scenes // BLOCK_SCENES)
    worlds = [run_axes.mechanisms, *run_axes.worlds.values()]
    n_levels = sum(len(levels) for levels in worlds)
    n_linked = len(run_axes.linked_mechanisms) + sum(
        len(levels) for levels in run_axes.linked_in.values()
    )
    n_tasks = len(run_axes.tasks) + len(run_axes.return_consumers)
    n_patrols = len(run_axes.patrol_mechanisms) + len(run_axes.tracked)
    return max(n_blocks * n_levels + n_tasks * n_linked + n_patrols, 1)


def choose_jobs(run_axes: Axes, settings: Settings) -> int:
    """Return the number of workers: as asked, or a core each if it is worth it."""
    if settings.jobs is not None:
        return min(settings.jobs, max(most_workers(run_axes, settings), 2))
    n_levels = len(run_axes.mechanisms)
    n_linkers = sum(len(run_axes.task_consumers(task)) - 1 for task in run_axes.tasks)
    if (
        settings.n_utility_scenes * n_levels < WORTH_WORKERS
        and n_levels * n_linkers < WORTH_WORKERS_LINKED
    ):
        return 1
    return usual_jobs()


def usual_jobs() -> int:
    """Return the workers of a run with enough work: a core each, up to a limit."""
    cores = os.cpu_count()
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    return min(cores or 1, MOST_DEFAULT_JOBS)


def _parse_attacks(
    specs: Iterable[Any],
) -> tuple[tuple[Plugin, ...], tuple[Consumer, ...]]:
    """Return reconstruction attacks and linkage attacks, each once, as ordered."""
    attacks: dict[str, Plugin] = {}
    links: dict[str, Consumer] = {}
    for spec in specs:
        # A linker behind a reconstruction is two plug-ins, named by SPECs.
        name, separator, smoother = spec, "", ""
        if isinstance(spec, str):
            name, separator, smoother = spec.partition("@")
        if separator and not (name.strip() and smoother.strip()):
            raise SettingsError(
                f"{spec!r}: expected LINKER@RECONSTRUCTION, as shape@radial_rts"
            )
        for plugin in plugins.resolve_plugins("attacks", name):
            links_people = attack_kind(plugin.instance) == "linkage"
            if not separator and not links_people:
                attacks[plugin.spec] = plugin
                continue
            for reconstruction in (
                plugins.parse("attacks", smoother) if separator else (None,)
            ):
                if reconstruction and (
                    not links_people
                    or attack_kind(reconstruction.instance) == "linkage"
                ):
                    raise SettingsError(
                        f"{spec!r}: write a linkage attack left of @ and a"
                        " reconstruction attack right of it, as in shape@radial_rts"
                    )
                link = Consumer("linkage", plugin, reconstruction=reconstruction)
                links[link.spec] = link
    return tuple(attacks.values()), tuple(links.values())


def _assign_links(
    settings: Settings,
    *,
    links: tuple[Consumer, ...],
    asked: tuple[Task, ...],
) -> tuple[tuple[Task, Consumer], ...]:
    """Return the linkers of each task; a linker that suits no task runs where it can.

    `asked` are the tasks of a run. That of people who come back has linkers of its own,
    so that these may be named without another task. A linker that needs the true frame
    suits tasks that show it, and the others suit the other tasks. A linker that needs
    ``same_stretch`` of a walk, or a gap to bridge (``across_gap``), suits the tasks that
    have it.
    """
    tasks = tuple(task for task in asked if task is not RETURNS)
    fused = FUSED if RETURNS in asked else ()
    chosen: dict[str, list[Task]] = {}
    _, named_links = _parse_attacks(settings.choice("attacks").named)
    must_run = {link.spec for link in named_links}
    for link in links:
        possible = [
            task for task in tasks if _granted(link, task, settings.adversaries)
        ]
        linker = link.plugins[0].instance
        suited = [
            task
            for task in possible
            if task.shows_scene == (Knowledge.SCENE in linker.requires)
        ]
        if links_same_stretch(linker):
            suited = [task for task in suited if task.is_same_stretch]
        if getattr(linker, "across_gap", False):
            suited = [task for task in suited if task.is_open]
        chosen[link.spec] = suited or possible
        if link.spec in must_run and not possible and link.spec not in fused:
            required = (
                ", ".join(sorted(knowledge.name for knowledge in link.requires))
                or "a task"
            )
            task_names = ", ".join(task.name for task in tasks) or "none"
            own = f"; task {RETURNS.name} has {', '.join(fused)} alone" if fused else ""
            raise SettingsError(
                f"attack {link.spec!r} has no task to run in (tasks: {task_names}); it"
                f" requires {required}{own}"
            )
    must_link = settings.choice("tasks").named
    for task in tasks:
        if task.name in must_link and not any(
            task in link_tasks for link_tasks in chosen.values()
        ):
            raise SettingsError(
                f"task {task.name} has no attack that can run in it; name one with"
                " --attack"
            )
    return tuple(
        (task, link) for task in tasks for link in links if task in chosen[link.spec]
    )
