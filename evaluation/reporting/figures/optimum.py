"""The closest attack beside the optimum or the genie's ceiling, in model worlds."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

from evaluation.estimates.bounds import ClosestAttack
from evaluation.reporting.amounts import PERCENT
from evaluation.reporting.bounds import world_error_law
from evaluation.reporting.charts import Look, rows_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import find_family
from evaluation.reporting.names import short_mechanism_name
from evaluation.reporting.rows import Results

if TYPE_CHECKING:
    from isac_track.intervals import Estimate

_CLOSEST: Final = Look(0)
_OPTIMUM: Final = Look(2)
_CEILING: Final = Look(2, hollow=True)


def figures(run: Results) -> Iterator[Figure]:
    """Yield a panel for each model world, its levels as rows."""
    gaps = [gap for gap in run.headline.gaps if not gap.attack.task]
    panels, key = [], dict[str, Look]()
    for world in dict.fromkeys(gap.world for gap in gaps):
        own = [gap for gap in gaps if gap.world == world]
        marks: dict[str, tuple[Look, Sequence[Estimate | None]]] = {
            "closest attack": (_CLOSEST, [gap.reached for gap in own]),
            "optimum": (_OPTIMUM, [gap.bound if gap.is_exact else None for gap in own]),
            "ceiling": (_CEILING, [None if gap.is_exact else gap.bound for gap in own]),
        }
        series = {name: drawn for name, drawn in marks.items() if any(drawn[1])}
        key |= {name: look for name, (look, _) in series.items()}
        names = [_level(run, gap) for gap in own]
        chart = rows_chart(names, series, x_label="PLR (%)")
        panels.append((f"error law: {world_error_law(world, run)}", chart))
    yield Figure(
        name="optimum",
        section="bounds",
        title="The closest attack beside the optimum, in model worlds",
        panels=panels,
        columns=2,
        key=key,
        caption=_caption(gaps),
        note=(
            "Ceiling: it also knows the scale of every error; attacks need not"
            " reach it."
        ),
    )


def _level(run: Results, gap: ClosestAttack) -> str:
    """Return the plain name of the level of a gap."""
    return short_mechanism_name(
        find_family(run.families, gap.mechanism_level.mechanism),
        gap.mechanism_level.level,
    )


def _caption(gaps: Sequence[ClosestAttack]) -> str:
    """Tell how far the closest attack stays below the optimum, at the worst level."""
    exact = [PERCENT * gap.gap.value for gap in gaps if gap.is_exact]
    if exact:
        return (
            f"The closest attack stays at most {max(exact):.1f} points of PLR below the"
            " optimum."
        )
    bounded = [PERCENT * gap.gap.value for gap in gaps]
    if not bounded:
        return ""
    return (
        f"The closest attack stays at most {max(bounded):.1f} points of PLR below the"
        " ceiling."
    )
