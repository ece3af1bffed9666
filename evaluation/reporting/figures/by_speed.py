"""PLR after attack over net speed, a curve for each level."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

import numpy as np
import pandas as pd

from evaluation.estimates.families import ADDING_RULES, AT_RAW, RAW
from evaluation.plan.address import MechanismLevel, parse_row
from evaluation.reporting.amounts import PERCENT, whole_percent
from evaluation.reporting.charts import (
    LOOKS,
    Axis,
    Chart,
    Curve,
    Look,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS, find_family
from evaluation.reporting.names import mechanism_name
from evaluation.reporting.rows import Results
from isac_track.intervals import LEAST_CLUSTERS

_NOTE: Final = (
    "Net speed: distance from the first to the last true position, over the duration. "
    "Each mechanism is shown after the strongest attack on it. "
    f"A bin of fewer than {LEAST_CLUSTERS:.0f} people has no interval."
)


def figures(run: Results) -> Iterator[Figure]:
    """Yield a panel of the attacked levels for each adding rule with noise."""
    curves = _by_level(run.speeds[run.speeds["knowledge"].fillna("") != ""])
    looks = _looks(run, curves)
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for rule in ADDING_RULES:
        mechanism_levels = [
            where
            for where in curves
            if rule in find_family(run.families, where.mechanism).rules
        ]
        drawn = [
            _curve(looks[_name(run, where)], _name(run, where), curves[where])
            for where in mechanism_levels
        ]
        if any(where.mechanism != RAW for where in mechanism_levels):
            if not label_room(drawn):
                key |= {curve.label: curve.look for curve in drawn}
            x, y = Axis("net speed (m/s)"), Axis("PLR after attack (%)")
            panels.append((f"{rule} adding", curves_chart(drawn, x=x, y=y)))
    yield Figure(
        name="by_speed",
        section="after",
        title="PLR after attack over net speed",
        panels=panels,
        columns=len(ADDING_RULES),
        key=key,
        caption=_caption(curves, run),
        note=_NOTE,
    )


def _caption(curves: Mapping[MechanismLevel, pd.DataFrame], run: Results) -> str:
    """Tell attacked PLR of the slowest and fastest people at the noisiest level."""
    added = [where for where in curves if where.mechanism != RAW]
    if not added:
        return ""
    where = min(added, key=lambda level: curves[level]["value"].mean())
    rows = curves[where].sort_values("speed_mps")
    slow, fast = rows.iloc[0], rows.iloc[-1]
    name = mechanism_name(find_family(run.families, where.mechanism), where.level)
    return (
        f"With {name}, PLR after attack is {whole_percent(slow['value'])} at "
        f"{slow['speed_mps']:.1f} m/s and {whole_percent(fast['value'])} at "
        f"{fast['speed_mps']:.1f} m/s."
    )


def _by_level(rows: pd.DataFrame) -> dict[MechanismLevel, pd.DataFrame]:
    """Return the rows of each level."""
    levels = rows["level"].astype(object).where(rows["level"].notna(), None)
    mechanism_levels = list(map(MechanismLevel, rows["mechanism"], levels))
    places: dict[MechanismLevel, list[int]] = {}
    for place, where in enumerate(mechanism_levels):
        places.setdefault(where, []).append(place)
    return {where: rows.iloc[own] for where, own in places.items()}


def _looks(run: Results, mechanism_levels: Iterable[MechanismLevel]) -> dict[str, Look]:
    """Return the look of each level under both adding rules; raw is a star."""
    names = dict.fromkeys(
        _name(run, where) for where in mechanism_levels if where.mechanism != RAW
    )
    looks = {name: Look(place % (LOOKS - 1)) for place, name in enumerate(names)}
    raw = {_name(run, AT_RAW): Look(LOOKS - 1)} if AT_RAW in mechanism_levels else {}
    return raw | looks


def _name(run: Results, where: MechanismLevel) -> str:
    """Return the plain name of a level, whatever its adding rule."""
    family = find_family(run.families, where.mechanism)
    return mechanism_name(replace(family, mechanism=family.name), where.level)


def _curve(look: Look, name: str, rows: pd.DataFrame) -> Curve:
    """Return the curve of a level over the mean speed of each bin.

    Its name tells both ends.
    """
    rows = rows.sort_values("speed_mps")
    x = rows["speed_mps"].to_numpy()
    values = PERCENT * rows[ENDS].to_numpy(dtype=np.float64).T
    points = [f"{values[0, n]:.1f} % at {x[n]:.2f} m/s" for n in (0, -1)]
    attack = parse_row(rows.iloc[0].to_dict()).label
    ends = " to ".join(dict.fromkeys(points))
    return Curve(look, f"{name} after {attack}: {ends}", x, values, name)
