"""The tables that a cell consists of, by name: most cells have only `rows`."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, TypeAlias

import numpy as np
import pyarrow as pa

from isac_track import privacy
from isac_track.config import PrivacySettings
from isac_track.types import Floats, Ints, Release, Scenes, Tracks, squared_lengths

Rows: TypeAlias = dict[str, np.ndarray[Any, np.dtype[Any]]]
Tables: TypeAlias = "dict[str, pa.Table]"
ROWS: Final = "rows"
DESCRIPTORS: Final = ("plr", "ael_s", "mel_s")
"""Columns of the privacy descriptors of a track, or of a window."""
ON_TRIAL: Final = (
    *(f"{name.removesuffix('_s')}_attacked" for name in DESCRIPTORS),
    "alignment_error",
    "posterior_std",
)
"""Columns of a window's descriptors after a blind smoother, in their units and m, m."""


def rows_table(rows: Rows, *, tracks: Tracks) -> pa.Table:
    """Return rows as a table, with the track's source and group in place of `track`."""
    columns: dict[str, Any] = {}
    for name, values in rows.items():
        if name == "track":
            columns["source"] = names_column(values, tracks.source)
            columns["group"] = names_column(values, tracks.group)
        else:
            columns[name] = values
    return table(columns)


def table(columns: Mapping[str, Any]) -> pa.Table:
    """Return a table of columns, each as `column` takes it."""
    arrays = [column(values) for values in columns.values()]
    return pa.Table.from_arrays(arrays, names=[*columns])


def column(
    values: Any,  # noqa: ANN401 - an array of either library, or text
) -> pa.Array:
    """Return an array of numbers or truth values, or a sequence of text, as a column.

    pyarrow's own conversions import pandas, to check the type: 40 MB in every worker.
    """
    if isinstance(values, pa.Array):
        return values
    buffers: tuple[Any, ...]
    if isinstance(values, np.ndarray):
        is_bits = values.dtype == np.bool_
        buffers = (
            np.packbits(values, bitorder="little") if is_bits else values.copy(),
        )
        kind = pa.from_numpy_dtype(values.dtype)
    else:
        encoded = [text.encode() for text in values]
        ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
        kind, buffers = pa.string(), (ends, b"".join(encoded))
    return pa.Array.from_buffers(kind, len(values), [None, *map(pa.py_buffer, buffers)])


def names_column(rows: Ints, names: Sequence[str]) -> pa.Array:
    """Return a column of names, (N,), given by their places in `names`."""
    return _names_column(
        np.ascontiguousarray(rows, dtype=np.int64).tobytes(), tuple(names)
    )


# The columns of a task, shared by its cells; the oldest makes room for the 17th.
@lru_cache(maxsize=16)
def _names_column(rows: bytes, names: tuple[str, ...]) -> pa.Array:
    return column(names).take(column(np.frombuffer(rows, dtype=np.int64)))


def track_columns(scenes: Scenes, rows: Ints) -> Rows:
    """Return the columns that identify tracks of a block: scene, agent, track."""
    return {
        "scene": np.repeat(scenes.index, scenes.n_agents)[rows],
        "agent": np.tile(np.arange(scenes.n_agents), len(scenes))[rows],
        "track": scenes.track[rows],
        "n_samples": np.diff(scenes.offsets)[rows],
    }


def net_speeds(batch: Tracks | Scenes) -> Floats:
    """Return the speed of each track from its first to its last sample, (N,) m/s.

    NaN for a track of a single sample.
    """
    first, last = batch.offsets[:-1], batch.offsets[1:] - 1
    way_m = np.sqrt(squared_lengths(batch.xy[last] - batch.xy[first]))
    duration_s = batch.t[last] - batch.t[first]
    speed_mps = np.full(first.size, np.nan)
    np.divide(way_m, duration_s, out=speed_mps, where=duration_s > 0.0)
    return speed_mps


def descriptors(release: Release, *, truth: Floats, settings: PrivacySettings) -> Rows:
    """Return the columns of `described_rows` of every track; `truth` is (M, 2) m."""
    xy, t, offsets = release.xy, release.t, release.offsets
    values = privacy.described(
        xy=xy, truth=truth, t=t, offsets=offsets, settings=settings
    )
    return described_rows(values)


def described_rows(described: Floats) -> Rows:
    """Return the columns of the descriptors that `privacy.described` returns."""
    plr, ael_s, mel_s, _, mse_m2, plr_wide, median_m = described
    return {
        "plr": plr,
        "ael_s": ael_s,
        "mel_s": mel_s,
        "mse_m2": mse_m2,
        "plr_wide": plr_wide,
        "median_error_m": median_m,
    }


def track_means(values: Floats, offsets: Ints) -> Floats:
    """Return the mean over the samples of each track, (N,)."""
    if offsets.size == 1:  # reduceat needs at least one segment
        return np.zeros(0)
    return np.asarray(np.add.reduceat(values, offsets[:-1]) / np.diff(offsets))
