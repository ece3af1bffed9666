"""Decisions of a robot by each predictor: the curve of misses over false alarms.

A robot may act on the predicted separation or, where there is a covariance, on the
probability of a conflict: two scores, two curves. The bootstrap needs only counts per
cluster and bin of the score, so that its cost does not grow with the scenes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.sparse import csr_array

from evaluation.estimates.metrics import EQUAL_ALARMS, FALSE_ALARMS, FUTURE_EQUAL_ALARMS
from evaluation.estimates.summary import SceneNumbers, bootstrap_weights
from evaluation.plan.address import Address, MechanismLevel, parse_consumer
from isac_track.intervals import (
    LEAST_CLUSTERS,
    Estimate,
    effective_clusters,
    estimate_from_replicates,
    percentile_interval,
)
from isac_track.types import Bools, Floats, Ints

N_BINS = 100  # Quantiles of the score over all scenes, at most.
N_POINTS = 51  # Of a curve in the file.
_ABOUT = ("dataset", "mechanism", "level", "consumer", "score")
DECISION_COLUMNS = [
    *_ABOUT,
    "area",
    "area_low",
    "area_high",
    "reference",
    "false_alarm_rate",
    "missed_conflict_rate",
    "missed_low",
    "missed_high",
    "difference",
    "ci_low",
    "ci_high",
    "missed_future_rate",
    "future_low",
    "future_high",
]
_SEPARATION = "separation"
_NO_POINTS: Final = np.full(N_POINTS, np.nan)


@dataclass(frozen=True, eq=False, slots=True)
class Curve:
    """Rates over K thresholds, strictest first: the estimate, then its replicates."""

    missed: Floats  # (1 + B, K) missed-conflict rate, from 1 down to 0
    false_alarm: Floats  # (1 + B, K) false-alarm rate, from 0 up to 1
    effective: float = np.nan  # Effective clusters behind both rates.

    def areas(self) -> Floats:
        """Return the areas under the curves, (1 + B,): 0 is perfect, 0.5 is chance."""
        width = np.diff(self.false_alarm, axis=1)
        return np.asarray(
            (width * 0.5 * (self.missed[:, 1:] + self.missed[:, :-1])).sum(axis=1)
        )

    def missed_at(self, false_alarm: Floats) -> Floats:
        """Return the interpolated missed rate at false-alarm rates, (1 + B,).

        Where a threshold jumps over several scenes, the robot may draw lots between the
        two sides: it can reach the linear interpolation.
        """
        rows = np.arange(self.missed.shape[0])
        # Take the most sensitive of several thresholds with this very rate.
        right = (self.false_alarm <= false_alarm[:, None]).sum(axis=1)
        right = np.clip(right, 1, self.missed.shape[1] - 1)
        low, high = self.false_alarm[rows, right - 1], self.false_alarm[rows, right]
        share = np.zeros_like(low)
        np.divide(false_alarm - low, high - low, out=share, where=high > low)
        left = self.missed[rows, right - 1]
        return np.asarray(left + share * (self.missed[rows, right] - left))

    def points(self) -> Floats:
        """Return the missed rate at equally spaced false-alarm rates, (`N_POINTS`,)."""
        shape = (N_POINTS, self.missed.shape[1])
        estimate = Curve(
            missed=np.broadcast_to(self.missed[0], shape),
            false_alarm=np.broadcast_to(self.false_alarm[0], shape),
        )
        return estimate.missed_at(np.linspace(0.0, 1.0, N_POINTS))


def decision_curve(
    *, score: Floats, conflict: Bools, cluster: Ints, weights: Floats
) -> Curve | None:
    """Return the curve of a score with its replicates; None without both labels.

    A higher `score`, (S,), means that a `conflict`, (S,), is likelier; `cluster`, (S,),
    is the column of a scene's cluster in `weights`, (B, C), from
    `intervals.cluster_weights`. Raises ValueError if a score is NaN.
    """
    if np.isnan(score).any():
        raise ValueError("a score is NaN")
    if conflict.all() or not conflict.any():
        return None
    distinct = np.unique(score)
    if distinct.size > N_BINS:
        distinct = np.unique(
            np.quantile(score, np.linspace(0, 1, N_BINS), method="lower")
        )
    # Bin 0 holds the highest scores; a scene counts once the threshold reaches its bin.
    bins = distinct.size - np.searchsorted(distinct, score, side="right")
    rows = np.where(conflict, distinct.size, 0) + bins
    # Sparse: few of thousands of people are in a bin.
    shape = 2 * distinct.size, weights.shape[1]
    counts = csr_array((np.ones(score.size), (rows, cluster)), shape=shape)
    drawn = np.column_stack([counts.sum(axis=1), np.asarray(counts @ weights.T)])
    drawn = drawn.reshape(2, distinct.size, -1).cumsum(axis=1).transpose(0, 2, 1)
    rates: Floats = np.zeros((*drawn.shape[:2], distinct.size + 1))
    # A replicate that lacks a label has no rate: NaN.
    with np.errstate(invalid="ignore"):
        np.divide(drawn, drawn[:, :, -1:], out=rates[:, :, 1:])
    sizes = (
        np.bincount(cluster[is_label], minlength=weights.shape[1]).astype(np.float64)
        for is_label in (conflict, ~conflict)
    )
    effective = min(map(effective_clusters, sizes))
    return Curve(missed=1.0 - rates[1], false_alarm=rates[0], effective=effective)


def _curves(
    score: Floats, columns: Mapping[str, Any], *, cluster: Ints, weights: Floats
) -> tuple[Curve | None, Curve | None]:
    """Return the curves of all conflicts, and of those that are still to come.

    Conflict-free scenes are in both, so that one threshold has one false-alarm rate.
    """
    conflict = columns["conflict"]
    ahead = ~(conflict & columns["inside_now"])
    all_conflicts = decision_curve(
        score=score, conflict=conflict, cluster=cluster, weights=weights
    )
    future = decision_curve(
        score=score[ahead],
        conflict=conflict[ahead],
        cluster=cluster[ahead],
        weights=weights,
    )
    return all_conflicts, future


def _missed_at(rates: Curve, false_alarm: Estimate) -> Estimate:
    missed = rates.missed_at(false_alarm.drawn)
    effective = float(np.fmin(false_alarm.effective, rates.effective))
    return estimate_from_replicates(missed, n=false_alarm.n, effective=effective)


@dataclass(frozen=True, eq=False, slots=True)
class Decisions:
    """Decisions by every predictor at every level."""

    curves: pd.DataFrame  # Points of each curve: `curves.csv`.
    decided: pd.DataFrame  # A row on each curve: `decisions.csv`.
    # Misses at raw's false alarms: `EQUAL_ALARMS`, `FUTURE_EQUAL_ALARMS`.
    at_raw_alarms: dict[Address, Estimate]


def decisions(
    numbers: SceneNumbers, manifest: Mapping[str, Any], *, dataset: str
) -> Decisions:
    """Return the decisions by each predictor at every level.

    The reference is the first predictor of the run. The row gives the area under the
    curve, and the missed-conflict rate at the reference's false-alarm rate at its
    operating point under the same mechanism. It also gives the paired difference from
    the rate that the reference's own curve by separation reaches there. The misses
    (`EQUAL_ALARMS`, and `FUTURE_EQUAL_ALARMS` for conflicts still to come) are by
    separation, at the predictor's own false-alarm rate under raw. The rows are named
    after `dataset`.
    """
    reference = next(iter(manifest["settings"]["predictors"]), None)
    weights = bootstrap_weights(manifest)
    at_reference: dict[MechanismLevel, tuple[Floats, Floats]] = {}
    at_raw_alarms: dict[Address, Estimate] = {}
    points, future_points = [np.zeros(0)], [np.zeros(0)]
    rows: list[dict[str, Any]] = []
    # The reference first: the others are compared with its curve.
    order = sorted(
        enumerate(numbers.scored),
        key=lambda numbered: numbered[1].entry.address.consumer != reference,
    )
    for place, (entry, cluster, columns) in order:
        where, consumer = entry.address.mechanism_level, entry.address.consumer
        alarms = parse_consumer(consumer).measured(FALSE_ALARMS)
        raw_alarm = numbers.estimates.get(alarms.at("raw", None))
        for name, score in _scores(columns).items():
            is_separation = name == _SEPARATION
            all_conflicts, future = _curves(
                score, columns, cluster=cluster, weights=weights
            )
            if all_conflicts is None:
                continue
            if is_separation and consumer == reference:
                at = numbers.estimates[alarms.at(*where)].drawn
                at_reference[where] = at, all_conflicts.missed_at(at)
            if is_separation and raw_alarm is not None:
                misses = _misses(all_conflicts, future, raw_alarm)
                at_raw_alarms |= {
                    parse_consumer(consumer).at(*where, metric): missed
                    for metric, missed in misses.items()
                }
            points.append(all_conflicts.points())
            future_points.append(future.points() if future else _NO_POINTS)
            level = np.nan if where.level is None else where.level
            about = dataset, where.mechanism, level, consumer, name
            row: dict[str, Any] = dict(zip(_ABOUT, about, strict=True))
            row |= {"place": place}
            few = all_conflicts.effective
            row |= _interval_columns(
                "area", "area", all_conflicts.areas(), effective=few
            )
            if where in at_reference:
                row |= {"reference": reference}
                row |= _beside_reference(all_conflicts, future, *at_reference[where])
            rows.append(row)
    curves, decided = _tables(rows, points, future_points)
    return Decisions(curves, decided, at_raw_alarms)


def _tables(
    rows: Sequence[Mapping[str, Any]],
    points: Sequence[Floats],
    future_points: Sequence[Floats],
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the points of the curves, and the rows in the order of the run."""
    table = pd.DataFrame(rows, columns=[*DECISION_COLUMNS, "place"])
    curves = table.loc[table.index.repeat(N_POINTS), list(_ABOUT)].assign(
        false_alarm_rate=np.tile(np.linspace(0.0, 1.0, N_POINTS), len(rows)),
        missed_conflict_rate=np.concatenate(points),
        missed_future_rate=np.concatenate(future_points),
    )
    in_order = table.sort_values("place", kind="stable", ignore_index=True)
    return curves, in_order[DECISION_COLUMNS]


def _misses(
    all_conflicts: Curve, future: Curve | None, false_alarm: Estimate
) -> dict[str, Estimate]:
    """Return the missed rates at a false-alarm rate by metric."""
    misses = {EQUAL_ALARMS: _missed_at(all_conflicts, false_alarm)}
    if future is not None:
        misses[FUTURE_EQUAL_ALARMS] = _missed_at(future, false_alarm)
    return misses


def _scores(columns: Mapping[str, Any]) -> dict[str, Floats]:
    """Return the scores by which a predictor's robot may decide, (S,) each, by name."""
    scores = {_SEPARATION: -columns["predicted_separation_m"]}
    if not np.isnan(columns["probability"]).any():
        scores["probability"] = columns["probability"]
    return scores


def _beside_reference(
    all_conflicts: Curve,
    future: Curve | None,
    false_alarm: Floats,
    reference_missed: Floats,
) -> dict[str, float]:
    """Return the missed rates at the reference's false-alarm rate, (1 + B,)."""
    missed = all_conflicts.missed_at(false_alarm)
    row: dict[str, float] = {"false_alarm_rate": false_alarm[0]}
    few = all_conflicts.effective
    row |= _interval_columns("missed_conflict_rate", "missed", missed, effective=few)
    gap = missed - reference_missed
    row |= _interval_columns("difference", "ci", gap, effective=few)
    if future:
        to_come = future.missed_at(false_alarm)
        few = future.effective
        row |= _interval_columns("missed_future_rate", "future", to_come, effective=few)
    return row


def _interval_columns(
    name: str, ends: str, values: Floats, *, effective: float
) -> dict[str, float]:
    """Return columns of a number and its interval; `values` are (1 + B,).

    Below `LEAST_CLUSTERS` effective clusters there is no interval.
    """
    low, high = np.nan, np.nan
    if effective >= LEAST_CLUSTERS:
        low, high = percentile_interval(values[1:])
    return {name: values[0], f"{ends}_low": low, f"{ends}_high": high}
