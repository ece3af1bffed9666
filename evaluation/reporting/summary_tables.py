"""Tables of `summary.csv`: every level as shared, and what is left after each attack."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.families import LEVEL_UNITS, families_in
from evaluation.analysis.keys import AS_SHARED, ORACLE, Source, is_attack
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
from evaluation.reporting.rows import by_level, mechanism_columns, of_source, sources_at, telling
from evaluation.reporting.table import Cell, Column, amount, built, held, metric_column, said

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from collections.abc import Set as AbstractSet

    import pandas as pd

    from evaluation.reporting.table import Table

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
        # As shared stands beside the first.
        drawn = {Source(predictor): UTILITY} | ({} if place else {AS_SHARED: DESCRIPTORS})
        rows = others[others["consumer"].isin([one.consumer for one in drawn])]
        columns = [
            _column(one, metric, f"{METRICS[metric].head}{', shared' * (one == AS_SHARED)}")
            for one, metrics in drawn.items()
            for metric in metrics
            if (rows["metric"] == metric).any()
        ]
        name, title = (f"sweep-{place}", "") if place else ("sweep", " as shared")
        title += f", predictor {predictor}" if predictor != SHARED else ""
        notes = [] if place else [f"Levels: {SCOPE}."]
        found.append(_by_level(name, f"All levels{title}", rows, columns, notes=notes))
    return [one for one in found if one.rows]


def sources_table(summary: pd.DataFrame, *, name: str, of: Sequence[tuple[Source, str]]) -> Table:
    """Return the levels that tell, a column for each metric of some positions or a predictor."""
    known, found = families_in(summary), by_level(summary)
    records = [
        {"mechanism": mechanism, "level": at, "of": sources}
        for mechanism, at in telling(found, known, controls=False)
        if (sources := sources_at(found[mechanism, at]))
        and any(metric in sources.get(one, {}) for one, metric in of)
    ]
    columns = [_column(one, metric, f"{METRICS[metric].head}, {one.label}") for one, metric in of]
    return built(name, "", records, [*mechanism_columns(known), *columns], n_keys=3)


def _by_level(
    name: str, title: str, rows: pd.DataFrame, columns: list[Column], *, notes: list[str]
) -> Table:
    """Return a table with a row for each mechanism level."""
    records = [
        {"mechanism": mechanism, "level": at, "of": sources_at(of)}
        for (mechanism, at), of in by_level(rows).items()
    ]
    columns = [*mechanism_columns(families_in(rows)), *columns]
    title = f"{title}; 95 % intervals"
    return built(name, title, records, columns, notes=notes, n_headings=2, n_keys=3)


def _column(source: Source, metric: str, name: str) -> Column:
    """Return the column of a metric of some positions."""
    weight = _WEIGHTS.get(metric, 1.0)
    return metric_column(metric, partial(_cell, source, metric), name=name, weight=weight)


def _cell(source: Source, metric: str, level: Mapping[str, Any]) -> Cell:
    """Return the cell of a metric of some positions at a level with its rows."""
    row = level["of"].get(source, {}).get(metric)
    return amount(metric, row["value"], row["ci_low"], row["ci_high"]) if row else Cell()


def after_attack(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of descriptors as shared and after attacks; none without attacks."""
    is_attacked = is_attack(summary)
    rows = summary.assign(knowledge=summary["knowledge"].where(is_attacked, ""))
    is_shown = (is_attacked | (rows["consumer"] == SHARED)) & bool(is_attacked.any())
    return rows[is_shown & rows["metric"].isin(RECONSTRUCTION)]


def sources_of(rows: pd.DataFrame) -> list[Source]:
    """Return whose positions the rows are of, in the order of the run."""
    return list(sources_at(rows.drop_duplicates(["consumer", "knowledge"]).to_dict("records")))


def exposure_table(summary: pd.DataFrame, *, slow: AbstractSet[str] = frozenset()) -> Table:
    """Return PLR as shared and after each attack, all levels.

    Of each attack the adversary is shown that knows most, short of the oracle.

    `slow` attacks saw one release of each source track only; a note says so.
    """
    rows = after_attack(summary)
    rows = rows[rows["metric"] == EXPOSURE]
    shown = most_knowing(sources_of(rows))
    columns = []
    for source in shown:
        # The strongest keep their intervals longest.
        weight = np.inf if source == AS_SHARED else float(of_source(rows, source)["value"].mean())
        columns.append(Column(source.label, partial(_cell, source, EXPOSURE), weight=weight))
    oracle = "The oracle is a reference: it stands where nobody less can run the attack."
    notes = [oracle] * any(source.knowledge == ORACLE for source in shown)
    ran = [source.consumer for source in shown if source.consumer in slow]
    notes += [f"{name} saw only the first release of each source track." for name in ran]
    title = "After attack: PLR in % at all levels"
    return _by_level("exposure", title, rows if len(shown) > 1 else rows[:0], columns, notes=notes)


def attack_table(summary: pd.DataFrame, *, only: Source | None = None) -> Table:
    """Return what is left after every attack and adversary, at the levels that tell.

    Adversaries whose numbers are the same share a row; the control is left out where it says what
    was shared.

    With `only` of this one alone, but all levels. `summary` is as in `summary.csv`.
    """
    rows = after_attack(summary)
    known = families_in(rows)
    blocks = by_level(rows)
    title = "After attack, every adversary"
    if only is not None:
        title = "As shared" if only == AS_SHARED else f"After {only.label}"
    records = [
        {"mechanism": where[0], "level": where[1]} | row
        for where in (telling(blocks, known) if only is None else blocks)
        for row in _merged(
            {of: found for of, found in sources_at(blocks[where]).items() if only in (None, of)}
        )
    ]
    columns = [
        *mechanism_columns(known),
        *map(said, ("positions", "adversary")),
        *(
            held(METRICS[one].head, one, unit=METRICS[one].unit, weight=_WEIGHTS.get(one, 1.0))
            for one in RECONSTRUCTION
        ),
    ]
    title = f"{title}; 95 % intervals"
    return built("attacks", title, records, columns, n_headings=3, n_keys=5)


def _merged(found: Mapping[Source, Any]) -> list[dict[str, Any]]:
    """Return the rows of a level; one for adversaries whose numbers are the same."""
    cells = {
        source: {metric: _cell(source, metric, {"of": found}) for metric in RECONSTRUCTION}
        for source in found
    }
    consumers = [source.consumer for source in found]
    shared = cells.get(AS_SHARED)
    groups: dict[tuple[str, tuple[str, ...]], list[Source]] = {}
    for source, of in cells.items():
        # Only an attack has a ratio to the benchmark.
        is_same = shared and all(
            of[one].text == cell.text for one, cell in shared.items() if cell.text
        )
        if source.consumer != IDENTITY or not is_same:
            key = source.consumer, tuple(cell.full for cell in of.values())
            groups.setdefault(key, []).append(source)
    rows = []
    for sources in groups.values():
        consumer, knows = sources[0].consumer, [source.knowledge for source in sources]
        is_any = len(sources) == consumers.count(consumer) > 1
        rows.append(
            {
                "positions": "as shared" if knows == [""] else consumer,
                "adversary": "any" if is_any else ", ".join(knows),
                **cells[sources[0]],
            }
        )
    return rows
