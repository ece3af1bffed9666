"""FID against fixed noise at an equal rise of the missed-conflict rate over raw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.optimize import isotonic_regression

from evaluation.grid import SHARED
from evaluation.summary import Key
from isac_track.intervals import percentile_interval

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isac_track.intervals import Estimate
    from isac_track.types import Floats

ADDING_SUFFIX = {"linear": "", "independent": ":adding=independent"}
DESCRIPTORS = ("plr", "ael", "mel")
N_POINTS = 20
MIN_DEFINED = 0.975
"""Share of replicates that must reach a rise for it to have an interval."""
_SMALLEST = 1e-12
_ROUNDING = 1e-9
COLUMNS = [
    "dataset",
    "adding",
    "predictor",
    "consumer",
    "knowledge",
    "metric",
    "rise",
    "missed_conflict_rate",
    "fid",
    "fid_low",
    "fid_high",
    "fixed",
    "fixed_low",
    "fixed_high",
    "difference",
    "ci_low",
    "ci_high",
    "defined",
]


def matched(
    found: Mapping[Key, Estimate], *, dataset: str, predictors: Sequence[str]
) -> pd.DataFrame:
    """Return descriptors of FID and fixed noise at equal missed-conflict rates.

    Both curves run from their noisiest level to raw, which is the end of either. Rate and
    descriptor are made monotone over the levels (isotonic regression) and interpolated, the
    descriptor on a logarithmic scale, never beyond the rates that both reach. Matched is the
    rise over the raw rate, so that each bootstrap replicate, which repeats all of it on its own
    drawn people, is read at its own raw rate plus that rise: the comparison is paired in the
    rate and in the descriptor. `missed_conflict_rate` is raw's estimate plus the rise.

    `defined` is the share of replicates that reach the rise; where it is below `MIN_DEFINED`
    there is no interval (NaN), since the replicates that are left would all lie on one side.
    """
    rows: list[dict[str, object]] = []
    # The descriptors are as shared, the same for every predictor: made monotone only once.
    smooth: dict[tuple[str, str], Floats] = {}
    for predictor in predictors:
        for adding, suffix in ADDING_SUFFIX.items():
            fid, fixed = (
                _curve(
                    found,
                    mechanism=f"{family}{suffix}",
                    predictor=predictor,
                    descending=family == "fixed",
                    smooth=smooth,
                )
                for family in ("fid", "fixed")
            )
            if fid is None or fixed is None:
                continue
            names = {
                "dataset": dataset,
                "adding": adding,
                "predictor": predictor,
                "consumer": SHARED,
                "knowledge": "",
            }
            rows.extend({**names, **row} for row in _compare(fid, fixed))
    return pd.DataFrame(rows, columns=COLUMNS)


def _curve(
    found: Mapping[Key, Estimate],
    *,
    mechanism: str,
    predictor: str,
    descending: bool,
    smooth: dict[tuple[str, str], Floats],
) -> dict[str, Floats] | None:
    """Return (1 + B, L) arrays of rate and monotone descriptors, noisiest first, raw last.

    Row 0 is the estimate, the others are replicates; None if there are fewer than two levels.
    """
    levels = sorted(
        (
            key.level
            for key in found
            if key.mechanism == mechanism
            and key.consumer == SHARED
            and not key.knowledge
            and key.metric == "plr"
            and key.level is not None
        ),
        reverse=descending,
    )
    raw = "raw"
    if len(levels) < 2 or Key(raw, None, predictor, "missed_conflict_rate") not in found:  # noqa: PLR2004
        return None
    curve = {}
    for metric in ("missed_conflict_rate", *DESCRIPTORS):
        is_rate = metric == "missed_conflict_rate"
        if not is_rate and (mechanism, metric) in smooth:
            curve[metric] = smooth[mechanism, metric]
            continue
        consumer = predictor if is_rate else SHARED
        points = [found[Key(mechanism, level, consumer, metric)] for level in levels]
        points.append(found[Key(raw, None, consumer, metric)])
        curve[metric] = np.stack(
            [np.concatenate([[point.value], point.replicates]) for point in points], axis=1
        )
        if not is_rate:
            curve[metric] = _monotone(curve[metric], increasing=True)
            smooth[mechanism, metric] = curve[metric]
    return curve


def _compare(fid: dict[str, Floats], fixed: dict[str, Floats]) -> list[dict[str, object]]:
    rate = "missed_conflict_rate"
    fid_rise = _rise(fid[rate])
    fixed_rise = _rise(fixed[rate])
    raw_rate = float(fid[rate][0, -1])
    reach = min(fid_rise[0].max(), fixed_rise[0].max())
    if not reach > 0:
        return []
    # No rise is raw itself, the end of both curves: nothing is compared there.
    at = np.linspace(0.0, reach, N_POINTS + 1)[1:]
    rows: list[dict[str, object]] = []
    for metric in DESCRIPTORS:
        a = _interpolate(at, fid_rise, fid[metric])
        b = _interpolate(at, fixed_rise, fixed[metric])
        difference = a - b
        defined = np.isfinite(difference[1:]).mean(axis=0)
        for point, rise in enumerate(at):
            row: dict[str, object] = {
                "metric": metric,
                "rise": rise,
                rate: raw_rate + rise,
                "fid": a[0, point],
                "fixed": b[0, point],
                "difference": difference[0, point],
                "defined": defined[point],
            }
            for low, high, values in (
                ("fid_low", "fid_high", a),
                ("fixed_low", "fixed_high", b),
                ("ci_low", "ci_high", difference),
            ):
                row[low], row[high] = (
                    percentile_interval(values[1:, point])
                    if defined[point] >= MIN_DEFINED
                    else (np.nan, np.nan)
                )
            rows.append(row)
    return rows


def _rise(rate: Floats) -> Floats:
    """Return each row's monotone rate less its value at raw, the last level."""
    monotone = _monotone(rate, increasing=False)
    return monotone - monotone[:, -1:]


def _monotone(values: Floats, *, increasing: bool) -> Floats:
    """Return each row made monotone from left to right."""
    return np.stack(
        [np.asarray(isotonic_regression(row, increasing=increasing).x) for row in values]
    )


def _interpolate(at: Floats, rise: Floats, descriptor: Floats) -> Floats:
    """Return each row's descriptor at the rises `at`; NaN beyond its own range.

    A descriptor falls about exponentially with the rate; on its logarithm a chord over a
    wide step of the levels lies close to the curve.
    """
    logarithm = np.log(np.maximum(descriptor, _SMALLEST))
    # The rise falls from left to right; np.interp wants it rising. Rounding must not put the
    # end of a curve out of its own reach.
    at = at - _ROUNDING
    values: Floats = np.exp(
        np.stack(
            [
                np.interp(at, x[::-1], y[::-1], right=np.nan)
                for x, y in zip(rise, logarithm, strict=True)
            ]
        )
    )
    return values
