"""The sample tracks of a run folder, where a redraw finds them: `gallery.parquet`."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import pandas as pd

from evaluation.cells.sample_tracks import COLUMNS
from evaluation.runs.files import write_whole
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

GALLERY = "gallery.parquet"


def write_gallery(parts: Sequence[pd.DataFrame], *, out: Path) -> None:
    """Keep the gallery in a run folder; without parts there is none, nor an earlier one.

    Raises
    ------
    DataError
        If the folder cannot be written.
    """
    if not parts:
        (out / GALLERY).unlink(missing_ok=True)
        return
    sink = io.BytesIO()
    pd.concat(parts, ignore_index=True).to_parquet(sink, index=False)
    write_whole(out / GALLERY, sink.getvalue())


def read_gallery(out: Path) -> pd.DataFrame | None:
    """Return the gallery of a run folder; None if it has none.

    Raises
    ------
    DataError
        If the file is broken.
    """
    path = out / GALLERY
    if not path.exists():
        return None
    try:
        rows = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read ({error}); delete it") from None
    if not set(COLUMNS) <= set(rows.columns):
        raise DataError(f"{path} is of another version; delete it")
    return rows
