"""The strongest attack: one definition, for the verdict, the tables, the page and a site's level.

It is the attack with the highest mean success over some levels: PLR after a
reconstruction, rank 1 of a linker; of equals the first. Those count that ran at all of
these levels, short of the oracle, who is a reference, and of the control, which takes
positions as they are. A linker names mates probe by probe, or all at once by the most
probable matching: the better of the two counts.

The strongest of a run is chosen over all levels of raw, fixed noise and FID, so that
the choice favours none of them; of a run with neither of the two over all levels but
the ceiling. It is the *headline adversary*, one for reconstruction and one for each
linkage task, whose is every number after attack without a name.

The best of many attacks looks better than it is on the people by whom it was chosen.
Where a number of the strongest is told it is therefore *cross-fitted*: chosen on one
half of the people and scored on the other, and the reverse.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from evaluation.estimates.families import CLEAN, FID, FIXED, RAW, SWEPT, Family
from evaluation.estimates.keys import (
    AS_SHARED,
    INFORMED,
    Found,
    Key,
    Measure,
    Source,
    Where,
)
from evaluation.estimates.metrics import (
    ASSIGNED,
    DESCRIPTORS,
    EXPOSURE,
    MEDIAN,
    METRICS,
    SUCCESS,
    SUCCESS_OF_100,
    WIDE,
)
from evaluation.plan.presets import IDENTITY
from evaluation.store.people import in_first_half
from isac_track.types import Bools, Floats, read_only

if TYPE_CHECKING:
    from evaluation.store.cell_files import Summed
    from isac_track.intervals import Estimate

# Success of every attack at each level.
Levels: TypeAlias = "dict[Where, dict[Source, float]]"
HEADLINE: Final = (
    "blind",
    INFORMED,
)  # Adversaries of whom the strongest is the headline.
BEYOND: Final = (
    "repeats",
    "anchor",
    "companions",
    "insider",
)  # Who knows more: told beside it.
GROUPS: Final = (HEADLINE, *((name,) for name in BEYOND))  # Each has its strongest.
RULES: Final = (SUCCESS, ASSIGNED)
"""How a linker names mates: for each probe its best candidate, or by the matching of them all."""
_CHOICES: Final = {
    EXPOSURE: (((EXPOSURE,), (*DESCRIPTORS, MEDIAN)), ((WIDE,), (WIDE,))),
    SUCCESS: ((RULES, (SUCCESS,)), ((SUCCESS_OF_100,), (SUCCESS_OF_100,))),
}
"""By what attacks are ranked: each choice of a strongest, by which metrics, and what it scores."""


def strongest_of(
    levels: Iterable[Mapping[Source, float]], *, among: Collection[str] = HEADLINE
) -> Source | None:
    """Return the strongest attack over some levels, or None if none counts.

    `levels` is of each level the success of every attack; those of the adversaries
    `among` count.
    """
    values: dict[Source, list[float]] = {}
    for level in levels:
        for source, value in level.items():
            if source.knowledge in among and source.consumer != IDENTITY:
                values.setdefault(source, []).append(value)
    most = max(map(len, values.values()), default=0)
    means = {
        source: float(np.mean(one))
        for source, one in values.items()
        if len(one) == most
    }
    finite = [source for source, mean in means.items() if np.isfinite(mean)]
    return max(finite, key=means.__getitem__, default=None)


def strongest(found: Found, known: Mapping[str, Family]) -> dict[str, Source]:
    """Return the strongest linker of a run by task; under "" the strongest reconstruction.

    `found` is every estimate of the run, `known` its mechanisms.
    """
    best = {}
    for metric in (EXPOSURE, SUCCESS):
        levels = by_task(found, metric=metric)
        families = {
            known[name].family for blocks in levels.values() for name, _ in blocks
        }
        for task, blocks in levels.items():
            if one := strongest_of(_choosing(blocks, known, families)):
                best[task] = one
    return best


def ranking_levels(wheres: Iterable[Where], known: Mapping[str, Family]) -> list[Where]:
    """Return the levels over which the strongest attack of a run is chosen, each once."""
    each = dict.fromkeys(wheres)
    families = {known[name].family for name, _ in each}
    return [where for where in each if _chooses(where, known, families)]


def rules_of(found: Found) -> dict[Source, str]:
    """Return by which of `RULES` each linker names more mates, on average over all levels.

    A linker without a known rate at any level is left out.
    """
    rates: dict[Source, dict[str, list[float]]] = {}
    for key, estimate in found.items():
        if key.metric in RULES and np.isfinite(estimate.value):
            of_linker = rates.setdefault(key.measure.source, {})
            of_linker.setdefault(key.metric, []).append(estimate.value)
    means = {
        linker: {rule: float(np.mean(values)) for rule, values in by_rule.items()}
        for linker, by_rule in rates.items()
    }
    return {
        linker: max(RULES, key=lambda rule: by_rule.get(rule, -1.0))
        for linker, by_rule in means.items()
    }


def success_of(found: Found, linker: Source) -> str:
    """Return the metric of who is found by a linker: rank 1 of 100 where so many are candidates."""
    at_raw = found.get(linker.measure(SUCCESS_OF_100).at(RAW, None))
    return (
        SUCCESS_OF_100 if at_raw is not None and np.isfinite(at_raw.value) else SUCCESS
    )


def _choosing(
    blocks: Levels, known: Mapping[str, Family], families: Collection[str]
) -> Iterator[Mapping[Source, float]]:
    return (
        block for where, block in blocks.items() if _chooses(where, known, families)
    )


def _chooses(
    where: Where, known: Mapping[str, Family], families: Collection[str]
) -> bool:
    """Whether the strongest is chosen at a level, where a run has some families."""
    wanted = SWEPT if {FIXED, FID}.intersection(families) else {*families} - {CLEAN}
    return known[where[0]].family in wanted


@dataclass(frozen=True, eq=False, slots=True)
class CrossFitted:
    """What the strongest attack achieves without the bias of its choice."""

    estimates: dict[Key, Estimate] = field(
        default_factory=dict
    )  # Under the headline's name.
    choices: dict[str, list[Measure]] = field(default_factory=dict)
    """By the metric that ranks (PLR, rank 1, rank 1 of 100) whom either half of the people chose,
    with the metric that counts for it: the first half is scored by the second
    choice."""


def cross_fitted(
    sums: Mapping[Key, Summed],
    known: Mapping[str, Family],
    headline: Source,
    *,
    by: str = EXPOSURE,
) -> CrossFitted:
    """Return what the strongest attack achieves, each half of the people scored by the other's.

    The people are in two halves, `first_half` of the names of their clusters. On each
    the strongest is chosen as ever, among the headline's adversaries; every cluster
    then counts as the choice of the other half leaves it. Intervals repeat the choice
    in every replicate, and where these are a jackknife's with each cluster deleted.
    Galleries and matchings stay whole: probes alone are split.

    `sums` are of every attack, all with the same weights; attacks are ranked by the
    metric `by`. Ranked by rank 1, a linker may name mates probe by probe or all at once
    (`RULES`); rank 1 of 100 has a choice of its own.
    """
    among = HEADLINE if headline.knowledge in HEADLINE else (headline.knowledge,)
    able = {
        key: summed
        for key, summed in sums.items()
        if key.knowledge in among
        and key.measure.source.task == headline.task
        and key.consumer != IDENTITY
        and np.isfinite(summed.sums).all()
    }
    families = {known[key.mechanism].family for key in able}
    is_ceiling = families == {CLEAN}
    wheres = {
        key.where for key in able if is_ceiling or _chooses(key.where, known, families)
    }
    crossed = CrossFitted()
    for ranked, metrics in _CHOICES[by]:
        if rivals := _rivals(able, wheres, ranked):
            estimates, winners = _scored(able, rivals, headline, metrics=metrics)
            crossed.estimates.update(estimates)
            crossed.choices[ranked[0]] = winners
    return crossed


def _rivals(
    sums: Mapping[Key, Summed], wheres: Collection[Where], ranked: Collection[str]
) -> dict[Measure, list[Summed]]:
    """Return the attacks that are measured at most of some levels, and their sums there."""
    values: dict[Measure, list[Summed]] = {}
    for key, summed in sums.items():
        if key.metric in ranked and key.where in wheres and summed.sums[1].any():
            values.setdefault(key.measure, []).append(summed)
    most = max(map(len, values.values()), default=0)
    return {
        measure: levels for measure, levels in values.items() if len(levels) == most
    }


def _scored(
    sums: Mapping[Key, Summed],
    rivals: Mapping[Measure, Sequence[Summed]],
    headline: Source,
    *,
    metrics: Collection[str],
) -> tuple[dict[Key, Estimate], list[Measure]]:
    """Return the numbers of a choice among rivals under the headline's name, and both choices."""
    from evaluation.estimates.cross_fit import (  # noqa: PLC0415 - who reads needs none
        cross_fit,
    )

    first = next(iter(rivals.values()))[0]
    keys: list[Key] = []
    scored: list[list[Floats]] = []
    for where, metric in product(dict.fromkeys(key.where for key in sums), metrics):
        # A linker that names all mates at once is scored by that, too.
        measures = [
            rival if metric in RULES else rival.source.measure(metric)
            for rival in rivals
        ]
        each = [sums.get(measure.at(*where)) for measure in measures]
        known = [summed.whole() for summed in each if summed is not None]
        if len(known) == len(rivals):
            keys.append(headline.measure(metric).at(*where))
            scored.append(known)
    if not keys:
        return {}, []
    estimates, best = cross_fit(
        choosing=np.array(
            [[summed.whole() for summed in some] for some in rivals.values()]
        ),
        scored=np.array(scored).transpose(1, 0, 2, 3),
        is_first=first_half(first.clusters),
        weights=first.weights,
        is_share=[METRICS[key.metric].is_share for key in keys],
    )
    names = list(rivals)
    return dict(zip(keys, estimates, strict=True)), [names[place] for place in best]


@lru_cache(maxsize=64)  # the clusters of a run, and of each of its tasks
def first_half(clusters: tuple[str, ...]) -> Bools:
    """Return which clusters are in the first of two halves, (C,): by a hash of each one's name.

    Who else is in the run does not matter, nor its seed, nor by which pseudonym it is
    called.
    """
    return read_only(np.array([in_first_half(name) for name in clusters], dtype=bool))


def by_task(found: Found, *, metric: str) -> dict[str, Levels]:
    """Return the success of every attack by task, level, and attack.

    Of rank 1 a linker's success is that of the better of `RULES`.
    """
    values: dict[str, Levels] = {}
    ranked = RULES if metric == SUCCESS else (metric,)
    for key, one in found.items():
        if key.metric in ranked:
            source = key.measure.source
            block = values.setdefault(source.task, {}).setdefault(key.where, {})
            block[source] = float(np.fmax(block.get(source, np.nan), one.value))
    return values


def against_each(
    levels: Levels, *, among: Collection[str] = HEADLINE
) -> dict[str, Source]:
    """Return the strongest attack against each mechanism over its levels, where one counts."""
    of: dict[str, list[Mapping[Source, float]]] = {}
    for (mechanism, _), block in levels.items():
        of.setdefault(mechanism, []).append(block)
    best = {name: strongest_of(blocks, among=among) for name, blocks in of.items()}
    return {name: source for name, source in best.items() if source}


def most_knowing(of: Iterable[Source]) -> list[Source]:
    """Return what was shared, and of each attack the adversary that knows most.

    The oracle is a reference: it stands for an attack that nobody else can run.
    """
    rank = {name: place for place, name in enumerate(("", *HEADLINE))}
    best: dict[str, Source] = {}
    for source in of:
        name = "" if source == AS_SHARED else source.consumer
        pair = best.get(name, source), source
        best[name] = max(pair, key=lambda one: rank.get(one.knowledge, 0))
    return list(best.values())
