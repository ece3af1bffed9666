"""Who is linked at every level of a task, and what their own windows give away.

The descriptors are those of the windows that are linked, not of the tracks in scenes.
Summed by cluster, everything is a ratio of sums: a bootstrap, a jackknife or one half
of the people are weights of these.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from evaluation.compute.link_scores import COMPANIONS, NAMED_MATES
from evaluation.compute.link_setup import SIDES
from evaluation.compute.tables import ON_TRIAL
from evaluation.estimates.families import ADDING_RULES, FID, FIXED, RAW
from evaluation.estimates.keys import Measure, Source
from evaluation.estimates.matching import Sweeps
from evaluation.estimates.metrics import (
    ASSIGNED,
    DESCRIPTORS,
    METRICS,
    SUCCESS,
    SUCCESS_OF_100,
)
from evaluation.estimates.strongest import against_each, by_task, first_half
from evaluation.plan.constants import WINDOWS
from evaluation.store.cell_files import read_rows
from isac_track.intervals import cluster_sums
from isac_track.linkability import GALLERY
from isac_track.linkability.ranks import among_strangers, expected_hit, first_among
from isac_track.types import Floats, Ints

COVARIATES: Final = (
    "n_samples",
    "duration_s",
    "speed_mps",
    "sigma_m",
)  # Of either release.
_WHOSE: Final = ("search", "source")
_COLUMN_OF: Final = {name: METRICS[name].column for name in DESCRIPTORS} | dict(
    zip(ON_TRIAL, ON_TRIAL, strict=True)
)
_OF_PROBES: Final = (
    *_WHOSE,
    "group",
    "above",
    "tied",
    "chance",
    "assigned",
    *COMPANIONS,
)
Choices: TypeAlias = "Mapping[str, Sequence[Measure]]"
_NO_CHOICES: Final[Mapping[tuple[str, str], Choices]] = MappingProxyType({})
_OF_WINDOWS: Final = ("side", *_WHOSE, *COVARIATES, *_COLUMN_OF.values())


@dataclass(frozen=True, eq=False, slots=True)
class LinkedProbes:
    """Who is linked at one mechanism level, and what their own windows say: N mated probes."""

    mechanism: str
    level: float | None
    linker: Source
    hit: Floats  # (N,) expected share of cases in which the mate comes first
    # (N,) the same among `GALLERY` without companions; NaN with fewer
    hit_among: Floats
    chance: Floats  # (N,) of `hit`
    cluster: Ints  # (N,) numbered alike at all levels of a task
    clusters: tuple[str, ...]  # Their names.
    descriptors: Mapping[str, Floats]
    """By descriptor, those on trial among them, (N, 2): in the probe and in the gallery release"""
    covariates: Floats  # (N, K) `COVARIATES` of either release
    strangers: Ints
    """(3, N) of `linker`: candidates without companions: above the mate, as high (mate included),
    in all"""


@dataclass(frozen=True, eq=False, slots=True)
class LinkedLevel:
    """One mechanism level of a task; clusters are numbered alike at all levels of the task."""

    mechanism: str
    level: float | None
    # Whose success it is: of all linkers the strongest against this mechanism.
    linker: Source
    # (C,) sum over mated probes of rank-1 at a gallery of 100, or of their own
    success: Floats
    chance: Floats  # (C,) the same of a guess
    probes: Floats  # (C,) mated probes
    descriptors: Mapping[str, Floats]
    """By name (2, C): sums over the cluster's linked windows that have a value, and their number"""


@dataclass(frozen=True, eq=False, slots=True)
class LinkedTask:
    """All levels of a task, raw among them."""

    task: str
    gallery: (
        int | None
    )  # At which rank-1 is read: 100, or None where it is everybody's own.
    clusters: tuple[str, ...]  # (C,) names, sorted
    levels: tuple[LinkedLevel, ...]


def read_probes(
    out: Path,
    manifest: Mapping[str, Any],
    sweeps: Sweeps,
    *,
    strongest: Mapping[str, Source],
    choices: Mapping[tuple[str, str], Choices] = _NO_CHOICES,
) -> dict[str, list[LinkedProbes]]:
    """Return who is linked at every level, by task, in the order of the run.

    `strongest` is by task its strongest linker. Raw, fixed noise and FID are linked by
    it, every other mechanism by who is strongest there. `choices` are by task and
    mechanism, or "" for raw, fixed noise and FID, whom either half of the people chose
    (`CrossFitted.choices`): the other half is linked by that. Without them all are
    linked by the strongest, probe by probe. Raises DataError if a cell cannot be read.
    """
    place = itemgetter("mechanism", "level", "consumer", "knowledge")
    cells = {
        place(entry): entry for entry in manifest["cells"] if not entry.get("world")
    }
    levels = by_task(sweeps.found, metric=SUCCESS)
    swept = [
        RAW,
        *(sweeps.named(one, adding=of) for of in ADDING_RULES for one in (FIXED, FID)),
    ]
    found: dict[str, list[LinkedProbes]] = {task: [] for task in strongest if task}
    for task, probes in found.items():
        usual = strongest[task]
        who = against_each(levels[task]) | dict.fromkeys(swept, usual)
        for where in levels[task]:
            if where[0] in swept or sweeps.known[where[0]].is_added:
                linked = cells.get((*where, *who.get(where[0], usual)))
                windows = cells.get((*where, f"{task}/{WINDOWS}", ""))
                if linked and windows:
                    chosen = choices.get(
                        (task, "" if where[0] in swept else where[0]), {}
                    )
                    pairs = {
                        metric: [
                            (cells.get((*where, *one.source)), one.metric)
                            for one in both
                        ]
                        for metric, both in chosen.items()
                    }
                    probes.append(_probes(out, linked, windows, pairs))
    return found


def _mated(out: Path, linked: Mapping[str, Any]) -> pa.Table:
    """Return the rows of the probes of a cell that have a mate."""
    probes = read_rows(out, linked, columns=_OF_PROBES, beside=_OF_WINDOWS)
    return probes.filter(pc.greater_equal(probes["above"], 0))


def _strangers(probes: pa.Table) -> Ints:
    """Return `LinkedProbes.strangers` of the rows of a cell."""
    counts = (probes[name].to_numpy() for name in ("above", "tied", *COMPANIONS))
    above, tied, *along = (column.astype(np.int64) for column in counts)
    chance = probes["chance"].to_numpy()
    return among_strangers(above, tied, chance, np.stack(along, axis=1))


def _hits(probes: pa.Table, metric: str) -> Floats:
    """Return how often the mate of each probe of a cell is named, (N,)."""
    if metric == ASSIGNED:
        named: list[str] = probes["assigned"].cast(pa.string()).to_pylist()
        return np.array([name in NAMED_MATES for name in named], dtype=np.float64)
    if metric == SUCCESS_OF_100:
        return first_among(_strangers(probes))
    above, tied = (
        probes[name].to_numpy().astype(np.int64) for name in ("above", "tied")
    )
    return expected_hit(above, tied)


def _crossed_hits(
    out: Path,
    pair: Sequence[tuple[Mapping[str, Any] | None, str]],
    group: Sequence[str],
) -> Floats | None:
    """Return how often mates are named, each half of the people linked by the other's choice."""
    (first, by_first), (second, by_second) = pair
    if first is None or second is None:
        return None
    clusters, cluster = np.unique(group, return_inverse=True)
    is_first = first_half(tuple(clusters.tolist()))[cluster]
    hits = (_hits(_mated(out, second), by_second), _hits(_mated(out, first), by_first))
    return np.where(is_first, *hits)


def _probes(
    out: Path,
    linked: Mapping[str, Any],
    windows: Mapping[str, Any],
    pairs: Mapping[str, Sequence[tuple[Mapping[str, Any] | None, str]]],
) -> LinkedProbes:
    probes = _mated(out, linked)
    tracks = read_rows(out, windows, columns=_OF_WINDOWS, beside=_OF_PROBES)
    names, sides = _names(tracks), []
    for side in SIDES:
        mine = np.flatnonzero(pc.equal(tracks["side"], side).to_numpy())
        sides.append(
            mine[pc.index_in(_names(probes), value_set=names.take(mine)).to_numpy()]
        )

    def both(column: str) -> Floats:
        values = tracks[column].to_numpy().astype(np.float64)
        return np.column_stack([values[side] for side in sides])

    group = probes["group"].to_numpy().astype(str)
    clusters, cluster = np.unique(group, return_inverse=True)
    hits = {}
    for metric in (SUCCESS, SUCCESS_OF_100):
        crossed = _crossed_hits(out, pairs[metric], group) if metric in pairs else None
        hits[metric] = _hits(probes, metric) if crossed is None else crossed
    return LinkedProbes(
        mechanism=linked["mechanism"],
        level=linked["level"],
        linker=Source(linked["consumer"], linked["knowledge"]),
        hit=hits[SUCCESS],
        hit_among=hits[SUCCESS_OF_100],
        strangers=_strangers(probes),
        chance=probes["chance"].to_numpy(),
        cluster=cluster,
        clusters=tuple(clusters.tolist()),
        descriptors={name: both(column) for name, column in _COLUMN_OF.items()},
        covariates=np.column_stack([both(column) for column in COVARIATES]),
    )


def _names(rows: pa.Table) -> pa.ChunkedArray:
    """Return what a track is called in its search and among all."""
    search, source = (rows[name].cast(pa.string()) for name in _WHOSE)
    return pc.binary_join_element_wise(search, source, "\n")


def by_cluster(probes: Mapping[str, Sequence[LinkedProbes]]) -> tuple[LinkedTask, ...]:
    """Return the tasks of a run summed by cluster; `probes` is what `read_probes` returns."""
    found = []
    for task, levels in probes.items():
        gallery = (
            GALLERY if all(np.isfinite(one.hit_among).all() for one in levels) else None
        )
        summed = tuple(_summed(one, gallery) for one in levels)
        if levels:
            found.append(LinkedTask(task, gallery, levels[0].clusters, summed))
    return tuple(found)


def _summed(one: LinkedProbes, gallery: int | None) -> LinkedLevel:

    def sums(values: Floats) -> Floats:
        return cluster_sums(
            values=values, cluster=one.cluster, n_clusters=len(one.clusters)
        )

    descriptors = {
        name: np.stack(
            [sums(np.nan_to_num(of).sum(axis=1)), sums((~np.isnan(of)).sum(axis=1))]
        )
        for name, of in one.descriptors.items()
    }
    success = sums(one.hit_among if gallery else one.hit)
    chance = sums(np.full(one.hit.size, 1.0 / gallery) if gallery else one.chance)
    about, n_probes = (
        (one.mechanism, one.level, one.linker),
        sums(np.ones(one.hit.size)),
    )
    return LinkedLevel(*about, success, chance, n_probes, descriptors)
