"""Cards of the board, made: the scores of entries under a protocol and a seed."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np

import isac_track
from evaluation.api.card_entries import CardEntry, Seed, card_entry
from evaluation.api.run_results import limit_threads
from evaluation.compute.board import (
    attack_scores,
    board_setup,
    hidden_message,
    policy_scores,
)
from evaluation.compute.log_attacks import LogAttack, log_attack
from evaluation.compute.patrols import PatrolSetup, SharedPatrol, share_level
from evaluation.estimates.board_places import cut_digests
from evaluation.estimates.cards import card_score, primary_scores
from evaluation.plan.protocol import Protocol, read_protocol
from evaluation.plan.source_digest import source_digest
from evaluation.store.cards import (
    Card,
    CardDigits,
    CardPlugin,
    card_file_name,
    read_card,
    seed_label,
    write_card,
)
from isac_track import datasets
from isac_track.errors import DataError, SettingsError
from isac_track.plugins import Plugin, parse_all

_CODE: Final = ("evaluation.compute.board", "evaluation.estimates.cards")
"""Modules that all numbers of a card come from, beside its plug-ins and robots."""


@dataclass(eq=False, slots=True)
class CardMaker:
    """Makes the cards of entries under one protocol, seed and list of attacks.

    It holds the patrols of one recording and law, and the mechanism that was shared
    last; both are replaced by the next.
    """

    seed: Seed
    attacks: Sequence[Plugin] = ()  # Beside those of the protocol.
    protocol: Protocol = field(default_factory=read_protocol)
    _setups: dict[tuple[str, str], PatrolSetup] = field(
        default_factory=dict, init=False
    )
    _shared: dict[tuple[str, str, str, str], SharedPatrol] = field(
        default_factory=dict, init=False
    )

    def check(self, entries: Iterable[CardEntry]) -> None:
        """Raise SettingsError for an entry or attack that the protocol cannot score."""
        self.all_attacks()
        for entry in entries:
            self.protocol.recording_digest(entry.recording)
            self.protocol.stages(entry.law)
            if getattr(entry.mechanism.instance, "withholds", False):
                raise SettingsError(
                    f"{entry.mechanism.spec} leaves samples out, which on patrols a"
                    " policy does: give --policy instead"
                )

    def all_attacks(self) -> list[LogAttack]:
        """Return all attacks, each once; SettingsError for one that cannot run here."""
        named = [*self.protocol.attacks, *(plugin.spec for plugin in self.attacks)]
        return [log_attack(plugin) for plugin in parse_all("attacks", named)]

    def card(self, entry: CardEntry, *, beside: Sequence[Plugin] = ()) -> Card:
        """Return the card of an entry.

        `beside` are further policies with the same mechanism: the people of a query are
        gathered once for all of them.
        """
        with limit_threads(), np.errstate(all="warn", under="ignore"):
            shared = self.share(entry, beside)
            attacks = self.all_attacks()
            scores = policy_scores(
                shared,
                entry.policy,
                robots=parse_all("predictors", self.protocol.robots),
                attacks=attacks,
            )
        message, digits = hidden_message(shared), None
        if message is not None:
            digits = CardDigits(
                explained=message.explained,
                place=message.place,
                target=message.target,
                is_message=message.is_message,
            )
        plain = [card_score(score.metric, score.by, score.estimate) for score in scores]
        return Card(
            protocol_version=self.protocol.version,
            protocol_digest=self.protocol.digest,
            recording=entry.recording,
            recording_digest=self.protocol.recording_digest(entry.recording),
            law=entry.law,
            mechanism=card_plugin(entry.mechanism, protects=entry.mechanism.protects),
            mechanism_name=entry.mechanism.name,
            level=entry.mechanism.level,
            policy=card_plugin(
                entry.policy,
                protects=bool(getattr(entry.policy.instance, "protects", True)),
            ),
            form=entry.policy.instance.form,
            seed=None if self.seed.is_secret else self.seed.value,
            seed_commitment=self.seed.commitment(self.protocol),
            scores=tuple(plain),
            primary=primary_scores(plain, self.protocol),
            attacks=tuple(map(card_attack, attacks)),
            digits=digits,
            code_digest=code_digest(self.protocol.robots),
            environment=environment(),
        )

    def with_new_attacks(self, card: Card, entry: CardEntry) -> Card:
        """Return a card with the scores of the further attacks, and new primary scores.

        The other scores stay as they are.
        """
        known = {attack.spec for attack in card.attacks}
        new = [item for item in self.all_attacks() if item.plugin.spec not in known]
        if not new:
            return card
        with limit_threads(), np.errstate(all="warn", under="ignore"):
            scores = attack_scores(self.share(entry), entry.policy, new)
        plain = [card_score(score.metric, score.by, score.estimate) for score in scores]
        together = (*card.scores, *plain)
        return replace(
            card,
            scores=together,
            primary=primary_scores(together, self.protocol),
            attacks=(*card.attacks, *map(card_attack, new)),
        )

    def share(self, entry: CardEntry, beside: Sequence[Plugin] = ()) -> SharedPatrol:
        """Return the patrol of an entry, shared with its mechanism."""
        world = entry.recording, entry.law
        if world not in self._setups:
            self._setups = {world: self._setup(entry)}
            self._shared = {}
        mechanism = entry.mechanism
        key = (*world, mechanism.spec, mechanism.origin)
        if key not in self._shared:
            policies = [entry.policy, *beside]
            self._shared = {key: share_level(mechanism, self._setups[world], policies)}
        return self._shared[key]

    def _setup(self, entry: CardEntry) -> PatrolSetup:
        expected = self.protocol.recording_digest(entry.recording)
        stages = self.protocol.stages(entry.law)
        dataset = datasets.load(entry.recording)
        if dataset.sha256 != expected:
            ours, others = cut_digests(dataset.sha256, expected)
            raise DataError(
                f"{entry.recording} at {dataset.path} has the sha256 {ours}, and"
                f" protocol {self.protocol.version} has {others}; get the file anew"
            )
        return board_setup(dataset.tracks, stages=stages, seed=self.seed.value)


def card_plugin(plugin: Plugin, *, protects: bool = True) -> CardPlugin:
    """Return a plug-in as a card names it."""
    digest = source_digest(plugin.origin.partition(":")[0])
    return CardPlugin(plugin.spec, digest, protects=protects)


def card_attack(attack: LogAttack) -> CardPlugin:
    """Return an attack as a card names it."""
    return replace(card_plugin(attack.plugin), adversary=attack.adversary)


# By robots; sources do not change while a process runs.
@cache
def code_digest(robots: tuple[str, ...]) -> str:
    """Return the sha256 of the source of robots and of the project's computations."""
    origins = [robot.origin for robot in parse_all("predictors", robots)]
    modules = [*_CODE, *(origin.partition(":")[0] for origin in origins)]
    digests = "".join(map(source_digest, modules))
    return hashlib.sha256(digests.encode()).hexdigest()


def environment() -> dict[str, str]:
    """Return what bits may depend on beside code, data and seed."""
    return {
        "isac_track": isac_track.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": f"{platform.system()} {platform.machine()}",
    }


def is_of_this_code(card: Card, maker: CardMaker) -> bool:
    """Whether a card is of the code, the plug-ins and the machine of this process."""
    entry = card_entry(card)
    return (
        card.protocol_digest == maker.protocol.digest
        and card.code_digest == code_digest(maker.protocol.robots)
        and card.environment == environment()
        and card.mechanism.digest == card_plugin(entry.mechanism).digest
        and card.policy.digest == card_plugin(entry.policy).digest
        and {*card.attacks} <= {*map(card_attack, maker.all_attacks())}
    )


def make_cards(
    maker: CardMaker, entries: Iterable[CardEntry], *, folder: Path
) -> Iterator[tuple[Card, Path]]:
    """Write the card of each entry into a folder, and yield card and path.

    A card that the same code, plug-ins, attacks and environment have made stays as it
    is.
    """
    ordered = sorted(
        entries, key=lambda entry: (entry.recording, entry.law, entry.mechanism.spec)
    )
    for _, group in groupby(
        ordered, key=lambda entry: (entry.recording, entry.law, entry.mechanism.spec)
    ):
        same = list(group)
        policies = [entry.policy for entry in same]
        for entry in same:
            path = folder / _file_name(maker, entry)
            card = _reusable_card(path, maker, entry)
            if card is None:
                card = maker.card(entry, beside=policies)
                path = write_card(card, folder)
            yield card, path


def _file_name(maker: CardMaker, entry: CardEntry) -> str:
    seed = None if maker.seed.is_secret else maker.seed.value
    label = seed_label(seed, maker.seed.commitment(maker.protocol))
    return card_file_name(
        entry.recording, entry.law, entry.mechanism.spec, entry.policy.spec, label
    )


def _reusable_card(path: Path, maker: CardMaker, entry: CardEntry) -> Card | None:
    """Return the card of a file if it is of an entry and of the same inputs."""
    try:
        card = read_card(path)
    except DataError:
        return None  # Missing or broken: it is made anew.
    is_same = (
        card.file_name == path.name == _file_name(maker, entry)
        and card.seed_commitment == maker.seed.commitment(maker.protocol)
        and is_of_this_code(card, maker)
        and card.attacks == tuple(map(card_attack, maker.all_attacks()))
    )
    return card if is_same else None
