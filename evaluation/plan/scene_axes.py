"""The axes of scenes: robots that predict, and attacks that reconstruct positions."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from evaluation.plan.adversaries import Adversaries, named_beyond_usual
from evaluation.plan.constants import OTHER_LAW
from evaluation.plan.consumer import Consumer
from evaluation.plan.presets import (
    STRONGEST_ON_SLOW_NOISE,
    UTILITY_PREDICTORS,
    Preset,
)
from evaluation.plan.settings import Settings
from evaluation.plan.world import OTHER_LAW_WORLD, WORLDS, World
from isac_track import plugins
from isac_track.kalman.slow_errors import added_error
from isac_track.plugins import Plugin
from isac_track.protocols import grants


@dataclass(frozen=True, slots=True)
class SceneAxes:
    """The robots and attacks that read scenes, and the worlds beside the run's own.

    In the run's own world they read every mechanism of the run.
    """

    predictors: tuple[Plugin, ...] = ()
    """Predictors of robots. All of them read the attacked scenes."""
    utility_predictors: tuple[Plugin, ...] = ()
    """Those of them that read all scenes, at every horizon, and patrols."""
    attacks: tuple[Plugin, ...] = ()
    """Reconstruction attacks."""
    slow_error_attacks: frozenset[str] = frozenset()
    """SPECs of attacks that run only against mechanisms whose error changes slowly."""
    adversaries: Adversaries = field(default_factory=Adversaries)
    mechanisms_by_world: Mapping[World, tuple[Plugin, ...]] = field(
        default_factory=dict
    )
    """Mechanisms that are attacked in other `WORLDS`, too."""
    runs_slow_attacks_in_worlds: bool = False
    """Whether attacks that take long run in these worlds, too."""
    why_left_out: str = ""
    """Why a run has no scenes: too few tracks are long enough. Empty if it has any."""

    @property
    def consumers(self) -> tuple[Consumer, ...]:
        """Consumers of the attacked scenes: descriptors, robots, attacks, optimum."""
        if self.why_left_out:
            return ()
        attacks = self._attack_consumers
        if self.adversaries.has_only_further:
            return attacks
        robots = tuple(Consumer("predictor", plugin) for plugin in self.predictors)
        bound = (Consumer("bound"),) if self.attacks else ()
        return (Consumer("shared"), *robots, *attacks, *bound)

    @property
    def _attack_consumers(self) -> tuple[Consumer, ...]:
        """Every attack, once for each adversary that runs it."""
        return tuple(
            Consumer("attack", plugin, adversary=adversary, granted=granted)
            for plugin in self.attacks
            for adversary, granted in self.adversaries.select(
                grants(plugin.instance, asked=self.adversaries.further)
            ).items()
        )

    @property
    def utility_consumers(self) -> tuple[Consumer, ...]:
        """Robots that read all scenes."""
        return tuple(
            Consumer("predictor", plugin) for plugin in self.utility_predictors
        )

    def consumers_at(self, horizon: World) -> tuple[Consumer, ...]:
        """Return the consumers at a further horizon: robots that read all scenes."""
        return tuple(replace(robot, world=horizon) for robot in self.utility_consumers)

    def consumers_in(self, world: World) -> tuple[Consumer, ...]:
        """Return the consumers in another of `WORLDS`.

        No robot predicts the walks of a model.
        """
        return tuple(
            replace(consumer, world=world)
            for consumer in self.consumers
            if (self.runs_slow_attacks_in_worlds or not consumer.is_slow)
            and (world == OTHER_LAW_WORLD or consumer.kind in {"attack", "bound"})
        )

    def reads_mechanism(self, consumer: Consumer, mechanism: Plugin) -> bool:
        """Whether a consumer reads the releases of a mechanism.

        All do, except attacks that are made for slow errors.
        """
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


def expand_scenes(
    settings: Settings,
    preset: Preset,
    *,
    mechanisms: Iterable[Plugin],
    predictors: tuple[Plugin, ...],
    attacks: tuple[Plugin, ...],
    adversaries: Adversaries,
    has_linkers: bool,
) -> SceneAxes:
    """Return the axes of scenes.

    `attacks` has the further attacks, too (`further_attacks`).
    """
    slow_error_specs = further_attacks(settings, preset).slow_error_specs
    slow_error_attacks = plugins.parse_all("attacks", slow_error_specs)
    return SceneAxes(
        predictors=predictors,
        utility_predictors=_utility_predictors(settings, predictors),
        attacks=attacks,
        slow_error_attacks=frozenset(plugin.spec for plugin in slow_error_attacks),
        adversaries=adversaries,
        mechanisms_by_world=_mechanisms_by_world(
            settings, preset, mechanisms, has_attacks=bool(attacks) or has_linkers
        ),
        # An audit compares all attacks with the optimum.
        runs_slow_attacks_in_worlds=settings.preset == "audit",
    )


def _utility_predictors(
    settings: Settings, predictors: Iterable[Plugin]
) -> tuple[Plugin, ...]:
    """Return the predictors that read all scenes: a preset's cheapest, and all named."""
    named = plugins.parse_all("predictors", settings.choice("predictors").named)
    specs = {*UTILITY_PREDICTORS, *(plugin.spec for plugin in named)}
    return tuple(plugin for plugin in predictors if plugin.spec in specs)


@dataclass(frozen=True, slots=True)
class FurtherAttacks:
    """SPECs of attacks that a run adds to the preset's own and to the user's."""

    specs: tuple[str, ...] = ()
    slow_error_specs: tuple[str, ...] = ()
    """Those of them that run only against an error that changes slowly."""


def further_attacks(settings: Settings, preset: Preset) -> FurtherAttacks:
    """Return the further attacks; a user who names the attacks of a run gets none."""
    choice = settings.choice("attacks")
    if choice.replaces:
        return FurtherAttacks()
    # An attack that is named runs against every mechanism.
    slow_error_specs = tuple(
        spec for spec in preset.slow_error_attacks if spec not in choice.named
    )
    if not named_beyond_usual(settings):
        return FurtherAttacks(slow_error_specs, slow_error_specs)
    return FurtherAttacks(
        (*slow_error_specs, STRONGEST_ON_SLOW_NOISE),
        tuple(spec for spec in slow_error_specs if spec != STRONGEST_ON_SLOW_NOISE),
    )


def _mechanisms_by_world(
    settings: Settings,
    preset: Preset,
    mechanisms: Iterable[Plugin],
    *,
    has_attacks: bool,
) -> dict[World, tuple[Plugin, ...]]:
    """Return the mechanisms of other worlds, by world.

    `has_attacks` counts attacks on scenes and linkers: the walks of a model are for
    these alone.
    """
    # A user who names mechanisms has asked for these alone.
    if settings.choice("mechanisms").replaces:
        return {}
    specs_by_world = {
        OTHER_LAW_WORLD: preset.other_law_mechanisms,
        **dict.fromkeys(WORLDS[1:], preset.model_mechanisms),
    }
    # A run under `OTHER_LAW` has no other law.
    has_other_law = settings.stages.sensing.law != OTHER_LAW
    return {
        world: tuple(plugin for plugin in mechanisms if plugin.spec in specs)
        for world, specs in specs_by_world.items()
        if (has_attacks or world == OTHER_LAW_WORLD)
        and (has_other_law or not world.law)
    }
