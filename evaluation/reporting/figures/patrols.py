"""Missed future conflicts against what a log tells: a curve for each policy."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates.families import RAW
from evaluation.estimates.keys import row_dicts
from evaluation.estimates.metrics import (
    FOLLOWED,
    FUTURE_EQUAL_ALARMS,
    KNOWN_SHARE,
    METRICS,
)
from evaluation.plan.world import World
from evaluation.reporting.amounts import PERCENT, whole_percent
from evaluation.reporting.charts import (
    LOOKS,
    Axis,
    Chart,
    Curve,
    LonePoint,
    Look,
    curves_chart,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS, find_family
from evaluation.reporting.names import robot_subject, short_mechanism_name
from evaluation.reporting.patrol_words import ahead_text, patrol_sentence
from evaluation.reporting.rows import Results
from evaluation.verdict.patrol_json import read_proposal

_CHAINS: Final = "blind"
_KEYS: Final = ["mechanism", "level", "policy"]
_PANELS: Final = {
    KNOWN_SHARE: "known by own chains (% of person-time)",
    FOLLOWED: "followed for 10 s (% of people)",
}


def figures(run: Results) -> Iterator[Figure]:
    """Yield missed futures over known share, and over the share that is followed."""
    proposal = read_proposal(run.verdict.get("patrols", {}))
    if proposal is None:
        return
    world = World(horizon_s=proposal.horizon_s).text if proposal.horizon_s else ""
    dataset = f"{run.dataset}:{world}" if world else run.dataset
    rows = run.patrols
    missed = rows[
        (rows["metric"] == FUTURE_EQUAL_ALARMS)
        & (rows["consumer"] == proposal.robot)
        & (rows["dataset"] == dataset)
    ]
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for metric, label in _PANELS.items():
        revealed = rows[(rows["metric"] == metric) & (rows["knowledge"] == _CHAINS)]
        both = _options(missed, revealed)
        if both.empty:
            continue
        looks = {
            policy: Look(place % (LOOKS - 1), turn=place // (LOOKS - 1))
            for place, policy in enumerate(both["policy"].unique())
        }
        key |= looks
        chart = curves_chart(
            list(_curves(run, both, looks)),
            x=Axis(label),
            y=Axis("missed at equal alarms (%)"),
            marked=list(_raw_marks(both, looks)),
        )
        panels.append((METRICS[metric].head, chart))
    yield Figure(
        name="patrols",
        section="plane",
        title=(
            f"Policies on patrol: {robot_subject(proposal.robot)}, future conflicts"
            f"{ahead_text(proposal.horizon_s)}"
        ),
        panels=panels,
        columns=2,
        key=key,
        caption=patrol_sentence(run),
        note=(
            "Filled: raw positions. Hollow: the same policy with a mechanism, joined"
            " along its levels. Lower and further left is better. The adversary joins"
            " answers without identities."
        ),
    )


def _options(missed: pd.DataFrame, revealed: pd.DataFrame) -> pd.DataFrame:
    """Return the rows that have both numbers, which are `value` and `value_x`."""
    both = missed.merge(revealed, on=_KEYS, suffixes=("", "_x"))
    return both.dropna(subset=["value", "value_x"])


def _curves(
    run: Results, both: pd.DataFrame, looks: Mapping[str, Look]
) -> Iterator[Curve]:
    """Yield the curve of each policy over the levels of each mechanism, from raw on.

    Each has the intervals of misses.
    """
    for policy, rows in both.groupby("policy", sort=False):
        is_raw = rows["mechanism"] == RAW
        groups = [own for _, own in rows[~is_raw].groupby("mechanism", sort=False)]
        for own in groups or [rows[:0]]:
            ordered = pd.concat([rows[is_raw], own.sort_values("level")])
            names = [_point_name(run, row) for row in row_dicts(ordered)]
            yield Curve(
                look=looks[str(policy)]._replace(hollow=True),
                name=f"{policy}: {'; '.join(names)}",
                x=ordered["value_x"].to_numpy(dtype=np.float64) * PERCENT,
                y=ordered[ENDS].to_numpy(dtype=np.float64).T * PERCENT,
            )


def _raw_marks(both: pd.DataFrame, looks: Mapping[str, Look]) -> Iterator[LonePoint]:
    """Yield the mark of each policy with raw positions."""
    for row in row_dicts(both[both["mechanism"] == RAW]):
        yield LonePoint(
            look=looks[row["policy"]],
            name=f"{row['policy']} with raw positions",
            x=PERCENT * row["value_x"],
            y=PERCENT * row["value"],
        )


def _point_name(run: Results, row: Mapping[str, Any]) -> str:
    """Return a level with its numbers, for the pointer."""
    level = None if pd.isna(row["level"]) else row["level"]
    name = short_mechanism_name(find_family(run.families, row["mechanism"]), level)
    missed, known = whole_percent(row["value"]), whole_percent(row["value_x"])
    return f"{name} {missed} missed, {known}"
