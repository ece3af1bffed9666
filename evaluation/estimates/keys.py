"""Tables of a run by the addresses of their rows, and levels as people write them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from evaluation.estimates.metrics import MISSED_RATE
from evaluation.plan.address import Address, parse_consumer, parse_dataset
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    import pandas as pd

    from isac_track.intervals import Estimate

INFORMED: Final = "informed"
EstimatesByAddress: TypeAlias = "Mapping[Address, Estimate]"
"""Estimates of one run in one world, which their addresses leave out."""
_MOST_WRITTEN_OUT = 1e7


def level_text(level: float | None) -> str:
    """Return a level as a short text; empty for a mechanism without levels."""
    if level is None or math.isnan(level):
        return ""
    short = f"{level:.4g}"
    # Write it as people type it, 10000 and not 1e+04, as long as it can be read.
    return f"{level:.0f}" if "e+" in short and abs(level) < _MOST_WRITTEN_OUT else short


def where_text(mechanism: str, level: float | None) -> str:
    """Return a mechanism and its level as people write it."""
    return f"{mechanism} {level_text(level)}".rstrip()


def row_dicts(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table as dictionaries, ten times as fast as `to_dict`."""
    names = list(frame.columns)
    columns = (frame[name].to_numpy(dtype=object).tolist() for name in names)
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def row_addresses(rows: pd.DataFrame) -> list[Address]:
    """Return the address of each row of a summary, without recording and world."""
    knowledge = rows["knowledge"].astype(object).fillna("")
    names = ("mechanism", "level", "consumer", "metric")
    return [
        parse_consumer(consumer, adversary).at(
            mechanism, None if math.isnan(level) else level, metric
        )
        for mechanism, level, consumer, metric, adversary in zip(
            *(rows[name] for name in names), knowledge, strict=True
        )
    ]


def judged_at(
    own: EstimatesByAddress, at_horizon: EstimatesByAddress
) -> EstimatesByAddress:
    """Return the estimates of a run with its robots judged at another horizon.

    The numbers of robots at that horizon replace those of the run's own; all other
    numbers are the same for both. A robot without numbers at that horizon is left out,
    so that two horizons are never compared.
    """
    robots = {key.consumer for key in own if key.metric == MISSED_RATE}
    not_judged = robots - {key.consumer for key in at_horizon}
    comparable = {
        key: estimate for key, estimate in own.items() if key.consumer not in not_judged
    }
    return {**comparable, **at_horizon}


def row_worlds(frame: pd.DataFrame) -> pd.Series[Any]:
    """Return the world of each row of a table with the column `dataset`."""
    names = frame["dataset"]
    return names.map(lambda name: parse_dataset(str(name)).world).astype(object)


def is_attack(frame: pd.DataFrame) -> pd.Series[bool]:
    """Return which rows of a summary are of an attack.

    Only these name an adversary; a predictor may bear the same name as an attack.
    """
    return frame["knowledge"].isin(list(ADVERSARIES))
