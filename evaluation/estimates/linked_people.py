"""People linked at every level of a task, with the descriptors of their own windows.

The descriptors are those of the linked windows, not of the tracks in scenes. Summed by
cluster, everything is a ratio of sums: a bootstrap, a jackknife or one half of the
people are weights of the clusters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from evaluation.compute.link_setup import SIDES
from evaluation.compute.link_tables import COMPANIONS, NAMED_MATES
from evaluation.compute.tables import ON_TRIAL
from evaluation.estimates.families import ADDING_RULES, FID, FIXED, RAW
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    METRICS,
    RANK1,
    RANK1_AMONG_100,
    RANK1_JOINT,
)
from evaluation.estimates.strongest import by_task, first_half, strongest_by_mechanism
from evaluation.estimates.sweeps import Sweeps
from evaluation.plan.address import Address
from evaluation.plan.constants import WINDOWS
from evaluation.plan.world import OWN_WORLD
from evaluation.store.cell_files import read_rows
from evaluation.store.entries import Entry, entries_in
from isac_track.intervals import cluster_sums
from isac_track.linkability import GALLERY
from isac_track.linkability.ranks import among_strangers, expected_hit, first_among
from isac_track.types import Floats, Ints

# Covariates of a window in either release.
COVARIATES: Final = (
    "n_samples",
    "duration_s",
    "speed_mps",
    "sigma_m",
)
_TRACK_NAMES: Final = ("search", "source")
_DESCRIPTOR_COLUMNS: Final = {
    **{name: METRICS[name].column for name in DESCRIPTORS},
    **{name: name for name in ON_TRIAL},
}
_PROBE_COLUMNS: Final = (
    *_TRACK_NAMES,
    "group",
    "above",
    "tied",
    "chance",
    "assigned",
    *COMPANIONS,
)
Choices: TypeAlias = "Mapping[str, Sequence[Address]]"
"""By metric: the linker that the first half of the people chose, then the second."""
PAPER_MECHANISMS: Final = ""
"""Key of the choices for raw, fixed noise and FID, where others have a mechanism."""
_NO_CHOICES: Final[Mapping[tuple[str, str], Choices]] = MappingProxyType({})
_WINDOW_COLUMNS: Final = (
    "side",
    *_TRACK_NAMES,
    *COVARIATES,
    *_DESCRIPTOR_COLUMNS.values(),
)


class _Choice(NamedTuple):
    """What a half of the people chose: a cell, and the metric that its linker has."""

    cell: Entry | None  # Of the manifest; None if the run has none.
    metric: str


@dataclass(frozen=True, eq=False, slots=True)
class LinkedProbes:
    """N mated probes at a mechanism level, with their hits and own descriptors."""

    mechanism: str
    level: float | None
    linker: Address
    hit: Floats  # (N,) expected share of cases in which the mate comes first
    # (N,) the same among `GALLERY` candidates without companions; NaN with fewer
    hit_among: Floats
    chance: Floats  # (N,) of `hit`
    cluster: Ints  # (N,) with the same numbers at all levels of a task
    clusters: tuple[str, ...]  # Names of the clusters.
    descriptors: Mapping[str, Floats]
    """(N, 2) by descriptor, on-trial included: in the probe and gallery release"""
    covariates: Floats  # (N, K) `COVARIATES` of either release
    strangers: Ints
    """(3, N) candidates of `linker` without companions: above the mate, as high as the
    mate (mate included), in all"""


@dataclass(frozen=True, eq=False, slots=True)
class LinkedLevel:
    """Sums by cluster at one mechanism level; a task's levels share cluster numbers."""

    mechanism: str
    level: float | None
    # The strongest linker against this mechanism.
    linker: Address
    # (C,) sum over mated probes of rank 1 in a gallery of 100, or in their own
    success: Floats
    chance: Floats  # (C,) the same sum for a guess
    probes: Floats  # (C,) mated probes
    descriptors: Mapping[str, Floats]
    """(2, C) by name: sums over the cluster's linked windows with a value, and the
    number of these windows"""


@dataclass(frozen=True, eq=False, slots=True)
class TaskSums:
    """All levels of a task, raw among them."""

    task: str
    # Gallery of the rank-1 rates: 100, or None where each probe has its own.
    gallery: int | None
    clusters: tuple[str, ...]  # (C,) names, sorted
    levels: tuple[LinkedLevel, ...]


def read_probes(
    out: Path,
    manifest: Mapping[str, Any],
    sweeps: Sweeps,
    *,
    strongest: Mapping[str, Address],
    choices: Mapping[tuple[str, str], Choices] = _NO_CHOICES,
) -> dict[str, list[LinkedProbes]]:
    """Return the linked probes of every level, by task, in the order of the run.

    `strongest` gives the strongest linker of each task. It links raw, fixed noise and
    FID; every other mechanism is linked by the strongest linker against it. `choices`
    gives the linkers that either half of the people chose (`CrossFitted.choices`), by
    task and mechanism, or `PAPER_MECHANISMS`: each half is linked by the other half's
    choice. Without choices all are linked by the strongest, probe by
    probe. Raises DataError if a cell cannot be read.
    """
    linked_entries = entries_in(
        manifest["cells"], OWN_WORLD, kinds=("linkage", "windows")
    )
    cells = {entry.address: entry for entry in linked_entries}
    levels = by_task(sweeps.estimates, metric=RANK1)
    papers = {RAW} | {
        sweeps.named(family, adding=adding)
        for adding in ADDING_RULES
        for family in (FIXED, FID)
    }
    probes: dict[str, list[LinkedProbes]] = {task: [] for task in strongest if task}
    for task, probes_of_task in probes.items():
        usual = strongest[task]
        linkers = strongest_by_mechanism(levels[task])
        for where in levels[task]:
            mechanism, _ = where
            is_paper = mechanism in papers
            if not (is_paper or sweeps.families[mechanism].is_added):
                continue
            linker = usual if is_paper else linkers.get(mechanism, usual)
            linked = cells.get(linker.at(*where))
            windows = cells.get(Address(task=task, plugin=WINDOWS).at(*where))
            if linked and windows:
                name = PAPER_MECHANISMS if is_paper else mechanism
                choice = choices.get((task, name), {})
                choices_by_metric = {
                    metric: [
                        _Choice(cells.get(measure.reader.at(*where)), measure.metric)
                        for measure in halves
                    ]
                    for metric, halves in choice.items()
                }
                probes_of_task.append(_probes(out, linked, windows, choices_by_metric))
    return probes


def _mated(out: Path, linked: Entry) -> pa.Table:
    """Return the rows of a cell's probes that have a mate."""
    probes = read_rows(out, linked, columns=_PROBE_COLUMNS, beside=_WINDOW_COLUMNS)
    return probes.filter(pc.greater_equal(probes["above"], 0))


def _strangers(probes: pa.Table) -> Ints:
    """Return `LinkedProbes.strangers` of the rows of a cell."""
    counts = (probes[name].to_numpy() for name in ("above", "tied", *COMPANIONS))
    above, tied, *along = (column.astype(np.int64) for column in counts)
    chance = probes["chance"].to_numpy()
    return among_strangers(above, tied, chance, np.stack(along, axis=1))


def _hits(probes: pa.Table, metric: str) -> Floats:
    """Return how often the mate of each probe of a cell is named, (N,)."""
    if metric == RANK1_JOINT:
        named: list[str] = probes["assigned"].cast(pa.string()).to_pylist()
        return np.array([name in NAMED_MATES for name in named], dtype=np.float64)
    if metric == RANK1_AMONG_100:
        return first_among(_strangers(probes))
    above, tied = (
        probes[name].to_numpy().astype(np.int64) for name in ("above", "tied")
    )
    return expected_hit(above, tied)


def _crossed_hits(
    out: Path,
    choices: Sequence[_Choice],
    group: Sequence[str],
) -> Floats | None:
    """Return the share of hits, (N,), each half linked by the other's choice.

    `choices` are those of the first and of the second half. None if a cell is missing.
    """
    first, second = choices
    if first.cell is None or second.cell is None:
        return None
    clusters, cluster = np.unique(group, return_inverse=True)
    is_first = first_half(tuple(clusters.tolist()))[cluster]
    hit_by_second = _hits(_mated(out, second.cell), second.metric)
    hit_by_first = _hits(_mated(out, first.cell), first.metric)
    return np.where(is_first, hit_by_second, hit_by_first)


def _probes(
    out: Path,
    linked: Entry,
    windows: Entry,
    choices: Mapping[str, Sequence[_Choice]],
) -> LinkedProbes:
    probes = _mated(out, linked)
    tracks = read_rows(out, windows, columns=_WINDOW_COLUMNS, beside=_PROBE_COLUMNS)
    window_names, rows_by_side = _row_names(tracks), []
    for side in SIDES:
        in_side = np.flatnonzero(pc.equal(tracks["side"], side).to_numpy())
        window = pc.index_in(
            _row_names(probes), value_set=window_names.take(in_side)
        ).to_numpy()
        rows_by_side.append(in_side[window])

    def in_both(column: str) -> Floats:
        values = tracks[column].to_numpy().astype(np.float64)
        return np.column_stack([values[rows] for rows in rows_by_side])

    group = probes["group"].to_numpy().astype(str)
    clusters, cluster = np.unique(group, return_inverse=True)
    hits = {}
    for metric in (RANK1, RANK1_AMONG_100):
        crossed = None
        if metric in choices:
            crossed = _crossed_hits(out, choices[metric], group)
        hits[metric] = _hits(probes, metric) if crossed is None else crossed
    return LinkedProbes(
        mechanism=linked.address.mechanism,
        level=linked.address.level,
        linker=linked.address.reader,
        hit=hits[RANK1],
        hit_among=hits[RANK1_AMONG_100],
        strangers=_strangers(probes),
        chance=probes["chance"].to_numpy(),
        cluster=cluster,
        clusters=tuple(clusters.tolist()),
        descriptors={
            name: in_both(column) for name, column in _DESCRIPTOR_COLUMNS.items()
        },
        covariates=np.column_stack([in_both(column) for column in COVARIATES]),
    )


def _row_names(rows: pa.Table) -> pa.ChunkedArray:
    """Return a name of each row: the search and source of its track."""
    search, source = (rows[name].cast(pa.string()) for name in _TRACK_NAMES)
    return pc.binary_join_element_wise(search, source, "\n")


def sum_by_cluster(
    probes: Mapping[str, Sequence[LinkedProbes]],
) -> tuple[TaskSums, ...]:
    """Return the tasks of a run summed by cluster, from the result of `read_probes`."""
    tasks = []
    for task, levels in probes.items():
        if not levels:
            continue
        has_gallery = all(np.isfinite(linked.hit_among).all() for linked in levels)
        gallery = GALLERY if has_gallery else None
        summed = tuple(_summed(linked, gallery) for linked in levels)
        tasks.append(TaskSums(task, gallery, levels[0].clusters, summed))
    return tuple(tasks)


def _summed(linked: LinkedProbes, gallery: int | None) -> LinkedLevel:

    def sums(values: Floats) -> Floats:
        return cluster_sums(
            values=values, cluster=linked.cluster, n_clusters=len(linked.clusters)
        )

    n_probes = linked.hit.size
    return LinkedLevel(
        mechanism=linked.mechanism,
        level=linked.level,
        linker=linked.linker,
        success=sums(linked.hit_among if gallery else linked.hit),
        chance=sums(np.full(n_probes, 1.0 / gallery) if gallery else linked.chance),
        probes=sums(np.ones(n_probes)),
        descriptors={
            name: np.stack(
                [
                    sums(np.nan_to_num(values).sum(axis=1)),
                    sums((~np.isnan(values)).sum(axis=1)),
                ]
            )
            for name, values in linked.descriptors.items()
        },
    )
