"""Mechanisms against fixed noise at equal cost or equal PLR: `matched.csv`.

Operating points are matched by one of four criteria: an equal rise of the
missed-conflict rate over raw; the same while false alarms are held at raw's rate; the
same for conflicts that are still to come; or an equal PLR as shared.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import ADDING_RULES, FIXED
from evaluation.estimates.interpolation import MIN_DEFINED, with_ends
from evaluation.estimates.metrics import DESCRIPTORS, LINKAGE_COMPARED
from evaluation.estimates.recordings import in_run
from evaluation.estimates.sweeps import (
    CRITERIA,
    EQUAL_PLR,
    PLR_AS_SHARED,
    Curves,
    Sweeps,
    at_changes,
)
from evaluation.plan.address import AS_SHARED, Address, parse_consumer
from evaluation.plan.presets import SHARED
from evaluation.plan.world import OWN_WORLD, World
from isac_track.intervals import LEAST_CLUSTERS
from isac_track.types import Floats

N_POINTS, N_ATTACK_POINTS = 20, 10  # Points of a curve as shared, and after an attack.
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
    (`isotonic_joined`) and interpolated, never beyond the reach of both. Curves are matched by
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
        if measure.reader == AS_SHARED and measure.metric in DESCRIPTORS
    ]
    attacked = [
        measure
        for measure in every_measure
        if measure.consumer != SHARED and measure.adversary
    ]
    measures = shared + [
        measure
        for measure in attacked
        if measure.metric in (LINKAGE_COMPARED if measure.reader.task else DESCRIPTORS)
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
    if PLR_AS_SHARED in shared and EQUAL_PLR in criteria:
        others = [measure for measure in measures if measure != PLR_AS_SHARED]
        matches.append(_Match(EQUAL_PLR, PLR_AS_SHARED, "", others))
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
    is_plr = matched_by.reader == AS_SHARED
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
