"""The closest attack beside the optimum, or the genie's ceiling, in worlds of the fitted motion."""

from collections.abc import Callable, Iterator
from typing import Final

from evaluation.analysis.bounds import Gap, gaps
from evaluation.reporting.bounds import law_of
from evaluation.reporting.charts import Look, rows_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.rows import Results, short_name
from isac_track.intervals import Estimate

_MARKS: Final[dict[str, tuple[Look, Callable[[Gap], Estimate | None]]]] = {
    "closest attack": (Look(0), lambda one: one.reached),
    "optimum": (Look(2), lambda one: one.bound if one.is_exact else None),
    "ceiling": (Look(2, hollow=True), lambda one: None if one.is_exact else one.bound),
}


def figures(run: Results) -> Iterator[Figure]:
    """Yield a panel for each model world, its levels as rows."""
    known = [one for one in gaps(run.summary) if not one.attack.task]
    panels, key = [], dict[str, Look]()
    for world in dict.fromkeys(one.world for one in known):
        of = [one for one in known if one.world == world]
        every = {name: (look, [take(one) for one in of]) for name, (look, take) in _MARKS.items()}
        series = {name: drawn for name, drawn in every.items() if any(drawn[1])}
        key |= {name: look for name, (look, _) in series.items()}
        names = [short_name(run.families, one.where) for one in of]
        chart = rows_chart(names, series, x_label="PLR (%)")
        panels.append((f"error law: {law_of(world, run)}", chart))
    title = "Attacks beside what none exceeds, in worlds of the fitted motion"
    said = "Ceiling: of a genie who is told the scale of every error; no attack need reach it."
    yield Figure("optimum", "bounds", title, panels, 2, key, said)
