"""Readers for JuPedSim, Pedestrian Data Archive, Vadere, MOT, SDD and Viswalk.

The user names the format; the number of columns never does. SQLite, HDF5 and pandas do
the parsing.
"""

from __future__ import annotations

import csv
import io
import sqlite3
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track.datasets import recording
from isac_track.datasets.recording import Place, Rows
from isac_track.errors import DataError, error_text
from isac_track.types import Bools, Floats

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

# Further columns are not used.
_MOT = ("frame", "id", "left", "top", "width", "height")
# Number of columns of MOT16 and later; the last is visibility, before it the class.
_MOT_GROUND_TRUTH = 9
# Classes: not given, a pedestrian, a person who stands.
_MOT_PEOPLE = (-1, 1, 7)
_SDD = (
    "id",
    "xmin",
    "ymin",
    "xmax",
    "ymax",
    "frame",
    "lost",
    "occluded",
    "generated",
    "label",
)


def _choose_rate(
    fps: float | None, declared: float | None, *, path: str, name: str
) -> float:
    """Return the frame rate of user or file; DataError if none, or if they differ."""
    if (
        fps is not None
        and declared is not None
        and not np.isclose(fps, declared, rtol=1e-6)
    ):
        raise DataError(
            f"{path}: --fps {fps:g} contradicts the file's frame rate {declared:g}"
        )
    rate = declared if fps is None else fps
    if rate is None:
        raise DataError(
            f"{path}: format {name} counts frames, and the file has no frame rate; "
            "give frames per second with --fps"
        )
    return recording.check_fps(rate, where=path)


def _frame_rows(columns: Mapping[str, Floats], place: Place, *, fps: float) -> Rows:
    """Return rows of columns frame, id, x and y, on a clock in seconds."""
    if not columns["frame"].size:
        raise DataError(f"{place.path}: the file holds no rows")
    rows = recording.build_rows(
        {name: columns[name] for name in ("frame", "id", "x", "y")}, place
    )
    return replace(rows, t=rows.t / fps)


def _timed_rows(t: Floats, person: Floats, xy: Floats, place: Place) -> Rows:
    """Return rows whose clock is in seconds, of positions (M, 2)."""
    if not t.size:
        raise DataError(f"{place.path}: the file holds no rows")
    columns = {"t": t, "id": person, "x": xy[:, 0], "y": xy[:, 1]}
    recording.check_numbers(columns, place)
    ids = np.unique(person)
    names = tuple(str(int(name)) for name in ids)
    return Rows(np.searchsorted(ids, person), names, t - t.min(), xy, place)


def _number_rows(path: str, n_rows: int, unit: str = "row") -> Place:
    """Return the places of rows that are numbered from 1."""
    return Place(path, lambda: np.arange(1, n_rows + 1), unit=unit)


def read_jupedsim(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read JuPedSim's SQLite file: trajectory_data and, in metadata, fps. In metres."""
    if not data.startswith(b"SQLite format 3\0"):
        raise DataError(f"{path}: not an SQLite file, as JuPedSim writes")
    try:
        with closing(sqlite3.connect(":memory:")) as database:
            database.deserialize(data)
            query = "SELECT frame, id, pos_x, pos_y FROM trajectory_data"
            table = np.array(
                database.execute(query).fetchall(), dtype=np.float64
            ).reshape(-1, 4)
            declared = database.execute(
                "SELECT value FROM metadata WHERE key = 'fps'"
            ).fetchone()
    except (sqlite3.Error, ValueError, TypeError, OverflowError, MemoryError) as error:
        raise DataError(
            f"{path}: cannot be read as JuPedSim's SQLite ({error_text(error)})"
        ) from None
    rate = (
        None if declared is None else recording.check_fps(str(declared[0]), where=path)
    )
    columns = dict(zip(("frame", "id", "x", "y"), table.T, strict=True))
    rows = _frame_rows(
        columns,
        _number_rows(path, len(table)),
        fps=_choose_rate(fps, rate, path=path, name="jupedsim"),
    )
    return replace(rows, unit="m")


def read_hdf5(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read the Pedestrian Data Archive's HDF5 file: `trajectory`, its attribute fps."""
    try:
        import h5py  # noqa: PLC0415 - optional
    except ImportError:
        raise DataError(f"{path}: HDF5 takes h5py: pip install h5py") from None
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            table = file["trajectory"][...]
            attributes = {**file.attrs, **file["trajectory"].attrs}
            names = ("frame", "id", "x", "y")
            columns = {
                name: np.asarray(table[name], dtype=np.float64) for name in names
            }
            declared = attributes.get("fps")
            rate = None if declared is None else float(np.ravel(declared)[0])
    except Exception as error:  # noqa: BLE001 - a damaged file makes h5py raise nearly anything
        raise DataError(
            f"{path}: cannot be read as HDF5 trajectories ({error_text(error)})"
        ) from None
    rows = _frame_rows(
        columns,
        _number_rows(path, len(table)),
        fps=_choose_rate(fps, rate, path=path, name="hdf5"),
    )
    return replace(rows, unit="m")


def _read_text_table(
    data: bytes,
    *,
    path: str,
    name: str,
    skip: int = 0,
    **options: Any,  # noqa: ANN401 - further options of pandas, each of its own type
) -> pd.DataFrame:
    """Return the fields of a text file as text; DataError if it is no table."""
    import pandas as pd  # noqa: PLC0415 - only for such a file

    try:
        table: pd.DataFrame = pd.read_csv(
            io.BytesIO(data), dtype=str, skiprows=skip, skipinitialspace=True, **options
        )
    except (ValueError, UnicodeError, MemoryError, OverflowError, csv.Error) as error:
        raise DataError(
            f"{path}: cannot be read as {name} ({error_text(error)})"
        ) from None
    return table


def _number_columns(
    table: pd.DataFrame, names: Mapping[str, str], place: Place
) -> dict[str, Floats]:
    """Return columns of text as numbers, (M,); `names` maps our names to headers.

    DataError names the first row that is not a number.
    """
    import pandas as pd  # noqa: PLC0415 - only for such a file

    columns = {}
    for name, header in names.items():
        numbers = pd.to_numeric(table[header], errors="coerce").to_numpy(
            dtype=np.float64
        )
        bad = np.isnan(numbers)
        if bad.any():
            row = int(bad.argmax())
            text = recording.printable(str(table[header].iloc[row])[:40])
            hint = "; write a decimal point" if "," in text else ""
            raise DataError(f"{place.at(row)}: {name} {text!r} is not a number{hint}")
        columns[name] = numbers
    return columns


def read_vadere(*, data: bytes, path: str) -> Rows:
    """Read Vadere's trajectories: pedestrianId, simTime, startX, startY. In m and s.

    A row is a step of the foot; its start is where the person is at that time.
    """
    recording.check_text(data=data, path=path)
    header = next(
        (line for line in recording.iterate_lines(data) if line[:1] not in {"", "#"}),
        "",
    )
    is_csv = "," in header
    table = _read_text_table(
        data, path=path, name="vadere", sep="," if is_csv else r"\s+", comment="#"
    )
    headers = {
        str(name).partition("-PID")[0].lower(): str(name) for name in table.columns
    }
    wanted = {"id": "pedestrianid", "t": "simtime", "x": "startx", "y": "starty"}
    if "startx" not in headers:
        wanted |= {"x": "x", "y": "y"}
    if missing := [name for name in wanted.values() if name not in headers]:
        raise DataError(
            f"{path}: no column {', '.join(missing)}, as Vadere's trajectories have"
        )
    place = _number_rows(path, len(table))
    columns = _number_columns(
        table, {ours: headers[name] for ours, name in wanted.items()}, place
    )
    xy = np.column_stack([columns["x"], columns["y"]])
    return replace(_timed_rows(columns["t"], columns["id"], xy, place), unit="m")


def read_mot(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read MOTChallenge boxes: frame, id, left, top, width, height.

    A person stands at the middle of the lower edge. In pixels, unless ``--unit`` gives
    the metres of a pixel.
    """
    recording.check_text(data=data, path=path)
    table = _read_text_table(data, path=path, name="mot", header=None, comment="#")
    if table.shape[1] < len(_MOT):
        raise DataError(
            f"{path}: {table.shape[1]} column(s) where mot has {', '.join(_MOT)}, ..."
        )
    place = _number_rows(path, len(table))
    named = table.iloc[:, : len(_MOT)].set_axis(_MOT, axis=1)
    columns = _number_columns(named, {name: name for name in _MOT}, place)
    if (columns["id"] < 0).all():
        raise DataError(
            f"{path}: every id is negative: detections of nobody; take the file gt.txt"
        )
    columns["x"] = columns["left"] + columns["width"] / 2.0
    columns["y"] = columns["top"] + columns["height"]
    return _keep_people(
        columns,
        *_mot_marks(table),
        place,
        fps=_choose_rate(fps, None, path=path, name="mot"),
    )


def _mot_marks(table: pd.DataFrame) -> tuple[Bools, Bools]:
    """Return which boxes of a ground truth are ignored, which are no people, (M,)."""
    import pandas as pd  # noqa: PLC0415 - only for such a file

    further = table.iloc[:, len(_MOT) :].apply(pd.to_numeric, errors="coerce")
    ignored = others = np.zeros(len(table), dtype=bool)
    # Values of 0 and 1 alone are a flag, not a confidence.
    if further.shape[1] and further.iloc[:, 0].isin((0, 1)).all():
        ignored = further.iloc[:, 0].to_numpy() == 0
    if table.shape[1] == _MOT_GROUND_TRUTH:
        others = ~further.iloc[:, 1].isin(_MOT_PEOPLE).to_numpy()
    return ignored, others


def _keep_people(
    columns: Mapping[str, Floats],
    lost: Bools,
    others: Bools,
    place: Place,
    *,
    fps: float,
) -> Rows:
    """Return the rows of people's boxes that are not lost; notes count the others."""
    notes = place.note_rows(
        "lost", np.flatnonzero(lost), "the box is marked as lost; dropped"
    )
    text = "no pedestrian; dropped"
    notes += place.note_rows("other-label", np.flatnonzero(~lost & others), text)
    is_person = ~(lost | others)
    if not is_person.any():
        raise DataError(
            f"{place.path}: all {is_person.size} boxes are lost, or no pedestrian's"
        )
    line = np.flatnonzero(is_person) + 1
    people = {name: column[is_person] for name, column in columns.items()}
    rows = _frame_rows(
        people, Place(place.path, lambda: line, unit=place.unit), fps=fps
    )
    return replace(rows, notes=tuple(notes))


def read_sdd(*, data: bytes, path: str, fps: float | None) -> Rows:
    """Read annotations of the Stanford Drone Dataset, without boxes that are lost.

    A person stands in the middle of the box. In pixels, unless ``--unit`` gives the
    metres of a pixel.
    """
    recording.check_text(data=data, path=path)
    table = _read_text_table(
        data, path=path, name="sdd", header=None, sep=r"\s+", quotechar='"'
    )
    if table.shape[1] != len(_SDD):
        raise DataError(
            f"{path}: {table.shape[1]} column(s) where sdd has {', '.join(_SDD)}"
        )
    table = table.set_axis(_SDD, axis=1)
    place = _number_rows(path, len(table))
    columns = _number_columns(table, {name: name for name in _SDD[:7]}, place)
    columns["x"] = (columns["xmin"] + columns["xmax"]) / 2.0
    columns["y"] = (columns["ymin"] + columns["ymax"]) / 2.0
    others = table["label"].to_numpy() != "Pedestrian"
    rate = _choose_rate(fps, None, path=path, name="sdd")
    return _keep_people(columns, columns["lost"] != 0, others, place, fps=rate)


def read_viswalk(*, data: bytes, path: str) -> Rows:
    """Read Viswalk's pedestrian protocol (.fzp), in seconds and metres.

    Its columns are SIMSEC, NO, and COORDCENTX and COORDCENTY, or COORDCENT with both.
    """
    recording.check_text(data=data, path=path)
    lines = [line.strip() for line in recording.iterate_lines(data)]
    begins = next(
        (n for n, line in enumerate(lines) if line.upper().startswith("$PED")), None
    )
    if begins is None:
        raise DataError(
            f"{path}: no line $PEDESTRIAN:..., which names the columns of Viswalk"
        )
    names = [
        name.strip().upper() for name in lines[begins].partition(":")[2].split(";")
    ]
    body = [
        line for line in lines[begins + 1 :] if line and not line.startswith(("*", "$"))
    ]
    text = "\n".join(body).encode()
    if not body:
        raise DataError(f"{path}: the file holds no rows")
    table = _read_text_table(text, path=path, name="viswalk", header=None, sep=";")
    if table.shape[1] < len(names):
        raise DataError(
            f"{path}: {table.shape[1]} column(s) where the header has {len(names)}"
        )
    table = table.iloc[:, : len(names)].set_axis(names, axis=1)
    if "COORDCENT" in names:
        parts = table["COORDCENT"].str.split(expand=True)
        if parts.shape[1] < 2:  # noqa: PLR2004 - x and y
            raise DataError(f"{path}: COORDCENT holds no x and y")
        table["COORDCENTX"], table["COORDCENTY"] = parts[0], parts[1]
    wanted = {"t": "SIMSEC", "id": "NO", "x": "COORDCENTX", "y": "COORDCENTY"}
    if missing := [name for name in wanted.values() if name not in table.columns]:
        raise DataError(
            f"{path}: no column {', '.join(missing)}, which Viswalk can write"
        )
    place = _number_rows(path, len(table))
    columns = _number_columns(table, wanted, place)
    xy = np.column_stack([columns["x"], columns["y"]])
    return replace(_timed_rows(columns["t"], columns["id"], xy, place), unit="m")
