"""Cards of the board: made, verified, and put to new attacks."""

from __future__ import annotations

import hashlib
import platform
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np

import isac_track
from evaluation.api.rebuilding import limit_threads
from evaluation.compute.board import (
    attack_scores,
    board_setup,
    hidden_message,
    policy_scores,
)
from evaluation.compute.log_attacks import LogAttack, log_attack
from evaluation.compute.patrols import PatrolSetup, SharedPatrol, share_level
from evaluation.estimates.cards import (
    Agreement,
    agreement,
    card_score,
    has_own_primary,
    primary_scores,
    same_board,
)
from evaluation.plan.fingerprint import is_user_plugin, source_digest
from evaluation.plan.protocol import Protocol, read_protocol
from evaluation.store.cards import (
    Card,
    CardMessage,
    CardPlugin,
    card_file_name,
    read_card,
    seed_label,
    write_card,
)
from evaluation.store.files import read_regular_file
from evaluation.store.manifest import read_manifest
from isac_track import datasets
from isac_track.errors import DataError, SettingsError
from isac_track.plugins import Plugin, parse, parse_all

_CODE: Final = ("evaluation.compute.board", "evaluation.estimates.cards")
"""Modules that all numbers of a card come from, beside its plug-ins and robots."""
_SECRET: Final = re.compile(r"[0-9a-f]{32,128}")


@dataclass(frozen=True, slots=True)
class Seed:
    """A base seed of all streams, published or secret."""

    value: int
    is_secret: bool = False

    def commitment(self, protocol: Protocol) -> str:
        """Return a digest that binds a card to its seed without showing it."""
        text = f"isac-track protocol {protocol.version} seed {self.value}"
        return hashlib.sha256(text.encode()).hexdigest()


def read_secret_seed(path: Path) -> Seed:
    """Return the seed of a file: at least 32 hexadecimal digits, so nobody guesses it.

    DataError for a file that is missing or holds anything else.
    """
    try:
        text = read_regular_file(path).decode().strip()
    except (OSError, ValueError) as error:
        raise DataError(f"--secret-seed {path} cannot be read: {error}") from None
    if not _SECRET.fullmatch(text):
        raise DataError(
            f"--secret-seed {path} must hold 32 to 128 hexadecimal digits, which"
            " python -c 'import secrets; print(secrets.token_hex(16))' prints"
        )
    return Seed(int(text, 16), is_secret=True)


@dataclass(frozen=True, slots=True)
class Entry:
    """What a card is of: a recording under a law, a mechanism, and a policy."""

    recording: str
    law: str
    mechanism: Plugin
    policy: Plugin


def cross_entries(
    recordings: Iterable[str],
    laws: Iterable[str],
    mechanisms: Sequence[str],
    policies: Sequence[str],
) -> list[Entry]:
    """Return an entry for each combination; a sweep is an entry for each level."""
    shared = parse_all("mechanisms", mechanisms)
    answering = parse_all("policies", policies)
    return [
        Entry(recording, law, mechanism, policy)
        for recording in dict.fromkeys(recordings)
        for law in dict.fromkeys(laws)
        for mechanism in shared
        for policy in answering
    ]


def protocol_entries(
    recordings: Sequence[str], laws: Sequence[str], *, protocol: Protocol
) -> list[Entry]:
    """Return the entries that the protocol names.

    They are all its mechanisms with `everything`, and raw with all its policies.
    """
    entries = cross_entries(recordings, laws, protocol.mechanisms, ["everything"])
    entries += cross_entries(recordings, laws, ["raw"], protocol.policies)
    return list(dict.fromkeys(entries))


def run_entries(out: Path, *, protocol: Protocol) -> tuple[list[Entry], int]:
    """Return the entries of a finished run, and its seed.

    DataError if its recording is not the protocol's.
    """
    manifest = read_manifest(out)
    settings, data = manifest["settings"], manifest["dataset"]
    names = {digest: name for name, digest in protocol.recordings.items()}
    name = names.get(data.get("sha256", ""))
    if name is None:
        raise DataError(
            f"{out}: its recording {data.get('name', '')!r} is not in protocol"
            f" {protocol.version} ({', '.join(protocol.recordings)})"
        )
    entries = cross_entries(
        [name],
        [settings["stages"]["sensing.law"]],
        settings["mechanisms"],
        settings["policies"] or ["everything"],
    )
    return entries, int(settings["seed"])


@dataclass(eq=False, slots=True)
class Maker:
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

    def check(self, entries: Iterable[Entry]) -> None:
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

    def card(self, entry: Entry, *, beside: Sequence[Plugin] = ()) -> Card:
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
        message = hidden_message(shared)
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
            attacks=tuple(map(attack_of_card, attacks)),
            digits=None
            if message is None
            else CardMessage(
                explained=message.explained,
                place=message.place,
                target=message.target,
                is_message=message.is_message,
            ),
            code_digest=code_digest(self.protocol.robots),
            environment=environment(),
        )

    def attacked(self, card: Card, entry: Entry) -> Card:
        """Return a card with the scores of the further attacks, and new primary scores.

        The other scores stay as they are.
        """
        known = {attack.spec for attack in card.attacks}
        new = [item for item in self.all_attacks() if item.plugin.spec not in known]
        with limit_threads(), np.errstate(all="warn", under="ignore"):
            scores = attack_scores(self.share(entry), entry.policy, new)
        plain = [card_score(score.metric, score.by, score.estimate) for score in scores]
        together = (*card.scores, *plain)
        return replace(
            card,
            scores=together,
            primary=primary_scores(together, self.protocol),
            attacks=(*card.attacks, *map(attack_of_card, new)),
        )

    def share(self, entry: Entry, beside: Sequence[Plugin] = ()) -> SharedPatrol:
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

    def _setup(self, entry: Entry) -> PatrolSetup:
        expected = self.protocol.recording_digest(entry.recording)
        stages = self.protocol.stages(entry.law)
        dataset = datasets.load(entry.recording)
        if dataset.sha256 != expected:
            raise DataError(
                f"{entry.recording} at {dataset.path} has the sha256"
                f" {dataset.sha256[:12]}..., and protocol {self.protocol.version} has"
                f" {expected[:12]}...; get the file anew"
            )
        return board_setup(dataset.tracks, stages=stages, seed=self.seed.value)


def card_plugin(plugin: Plugin, *, protects: bool = True) -> CardPlugin:
    """Return a plug-in as a card names it."""
    digest = source_digest(plugin.origin.partition(":")[0])
    return CardPlugin(plugin.spec, digest, protects=protects)


def attack_of_card(attack: LogAttack) -> CardPlugin:
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


def is_of_this_code(card: Card, maker: Maker) -> bool:
    """Whether a card is of the code, the plug-ins and the machine of this process."""
    entry = card_entry(card)
    return (
        card.protocol_digest == maker.protocol.digest
        and card.code_digest == code_digest(maker.protocol.robots)
        and card.environment == environment()
        and card.mechanism.digest == card_plugin(entry.mechanism).digest
        and card.policy.digest == card_plugin(entry.policy).digest
        and {*card.attacks} <= {*map(attack_of_card, maker.all_attacks())}
    )


def make_cards(
    maker: Maker, entries: Iterable[Entry], *, folder: Path
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
            card = _made_before(path, maker, entry)
            if card is None:
                card = maker.card(entry, beside=policies)
                path = write_card(card, folder)
            yield card, path


def _file_name(maker: Maker, entry: Entry) -> str:
    seed = None if maker.seed.is_secret else maker.seed.value
    label = seed_label(seed, maker.seed.commitment(maker.protocol))
    return card_file_name(
        entry.recording, entry.law, entry.mechanism.spec, entry.policy.spec, label
    )


def _made_before(path: Path, maker: Maker, entry: Entry) -> Card | None:
    """Return the card of a file if it is of an entry and of the same inputs."""
    try:
        card = read_card(path)
    except DataError:
        return None  # Missing or broken: it is made anew.
    is_same = (
        card.file_name == path.name == _file_name(maker, entry)
        and card.seed_commitment == maker.seed.commitment(maker.protocol)
        and is_of_this_code(card, maker)
        and card.attacks == tuple(map(attack_of_card, maker.all_attacks()))
    )
    return card if is_same else None


def load_cards(
    paths: Iterable[Path], *, protocol: Protocol | None = None
) -> dict[Path, Card]:
    """Return the cards of files and of folders of cards, checked to fit together.

    DataError, in a line, for a file that is no card of the protocol, and for two cards
    of one entry.
    """
    cards: dict[Path, Card] = {}
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob("*.json"))
            if not inside:
                raise DataError(f"{path} holds no card (*.json)")
            cards |= {item: read_card(item) for item in inside}
        else:
            cards[path] = read_card(path)
    protocol = protocol or read_protocol()
    same_board(cards.values(), protocol)
    for path, card in cards.items():
        if not has_own_primary(card, protocol):
            raise DataError(
                f"{path}: its primary scores do not follow from its scores; the card"
                " was changed"
            )
    first: dict[str, Path] = {}
    for path, card in cards.items():
        other = first.setdefault(card.file_name, path)
        if other != path:
            raise DataError(
                f"{other} and {path} are both of {card.label}; leave out either"
            )
    return cards


def card_entry(card: Card) -> Entry:
    """Return the entry of a card, with the plug-ins of this machine."""
    (mechanism,) = parse("mechanisms", card.mechanism.spec)
    (policy,) = parse("policies", card.policy.spec)
    return Entry(card.recording, card.law, mechanism, policy)


def verify(
    card: Card, *, seed: Seed | None = None, protocol: Protocol | None = None
) -> Agreement:
    """Compute a card again, and return whether it is the same.

    Without a seed it is the card's own. SettingsError if that is secret and was not
    given, or if a plug-in here is not the card's.
    """
    protocol = protocol or read_protocol()
    same_board([card], protocol)
    if seed is None:
        if card.seed is None:
            raise SettingsError(
                f"{card.label}: give its seed by --secret-seed FILE, or another seed by"
                " --seed N"
            )
        seed = Seed(card.seed)
        if seed.commitment(protocol) != card.seed_commitment:
            return Agreement("differs", "the commitment is not that of its seed")
    if not has_own_primary(card, protocol):
        reason = "its primary scores do not follow from its scores"
        return Agreement("differs", reason)
    extra = [
        attack.spec for attack in card.attacks if attack.spec not in protocol.attacks
    ]
    maker = Maker(seed, parse_all("attacks", extra), protocol)
    entry = card_entry(card)
    _refuse_other_plugins(card, [entry.mechanism, entry.policy, *maker.attacks])
    return agreement(card, maker.card(entry), protocol)


def _refuse_other_plugins(card: Card, plugins: Iterable[Plugin]) -> None:
    """Raise SettingsError if a user's plug-in here has another source than a card's."""
    digests = {
        item.spec: item.digest for item in (card.mechanism, card.policy, *card.attacks)
    }
    for plugin in filter(is_user_plugin, plugins):
        if card_plugin(plugin).digest != digests.get(plugin.spec):
            raise SettingsError(
                f"{plugin.spec} here is not the card's: its source has another digest;"
                " get the plug-in that the card was made with"
            )
