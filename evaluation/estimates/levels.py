"""Costs and privacy of each level that a site could choose: `levels.csv`.

A row is a number of a level. There are the misses and false alarms of robots at every
horizon of the run, and those of the cross-fitted best robot under a name of its own
(`evaluation.estimates.best_robot`). There are the descriptors as shared and after the
strongest attack of each group of adversaries. And there is rank 1 of the strongest
linker of each task, also as a share of its rank 1 under raw. The table has raw and the
mechanisms that protect, no others.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates.best_robot import BestRobots
from evaluation.estimates.families import RAW, Family
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.metrics import (
    CHANCE,
    COSTS,
    DESCRIPTORS,
    DISTANCE,
    FALSE_ALARMS,
    LINKAGE_SHARE,
    MEDIAN_ERROR,
    PLR,
    PLR_WIDE,
    RANK1,
    RANK1_AMONG_100,
)
from evaluation.estimates.recordings import task_recording
from evaluation.estimates.strongest import (
    HEADLINE,
    by_task,
    strongest_by_mechanism,
    success_metric,
)
from evaluation.estimates.strongest_table import SINGLE_RELEASE, StrongestAttack
from evaluation.plan.address import AS_SHARED, Address, MechanismLevel, parse_row
from evaluation.plan.world import OWN_WORLD, World
from isac_track.intervals import Estimate, estimate_from_replicates
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
_ROBOT_METRICS: Final = (*COSTS, FALSE_ALARMS)
_LINKER_METRICS: Final = (RANK1, RANK1_AMONG_100)
_UNKNOWN: Final = Estimate(np.nan)


def group_name(among: tuple[str, ...]) -> str:
    """Return the name of a group of adversaries."""
    return SINGLE_RELEASE if among == HEADLINE else among[0]


def linkage_share(
    linked: Estimate, chance: float, raw: Estimate, raw_chance: float
) -> Estimate:
    """Return rank 1 above chance as a share of the same under raw, paired by cluster.

    The replicates of both estimates must come from the same rows of weights. NaN where
    raw does not link.
    """
    n_drawn = min(linked.replicates.size, raw.replicates.size)
    above = linked.drawn[: n_drawn + 1] - chance
    raw_above = raw.drawn[: n_drawn + 1] - raw_chance
    share = np.full(n_drawn + 1, np.nan)
    np.divide(above, raw_above, out=share, where=raw_above > 0.0)
    effective = min(linked.n_effective, raw.n_effective)
    # Where raw hardly links the share is large: to leave out a replicate in which it
    # does not link would lower the upper end, which decides.
    if not np.isfinite(share).all() or not n_drawn:
        return Estimate(float(share[0]), n=min(linked.n, raw.n), effective=effective)
    return estimate_from_replicates(share, n=min(linked.n, raw.n), effective=effective)


def levels(
    estimates: EstimatesByAddress,
    *,
    attacks: Sequence[StrongestAttack],
    horizons: Mapping[World, EstimatesByAddress],
    best: Mapping[World, BestRobots],
    linked: pd.DataFrame,
    families: Mapping[str, Family],
    dataset: str,
) -> pd.DataFrame:
    """Return a row for each number of raw and of every protecting level: `COLUMNS`.

    A level protects if its mechanism claims to. `estimates` are all those of the run,
    misses at raw's false alarms among them; `attacks` are the strongest on each
    mechanism; `horizons` are the estimates of robots at further horizons; `best` are
    the best robots by horizon; `linked` is `linkability.csv`.
    """
    chosen = {
        name
        for name, family in families.items()
        if family.protects or family.family == RAW
    }
    own = _select(estimates, chosen)
    rows = list(_robot_rows(own, OWN_WORLD, families, dataset))
    for world, numbers in horizons.items():
        at_horizon = _select(numbers, chosen)
        rows += _robot_rows(at_horizon, world, families, dataset)
    for world, robots in best.items():
        rows += _best_robot_rows(robots, world, families, dataset)
    rows += [
        _row(key, number, families, dataset)
        for key, number in own.items()
        if key.reader == AS_SHARED and key.metric in {*DESCRIPTORS, *DISTANCE}
    ]
    attacks_on_chosen = [attack for attack in attacks if attack.mechanism in chosen]
    rows += _reconstruction_rows(attacks_on_chosen, own, families, dataset)
    rows += _linker_rows(attacks_on_chosen, own, linked, families, dataset)
    return pd.DataFrame(rows, columns=COLUMNS)


def _select(
    estimates: EstimatesByAddress, mechanisms: Collection[str]
) -> dict[Address, Estimate]:
    return {
        key: number for key, number in estimates.items() if key.mechanism in mechanisms
    }


def _reconstruction_rows(
    attacks: Sequence[StrongestAttack],
    estimates: EstimatesByAddress,
    families: Mapping[str, Family],
    dataset: str,
) -> Iterator[dict[str, Any]]:
    """Yield the descriptors after the strongest reconstructions."""
    success_at_wide = by_task(estimates, metric=PLR_WIDE).get("", {})
    for attack in attacks:
        if attack.reader.task:
            continue
        # At the wider epsilon another attack may be stronger.
        at_wide = strongest_by_mechanism(success_at_wide, among=attack.among).get(
            attack.mechanism, attack.reader
        )
        for where in attack.levels:
            for metric in (*DESCRIPTORS, MEDIAN_ERROR, PLR_WIDE):
                reader = attack.reader
                key = reader.at(*where, metric)
                estimate = attack.at(where, metric, estimates)
                if metric == PLR_WIDE and key not in attack.crossed.estimates:
                    reader = at_wide
                    estimate = estimates.get(reader.at(*where, PLR_WIDE))
                if estimate is not None:
                    own = reader.at(*where, metric)
                    about = {
                        "adversary": group_name(attack.among),
                        **_choices(attack, metric),
                    }
                    yield _row(own, estimate, families, dataset) | about


def _robot_rows(
    estimates: EstimatesByAddress,
    world: World,
    families: Mapping[str, Family],
    dataset: str,
) -> Iterator[dict[str, Any]]:
    name = Address(recording=dataset, world=world).dataset
    for key, number in estimates.items():
        if key.metric in _ROBOT_METRICS:
            yield _row(key, number, families, name)


def _best_robot_rows(
    robots: BestRobots, world: World, families: Mapping[str, Family], dataset: str
) -> Iterator[dict[str, Any]]:
    name = Address(recording=dataset, world=world).dataset
    for key, number in robots.estimates.items():
        first, second = robots.choices[key.consumer]
        chosen = {"first_choice": first, "second_choice": second}
        yield _row(key, number, families, name) | chosen


def _linker_rows(
    attacks: Sequence[StrongestAttack],
    estimates: EstimatesByAddress,
    linked: pd.DataFrame,
    families: Mapping[str, Family],
    dataset: str,
) -> Iterator[dict[str, Any]]:
    """Yield rank 1 of each task's strongest linker, chance, and its share of raw's."""
    by_linker = _linkage_rows(linked)
    linkers = [
        attack for attack in attacks if attack.reader.task and attack.among == HEADLINE
    ]
    raws = {
        linker.reader.task: linker
        for linker in linkers
        if families[linker.mechanism].family == RAW
    }
    for linker in linkers:
        reader, raw = linker.reader, raws.get(linker.reader.task)
        metric = success_metric(estimates, (raw or linker).reader)
        data = task_recording(reader.task, dataset=dataset)
        for where in linker.levels:
            key = reader.at(*where, metric)
            known = by_linker.get(reader.at(*where), {})
            about = {
                name: str(known.get(name) or "") for name in ("outcome", "invalid")
            }
            about |= {"adversary": group_name(linker.among), **_choices(linker, metric)}
            chance = _chance(reader, metric, where, estimates)
            rank = linker.at(where, metric, estimates) or _UNKNOWN
            numbers = {metric: rank, CHANCE: Estimate(chance)}
            if raw is not None:
                at_raw = raw.at(raw.levels[0], metric, estimates) or _UNKNOWN
                raw_chance = _chance(raw.reader, metric, raw.levels[0], estimates)
                share = linkage_share(rank, chance, at_raw, raw_chance)
                numbers[LINKAGE_SHARE] = share
            for name, number in numbers.items():
                row = _row(key.measured(name), number, families, data)
                yield row | about


def _linkage_rows(linked: pd.DataFrame) -> dict[Address, dict[Any, Any]]:
    """Return the rows of `linkability.csv` of all people, by level and linker."""
    if linked.empty:
        return {}
    rows = linked[linked["cohort"] == "all"].to_dict("records")
    return {parse_row(row).within(): row for row in rows}


def _choices(attack: StrongestAttack, metric: str) -> dict[str, str]:
    """Return the attack that either half chose, where the number is cross-fitted."""
    ranked = metric if metric in (PLR_WIDE, *_LINKER_METRICS) else PLR
    labels = [measure.label for measure in attack.crossed.choices.get(ranked, ())]
    first, second = labels or ("", "")
    return {"first_choice": first, "second_choice": second}


def _chance(
    reader: Address, metric: str, where: MechanismLevel, estimates: EstimatesByAddress
) -> float:
    if metric == RANK1_AMONG_100:
        return 1.0 / GALLERY
    return estimates.get(reader.at(*where, CHANCE), _UNKNOWN).value


def _row(
    key: Address, number: Estimate, families: Mapping[str, Family], dataset: str
) -> dict[str, Any]:
    family = families[key.mechanism]
    return {
        **key.to_columns(),
        "dataset": dataset,
        "family": family.family,
        "adding": family.adding,
        "protects": family.protects,
        "adversary": "",
        **{name: getattr(number, name) for name in ("value", "ci_low", "ci_high", "n")},
        "outcome": "",
        "invalid": "",
        "first_choice": "",
        "second_choice": "",
    }
