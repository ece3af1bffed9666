"""What is left at a price: every mechanism at fixed rises of the missed conflicts, `frontier.csv`.

A mechanism is a curve over its levels that ends at raw. Its level is read where the missed-conflict
rate has risen over raw by a target, and there what an adversary still has: PLR as shared, PLR after
the strongest reconstruction, and how often the strongest linker of each task finds a person again.
"""

from __future__ import annotations

from dataclasses import asdict
from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from evaluation.analysis.keys import AS_SHARED, Measure
from evaluation.analysis.linkability import dataset_of
from evaluation.analysis.matching import AT_EQUAL_ALARMS, MIN_DEFINED, MISSED, interpolated, places
from evaluation.analysis.metrics import (
    DESCRIPTORS,
    EQUAL_ALARMS,
    EXPOSURE,
    MISSED_RATE,
    SUCCESS,
    SUCCESS_OF_100,
)
from isac_track.intervals import percentile_intervals

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence

    from evaluation.analysis.keys import Source
    from evaluation.analysis.matching import Sweeps
    from isac_track.types import Bools, Floats, Ints

TARGETS: Final = (0.03, 0.05, 0.075, 0.1)
"""Rises of the missed-conflict rate over raw, fixed beforehand."""
WHITE: Final = "fixed:adding=independent,law=isotropic"
"""What others are held against: white noise, equal in all directions."""
COLUMNS: Final = [
    *("dataset", "mechanism", "family", "adding", "robot", "criterion", "target"),
    *("level", "level_low", "level_high", "consumer", "knowledge", "metric"),
    *("value", "ci_low", "ci_high", "vs_white", "vs_white_low", "vs_white_high"),
    *("dominated", "n"),
]
_CRITERIA: Final = {MISSED: MISSED_RATE, AT_EQUAL_ALARMS: EQUAL_ALARMS}
_LOG_SPAN: Final = 30.0
"""Levels that span more are interpolated on a logarithmic scale, as their sweep runs."""


def front(x: Floats, y: Floats) -> Bools:
    """Return which points no other one beats: none is at most as large in both and less in one.

    `x` and `y` are (N,), less is better in either; a point that is not known is on no front.
    """
    points, place = np.unique(np.column_stack([x, y]), axis=0, return_inverse=True)
    left = np.where(np.isnan(points).any(axis=1), np.inf, points[:, 1])
    # Of points from left to right the one is on it that has less left than all before.
    best = np.minimum.accumulate(np.append(np.inf, left))
    found: Bools = (left < best[:-1])[place.reshape(-1)]
    return found


def adversaries(strongest: Mapping[str, Source], known: Container[Measure]) -> list[Measure]:
    """Return what is told of a level: as shared, then the strongest attack of every kind.

    `strongest` is by task, as `analysis.strongest` has it; `known` are the measures of the run.
    """
    found = [AS_SHARED.measure(EXPOSURE)]
    for task, one in strongest.items():
        at_100 = one.measure(SUCCESS_OF_100)
        usual = one.measure(SUCCESS if task else EXPOSURE)
        found.append(at_100 if task and at_100 in known else usual)
    return found


def frontier(
    sweeps: Sweeps, *, predictors: Sequence[str], strongest: Mapping[str, Source], dataset: str
) -> pd.DataFrame:
    """Return a row for each mechanism, robot, criterion, target and adversary: `COLUMNS`.

    Level and value are interpolated on the isotonic curve from the noisiest level to raw, each
    replicate on its own; with less than `MIN_DEFINED` of them in reach there is no interval.
    `vs_white` is the difference from white noise at the same target, paired; empty without it.
    `dominated`: another row of this robot, criterion and adversary has less left at no higher
    target. A target out of reach keeps its row without level and numbers.
    """
    told, parts = adversaries(strongest, {key.measure for key in sweeps.found}), []
    for robot, (criterion, metric) in product(predictors, _CRITERIA.items()):
        reached = {
            name: places(np.array(TARGETS), np.abs(curve - curve[:, -1:]))
            for name in sweeps.known
            if (curve := sweeps.curve(name, Measure(robot, metric))) is not None
        }
        level = {
            name: _read(("level", "level_low", "level_high"), _levels(sweeps.levels(name), where))
            for name, where in reached.items()
        }
        for measure in told:
            left = {
                name: interpolated(where, curve, log=measure.metric in DESCRIPTORS)
                for name, where in reached.items()
                if (curve := sweeps.curve(name, measure)) is not None
            }
            rows = []
            for name, values in left.items():
                row = asdict(sweeps.known[name]) | {"target": TARGETS} | level[name]
                row |= _read(("value", "ci_low", "ci_high"), values)
                if WHITE in left:
                    n_rows = min(len(values), len(left[WHITE]))
                    difference = values[:n_rows] - left[WHITE][:n_rows]
                    row |= _read(("vs_white", "vs_white_low", "vs_white_high"), difference)
                rows.append(pd.DataFrame(row | {"n": sweeps.n(name, measure)}))
            if rows:
                of = pd.concat(rows, ignore_index=True).assign(
                    robot=robot, criterion=criterion, **measure._asdict()
                )
                on_front = front(of["target"].to_numpy(), of["value"].to_numpy())
                of["dominated"] = pd.array(~on_front, dtype="boolean")
                of.loc[of["value"].isna(), "dominated"] = pd.NA
                of["dataset"] = dataset_of(measure.consumer, dataset=dataset)
                parts.append(of)
    if not parts:
        return pd.DataFrame(columns=COLUMNS)
    return pd.concat(parts, ignore_index=True).reindex(columns=COLUMNS)


def _levels(levels: Sequence[float | None], where: tuple[Ints, Floats]) -> Floats:
    """Return the level at some places of a curve, (R, P); NaN where only raw is beyond it.

    Raw is a level of zero where levels fall towards it on a linear scale; on all others none.
    """
    known = np.array(levels, dtype=float)
    is_log = bool(known.min() > 0 and known.max() > _LOG_SPAN * known.min())
    raw = 0.0 if known[0] > known[-1] and not is_log else np.nan
    every = np.broadcast_to(np.append(known, raw), (len(where[0]), known.size + 1))
    return interpolated(where, every, log=is_log)


def _read(names: tuple[str, str, str], values: Floats) -> dict[str, Floats]:
    """Return estimate and both ends, (P,) each, of estimate and replicates, (1 + B, P)."""
    drawn = values[1:].T.copy()
    has_interval = np.isfinite(drawn).sum(axis=1) >= MIN_DEFINED * drawn.shape[1]
    ends = np.where(has_interval & np.isfinite(values[0]), percentile_intervals(drawn), np.nan)
    return dict(zip(names, (values[0], *ends), strict=True))
