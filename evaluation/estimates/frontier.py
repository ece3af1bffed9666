"""Privacy at a price: mechanisms at fixed rises of missed conflicts, `frontier.csv`.

The table has the descriptors as shared and after the strongest reconstruction of every
adversary that was run, and rank 1 of the strongest linker of each task. Beside them are
the robot's own MAE and PLR.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import RAW
from evaluation.estimates.interpolation import (
    CurvePositions,
    has_interval,
    interpolated,
    positions_at_change,
    with_ends,
)
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    RANK1,
    RANK1_AMONG_100,
    ROBOTS_OWN,
)
from evaluation.estimates.recordings import in_run
from evaluation.estimates.strongest import success_metric
from evaluation.estimates.strongest_table import StrongestAttack, strongest_attacks
from evaluation.estimates.sweeps import AT_EQUAL_ALARMS, CRITERIA, FUTURE, Sweeps
from evaluation.plan.address import AS_SHARED, Address, parse_consumer, parse_dataset
from evaluation.plan.world import OWN_WORLD, World
from evaluation.store.linkage_outcomes import ClusterSums
from isac_track.intervals import CONFIDENCE, LEAST_CLUSTERS, Estimate
from isac_track.types import Bools, Floats

TARGETS: Final = (0.03, 0.05, 0.075, 0.1)  # Rises over raw, fixed beforehand.
# White noise: other mechanisms are compared with it.
WHITE_NOISE: Final = "fixed:adding=independent,law=isotropic"
NEAR: Final = 0.03 + 1e-9  # The second term allows for rounding.
ENOUGH_LEVELS: Final = 4  # Levels within `NEAR` of a target for an interval there.
MARGIN: Final = 0.02  # Difference by which a mechanism is beaten.
LEVEL_READ: Final = ("level", "level_low", "level_high")
VALUE: Final = ("value", "ci_low", "ci_high")
VS_WHITE: Final = ("vs_white", "vs_white_low", "vs_white_high")
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
    *VS_WHITE,
    "dominated",
    "n",
]
# Levels that span more are interpolated on a log scale, as they are swept.
_LOG_SPAN: Final = 30.0


class Quantity(NamedTuple):
    """A number that the frontier shows of every mechanism: a metric of some reader."""

    metric: str
    reader_by_mechanism: Mapping[str, Address]
    """Reader by mechanism, raw included: the strongest attack against each."""
    is_axis: bool = False  # Whether mechanisms are held against one another by it.


def frontier_quantities(
    sweeps: Sweeps, attacks: Sequence[StrongestAttack]
) -> tuple[list[Quantity], dict[Address, Estimate]]:
    """Return the quantities of every mechanism, and cross-fitted estimates of attacks.

    Descriptors are as shared and after the strongest reconstruction of each of
    `GROUPS`; success is that of the strongest linker. The attack is chosen against each
    mechanism by itself, cross-fitted where sums over people are known.
    """
    as_shared = dict.fromkeys(sweeps.families, AS_SHARED)
    quantities = [Quantity(name, as_shared) for name in DESCRIPTORS]
    readers: dict[tuple[str, tuple[str, ...]], dict[str, Address]] = {}
    for attack in attacks:
        group = attack.reader.task, attack.among
        readers.setdefault(group, {})[attack.mechanism] = attack.reader
    for (task, _), reader_by_mechanism in readers.items():
        if RAW not in reader_by_mechanism:
            continue
        metrics = DESCRIPTORS
        if task:
            metrics = (success_metric(sweeps.estimates, reader_by_mechanism[RAW]),)
        quantities += [
            Quantity(metric, reader_by_mechanism, is_axis=metric == metrics[0])
            for metric in metrics
        ]
    crossed: dict[Address, Estimate] = {}
    for attack in attacks:
        metrics = (RANK1, RANK1_AMONG_100) if attack.reader.task else DESCRIPTORS
        for where, metric in product(attack.levels, metrics):
            if estimate := attack.at(where, metric, sweeps.estimates):
                crossed[attack.reader.at(*where, metric)] = estimate
    return quantities, crossed


def frontier(
    sweeps: Sweeps,
    *,
    predictors: Sequence[str],
    dataset: str,
    world: World = OWN_WORLD,
    sums: Mapping[Address, ClusterSums] | None = None,
    attacks: Sequence[StrongestAttack] | None = None,
) -> pd.DataFrame:
    """Return a row for each mechanism, robot, criterion, target and number: `COLUMNS`.

    `world` is the further horizon, if any, at which the robots of `sweeps` are judged.
    docs/reference/metrics.md explains the numbers. A target out of reach keeps its row
    without numbers. In three cases there is no interval, and no mechanism is held
    against another: fewer than `ENOUGH_LEVELS` levels (raw is one of them) have a
    missed rate within `NEAR` of the target; less than `MIN_DEFINED` of the replicates
    are in reach; or there are too few people. `attacks` are the strongest, by
    default those of `sweeps` with the `sums` of `strongest_attacks`.
    """
    if attacks is None:
        attacks = strongest_attacks(sweeps.estimates, sums or {}, sweeps.families)
    quantities, crossed = frontier_quantities(sweeps, attacks)
    sweeps = Sweeps({**sweeps.estimates, **crossed}, sweeps.families)
    shared = [(quantity, _curves(sweeps, quantity)) for quantity in quantities]
    rows: list[dict[str, Any]] = []
    locate = partial(in_run, dataset=dataset, world=world)
    for robot, (criterion, metric) in product(predictors, CRITERIA.items()):
        price = _price(sweeps, robot, metric)
        robots = dict.fromkeys(sweeps.families, parse_consumer(robot))
        own = [Quantity(name, robots) for name in ROBOTS_OWN]
        axes, robot_rows = list[_Axis](), []
        for quantity, curves in [
            *shared,
            *((quantity, _curves(sweeps, quantity)) for quantity in own),
        ]:
            log = quantity.metric in DESCRIPTORS
            values_by_mechanism = {
                name: interpolated(price.reached[name], curve, log=log)
                for name, curve in curves.items()
                if name in price.reached
            }
            if quantity.is_axis:
                axes.append(_axis(sweeps, price, quantity, values_by_mechanism))
            robot_rows += [
                {
                    **row,
                    "robot": robot,
                    "criterion": criterion,
                }
                for row in _rows(sweeps, price, quantity, values_by_mechanism, locate)
            ]
        beaten = _surely_beaten(axes)
        for row in robot_rows:
            row["dominated"] = beaten.get((row["mechanism"], row["target"]), pd.NA)
        rows += robot_rows
    return pd.DataFrame(rows, columns=COLUMNS).astype({"dominated": "boolean"})


@dataclass(frozen=True, eq=False, slots=True)
class _Price:
    """Mechanisms where a robot's missed rate has risen by the targets, (P,)."""

    cost: Address
    reached: Mapping[str, CurvePositions]  # Position on the curve, (1 + B, P) each.
    is_dense: Mapping[str, Bools]  # (P,) whether enough levels are near the target
    level: Mapping[str, Mapping[str, Floats]]  # (P,) columns `LEVEL_READ`


def _price(sweeps: Sweeps, robot: str, metric: str) -> _Price:
    robots = dict.fromkeys(sweeps.families, parse_consumer(robot))
    costs = _curves(sweeps, Quantity(metric, robots))
    rises = {name: np.abs(curve - curve[:, -1:]) for name, curve in costs.items()}
    targets = np.array(TARGETS)
    reached = {name: positions_at_change(targets, rise) for name, rise in rises.items()}
    is_dense = {
        name: (np.abs(rise[0, :, None] - targets) <= NEAR).sum(axis=0) >= ENOUGH_LEVELS
        for name, rise in rises.items()
    }
    cost = parse_consumer(robot).measured(metric)
    level = {}
    for name, position in reached.items():
        _, effective = sweeps.rests_on([name], cost)
        can_say = is_dense[name] & (effective >= LEAST_CLUSTERS)
        values = _levels(sweeps.levels(name), position)
        level[name] = with_ends(LEVEL_READ, values, can_say)
    return _Price(cost, reached, is_dense, level)


def _rows(
    sweeps: Sweeps,
    price: _Price,
    quantity: Quantity,
    values_by_mechanism: Mapping[str, Floats],
    locate: Callable[[Address], Address],
) -> Iterator[dict[str, Any]]:
    """Yield the rows of a quantity at a price: every mechanism at every target.

    `values_by_mechanism`, (1 + B, P), are those of the quantity; `locate` gives an
    address its recording and world.
    """
    for name in values_by_mechanism:
        measure = quantity.reader_by_mechanism[name].measured(quantity.metric)
        about = {
            **locate(measure).to_columns(),
            **asdict(sweeps.families[name]),
            "n": sweeps.n(name, measure),
        }
        columns = _columns(sweeps, price, measure, values_by_mechanism, name=name)
        for place, target in enumerate(TARGETS):
            numbers = {column: values[place] for column, values in columns.items()}
            yield {**about, "target": target, **numbers}


def _columns(
    sweeps: Sweeps,
    price: _Price,
    measure: Address,
    values_by_mechanism: Mapping[str, Floats],
    *,
    name: str,
) -> dict[str, Floats]:
    """Return the columns of a mechanism at a price, (P,) each: level, value and gap."""
    values = values_by_mechanism[name]
    can_say = _can_say(sweeps, price, measure, name=name)
    columns = {**price.level[name], **with_ends(VALUE, values, can_say)}
    white = values_by_mechanism.get(WHITE_NOISE)
    if white is not None:
        n_rows = min(len(values), len(white))
        gap = values[:n_rows] - white[:n_rows]
        columns |= with_ends(VS_WHITE, gap, can_say & price.is_dense[WHITE_NOISE])
    return columns


def usual_price(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows at the usual price, by which levels are chosen.

    The price is the rise of missed conflicts that are still to come, at raw's false
    alarms and at the longest further horizon, or at the run's own horizon if there is
    no other. A table without such conflicts is priced by all conflicts.
    """
    horizons = table["dataset"].map(
        lambda name: parse_dataset(name).world.horizon_s or 0.0
    )
    rows: pd.DataFrame = table[horizons == horizons.max()]
    to_come: pd.DataFrame = rows[rows["criterion"] == FUTURE]
    is_known = bool((to_come["level"].notna() | to_come["value"].notna()).any())
    all_of_them: pd.DataFrame = rows[rows["criterion"] == AT_EQUAL_ALARMS]
    return to_come if is_known else all_of_them


def _curves(sweeps: Sweeps, quantity: Quantity) -> dict[str, Floats]:
    return sweeps.together(
        {
            name: reader.measured(quantity.metric)
            for name, reader in quantity.reader_by_mechanism.items()
        }
    )


def _can_say(sweeps: Sweeps, price: _Price, measure: Address, *, name: str) -> Bools:
    """Return at which targets a mechanism has levels and people enough, (P,)."""
    _, effective = sweeps.rests_on([name], measure, price.cost)
    return price.is_dense[name] & (effective >= LEAST_CLUSTERS)


@dataclass(frozen=True, eq=False, slots=True)
class _Axis:
    """A number by which mechanisms are held against one another at a price."""

    values: Mapping[str, Floats]  # (1 + B, P) estimate and replicates at the targets
    can_say: Mapping[str, Bools]  # (P,) whether the number has an interval there


def _axis(
    sweeps: Sweeps, price: _Price, quantity: Quantity, values: Mapping[str, Floats]
) -> _Axis:
    can_say = {
        name: _can_say(
            sweeps,
            price,
            quantity.reader_by_mechanism[name].measured(quantity.metric),
            name=name,
        )
        & has_interval(numbers)
        for name, numbers in values.items()
    }
    return _Axis(values, can_say)


def _surely_beaten(axes: Sequence[_Axis]) -> dict[tuple[str, float], bool]:
    """Return whether a mechanism is beaten at a target, where that can be decided.

    A mechanism is beaten if another is surely better by more than `MARGIN` on some axis
    (attacked PLR, or rank 1 of a linker), and it is surely better on none. The bounds
    are simultaneous (max-t over all pairs and axes). Only mechanisms that have an
    interval on every axis are compared.
    """
    is_beaten: dict[tuple[str, float], bool] = {}
    if not axes:
        return is_beaten
    for place, target in enumerate(TARGETS):
        names = [
            name
            for name in axes[0].values
            if all(name in axis.values and axis.can_say[name][place] for axis in axes)
        ]
        if not names:
            continue
        n_rows = min(len(axis.values[name]) for axis in axes for name in names)
        at_target = np.array(
            [[axis.values[name][:n_rows, place] for axis in axes] for name in names]
        )
        gaps = at_target[:, None] - at_target
        gap, drawn = gaps[..., 0], gaps[..., 1:]
        error = np.nanstd(drawn, axis=-1)
        deviation = np.abs(drawn - gap[..., None])
        t = np.divide(
            deviation,
            error[..., None],
            out=np.zeros_like(deviation),
            where=error[..., None] > 0,
        )
        half = np.quantile(np.nan_to_num(t).max(axis=(0, 1, 2)), CONFIDENCE) * error
        is_worse, is_better = gap - half > MARGIN, gap + half < 0.0
        beaten = (is_worse.any(axis=2) & ~is_better.any(axis=2)).any(axis=1)
        is_beaten |= {
            (name, target): bool(is_so)
            for name, is_so in zip(names, beaten, strict=True)
        }
    return is_beaten


def _levels(levels: Sequence[float | None], position: CurvePositions) -> Floats:
    """Return the level at positions on a curve, (R, P); NaN where only raw is beyond.

    Raw counts as a level of zero where levels fall towards it on a linear scale; on
    other scales it has no level.
    """
    scale = np.array(levels, dtype=float)
    is_log = bool(scale.min() > 0 and scale.max() > _LOG_SPAN * scale.min())
    raw = 0.0 if scale[0] > scale[-1] and not is_log else np.nan
    rows = np.broadcast_to(np.append(scale, raw), (len(position.right), scale.size + 1))
    return interpolated(position, rows, log=is_log)
