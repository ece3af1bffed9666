"""What each predictor lets a robot decide: curves, their areas, and misses at equal alarms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from evaluation.analysis.curves import Curve, curve
from evaluation.analysis.keys import Key
from evaluation.analysis.metrics import EQUAL_ALARMS
from evaluation.analysis.summary import weights_of
from isac_track.intervals import estimate_of, percentile_interval

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.analysis.summary import Scored
    from isac_track.intervals import Estimate
    from isac_track.types import Floats

N_POINTS = 51
CURVE_COLUMNS = [
    "dataset",
    "mechanism",
    "level",
    "consumer",
    "score",
    "false_alarm_rate",
    "missed_conflict_rate",
]
DECISION_COLUMNS = [
    "dataset",
    "mechanism",
    "level",
    "consumer",
    "score",
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
]
_SEPARATION = "separation"


def decisions(
    scored: Sequence[Scored], manifest: Mapping[str, Any], found: Mapping[Key, Estimate]
) -> tuple[pd.DataFrame, pd.DataFrame, dict[Key, Estimate]]:
    """Return the curves of every predictor, a row on each, and misses at raw's false alarms.

    A robot may act on the predicted separation or, where there is a covariance, on the
    probability of a conflict: two scores, two curves. The row gives the area under the curve
    and the missed-conflict rate at the false-alarm rate that the reference, the first predictor
    of the run, has at its operating point under the same mechanism, with the paired difference
    from what the reference's own curve by separation reaches there.

    The last are what is missed at the false-alarm rate that the predictor has at its operating
    point where nothing is added (`EQUAL_ALARMS`, by separation): noise costs misses, alarms or
    both, and at equal alarms the misses alone tell.
    """
    dataset = manifest["dataset"]["name"]
    reference = next(iter(manifest["settings"]["predictors"]), None)
    weights = weights_of(manifest)
    at_reference: dict[tuple[str, float | None], tuple[Floats, Floats]] = {}
    curve_rows: list[pd.DataFrame] = []
    rows: dict[int, list[dict[str, object]]] = {}
    at_raw_alarms: dict[Key, Estimate] = {}
    # The reference first: the others are compared with its curve.
    for place in sorted(range(len(scored)), key=lambda place: scored[place].consumer != reference):
        entry = scored[place]
        where = (entry.mechanism, entry.level)
        names = {
            "dataset": dataset,
            "mechanism": entry.mechanism,
            "level": np.nan if entry.level is None else entry.level,
            "consumer": entry.consumer,
        }
        for name, drawn in _curves(entry, weights=weights).items():
            if entry.consumer == reference and name == _SEPARATION:
                alarm = found[Key(*where, entry.consumer, "false_alarm_rate")]
                at = np.concatenate([[alarm.value], alarm.replicates])
                at_reference[where] = at, drawn.missed_at(at)
            raw_alarm = found.get(Key("raw", None, entry.consumer, "false_alarm_rate"))
            if name == _SEPARATION and raw_alarm is not None:
                missed = drawn.missed_at(np.concatenate([[raw_alarm.value], raw_alarm.replicates]))
                at_raw_alarms[Key(*where, entry.consumer, EQUAL_ALARMS)] = estimate_of(
                    missed, n=raw_alarm.n
                )
            curve_rows.append(pd.DataFrame({**names, "score": name, **_points(drawn)}))
            rows.setdefault(place, []).append(
                {**names, "score": name, **_row(drawn, at_reference.get(where), reference)}
            )
    curves = pd.concat(curve_rows) if curve_rows else pd.DataFrame(columns=CURVE_COLUMNS)
    in_order = [row for place in sorted(rows) for row in rows[place]]
    return (
        curves[CURVE_COLUMNS],
        pd.DataFrame(in_order, columns=DECISION_COLUMNS),
        at_raw_alarms,
    )


def _curves(entry: Scored, *, weights: Floats) -> dict[str, Curve]:
    scores = {_SEPARATION: -entry.separation_m}
    if not np.isnan(entry.probability).any():
        scores["probability"] = entry.probability
    drawn = {
        name: curve(score=score, conflict=entry.conflict, cluster=entry.cluster, weights=weights)
        for name, score in scores.items()
    }
    return {name: one for name, one in drawn.items() if one is not None}


def _points(drawn: Curve) -> dict[str, Floats]:
    at = np.linspace(0.0, 1.0, N_POINTS)
    shape = (N_POINTS, drawn.missed.shape[1])
    same = Curve(
        missed=np.broadcast_to(drawn.missed[0], shape),
        false_alarm=np.broadcast_to(drawn.false_alarm[0], shape),
    )
    return {"false_alarm_rate": at, "missed_conflict_rate": same.missed_at(at)}


def _row(
    drawn: Curve, at_reference: tuple[Floats, Floats] | None, reference: str | None
) -> dict[str, object]:
    areas = drawn.areas()
    row: dict[str, object] = {"area": areas[0]}
    row["area_low"], row["area_high"] = percentile_interval(areas[1:])
    if at_reference is None:
        return row
    false_alarm, reference_missed = at_reference
    missed = drawn.missed_at(false_alarm)
    row |= {
        "reference": reference,
        "false_alarm_rate": false_alarm[0],
        "missed_conflict_rate": missed[0],
        "difference": missed[0] - reference_missed[0],
    }
    row["missed_low"], row["missed_high"] = percentile_interval(missed[1:])
    row["ci_low"], row["ci_high"] = percentile_interval((missed - reference_missed)[1:])
    return row
