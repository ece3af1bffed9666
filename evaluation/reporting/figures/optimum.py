"""The closest attack beside the optimum, or the genie's ceiling, in worlds of the fitted motion."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from evaluation.estimates.bounds import Gap
from evaluation.reporting.bounds import law_of
from evaluation.reporting.charts import PERCENT, Look, rows_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import family_of
from evaluation.reporting.names import short_mechanism_name
from evaluation.reporting.rows import Results
from isac_track.intervals import Estimate

_MARKS: Final[dict[str, tuple[Look, Callable[[Gap], Estimate | None]]]] = {
    "closest attack": (Look(0), lambda one: one.reached),
    "optimum": (Look(2), lambda one: one.bound if one.is_exact else None),
    "ceiling": (Look(2, hollow=True), lambda one: None if one.is_exact else one.bound),
}


def figures(run: Results) -> Iterator[Figure]:
    """Yield a panel for each model world, its levels as rows."""
    known = [one for one in run.headline.gaps if not one.attack.task]
    panels, key = [], dict[str, Look]()
    for world in dict.fromkeys(one.world for one in known):
        of = [one for one in known if one.world == world]
        every = {
            name: (look, [take(one) for one in of])
            for name, (look, take) in _MARKS.items()
        }
        series = {name: drawn for name, drawn in every.items() if any(drawn[1])}
        key |= {name: look for name, (look, _) in series.items()}
        names = [_level(run, gap) for gap in of]
        chart = rows_chart(names, series, x_label="PLR (%)")
        panels.append((f"error law: {law_of(world, run)}", chart))
    yield Figure(
        name="optimum",
        section="bounds",
        title="The closest attack beside the optimum, in model worlds",
        panels=panels,
        columns=2,
        key=key,
        caption=_caption(known),
        note=(
            "Ceiling: it also knows the scale of every error; attacks need not"
            " reach it."
        ),
    )


def _level(run: Results, gap: Gap) -> str:
    """Return the plain name of the level of a gap."""
    return short_mechanism_name(family_of(run.families, gap.where[0]), gap.where[1])


def _caption(known: Sequence[Gap]) -> str:
    """Return how far the closest attack stays below the optimum, at the worst level."""
    exact = [PERCENT * gap.gap.value for gap in known if gap.is_exact]
    if exact:
        return (
            f"The closest attack stays at most {max(exact):.1f} points of PLR below the"
            " optimum."
        )
    bounded = [PERCENT * gap.gap.value for gap in known]
    if not bounded:
        return ""
    return (
        f"The closest attack stays at most {max(bounded):.1f} points of PLR below the"
        " ceiling."
    )
