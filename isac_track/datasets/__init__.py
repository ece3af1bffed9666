"""Pedestrian tracks by name or from a file of one's own.

``load("students03")``, ``load("plaza")``, ``load("walk.csv")``, and ``load()`` for the
best data set on this machine. The user names a format, or the file's extension does; it
is never guessed. `registry` knows the names and places, `repair` mends the rows;
``docs/how-to/data.md`` describes all of it.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isac_track.datasets import (
    crowd,
    people,
    read_frames,
    read_gc,
    read_table,
    read_tools,
    registry,
)
from isac_track.datasets.recording import (
    Reading,
    Repair,
    Rows,
    check_fps,
    convert_to_metres,
    listed,
    parse_columns,
    project_degrees,
    steps_within,
)
from isac_track.datasets.registry import (
    DEFAULT,
    FALLBACK,
    GROUPS_FILE,
    KNOWN,
    Known,
    shown,
)
from isac_track.datasets.repair import to_tracks
from isac_track.datasets.sessions import Session, join_sessions
from isac_track.datasets.sessions import files_in as session_files
from isac_track.errors import DataError, did_you_mean
from isac_track.types import Bools, Floats, Tracks

if TYPE_CHECKING:
    from pandas import DataFrame


__all__ = ["FORMATS", "TOOLS", "Dataset", "Repair", "load", "read", "summarise"]

FORMATS: Mapping[str, Callable[..., Rows]] = {
    **{name: partial(read_frames.read_columns, name) for name in read_frames.COLUMNS},
    "trajnet": read_frames.read_trajnet,
    "csv": read_table.read_csv,
    "parquet": read_table.read_parquet,
}
"""Readers that turn the bytes of a file into rows and raise only `DataError`."""
TOOLS: Mapping[str, Callable[..., Rows]] = {
    "jupedsim": read_tools.read_jupedsim,
    "hdf5": read_tools.read_hdf5,
    "vadere": read_tools.read_vadere,
    "mot": read_tools.read_mot,
    "sdd": read_tools.read_sdd,
    "viswalk": read_tools.read_viswalk,
}
"""Readers of files that other tools write."""
READERS: Mapping[str, Callable[..., Rows]] = {**FORMATS, **TOOLS}
_WITH_COLUMNS = ("csv", "parquet")  # Formats whose columns have names.
# Formats whose times are seconds, not frames.
_WITH_CLOCK = (*_WITH_COLUMNS, "vadere", "viswalk")
FRAME = "DataFrame"  # Name, path and format of a recording that is a data frame.
WALKING_MPS = (0.15, 2.5)  # Limits of the median speed; outside, units are in doubt.
WALK_MPS = 1.2  # Usual speed of a walk.
USUAL_MPS = (0.4, 2.2)  # Median speeds that another unit has to explain.
STEP_S = 1.0  # With a longer usual step, the clock is in doubt.
GRAND_CENTRAL = "gc"  # The format of an archive or a folder, as `read_gc` describes it.
_EXTENSIONS = {
    ".csv": "csv",
    ".parquet": "parquet",
    ".ndjson": "trajnet",
    ".fzp": "viswalk",
}
_TO_CSV = "to_csv('walks.csv', index=False)"
_EXCEL = f"import pandas; pandas.read_excel('FILE').{_TO_CSV}"
_CONVERTED = {
    ".xlsx": _EXCEL,
    ".xls": _EXCEL,
    ".json": f"import pandas; pandas.read_json('FILE').{_TO_CSV}",
    ".geojson": (
        "import geopandas; f = geopandas.read_file('FILE'); "
        f"f.assign(x=f.geometry.x, y=f.geometry.y).drop(columns='geometry').{_TO_CSV}"
    ),
}
"""Python code that converts files of other kinds to csv, by their extension."""
SLOW_MPS = 0.2  # Slower steps than this are not walking.
FROZEN_SHARE = 0.9
"""Share of steps without length in a nearly frozen track.

Such an annotation has one sample, its end, for the whole walk.
"""


@dataclass(frozen=True, eq=False, slots=True)
class Dataset:
    """Tracks, where they come from, and what was done to them on reading."""

    name: str  # Name in the registry, or of the file.
    tracks: Tracks
    path: str  # Where the file is; for bundled data relative to the package.
    sha256: str  # Hash of the main file.
    format: str
    # True for the bundled crowd; False for all files, of which nothing is known.
    simulated: bool
    repairs: tuple[Repair, ...]
    # Says that another data set than the preferred was taken; to be shown.
    notice: str | None
    citation: str  # Source to credit; empty if unknown.
    licence: str  # Empty if unknown.
    # Paths of the files that the user named as sessions.
    sessions: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return the recording's name, size, format and repairs in one line."""
        people = " (simulated people)" if self.simulated else ""
        size = f"{len(self.tracks):,} tracks, {self.tracks.t.size:,} samples"
        mended = f", {len(self.repairs)} kinds of repair" if self.repairs else ""
        return f"<Dataset {self.name}{people}: {size}, {self.format}{mended}>"


def load(
    name: str | Path | DataFrame | None = None,
    *,
    format: str | None = None,  # noqa: A002 - the name of the option
    fps: float | None = None,
    unit: str | None = None,
    download: bool = True,
    sessions: Sequence[str | Path] = (),
    persistent_ids: bool = False,
    columns: str | Mapping[str, str] | None = None,
    on_duplicate: str = "error",
    crs: str | None = None,
    drop_frozen: float | None = None,
) -> Dataset:
    """Load a known data set, a file, or the best data set that is on this machine.

    Parameters
    ----------
    name : str, Path or DataFrame, optional
        A known name, the path of a file or of a folder of sessions, or a data frame of
        pandas or polars with the columns of a csv. Without it: students03 if it is
        here, otherwise the bundled crowd plaza, with a notice; never a download.
    format : str, optional
        Format of a file. ``.csv``, ``.parquet`` and ``.ndjson`` (trajnet) name theirs,
        and so does a header of PeTrack or PedPy, which names the columns.
    fps : float, optional
        Frames per second, for a format that counts frames, unless the file says so.
    unit : str, optional
        Unit of length: m (the default), cm or mm, unless the file says so.
    download : bool
        Whether a known data set that was named may be downloaded if it is not here.
    sessions : sequence of str or Path
        Two files or more that are sessions of one recording, instead of a name.
    persistent_ids : bool
        Whether an id is the same person in all sessions. Labels, a column person, and
        PeTrack's markerID always name the person.
    columns : str or mapping, optional
        Names of t, id, x, y, group and person in a table: ``t=time[ms],x=pos_x[cm]``.
    on_duplicate : str
        Treatment of an id at two places at one time: error, first or mean.
    crs : str, optional
        ``degrees``: x and y are longitude and latitude, to be projected to local
        metres.
    drop_frozen : float, optional
        Drop stretches of so many s or more at exactly one place.

    Returns
    -------
    Dataset
        Times in s from the first sample of the recording, positions in m.

    Raises
    ------
    DataError
        If a file is missing or cannot be read; it names file and line, or the way out.
    """
    if sessions:
        if name is not None or len(sessions) == 1:
            raise DataError(
                "--session takes two files or more, and the place of --dataset"
            )
        name = Path(os.path.abspath(sessions[0])).parent  # noqa: PTH100 - never raises
    reading = Reading(parse_columns(columns), on_duplicate, crs, drop_frozen)
    fps = None if fps is None else check_fps(fps, where="--fps")
    if not isinstance(name, str | Path | None):
        if (format, fps) != (None, None) or persistent_ids:
            raise DataError(
                "a DataFrame has no format, no frames a second and no sessions"
            )
        return _load_frame(name, unit=unit, reading=reading)
    source = _find_source(name, download=download, format=format, fps=fps, unit=unit)
    known, path = source.known, next(iter(source.files.values()))
    _refuse_for_known(known, reading)
    session_paths = _list_sessions(path, sessions, known=known)
    if persistent_ids and not session_paths:
        raise DataError(
            "--persistent-ids is of sessions: a folder of files, or --session"
        )
    recording = _read_source(
        source, session_paths, unit=unit, same_people=persistent_ids, reading=reading
    )
    notice = (
        _unknown_sessions_notice(session_paths, known)
        or source.notice
        or _other_rate_notice(recording.sha256, known)
    )
    is_bundled = known.session is not None
    return Dataset(
        name=known.name,
        tracks=recording.tracks,
        path=f"isac_track/datasets/{path.name}" if is_bundled else shown(path),
        sha256=recording.sha256,
        format=recording.format,
        simulated=is_bundled,
        repairs=_with_doubts(known, recording, where=shown(path)),
        notice=notice,
        citation=known.citation,
        licence=known.licence,
        sessions=tuple(map(str, sessions)),
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Source:
    """A data set to read: known by name, or a file or folder."""

    known: Known
    files: Mapping[str, Path]
    notice: str | None = None  # To be shown: why this data set was chosen.


@dataclass(frozen=True, eq=False, slots=True)
class _Recording:
    """Tracks as read from files, and what was done to them."""

    tracks: Tracks
    repairs: tuple[Repair, ...]
    sha256: str
    format: str


def _read_source(
    source: _Source,
    session_paths: list[Path],
    *,
    unit: str | None,
    same_people: bool,
    reading: Reading,
) -> _Recording:
    """Read sessions, Grand Central or a single file, as the source asks."""
    known, path = source.known, next(iter(source.files.values()))
    if session_paths:
        return _read_sessions(
            session_paths, known, unit=unit, same_people=same_people, reading=reading
        )
    if known.format == GRAND_CENTRAL:
        return _read_grand_central(path, known, reading=reading)
    return _read_file(path, known, files=source.files, unit=unit, reading=reading)


def _list_sessions(
    path: Path, sessions: Sequence[str | Path], *, known: Known
) -> list[Path]:
    """Return the files that are sessions: those named, or those in a folder."""
    is_folder = os.path.isdir(path)  # noqa: PTH112 - never raises
    if sessions or known.format == GRAND_CENTRAL or not is_folder:
        return [Path(session) for session in sessions]
    return session_files(path, known.sessions or "*")


def _unknown_sessions_notice(paths: Sequence[Path], known: Known) -> str | None:
    """Return a notice of the sessions of a known data set whose hash is not known."""
    strange = [path.name for path in paths if path.name not in known.sha256]
    if not strange or known.name not in KNOWN:
        return None
    return f"{known.name}: no known hash: {shown(listed(strange))}"


def _refuse_for_known(known: Known, reading: Reading) -> None:
    """Raise DataError for options that only a file of the user's own may have."""
    if known.name in KNOWN and (reading.columns or reading.crs):
        raise DataError(f"{known.name} is known by name: leave --columns and --crs out")


def _with_doubts(
    known: Known, recording: _Recording, *, where: str
) -> tuple[Repair, ...]:
    """Return the repairs and, unless it is known by name, doubts about units."""
    if known.name in KNOWN:  # docs/how-to/data.md describes frozen tracks and units.
        return tuple(
            repair
            for repair in recording.repairs
            if repair.kind not in {"frozen", "unit"}
        )
    return (*recording.repairs, *doubts(recording.tracks, where=where))


def _load_frame(frame: object, *, unit: str | None, reading: Reading) -> Dataset:
    """Load a data frame of pandas, or of a library that converts to it."""
    import pandas as pd  # noqa: PLC0415 - `--help` stays quick

    if hasattr(frame, "collect_schema") and not hasattr(frame, "to_pandas"):
        raise DataError("a LazyFrame holds no rows yet: pass frame.collect()")
    if hasattr(frame, "to_pandas"):  # polars, pyarrow
        frame = frame.to_pandas()
    elif not isinstance(frame, pd.DataFrame) and hasattr(frame, "__dataframe__"):
        frame = pd.api.interchange.from_dataframe(frame)
    if not isinstance(frame, pd.DataFrame):
        kind = type(frame).__name__
        raise DataError(f"a recording is a name, a path or a DataFrame, not {kind}")
    rows = read_table.read_frame(frame, columns=reading.columns)
    digest = hashlib.sha256(repr((rows.ids, rows.groups, rows.unit)).encode())
    if rows.people is not None:
        digest.update(
            repr(
                [(name, label.person) for name, label in sorted(rows.people.items())]
            ).encode()
        )
    for column in (rows.person, rows.t, rows.xy):
        digest.update(
            np.ascontiguousarray(column, dtype=column.dtype.newbyteorder("<")).tobytes()
        )
    tracks, repairs = _to_tracks(rows, unit=unit, reading=reading)
    return Dataset(
        name=FRAME,
        tracks=tracks,
        path=FRAME,
        sha256=digest.hexdigest(),
        format=FRAME,
        simulated=False,
        repairs=(*repairs, *doubts(tracks, where=FRAME)),
        notice=None,
        citation="",
        licence="",
    )


def _to_tracks(
    rows: Rows,
    groups: Iterable[tuple[str, str]] = (),
    *,
    unit: str | None,
    reading: Reading,
) -> tuple[Tracks, tuple[Repair, ...]]:
    """Convert rows in any unit or in degrees to tracks; return all repairs, too."""
    if reading.crs is not None:
        if unit is not None:
            raise DataError(
                f"{rows.place.path}: --crs degrees has its unit; leave --unit out"
            )
        if rows.unit:
            path, by = rows.place.path, rows.unit_by
            raise DataError(
                f"{path}: --crs degrees contradicts {by}: lengths are in {rows.unit}"
            )
        rows = project_degrees(rows)
    else:
        rows = convert_to_metres(rows, unit=unit)
    return to_tracks(
        rows,
        groups,
        on_duplicate=reading.on_duplicate,
        drop_frozen_s=reading.drop_frozen_s,
    )


def _read_file(
    path: Path,
    known: Known,
    *,
    files: Mapping[str, Path],
    unit: str | None,
    reading: Reading,
) -> _Recording:
    """Read one file of tracks, and its file of walking groups, if any."""
    data, where = registry.read_bytes(path, data_set=known), shown(path)
    sha256 = hashlib.sha256(data).hexdigest()
    if known.session is not None:
        return _Recording(crowd.read_npz(path), (), sha256, "npz")
    format_name, notes = _choose_format(path, known.format, data=data)
    groups: list[tuple[str, str]] = []
    if GROUPS_FILE in files:
        text = registry.read_bytes(files[GROUPS_FILE], data_set=known).decode()
        for line in text.splitlines():
            # A line holds the ids of a group; the first id serves as its label.
            members = line.split()
            groups += [(member, members[0]) for member in members]
    tracks, repairs = read(
        data=data,
        path=where,
        format=format_name,
        fps=known.fps,
        unit=unit or known.unit or None,
        groups=groups,
        withdrawn=known.withdrawn.get(path.name, {}),
        reading=reading,
    )
    return _Recording(tracks, (*notes, *repairs), sha256, format_name)


def _refuse_copies(paths: list[Path], known: Known) -> None:
    """Raise DataError if two files hold the same bytes: nobody comes back in a copy."""
    first_paths: dict[str, Path] = {}
    for path in paths:
        sha256 = hashlib.sha256(registry.read_bytes(path, data_set=known)).hexdigest()
        first = first_paths.setdefault(sha256, path)
        if first is not path:
            pair = f"sessions {shown(first)} and {shown(path)}"
            raise DataError(
                f"{pair} hold the same bytes, one recording twice; leave out one"
            )


def _other_rate_notice(sha256: str, source: Known) -> str | None:
    """Return a notice if a file is a known data set, read at another frame rate."""
    if source.name in KNOWN or source.fps is None:
        return None
    for name, known in KNOWN.items():
        is_same_file = sha256 in known.sha256.values()
        if is_same_file and known.fps is not None and source.fps != known.fps:
            return (
                f"these are the bytes of {name}, recorded at {known.fps:g} frames/s,"
                f" read at {source.fps:g}: speeds are {source.fps / known.fps:.2g}"
                " times what they were"
            )
    return None


def _read_sessions(
    paths: list[Path],
    known: Known,
    *,
    unit: str | None,
    same_people: bool,
    reading: Reading,
) -> _Recording:
    """Read files that are sessions; the digest is over the lines of sha256sum."""
    _refuse_copies(paths, known)
    sessions: list[Session] = []
    notes: list[Repair] = []
    digest, formats = hashlib.sha256(), set[str]()
    names_people: dict[str, bool] = {}
    for path in paths:
        data, where = registry.read_bytes(path, data_set=known), shown(path)
        format_name, format_notes = _choose_format(path, known.format, data=data)
        header = read_frames.read_header(format_name, data=data, path=where)
        tracks, repairs = read(
            data=data,
            path=where,
            format=format_name,
            fps=known.fps,
            unit=unit or known.unit or None,
            withdrawn=known.withdrawn.get(path.name, {}),
            reading=reading,
        )
        name = shown(path.stem)
        names_people[name] = any(note.kind == people.KIND for note in repairs)
        file_unit = unit or header.unit or known.unit or "m"
        sessions.append(Session(name, tracks, file_unit))
        notes += [*format_notes, *repairs]
        digest.update(
            f"{hashlib.sha256(data).hexdigest()}  {path.name}\n".encode(
                errors="replace"
            )
        )
        formats.add(format_name)
    _refuse_mixed_people(names_people)
    same_people = same_people or all(names_people.values())
    return _Recording(
        join_sessions(sessions, same_people=same_people),
        tuple(notes),
        digest.hexdigest(),
        " ".join(sorted(formats)),
    )


def _refuse_mixed_people(names_people: Mapping[str, bool]) -> None:
    """Raise DataError if only some sessions name their people."""
    if len(set(names_people.values())) < 2:  # noqa: PLR2004 - all or none
        return
    first = next(session for session in names_people if names_people[session])
    other = next(session for session in names_people if not names_people[session])
    raise DataError(
        f"sessions {first} and {other}: the first alone names people (by labels, a"
        " markerID or a column person), so that ids clash; name them in the other,"
        " too, or leave them out"
    )


def _find_source(
    name: str | Path | None,
    *,
    download: bool,
    format: str | None,  # noqa: A002 - the name of the option
    fps: float | None,
    unit: str | None,
) -> _Source:
    """Return the data set that a name or path means, its files, and a notice."""
    text = str(name or "")
    # A mistyped name is no path, if nothing in it looks like a path.
    looks_like_path = os.sep in text or "." in text or os.path.exists(text)  # noqa: PTH110 - never raises
    if isinstance(name, Path) or (looks_like_path and name not in KNOWN):
        path = Path(text)
        # Rows of another recording must never pass for those of a known recording.
        title = shown(path.name if path.stem in KNOWN else path.stem)
        own = Known(title, format=format or "", fps=fps)
        return _Source(own, {registry.MAIN_FILE: path})
    is_preferred = name is not None or bool(registry.locate(KNOWN[DEFAULT])[0])
    if name is None:
        text = DEFAULT if is_preferred else FALLBACK
    known = registry.known(text)
    if (format, fps, unit) != (None, None, None):
        raise DataError(
            f"{'the default data set' if name is None else known.name} is known by"
            " name: leave --format, --fps and --unit out (they describe a file of your"
            " own)"
        )
    if known.session is None:
        may_download = download and name is not None
        files = registry.find_data_files(known, download=may_download)
        return _Source(known, files)
    notice = (
        f"{DEFAULT} is not here ({registry.describe_lookup()}): using the bundled"
        f" simulated crowd {FALLBACK}. To get it: python -m isac_track.datasets fetch"
        f" {DEFAULT}"
    )
    files = {registry.MAIN_FILE: crowd.bundled_path(known.session)}
    return _Source(known, files, None if is_preferred else notice)


def _read_grand_central(path: Path, known: Known, *, reading: Reading) -> _Recording:
    """Read a folder or archive of the format `GRAND_CENTRAL`."""
    if known.fps is not None:
        raise DataError(
            f"{shown(path)}: format {GRAND_CENTRAL} has its own clock; leave --fps out"
        )
    rows, digest = read_gc.read_gc(path, where=shown(path))
    registry.check(path, known, file_name=registry.WHOLE, actual=digest)
    _no_columns(reading, format_name=GRAND_CENTRAL, path=shown(path))
    tracks, repairs = _to_tracks(rows, unit=None, reading=reading)
    fast = read_gc.note_fast_tracks(tracks, where=shown(path))
    return _Recording(tracks, (*repairs, *fast), digest, GRAND_CENTRAL)


def _choose_format(
    path: Path, name: str, *, data: bytes
) -> tuple[str, tuple[Repair, ...]]:
    """Return the format as named, by extension or by header, and a note of the header.

    The number of columns is no guide: it does not tell an id from a frame.
    """
    name = name or _EXTENSIONS.get(path.suffix.lower(), "")
    known = ", ".join((*READERS, GRAND_CENTRAL))
    if not name:
        where = shown(path)
        if convert := _CONVERTED.get(path.suffix.lower()):
            raise DataError(
                f"{where}: not read as it is; save it as csv first, in Python:"
                f" {convert}"
            )
        header = read_frames.read_header("pedpy", data=data, path=where)
        if header.columns:
            rate = "" if header.fps is None else f", {header.fps:g} frames a second"
            order = sorted(header.columns, key=lambda column: header.columns[column])
            detail = (
                f"{where}: line {header.line} names the columns:"
                f" {' '.join(order)}{rate}"
            )
            return "pedpy", (Repair("header", 1, detail),)
        raise DataError(
            f"{where}: the format is not known from the name, and no header names id,"
            f" frame, x and y; give --format ({known})"
        )
    if name not in READERS:
        hint = did_you_mean(str(name), READERS)
        raise DataError(f"unknown format {name!r:.40}{hint} (known: {known})")
    return name, ()


def read(
    *,
    data: bytes,
    path: str,
    format: str,  # noqa: A002 - the name of the option
    fps: float | None = None,
    unit: str | None = None,
    groups: Iterable[tuple[str, str]] = (),
    withdrawn: Mapping[str, str] = {},
    reading: Reading = Reading(),  # noqa: B008 - frozen
) -> tuple[Tracks, tuple[Repair, ...]]:
    """Return the tracks in the bytes of one file, and what was mended or left out.

    `path` is the file's name for messages, and `format` one of `READERS`. `fps`, frames
    a second, is for formats that count frames; `unit` of length is m if neither it nor
    the file says. `groups` are (id, label) pairs of people who walk together, from
    another file. `withdrawn` are labels of people that are not believed, by passage, with
    the reason. `reading` holds further options. DataError names file and line of
    anything that cannot be read as tracks.
    """
    if fps is not None:
        check_fps(fps, where="--fps")
    if fps is not None and format in _WITH_CLOCK:
        frames = (
            "; of frames: --columns 't=frame[25 fps]'"
            if format in _WITH_COLUMNS
            else ""
        )
        raise DataError(
            f"{path}: format {format} has times in seconds; leave --fps out{frames}"
        )
    options: dict[str, object] = {}
    if format in _WITH_COLUMNS:
        options["columns"] = reading.columns
    else:
        _no_columns(reading, format_name=format, path=path)
    if format not in _WITH_CLOCK:
        options["fps"] = fps
    # The rows have no name here: they are freed as soon as they are sorted.
    return _to_tracks(
        people.withdraw(READERS[format](data=data, path=path, **options), withdrawn),
        groups,
        unit=unit,
        reading=reading,
    )


def _no_columns(reading: Reading, *, format_name: str, path: str) -> None:
    """Raise DataError if column names are given for a format without such names."""
    if reading.columns:
        raise DataError(
            f"{path}: --columns is of csv and parquet, not of {format_name}"
        )


def doubts(tracks: Tracks, *, where: str) -> tuple[Repair, ...]:
    """Return a doubt if the units of a recording may be wrong, with a likely cause.

    That is if its median speed while moving is not within `WALKING_MPS`, or its median
    step is over `STEP_S`.
    """
    within = steps_within(tracks.offsets)
    step_s = np.diff(tracks.t)[within]
    length_m = np.linalg.norm(np.diff(tracks.xy, axis=0)[within], axis=1)
    usual_s, moving = float(np.median(step_s)), length_m > 0
    speed = (
        float(np.median(length_m[moving] / step_s[moving])) if moving.any() else np.nan
    )
    low, high = WALKING_MPS
    is_slow, is_fast, is_coarse = speed < low, speed > high, usual_s > STEP_S
    if not (is_slow or is_fast or is_coarse):
        return ()
    causes = (
        ("feet for metres: --unit ft", 0.3048, is_fast),
        ("decimetres for metres: --unit 0.1", 0.1, is_fast),
        ("a frame rate twice too high", 0.5, is_fast),
        ("frame numbers for seconds, as at 10 a second", 10.0, not is_fast),
        ("frame numbers for seconds, as at 25 a second", 25.0, not is_fast),
        ("milliseconds for seconds", 1000.0, not is_fast),
    )
    likely = []
    for cause, factor, is_possible in causes:
        corrected = speed * factor
        if is_possible and USUAL_MPS[0] <= corrected <= USUAL_MPS[1]:
            error = abs(np.log(corrected / WALK_MPS))
            likely.append((error, f"{cause} (makes {corrected:.2g} m/s)"))
    guess = "; is the clock in seconds, are lengths in metres"
    if likely:
        guess = f"; likely {min(likely)[1]}"
    text = f"median speed {speed:.2f} m/s, a sample every {usual_s:.2g} s{guess}"
    return (Repair("doubt", 1, f"{where}: units may be wrong: {text}?"),)


def summarise(tracks: Tracks) -> DataFrame:
    """Return the statistics of every track; a step is from one sample to the next.

    The N rows have `steps`, their number; `duration_s`; `speed_mean_mps`, the length of
    the path over the duration; `speed_sd_mps`, the standard deviation over time of the
    step speed; `slow_share` and `still_share`, the shares of steps slower than
    `SLOW_MPS` and of exactly no length (all four NaN for a single sample); and
    `frozen`, whether the track is nearly frozen.
    """
    import pandas as pd  # noqa: PLC0415 - `--help` stays quick

    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    steps = last - first
    owner = np.repeat(np.arange(len(tracks)), steps)
    within = steps_within(tracks.offsets)
    length = np.linalg.norm(np.diff(tracks.xy, axis=0), axis=1)[within]
    lasting = np.diff(tracks.t)[within]
    speed = length / lasting

    def per_track(values: Floats | Bools) -> Floats:
        return np.bincount(owner, weights=values, minlength=len(tracks)).astype(
            np.float64
        )

    duration = tracks.t[last] - tracks.t[first]
    # 0 / 0 of a single sample is NaN.
    with np.errstate(invalid="ignore"):
        mean = per_track(length) / duration
        summary = {
            "steps": steps,
            "duration_s": duration,
            "speed_mean_mps": mean,
            "speed_sd_mps": np.sqrt(
                per_track((speed - mean[owner]) ** 2 * lasting) / duration
            ),
            "slow_share": per_track(speed < SLOW_MPS) / steps,
            "still_share": per_track(length == 0) / steps,
        }
    return pd.DataFrame(summary | {"frozen": summary["still_share"] >= FROZEN_SHARE})


def still_share(summary: DataFrame) -> float:
    """Return the share of exactly-zero steps among all steps; NaN without steps."""
    n_steps = summary["steps"].sum()
    if not n_steps:
        return np.nan
    return float((summary["still_share"] * summary["steps"]).sum() / n_steps)


def n_lasting(summary: DataFrame, duration_s: float) -> int:
    """Return the number of tracks that last at least this long."""
    # The clock rounds: 21.6 s at 25 frames a second is 540 frames.
    return int((summary["duration_s"] >= duration_s - 1e-9).sum())
