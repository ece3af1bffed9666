"""Pedestrian tracks by name or from a file of one's own.

``load("students03")``, ``load("plaza")``, ``load("walk.csv")``, and ``load()`` for the
best that is here. A format is told, or named by the file's extension, never guessed.
`registry` knows the names and places, `repair` what is mended on reading;
``docs/data.md`` describes it all.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from isac_track.datasets import (
    crowd,
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
    checked_fps,
    columns_named,
    in_metres,
    listed,
    projected,
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
from isac_track.datasets.sessions import as_one
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
"""Each turns the bytes of a file into rows, and lets no error but `DataError` out."""
TOOLS: Mapping[str, Callable[..., Rows]] = {
    "jupedsim": read_tools.read_jupedsim,
    "hdf5": read_tools.read_hdf5,
    "vadere": read_tools.read_vadere,
    "mot": read_tools.read_mot,
    "sdd": read_tools.read_sdd,
    "viswalk": read_tools.read_viswalk,
}
"""The same for what other tools write."""
READERS: Mapping[str, Callable[..., Rows]] = {**FORMATS, **TOOLS}
_WITH_COLUMNS = ("csv", "parquet")  # Their columns have names,
_WITH_CLOCK = (
    *_WITH_COLUMNS,
    "vadere",
    "viswalk",
)  # and their times are seconds, not frames.
FRAME = "DataFrame"  # Name, path and format of a recording that is none of a file.
WALKING_MPS = (0.15, 2.5)  # Of the median speed; beyond, the units are in doubt.
WALK_MPS = 1.2  # What most people walk at.
USUAL_MPS = (0.4, 2.2)  # Of people who walk: what another unit would have to explain.
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
"""How files of other kinds become a csv, by their extension."""
# Tracks, repairs, hash, format.
_Read: TypeAlias = "tuple[Tracks, tuple[Repair, ...], str, str]"
SLOW_MPS = 0.2  # Slower steps than this are not walking.
FROZEN_SHARE = 0.9
"""Of steps of no length in a nearly frozen track: an annotation whose end tells the whole walk."""


@dataclass(frozen=True, eq=False, slots=True)
class Dataset:
    """Tracks, where they come from, and what was done to them on reading."""

    name: str  # Name in the registry, or of the file.
    tracks: Tracks
    path: str  # Where it was found; for bundled data relative to the package.
    sha256: str  # Hash of the main file.
    format: str
    # True for the bundled crowd; of a file of one's own nothing is known: False.
    simulated: bool
    repairs: tuple[Repair, ...]
    notice: (
        str | None
    )  # Says that another data set than the preferred one was taken; to be shown.
    citation: str  # Whom to credit; empty if unknown.
    licence: str  # Empty if unknown.
    sessions: tuple[str, ...] = ()  # Paths of the files that were named as sessions.

    def __repr__(self) -> str:
        """Return which recording it is and how large, in a line."""
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
        A known name, or else the path of a file, or of a folder of sessions, or a data
        frame of pandas or polars with the columns of a csv. Without it: students03 if
        it is here, otherwise the bundled crowd plaza, with a notice; never a download.
    format : str, optional
        Format of a file; ``.csv``, ``.parquet`` and ``.ndjson`` (trajnet) name theirs,
        and so does a header as PeTrack and PedPy write it, which names the columns.
    fps : float, optional
        Frames per second, for a format that counts frames, unless the file says so.
    unit : str, optional
        Of the lengths in a file: m (the default), cm or mm, unless the file says so.
    download : bool
        Whether a known data set that was named may be downloaded if it is not here.
    sessions : sequence of str or Path
        Two files or more that are sessions of one recording, instead of a name.
    persistent_ids : bool
        Whether an id is the same person in all sessions. Where a header names a
        markerID, as PeTrack's do, that says who it is, in any case.
    columns : str or mapping, optional
        What t, id, x, y and group are called in a table: ``t=time[ms],x=pos_x[cm]``.
    on_duplicate : str
        What is done with an id at two places at one time: error, first or mean.
    crs : str, optional
        ``degrees``: x and y are longitude and latitude, to be projected to local
        metres.
    drop_frozen : float, optional
        Stretches of so many s or more at exactly one place are dropped.

    Returns
    -------
    Dataset
        Times in s from the first sample of the recording, positions in m. What cannot
        be had or read is a DataError that names file and line, or the way out.
    """
    if sessions:
        if name is not None or len(sessions) == 1:
            raise DataError(
                "--session takes two files or more, and the place of --dataset"
            )
        name = Path(os.path.abspath(sessions[0])).parent  # noqa: PTH100 - never raises
    reading = Reading(columns_named(columns), on_duplicate, crs, drop_frozen)
    fps = None if fps is None else checked_fps(fps, where="--fps")
    if not isinstance(name, str | Path | None):
        if (format, fps) != (None, None) or persistent_ids:
            raise DataError(
                "a DataFrame has no format, frames a second or sessions to be told"
            )
        return _of_frame(name, unit=unit, reading=reading)
    source, files, notice = _found(
        name, download=download, format=format, fps=fps, unit=unit
    )
    _refuse_for_known(source, reading)
    path = next(iter(files.values()))
    is_central = source.format == GRAND_CENTRAL
    several = _several(path, sessions, source=source)
    if persistent_ids and not several:
        raise DataError(
            "--persistent-ids is of sessions: a folder of files, or --session"
        )
    if several:
        found = _sessions(
            several, source, unit=unit, same_people=persistent_ids, reading=reading
        )
        strange = [one.name for one in several if one.name not in source.sha256]
        if strange and source.name in KNOWN:
            notice = f"{source.name}: no known hash: {shown(listed(strange))}"
    elif is_central:
        found = _grand_central(path, source, reading=reading)
    else:
        found = _one_file(path, source, files=files, unit=unit, reading=reading)
    tracks, repairs, sha256, format_name = found
    notice = notice or _of_registered(sha256, source)
    repairs = _with_doubts(source, tracks, repairs, where=shown(path))
    return Dataset(
        name=source.name,
        tracks=tracks,
        path=(
            shown(path)
            if source.session is None
            else f"isac_track/datasets/{path.name}"
        ),
        sha256=sha256,
        format=format_name,
        simulated=source.session is not None,
        repairs=repairs,
        notice=notice,
        citation=source.citation,
        licence=source.licence,
        sessions=tuple(map(str, sessions)),
    )


def _several(
    path: Path, sessions: Sequence[str | Path], *, source: Known
) -> list[Path]:
    """Return the files that are sessions: those named, or those in a folder."""
    is_folder = os.path.isdir(path)  # noqa: PTH112 - never raises
    if sessions or source.format == GRAND_CENTRAL or not is_folder:
        return [Path(session) for session in sessions]
    return session_files(path, source.sessions or "*")


def _refuse_for_known(source: Known, reading: Reading) -> None:
    if source.name in KNOWN and (reading.columns or reading.crs):
        raise DataError(
            f"{source.name} is known by name: leave --columns and --crs out"
        )


def _with_doubts(
    source: Known, tracks: Tracks, repairs: tuple[Repair, ...], *, where: str
) -> tuple[Repair, ...]:
    """Return repairs, and what is in doubt of a recording that is not known by name."""
    if source.name in KNOWN:  # docs/data.md says how much of these stands.
        return tuple(repair for repair in repairs if repair.kind != "frozen")
    return (*repairs, *doubts(tracks, where=where))


def _of_frame(frame: object, *, unit: str | None, reading: Reading) -> Dataset:
    """Return the recording in a data frame of pandas, or of a library that converts to it."""
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
    for column in (rows.person, rows.t, rows.xy):
        digest.update(
            np.ascontiguousarray(column, dtype=column.dtype.newbyteorder("<")).tobytes()
        )
    tracks, repairs = _tracks_of(rows, unit=unit, reading=reading)
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


def _tracks_of(
    rows: Rows,
    groups: Iterable[tuple[str, str]] = (),
    *,
    unit: str | None,
    reading: Reading,
) -> tuple[Tracks, tuple[Repair, ...]]:
    """Return the tracks of rows in any unit or in degrees, and what was mended."""
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
        rows = projected(rows)
    else:
        rows = in_metres(rows, unit=unit)
    return to_tracks(
        rows,
        groups,
        on_duplicate=reading.on_duplicate,
        drop_frozen_s=reading.drop_frozen_s,
    )


def _one_file(
    path: Path,
    source: Known,
    *,
    files: Mapping[str, Path],
    unit: str | None,
    reading: Reading,
) -> _Read:
    """Return the tracks of one file, what was mended, its hash and format."""
    data, where = registry.read_bytes(path, data_set=source), shown(path)
    sha256 = hashlib.sha256(data).hexdigest()
    if source.session is not None:
        return crowd.read_npz(path), (), sha256, "npz"
    name, found = _format_of(path, source.format, data=data)
    groups = []
    if GROUPS_FILE in files:
        lines = (
            registry.read_bytes(files[GROUPS_FILE], data_set=source)
            .decode()
            .splitlines()
        )
        groups = [
            (member, line.split()[0]) for line in lines for member in line.split()
        ]
    tracks, repairs = read(
        data=data,
        path=where,
        format=name,
        fps=source.fps,
        unit=unit,
        groups=groups,
        reading=reading,
    )
    return tracks, (*found, *repairs), sha256, name


def _refuse_copies(paths: list[Path], source: Known) -> None:
    """Raise DataError if two files hold the same bytes: nobody comes back in a copy."""
    first_of: dict[str, Path] = {}
    for path in paths:
        sha256 = hashlib.sha256(registry.read_bytes(path, data_set=source)).hexdigest()
        first = first_of.setdefault(sha256, path)
        if first is not path:
            both = f"sessions {shown(first)} and {shown(path)}"
            raise DataError(
                f"{both} hold the same bytes, one recording twice; leave out one"
            )


def _of_registered(sha256: str, source: Known) -> str | None:
    """Return a notice if a file of one's own is a known data set under another rate."""
    for name, known in KNOWN.items():
        is_of_it = source.name not in KNOWN and sha256 in known.sha256.values()
        if is_of_it and None not in (known.fps, source.fps) and source.fps != known.fps:
            assert known.fps is not None
            assert source.fps is not None
            return (
                f"these are the bytes of {name}, recorded at {known.fps:g} frames/s,"
                f" read at {source.fps:g}: speeds are {source.fps / known.fps:.2g}"
                " times what they were"
            )
    return None


def _sessions(
    paths: list[Path],
    source: Known,
    *,
    unit: str | None,
    same_people: bool,
    reading: Reading,
) -> _Read:
    """Return what sessions hold, as `_one_file` does; the digest is over the lines of sha256sum."""
    parts, notes, digest, formats, marked = (
        [],
        list[Repair](),
        hashlib.sha256(),
        set(),
        {},
    )
    _refuse_copies(paths, source)
    for path in paths:
        data, where = registry.read_bytes(path, data_set=source), shown(path)
        format_name, found = _format_of(path, source.format, data=data)
        header = read_frames.read_header(format_name, data=data, path=where)
        by = marked[path.stem] = header.marker is not None
        tracks, repairs = read(
            data=data,
            path=where,
            format=format_name,
            fps=source.fps,
            unit=unit,
            by_marker=by,
            reading=reading,
        )
        if by:  # Who wears no marker is nobody whom another session knows.
            own = [
                f"{path.stem}:{who}" if who.startswith("-") else who
                for who in tracks.group
            ]
            tracks = replace(tracks, person=tuple(own))
        parts.append((shown(path.stem), tracks, unit or header.unit or "m"))
        notes += [*found, *repairs]
        digest.update(
            f"{hashlib.sha256(data).hexdigest()}  {path.name}\n".encode(
                errors="replace"
            )
        )
        formats.add(format_name)
    if len(set(marked.values())) > 1:
        one, other = (
            next(at for at in marked if marked[at] is is_so) for is_so in (True, False)
        )
        raise DataError(
            f"sessions {shown(one)} and {shown(other)}: a header names a markerID in"
            " the first alone, so that ids clash; leave the column out there, or add"
            " it to the other"
        )
    tracks = as_one(parts, same_people=same_people or all(marked.values()))
    return tracks, tuple(notes), digest.hexdigest(), " ".join(sorted(formats))


def _found(
    name: str | Path | None,
    *,
    download: bool,
    format: str | None,  # noqa: A002 - the name of the option
    fps: float | None,
    unit: str | None,
) -> tuple[Known, dict[str, Path], str | None]:
    """Return what is meant by a name or path, its files, and what is to be said of the choice."""
    said = str(name or "")
    # A mistyped name is no path, if nothing in it looks like one.
    looks = os.sep in said or "." in said or os.path.exists(said)  # noqa: PTH110 - never raises
    if isinstance(name, Path) or (looks and name not in KNOWN):
        path = Path(said)
        # Rows of another recording must never pass for those of a known one.
        title = shown(path.name if path.stem in KNOWN else path.stem)
        return (
            Known(title, format=format or "", fps=fps),
            {registry.MAIN_FILE: path},
            None,
        )
    is_asked = name is not None or bool(registry.locate(KNOWN[DEFAULT])[0])
    source = registry.known(
        (DEFAULT if is_asked else FALLBACK) if name is None else said
    )
    if (format, fps, unit) != (None, None, None):
        raise DataError(
            f"{'the default data set' if name is None else source.name} is known by"
            " name: leave --format, --fps and --unit out (they describe a file of your"
            " own)"
        )
    if source.session is None:
        return (
            source,
            registry.files_of(source, download=download and name is not None),
            None,
        )
    notice = (
        f"{DEFAULT} is not here ({registry.searched()}): using the bundled simulated "
        f"crowd {FALLBACK}. To get it: python -m isac_track.datasets fetch {DEFAULT}"
    )
    files = {registry.MAIN_FILE: crowd.bundled_path(source.session)}
    return source, files, None if is_asked else notice


def _grand_central(path: Path, source: Known, *, reading: Reading) -> _Read:
    """Return the tracks of a folder or archive of `GRAND_CENTRAL`, as `_one_file` does."""
    if source.fps is not None:
        raise DataError(
            f"{shown(path)}: format {GRAND_CENTRAL} has its own clock; leave --fps out"
        )
    rows, digest = read_gc.read_gc(path, where=shown(path))
    registry.check(path, source, file_name=registry.WHOLE, actual=digest)
    _no_columns(reading, format_name=GRAND_CENTRAL, path=shown(path))
    tracks, repairs = _tracks_of(rows, unit=None, reading=reading)
    fast = read_gc.fast_pieces(tracks, where=shown(path))
    return tracks, (*repairs, *fast), digest, GRAND_CENTRAL


def _format_of(path: Path, name: str, *, data: bytes) -> tuple[str, tuple[Repair, ...]]:
    """Return the format, as named, by extension or by header; columns tell no id from frame."""
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
    by_marker: bool = False,
    reading: Reading = Reading(),  # noqa: B008 - frozen
) -> tuple[Tracks, tuple[Repair, ...]]:
    """Return the tracks in the bytes of one file, and what was mended or left out.

    `path` is its name, for messages, and `format` one of `READERS`; `fps`, frames a
    second, is for those that count frames; `unit`, of lengths, is m if neither it nor
    the file says. `groups` are (id, label) pairs of who walks together, if that is in
    another file. `by_marker`: who it is says the marker that a pedpy header names.
    `reading` is what else is known of it. DataError names file and line for anything
    that cannot be read as tracks.
    """
    if fps is not None:
        checked_fps(fps, where="--fps")
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
    if by_marker:
        options["by_marker"] = True
    # The rows have no name here: they are let go as soon as they are sorted.
    return _tracks_of(
        READERS[format](data=data, path=path, **options),
        groups,
        unit=unit,
        reading=reading,
    )


def _no_columns(reading: Reading, *, format_name: str, path: str) -> None:
    if reading.columns:
        raise DataError(
            f"{path}: --columns is of csv and parquet, not of {format_name}"
        )


def doubts(tracks: Tracks, *, where: str) -> tuple[Repair, ...]:
    """Return why the units of a recording of one's own may be wrong, and what they may be.

    Its median speed while moving is not within `WALKING_MPS`, or its median step over
    `STEP_S`.
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
    causes = [
        (
            abs(np.log(speed * factor / WALK_MPS)),
            f"{cause} (makes {speed * factor:.2g} m/s)",
        )
        for cause, factor, is_so in (
            ("feet for metres: --unit ft", 0.3048, is_fast),
            ("decimetres for metres: --unit 0.1", 0.1, is_fast),
            ("a frame rate twice too high", 0.5, is_fast),
            ("frame numbers for seconds, as at 10 a second", 10.0, not is_fast),
            ("frame numbers for seconds, as at 25 a second", 25.0, not is_fast),
            ("milliseconds for seconds", 1000.0, not is_fast),
        )
        if is_so and USUAL_MPS[0] <= speed * factor <= USUAL_MPS[1]
    ]
    guess = (
        f"; likely {min(causes)[1]}"
        if causes
        else "; is the clock in seconds, are lengths in metres"
    )
    text = f"median speed {speed:.2f} m/s, a sample every {usual_s:.2g} s{guess}"
    return (Repair("doubt", 1, f"{where}: units may be wrong: {text}?"),)


def summarise(tracks: Tracks) -> DataFrame:
    """Return the statistics of every track; a step is from one sample to the next.

    The N rows have `steps`, their number; `duration_s`; `speed_mean_mps`, the length of
    the path over the duration; `speed_sd_mps`, the standard deviation over time of the
    step speed; `slow_share` and `still_share`, the shares of steps slower than
    `SLOW_MPS` and of exactly no length (all four NaN for a single sample); and
    `frozen`, nearly frozen tracks.
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
    with np.errstate(invalid="ignore"):  # 0 / 0 of a single sample is NaN, as promised
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
    return (
        float((summary["still_share"] * summary["steps"]).sum() / n_steps)
        if n_steps
        else np.nan
    )


def n_lasting(summary: DataFrame, duration_s: float) -> int:
    """Return how many tracks last at least this long."""
    # The clock rounds: 21.6 s at 25 frames a second is 540 frames.
    return int((summary["duration_s"] >= duration_s - 1e-9).sum())
