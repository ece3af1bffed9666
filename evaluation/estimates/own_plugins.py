"""A user's own plug-ins beside the built-in: the section `plugins` of `verdict.json`.

An attack, a linker or a predictor is compared with the strongest built-in of its kind
in the same run: same people, same draws, so that the difference is paired by cluster.
Both numbers are means over the levels at which the strongest attack of a run is chosen.
Where an attack has several rows, and among the built-in attacks, the strongest is
chosen on one half of the people and scored on the other. The best built-in predictor is
chosen and scored on the same people, which favours it slightly. A mechanism has a row of
numbers for each of its levels.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from evaluation.estimates.families import Family
from evaluation.estimates.json_numbers import json_interval
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.metrics import FALSE_ALARMS, MISSED_FUTURE, PLR, RANK1
from evaluation.estimates.strongest import (
    GROUPS,
    HEADLINE,
    by_task,
    choose_strongest,
    cross_fitted,
    ranking_levels,
)
from evaluation.estimates.strongest_table import StrongestAttack
from evaluation.plan.address import AS_SHARED, Address, MechanismLevel, parse_consumer
from evaluation.plan.constants import IDENTITY, ORACLE
from evaluation.store.linkage_outcomes import ClusterSums
from isac_track.intervals import Estimate, estimate_from_replicates

ATTACK: Final = "attack"
LINKER: Final = "linker"
PREDICTOR: Final = "predictor"
MECHANISM: Final = "mechanism"

_interval = partial(json_interval, "value", ends="ci")


@dataclass(frozen=True, eq=False, slots=True)
class RunNumbers:
    """Estimates of a run for comparing plug-ins, with the same bootstrap weights."""

    own: EstimatesByAddress  # Of scenes at the run's own horizon, and of linkage.
    # Of predictors, by further horizon, s, ascending.
    later: Mapping[float, EstimatesByAddress]
    sums: Mapping[Address, ClusterSums]  # Of attacks, by cluster.
    families: Mapping[str, Family]  # Mechanisms of the run.
    attacks: Sequence[StrongestAttack]  # The strongest attack against each mechanism.
    leading: str  # Linkage task that linkers are compared in; empty if none leads.


def plugin_records(
    own: Mapping[str, Sequence[str]], run: RunNumbers
) -> list[dict[str, Any]]:
    """Return a record for each plug-in of a user, and for each level of a mechanism.

    `own` are the plug-ins' SPECs by axis (`mechanisms`, `predictors`, `attacks`), as
    the manifest has them in `own_plugins`. A number is a record of `value`, `ci_low`
    and `ci_high`, None where it is not known. `rival` is empty in a run without a
    built-in plug-in of that kind.
    """
    attacks = frozenset(own.get("attacks", ()))
    predictors = frozenset(own.get("predictors", ()))
    records = [
        _attack_record(spec, own_attacks=attacks, run=run) for spec in sorted(attacks)
    ]
    records += [
        _predictor_record(spec, own_predictors=predictors, run=run)
        for spec in sorted(predictors)
    ]
    compared = [record for record in records if record is not None]
    return [*compared, *_mechanism_records(own.get("mechanisms", ()), run=run)]


def _attack_record(
    spec: str, *, own_attacks: Collection[str], run: RunNumbers
) -> dict[str, Any] | None:
    """Return the comparison of an attack or a linker; None if the run has no number."""
    attacks = {key.reader for key in run.sums if key.adversary}
    attacks |= {key.reader for key in run.own if key.metric in (PLR, RANK1)}
    tasks = {reader.task for reader in attacks if reader.attack_spec == spec}
    if not tasks:
        return None
    task = run.leading if run.leading in tasks else min(tasks)
    in_task = [reader for reader in attacks if reader.task == task and reader.adversary]
    tested = _strongest(
        [reader for reader in in_task if reader.attack_spec == spec], run=run
    )
    built_in = [
        reader
        for reader in in_task
        if reader.attack_spec not in {*own_attacks, IDENTITY}
        and reader.adversary in HEADLINE
    ]
    rival = _strongest(built_in, run=run)
    if tested is None:
        return None
    metric = RANK1 if task else PLR
    pairs: list[tuple[Estimate | None, Estimate | None]] = []
    for where in ranking_levels([*tested.levels], run.families):
        own = tested.at(where, metric, run.own)
        other = rival.at(where, metric, run.own) if rival else None
        if own is not None and (other is not None or rival is None):
            pairs.append((own, other))
    return {
        "kind": LINKER if task else ATTACK,
        "plugin": spec,
        "knowledge": tested.reader.adversary,
        "metric": metric,
        "task": task,
        "horizon_s": None,
        "rival": rival.reader.attack_spec if rival else "",
        "rival_knowledge": rival.reader.adversary if rival else "",
        **_compared(pairs),
    }


def _strongest(
    readers: Collection[Address], *, run: RunNumbers
) -> StrongestAttack | None:
    """Return the strongest of a task's attacks, cross-fitted; None without any."""
    if not readers:
        return None
    task = next(iter(readers)).task
    metric = RANK1 if task else PLR
    estimates = {key: known for key, known in run.own.items() if key.reader in readers}
    levels = by_task(estimates, metric=metric).get(task, {})
    ranking = [levels[where] for where in ranking_levels([*levels], run.families)]
    for among in (*GROUPS, (ORACLE,)):
        if reader := choose_strongest(ranking, among=among):
            sums = {
                key: summed for key, summed in run.sums.items() if key.reader in readers
            }
            crossed = cross_fitted(sums, run.families, reader, by=metric)
            return StrongestAttack("", among, reader, tuple(levels), crossed)
    return None


def _predictor_record(
    spec: str, *, own_predictors: Collection[str], run: RunNumbers
) -> dict[str, Any] | None:
    """Return the comparison of a predictor at its first horizon, if any."""
    for horizon_s, estimates in (*run.later.items(), (None, run.own)):
        robots = {key.consumer for key in estimates if key.metric == MISSED_FUTURE}
        if spec not in robots:
            continue
        measure = parse_consumer(spec).measured(MISSED_FUTURE)
        mechanism_levels = [
            key.mechanism_level for key in estimates if key.measure == measure
        ]
        levels = ranking_levels(mechanism_levels, run.families)
        missed: dict[str, list[Estimate | None]] = {
            robot: _at_levels(
                estimates, parse_consumer(robot).measured(MISSED_FUTURE), levels
            )
            for robot in (spec, *sorted(robots - {*own_predictors}))
        }
        rivals = {
            robot: mean.value
            for robot, at_levels in missed.items()
            if robot != spec and (mean := _mean(at_levels))
        }
        rival = min(rivals, key=rivals.__getitem__, default="")
        rival_missed = missed[rival] if rival else [None] * len(levels)
        alarms = {
            name: _interval(
                _mean(
                    _at_levels(
                        estimates, parse_consumer(robot).measured(FALSE_ALARMS), levels
                    )
                )
            )
            for name, robot in (("alarms", spec), ("rival_alarms", rival))
        }
        return {
            "kind": PREDICTOR,
            "plugin": spec,
            "knowledge": "",
            "metric": MISSED_FUTURE,
            "task": "",
            "horizon_s": horizon_s,
            "rival": rival,
            "rival_knowledge": "",
            **_compared([*zip(missed[spec], rival_missed, strict=True)]),
            **alarms,
        }
    return None


def _at_levels(
    estimates: EstimatesByAddress, measure: Address, levels: Sequence[MechanismLevel]
) -> list[Estimate | None]:
    return [estimates.get(measure.at(*where)) for where in levels]


def _mechanism_records(
    specs: Sequence[str], *, run: RunNumbers
) -> Iterator[dict[str, Any]]:
    """Yield a robot's misses and the leaks at each level of a user's own mechanisms."""
    horizon_s, robots = next(iter(run.later.items()), (None, run.own))
    mechanisms = {*specs}
    levels = dict.fromkeys(
        key.mechanism_level for key in run.own if key.mechanism in mechanisms
    )
    attacks = {
        attack.mechanism: attack for attack in run.attacks if _leads(attack, task="")
    }
    linkers = {
        linker.mechanism: linker
        for linker in run.attacks
        if _leads(linker, task=run.leading)
    }
    for where in levels:
        missed = {
            key.consumer: estimate
            for key, estimate in robots.items()
            if key.mechanism_level == where
            and key.metric == MISSED_FUTURE
            and np.isfinite(estimate.value)
        }
        robot = min(missed, key=lambda name: missed[name].value, default="")
        attack, linker = attacks.get(where.mechanism), linkers.get(where.mechanism)
        yield {
            "kind": MECHANISM,
            "plugin": where.mechanism,
            "level": where.level,
            "horizon_s": horizon_s,
            "robot": robot,
            "missed": _interval(missed.get(robot)),
            "as_sent": _interval(run.own.get(AS_SHARED.at(*where, PLR))),
            "attacked": _interval(attack.at(where, PLR, run.own) if attack else None),
            "task": run.leading,
            "linked": _interval(
                linker.at(where, RANK1, run.own) if linker and run.leading else None
            ),
        }


def _leads(attack: StrongestAttack, *, task: str) -> bool:
    return attack.among == HEADLINE and attack.reader.task == task


def _compared(
    pairs: Sequence[tuple[Estimate | None, Estimate | None]],
) -> dict[str, Any]:
    """Return the means over levels of a plug-in, its rival, and their difference."""
    tested = _mean([own for own, _ in pairs])
    rival = _mean([other for _, other in pairs])
    gap = None
    if tested is not None and rival is not None:
        n_drawn = min(tested.drawn.size, rival.drawn.size)
        n = min(tested.n, rival.n)
        effective = min(tested.n_effective, rival.n_effective)
        drawn = tested.drawn[:n_drawn] - rival.drawn[:n_drawn]
        gap = estimate_from_replicates(drawn, n=n, effective=effective)
    return {
        "levels": len(pairs),
        "n": tested.n if tested else 0,
        "own": _interval(tested),
        "other": _interval(rival),
        "difference": _interval(gap),
    }


def _mean(estimates: Sequence[Estimate | None]) -> Estimate | None:
    """Return the mean over levels, by replicate; None if a level is missing."""
    known = [
        estimate
        for estimate in estimates
        if estimate is not None and np.isfinite(estimate.value)
    ]
    if not known or len(known) < len(estimates):
        return None
    n_drawn = min(estimate.drawn.size for estimate in known)
    drawn = np.mean([estimate.drawn[:n_drawn] for estimate in known], axis=0)
    effective = min(estimate.n_effective for estimate in known)
    return estimate_from_replicates(
        drawn, n=min(estimate.n for estimate in known), effective=effective
    )
