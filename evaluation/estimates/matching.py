"""FID, or another mechanism, against fixed noise at equal cost or equal PLR: `matched.csv`.

Operating points are matched at an equal rise of the missed-conflict rate over raw, at
an equal rise of it while false alarms are held at raw's rate, at the same of conflicts
that are still to come, or at an equal PLR as shared.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Final, TypeAlias

import numpy as np
import pandas as pd

from evaluation.estimates.families import ADDING_RULES, FID, FIXED, RAW, Family
from evaluation.estimates.keys import AS_SHARED, Found, Measure
from evaluation.estimates.linkability import dataset_of
from evaluation.estimates.metrics import (
    ACHIEVED,
    COSTS,
    DESCRIPTORS,
    EQUAL_ALARMS,
    ERROR,
    EXPOSURE,
    FUTURE_EQUAL_ALARMS,
    MISSED_RATE,
)
from evaluation.plan.presets import SHARED
from isac_track.intervals import Estimate, percentile_intervals
from isac_track.types import Bools, Floats, Ints

MISSED, AT_EQUAL_ALARMS, FUTURE, PLR = "missed", EQUAL_ALARMS, "missed_future", "plr"
"""Criteria of matching."""
CRITERIA: Final = {
    MISSED: MISSED_RATE,
    AT_EQUAL_ALARMS: EQUAL_ALARMS,
    FUTURE: FUTURE_EQUAL_ALARMS,
}
"""What noise may cost: false alarms are held at raw's rate but in the first, the paper's."""
N_POINTS, N_ATTACK_POINTS = 20, 10  # Of a curve as shared, and of one after an attack.
# Share of replicates that must reach a point for it to have an interval.
MIN_DEFINED = 0.975
FEWEST_LEVELS: Final = 2  # Of a curve, beside raw.
_SHOWN: Final = AS_SHARED.measure(EXPOSURE)
_SMALLEST = 1e-12
_ROUNDING = 1e-9
_INTERVALS = (
    ("fid", "fid_low", "fid_high"),  # What is compared, under any name.
    ("fixed", "fixed_low", "fixed_high"),
    ("difference", "ci_low", "ci_high"),
)
_POINTS = ("at", "missed_conflict_rate", *chain(*_INTERVALS), "defined")
COLUMNS = [
    "dataset",
    "criterion",
    "adding",
    "predictor",
    "consumer",
    "knowledge",
    "metric",
    *_POINTS,
    "n",
    "mechanism",
    "family",
]
Curves: TypeAlias = "dict[Measure, tuple[Floats, Floats]]"
"""Two mechanisms over their levels, (1 + B, L) each, by what they are measured by."""


class Sweeps:
    """Every estimate of a run, and its mechanisms."""

    def __init__(self, found: Found, known: Mapping[str, Family]) -> None:
        self.found = found
        self.known = known
        self._levels: dict[str, list[float | None]] = {}
        for key in found:
            if (
                key.metric == EXPOSURE
                and key.measure == _SHOWN
                and known[key.mechanism].is_added
            ):
                self._levels.setdefault(key.mechanism, []).append(key.level)
        for mechanism, levels in self._levels.items():
            levels.sort(key=lambda level: (level is None, level))
            family = known[mechanism].family
            least, most = (
                found[_SHOWN.at(mechanism, levels[end])].value for end in (0, -1)
            )
            if not (family == FID or (family != FIXED and least < most)):
                levels.reverse()

    def levels(self, mechanism: str) -> list[float | None]:
        """Return the levels of a mechanism, noisiest first: eta grows, a fixed error falls.

        Of any other mechanism the ends tell: the noisier one shows less.
        """
        return self._levels.get(mechanism, [])

    def named(self, family: str, *, adding: str) -> str:
        """Return a family's mechanism under an adding rule, nothing else of it changed, or ""."""
        wanted = family, adding, ""
        found = {
            (one.family, one.adding, one.parameters): name
            for name, one in self.known.items()
        }
        return found.get(wanted, "")

    def swept(self, adding: str) -> list[str]:
        """Return what is a curve under an adding rule: FID, fixed noise, and others with levels."""
        plain = [self.named(family, adding=adding) for family in (FID, FIXED)]
        more = (
            name
            for name, levels in self._levels.items()
            if len(levels) >= FEWEST_LEVELS
        )
        of_rule = [
            name
            for name in more
            if adding in self.known[name].rules and name not in plain
        ]
        return [*filter(None, plain), *of_rule]

    def curves(self, a: str, b: str, measures: Iterable[Measure]) -> Curves:
        """Return the curves of two mechanisms that end in one raw, by what both are measured by."""
        found = {
            one: self.together(dict.fromkeys((a, b, RAW), one)) for one in measures
        }
        return {one: (of[a], of[b]) for one, of in found.items() if {a, b} <= of.keys()}

    def together(self, by: Mapping[str, Measure]) -> dict[str, Floats]:
        """Return the curves of mechanisms that end in one raw, pooled over all, (1 + B, L) each.

        `by` is what each is measured by; without raw among them there are none. Left
        out is what has fewer than two levels, or lacks one.
        """
        found: dict[str, Floats] = {}
        if RAW not in by:
            return found
        raw = by[RAW].at(RAW, None)
        for name, measure in by.items():
            keys = [*(measure.at(name, level) for level in self.levels(name)), raw]
            if len(keys) > FEWEST_LEVELS and all(key in self.found for key in keys):
                found[name] = np.stack([self.found[key].drawn for key in keys], axis=1)
        # What noise costs falls towards raw, what it hides rises.
        rises = by[RAW].metric not in (*COSTS, ERROR)
        curves = joined([*found.values()], increasing=rises) if found else []
        return dict(zip(found, curves, strict=True))

    def rests_on(
        self, mechanisms: Iterable[str], *measures: Measure
    ) -> tuple[int, float]:
        """Return the least number of clusters, and of effective ones, over all levels and raw."""
        added = ((name, level) for name in mechanisms for level in self.levels(name))
        keys = (one.at(*where) for where in (*added, (RAW, None)) for one in measures)
        of = [self.found[key] for key in keys if key in self.found] or [
            Estimate(np.nan)
        ]
        return min(one.n for one in of), min(one.n_effective for one in of)

    def n(self, mechanism: str, measure: Measure) -> int:
        """Return how many clusters the least of a mechanism's levels has; 0 if none was run."""
        keys = (measure.at(mechanism, level) for level in self.levels(mechanism))
        return min((self.found[key].n for key in keys if key in self.found), default=0)


def matched(
    sweeps: Sweeps,
    *,
    predictors: Sequence[str],
    dataset: str,
    world: str = "",
    criteria: Collection[str] = (*CRITERIA, PLR),
) -> pd.DataFrame:
    """Return every mechanism with levels against fixed noise: every criterion, rule and measure.

    Both curves end in one raw; what is matched and what is compared are made monotone
    over the levels (`joined`) and interpolated, never beyond what both reach. Matched
    is the *change from raw*, so that each bootstrap replicate, which repeats all of it
    on its own drawn people, is read at its own raw value plus that change: the
    comparison is paired in both.

    Descriptors as shared are compared for every predictor; the same after each attack,
    and what each linker achieves, for the first one. A mechanism is compared under its
    own adding rule, one that declares none under both; FID comes first. `sweeps` are of
    every metric of the run; `world` is the further horizon, if it is one, at which
    their robots are judged.

    The columns are `COLUMNS`. `at` is the rise of the missed rate over raw, or the PLR
    as shared; `missed_conflict_rate` is that of raw plus the rise. `defined` is the
    share of replicates that reach the point; below `MIN_DEFINED` there is no interval
    (NaN), since those that are left would all lie on one side.
    """
    known = dict.fromkeys(key.measure for key in sweeps.found)
    shared = [
        one for one in known if one.source == AS_SHARED and one.metric in DESCRIPTORS
    ]
    attacked = [one for one in known if one.consumer != SHARED and one.knowledge]
    measures = shared + [
        one
        for one in attacked
        if one.metric in (ACHIEVED if one.source.task else DESCRIPTORS)
    ]
    matched_by = [
        (
            criterion,
            Measure(predictor, metric),
            predictor,
            shared if place else measures,
        )
        for place, predictor in enumerate(predictors)
        for criterion, metric in CRITERIA.items()
        if criterion in criteria
    ]
    if _SHOWN in shared and PLR in criteria:
        matched_by.append((PLR, _SHOWN, "", [one for one in measures if one != _SHOWN]))
    parts = [
        {
            "dataset": dataset_of(measure.consumer, dataset=dataset, world=world),
            "criterion": criterion,
            "adding": adding,
            "predictor": predictor,
            **measure._asdict(),
            **points,
            "n": min(sweeps.n(arm, measure) for arm in (mechanism, fixed)),
            "mechanism": mechanism,
            "family": sweeps.known[mechanism].family,
        }
        for adding in ADDING_RULES
        for fixed in [sweeps.named(FIXED, adding=adding)]
        for mechanism in sweeps.swept(adding)
        if mechanism != fixed
        for curves in [
            sweeps.curves(mechanism, fixed, {*measures, *(of[1] for of in matched_by)})
        ]
        for criterion, by, predictor, wanted in matched_by
        for measure, points in _compared(curves, by, wanted)
    ]
    table = pd.DataFrame(parts, columns=COLUMNS)
    return table.explode([*_POINTS], ignore_index=True).infer_objects()


def _compared(
    curves: Curves, by: Measure, measures: Sequence[Measure]
) -> Iterator[tuple[Measure, dict[str, Floats]]]:
    """Yield measures with columns of `matched.csv`, (P,), where `by` has changed alike in both."""
    scales: Sequence[Floats] = curves.get(by, ())
    reach = min((np.abs(one[0] - one[0, -1]).max() for one in scales), default=0.0)
    if not reach > 0:
        return
    raw, is_plr = float(scales[0][0, -1]), by.source == AS_SHARED
    for n_points, are_shared in ((N_POINTS, True), (N_ATTACK_POINTS, False)):
        # No change is raw itself, the end of both curves: nothing is compared there.
        at = np.linspace(0.0, reach, n_points + 1)[1:]
        at = at[::-1] if is_plr else at  # at ascends, in PLR as well
        rate = np.full(n_points, np.nan) if is_plr else raw + at
        of = [one for one in measures if (one.consumer == SHARED) == are_shared]
        for measure, compared, fixed in at_changes(curves, by, of, at=at):
            gap = compared - fixed
            defined = np.isfinite(gap[1:]).mean(axis=0)
            points = {"at": raw - at if is_plr else at, "missed_conflict_rate": rate}
            for names, values in zip(_INTERVALS, (compared, fixed, gap), strict=True):
                has_ends = np.isfinite(values[1:]).all(axis=0) | (
                    defined >= MIN_DEFINED
                )
                points |= with_ends(names, values, has_ends)
            yield measure, points | {"defined": defined}


def with_ends(
    names: tuple[str, str, str], values: Floats, can_say: Bools
) -> dict[str, Floats]:
    """Return estimate and both ends, (P,) each, of estimate and replicates, (1 + B, P).

    `can_say`, (P,), is where there may be an interval.
    """
    drawn = values[1:].T.copy()
    has_ends = can_say & (
        np.isfinite(drawn).sum(axis=1) >= MIN_DEFINED * drawn.shape[1]
    )
    ends = np.where(
        has_ends & np.isfinite(values[0]), percentile_intervals(drawn), np.nan
    )
    # A copy: a view would keep all replicates in memory.
    return dict(zip(names, (values[0].copy(), *ends), strict=True))


def at_changes(
    curves: Curves, by: Measure, measures: Iterable[Measure], *, at: Floats
) -> Iterator[tuple[Measure, Floats, Floats]]:
    """Yield measures of both mechanisms where `by` has changed from raw by `at`, (1 + B, P) each.

    Raw is one for both; what is out of reach is NaN. Measures that a level lacks are
    left out.
    """
    where = [places(at, np.abs(scale - scale[:, -1:])) for scale in curves.get(by, ())]
    for measure in measures if where else ():
        if measure in curves:
            first, second = (
                interpolated(place, curve, log=measure.metric in DESCRIPTORS)
                for place, curve in zip(where, curves[measure], strict=True)
            )
            n_rows = min(len(first), len(second))
            yield measure, first[:n_rows], second[:n_rows]


def rising(values: Floats) -> Floats:
    """Return each row made to rise from left to right by isotonic regression, (R, L).

    By the min-max formula (Barlow et al. 1972): the largest over all beginnings of the
    smallest over all ends of the mean between them. SciPy's takes replicates row by
    row.
    """
    is_broken = ~(np.diff(values, axis=1) >= 0.0).all(axis=1)
    if not is_broken.all():  # about half of the replicates rise by themselves
        found = values.copy()
        if is_broken.any():
            found[is_broken] = rising(values[is_broken])
        return found
    # Levels first: steps along the replicates are long, those along the levels few.
    n_levels = values.shape[1]
    sums = np.zeros((n_levels + 1, values.shape[0]))
    np.cumsum(values.T, axis=0, out=sums[1:])
    best: Floats = np.full((n_levels, values.shape[0]), -np.inf)
    for first in range(n_levels):
        counts = np.arange(1, n_levels - first + 1)[:, None]
        means = (sums[first + 1 :] - sums[first]) / counts
        smallest = np.minimum.accumulate(means[::-1], axis=0)[::-1]
        np.maximum(best[first:], smallest, out=best[first:])
    return np.ascontiguousarray(best.T)


def joined(curves: Sequence[Floats], *, increasing: bool) -> list[Floats]:
    """Return curves that end in one raw, their last column, made monotone together.

    Isotonic regression over all of them, (R, L) each, in which raw counts once: with
    what lies above it, once every curve is monotone by itself, it is pooled to their
    mean (isotonic regression within bounds; Barlow et al. 1972).
    """
    if not increasing:
        return [-one for one in joined([-one for one in curves], increasing=True)]
    own = [rising(one[:, :-1]) for one in curves]
    highest = -np.sort(-np.concatenate(own, axis=1), axis=1)
    sums = np.cumsum(np.append(curves[0][:, -1:], highest, axis=1), axis=1)
    raw = (sums / np.arange(1, sums.shape[1] + 1)).max(axis=1, keepdims=True)
    return [np.append(np.minimum(one, raw), raw, axis=1) for one in own]


def places(at: Floats, change: Floats) -> tuple[Ints, Floats]:
    """Return where each row has changed by `at` from raw, (R, P) each.

    The level to the right (left of it is raw), and how far it is from the level to the
    left, 0..1; NaN out of reach. `at` is (P,) for all rows, or (R, P); `change`, (R,
    L), falls from left to right, to 0 at raw.
    """
    x = change[:, ::-1]
    # Rounding must not put the end of a curve out of its own reach.
    wanted = np.maximum(
        np.broadcast_to(at, (x.shape[0], at.shape[-1])) - _ROUNDING, 0.0
    )
    right = np.zeros(wanted.shape, dtype=np.int64)
    for level in x.T:
        right += level[:, None] < wanted
    in_reach = right < x.shape[1]
    right = np.clip(right, 1, x.shape[1] - 1)
    low, high = (np.take_along_axis(x, place, axis=1) for place in (right - 1, right))
    share = np.zeros_like(low)
    np.divide(wanted - low, high - low, out=share, where=high > low)
    return right, np.where(in_reach, np.clip(share, 0.0, 1.0), np.nan)


def nearest_places(at: Floats, scale: Floats) -> tuple[Ints, Floats]:
    """Return `places` of values, (R, P), on a scale that rises to raw; beyond its ends at these."""
    change = scale[:, -1:] - scale
    return places(np.clip(scale[:, -1:] - at, 0.0, change[:, :1]), change)


def interpolated(where: tuple[Ints, Floats], values: Floats, *, log: bool) -> Floats:
    """Return the values, (R, L), of each row at its places, (R, P); NaN out of reach.

    Of unequal numbers of rows the first are read. With `log` the logarithm is
    interpolated: close to a descriptor's curve over a wide step, as it falls about
    exponentially with the rate.
    """
    n_rows = min(len(where[0]), len(values))
    right, share = where[0][:n_rows], where[1][:n_rows]
    y = values[:n_rows, ::-1]
    y = np.log(np.maximum(y, _SMALLEST)) if log else y
    low, high = (np.take_along_axis(y, place, axis=1) for place in (right - 1, right))
    between: Floats = low + share * (high - low)
    return np.exp(between) if log else between
