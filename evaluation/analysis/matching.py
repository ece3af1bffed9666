"""FID against fixed noise where they cost the same, or show the same PLR: `matched.csv`.

Operating points are matched at an equal rise of the missed-conflict rate over raw, at an equal rise
of it while false alarms are held at raw's rate, or at an equal PLR as shared. Compared are the
descriptors as shared, the same after each reconstruction attack, and what each linker achieves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from evaluation.analysis.linkability import dataset_of
from evaluation.analysis.metrics import ACHIEVED, DESCRIPTORS
from evaluation.analysis.summary import Key
from evaluation.experiment.presets import SHARED
from isac_track.intervals import CONFIDENCE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from isac_track.intervals import Estimate
    from isac_track.types import Floats

ADDING_SUFFIX: Final = {"linear": "", "independent": ":adding=independent"}
MISSED, AT_EQUAL_ALARMS, PLR = "missed", "missed_at_equal_false_alarms", "plr"
"""Criteria of matching."""
EQUAL_ALARMS = "missed_at_equal_false_alarms"
"""Metric of a predictor: its missed rate at the false-alarm rate that it has at raw."""
N_POINTS, N_ATTACK_POINTS = 20, 10
"""Of a curve as shared, and of one after an attack."""
MIN_DEFINED = 0.975
"""Share of replicates that must reach a point for it to have an interval."""
_ENDS = (0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2)
_SMALLEST = 1e-12
_ROUNDING = 1e-9
COLUMNS = [
    "dataset",
    "criterion",
    "adding",
    "predictor",
    "consumer",
    "knowledge",
    "metric",
    "at",
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
    "n",
]


@dataclass(frozen=True, slots=True)
class Measure:
    """One thing that is measured at every mechanism level."""

    consumer: str
    metric: str
    knowledge: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """FID and fixed noise along all points at which they are matched."""

    criterion: str
    adding: str
    predictor: str
    measure: Measure
    at: Floats
    """(P,) ascending: rise of the missed rate over raw, or PLR as shared"""
    rate: Floats
    """(P,) missed-conflict rate of the criterion; NaN when matched by PLR"""
    fid: Floats
    """(3, P) value and both ends of its interval; NaN out of reach"""
    fixed: Floats
    """(3, P)"""
    difference: Floats
    """(3, P) FID minus fixed"""
    defined: Floats
    """(P,) share of the replicates that reach the point"""
    mean_difference: Floats
    """(1 + B,) over the points that have an interval; row 0 is the estimate; NaN without any"""
    mean_fixed: float
    """Of fixed noise, over the same points."""
    n: int
    """Clusters."""


class Sweeps:
    """Mechanism families as curves over their levels, each read and made monotone once."""

    def __init__(self, found: Mapping[Key, Estimate]) -> None:
        self.found = found
        self._levels: dict[str, list[float]] = {}
        for key in found:
            shown = key.consumer, key.metric, key.knowledge
            if key.level is not None and shown == (SHARED, "plr", ""):
                self._levels.setdefault(key.mechanism, []).append(key.level)
        self._monotone: dict[tuple[str, Measure], Floats | None] = {}

    def levels(self, mechanism: str) -> list[float]:
        """Return the levels of a mechanism, noisiest first: eta grows, a fixed error falls."""
        descending = mechanism.partition(":")[0] != "fid"
        return sorted(self._levels.get(mechanism, ()), reverse=descending)

    def mechanisms(self) -> list[str]:
        """Return the names of all mechanisms that have a level."""
        return list(self._levels)

    def point(self, mechanism: str, level: float | None, measure: Measure) -> Floats | None:
        """Return estimate and replicates of one level, (1 + B,); None if it was not run."""
        found = self.found.get(
            Key(mechanism, level, measure.consumer, measure.metric, measure.knowledge)
        )
        return None if found is None else np.concatenate([[found.value], found.replicates])

    def curve(self, mechanism: str, measure: Measure) -> Floats | None:
        """Return the measure from the noisiest level to raw, made monotone, (1 + B, L).

        None if there are fewer than two levels, or one of them or raw was not run.
        """
        known = mechanism, measure
        if known not in self._monotone:
            self._monotone[known] = self._curve(mechanism, measure)
        return self._monotone[known]

    def _curve(self, mechanism: str, measure: Measure) -> Floats | None:
        levels = self.levels(mechanism)
        points = [self.point(mechanism, level, measure) for level in levels]
        points.append(self.point("raw", None, measure))
        known = [point for point in points if point is not None]
        if len(levels) < 2 or len(known) < len(points):  # noqa: PLR2004
            return None
        falls = measure.metric in {"missed_conflict_rate", EQUAL_ALARMS}
        return monotone(np.stack(known, axis=1), increasing=not falls)

    def n(self, mechanism: str, measure: Measure) -> int:
        """Return how many clusters the least of a mechanism's levels has."""
        return min(
            self.found[Key(mechanism, level, measure.consumer, measure.metric, measure.knowledge)].n
            for level in self.levels(mechanism)
        )


def comparisons(
    found: Mapping[Key, Estimate], *, predictors: Sequence[str]
) -> Iterator[Comparison]:
    """Yield FID against fixed noise, for every criterion, adding rule and measure.

    Both curves run from their noisiest level to raw, which is the end of either. What is matched
    and what is compared are made monotone over the levels (isotonic regression) and interpolated,
    descriptors on a logarithmic scale, never beyond what both reach. Matched is the *change from
    raw*, so that each bootstrap replicate, which repeats all of it on its own drawn people, is read
    at its own raw value plus that change: the comparison is paired in both.

    Descriptors as shared are compared for every predictor, attacks for the first one.

    Parameters
    ----------
    found : mapping
        Every metric of a run, linkage among them.
    predictors : sequence of str
        Of the run, the reference first.
    """
    sweeps = Sweeps(found)
    measures = _measures(found)
    shared = [Measure(SHARED, metric) for metric in DESCRIPTORS]
    for adding, suffix in ADDING_SUFFIX.items():
        arms = f"fid{suffix}", f"fixed{suffix}"
        for place, predictor in enumerate(predictors):
            wanted = measures if place == 0 else shared
            for criterion, metric in (
                (MISSED, "missed_conflict_rate"),
                (AT_EQUAL_ALARMS, EQUAL_ALARMS),
            ):
                by = Measure(predictor, metric)
                yield from compare(sweeps, arms, by, wanted, (criterion, adding, predictor))
        others = [one for one in measures if one != Measure(SHARED, "plr")]
        yield from compare(sweeps, arms, Measure(SHARED, "plr"), others, (PLR, adding, ""))


def matched(compared: Sequence[Comparison], *, dataset: str) -> pd.DataFrame:
    """Return the comparisons as rows; the columns are `COLUMNS`.

    `at` is the rise of the missed rate over raw, or the PLR as shared; `missed_conflict_rate` is
    raw's estimate plus the rise. `defined` is the share of replicates that reach the point; where
    it is below `MIN_DEFINED` there is no interval (NaN), since the replicates that are left would
    all lie on one side.

    Parameters
    ----------
    compared : sequence of Comparison
    dataset : str
        Of the run.
    """
    parts = [_rows(one, dataset=dataset) for one in compared]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=COLUMNS)


def _rows(one: Comparison, *, dataset: str) -> pd.DataFrame:
    columns: dict[str, object] = {
        "dataset": dataset_of(one.measure.consumer, dataset=dataset),
        "criterion": one.criterion,
        "adding": one.adding,
        "predictor": one.predictor,
        "consumer": one.measure.consumer,
        "knowledge": one.measure.knowledge,
        "metric": one.measure.metric,
        "at": one.at,
        "missed_conflict_rate": one.rate,
        "defined": one.defined,
        "n": one.n,
    }
    for name, low, high, values in (
        ("fid", "fid_low", "fid_high", one.fid),
        ("fixed", "fixed_low", "fixed_high", one.fixed),
        ("difference", "ci_low", "ci_high", one.difference),
    ):
        columns |= {name: values[0], low: values[1], high: values[2]}
    return pd.DataFrame(columns)[COLUMNS]


def _measures(found: Mapping[Key, Estimate]) -> list[Measure]:
    """Return what is compared: descriptors as shared, after each attack, and each linker."""
    measures: dict[Measure, None] = {}
    for key in found:
        is_link = "/" in key.consumer
        is_none = "/control-" in key.consumer or (key.consumer == SHARED and key.knowledge)
        if is_none or key.metric not in (ACHIEVED if is_link else DESCRIPTORS):
            continue
        measures[Measure(key.consumer, key.metric, key.knowledge)] = None
    return sorted(measures, key=lambda one: one.consumer != SHARED)


def compare(
    sweeps: Sweeps,
    arms: tuple[str, str],
    by: Measure,
    measures: Sequence[Measure],
    names: tuple[str, str, str],
) -> Iterator[Comparison]:
    """Yield measures of two mechanisms where `by` has changed from raw by as much in both.

    Parameters
    ----------
    sweeps : Sweeps
    arms : (FID, fixed)
        Names of the mechanisms.
    by : Measure
        What is matched.
    measures : sequence of Measure
        What is compared.
    names : (criterion, adding, predictor)
        Handed on.
    """
    scales = [sweeps.curve(arm, by) for arm in arms]
    if scales[0] is None or scales[1] is None:
        return
    change = [np.abs(scale - scale[:, -1:]) for scale in (scales[0], scales[1])]
    reach = min(one[0].max() for one in change)
    if not reach > 0:
        return
    raw = float(scales[0][0, -1])
    is_plr = by.consumer == SHARED
    order = slice(None, None, -1 if is_plr else 1)  # at ascends, in PLR as well
    for measure in measures:
        curves = [sweeps.curve(arm, measure) for arm in arms]
        if curves[0] is None or curves[1] is None:
            continue
        n_points = N_POINTS if measure.consumer == SHARED else N_ATTACK_POINTS
        # No change is raw itself, the end of both curves: nothing is compared there.
        at = np.linspace(0.0, reach, n_points + 1)[1:][order]
        fid, fixed = (
            interpolated(at, scale, curve, log=measure.metric in DESCRIPTORS)
            for scale, curve in zip(change, (curves[0], curves[1]), strict=True)
        )
        difference = fid - fixed
        defined = np.isfinite(difference[1:]).mean(axis=0)
        kept = (defined >= MIN_DEFINED) & np.isfinite(difference[0])
        criterion, adding, predictor = names
        yield Comparison(
            criterion=criterion,
            adding=adding,
            predictor=predictor,
            measure=measure,
            at=raw - at if is_plr else at,
            rate=np.full(n_points, np.nan) if is_plr else raw + at,
            fid=_summarised(fid, defined),
            fixed=_summarised(fixed, defined),
            difference=_summarised(difference, defined),
            defined=defined,
            mean_difference=_mean(difference[:, kept]),
            mean_fixed=float(_mean(fixed[:1, kept])[0]),
            n=min(sweeps.n(arm, measure) for arm in arms),
        )


def _summarised(values: Floats, defined: Floats) -> Floats:
    """Return the estimate and the ends of its interval, (3, P), of (1 + B, P) values."""
    found = np.full((3, values.shape[1]), np.nan)
    found[0] = values[0]
    whole = np.isfinite(values[1:]).all(axis=0)
    found[1:, whole] = np.quantile(values[1:, whole], _ENDS, axis=0)
    for place in np.flatnonzero(~whole & (defined >= MIN_DEFINED)):
        found[1:, place] = np.nanquantile(values[1:, place], _ENDS)
    return found


def _mean(values: Floats) -> Floats:
    """Return the mean of each row over what is known, (R,); NaN where nothing is."""
    count = np.isfinite(values).sum(axis=1)
    mean: Floats = np.full(values.shape[0], np.nan)
    np.divide(np.nansum(values, axis=1), count, out=mean, where=count > 0)
    return mean


def monotone(values: Floats, *, increasing: bool) -> Floats:
    """Return each row made monotone from left to right by isotonic regression, (R, L).

    By the min-max formula (Barlow et al. 1972): the largest over all beginnings of the smallest
    over all ends of the mean between them. It does all replicates at once, where
    `scipy.optimize.isotonic_regression` takes them row by row.
    """
    if not increasing:
        return -monotone(-values, increasing=True)
    sums = np.concatenate([np.zeros((values.shape[0], 1)), np.cumsum(values, axis=1)], axis=1)
    best: Floats = np.full(values.shape, -np.inf)
    for first in range(values.shape[1]):
        counts = np.arange(1, values.shape[1] - first + 1)
        means = (sums[:, first + 1 :] - sums[:, first : first + 1]) / counts
        smallest = np.minimum.accumulate(means[:, ::-1], axis=1)[:, ::-1]
        best[:, first:] = np.maximum(best[:, first:], smallest)
    return best


def interpolated(at: Floats, change: Floats, values: Floats, *, log: bool) -> Floats:
    """Return each row's value where it has changed by `at` from raw, (R, P); NaN out of reach.

    Parameters
    ----------
    at : (P,) or (R, P)
        The same for all rows, or for each.
    change : (>= R, L)
        Falling from left to right, to 0 at raw.
    values : (R, L)
    log : bool
        Interpolate the logarithm: a descriptor falls about exponentially with the rate, so that a
        chord over a wide step of the levels lies close to the curve.
    """
    n_rows = min(change.shape[0], values.shape[0])
    x, y = change[:n_rows, ::-1], values[:n_rows, ::-1]
    y = np.log(np.maximum(y, _SMALLEST)) if log else y
    wanted = np.broadcast_to(at if at.ndim == 2 else at[None], (n_rows, at.shape[-1]))  # noqa: PLR2004
    # Rounding must not put the end of a curve out of its own reach.
    wanted = np.maximum(wanted - _ROUNDING, 0.0)
    right = (x[:, :, None] < wanted[:, None, :]).sum(axis=1)
    in_reach = right < x.shape[1]
    right = np.clip(right, 1, x.shape[1] - 1)
    x_low, x_high = (np.take_along_axis(x, place, axis=1) for place in (right - 1, right))
    y_low, y_high = (np.take_along_axis(y, place, axis=1) for place in (right - 1, right))
    share = np.zeros_like(x_low)
    np.divide(wanted - x_low, x_high - x_low, out=share, where=x_high > x_low)
    between = y_low + np.clip(share, 0.0, 1.0) * (y_high - y_low)
    found: Floats = np.where(in_reach, np.exp(between) if log else between, np.nan)
    return found
