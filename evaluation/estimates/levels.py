"""What a site would get and pay at each level that it could choose: `levels.csv`.

A row is a number of a level: what robots miss and how often they raise a false alarm,
at every horizon of the run, and the same of the cross-fitted best robot, under names of
its own (`evaluation.estimates.best_robot`); the descriptors as shared and after the
strongest attack of each group of adversaries; and how often the strongest linker of a
task finds a person again, also as a share of what it finds under raw. Raw is there,
too; mechanisms that do not protect are not.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates.best_robot import BestRobots
from evaluation.estimates.families import RAW, Family
from evaluation.estimates.keys import AS_SHARED, Found, Key, Source, Where
from evaluation.estimates.linkability import dataset_of
from evaluation.estimates.metrics import (
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
from evaluation.estimates.strongest import HEADLINE, against_each, by_task, success_of
from evaluation.estimates.strongest_table import ONE_RELEASE, Strongest
from isac_track.intervals import Estimate, estimate_of
from isac_track.linkability import GALLERY

COLUMNS: Final = [
    "dataset",
    "mechanism",
    "level",
    "family",
    "adding",
    "protects",
    "adversary",
    "consumer",
    "knowledge",
    "metric",
    "value",
    "ci_low",
    "ci_high",
    "n",
    "outcome",
    "invalid",
    "first_choice",
    "second_choice",
]
"""The last two: the robot, or the attack, that either half of the people chose."""
_OF_ROBOTS: Final = (*COSTS, FALSE_ALARMS)
_OF_LINKERS: Final = (SUCCESS, SUCCESS_OF_100)
_UNKNOWN: Final = Estimate(np.nan)


def group_name(among: tuple[str, ...]) -> str:
    """Return the name of a group of adversaries."""
    return ONE_RELEASE if among == HEADLINE else among[0]


def linked_share(
    linked: Estimate, chance: float, raw: Estimate, raw_chance: float
) -> Estimate:
    """Return how much of raw's rank 1 above chance is left, paired by person cluster.

    The estimates have their replicates from the same rows of weights. NaN where raw
    does not link.
    """
    n_drawn = min(linked.replicates.size, raw.replicates.size)
    above, of_raw = (
        linked.drawn[: n_drawn + 1] - chance,
        raw.drawn[: n_drawn + 1] - raw_chance,
    )
    share = np.full(n_drawn + 1, np.nan)
    np.divide(above, of_raw, out=share, where=of_raw > 0.0)
    effective = min(linked.n_effective, raw.n_effective)
    if not np.isfinite(share).all() or not n_drawn:
        return Estimate(float(share[0]), n=min(linked.n, raw.n), effective=effective)
    return estimate_of(share, n=min(linked.n, raw.n), effective=effective)


def levels(
    found: Found,
    *,
    attacks: Sequence[Strongest],
    horizons: Mapping[str, Found],
    best: Mapping[str, BestRobots],
    linked: pd.DataFrame,
    known: Mapping[str, Family],
    dataset: str,
) -> pd.DataFrame:
    """Return a row for each number of raw and of every level that claims to protect: `COLUMNS`.

    `found` is every estimate of the run, misses at raw's false alarms among them,
    `attacks` are the strongest on each mechanism, `horizons` the estimates of robots by
    further horizon (as in `dataset`, behind the name), `best` the best robots by
    horizon (empty: the run's own), `linked` is `linkability.csv`.
    """
    chosen = {
        name
        for name, family in known.items()
        if family.protects or family.family == RAW
    }
    own = {key: number for key, number in found.items() if key.mechanism in chosen}
    rows = list(_of_robots(own, "", known, dataset))
    for world, of_world in horizons.items():
        some = {
            key: number for key, number in of_world.items() if key.mechanism in chosen
        }
        rows += _of_robots(some, world, known, dataset)
    for world, robots in best.items():
        rows += _of_best_robots(robots, world, known, dataset)
    rows += [
        _row(key, number, known, dataset)
        for key, number in own.items()
        if key.measure.source == AS_SHARED and key.metric in {*DESCRIPTORS, *DISTANCE}
    ]
    some_attacks = [attack for attack in attacks if attack.mechanism in chosen]
    rows += _of_reconstructions(some_attacks, own, known, dataset)
    rows += _of_linkers(some_attacks, own, linked, known, dataset)
    return pd.DataFrame(rows, columns=COLUMNS)


def _of_reconstructions(
    attacks: Sequence[Strongest],
    found: Found,
    known: Mapping[str, Family],
    dataset: str,
) -> Iterator[dict[str, Any]]:
    """Yield what the strongest reconstructions leave."""
    farther = by_task(found, metric=WIDE).get("", {})
    for attack in attacks:
        if attack.source.task:
            continue
        # Farther off another attack may be the stronger one.
        at_wide = against_each(farther, among=attack.among).get(
            attack.mechanism, attack.source
        )
        for where in attack.wheres:
            for metric in (*DESCRIPTORS, MEDIAN, WIDE):
                key, source = attack.source.measure(metric).at(*where), attack.source
                estimate = attack.at(where, metric, found)
                if metric == WIDE and key not in attack.crossed.estimates:
                    source = at_wide
                    estimate = found.get(source.measure(WIDE).at(*where))
                if estimate is not None:
                    own = source.measure(metric).at(*where)
                    about = {
                        "adversary": group_name(attack.among),
                        **_choices(attack, metric),
                    }
                    yield _row(own, estimate, known, dataset) | about


def _of_robots(
    found: Found, world: str, known: Mapping[str, Family], dataset: str
) -> Iterator[dict[str, Any]]:
    name = f"{dataset}:{world}" if world else dataset
    for key, number in found.items():
        if key.metric in _OF_ROBOTS:
            yield _row(key, number, known, name)


def _of_best_robots(
    robots: BestRobots, world: str, known: Mapping[str, Family], dataset: str
) -> Iterator[dict[str, Any]]:
    name = f"{dataset}:{world}" if world else dataset
    for key, number in robots.estimates.items():
        first, second = robots.choices[key.consumer]
        chosen = {"first_choice": first, "second_choice": second}
        yield _row(key, number, known, name) | chosen


def _of_linkers(
    attacks: Sequence[Strongest],
    found: Found,
    linked: pd.DataFrame,
    known: Mapping[str, Family],
    dataset: str,
) -> Iterator[dict[str, Any]]:
    """Yield what the strongest linker of each task finds, and its share of what raw leaves."""
    cards = _cards(linked)
    linkers = [
        attack for attack in attacks if attack.source.task and attack.among == HEADLINE
    ]
    raws = {
        linker.source.task: linker
        for linker in linkers
        if known[linker.mechanism].family == RAW
    }
    for linker in linkers:
        raw = raws.get(linker.source.task)
        metric = success_of(found, (raw or linker).source)
        data = dataset_of(linker.source.consumer, dataset=dataset)
        for where in linker.wheres:
            key = linker.source.measure(metric).at(*where)
            card = cards.get((*where, *linker.source), {})
            about = {name: str(card.get(name) or "") for name in ("outcome", "invalid")}
            about |= {"adversary": group_name(linker.among), **_choices(linker, metric)}
            rank = linker.at(where, metric, found) or _UNKNOWN
            chance = _chance(linker.source, metric, where, found)
            yield _row(key, rank, known, data) | about
            yield (
                _row(key._replace(metric="chance"), Estimate(chance), known, data)
                | about
            )
            if raw is not None:
                at_raw = raw.at(raw.wheres[0], metric, found) or _UNKNOWN
                its_chance = _chance(raw.source, metric, raw.wheres[0], found)
                share = linked_share(rank, chance, at_raw, its_chance)
                yield (
                    _row(key._replace(metric=LINKAGE_SHARE), share, known, data) | about
                )


def _cards(linked: pd.DataFrame) -> dict[tuple[Any, ...], dict[Any, Any]]:
    """Return the rows of `linkability.csv` of everybody, by level and linker."""
    cards = {}
    for row in (
        linked[linked["cohort"] == "all"].to_dict("records") if len(linked) else ()
    ):
        level = None if np.isnan(row["level"]) else row["level"]
        cards[row["mechanism"], level, row["consumer"], row["knowledge"]] = row
    return cards


def _choices(attack: Strongest, metric: str) -> dict[str, str]:
    """Return which attack either half of the people chose, where the number is cross-fitted."""
    ranked = metric if metric in (WIDE, *_OF_LINKERS) else EXPOSURE
    labels = [measure.label for measure in attack.crossed.choices.get(ranked, ())]
    first, second = labels or ("", "")
    return {"first_choice": first, "second_choice": second}


def _chance(source: Source, metric: str, where: Where, found: Found) -> float:
    if metric == SUCCESS_OF_100:
        return 1.0 / GALLERY
    return found.get(source.measure("chance").at(*where), _UNKNOWN).value


def _row(
    key: Key, number: Estimate, known: Mapping[str, Family], dataset: str
) -> dict[str, Any]:
    family = known[key.mechanism]
    return {
        "dataset": dataset,
        "mechanism": key.mechanism,
        "level": np.nan if key.level is None else key.level,
        "family": family.family,
        "adding": family.adding,
        "protects": family.protects,
        "adversary": "",
        "consumer": key.consumer,
        "knowledge": key.knowledge,
        "metric": key.metric,
        **{name: getattr(number, name) for name in ("value", "ci_low", "ci_high", "n")},
        "outcome": "",
        "invalid": "",
        "first_choice": "",
        "second_choice": "",
    }
