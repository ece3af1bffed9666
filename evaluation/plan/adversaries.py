"""The adversaries of a run: the usual three, and those that it adds."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from evaluation.plan.constants import ORACLE
from evaluation.plan.consumer import Consumer
from evaluation.plan.presets import STRONGEST_ON_SLOW_NOISE, Preset
from evaluation.plan.settings import Settings
from isac_track.errors import SettingsError
from isac_track.protocols import USUAL
from isac_track.types import Knowledge


@dataclass(frozen=True, slots=True)
class Adversaries:
    """The adversaries for whom the attacks of a run are computed.

    Blind, informed and oracle are the usual three. `isac_track.protocols.grants` says
    what each adversary knows.
    """

    further: tuple[str, ...] = ()
    """Adversaries that the user or the preset names beside the usual three."""
    has_only_further: bool = False
    """Whether these alone attack, because the usual three did so in an earlier plan."""
    skips_oracle: bool = False
    """Whether the oracle, a reference, attacks only where no lesser adversary can."""

    def select(
        self, granted: Mapping[str, frozenset[Knowledge]]
    ) -> dict[str, frozenset[Knowledge]]:
        """Return the adversaries who run an attack, with the knowledge of each.

        `granted` has all adversaries who could run it.
        """
        without_oracle = self.skips_oracle and len(granted) > 1
        return {
            name: knowledge
            for name, knowledge in granted.items()
            if not (without_oracle and name == ORACLE)
            if not self.has_only_further or name in self.further
        }


def expand_adversaries(settings: Settings, preset: Preset) -> Adversaries:
    """Return the adversaries of a run."""
    replaces_attacks = settings.choice("attacks").replaces
    preset_names = () if replaces_attacks else preset.adversaries
    return Adversaries(
        further=tuple(dict.fromkeys((*settings.adversaries, *preset_names))),
        skips_oracle=(
            preset.skips_oracle
            and ORACLE not in settings.adversaries
            and not (preset.oracle_meets_named_attacks and replaces_attacks)
        ),
    )


def named_beyond_usual(settings: Settings) -> list[str]:
    """Return the adversaries that the user names, without the usual three."""
    return [name for name in settings.adversaries if name not in USUAL]


def check_adversaries_attack(settings: Settings, consumers: Iterable[Consumer]) -> None:
    """Raise SettingsError if no attack uses the knowledge of an adversary.

    `consumers` are all consumers of scenes and of linkage tasks.
    """
    attacking = {consumer.adversary for consumer in consumers}
    for name in sorted(set(named_beyond_usual(settings)) - attacking):
        raise SettingsError(
            f"adversary {name}: no attack of the run uses its knowledge; name one that"
            f" does, such as --attack {STRONGEST_ON_SLOW_NOISE}"
        )
