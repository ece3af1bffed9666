"""The sample tracks of a run: the few walks that its pictures show."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.compute.sample_tracks import COLUMNS
from evaluation.store.cell_files import readable
from evaluation.store.files import SAMPLE_TRACKS, open_regular, write_whole

if TYPE_CHECKING:
    import pandas as pd


def save_sample_tracks(parts: Sequence[pa.Table], *, out: Path) -> None:
    """Write sample tracks into a run folder; without parts remove earlier tracks."""
    if not parts:
        (out / SAMPLE_TRACKS).unlink(missing_ok=True)
        return
    sink = pa.BufferOutputStream()
    pq.write_table(
        pa.concat_tables(parts), sink, compression="zstd", write_page_checksum=True
    )
    write_whole(out / SAMPLE_TRACKS, sink.getvalue().to_pybytes())


def read_sample_tracks(out: Path) -> pd.DataFrame | None:
    """Return the sample tracks of a run folder, None without any.

    Raises DataError if they are broken.
    """
    path = out / SAMPLE_TRACKS
    if not path.exists():
        return None
    with readable(path):
        # Not pq.read_table: where no further thread can start it ends the process.
        with (
            open_regular(path) as opened,
            pq.ParquetFile(opened, page_checksum_verification=True) as file,
        ):
            # A column that is missing is not an error of `read`.
            table = file.read(use_threads=False).select(COLUMNS)
        tracks: pd.DataFrame = table.to_pandas(use_threads=False)
        return tracks
