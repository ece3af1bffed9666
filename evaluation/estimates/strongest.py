"""The strongest attack: one definition for verdict, tables, page and recommendation.

The strongest attack has the highest mean success over some levels: PLR after a
reconstruction, rank 1 of a linker; among equals it is the first. Attacks compete that
ran at as many of these levels as any other. The oracle, a reference, and the control, which takes
positions as they are, do not compete. A linker names mates probe by probe, or all at
once by the most probable matching: the better of the two counts.

The strongest of a run is chosen over all levels of raw, fixed noise and FID, so that
the choice favours none of them. In a run with neither fixed noise nor FID it is chosen
over all levels but the ceiling. It is the *headline adversary*, one for reconstruction
and one for each linkage task. Every number after attack without a name is its number.

The best of many attacks looks better than it is on the people by whom it was chosen. A
shown number of the strongest is therefore *cross-fitted*: chosen on one half of the
people and scored on the other, and the reverse.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from evaluation.estimates.families import CLEAN, FID, FIXED, PAPER_FAMILIES, RAW, Family
from evaluation.estimates.keys import INFORMED, EstimatesByAddress
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    MEDIAN_ERROR,
    METRICS,
    PLR,
    PLR_WIDE,
    RANK1,
    RANK1_AMONG_100,
    RANK1_JOINT,
)
from evaluation.plan.address import AS_SHARED, Address, MechanismLevel
from evaluation.plan.presets import IDENTITY
from evaluation.store.people import in_first_half
from isac_track.types import Bools, Floats, read_only

if TYPE_CHECKING:
    from evaluation.store.linkage_outcomes import ClusterSums
    from isac_track.intervals import Estimate

# Success of every attack at each level.
SuccessByLevel: TypeAlias = "dict[MechanismLevel, dict[Address, float]]"
# Adversaries of which the strongest is the headline.
HEADLINE: Final = ("blind", INFORMED)
# Adversaries that know more: shown beside the headline.
BEYOND: Final = ("repeats", "anchor", "companions", "insider")
GROUPS: Final = (HEADLINE, *((name,) for name in BEYOND))  # Each has its strongest.
NO_TASK: Final = ""  # Of a reconstruction, where linkers have the name of a task.
NAMING_RULES: Final = (RANK1, RANK1_JOINT)
"""Rules by which a linker names mates: each best candidate, or a matching of all."""
_CHOICES: Final = {
    PLR: (((PLR,), (*DESCRIPTORS, MEDIAN_ERROR)), ((PLR_WIDE,), (PLR_WIDE,))),
    RANK1: ((NAMING_RULES, (RANK1,)), ((RANK1_AMONG_100,), (RANK1_AMONG_100,))),
}
"""Choices of a strongest by ranking metric: metrics that rank, and metrics scored."""


def choose_strongest(
    levels: Iterable[Mapping[Address, float]], *, among: Collection[str] = HEADLINE
) -> Address | None:
    """Return the strongest attack over some levels, or None if none counts.

    `levels` has the success of every attack at each level; attacks of the adversaries
    `among` compete.
    """
    values: dict[Address, list[float]] = {}
    for level in levels:
        for reader, value in level.items():
            if reader.adversary in among and reader.consumer != IDENTITY:
                values.setdefault(reader, []).append(value)
    most = max(map(len, values.values()), default=0)
    means = {
        reader: float(np.mean(successes))
        for reader, successes in values.items()
        if len(successes) == most
    }
    finite = [reader for reader, mean in means.items() if np.isfinite(mean)]
    return max(finite, key=means.__getitem__, default=None)


def strongest_by_task(
    estimates: EstimatesByAddress, families: Mapping[str, Family]
) -> dict[str, Address]:
    """Return the strongest linker by task; the strongest reconstruction is `NO_TASK`'s.

    `estimates` are all those of the run, `families` its mechanisms.
    """
    best = {}
    for metric in (PLR, RANK1):
        levels = by_task(estimates, metric=metric)
        family_names = {
            families[name].family
            for by_where in levels.values()
            for name, _ in by_where
        }
        for task, by_where in levels.items():
            if reader := choose_strongest(_choosing(by_where, families, family_names)):
                best[task] = reader
    return best


def ranking_levels(
    mechanism_levels: Iterable[MechanismLevel], families: Mapping[str, Family]
) -> list[MechanismLevel]:
    """Return the distinct levels over which a run's strongest attack is chosen."""
    distinct = dict.fromkeys(mechanism_levels)
    family_names = {families[name].family for name, _ in distinct}
    return [
        where for where in distinct if _is_ranking_level(where, families, family_names)
    ]


def naming_rules(estimates: EstimatesByAddress) -> dict[Address, str]:
    """Return the rule, of `NAMING_RULES`, by which each linker names more mates on average.

    A linker without a known rate at any level is left out.
    """
    rates: dict[Address, dict[str, list[float]]] = {}
    for key, estimate in estimates.items():
        if key.metric in NAMING_RULES and np.isfinite(estimate.value):
            rates_of_linker = rates.setdefault(key.reader, {})
            rates_of_linker.setdefault(key.metric, []).append(estimate.value)
    means = {
        linker: {rule: float(np.mean(values)) for rule, values in by_rule.items()}
        for linker, by_rule in rates.items()
    }
    return {
        linker: max(NAMING_RULES, key=lambda rule: by_rule.get(rule, -1.0))
        for linker, by_rule in means.items()
    }


def success_metric(estimates: EstimatesByAddress, linker: Address) -> str:
    """Return a linker's success metric: rank 1 of 100 if it has as many candidates."""
    at_raw = estimates.get(linker.measured(RANK1_AMONG_100).at(RAW, None))
    is_known = at_raw is not None and np.isfinite(at_raw.value)
    return RANK1_AMONG_100 if is_known else RANK1


def _choosing(
    by_where: SuccessByLevel,
    families: Mapping[str, Family],
    family_names: Collection[str],
) -> Iterator[Mapping[Address, float]]:
    return (
        block
        for where, block in by_where.items()
        if _is_ranking_level(where, families, family_names)
    )


def _is_ranking_level(
    where: MechanismLevel, families: Mapping[str, Family], family_names: Collection[str]
) -> bool:
    """Whether the strongest is chosen at a level, in a run with some families."""
    wanted = (
        PAPER_FAMILIES
        if {FIXED, FID}.intersection(family_names)
        else {*family_names} - {CLEAN}
    )
    return families[where.mechanism].family in wanted


@dataclass(frozen=True, eq=False, slots=True)
class CrossFitted:
    """Success of the strongest attack without the bias of its choice."""

    # Under the headline's name.
    estimates: dict[Address, Estimate] = field(default_factory=dict)
    choices: dict[str, list[Address]] = field(default_factory=dict)
    """Attack that either half of the people chose, with the metric that counts for it,
    by ranking metric (PLR, rank 1, rank 1 of 100). The first half is scored by the
    second choice."""


def cross_fitted(
    sums: Mapping[Address, ClusterSums],
    families: Mapping[str, Family],
    headline: Address,
    *,
    by: str = PLR,
) -> CrossFitted:
    """Return the strongest attack's success, each half scored by the other's choice.

    The people are in two halves, `first_half` of the names of their clusters. On each
    half the strongest is chosen as usual, among the headline's adversaries; every
    cluster is then scored under the other half's choice. Intervals repeat the choice in
    every replicate; those of a jackknife repeat it with each cluster deleted. Galleries
    and matchings stay whole: only the probes are split.

    `sums` are of every attack, all with the same weights; attacks are ranked by the
    metric `by`. Ranked by rank 1, a linker may name mates probe by probe or all at once
    (`NAMING_RULES`); rank 1 of 100 has a choice of its own.
    """
    among = HEADLINE if headline.adversary in HEADLINE else (headline.adversary,)
    eligible = {
        key: summed
        for key, summed in sums.items()
        if key.adversary in among
        and key.reader.task == headline.task
        and key.consumer != IDENTITY
        and np.isfinite(summed.sums).all()
    }
    family_names = {families[key.mechanism].family for key in eligible}
    is_ceiling = family_names == {CLEAN}
    mechanism_levels = {
        key.mechanism_level
        for key in eligible
        if is_ceiling or _is_ranking_level(key.mechanism_level, families, family_names)
    }
    crossed = CrossFitted()
    for ranked, metrics in _CHOICES[by]:
        if rivals := _rivals(eligible, mechanism_levels, ranked):
            estimates, winners = _scored(eligible, rivals, headline, metrics=metrics)
            crossed.estimates.update(estimates)
            crossed.choices[ranked[0]] = winners
    return crossed


def _rivals(
    sums: Mapping[Address, ClusterSums],
    mechanism_levels: Collection[MechanismLevel],
    ranked: Collection[str],
) -> dict[Address, list[ClusterSums]]:
    """Return the attacks measured at the most of some levels, and their sums there."""
    values: dict[Address, list[ClusterSums]] = {}
    for key, summed in sums.items():
        if (
            key.metric in ranked
            and key.mechanism_level in mechanism_levels
            and summed.sums[1].any()
        ):
            values.setdefault(key.measure, []).append(summed)
    most = max(map(len, values.values()), default=0)
    return {
        measure: levels for measure, levels in values.items() if len(levels) == most
    }


def _scored(
    sums: Mapping[Address, ClusterSums],
    rivals: Mapping[Address, Sequence[ClusterSums]],
    headline: Address,
    *,
    metrics: Collection[str],
) -> tuple[dict[Address, Estimate], list[Address]]:
    """Return a choice's numbers under the headline's name, and the choices."""
    # Import here: reading a finished run needs none of it.
    from evaluation.estimates.cross_fit import cross_fit  # noqa: PLC0415 - as said above

    first = next(iter(rivals.values()))[0]
    keys: list[Address] = []
    scored: list[list[Floats]] = []
    for where, metric in product(
        dict.fromkeys(key.mechanism_level for key in sums), metrics
    ):
        # A linker that names all mates at once is scored by that, too.
        measures = [
            rival if metric in NAMING_RULES else rival.reader.measured(metric)
            for rival in rivals
        ]
        candidates = [sums.get(measure.at(*where)) for measure in measures]
        known = [summed.whole() for summed in candidates if summed is not None]
        if len(known) == len(rivals):
            keys.append(headline.measured(metric).at(*where))
            scored.append(known)
    if not keys:
        return {}, []
    estimates, best = cross_fit(
        choosing=np.array(
            [[summed.whole() for summed in levels] for levels in rivals.values()]
        ),
        scored=np.array(scored).transpose(1, 0, 2, 3),
        is_first=first_half(first.clusters),
        weights=first.weights,
        is_share=[METRICS[key.metric].is_share for key in keys],
    )
    names = list(rivals)
    return dict(zip(keys, estimates, strict=True)), [names[place] for place in best]


# Holds the clusters of the last runs, and of each of their tasks; the oldest of 64
# goes.
@lru_cache(maxsize=64)
def first_half(clusters: tuple[str, ...]) -> Bools:
    """Return which clusters are in the first half, (C,), by a hash of the name.

    The half depends neither on the other people of the run, nor on its seed, nor on the
    pseudonyms.
    """
    return read_only(np.array([in_first_half(name) for name in clusters], dtype=bool))


def by_task(estimates: EstimatesByAddress, *, metric: str) -> dict[str, SuccessByLevel]:
    """Return the success of every attack by task, level, and attack.

    A linker's rank 1 is that by the better of `NAMING_RULES`.
    """
    values: dict[str, SuccessByLevel] = {}
    ranked = NAMING_RULES if metric == RANK1 else (metric,)
    for key, estimate in estimates.items():
        if key.metric in ranked:
            reader = key.reader
            successes = values.setdefault(reader.task, {}).setdefault(
                key.mechanism_level, {}
            )
            successes[reader] = float(
                np.fmax(successes.get(reader, np.nan), estimate.value)
            )
    return values


def strongest_by_mechanism(
    levels: SuccessByLevel, *, among: Collection[str] = HEADLINE
) -> dict[str, Address]:
    """Return the strongest attack against each mechanism over its levels, if any."""
    levels_of_mechanism: dict[str, list[Mapping[Address, float]]] = {}
    for (mechanism, _), block in levels.items():
        levels_of_mechanism.setdefault(mechanism, []).append(block)
    best = {
        name: choose_strongest(blocks, among=among)
        for name, blocks in levels_of_mechanism.items()
    }
    return {name: reader for name, reader in best.items() if reader}


def most_knowing(readers: Iterable[Address]) -> list[Address]:
    """Return the reader as shared, and each attack with one of its adversaries.

    It is the informed one, else the blind; another stands only for an attack that
    neither can run.
    """
    rank = {name: place for place, name in enumerate(("", *HEADLINE))}
    best: dict[str, Address] = {}
    for reader in readers:
        name = "" if reader == AS_SHARED else reader.consumer
        pair = best.get(name, reader), reader
        best[name] = max(pair, key=lambda candidate: rank.get(candidate.adversary, 0))
    return list(best.values())
