"""What a run crosses: the levels and consumers that its settings expand to."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import RETURNS, Task, task_named
from evaluation.plan.address import track_release_text
from evaluation.plan.constants import ORACLE, OTHER_LAW
from evaluation.plan.consumer import Consumer, windows_consumer
from evaluation.plan.linkers import assign_links, granted_knowledge, parse_attacks
from evaluation.plan.presets import (
    PRESETS,
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
from isac_track.protocols import USUAL, grants
from isac_track.types import Knowledge

ORACLE_TRACKER: Final = "oracle"
"""Tracker that knows who is behind each detection."""
HANDOVER: Final = "handover"
"""Family of the tasks in which tracks are linked."""
LOG_ADVERSARIES: Final = ("blind", "informed", ORACLE)
"""Adversaries with a log: the informed knows routes and policy, the oracle knows
which answers are about the same person."""
_QUICK_LOG_ADVERSARIES: Final = ("blind", ORACLE)


@dataclass(frozen=True, slots=True)
class Axes:
    """The axes of a run, which crosses every mechanism level with every consumer."""

    mechanisms: tuple[Plugin, ...]
    predictors: tuple[Plugin, ...]
    attacks: tuple[Plugin, ...]
    """Reconstruction attacks."""
    links: tuple[tuple[Task, Consumer], ...] = ()
    """Linkers by task; `task_consumers` adds the adversaries."""
    ceiling: Plugin | None = None
    """A mechanism without any error: every linkage attack must succeed."""
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Linkage that is left out, with the reasons: by task, or by people of a task."""
    utility_predictors: frozenset[str] = frozenset()
    """SPECs of predictors that are read in all scenes."""
    mechanisms_by_world: Mapping[World, tuple[Plugin, ...]] = field(
        default_factory=dict
    )
    """Mechanisms whose scenes are attacked in others of `WORLDS`, too."""
    runs_slow_attacks_in_worlds: bool = False
    """Whether attacks that take long run in these worlds, too."""
    linked_mechanisms_by_world: Mapping[World, tuple[Plugin, ...]] = field(
        default_factory=dict
    )
    """The worlds where people are linked, and the mechanisms there."""
    horizons_s: tuple[float, ...] = ()
    """Further horizons, a world each, where predictors alone read, in all scenes."""
    adversaries: tuple[str, ...] = ()
    """Adversaries beside the usual adversaries."""
    has_only_stronger: bool = False
    """Whether only `adversaries` read: on a few levels, after all others."""
    slow_error_attacks: frozenset[str] = frozenset()
    """SPECs of attacks that run only against mechanisms whose error changes slowly."""
    skips_oracle: bool = False
    """Whether the oracle attacks only where no lesser adversary can."""
    policies: tuple[Plugin, ...] = ()
    """Disclosure policies on patrols."""
    patrol_mechanisms: tuple[Plugin, ...] = ()
    """Mechanisms that patrols are shared with."""
    has_informed_log: bool = True
    """Whether an informed adversary reads the logs of patrols, too."""
    why_no_scenes: str = ""
    """Why a run has no scenes: too few tracks are long enough. Empty if it has any."""
    links_returns: bool = False
    """Whether people who come back are linked, wherever a recording has any."""
    track_releases: tuple[Plugin, ...] = ()
    """Trackers of a network's detections; the SPEC is that of the release."""
    track_mechanisms: tuple[Plugin, ...] = ()
    """Mechanisms of these releases."""
    track_policies: tuple[Plugin, ...] = ()
    """Policies that answer from tracks, too."""
    track_tasks: tuple[str, ...] = ()
    """Tasks in which tracks are linked, too."""

    def _adversaries_that_attack(
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
            for adversary, granted in self._adversaries_that_attack(
                grants(plugin.instance, asked=self.adversaries)
            )
            if not self.has_only_stronger or adversary in self.adversaries
        )
        if self.has_only_stronger or self.why_no_scenes:
            return attacks
        robots = tuple(Consumer("predictor", plugin) for plugin in self.predictors)
        bound = (Consumer("bound"),) if self.attacks else ()
        return (Consumer("shared"), *robots, *attacks, *bound)

    def reads_mechanism(self, consumer: Consumer, mechanism: Plugin) -> bool:
        """Whether a consumer reads the releases of a mechanism."""
        needs_slow_error = False
        if consumer.kind == "attack":
            needs_slow_error = consumer.spec in self.slow_error_attacks
        elif consumer.kind == "bound":
            # Where no attack runs, a bound has nothing to be compared with.
            needs_slow_error = all(
                attack.spec in self.slow_error_attacks for attack in self.attacks
            )
        std_m, tau_s = added_error(mechanism.instance)
        return not needs_slow_error or (std_m > 0.0 and tau_s > 0.0)

    def consumers_in(self, world: World) -> tuple[Consumer, ...]:
        """Return the consumers in another world: no robot predicts a model's walks."""
        return tuple(
            replace(consumer, world=world)
            for consumer in self.consumers
            if (self.runs_slow_attacks_in_worlds or not consumer.is_slow)
            and (world == OTHER_LAW_WORLD or consumer.kind in {"attack", "bound"})
        )

    def robots_at(self, horizon_s: float) -> tuple[Consumer, ...]:
        """Return the predictors at a further horizon: those read in all scenes."""
        return tuple(
            replace(consumer, world=World(horizon_s=horizon_s))
            for consumer in self.consumers
            if consumer.kind == "predictor" and consumer.spec in self.utility_predictors
        )

    def patrol_consumers(self, world: World = OWN_WORLD) -> tuple[Consumer, ...]:
        """Return the consumers of patrols in a world: robots, and adversaries with a log.

        The robots are the predictors that are read in all scenes. Logs belong to no
        further horizon.
        """
        robots = [
            Consumer("patrol", plugin, world=world)
            for plugin in self.predictors
            if plugin.spec in self.utility_predictors
        ]
        adversaries = (
            LOG_ADVERSARIES if self.has_informed_log else _QUICK_LOG_ADVERSARIES
        )
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
            if plugin.spec in self.utility_predictors
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
            why_no_scenes=why,
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
                for adversary, granted in self._adversaries_that_attack(
                    granted_knowledge(link, task, self.adversaries)
                )
            ),
        )


def expand_axes(settings: Settings) -> Axes:
    """Return the plug-ins of a run, each once.

    Raises SettingsError if a SPEC is wrong, no mechanism is left, or a task and the
    attacks do not fit, and PluginError if a named plug-in cannot be loaded.
    """
    preset = PRESETS[settings.preset]
    names = _axis_names(settings, preset)
    further_attacks = _further_attacks(settings, preset)
    attacks, links = parse_attacks(names["attacks"] + further_attacks.specs)
    mechanisms = plugins.parse_all("mechanisms", names["mechanisms"])
    predictors = plugins.parse_all("predictors", names["predictors"])
    tasks = tuple(task_named(name) for name in dict.fromkeys(names["tasks"]))
    pairs = assign_links(settings, links=links, asked=tasks)
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
        worlds = _mechanisms_by_world(
            mechanisms, preset, law=law, has_attacks=bool(attacks or pairs)
        )
    run_axes = Axes(
        mechanisms,
        predictors,
        attacks,
        pairs,
        ceiling,
        utility_predictors=utility,
        adversaries=_stronger_adversaries(settings, preset),
        skips_oracle=_skips_oracle(settings, preset),
        horizons_s=settings.stages.conflict.horizons_s if utility else (),
        mechanisms_by_world=worlds,
        runs_slow_attacks_in_worlds=settings.preset == "audit",
        slow_error_attacks=frozenset(
            plugin.spec
            for plugin in plugins.parse_all("attacks", further_attacks.slow_error_specs)
        ),
        linked_mechanisms_by_world=_linked_mechanisms_by_world(worlds, preset, law=law),
        policies=policies,
        patrol_mechanisms=_patrol_mechanisms(settings, preset, mechanisms, policies),
        has_informed_log=preset.has_informed_log,
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
        track_mechanisms=_track_mechanisms(settings, preset, run_axes.mechanisms),
        track_policies=_track_policies(settings),
        track_tasks=_track_tasks(settings),
    )


def _skips_oracle(settings: Settings, preset: Preset) -> bool:
    """Whether the oracle attacks only where no lesser adversary can."""
    if not preset.skips_oracle or ORACLE in settings.adversaries:
        return False
    return not (
        preset.oracle_meets_named_attacks and settings.choice("attacks").replaces
    )


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
    includes_named = bool(settings.choice("policies").named)
    return _patrolled_mechanisms(
        settings, preset, mechanisms, includes_named=includes_named
    )


def _patrolled_mechanisms(
    settings: Settings,
    preset: Preset,
    mechanisms: Iterable[Plugin],
    *,
    includes_named: bool,
) -> tuple[Plugin, ...]:
    """Return the mechanisms of patrolled recordings: the preset's, and those named."""
    specs = set(preset.patrol_mechanisms)
    if includes_named:
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
    (oracle,) = plugins.parse("trackers", ORACLE_TRACKER)
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


def _track_mechanisms(
    settings: Settings, preset: Preset, mechanisms: Iterable[Plugin]
) -> tuple[Plugin, ...]:
    """Return the mechanisms of a run that tracks are shared with.

    They are those of the preset's patrols, and those that a user names. A mechanism
    that withholds samples is left out.
    """
    return _patrolled_mechanisms(settings, preset, mechanisms, includes_named=True)


class _FurtherAttacks(NamedTuple):
    """SPECs of attacks beside the named attacks and the preset's own."""

    specs: tuple[str, ...] = ()
    slow_error_specs: tuple[str, ...] = ()
    """Those of them that run only against an error that changes slowly."""


def _further_attacks(settings: Settings, preset: Preset) -> _FurtherAttacks:
    """Return the further attacks; a user who names the attacks of a run gets none."""
    choice = settings.choice("attacks")
    if choice.replaces:
        return _FurtherAttacks()
    # An attack that is named runs against every mechanism.
    slow_error_specs = tuple(
        spec for spec in preset.slow_error_attacks if spec not in choice.named
    )
    if not _asked_stronger(settings):
        return _FurtherAttacks(slow_error_specs, slow_error_specs)
    return _FurtherAttacks(
        (*slow_error_specs, STRONGEST_ON_SLOW_NOISE),
        tuple(spec for spec in slow_error_specs if spec != STRONGEST_ON_SLOW_NOISE),
    )


def _asked_stronger(settings: Settings) -> list[str]:
    """Return the adversaries that a user names beside the usual three."""
    return [name for name in settings.adversaries if name not in USUAL]


def _mechanisms_by_world(
    mechanisms: Iterable[Plugin], preset: Preset, *, law: str, has_attacks: bool
) -> dict[World, tuple[Plugin, ...]]:
    """Return the mechanisms that are computed in other worlds, by world.

    A run under `OTHER_LAW` has no other law.
    """
    specs_by_world = {
        OTHER_LAW_WORLD: preset.other_law_mechanisms,
        **dict.fromkeys(WORLDS[1:], preset.model_mechanisms),
    }
    return {
        world: tuple(plugin for plugin in mechanisms if plugin.spec in specs)
        for world, specs in specs_by_world.items()
        if (has_attacks or world == OTHER_LAW_WORLD)
        and (law != OTHER_LAW or not world.law)
    }


def _linked_mechanisms_by_world(
    worlds: Mapping[World, tuple[Plugin, ...]], preset: Preset, *, law: str
) -> dict[World, tuple[Plugin, ...]]:
    """Return the mechanisms that are linked in other worlds, by world.

    Only walks of a model with Gaussian errors: else the optimum is not known.
    """
    return {
        world: tuple(
            plugin for plugin in levels if plugin.spec in preset.model_linked_mechanisms
        )
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
