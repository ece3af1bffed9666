"""Entries that the board scores, by name, of a run or of a card; and their seeds."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from evaluation.store.files import read_regular_file
from evaluation.store.manifest import read_manifest
from isac_track.errors import DataError
from isac_track.plugins import Plugin, parse, parse_all

if TYPE_CHECKING:
    from evaluation.plan.protocol import Protocol
    from evaluation.store.cards import Card

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

    Letters are in lower case: a seed is written in a single way. DataError for a file
    that is missing or holds anything else.
    """
    try:
        text = read_regular_file(path).decode().strip()
    except (OSError, ValueError) as error:
        raise DataError(f"--secret-seed {path} cannot be read: {error}") from None
    if not _SECRET.fullmatch(text):
        raise DataError(
            f"--secret-seed {path} must hold 32 to 128 lower-case hexadecimal digits,"
            " which python -c 'import secrets; print(secrets.token_hex(16))' prints"
        )
    return Seed(int(text, 16), is_secret=True)


@dataclass(frozen=True, slots=True)
class CardEntry:
    """The subject of a card: a recording under a law, a mechanism, and a policy."""

    recording: str
    law: str
    mechanism: Plugin
    policy: Plugin


def cross_entries(
    recordings: Iterable[str],
    laws: Iterable[str],
    mechanisms: Sequence[str],
    policies: Sequence[str],
) -> list[CardEntry]:
    """Return an entry for each combination; a sweep is an entry for each level."""
    shared = parse_all("mechanisms", mechanisms)
    answering = parse_all("policies", policies)
    return [
        CardEntry(recording, law, mechanism, policy)
        for recording in dict.fromkeys(recordings)
        for law in dict.fromkeys(laws)
        for mechanism in shared
        for policy in answering
    ]


def protocol_entries(
    recordings: Sequence[str], laws: Sequence[str], *, protocol: Protocol
) -> list[CardEntry]:
    """Return the entries that the protocol names.

    They are all its mechanisms with `everything`, and raw with all its policies.
    """
    entries = cross_entries(recordings, laws, protocol.mechanisms, ["everything"])
    entries += cross_entries(recordings, laws, ["raw"], protocol.policies)
    return list(dict.fromkeys(entries))


def run_entries(out: Path, *, protocol: Protocol) -> tuple[list[CardEntry], int]:
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


def card_entry(card: Card) -> CardEntry:
    """Return the entry of a card, with the plug-ins of this machine."""
    (mechanism,) = parse("mechanisms", card.mechanism.spec)
    (policy,) = parse("policies", card.policy.spec)
    return CardEntry(card.recording, card.law, mechanism, policy)
