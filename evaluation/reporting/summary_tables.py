"""Tables of `summary.csv`: every level as shared, and what is left after each attack."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.families import families_in
from evaluation.analysis.keys import AS_SHARED, ORACLE
from evaluation.analysis.levels import LEVEL_UNITS, is_attack, most_knowing
from evaluation.analysis.metrics import (
    DESCRIPTORS,
    EXPOSURE,
    METRICS,
    MISSED_RATE,
    RECONSTRUCTION,
    UTILITY,
)
from evaluation.experiment.presets import IDENTITY, SHARED
from evaluation.reporting.rows import (
    MECHANISM,
    attacked,
    by_level,
    family_of,
    mechanism_cells,
    sources_at,
    telling,
)
from evaluation.reporting.table import (
    Cell,
    Column,
    metric_column,
    metric_of,
    table,
    word,
    words,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from collections.abc import Set as AbstractSet

    import pandas as pd

    from evaluation.analysis.keys import Source
    from evaluation.reporting.table import Table

_WEIGHTS = {MISSED_RATE: 3.0, EXPOSURE: 3.0, "rmse": 2.5, "ael": 2.0, "mel": 2.0}
_EMPTY = Cell()
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
    metrics = [one for one in (*UTILITY, *DESCRIPTORS) if (rows["metric"] == one).any()]
    known = families_in(rows)
    columns = [
        metric_column(
            one,
            f"{METRICS[one].head}, shared" if one in DESCRIPTORS else "",
            weight=_WEIGHTS.get(one, 1.0),
        )
        for one in metrics
    ]
    cells = []
    for (mechanism, at), block in by_level(rows).items():
        by_metric = {row["metric"]: metric_of(row) for row in block}
        cells.append(
            [
                *mechanism_cells(family_of(known, mechanism), at),
                *(by_metric.get(one, _EMPTY) for one in metrics),
            ]
        )
    return table(
        name,
        f"{title}; 95 % intervals",
        [*MECHANISM, *columns],
        cells,
        notes=[f"Levels: {SCOPE}."] if name == "sweep" else [],
        n_headings=2,
        n_keys=3,
    )


def after_attack(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of descriptors as shared and after attacks; none without attacks."""
    is_attacked = is_attack(summary)
    rows = summary[(is_attacked | (summary["consumer"] == SHARED)) & is_attacked.any()]
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
    known = families_in(rows)
    shown = most_knowing(sources_of(rows))
    # The strongest keep their intervals longest.
    means = {
        source: rows.loc[
            (rows["consumer"] == source.consumer) & (rows["knowledge"] == source.knowledge), "value"
        ].mean()
        for source in shown
    }
    columns = [
        Column(source.label, weight=np.inf if source == AS_SHARED else float(means[source]))
        for source in shown
    ]
    cells = []
    for (mechanism, at), block in by_level(rows).items():
        found = {
            source: metric_of(metrics[EXPOSURE]) for source, metrics in sources_at(block).items()
        }
        cells.append(
            [
                *mechanism_cells(family_of(known, mechanism), at),
                *(found.get(source, _EMPTY) for source in shown),
            ]
        )
    notes = []
    if any(source.knowledge == ORACLE for source in shown):
        notes.append("The oracle is a reference: it stands where nobody less can run the attack.")
    notes += [
        f"{source.consumer} saw only the first release of each source track."
        for source in shown
        if source.consumer in slow
    ]
    return table(
        "exposure",
        "After attack: PLR in % at all levels; 95 % intervals",
        [*MECHANISM, *columns],
        cells if len(shown) > 1 else [],
        notes=notes,
        n_headings=2,
        n_keys=3,
    )


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
    cells = []
    for where in telling(blocks, known) if only is None else blocks:
        found = sources_at(blocks[where])
        if only is not None:
            found = {source: found[source] for source in found if source == only}
        cells += [
            [*mechanism_cells(family_of(known, where[0]), where[1]), *of] for of in _merged(found)
        ]
    return table(
        "attacks",
        title,
        [
            *MECHANISM,
            *words("positions", "adversary"),
            *(metric_column(one, weight=_WEIGHTS.get(one, 1.0)) for one in RECONSTRUCTION),
        ],
        cells,
        n_headings=3,
        n_keys=5,
    )


def _merged(found: Mapping[Source, Mapping[str, Mapping[str, Any]]]) -> list[list[Cell]]:
    """Return the rows of a level; one for adversaries whose numbers are the same."""
    shared = _amounts(found.get(AS_SHARED, {}))
    groups: dict[tuple[str, tuple[str, ...]], tuple[list[str], tuple[Cell, ...]]] = {}
    adversaries: dict[str, int] = {}
    for source, metrics in found.items():
        adversaries[source.consumer] = adversaries.get(source.consumer, 0) + 1
        cells = _amounts(metrics)
        if source.consumer == IDENTITY and _same(cells, shared):
            continue
        key = source.consumer, tuple(cell.full for cell in cells)
        groups.setdefault(key, ([], cells))[0].append(source.knowledge)
    rows = []
    for (consumer, _), (knows, cells) in groups.items():
        is_any = len(knows) == adversaries[consumer] > 1
        rows.append(
            [
                word("as shared" if knows == [""] else consumer),
                word("any" if is_any else ", ".join(knows)),
                *cells,
            ]
        )
    return rows


def _amounts(metrics: Mapping[str, Mapping[str, Any]]) -> tuple[Cell, ...]:
    return tuple(metric_of(metrics[one]) if one in metrics else _EMPTY for one in RECONSTRUCTION)


def _same(cells: Iterable[Cell], shared: Iterable[Cell]) -> bool:
    """Whether the descriptors agree; only an attack has a ratio to the benchmark."""
    pairs = zip(cells, shared, strict=True)
    return all(not one.text or one.text == cell.text for cell, one in pairs)
