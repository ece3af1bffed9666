"""Recordings to read: walks as tracks, or as a file in any format; and refusals."""

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from isac_track.datasets import FORMATS, read
from isac_track.errors import IsacTrackError
from isac_track.types import Tracks

CORPUS = Path(__file__).parents[1] / "fuzz" / "corpus"
TEXT = [name for name in FORMATS if name != "parquet"]
SECONDS = {"csv", "parquet"}
"""Formats with a clock of their own; the others count frames."""

# Two people, 2.5 samples a second: 3 walks at 1 m/s along x, 12 walks at 0.5 m/s along
# y.
T = [0.0, 0.4, 0.8]
THREE = [(0.0, 1.0), (0.4, 1.0), (0.8, 1.0)]
TWELVE = [(5.0, 0.0), (5.0, 0.2), (5.0, 0.4)]
WALK = [
    (t, person, *xy)
    for person, walk in (("3", THREE), ("12", TWELVE))
    for t, xy in zip(T, walk, strict=True)
]

_LINE = {
    "obsmat": " {frame:.9e} {id:.9e} {x:.17e} 0 {y:.17e} 9 9 9",
    "social-gan": "{frame}.0\t{id}.0\t{x!r}\t{y!r}",
    "pedpy": "{id} {frame} {x!r} {y!r} 1.70",
    "trajnet": '{{"track": {{"f": {frame}, "p": {id}, "x": {x!r}, "y": {y!r}}}}}',
    "csv": "{t!r},{id},{x!r},{y!r}",
}
_HEADER = {
    "pedpy": "# framerate: 25.00 fps\n# id frame x/m y/m z/m\n\n",
    "csv": "t,id,x,y\n",
}


def build_tracks(*walks, frame_s=0.4):
    """Return tracks of the given positions [(x, y), ...], sampled every `frame_s`."""
    names = tuple(f"w{row}" for row in range(len(walks)))
    return Tracks(
        t=np.concatenate([frame_s * np.arange(len(walk)) for walk in walks]),
        xy=np.concatenate([np.asarray(walk, dtype=float) for walk in walks]),
        offsets=np.cumsum([0, *map(len, walks)]),
        source=names,
        group=names,
    )


def write_csv(path, tracks):
    """Write tracks as a recording of one's own."""
    rows = [
        f"{t:.2f},{track.source[0]},{x:.4f},{y:.4f}"
        for track in tracks
        for t, (x, y) in zip(track.t, track.xy, strict=True)
    ]
    path.write_text("t,id,x,y\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def packed(*, compression="snappy", row_group_size=None, **columns):
    """Return columns as a parquet file."""
    buffer = io.BytesIO()
    table = pa.table(
        {name: column for name, column in columns.items() if column is not None}
    )
    parquet.write_table(
        table, buffer, compression=compression, row_group_size=row_group_size
    )
    return buffer.getvalue()


def written(rows, format_name, *, frame_s=0.04):
    """Return rows of (t, id, x, y) as a file; frames are counted from 100."""
    if format_name == "parquet":
        return packed(
            **dict(zip(("t", "id", "x", "y"), map(list, zip(*rows, strict=True))))  # noqa: B905 - four
        )
    lines = [
        _LINE[format_name].format(
            t=t, frame=100 + round(t / frame_s), id=int(person), x=float(x), y=float(y)
        )
        for t, person, x, y in rows
    ]
    return (_HEADER.get(format_name, "") + "\n".join(lines) + "\n").encode()


def stated_fps(format_name):
    """Return the frame rate that `written` needs to be told: pedpy declares it."""
    return None if format_name in {"csv", "parquet", "pedpy"} else 25.0


def read_walk(data, format_name, fps="usual"):
    """Return tracks and repairs of a file called ``f``."""
    rate = stated_fps(format_name) if fps == "usual" else fps
    return read(data=data, path="f", format=format_name, fps=rate)


def refusal(data, format_name, fps="usual"):
    """Return the message with which a reader refuses a file called ``f``: one line."""
    with pytest.raises(IsacTrackError) as caught:
        read_walk(data, format_name, fps)
    message = str(caught.value)
    assert_message(message)
    return message


def assert_message(message):
    """Properties of every message: about the file, one line, short and printable."""
    assert message.startswith(("f:", "f,", "--fps")), message
    assert len(message.splitlines()) == 1, message
    assert len(message) < 1000
    message.encode()


def kinds(repairs):
    """Return how often each kind of repair was made."""
    return {repair.kind: repair.count for repair in repairs}


def same(first, other):
    """Whether two recordings are the same bit for bit, names included."""
    return (
        np.array_equal(first.xy, other.xy)
        and np.array_equal(first.t, other.t)
        and (first.source, first.group) == (other.source, other.group)
    )


def files_in(folder):
    """Return all files below a folder."""
    return [path for path in folder.rglob("*") if path.is_file()]
