"""What a consumer leaves of a unit of work: tables, by name, most of them one called `rows`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pyarrow as pa

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.scenes import Cut
    from isac_track.types import Ints

Rows: TypeAlias = dict[str, np.ndarray[Any, np.dtype[Any]]]
Tables: TypeAlias = "dict[str, pa.Table]"
ROWS = "rows"


def rows_table(rows: Rows, *, tracks: Cut) -> pa.Table:
    """Return rows with the source and the group of each row's track, in place of `track`."""
    columns: dict[str, Any] = {}
    for name, values in rows.items():
        if name == "track":
            columns["source"] = names_column(values, tracks.source)
            columns["group"] = names_column(values, tracks.group)
        else:
            columns[name] = values
    return pa.table(columns)


def names_column(rows: Ints, names: Sequence[str]) -> pa.Array:
    """Return a column of names, (N,), given by their places in `names`."""
    return pa.array(names, type=pa.string()).take(pa.array(rows))
