"""Tables of `summary.csv`: every level as shared, and what is left after each attack."""

from __future__ import annotations

from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.families import LEVEL_UNITS, families_in
from evaluation.analysis.keys import AS_SHARED, ORACLE, is_attack
from evaluation.analysis.metrics import (
    DESCRIPTORS,
    EXPOSURE,
    METRICS,
    MISSED_RATE,
    RECONSTRUCTION,
    UTILITY,
)
from evaluation.analysis.strongest import most_knowing
from evaluation.experiment.presets import IDENTITY, SHARED
from evaluation.reporting.rows import (
    attacked,
    by_level,
    mechanism_columns,
    sources_at,
    telling,
)
from evaluation.reporting.table import Cell, Column, built, metric_column, metric_of, said

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from collections.abc import Set as AbstractSet

    import pandas as pd

    from evaluation.analysis.keys import Source, Where
    from evaluation.reporting.table import Made, Table

_WEIGHTS = {MISSED_RATE: 3.0, EXPOSURE: 3.0, "rmse": 2.5, "ael": 2.0, "mel": 2.0}
SCOPE = "; ".join(f"{family}: {unit}" for family, unit in LEVEL_UNITS.items())
"""What the levels are."""


def sweep_tables(summary: pd.DataFrame) -> list[Table]:
    """Return every level: descriptors as shared with the first predictor, then the others'."""
    others = summary[~is_attack(summary)]
    is_shared = others["consumer"] == SHARED
    others = others[
        others["metric"].isin(DESCRIPTORS).where(is_shared, others["metric"].isin(UTILITY))
    ]
    predictors = list(others.loc[others["consumer"] != SHARED, "consumer"].unique())
    found = []
    for place, predictor in enumerate(predictors or [SHARED]):
        drawn = {predictor} if place else {predictor, SHARED}
        one = _sweep(
            others[others["consumer"].isin(drawn)],
            name=f"sweep-{place}" if place else "sweep",
            title=("All levels" if place else "All levels as shared")
            + (f", predictor {predictor}" if predictor != SHARED else ""),
        )
        found += [one] if one.rows else []
    return found


def _sweep(rows: pd.DataFrame, *, name: str, title: str) -> Table:
    present = set(rows["metric"])
    return built(
        name,
        f"{title}; 95 % intervals",
        by_level(rows).items(),
        [
            *mechanism_columns(families_in(rows), itemgetter(0)),
            *(
                _metric(one, f"{METRICS[one].head}{', shared' * (one in DESCRIPTORS)}")
                for one in (*UTILITY, *DESCRIPTORS)
                if one in present
            ),
        ],
        notes=[f"Levels: {SCOPE}."] if name == "sweep" else [],
        n_headings=2,
        n_keys=3,
    )


def _metric(metric: str, name: str) -> Made:
    """Return the column of a metric of levels with their rows."""

    def cell(record: tuple[Where, Sequence[Mapping[str, Any]]]) -> Cell:
        return next((metric_of(row) for row in record[1] if row["metric"] == metric), Cell())

    return metric_column(metric, name, weight=_WEIGHTS.get(metric, 1.0)), cell


def after_attack(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of descriptors as shared and after attacks; none without attacks."""
    is_attacked = is_attack(summary)
    rows = summary[(is_attacked | (summary["consumer"] == SHARED)) & bool(is_attacked.any())]
    return attacked(rows[rows["metric"].isin(RECONSTRUCTION)])


def sources_of(rows: pd.DataFrame) -> list[Source]:
    """Return whose positions the rows are of, in the order of the run."""
    return list(sources_at(rows.drop_duplicates(["consumer", "knowledge"]).to_dict("records")))


def exposure_table(summary: pd.DataFrame, *, slow: AbstractSet[str] = frozenset()) -> Table:
    """Return PLR as shared and after each attack, all levels.

    Of each attack the adversary is shown that knows most, short of the oracle.

    Parameters
    ----------
    summary : DataFrame
        As in `summary.csv`.
    slow : set of str
        Attacks that saw one release of each source track only; a note says so.
    """
    rows = after_attack(summary)
    rows = rows[rows["metric"] == EXPOSURE]
    shown = most_knowing(sources_of(rows))
    # The strongest keep their intervals longest.
    means = {
        source: rows.loc[
            (rows["consumer"] == source.consumer) & (rows["knowledge"] == source.knowledge), "value"
        ].mean()
        for source in shown
    }
    columns = [
        (
            Column(source.label, weight=np.inf if source == AS_SHARED else float(means[source])),
            partial(_of_source, source),
        )
        for source in shown
    ]
    notes = []
    if any(source.knowledge == ORACLE for source in shown):
        notes.append("The oracle is a reference: it stands where nobody less can run the attack.")
    notes += [
        f"{source.consumer} saw only the first release of each source track."
        for source in shown
        if source.consumer in slow
    ]
    return built(
        "exposure",
        "After attack: PLR in % at all levels; 95 % intervals",
        by_level(rows).items() if len(shown) > 1 else (),
        [*mechanism_columns(families_in(rows), itemgetter(0)), *columns],
        notes=notes,
        n_headings=2,
        n_keys=3,
    )


def _of_source(source: Source, record: tuple[Where, Sequence[Mapping[str, Any]]]) -> Cell:
    found = sources_at(record[1]).get(source)
    return metric_of(found[EXPOSURE]) if found else Cell()


def attack_table(summary: pd.DataFrame, *, only: Source | None = None) -> Table:
    """Return what is left after every attack and adversary, at the levels that tell.

    Adversaries whose numbers are the same share a row; the control is left out where it says what
    was shared.

    Parameters
    ----------
    summary : DataFrame
        As in `summary.csv`.
    only : Source, optional
        Of this one alone, but all levels.
    """
    rows = after_attack(summary)
    known = families_in(rows)
    blocks = by_level(rows)
    title = "After attack, every adversary; 95 % intervals"
    if only is not None:
        title = f"{'As shared' if only == AS_SHARED else f'After {only.label}'}; 95 % intervals"
    records = []
    for where in telling(blocks, known) if only is None else blocks:
        found = sources_at(blocks[where])
        if only is not None:
            found = {source: found[source] for source in found if source == only}
        records += [(where, *row) for row in _merged(found)]
    return built(
        "attacks",
        title,
        records,
        [
            *mechanism_columns(known, itemgetter(0)),
            said("positions", itemgetter(1)),
            said("adversary", itemgetter(2)),
            *(
                (metric_column(one, weight=_WEIGHTS.get(one, 1.0)), lambda of, n=n: of[3][n])
                for n, one in enumerate(RECONSTRUCTION)
            ),
        ],
        n_headings=3,
        n_keys=5,
    )


def _merged(
    found: Mapping[Source, Mapping[str, Mapping[str, Any]]],
) -> list[tuple[str, str, tuple[Cell, ...]]]:
    """Return the rows of a level; one for adversaries whose numbers are the same."""
    shared = _amounts(found.get(AS_SHARED, {}))
    groups: dict[tuple[str, tuple[str, ...]], tuple[list[str], tuple[Cell, ...]]] = {}
    adversaries: dict[str, int] = {}
    for source, metrics in found.items():
        adversaries[source.consumer] = adversaries.get(source.consumer, 0) + 1
        cells = _amounts(metrics)
        if source.consumer == IDENTITY and AS_SHARED in found and _same(cells, shared):
            continue
        key = source.consumer, tuple(cell.full for cell in cells)
        groups.setdefault(key, ([], cells))[0].append(source.knowledge)
    return [
        (
            "as shared" if knows == [""] else consumer,
            "any" if len(knows) == adversaries[consumer] > 1 else ", ".join(knows),
            cells,
        )
        for (consumer, _), (knows, cells) in groups.items()
    ]


def _amounts(metrics: Mapping[str, Mapping[str, Any]]) -> tuple[Cell, ...]:
    return tuple(metric_of(metrics[one]) if one in metrics else Cell() for one in RECONSTRUCTION)


def _same(cells: Iterable[Cell], shared: Iterable[Cell]) -> bool:
    """Whether the descriptors agree; only an attack has a ratio to the benchmark."""
    pairs = zip(cells, shared, strict=True)
    return all(not one.text or one.text == cell.text for cell, one in pairs)
