"""What is left at a price: every mechanism at fixed rises of the missed conflicts, `frontier.csv`.

What an adversary still has there: the descriptors as shared and after the strongest
reconstruction of every adversary that was run, and how often the strongest linker of
each task finds a person again. Beside it the robot's own: MAE and PLR.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import RAW
from evaluation.estimates.keys import AS_SHARED, Key, Source
from evaluation.estimates.linkability import dataset_of
from evaluation.estimates.matching import (
    AT_EQUAL_ALARMS,
    CRITERIA,
    FUTURE,
    Sweeps,
    interpolated,
    places,
    with_ends,
)
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    ROBOTS_OWN,
    SUCCESS,
    SUCCESS_OF_100,
)
from evaluation.estimates.strongest import success_of
from evaluation.estimates.strongest_table import Strongest, strongest_on_each
from evaluation.plan.constants import horizon_of
from evaluation.store.cell_files import Summed
from isac_track.intervals import CONFIDENCE, LEAST_CLUSTERS, Estimate
from isac_track.types import Bools, Floats, Ints

TARGETS: Final = (0.03, 0.05, 0.075, 0.1)  # Rises over raw, fixed beforehand.
# White noise: others are held against it.
WHITE: Final = "fixed:adding=independent,law=isotropic"
NEAR: Final = 0.03 + 1e-9  # With what rounding takes.
ENOUGH_LEVELS: Final = 4  # Of a curve within `NEAR` of a target for an interval there.
MARGIN: Final = 0.02  # By how much a mechanism is beaten.
LEVEL_READ: Final = ("level", "level_low", "level_high")
VALUE: Final = ("value", "ci_low", "ci_high")
GAP: Final = ("vs_white", "vs_white_low", "vs_white_high")
COLUMNS: Final = [
    "dataset",
    "mechanism",
    "family",
    "adding",
    "robot",
    "criterion",
    "target",
    *LEVEL_READ,
    "consumer",
    "knowledge",
    "metric",
    *VALUE,
    *GAP,
    "dominated",
    "n",
]
# Levels that span more are interpolated on a log scale, as they are swept.
_LOG_SPAN: Final = 30.0


def front(x: Floats, y: Floats) -> Bools:
    """Return which points no other one beats: none is at most as large in both and less in one.

    `x` and `y` are (N,), less is better in either; a point that is not known is on no
    front.
    """
    points, place = np.unique(np.column_stack([x, y]), axis=0, return_inverse=True)
    left = np.where(np.isnan(points).any(axis=1), np.inf, points[:, 1])
    # Of points from left to right the one is on it that has less left than all before.
    found: Bools = (left < np.minimum.accumulate(np.append(np.inf, left))[:-1])[
        place.reshape(-1)
    ]
    return found


class Told(NamedTuple):
    """What is told of every mechanism: a metric, and whose it is."""

    metric: str
    whose: Mapping[str, Source]
    """By mechanism, raw among them: against each the adversary takes what is strongest there."""
    is_axis: bool = False  # Whether mechanisms are held against one another by it.


def told(
    sweeps: Sweeps, attacks: Sequence[Strongest]
) -> tuple[list[Told], dict[Key, Estimate]]:
    """Return what is told of every mechanism, and the estimates that are not those of the run.

    As shared, and after the strongest reconstruction and linker of each of `GROUPS`:
    chosen against each mechanism by itself, cross-fitted where sums over people are
    known.
    """
    found = [Told(name, dict.fromkeys(sweeps.known, AS_SHARED)) for name in DESCRIPTORS]
    crossed: dict[Key, Estimate] = {}
    every: dict[tuple[str, tuple[str, ...]], dict[str, Source]] = {}
    for attack in attacks:
        every.setdefault((attack.source.task, attack.among), {})[attack.mechanism] = (
            attack.source
        )
    for (task, _), whose in every.items():
        if RAW in whose:
            names = (success_of(sweeps.found, whose[RAW]),) if task else DESCRIPTORS
            found += [Told(name, whose, is_axis=name == names[0]) for name in names]
    for attack in attacks:
        for where in attack.wheres:
            for metric in (
                (SUCCESS, SUCCESS_OF_100) if attack.source.task else DESCRIPTORS
            ):
                if estimate := attack.at(where, metric, sweeps.found):
                    crossed[attack.source.measure(metric).at(*where)] = estimate
    return found, crossed


def frontier(
    sweeps: Sweeps,
    *,
    predictors: Sequence[str],
    dataset: str,
    world: str = "",
    sums: Mapping[Key, Summed] | None = None,
    attacks: Sequence[Strongest] | None = None,
) -> pd.DataFrame:
    """Return a row for each mechanism, robot, criterion, target and number: `COLUMNS`.

    `world` is the further horizon, if it is one, that the robots of `sweeps` are judged
    at.

    docs/metrics.md says what they are. A target out of reach keeps its row without
    numbers. There is no interval, and nothing is held against another, with fewer than
    `ENOUGH_LEVELS` levels (raw is one) whose missed rate is within `NEAR` of the
    target, with less than `MIN_DEFINED` of the replicates in reach, or of too few
    people. `attacks` are the strongest ones, by default those of `sweeps` with the
    `sums` of `strongest_on_each`.
    """
    if attacks is None:
        attacks = strongest_on_each(sweeps.found, sums or {}, sweeps.known)
    every, crossed = told(sweeps, attacks)
    sweeps = Sweeps({**sweeps.found, **crossed}, sweeps.known)
    shared = [(one, _curves(sweeps, one)) for one in every]
    rows: list[dict[str, Any]] = []
    for robot, (criterion, metric) in product(predictors, CRITERIA.items()):
        robots = dict.fromkeys(sweeps.known, Source(robot))
        own = [Told(name, robots) for name in ROBOTS_OWN]
        cost, costs = (
            Source(robot).measure(metric),
            _curves(sweeps, Told(metric, robots)),
        )
        rises = {name: np.abs(curve - curve[:, -1:]) for name, curve in costs.items()}
        reached = {
            name: places(np.array(TARGETS), rise) for name, rise in rises.items()
        }
        is_dense = {
            name: (
                (np.abs(rise[0, :, None] - TARGETS) <= NEAR).sum(axis=0)
                >= ENOUGH_LEVELS
            )
            for name, rise in rises.items()
        }
        level = {
            name: with_ends(
                LEVEL_READ, _levels(sweeps.levels(name), where), is_dense[name]
            )
            for name, where in reached.items()
        }
        axes, first = [], len(rows)
        for one, of in [*shared, *((one, _curves(sweeps, one)) for one in own)]:
            left = {
                name: interpolated(reached[name], curve, log=one.metric in DESCRIPTORS)
                for name, curve in of.items()
                if name in reached
            }
            axes += [left] * one.is_axis
            for name, values in left.items():
                measure = one.whose[name].measure(one.metric)
                _, effective = sweeps.rests_on([name], measure, cost)
                can_say = is_dense[name] & (effective >= LEAST_CLUSTERS)
                told_of = level[name] | with_ends(VALUE, values, can_say)
                if WHITE in left:
                    n_rows = min(len(values), len(left[WHITE]))
                    gap = values[:n_rows] - left[WHITE][:n_rows]
                    told_of |= with_ends(GAP, gap, can_say & is_dense[WHITE])
                about = asdict(sweeps.known[name]) | measure._asdict()
                about |= {
                    "dataset": dataset_of(
                        measure.consumer, dataset=dataset, world=world
                    )
                }
                about |= {
                    "robot": robot,
                    "criterion": criterion,
                    "n": sweeps.n(name, measure),
                }
                rows += [
                    about
                    | {"target": at}
                    | {of: values[place] for of, values in told_of.items()}
                    for place, at in enumerate(TARGETS)
                ]
        beaten = _dominated(axes, is_dense)
        for row in rows[first:]:
            row["dominated"] = beaten.get((row["mechanism"], row["target"]), pd.NA)
    return pd.DataFrame(rows, columns=COLUMNS).astype({"dominated": "boolean"})


def usual_price(every: pd.DataFrame) -> pd.DataFrame:
    """Return the rows at the price by which levels are chosen, unless another is asked for.

    That is the rise of missed conflicts that are still to come, at raw's false alarms
    and at the longest further horizon; of the run's own horizon where there is no
    other. A table without such conflicts is priced by all of them.
    """
    horizons = every["dataset"].map(
        lambda name: horizon_of(name.rpartition(":")[2]) or 0.0
    )
    rows: pd.DataFrame = every[horizons == horizons.max()]
    to_come: pd.DataFrame = rows[rows["criterion"] == FUTURE]
    is_known = bool((to_come["level"].notna() | to_come["value"].notna()).any())
    all_of_them: pd.DataFrame = rows[rows["criterion"] == AT_EQUAL_ALARMS]
    return to_come if is_known else all_of_them


def _curves(sweeps: Sweeps, one: Told) -> dict[str, Floats]:
    return sweeps.together(
        {name: of.measure(one.metric) for name, of in one.whose.items()}
    )


def _dominated(
    axes: Sequence[Mapping[str, Floats]], is_dense: Mapping[str, Bools]
) -> dict[tuple[str, float], bool]:
    """Return which mechanisms are beaten at which target, of those of which it can be said.

    Another is surely better by more than `MARGIN` on one of the axes, and this one
    surely on none (simultaneous bounds, max-t over all pairs and axes): attacked PLR,
    and whom a linker finds. `axes` are what is left by mechanism, estimate and
    replicates at all targets, (1 + B, P).
    """
    found: dict[tuple[str, float], bool] = {}
    for place, target in enumerate(TARGETS):
        dense = (name for name, is_so in is_dense.items() if is_so[place])
        known = [
            {name for name in of if np.isfinite(of[name][0, place])} for of in axes
        ]
        names = [name for name in dense if all(name in of for of in known)]
        if not names or not axes:
            continue
        n_rows = min(len(of[name]) for of in axes for name in names)
        left = np.array([[of[name][:n_rows, place] for of in axes] for name in names])
        gaps = left[:, None] - left
        gap, drawn = gaps[..., 0], gaps[..., 1:]
        error = np.nanstd(drawn, axis=-1)
        off = np.abs(drawn - gap[..., None])
        t = np.divide(
            off, error[..., None], out=np.zeros_like(off), where=error[..., None] > 0
        )
        half = np.quantile(np.nan_to_num(t).max(axis=(0, 1, 2)), CONFIDENCE) * error
        is_worse, is_better = gap - half > MARGIN, gap + half < 0.0
        beaten = (is_worse.any(axis=2) & ~is_better.any(axis=2)).any(axis=1)
        found |= {
            (name, target): bool(is_so)
            for name, is_so in zip(names, beaten, strict=True)
        }
    return found


def _levels(levels: Sequence[float | None], where: tuple[Ints, Floats]) -> Floats:
    """Return the level at some places of a curve, (R, P); NaN where only raw is beyond it.

    Raw is a level of zero where levels fall towards it on a linear scale; on all others
    none.
    """
    known = np.array(levels, dtype=float)
    is_log = bool(known.min() > 0 and known.max() > _LOG_SPAN * known.min())
    raw = 0.0 if known[0] > known[-1] and not is_log else np.nan
    every = np.broadcast_to(np.append(known, raw), (len(where[0]), known.size + 1))
    return interpolated(where, every, log=is_log)
