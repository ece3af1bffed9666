"""A user's own plug-ins beside the built-in ones: the section `plugins` of `verdict.json`.

An attack, a linker or a predictor is held against the strongest built-in of its kind in
the same run: same people, same draws, so that the difference is paired by cluster. Both
are means over the levels at which the strongest attack of a run is chosen. Where an
attack has several rows, and among the built-in attacks, the strongest is chosen on one
half of the people and scored on the other. A mechanism has a row of numbers for each of
its levels.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from evaluation.estimates.families import Family
from evaluation.estimates.keys import AS_SHARED, Found, Key, Measure, Source, Where
from evaluation.estimates.metrics import EXPOSURE, MISSED_FUTURE, SUCCESS
from evaluation.estimates.strongest import (
    GROUPS,
    HEADLINE,
    by_task,
    cross_fitted,
    ranking_levels,
    strongest_of,
)
from evaluation.estimates.strongest_table import Strongest
from evaluation.plan.constants import IDENTITY, ORACLE
from evaluation.store.cell_files import Summed
from isac_track.intervals import Estimate, estimate_of

ATTACK: Final = "attack"
LINKER: Final = "linker"
PREDICTOR: Final = "predictor"
MECHANISM: Final = "mechanism"
_ALARMS: Final = "false_alarm_rate"


@dataclass(frozen=True, eq=False, slots=True)
class Estimates:
    """Estimates of a run that plug-ins are compared by, all with the same bootstrap weights."""

    own: Found  # Of scenes at the run's own horizon, and of what is linked.
    later: Mapping[float, Found]  # Of predictors at further horizons, s, ascending.
    sums: Mapping[Key, Summed]  # Of attacks, by cluster.
    known: Mapping[str, Family]  # Mechanisms of the run.
    attacks: Sequence[Strongest]  # The strongest attack against each mechanism.
    leading: str  # Linkage task that linkers are compared in; empty if none leads.


def plugin_records(
    own: Mapping[str, Sequence[str]], run: Estimates
) -> list[dict[str, Any]]:
    """Return a record for each plug-in of a user's own, and for each level of such a mechanism.

    `own` are their SPECs by axis (`mechanisms`, `predictors`, `attacks`), as the
    manifest has them in `own_plugins`. A number is a record of `value`, `ci_low` and
    `ci_high`, None where it is not known. `rival` is empty in a run without a built-in
    plug-in of that kind.
    """
    strangers = frozenset(own.get("attacks", ()))
    robots = frozenset(own.get("predictors", ()))
    records = [
        _attack_record(spec, strangers=strangers, run=run) for spec in sorted(strangers)
    ]
    records += [
        _predictor_record(spec, strangers=robots, run=run) for spec in sorted(robots)
    ]
    compared = [record for record in records if record is not None]
    return [*compared, *_mechanism_records(own.get("mechanisms", ()), run=run)]


def _attack_record(
    spec: str, *, strangers: Collection[str], run: Estimates
) -> dict[str, Any] | None:
    """Return how an attack or a linker compares; None if the run has no number of it."""
    attacks = {key.measure.source for key in run.sums if key.knowledge}
    attacks |= {
        key.measure.source for key in run.own if key.metric in (EXPOSURE, SUCCESS)
    }
    tasks = {source.task for source in attacks if source.attack.consumer == spec}
    if not tasks:
        return None
    task = run.leading if run.leading in tasks else min(tasks)
    in_task = [source for source in attacks if source.task == task and source.knowledge]
    mine = _strongest(
        [source for source in in_task if source.attack.consumer == spec], run=run
    )
    built_in = [
        source
        for source in in_task
        if source.attack.consumer not in {*strangers, IDENTITY}
        and source.knowledge in HEADLINE
    ]
    rival = _strongest(built_in, run=run)
    if mine is None:
        return None
    metric = SUCCESS if task else EXPOSURE
    pairs = [
        (own, theirs)
        for where in ranking_levels([*mine.wheres], run.known)
        if (own := mine.at(where, metric, run.own)) is not None
        and (
            (theirs := rival.at(where, metric, run.own) if rival else None)
            or rival is None
        )
    ]
    return {
        "kind": LINKER if task else ATTACK,
        "plugin": spec,
        "knowledge": mine.source.knowledge,
        "metric": metric,
        "task": task,
        "horizon_s": None,
        "rival": rival.source.attack.consumer if rival else "",
        "rival_knowledge": rival.source.knowledge if rival else "",
        **_compared(pairs),
    }


def _strongest(sources: Collection[Source], *, run: Estimates) -> Strongest | None:
    """Return the strongest of some attacks on one task, cross-fitted; None if there is none."""
    if not sources:
        return None
    task = next(iter(sources)).task
    metric = SUCCESS if task else EXPOSURE
    estimates = {
        key: known for key, known in run.own.items() if key.measure.source in sources
    }
    levels = by_task(estimates, metric=metric).get(task, {})
    ranking = [levels[where] for where in ranking_levels([*levels], run.known)]
    for among in (*GROUPS, (ORACLE,)):
        if source := strongest_of(ranking, among=among):
            sums = {
                key: summed
                for key, summed in run.sums.items()
                if key.measure.source in sources
            }
            crossed = cross_fitted(sums, run.known, source, by=metric)
            return Strongest("", among, source, tuple(levels), crossed)
    return None


def _predictor_record(
    spec: str, *, strangers: Collection[str], run: Estimates
) -> dict[str, Any] | None:
    """Return how a predictor compares at the first horizon that it is read at; None without one."""
    for horizon_s, estimates in (*run.later.items(), (None, run.own)):
        robots = {key.consumer for key in estimates if key.metric == MISSED_FUTURE}
        if spec not in robots:
            continue
        measure = Measure(spec, MISSED_FUTURE)
        wheres = [key.where for key in estimates if key.measure == measure]
        levels = ranking_levels(wheres, run.known)
        missed = {
            robot: _at_levels(estimates, Measure(robot, MISSED_FUTURE), levels)
            for robot in (spec, *sorted(robots - {*strangers}))
        }
        means = {robot: mean for robot, some in missed.items() if (mean := _mean(some))}
        rivals = {robot: mean.value for robot, mean in means.items() if robot != spec}
        rival = min(rivals, key=rivals.__getitem__, default="")
        theirs = missed[rival] if rival else [None] * len(levels)
        alarms = {
            name: _interval(
                _mean(_at_levels(estimates, Measure(robot, _ALARMS), levels))
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
            **_compared([*zip(missed[spec], theirs, strict=True)]),
            **alarms,
        }
    return None


def _at_levels(
    estimates: Found, measure: Measure, levels: Sequence[Where]
) -> list[Estimate | None]:
    return [estimates.get(measure.at(*where)) for where in levels]


def _mechanism_records(
    specs: Sequence[str], *, run: Estimates
) -> Iterator[dict[str, Any]]:
    """Yield what a robot misses and what leaks at each level of mechanisms of a user's own."""
    horizon_s, robots = next(iter(run.later.items()), (None, run.own))
    mechanisms = {*specs}
    levels = dict.fromkeys(key.where for key in run.own if key.mechanism in mechanisms)
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
            if key.where == where
            and key.metric == MISSED_FUTURE
            and np.isfinite(estimate.value)
        }
        robot = min(missed, key=lambda name: missed[name].value, default="")
        attack, linker = attacks.get(where[0]), linkers.get(where[0])
        yield {
            "kind": MECHANISM,
            "plugin": where[0],
            "level": where[1],
            "horizon_s": horizon_s,
            "robot": robot,
            "missed": _interval(missed.get(robot)),
            "as_sent": _interval(run.own.get(AS_SHARED.measure(EXPOSURE).at(*where))),
            "attacked": _interval(
                attack.at(where, EXPOSURE, run.own) if attack else None
            ),
            "task": run.leading,
            "linked": _interval(
                linker.at(where, SUCCESS, run.own) if linker and run.leading else None
            ),
        }


def _leads(attack: Strongest, *, task: str) -> bool:
    return attack.among == HEADLINE and attack.source.task == task


def _compared(
    pairs: Sequence[tuple[Estimate | None, Estimate | None]],
) -> dict[str, Any]:
    """Return the means over levels of a plug-in, of its rival, and of their paired difference."""
    mine, rival = (
        _mean([own for own, _ in pairs]),
        _mean([theirs for _, theirs in pairs]),
    )
    gap = None
    if mine is not None and rival is not None:
        n_drawn = min(mine.drawn.size, rival.drawn.size)
        n = min(mine.n, rival.n)
        effective = min(mine.n_effective, rival.n_effective)
        drawn = mine.drawn[:n_drawn] - rival.drawn[:n_drawn]
        gap = estimate_of(drawn, n=n, effective=effective)
    return {
        "levels": len(pairs),
        "n": mine.n if mine else 0,
        "own": _interval(mine),
        "other": _interval(rival),
        "difference": _interval(gap),
    }


def _mean(estimates: Sequence[Estimate | None]) -> Estimate | None:
    """Return the mean of estimates over levels, replicate by replicate; None if one is missing."""
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
    return estimate_of(
        drawn, n=min(estimate.n for estimate in known), effective=effective
    )


def _interval(estimate: Estimate | None) -> dict[str, float | None]:
    """Return value and interval, None where they are not known: JSON has no NaN."""
    ends = ("value", "ci_low", "ci_high")
    values = [getattr(estimate, end, np.nan) for end in ends]
    return {
        end: float(value) if np.isfinite(value) else None
        for end, value in zip(ends, values, strict=True)
    }
