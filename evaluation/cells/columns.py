"""Columns of names in the files of cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.types import Ints


def names_column(rows: Ints, names: Sequence[str]) -> pa.DictionaryArray:
    """Return a column of names, (N,), given by their places in `names`.

    Each name is in the dictionary once: of one with repetitions, files differ from run to run.
    """
    place: dict[str, int] = {}
    for name in names:
        place.setdefault(name, len(place))
    places = np.array([place[name] for name in names], dtype=np.int32)
    return pa.DictionaryArray.from_arrays(
        pa.array(places[rows]), pa.array(list(place), type=pa.string())
    )
