"""FID, or another mechanism, against fixed noise at equal cost or equal PLR: `matched.csv`.

Operating points are matched at an equal rise of the missed-conflict rate over raw, at an equal rise
of it while false alarms are held at raw's rate, or at an equal PLR as shared. Compared are the
descriptors as shared, the same after each reconstruction attack, and what each linker achieves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from evaluation.analysis.families import ADDING_RULES, FIXED, Family
from evaluation.analysis.keys import AS_SHARED, Measure
from evaluation.analysis.linkability import dataset_of
from evaluation.analysis.metrics import ACHIEVED, DESCRIPTORS, EQUAL_ALARMS, EXPOSURE, MISSED_RATE
from evaluation.analysis.sweeps import Sweeps, interpolated, places
from evaluation.experiment.presets import SHARED
from isac_track.intervals import CONFIDENCE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from isac_track.types import Floats

MISSED, AT_EQUAL_ALARMS, PLR = "missed", EQUAL_ALARMS, "plr"
"""Criteria of matching."""
N_POINTS, N_ATTACK_POINTS = 20, 10
"""Of a curve as shared, and of one after an attack."""
MIN_DEFINED = 0.975
"""Share of replicates that must reach a point for it to have an interval."""
_ENDS = (0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2)
_INTERVALS = (
    ("fid", "fid_low", "fid_high"),
    ("fixed", "fixed_low", "fixed_high"),
    ("difference", "ci_low", "ci_high"),
)
"""Columns: what is compared, fixed noise, and the one less the other."""
_POINTS = ("at", "missed_conflict_rate", *chain(*_INTERVALS), "defined")
COLUMNS = [
    *("dataset", "criterion", "adding", "predictor", "consumer", "knowledge", "metric"),
    *(*_POINTS, "n", "mechanism", "family"),
]


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """A mechanism and fixed noise along all points at which they are matched."""

    mechanism: str
    """Compared with fixed noise."""
    measure: Measure
    points: Mapping[str, Floats]
    """(P,) by column of `matched.csv`, from `at` to `defined`."""
    mean_difference: Floats
    """(1 + B,) over the points that have an interval; row 0 is the estimate; NaN without any"""
    mean_fixed: float
    """Of fixed noise, over the same points."""
    n: int
    """Clusters."""
    criterion: str = ""
    adding: str = ""
    predictor: str = ""


def comparisons(sweeps: Sweeps, *, predictors: Sequence[str]) -> Iterator[Comparison]:
    """Yield every mechanism with levels against fixed noise: every criterion, rule and measure.

    Both curves run from their noisiest level to raw, which is the end of either. What is matched
    and what is compared are made monotone over the levels (isotonic regression) and interpolated,
    descriptors on a logarithmic scale, never beyond what both reach. Matched is the *change from
    raw*, so that each bootstrap replicate, which repeats all of it on its own drawn people, is read
    at its own raw value plus that change: the comparison is paired in both.

    Descriptors as shared are compared for every predictor, attacks for the first one. A mechanism
    is compared under its own adding rule, one that declares none under both. FID comes first.
    `sweeps` are of every metric of the run, linkage among them; of `predictors` the reference is
    the first.
    """
    # Descriptors as shared, then the same after each attack, and what each linker achieves.
    known = dict.fromkeys(key.measure for key in sweeps.found)
    shared = [one for one in known if one.source == AS_SHARED and one.metric in DESCRIPTORS]
    measures = shared + [
        one
        for one in known
        if one.consumer != SHARED
        and one.knowledge
        and one.metric in (ACHIEVED if one.source.task else DESCRIPTORS)
    ]
    criteria = [
        (criterion, Measure(predictor, metric), predictor, shared if place else measures)
        for place, predictor in enumerate(predictors)
        for criterion, metric in ((MISSED, MISSED_RATE), (AT_EQUAL_ALARMS, EQUAL_ALARMS))
    ]
    exposure = AS_SHARED.measure(EXPOSURE)
    if exposure in shared:
        criteria.append((PLR, exposure, "", [one for one in measures if one != exposure]))
    for adding in ADDING_RULES:
        fixed = sweeps.named(FIXED, adding=adding)
        for mechanism in sweeps.swept(adding):
            for criterion, by, predictor, wanted in criteria if mechanism != fixed else ():
                for one in compare(sweeps, (mechanism, fixed), by, wanted):
                    yield replace(one, criterion=criterion, adding=adding, predictor=predictor)


def matched(
    compared: Iterable[Comparison], *, known: Mapping[str, Family], dataset: str
) -> pd.DataFrame:
    """Return the comparisons as rows; the columns are `COLUMNS`.

    `mechanism` (of `family`) is what stands in the columns `fid`: the paper's mechanism, or
    another of the run. `at` is the rise of the missed rate over raw, or the PLR as shared;
    `missed_conflict_rate` is raw's estimate plus the rise. `defined` is the share of replicates
    that reach the point; where it is below `MIN_DEFINED` there is no interval (NaN), since the
    replicates that are left would all lie on one side. `known` are the mechanisms of the run, from
    `families`.
    """
    compared = list(compared)
    about = pd.DataFrame(
        [
            {
                "dataset": dataset_of(one.measure.consumer, dataset=dataset),
                **{name: getattr(one, name) for name in ("criterion", "adding", "predictor")},
                **one.measure._asdict(),
                "n": one.n,
                "mechanism": one.mechanism,
                "family": known[one.mechanism].family,
                "points": one.points["at"].size,
            }
            for one in compared
        ],
        columns=[*(name for name in COLUMNS if name not in _POINTS), "points"],
    )
    rows = about.loc[about.index.repeat(about.pop("points").astype(int))].reset_index(drop=True)
    for name in _POINTS if compared else ():
        rows[name] = np.concatenate([one.points[name] for one in compared])
    return rows.reindex(columns=COLUMNS)


def compare(
    sweeps: Sweeps, arms: tuple[str, str], by: Measure, measures: Sequence[Measure]
) -> Iterator[Comparison]:
    """Yield measures of two mechanisms where `by` has changed from raw by as much in both.

    `arms` are the names of the mechanism that is compared and of fixed noise.
    """
    scales = [scale for arm in arms if (scale := sweeps.curve(arm, by)) is not None]
    if len(scales) < len(arms):
        return
    change = [np.abs(scale - scale[:, -1:]) for scale in scales]
    reach = min(one[0].max() for one in change)
    if not reach > 0:
        return
    raw = float(scales[0][0, -1])
    is_plr = by.source == AS_SHARED
    order = slice(None, None, -1 if is_plr else 1)  # at ascends, in PLR as well
    # No change is raw itself, the end of both curves: nothing is compared there.
    at_of = {n: np.linspace(0.0, reach, n + 1)[1:][order] for n in (N_POINTS, N_ATTACK_POINTS)}
    where_of = {n: [places(at, scale) for scale in change] for n, at in at_of.items()}
    for measure in measures:
        curves = [curve for arm in arms if (curve := sweeps.curve(arm, measure)) is not None]
        if len(curves) < len(arms):
            continue
        n_points = N_POINTS if measure.consumer == SHARED else N_ATTACK_POINTS
        at = at_of[n_points]
        compared, fixed = (
            interpolated(where, curve, log=measure.metric in DESCRIPTORS)
            for where, curve in zip(where_of[n_points], curves, strict=True)
        )
        difference = compared - fixed
        defined = np.isfinite(difference[1:]).mean(axis=0)
        counts = (defined >= MIN_DEFINED) & np.isfinite(difference[0])
        points = {
            "at": raw - at if is_plr else at,
            "missed_conflict_rate": np.full(n_points, np.nan) if is_plr else raw + at,
            "defined": defined,
        }
        for names, values in zip(_INTERVALS, (compared, fixed, difference), strict=True):
            points |= zip(names, _summarised(values, defined), strict=True)
        yield Comparison(
            mechanism=arms[0],
            measure=measure,
            points=points,
            mean_difference=_mean(difference[:, counts]),
            mean_fixed=float(_mean(fixed[:1, counts])[0]),
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
