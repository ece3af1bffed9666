"""FID against fixed noise at equal missed-conflict rate, by monotone interpolation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.optimize import isotonic_regression

from evaluation.cell import SHARED
from evaluation.summary import Key
from isac_track.intervals import percentile_interval

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isac_track.intervals import Estimate
    from isac_track.types import Floats

ADDING_SUFFIX = {"linear": "", "independent": ":adding=independent"}
DESCRIPTORS = ("plr", "ael", "mel")
N_POINTS = 20
COLUMNS = [
    "dataset",
    "adding",
    "predictor",
    "metric",
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
    descriptor are made monotone over the levels (isotonic regression) and interpolated
    linearly, never beyond the rates that both reach. Each bootstrap replicate repeats all of
    it on the same drawn people, so that the difference (FID minus fixed) is paired; `defined`
    is the share of replicates that reach the rate.
    """
    rows: list[dict[str, object]] = []
    for predictor in predictors:
        for adding, suffix in ADDING_SUFFIX.items():
            fid = _curve(found, mechanism=f"fid{suffix}", predictor=predictor, descending=False)
            fixed = _curve(found, mechanism=f"fixed{suffix}", predictor=predictor, descending=True)
            if fid is None or fixed is None:
                continue
            names = {"dataset": dataset, "adding": adding, "predictor": predictor}
            rows.extend({**names, **row} for row in _compare(fid, fixed))
    return pd.DataFrame(rows, columns=COLUMNS)


def _curve(
    found: Mapping[Key, Estimate], *, mechanism: str, predictor: str, descending: bool
) -> dict[str, Floats] | None:
    """Return (1 + B, L) arrays of rate and descriptors, noisiest level first, raw last.

    Row 0 is the estimate, the others are replicates; None if there are fewer than two levels.
    """
    levels = sorted(
        (
            key.level
            for key in found
            if key.mechanism == mechanism
            and key.consumer == SHARED
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
        consumer = predictor if metric == "missed_conflict_rate" else SHARED
        points = [found[Key(mechanism, level, consumer, metric)] for level in levels]
        points.append(found[Key(raw, None, consumer, metric)])
        curve[metric] = np.stack(
            [np.concatenate([[point.value], point.replicates]) for point in points], axis=1
        )
    return curve


def _compare(fid: dict[str, Floats], fixed: dict[str, Floats]) -> list[dict[str, object]]:
    rate = "missed_conflict_rate"
    fid_rate = _monotone(fid[rate], increasing=False)
    fixed_rate = _monotone(fixed[rate], increasing=False)
    low = max(fid_rate[0].min(), fixed_rate[0].min())
    high = min(fid_rate[0].max(), fixed_rate[0].max())
    if not low < high:
        return []
    # The lowest rate is raw itself, the end of both curves: nothing is compared there.
    at = np.linspace(low, high, N_POINTS + 1)[1:]
    rows: list[dict[str, object]] = []
    for metric in DESCRIPTORS:
        a = _interpolate(at, fid_rate, _monotone(fid[metric], increasing=True))
        b = _interpolate(at, fixed_rate, _monotone(fixed[metric], increasing=True))
        for point, value in enumerate(at):
            both = a[1:, point] - b[1:, point]
            fid_low, fid_high = percentile_interval(a[1:, point])
            fixed_low, fixed_high = percentile_interval(b[1:, point])
            ci_low, ci_high = percentile_interval(both)
            rows.append(
                {
                    "metric": metric,
                    rate: value,
                    "fid": a[0, point],
                    "fid_low": fid_low,
                    "fid_high": fid_high,
                    "fixed": b[0, point],
                    "fixed_low": fixed_low,
                    "fixed_high": fixed_high,
                    "difference": a[0, point] - b[0, point],
                    "ci_low": ci_low,
                    "ci_high": ci_high,
                    "defined": float(np.isfinite(both).mean()),
                }
            )
    return rows


def _monotone(values: Floats, *, increasing: bool) -> Floats:
    """Return each row made monotone from left to right."""
    return np.stack(
        [np.asarray(isotonic_regression(row, increasing=increasing).x) for row in values]
    )


def _interpolate(at: Floats, rate: Floats, descriptor: Floats) -> Floats:
    """Return each row's descriptor at the rates `at`; NaN beyond its own range."""
    # The rate falls from left to right; np.interp wants it rising.
    return np.stack(
        [
            np.interp(at, x[::-1], y[::-1], left=np.nan, right=np.nan)
            for x, y in zip(rate, descriptor, strict=True)
        ]
    )
