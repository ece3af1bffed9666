"""People who come back: rank 1 of linkers and control by level, and guessing."""

from collections.abc import Iterator
from typing import Final

from evaluation.compute.return_columns import STRONGEST
from evaluation.estimates.metrics import RANK1
from evaluation.plan.consumer import FUSION
from evaluation.reporting.charts import LOOKS, Look, rows_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import find_family
from evaluation.reporting.names import (
    INDEPENDENT_MARK,
    INDEPENDENT_NOTE,
    short_mechanism_name,
)
from evaluation.reporting.return_tables import (
    find_number,
    linkers,
    return_levels,
    return_numbers,
)
from evaluation.reporting.return_words import return_sentence
from evaluation.reporting.rows import Results

_CONTROL: Final = "strongest control"


def figures(run: Results) -> Iterator[Figure]:
    """Yield rank 1 by level: a mark for each linker, the fusion and the control."""
    numbers = return_numbers(run)
    levels = return_levels(numbers)
    if not levels:
        return
    shown = {name: name for name in linkers(numbers)} | {_CONTROL: STRONGEST}
    looks = {name: Look(place % LOOKS) for place, name in enumerate(shown)}
    series = {
        name: (
            looks[name],
            [find_number(numbers, where, plugin, RANK1) for where in levels],
        )
        for name, plugin in shown.items()
    }
    rows = [
        short_mechanism_name(find_family(run.families, where.mechanism), where.level)
        for where in levels
    ]
    is_marked = any(row.endswith(INDEPENDENT_MARK) for row in rows)
    note = "Dashed: guessing. Bars are 95 % intervals over people."
    chance = find_number(numbers, levels[0], FUSION, "chance")
    guides = [(looks[FUSION], chance.value)] if chance else []
    chart = rows_chart(rows, series, x_label="named first (%)", guides=guides)
    yield Figure(
        name="returns",
        section="returns",
        title="People who come back, named first in another run",
        panels=[("all passages of other runs enrolled", chart)],
        columns=1,
        key=looks,
        caption=return_sentence(run),
        note=f"{note} {INDEPENDENT_NOTE}" if is_marked else note,
    )
