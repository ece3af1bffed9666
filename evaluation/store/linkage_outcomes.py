"""Outcomes of linkage attacks and controls, from the cells of a run folder.

A cell has the ranks of its probes. Replicates of rank metrics are computed from these
while they are read: stored they would take most of a run's disk.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from evaluation.compute.link_setup import linkage_weights
from evaluation.compute.link_tables import (
    ABOUT,
    ASSIGNED,
    COMPANIONS,
    DERIVED,
    ESTIMATES,
    REPLICATES,
)
from evaluation.compute.tables import ROWS
from evaluation.store.cell_files import (
    check_columns,
    consumer_tables,
    read_units,
    readable,
)
from evaluation.store.people import read_labels
from isac_track.intervals import Estimate, effective_clusters
from isac_track.linkability.scoring import RANK_METRICS, ProbeRanks
from isac_track.types import Floats, Ints

if TYPE_CHECKING:
    import pyarrow as pa

    from evaluation.store.entries import Entry

_COUNTED: Final = ("above", "tied", "chance", *COMPANIONS)
_OUTCOME: Final = (
    "metric",
    "group",
    "assigned",
    *_COUNTED,
    "about",
    "value",
    "ci_low",
    "ci_high",
    "n",
)
"""Columns of a linkage cell beside its replicates."""
_NONE: Final[Floats] = np.zeros(0, dtype=np.float32)


class ClusterSums(NamedTuple):
    """A metric that is a ratio of sums over people, by cluster."""

    sums: Floats  # (2, U) numerator and denominator within each cluster that has any.
    weights: Floats  # (B, C) how often each cluster is drawn.
    used: Ints | slice = slice(None)  # (U,) places among the C clusters.
    # (C,) names of the clusters; empty: their names are their numbers.
    names: tuple[str, ...] = ()

    @property
    def clusters(self) -> tuple[str, ...]:
        """Names of all clusters, (C,)."""
        return self.names or tuple(map(str, range(self.weights.shape[1])))

    def whole(self) -> Floats:
        """Return the sums of all clusters, (2, C)."""
        sums = np.zeros((2, self.weights.shape[1]))
        sums[:, self.used] = self.sums
        return sums


@dataclass(frozen=True, eq=False, slots=True)
class LinkageOutcome:
    """Estimates of a linkage attack, or of a control, at one level."""

    estimates: Mapping[str, Estimate]  # By metric.
    # All other numbers of the `isac_track.linkability.Scorecard`, by its names.
    numbers: Mapping[str, Any]
    cohorts: Mapping[str, Mapping[str, Any]]
    """Without confounders, by name: rank1, ci_low, ci_high, chance, p_rank1, n_mated,
    n_clusters."""
    sums: Mapping[str, ClusterSums] = field(default_factory=dict)
    """Of an attack's rank metrics, by metric."""


def read_outcomes(
    out: Path,
    entries: Iterable[Entry],
    *,
    drawn: Collection[str] | None = None,
) -> list[LinkageOutcome]:
    """Return the outcomes of linkage attacks, or controls, each at one level.

    Entries of one level in one file are read at once if they come one after the other.
    Replicates are in single precision: those of a run would take half a gigabyte in
    double. Only attacks have them, not controls: for the metrics in `drawn`, or for
    every metric that can if it is None. DataError names a cell that is broken.
    """
    columns = None if drawn is None else (*_OUTCOME, *drawn)
    # The weights of a task, shared by its hundreds of cells; they end with this call.
    cached_weights = lru_cache(maxsize=16)(_cluster_weights)
    outcomes: list[LinkageOutcome] = []
    for _, group in groupby(entries, key=attrgetter("spec", "files")):
        file_entries = list(group)
        (file,) = read_units(out, file_entries[0], columns)
        with readable(file.path):
            check_columns(file.table, _OUTCOME, path=file.path)
            tables = [consumer_tables(file, entry).tables for entry in file_entries]
            labels = read_labels(out)
            outcomes += _outcomes(
                file.table, file_entries, tables, drawn, labels, cached_weights
            )
    return outcomes


class _Draws(NamedTuple):
    """All that the bootstrap weights of a task's clusters depend on."""

    drawn_as: tuple[int, ...]  # (C,) row of each cluster among the groups, or -1.
    n_groups: int
    task: str
    seed: int


def _cluster_weights(draws: _Draws) -> Floats:
    """Return how often each cluster is drawn, (B, C)."""
    drawn_as: Ints = np.array(draws.drawn_as)
    return linkage_weights(
        drawn_as, n_groups=draws.n_groups, task=draws.task, seed=draws.seed
    )


@dataclass(frozen=True, eq=False, slots=True)
class _StoredOutcome:
    """The part of a file that belongs to one linkage consumer."""

    about: dict[str, Any]
    estimate_rows: slice
    probe_rows: Ints  # (P,)
    replicates: dict[str, Floats]  # By metric.
    sums: dict[str, ClusterSums] = field(default_factory=dict)


class _Coded(NamedTuple):
    """A column of names."""

    codes: Ints  # (rows,) place in `names`, -1 for none.
    names: list[str]


def _outcomes(
    table: pa.Table,
    entries: Sequence[Entry],
    tables: Sequence[Mapping[str, tuple[int, int]]],
    drawn: Collection[str] | None,
    labels: Mapping[str, str],
    cached_weights: Callable[[_Draws], Floats],
) -> Iterator[LinkageOutcome]:
    """Yield the outcomes of consumers of a file; `tables` has the places of each."""
    stored = [
        name
        for name in table.column_names
        if name not in _OUTCOME and (drawn is None or name in drawn)
    ]
    outcomes: list[_StoredOutcome] = []
    by_draws: defaultdict[tuple[tuple[str, ...], _Draws], list[_StoredOutcome]]
    by_draws = defaultdict(list)
    for entry, places in zip(entries, tables, strict=True):
        outcome = _stored_outcome(table, places, stored)
        about, address = outcome.about, entry.address
        if drawn is None or (drawn and (address.adversary or address.world)):
            draws = _Draws(
                tuple(about["drawn_as"]), about["n_groups"], address.task, about["seed"]
            )
            clusters = tuple(labels.get(name, name) for name in about["clusters"])
            by_draws[clusters, draws].append(outcome)
        outcomes.append(outcome)
    wanted = {*(RANK_METRICS if drawn is None else drawn)} - {*DERIVED}
    for (clusters, draws), same_draws in by_draws.items():
        weights = cached_weights(draws)
        _add_rank_sums(table, same_draws, clusters, weights, wanted)
    metrics = _coded(table.column("metric"))
    fields = [table[name].to_numpy() for name in ("value", "ci_low", "ci_high", "n")]
    for outcome in outcomes:
        yield _linkage_outcome(outcome, metrics, fields)


def _stored_outcome(
    table: pa.Table, places: Mapping[str, tuple[int, int]], stored: Sequence[str]
) -> _StoredOutcome:
    """Return one consumer's part of a file, with the replicates that are stored."""
    rows = {name: slice(first, first + n) for name, (first, n) in places.items()}
    replicates = {}
    for name in stored if REPLICATES in rows else ():
        column = table[name].slice(*places[REPLICATES])
        if column.null_count == 0:
            replicates[name] = column.to_numpy()
    return _StoredOutcome(
        about=json.loads(table["about"][rows[ABOUT].start].as_py()),
        estimate_rows=rows[ESTIMATES],
        probe_rows=np.arange(rows[ROWS].start, rows[ROWS].stop),
        replicates=replicates,
    )


def _add_rank_sums(
    table: pa.Table,
    outcomes: Sequence[_StoredOutcome],
    clusters: tuple[str, ...],
    weights: Floats,
    wanted: set[str],
) -> None:
    """Add sums and replicates of rank metrics to outcomes that share their draws.

    All are summed at once: the clusters of one outcome come after those of another.
    `weights` are (B, C), of the C `clusters`.
    """
    n_outcomes, n_clusters = len(outcomes), len(clusters)
    assigned = _coded(table.column("assigned"))
    probes = _probe_ranks(table, assigned, outcomes, clusters)
    first_codes = (assigned.codes[outcome.probe_rows[0]] for outcome in outcomes)
    is_unknown = [assigned.names[code] == "unknown" for code in first_codes]
    for metric, sums in probes.sums(n_outcomes * n_clusters, wanted).items():
        # Numerators and denominators, (O, C) each.
        over, under = (part.reshape(n_outcomes, n_clusters) for part in sums)
        if metric in {"rank1_assigned", "false_link_rate"}:
            over[is_unknown] = np.nan
        with np.errstate(invalid="ignore"):  # NaN where no person was drawn
            ratios = (over @ weights.T / (under @ weights.T)).astype(np.float32)
        for number, outcome in enumerate(outcomes):
            own_sums = np.stack([over[number], under[number]])
            outcome.replicates[metric] = ratios[number]
            outcome.sums[metric] = ClusterSums(own_sums, weights, names=clusters)


def _probe_ranks(
    table: pa.Table,
    assigned: _Coded,
    outcomes: Sequence[_StoredOutcome],
    clusters: tuple[str, ...],
) -> ProbeRanks:
    """Return the ranks of the probes of all outcomes, one outcome after the other.

    Cluster c of outcome o has the number o C + c.
    """
    groups = _coded(table.column("group"))
    above, tied, chance, *companions = (table[name].to_numpy() for name in _COUNTED)
    mate_code = np.array(
        [ASSIGNED.index(name) - 1 for name in assigned.names], dtype=np.int64
    )
    n_outcomes, n_clusters = len(outcomes), len(clusters)
    rows = np.concatenate([outcome.probe_rows for outcome in outcomes])
    number_by_name = {name: number for number, name in enumerate(clusters)}
    # A group of other outcomes of the file is no cluster here: its number stays
    # negative whatever is added to it.
    no_cluster = -n_clusters * n_outcomes
    numbers = np.array([number_by_name.get(name, no_cluster) for name in groups.names])
    n_probes = [outcome.probe_rows.size for outcome in outcomes]
    first = np.repeat(np.arange(n_outcomes), n_probes) * n_clusters
    return ProbeRanks(
        above=above[rows].astype(np.int64),
        tied=tied[rows].astype(np.int64),
        chance=chance[rows],
        companions=np.stack(
            [counts[rows].astype(np.int64) for counts in companions], axis=1
        ),
        assigned=mate_code[assigned.codes[rows]],
        cluster=numbers[groups.codes[rows]] + first,
        n_gallery=max(
            outcome.about["numbers"]["gallery_sizes"][1] for outcome in outcomes
        ),
    )


def _linkage_outcome(
    outcome: _StoredOutcome, metrics: _Coded, fields: Sequence[Floats]
) -> LinkageOutcome:
    """Return an outcome; `fields` are value, ci_low, ci_high and n of every row."""
    rows = outcome.estimate_rows
    names = [metrics.names[code] for code in metrics.codes[rows]]
    numbers = zip(*(values[rows].tolist() for values in fields), strict=True)
    estimates = {}
    for name, (value, low, high, n) in zip(names, numbers, strict=True):
        effective = np.nan
        if name in outcome.sums:
            effective = effective_clusters(outcome.sums[name].sums[1])
        replicates = outcome.replicates.get(name, _NONE)
        estimates[name] = Estimate(
            value, low, high, int(n), replicates, effective=effective
        )
    about = outcome.about
    return LinkageOutcome(estimates, about["numbers"], about["cohorts"], outcome.sums)


def _coded(column: pa.ChunkedArray) -> _Coded:
    whole = column.combine_chunks()
    codes = whole.indices.fill_null(-1).to_numpy()
    return _Coded(codes, whole.dictionary.to_pylist())
