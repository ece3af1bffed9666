"""What a site would get and pay at each level that it could choose: `levels.csv`.

A row is a number of a level: what robots miss and how often they raise a false alarm, at every
horizon of the run; the descriptors as shared and after the strongest attack of each group of
adversaries; and how often the strongest linker of a task finds a person again, also as a share of
what it finds under raw. Raw is there, too, and mechanisms that do not protect are not.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.analysis.families import RAW, Family
from evaluation.analysis.keys import AS_SHARED, Found, Key, Source, Where
from evaluation.analysis.linkability import dataset_of
from evaluation.analysis.metrics import (
    COSTS,
    DESCRIPTORS,
    DISTANCE,
    EXPOSURE,
    FALSE_ALARMS,
    LINKAGE_SHARE,
    MEDIAN,
    SUCCESS,
    SUCCESS_OF_100,
    WIDE,
)
from evaluation.analysis.strongest import GROUPS, HEADLINE, against_each, by_task, cross_fitted
from evaluation.runs.cell_files import Summed
from isac_track.intervals import Estimate, estimate_of
from isac_track.linkability import GALLERY

ONE_RELEASE: Final = "one release"  # Group of the headline's adversaries: blind and informed.
COLUMNS: Final = [
    *("dataset", "mechanism", "level", "family", "adding", "protects"),
    *("adversary", "consumer", "knowledge", "metric", "value", "ci_low", "ci_high", "n"),
    *("outcome", "invalid"),
]
_OF_ROBOTS: Final = (*COSTS, FALSE_ALARMS)
_UNKNOWN: Final = Estimate(np.nan)


@dataclass(frozen=True, eq=False, slots=True)
class Strongest:
    """The strongest attack of a group of adversaries on one mechanism, and what it achieves."""

    task: str  # Empty: it reconstructs.
    adversary: str  # `ONE_RELEASE`, or an adversary with a name.
    source: Source
    numbers: Found  # At the levels of the mechanism.


def group_name(among: tuple[str, ...]) -> str:
    """Return the name of a group of adversaries."""
    return ONE_RELEASE if among == HEADLINE else among[0]


def strongest_on_each(
    found: Found, sums: Mapping[Key, Summed], known: Mapping[str, Family], *, seed: int, by: str
) -> dict[str, list[Strongest]]:
    """Return the strongest attacks on every mechanism, by mechanism; `by` is what they rank by.

    Each is chosen against the mechanism alone and, where `sums` are known, on one half of the
    people and scored on the other, and the reverse: this is the only place that asks who is
    strongest where a level is recommended.
    """
    own: dict[tuple[str, str], dict[Key, Summed]] = {}
    for key, one in sums.items():
        own.setdefault((key.mechanism, key.measure.source.task), {})[key] = one
    best: dict[str, list[Strongest]] = {}
    for task, levels in by_task(found, metric=by).items():
        for among in GROUPS:
            for name, source in against_each(levels, among=among).items():
                mine = own.get((name, task), {})
                crossed = cross_fitted(mine, known, source, seed=seed, by=by)[0]
                wheres = [where for where in levels if where[0] == name]
                numbers = _numbers(found, source, wheres) | crossed
                best.setdefault(name, []).append(
                    Strongest(task, group_name(among), source, numbers)
                )
    return best


def _numbers(found: Found, source: Source, wheres: list[Where]) -> dict[Key, Estimate]:
    metrics = (*DESCRIPTORS, *DISTANCE, SUCCESS, SUCCESS_OF_100, "chance")
    keys = (source.measure(metric).at(*where) for metric in metrics for where in wheres)
    return {key: found[key] for key in keys if key in found}


def linked_share(linked: Estimate, chance: float, raw: Estimate, raw_chance: float) -> Estimate:
    """Return how much of raw's rank 1 above chance is left, paired by person cluster.

    The estimates have their replicates from the same rows of weights. NaN where raw does not link.
    """
    n_drawn = min(linked.replicates.size, raw.replicates.size)
    above, of_raw = linked.drawn[: n_drawn + 1] - chance, raw.drawn[: n_drawn + 1] - raw_chance
    share = np.full(n_drawn + 1, np.nan)
    np.divide(above, of_raw, out=share, where=of_raw > 0.0)
    effective = min(linked.n_effective, raw.n_effective)
    if not np.isfinite(share).all() or not n_drawn:
        return Estimate(float(share[0]), n=min(linked.n, raw.n), effective=effective)
    return estimate_of(share, n=min(linked.n, raw.n), effective=effective)


def levels(
    found: Found,
    *,
    sums: Mapping[Key, Summed],
    horizons: Mapping[str, Found],
    linked: pd.DataFrame,
    known: Mapping[str, Family],
    dataset: str,
    seed: int,
) -> pd.DataFrame:
    """Return a row for each number of raw and of every level that claims to protect: `COLUMNS`.

    `found` is every estimate of the run, misses at raw's false alarms among them, `sums` those of
    the attacks by cluster, `horizons` the estimates of robots by further horizon (as in `dataset`,
    behind the name), `linked` is `linkability.csv`.
    """
    chosen = {name for name, one in known.items() if one.protects or one.family == RAW}
    own = {key: one for key, one in found.items() if key.mechanism in chosen}
    its_sums = {key: one for key, one in sums.items() if key.mechanism in chosen}
    rows = list(_of_robots(own, "", known, dataset))
    for world, of_world in horizons.items():
        some = {key: one for key, one in of_world.items() if key.mechanism in chosen}
        rows += _of_robots(some, world, known, dataset)
    rows += [
        _row(key, one, known, dataset)
        for key, one in own.items()
        if key.measure.source == AS_SHARED and key.metric in {*DESCRIPTORS, *DISTANCE}
    ]
    for by, metrics in ((EXPOSURE, (*DESCRIPTORS, MEDIAN)), (WIDE, (WIDE,))):
        on_each = strongest_on_each(own, its_sums, known, seed=seed, by=by)
        rows += [
            _row(key, one, known, dataset, adversary=best.adversary)
            for bests in on_each.values()
            for best in bests
            if not best.task
            for key, one in best.numbers.items()
            if key.metric in metrics
        ]
    on_each = strongest_on_each(own, its_sums, known, seed=seed, by=SUCCESS)
    rows += _of_linkers(on_each, linked, known, dataset)
    return pd.DataFrame(rows, columns=COLUMNS)


def _of_robots(
    found: Found, world: str, known: Mapping[str, Family], dataset: str
) -> Iterator[dict[str, Any]]:
    name = f"{dataset}:{world}" if world else dataset
    for key, one in found.items():
        if key.metric in _OF_ROBOTS:
            yield _row(key, one, known, name)


def _of_linkers(
    on_each: Mapping[str, list[Strongest]],
    linked: pd.DataFrame,
    known: Mapping[str, Family],
    dataset: str,
) -> Iterator[dict[str, Any]]:
    """Yield what the strongest linker of each task finds, and its share of what raw leaves."""
    cards = (
        {
            (row["mechanism"], row["level"], row["consumer"], row["knowledge"]): row
            for row in linked[linked["cohort"] == "all"].to_dict("records")
        }
        if len(linked)
        else {}
    )
    cards = {
        (name, None if np.isnan(level) else level, consumer, knowledge): row
        for (name, level, consumer, knowledge), row in cards.items()
    }
    raws = {one.task: one for one in on_each.get(RAW, ()) if one.task}
    for bests in on_each.values():
        for best in (one for one in bests if one.task and one.adversary == ONE_RELEASE):
            raw = raws.get(best.task)
            metric = _rank_of(raw or best)
            for where in dict.fromkeys(key.where for key in best.numbers):
                key = best.source.measure(metric).at(*where)
                card = cards.get((*where, *best.source), {})
                about = {of: str(card.get(of) or "") for of in ("outcome", "invalid")}
                about["adversary"] = best.adversary
                data = dataset_of(best.source.consumer, dataset=dataset)
                rank = best.numbers.get(key, _UNKNOWN)
                yield _row(key, rank, known, data) | about
                chance = _chance(best, metric, where)
                yield _row(key._replace(metric="chance"), Estimate(chance), known, data) | about
                if raw is not None:
                    at_raw = raw.numbers.get(raw.source.measure(metric).at(RAW, None), _UNKNOWN)
                    its_chance = _chance(raw, metric, (RAW, None))
                    share = linked_share(rank, chance, at_raw, its_chance)
                    yield _row(key._replace(metric=LINKAGE_SHARE), share, known, data) | about


def _rank_of(one: Strongest) -> str:
    """Return rank 1 of 100 where a task has so many candidates, else rank 1."""
    values = (of.value for key, of in one.numbers.items() if key.metric == SUCCESS_OF_100)
    return SUCCESS_OF_100 if any(map(np.isfinite, values)) else SUCCESS


def _chance(one: Strongest, metric: str, where: Where) -> float:
    if metric == SUCCESS_OF_100:
        return 1.0 / GALLERY
    return one.numbers.get(one.source.measure("chance").at(*where), _UNKNOWN).value


def _row(
    key: Key, one: Estimate, known: Mapping[str, Family], dataset: str, *, adversary: str = ""
) -> dict[str, Any]:
    family = known[key.mechanism]
    return {
        "dataset": dataset,
        "mechanism": key.mechanism,
        "level": np.nan if key.level is None else key.level,
        "family": family.family,
        "adding": family.adding,
        "protects": family.protects,
        "adversary": adversary,
        "consumer": key.consumer,
        "knowledge": key.knowledge,
        "metric": key.metric,
        **{name: getattr(one, name) for name in ("value", "ci_low", "ci_high", "n")},
        "outcome": "",
        "invalid": "",
    }
