"""The strongest attack: one definition, for the verdict, the tables, the page and a site's level.

It is the attack with the highest mean success over some levels: PLR after a reconstruction, rank 1
of a linker; of equals the first. Those count that ran at all of these levels, short of the oracle,
who is a reference, and of the control, which takes positions as they are.

The strongest of a run is chosen over all levels of raw, fixed noise and FID, so that the choice
favours none of them; of a run with neither of the two over all levels but the ceiling. It is the
*headline adversary*, one for reconstruction and one for each linkage task, whose is every number
after attack without a name.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from evaluation.analysis.families import CLEAN, FID, FIXED, RAW, SWEPT, Family
from evaluation.analysis.keys import AS_SHARED, INFORMED, Found, Key, Source, Where
from evaluation.analysis.metrics import EXPOSURE, METRICS, SUCCESS, SUCCESS_OF_100
from evaluation.experiment.presets import IDENTITY
from isac_track.rng import stream

if TYPE_CHECKING:
    from evaluation.runs.cell_files import Summed
    from isac_track.intervals import Estimate

Levels: TypeAlias = "dict[Where, dict[Source, float]]"  # Success of every attack at each level.
HEADLINE: Final = ("blind", INFORMED)  # Adversaries of whom the strongest is the headline.
BEYOND: Final = ("repeats", "anchor", "companions", "insider")  # Who knows more: told beside it.
GROUPS: Final = (HEADLINE, *((name,) for name in BEYOND))  # Each has its strongest.


def strongest_of(
    levels: Iterable[Mapping[Source, float]], *, among: Collection[str] = HEADLINE
) -> Source | None:
    """Return the strongest attack over some levels, or None if none counts.

    `levels` is of each level the success of every attack; those of the adversaries `among` count.
    """
    values: dict[Source, list[float]] = {}
    for level in levels:
        for source, value in level.items():
            if source.knowledge in among and source.consumer != IDENTITY:
                values.setdefault(source, []).append(value)
    most = max(map(len, values.values()), default=0)
    means = {source: float(np.mean(one)) for source, one in values.items() if len(one) == most}
    finite = [source for source, mean in means.items() if np.isfinite(mean)]
    return max(finite, key=means.__getitem__, default=None)


def strongest(found: Found, known: Mapping[str, Family]) -> dict[str, Source]:
    """Return the strongest linker of a run by task; under "" the strongest reconstruction.

    `found` is every estimate of the run, `known` its mechanisms.
    """
    best = {}
    for metric in (EXPOSURE, SUCCESS):
        levels = by_task(found, metric=metric)
        families = {known[name].family for blocks in levels.values() for name, _ in blocks}
        for task, blocks in levels.items():
            if one := strongest_of(_choosing(blocks, known, families)):
                best[task] = one
    return best


def success_of(found: Found, linker: Source) -> str:
    """Return the metric of who is found by a linker: rank 1 of 100 where so many are candidates."""
    at_raw = found.get(linker.measure(SUCCESS_OF_100).at(RAW, None))
    return SUCCESS_OF_100 if at_raw is not None and np.isfinite(at_raw.value) else SUCCESS


def _choosing(
    blocks: Levels, known: Mapping[str, Family], families: Collection[str]
) -> Iterator[Mapping[Source, float]]:
    wanted = SWEPT if {FIXED, FID}.intersection(families) else {*families} - {CLEAN}
    return (block for (name, _), block in blocks.items() if known[name].family in wanted)


def cross_fitted(
    sums: Mapping[Key, Summed],
    known: Mapping[str, Family],
    headline: Source,
    *,
    seed: int,
    by: str = EXPOSURE,
) -> tuple[dict[Key, Estimate], list[Source]]:
    """Return what the headline attack achieves without the bias of its choice.

    On each half of the people (clusters, drawn once) the strongest is chosen as ever, among the
    headline's adversaries; every cluster then counts as the choice of the other half leaves it.
    Also returns the two choices; nothing if both are the headline, whose estimates these would be.
    `sums` are of every attack, all with the same weights; attacks are ranked by the metric `by`.
    """
    from isac_track.intervals import ratio_estimates  # noqa: PLC0415 - who reads a run needs none

    if not sums:
        return {}, []
    weights = next(iter(sums.values())).weights
    n = weights.shape[1]
    is_first = stream(seed, "strongest", "halves").permutation(n) < n / 2
    families = {known[key.mechanism].family for key in sums}
    among = HEADLINE if headline.knowledge in HEADLINE else (headline.knowledge,)
    choices = []
    for half in (is_first, ~is_first):
        levels: Levels = {}
        for key, one in sums.items():
            over, under = one.whole()[:, half].sum(axis=1) if key.metric == by else (0.0, 0.0)
            if under > 0.0:
                levels.setdefault(key.where, {})[key.measure.source] = float(over / under)
        choices.append(strongest_of(_choosing(levels, known, families), among=among))
    of_first, of_second = choices
    if of_first is None or of_second is None or of_first == of_second == headline:
        return {}, []
    keys, mixed = [], []
    for key, second in sums.items():
        first = sums.get(of_second.measure(key.metric).at(*key.where))
        if key.measure.source == of_first and first is not None:
            keys.append(headline.measure(key.metric).at(*key.where))
            mixed.append(np.where(is_first, first.whole(), second.whole()))
    over, under = np.stack(mixed, axis=1)
    is_share = [METRICS[key.metric].is_share for key in keys]
    found = ratio_estimates(numerator=over, denominator=under, weights=weights, is_share=is_share)
    return dict(zip(keys, found, strict=True)), [of_first, of_second]


def by_task(found: Found, *, metric: str) -> dict[str, Levels]:
    """Return the success of every attack by task, level, and attack."""
    values: dict[str, Levels] = {}
    for key, one in found.items():
        if key.metric == metric:
            source = Source(key.consumer, key.knowledge)
            values.setdefault(source.task, {}).setdefault(key.where, {})[source] = one.value
    return values


def against_each(levels: Levels, *, among: Collection[str] = HEADLINE) -> dict[str, Source]:
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
