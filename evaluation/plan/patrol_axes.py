"""The axes of patrols: policies that answer robots, and adversaries with the log."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from evaluation.plan.constants import ORACLE
from evaluation.plan.consumer import Consumer
from evaluation.plan.presets import Preset
from evaluation.plan.settings import Settings
from evaluation.plan.world import OWN_WORLD, World
from isac_track import plugins
from isac_track.errors import SettingsError
from isac_track.patrols import forecast_instants
from isac_track.plugins import Plugin
from isac_track.policies.query import check_reach
from isac_track.policies.samples import Ahead
from isac_track.policies.summaries import State

_LOG_ADVERSARIES: Final = ("blind", "informed", ORACLE)
"""Adversaries with a log: the informed knows routes and policy, the oracle knows
which answers are about the same person."""
_QUICK_LOG_ADVERSARIES: Final = ("blind", ORACLE)


@dataclass(frozen=True, slots=True)
class PatrolAxes:
    """The robots on patrol, the policies that answer them, and the log's adversaries."""

    policies: tuple[Plugin, ...] = ()
    """Disclosure policies; without any there are no patrols."""
    mechanisms: tuple[Plugin, ...] = ()
    """Mechanisms whose releases the policies answer from."""
    robots: tuple[Plugin, ...] = ()
    """Predictors of the robots."""
    has_informed_log: bool = True
    """Whether an informed adversary reads the logs, too."""

    def consumers(self, world: World = OWN_WORLD) -> tuple[Consumer, ...]:
        """Return the consumers in a world: robots, and adversaries with a log.

        Logs belong to no further horizon.
        """
        consumers = [Consumer("patrol", plugin, world=world) for plugin in self.robots]
        if world == OWN_WORLD:
            adversaries = (
                _LOG_ADVERSARIES if self.has_informed_log else _QUICK_LOG_ADVERSARIES
            )
            consumers += [Consumer("log", adversary=name) for name in adversaries]
        return tuple(
            replace(consumer, policy=policy)
            for policy in self.policies
            for consumer in consumers
        )


def expand_patrols(
    settings: Settings,
    preset: Preset,
    *,
    policies: tuple[Plugin, ...],
    mechanisms: Iterable[Plugin],
    robots: tuple[Plugin, ...],
) -> PatrolAxes:
    """Return the axes of patrols.

    Their mechanisms are the preset's for patrols, and those that a user names together
    with a policy. Raises SettingsError for a policy that does not fit.
    """
    _check_policies(policies, settings)
    patrolled: tuple[Plugin, ...] = ()
    if policies:
        patrolled = select_patrolled(
            settings,
            preset,
            mechanisms,
            includes_named=bool(settings.choice("policies").named),
        )
    return PatrolAxes(policies, patrolled, robots, preset.has_informed_log)


def select_patrolled(
    settings: Settings,
    preset: Preset,
    mechanisms: Iterable[Plugin],
    *,
    includes_named: bool,
) -> tuple[Plugin, ...]:
    """Return the mechanisms of patrolled recordings: the preset's, and those named.

    A mechanism that withholds samples is left out: on patrols that is a policy's part.
    """
    specs = set(preset.patrol_mechanisms)
    if includes_named:
        named = plugins.parse_all("mechanisms", settings.choice("mechanisms").named)
        specs.update(plugin.spec for plugin in named)
    return tuple(
        plugin
        for plugin in mechanisms
        if plugin.spec in specs and not getattr(plugin.instance, "withholds", False)
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
