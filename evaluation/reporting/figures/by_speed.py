"""Whom a slow walk exposes: PLR after attack over net speed, a curve for each level."""

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
import pandas as pd

from evaluation.analysis.families import ADDING_RULES, RAW
from evaluation.analysis.keys import Source, Where, where_text
from evaluation.reporting.charts import LOOKS, PERCENT, Axis, Chart, Curve, Look, curves_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.rows import ENDS, Results, family_of
from isac_track.intervals import LEAST_CLUSTERS

_SAID: Final = (
    "Net speed: the way from the first to the last true position, over the duration. Raw, fid and "
    "fixed after the run's strongest attack, another mechanism after the strongest on it. A bin of "
    f"fewer than {LEAST_CLUSTERS:.0f} people has no interval."
)


def figures(run: Results) -> Iterator[Figure]:
    """Yield a panel for each adding rule, of the levels that the run has attacked."""
    curves = _by_level(run.speeds[run.speeds["knowledge"].fillna("") != ""])
    key = _looks(run, curves)
    panels = list[tuple[str, Chart]]()
    for rule in ADDING_RULES:
        under = [where for where in curves if rule in family_of(run.families, where[0]).rules]
        drawn = [
            _curve(key[_name(run, where)], _name(run, where), curves[where]) for where in under
        ]
        if drawn:
            x, y = Axis("net speed (m/s)"), Axis("PLR after attack (%)")
            panels.append((f"{rule} adding", curves_chart(drawn, x=x, y=y)))
    title = "PLR after attack over net speed"
    yield Figure("by_speed", "after", title, panels, len(ADDING_RULES), key, _SAID)


def _by_level(rows: pd.DataFrame) -> dict[Where, pd.DataFrame]:
    """Return the rows of each level."""
    levels = rows["level"].astype(object).where(rows["level"].notna(), None)
    wheres = list(zip(rows["mechanism"], levels, strict=True))
    places: dict[Where, list[int]] = {}
    for place, where in enumerate(wheres):
        places.setdefault(where, []).append(place)
    return {where: rows.iloc[some] for where, some in places.items()}


def _looks(run: Results, wheres: Iterable[Where]) -> dict[str, Look]:
    """Return what each level looks like under either rule: raw is a star, as everywhere."""
    names = dict.fromkeys(_name(run, where) for where in wheres if where[0] != RAW)
    looks = {RAW: Look(LOOKS - 1)} if (RAW, None) in wheres else {}
    return looks | {name: Look(place % (LOOKS - 1)) for place, name in enumerate(names)}


def _name(run: Results, where: Where) -> str:
    return where_text(family_of(run.families, where[0]).name, where[1])


def _curve(look: Look, name: str, rows: pd.DataFrame) -> Curve:
    """Return a level over the mean speed of each bin; its name tells both ends."""
    rows = rows.sort_values("speed_mps")
    x, values = rows["speed_mps"].to_numpy(), PERCENT * rows[ENDS].to_numpy(dtype=np.float64).T
    said = [f"{values[0, n]:.1f} % at {x[n]:.2f} m/s" for n in (0, -1)]
    attack = Source(str(rows["consumer"].iloc[0]), str(rows["knowledge"].iloc[0])).label
    ends = " to ".join(dict.fromkeys(said))
    return Curve(look, f"{name} after {attack}: {ends}", x, values)
