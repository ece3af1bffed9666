"""Entries of a run's manifest as records: its cells, and its failed cells.

The texts of the file become addresses once, when the manifest is opened. In the file an
entry has the fields of its mechanism level and those of its consumer, each by name.
Two fields of the file have another name in the code: `knowledge` is `adversary`, and
`slow` is `is_slow`. The file has the names of earlier versions.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from evaluation.plan.address import Address, parse_row

if TYPE_CHECKING:
    from evaluation.plan.consumer import Consumer
    from evaluation.plan.world import World
    from isac_track.plugins import Plugin

FAILED_COLUMNS: Final = (
    "spec",
    "kind",
    "consumer",
    "knowledge",
    "block",
    "why",
    "policy",
    "world",
)
"""Columns of `failed.csv`."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A consumer at a mechanism level, and the files that hold its rows."""

    address: Address  # Without recording and metric.
    kind: str  # Of the consumer: `shared`, `predictor`, `attack`, `linkage`, ...
    spec: str  # SPEC of the mechanism, with its level.
    family: str = ""  # Of the mechanism.
    protects: bool = True  # Whether the mechanism claims to protect.
    is_slow: bool = False  # Whether the consumer sees one release of each track only.
    files: tuple[str, ...] = ()  # Names in the folder of cells, block by block.

    @property
    def label(self) -> str:
        """Name of the consumer in the files."""
        return self.address.cell_label

    @property
    def cell(self) -> tuple[str, str]:
        """SPEC of the mechanism and label of the consumer: unique in a manifest."""
        return self.spec, self.label

    def level_fields(self) -> dict[str, Any]:
        """Return the fields in the file that all consumers of a level share."""
        return {
            "mechanism": self.address.mechanism,
            "level": self.address.level,
            "family": self.family,
            "adding": self.address.adding,
            "protects": self.protects,
            "spec": self.spec,
            "files": list(self.files),
        }

    def consumer_fields(self) -> dict[str, Any]:
        """Return the fields in the file of the consumer."""
        return {
            "kind": self.kind,
            "consumer": self.address.consumer,
            "knowledge": self.address.adversary,
            "slow": self.is_slow,
            "world": self.address.world.text,
            "policy": self.address.policy,
        }


@dataclass(frozen=True, slots=True)
class FailedEntry:
    """A cell that could not be computed."""

    address: Address  # Of the consumer alone; the level is in `spec`.
    kind: str  # As in `Entry`.
    spec: str  # SPEC of the mechanism, with its level.
    block: int  # Of scenes; 0 for a linkage task.
    why: str

    @property
    def cell(self) -> tuple[str, str]:
        """SPEC of the mechanism and label of the consumer, as in `Entry`."""
        return self.spec, self.address.cell_label

    def fields(self) -> dict[str, Any]:
        """Return the fields in the file."""
        return {
            "spec": self.spec,
            "consumer": self.address.consumer,
            "kind": self.kind,
            "knowledge": self.address.adversary,
            "world": self.address.world.text,
            "policy": self.address.policy,
            "block": self.block,
            "why": self.why,
        }


class _HasCell(Protocol):
    @property
    def cell(self) -> tuple[str, str]: ...


_AnyEntry = TypeVar("_AnyEntry", bound=_HasCell)


def make_entry(
    mechanism: Plugin, consumer: Consumer, *, files: Iterable[str] = ()
) -> Entry:
    """Return the entry of a consumer of a plan at a level of a mechanism."""
    address = consumer.address.at(
        mechanism.name, mechanism.level, adding=mechanism.adding
    )
    return Entry(
        address=address,
        kind=consumer.kind_in_files,
        spec=mechanism.spec,
        family=mechanism.family,
        protects=mechanism.protects,
        is_slow=consumer.is_slow,
        files=tuple(files),
    )


def parse_entries(
    levels: Iterable[Mapping[str, Any]],
    consumers: Sequence[Sequence[Mapping[str, Any]]],
) -> list[Entry]:
    """Return the entries of a manifest's file: each level with all of its consumers.

    A level names its set of consumers by a number, its place in `consumers`.
    """
    # Hundreds of levels share a set: each text becomes an address once.
    sets = [
        [(parse_row(consumer), consumer) for consumer in group] for group in consumers
    ]
    entries = []
    for level in levels:
        at_level = parse_row({name: level[name] for name in ("mechanism", "level")})
        files = tuple(level["files"])
        for reader, consumer in sets[level["consumers"]]:
            address = reader.at(
                at_level.mechanism, at_level.level, adding=level["adding"]
            )
            entries.append(
                Entry(
                    address=address,
                    kind=consumer["kind"],
                    spec=level["spec"],
                    family=level["family"],
                    protects=level["protects"],
                    is_slow=bool(consumer["slow"]),
                    files=files,
                )
            )
    return entries


def parse_failed(rows: Iterable[Mapping[str, Any]]) -> list[FailedEntry]:
    """Return the failed cells of a manifest's file."""
    return [
        FailedEntry(
            address=parse_row(row),
            kind=row["kind"],
            spec=row["spec"],
            block=row["block"],
            why=row["why"],
        )
        for row in rows
    ]


def entries_without(
    entries: Iterable[_AnyEntry], excluded: Iterable[_HasCell]
) -> list[_AnyEntry]:
    """Return the entries whose cells are not among those of the excluded entries."""
    cells = {entry.cell for entry in excluded}
    return [entry for entry in entries if entry.cell not in cells]


def entries_in(
    entries: Iterable[Entry], world: World, *, kinds: Collection[str]
) -> list[Entry]:
    """Return the entries of some kinds in a world, in their order."""
    return [
        entry
        for entry in entries
        if entry.kind in kinds and entry.address.world == world
    ]


def horizons_in(entries: Iterable[Entry]) -> list[float]:
    """Return the further horizons of a run, s, ascending, from its entries."""
    horizons_s = {entry.address.world.horizon_s for entry in entries}
    return sorted(horizon_s for horizon_s in horizons_s if horizon_s is not None)
