"""The closest attack beside the optimum, or the genie's ceiling, in worlds of the fitted motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluation.analysis.bounds import gaps
from evaluation.reporting.bounds import law_of
from evaluation.reporting.charts import Look, rows_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.rows import Results, family_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isac_track.intervals import Estimate

_CLOSEST, _OPTIMUM, _CEILING = Look(0), Look(2), Look(2, hollow=True)


def figures(run: Results) -> Iterator[Figure]:
    """Yield a panel for each model world, its levels as rows."""
    known = [one for one in gaps(run.summary) if not one.attack.task]
    panels, key = [], {"closest attack": _CLOSEST}
    for world in dict.fromkeys(one.world for one in known):
        of = [one for one in known if one.world == world]
        names = []
        for one in of:
            family = family_of(run.families, one.where[0])
            level = "" if one.where[1] is None else f":{one.where[1]:g}"
            names.append(f"{family.name}{level}{' ind.' * (family.adding == 'independent')}")
        reached: list[Estimate | None] = [one.reached for one in of]
        exact = [one.bound if one.is_exact else None for one in of]
        genie = [None if one.is_exact else one.bound for one in of]
        series = {"closest attack": (_CLOSEST, reached)}
        for name, look, values in (("optimum", _OPTIMUM, exact), ("ceiling", _CEILING, genie)):
            if any(values):
                series[name], key[name] = (look, values), look
        panels.append(
            (f"error law: {law_of(world, run)}", rows_chart(names, series, x_label="PLR (%)"))
        )
    if panels:
        title = "Attacks beside what none exceeds, in worlds of the fitted motion"
        said = "Ceiling: of a genie who is told the scale of every error; no attack need reach it."
        yield Figure("optimum", "bounds", title, panels, 2, key, said)
