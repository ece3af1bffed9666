"""Mechanisms against fixed noise at equal cost or equal PLR: `matched.csv`.

Operating points are matched by one of four criteria: an equal rise of the
missed-conflict rate over raw; the same while false alarms are held at raw's rate; the
same for conflicts that are still to come; or an equal PLR as shared.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from evaluation.estimates.families import ADDING_RULES, AT_RAW, FID, FIXED, RAW, Family
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.linkability import in_run
from evaluation.estimates.metrics import (
    COSTS,
    DESCRIPTORS,
    DISTANCE_MAE,
    EQUAL_ALARMS,
    FUTURE_EQUAL_ALARMS,
    LINKAGE_COMPARED,
    MISSED_RATE,
    PLR,
)
from evaluation.plan.address import AS_SHARED, Address, Where, parse_consumer
from evaluation.plan.presets import SHARED
from evaluation.plan.world import OWN_WORLD, World
from isac_track.intervals import LEAST_CLUSTERS, Estimate, percentile_intervals
from isac_track.types import Bools, Floats, Ints

MISSED, AT_EQUAL_ALARMS, FUTURE, EQUAL_PLR = (
    "missed",
    EQUAL_ALARMS,
    "missed_future",
    "plr",
)
"""Criteria of matching."""
CRITERIA: Final = {
    MISSED: MISSED_RATE,
    AT_EQUAL_ALARMS: EQUAL_ALARMS,
    FUTURE: FUTURE_EQUAL_ALARMS,
}
"""Cost of noise by criterion; all but the paper's hold false alarms at raw's rate."""
N_POINTS, N_ATTACK_POINTS = 20, 10  # Points of a curve as shared, and after an attack.
# Share of replicates that must reach a point for it to have an interval.
MIN_DEFINED = 0.975
FEWEST_LEVELS: Final = 2  # Fewest levels of a curve, beside raw.
_SHOWN: Final = AS_SHARED.measured(PLR)
_SMALLEST = 1e-12
_ROUNDING = 1e-9
_INTERVALS = (
    ("fid", "fid_low", "fid_high"),  # The mechanism compared, whatever its name.
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
Curves: TypeAlias = "dict[Address, tuple[Floats, Floats]]"
"""Curves of two mechanisms over their levels, (1 + B, L) each, by measure."""


class Sweeps:
    """Every estimate of a run, and its mechanisms."""

    def __init__(
        self, estimates: EstimatesByAddress, families: Mapping[str, Family]
    ) -> None:
        self.estimates = estimates
        self.families = families
        self._levels: dict[str, list[float | None]] = {}
        for key in estimates:
            if (
                key.metric == PLR
                and key.measure == _SHOWN
                and families[key.mechanism].is_added
            ):
                self._levels.setdefault(key.mechanism, []).append(key.level)
        for mechanism, levels in self._levels.items():
            levels.sort(key=lambda level: (level is None, level))
            family = families[mechanism].family
            plr_first, plr_last = (
                estimates[_SHOWN.at(mechanism, levels[end])].value for end in (0, -1)
            )
            is_other = family not in (FID, FIXED)
            if not (family == FID or (is_other and plr_first < plr_last)):
                levels.reverse()

    def levels(self, mechanism: str) -> list[float | None]:
        """Return the levels of a mechanism, noisiest first.

        From there eta grows and the fixed error falls. For any other mechanism PLR at
        the two ends decides: the noisier end shows less.
        """
        return self._levels.get(mechanism, [])

    def named(self, family: str, *, adding: str) -> str:
        """Return a family's mechanism under an adding rule, all else default; or ""."""
        name_by_parts = {
            (mechanism.family, mechanism.adding, mechanism.parameters): name
            for name, mechanism in self.families.items()
        }
        return name_by_parts.get((family, adding, ""), "")

    def swept(self, adding: str) -> list[str]:
        """Return the mechanisms with a curve under a rule, FID and fixed first."""
        papers = [self.named(family, adding=adding) for family in (FID, FIXED)]
        others = [
            name
            for name, levels in self._levels.items()
            if len(levels) >= FEWEST_LEVELS
            and adding in self.families[name].rules
            and name not in papers
        ]
        return [*filter(None, papers), *others]

    def curves(self, a: str, b: str, measures: Iterable[Address]) -> Curves:
        """Return two mechanisms' curves, joined at raw, for each common measure."""
        joined_curves = {
            measure: self.together(dict.fromkeys((a, b, RAW), measure))
            for measure in measures
        }
        return {
            measure: (by_mechanism[a], by_mechanism[b])
            for measure, by_mechanism in joined_curves.items()
            if {a, b} <= by_mechanism.keys()
        }

    def together(self, measures: Mapping[str, Address]) -> dict[str, Floats]:
        """Return the curves of mechanisms, joined at raw and pooled, (1 + B, L) each.

        `measures` gives the measure of each mechanism; without raw among them there
        are no curves. A mechanism with fewer than two levels, or without an estimate at
        one of its levels, is left out.
        """
        stacked: dict[str, Floats] = {}
        if RAW not in measures:
            return stacked
        raw = measures[RAW].at(RAW, None)
        for name, measure in measures.items():
            keys = [*(measure.at(name, level) for level in self.levels(name)), raw]
            if len(keys) > FEWEST_LEVELS and all(key in self.estimates for key in keys):
                drawn = [self.estimates[key].drawn for key in keys]
                stacked[name] = np.stack(drawn, axis=1)
        # The cost of noise falls towards raw; what noise hides rises.
        rises = measures[RAW].metric not in (*COSTS, DISTANCE_MAE)
        curves = joined([*stacked.values()], increasing=rises) if stacked else []
        return dict(zip(stacked, curves, strict=True))

    def rests_on(
        self, mechanisms: Iterable[str], *measures: Address
    ) -> tuple[int, float]:
        """Return the least clusters and effective clusters over all levels and raw."""
        wheres = [
            Where(name, level) for name in mechanisms for level in self.levels(name)
        ]
        wheres.append(AT_RAW)
        keys = (measure.at(*where) for where in wheres for measure in measures)
        known = [self.estimates[key] for key in keys if key in self.estimates]
        known = known or [Estimate(np.nan)]
        return (
            min(estimate.n for estimate in known),
            min(estimate.n_effective for estimate in known),
        )

    def n(self, mechanism: str, measure: Address) -> int:
        """Return the least clusters over a mechanism's levels; 0 if none was run."""
        keys = (measure.at(mechanism, level) for level in self.levels(mechanism))
        return min(
            (self.estimates[key].n for key in keys if key in self.estimates), default=0
        )


class _Match(NamedTuple):
    """A criterion by which two curves are matched, and the measures compared there."""

    criterion: str
    by: Address
    predictor: str  # Empty where robots play no part.
    measures: Sequence[Address]


def matched(
    sweeps: Sweeps,
    *,
    predictors: Sequence[str],
    dataset: str,
    world: World = OWN_WORLD,
    criteria: Collection[str] = (*CRITERIA, EQUAL_PLR),
) -> pd.DataFrame:
    """Return every mechanism with levels against fixed noise at matched points.

    There are rows for every criterion, adding rule and measure. Both curves end in the
    same raw; the measures matched and compared are made monotone over the levels
    (`joined`) and interpolated, never beyond the reach of both. Curves are matched by
    the *change from raw*: each bootstrap replicate, which repeats everything on its own
    drawn people, is read at its own raw value plus that change. The comparison is
    paired in both.

    Descriptors as shared are compared for every predictor; descriptors after each
    attack, and each linker's success, for the first predictor. A mechanism is compared
    under its own adding rule, or under both if it declares none; FID comes first.
    `sweeps` has every metric of the run; `world` is the further horizon, if any, at
    which its robots are judged.

    The columns are `COLUMNS`. `at` is the rise of the missed rate over raw, or the PLR
    as shared; `missed_conflict_rate` is raw's plus the rise. `defined` is the share of
    replicates that reach the point. Below `MIN_DEFINED` there is no interval (NaN),
    since the remaining replicates would all lie on one side. Neither is there one below
    `LEAST_CLUSTERS` effective clusters.
    """
    matches = _matches(sweeps, predictors, criteria)
    measures = {measure for match in matches for measure in (*match.measures, match.by)}
    parts = []
    for adding in ADDING_RULES:
        fixed = sweeps.named(FIXED, adding=adding)
        for mechanism in sweeps.swept(adding):
            if mechanism == fixed:
                continue
            curves = sweeps.curves(mechanism, fixed, measures)
            parts += [
                {
                    "criterion": match.criterion,
                    "predictor": match.predictor,
                    **in_run(measure, dataset=dataset, world=world).to_columns(),
                    "adding": adding,
                    **points,
                    "n": min(sweeps.n(name, measure) for name in (mechanism, fixed)),
                    "mechanism": mechanism,
                    "family": sweeps.families[mechanism].family,
                }
                for match in matches
                for measure, points in _compared(
                    curves, match, partial(sweeps.rests_on, (mechanism, fixed))
                )
            ]
    table = pd.DataFrame(parts, columns=COLUMNS)
    return table.explode([*_POINTS], ignore_index=True).infer_objects()


def _matches(
    sweeps: Sweeps, predictors: Sequence[str], criteria: Collection[str]
) -> list[_Match]:
    """Return the criteria that curves are matched by, with the measures compared."""
    every_measure = dict.fromkeys(key.measure for key in sweeps.estimates)
    shared = [
        measure
        for measure in every_measure
        if measure.source == AS_SHARED and measure.metric in DESCRIPTORS
    ]
    attacked = [
        measure
        for measure in every_measure
        if measure.consumer != SHARED and measure.adversary
    ]
    measures = shared + [
        measure
        for measure in attacked
        if measure.metric in (LINKAGE_COMPARED if measure.source.task else DESCRIPTORS)
    ]
    matches = [
        _Match(
            criterion,
            parse_consumer(predictor).measured(metric),
            predictor,
            shared if place else measures,
        )
        for place, predictor in enumerate(predictors)
        for criterion, metric in CRITERIA.items()
        if criterion in criteria
    ]
    if _SHOWN in shared and EQUAL_PLR in criteria:
        others = [measure for measure in measures if measure != _SHOWN]
        matches.append(_Match(EQUAL_PLR, _SHOWN, "", others))
    return matches


def _compared(
    curves: Curves, match: _Match, rests_on: Callable[..., tuple[int, float]]
) -> Iterator[tuple[Address, dict[str, Floats]]]:
    """Yield measures with their columns of `matched.csv`, (P,), at matched points.

    `rests_on` is that of the sweeps, for both mechanisms.
    """
    matched_by = match.by
    scales: Sequence[Floats] = curves.get(matched_by, ())
    reach = min(
        (np.abs(curve[0] - curve[0, -1]).max() for curve in scales), default=0.0
    )
    if not reach > 0:
        return
    raw = float(scales[0][0, -1])
    is_plr = matched_by.source == AS_SHARED
    for n_points, are_shared in ((N_POINTS, True), (N_ATTACK_POINTS, False)):
        # A change of zero is raw itself, the end of both curves: skip it.
        changes = np.linspace(0.0, reach, n_points + 1)[1:]
        if is_plr:
            # So that the column `at` ascends, in PLR as well.
            changes = changes[::-1]
            at, rate = raw - changes, np.full(n_points, np.nan)
        else:
            at, rate = changes, raw + changes
        in_group = [
            measure
            for measure in match.measures
            if (measure.consumer == SHARED) == are_shared
        ]
        pairs = at_changes(curves, matched_by, in_group, at=changes)
        for pair in pairs:
            compared, fixed = pair.first, pair.second
            gap = compared - fixed
            defined = np.isfinite(gap[1:]).mean(axis=0)
            _, effective = rests_on(matched_by, pair.measure)
            points = {"at": at, "missed_conflict_rate": rate}
            for names, values in zip(_INTERVALS, (compared, fixed, gap), strict=True):
                has_ends = np.isfinite(values[1:]).all(axis=0) | (
                    defined >= MIN_DEFINED
                )
                has_ends &= effective >= LEAST_CLUSTERS
                points |= with_ends(names, values, has_ends)
            yield pair.measure, points | {"defined": defined}


def with_ends(
    names: tuple[str, str, str], values: Floats, can_say: Bools
) -> dict[str, Floats]:
    """Return value and interval, (P,) each, from estimate and replicates, (1 + B, P).

    `can_say`, (P,), tells where there may be an interval.
    """
    drawn = values[1:].T.copy()
    has_ends = can_say & has_interval(values)
    ends = np.where(has_ends, percentile_intervals(drawn), np.nan)
    # Copy: a view would keep all replicates in memory.
    return dict(zip(names, (values[0].copy(), *ends), strict=True))


def has_interval(values: Floats) -> Bools:
    """Return where enough replicates are known, (P,), of estimates, (1 + B, P)."""
    n_known = np.isfinite(values[1:]).sum(axis=0)
    is_enough = n_known >= MIN_DEFINED * (len(values) - 1)
    return np.asarray(is_enough & np.isfinite(values[0]))


@dataclass(frozen=True, eq=False, slots=True)
class AtChanges:
    """A measure of two mechanisms, at P equal changes of another from raw."""

    measure: Address
    first: Floats  # (1 + B, P) estimate, then replicates.
    second: Floats  # (1 + B, P) of the other mechanism.


def at_changes(
    curves: Curves, matched_by: Address, measures: Iterable[Address], *, at: Floats
) -> Iterator[AtChanges]:
    """Yield measures of both mechanisms at equal changes from raw.

    The measure `matched_by` has changed from raw by `at` there. Raw is the same for
    both mechanisms; points out of reach are NaN. Measures without an estimate at some
    level are left out.
    """
    if matched_by not in curves:
        return
    positions = [
        places(at, np.abs(scale - scale[:, -1:])) for scale in curves[matched_by]
    ]
    for measure in measures:
        if measure in curves:
            first, second = (
                interpolated(position, curve, log=measure.metric in DESCRIPTORS)
                for position, curve in zip(positions, curves[measure], strict=True)
            )
            n_rows = min(len(first), len(second))
            yield AtChanges(measure, first[:n_rows], second[:n_rows])


def rising(values: Floats) -> Floats:
    """Return each row made to rise from left to right by isotonic regression, (R, L).

    By the min-max formula (Barlow et al. 1972): the largest over all beginnings of the
    smallest over all ends of the mean between them. SciPy's function would need a loop
    over the replicates.
    """
    is_broken = ~(np.diff(values, axis=1) >= 0.0).all(axis=1)
    # About half of the replicates rise by themselves.
    if not is_broken.all():
        monotone = values.copy()
        if is_broken.any():
            monotone[is_broken] = rising(values[is_broken])
        return monotone
    # Levels on the first axis: there are few of them and many replicates.
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

    Isotonic regression over all curves, (R, L) each, in which raw counts once. Each
    curve is first made monotone by itself; then raw and the values above it are pooled
    to their mean (isotonic regression within bounds; Barlow et al. 1972).
    """
    if not increasing:
        return [
            -curve for curve in joined([-curve for curve in curves], increasing=True)
        ]
    own = [rising(curve[:, :-1]) for curve in curves]
    highest = -np.sort(-np.concatenate(own, axis=1), axis=1)
    sums = np.cumsum(np.append(curves[0][:, -1:], highest, axis=1), axis=1)
    raw = (sums / np.arange(1, sums.shape[1] + 1)).max(axis=1, keepdims=True)
    return [np.append(np.minimum(curve, raw), raw, axis=1) for curve in own]


class Places(NamedTuple):
    """Places between levels, whose columns are taken from right to left, raw first."""

    right: Ints  # (R, P) column right of each place, at least 1.
    share: Floats  # (R, P) of the way from the column before; NaN out of reach.


def places(at: Floats, change: Floats) -> Places:
    """Return the position at which each row has changed by `at` from raw, (R, P) each.

    A position is the level to the right (left of it is raw), and the distance from the
    level to the left, 0..1; NaN out of reach. `at` is (P,) for all rows, or (R, P);
    `change`, (R, L), falls from left to right, to 0 at raw.
    """
    x = change[:, ::-1]
    # Rounding must not put the end of a curve out of its own reach.
    targets = np.maximum(
        np.broadcast_to(at, (x.shape[0], at.shape[-1])) - _ROUNDING, 0.0
    )
    right = np.zeros(targets.shape, dtype=np.int64)
    for level in x.T:
        right += level[:, None] < targets
    in_reach = right < x.shape[1]
    right = np.clip(right, 1, x.shape[1] - 1)
    low, high = (np.take_along_axis(x, place, axis=1) for place in (right - 1, right))
    share = np.zeros_like(low)
    np.divide(targets - low, high - low, out=share, where=high > low)
    return Places(right, np.where(in_reach, np.clip(share, 0.0, 1.0), np.nan))


def nearest_places(at: Floats, scale: Floats) -> Places:
    """Return `places` of values, (R, P), on a scale that rises to raw, clipped."""
    change = scale[:, -1:] - scale
    return places(np.clip(scale[:, -1:] - at, 0.0, change[:, :1]), change)


def interpolated(at: Places, values: Floats, *, log: bool) -> Floats:
    """Return the values, (R, L), of each row at its places, (R, P); NaN out of reach.

    If the numbers of rows differ, the first rows of both are used. With `log` the
    logarithm is interpolated: a descriptor falls about exponentially with the rate, so
    that this stays close to its curve over a wide step.
    """
    n_rows = min(len(at.right), len(values))
    right, share = at.right[:n_rows], at.share[:n_rows]
    y = values[:n_rows, ::-1]
    y = np.log(np.maximum(y, _SMALLEST)) if log else y
    low, high = (np.take_along_axis(y, place, axis=1) for place in (right - 1, right))
    between: Floats = low + share * (high - low)
    return np.exp(between) if log else between
