"""Missed future conflicts against what a log tells: a curve for each policy."""

from collections.abc import Iterator
from typing import Final

import numpy as np
import pandas as pd

from evaluation.estimates.keys import row_dicts
from evaluation.estimates.metrics import (
    FOLLOWED,
    FUTURE_EQUAL_ALARMS,
    KNOWN_SHARE,
    METRICS,
)
from evaluation.plan.world import World
from evaluation.reporting.charts import (
    LOOKS,
    PERCENT,
    Axis,
    Chart,
    Curve,
    Look,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS, find_family
from evaluation.reporting.names import robot_name, short_mechanism_name
from evaluation.reporting.patrol_words import ahead_text, patrol_sentence
from evaluation.reporting.rows import Results

_CHAINS: Final = "blind"
_KEYS: Final = ["mechanism", "level", "policy"]
_PANELS: Final = {
    KNOWN_SHARE: "known by own chains (% of person-time)",
    FOLLOWED: "followed for 10 s (% of people)",
}


def figures(run: Results) -> Iterator[Figure]:
    """Yield missed futures over known share, and over the share that is followed."""
    proposal = run.verdict.get("patrols", {}).get("recommended", {})
    if not proposal:
        return
    world = World(horizon_s=proposal["horizon_s"]).text if proposal["horizon_s"] else ""
    dataset = f"{run.dataset}:{world}" if world else run.dataset
    rows = run.patrols
    missed = rows[
        (rows["metric"] == FUTURE_EQUAL_ALARMS)
        & (rows["consumer"] == proposal["robot"])
        & (rows["dataset"] == dataset)
    ]
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for metric, label in _PANELS.items():
        revealed = rows[(rows["metric"] == metric) & (rows["knowledge"] == _CHAINS)]
        curves = list(_curves(run, missed, revealed))
        if not curves:
            continue
        if not label_room(curves):
            key |= {curve.label: curve.look for curve in curves}
        y = Axis("missed future conflicts (%)")
        panels.append((METRICS[metric].head, curves_chart(curves, x=Axis(label), y=y)))
    ahead = ahead_text(proposal["horizon_s"])
    yield Figure(
        name="patrols",
        section="plane",
        title=f"Policies on patrol: robot {robot_name(proposal['robot'])}, conflicts{ahead}",
        panels=panels,
        columns=2,
        key=key,
        caption=patrol_sentence(run),
        note=(
            "Along a curve: the mechanisms, from the one by which least is known. Lower"
            " and further left is better. The adversary joins answers without"
            " identities."
        ),
    )


def _curves(
    run: Results, missed: pd.DataFrame, revealed: pd.DataFrame
) -> Iterator[Curve]:
    """Yield the curve of each policy, over its mechanisms, with intervals of misses."""
    both = missed.merge(revealed, on=_KEYS, suffixes=("", "_x"))
    both = both[np.isfinite(both["value"]) & np.isfinite(both["value_x"])]
    for place, (policy, rows) in enumerate(both.groupby("policy", sort=False)):
        ordered = rows.sort_values("value_x", kind="stable")
        names = [
            short_mechanism_name(
                find_family(run.families, row["mechanism"]),
                None if pd.isna(row["level"]) else row["level"],
            )
            + f" {PERCENT * row['value']:.0f} % missed, {PERCENT * row['value_x']:.0f} %"
            for row in row_dicts(ordered)
        ]
        yield Curve(
            look=Look(place % LOOKS, hollow=place >= LOOKS),
            name=f"{policy}: {'; '.join(names)}",
            x=ordered["value_x"].to_numpy(dtype=np.float64) * PERCENT,
            y=ordered[ENDS].to_numpy(dtype=np.float64).T * PERCENT,
            label=str(policy),
        )
