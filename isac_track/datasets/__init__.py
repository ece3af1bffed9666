"""Pedestrian tracks by name or from a file of one's own.

``load("students03")``, ``load("plaza")``, ``load("walk.csv")``, and ``load()`` for the best
that is here. A format is told, or named by the file's extension, never guessed. `registry` knows
the names and places, `repair` what is mended on reading; ``docs/data.md`` describes it all.
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

from isac_track.datasets import crowd, read_frames, read_gc, read_table, registry
from isac_track.datasets.recording import Repair, Rows, checked_fps, in_metres, listed, steps_within
from isac_track.datasets.registry import DEFAULT, FALLBACK, GROUPS_FILE, KNOWN, Known, shown
from isac_track.datasets.repair import to_tracks
from isac_track.datasets.sessions import as_one
from isac_track.datasets.sessions import files_in as session_files
from isac_track.errors import DataError, did_you_mean
from isac_track.types import Bools, Floats, Tracks

if TYPE_CHECKING:
    from pandas import DataFrame


__all__ = ["FORMATS", "Dataset", "Repair", "load", "read", "summarise"]

FORMATS: Mapping[str, Callable[..., Rows]] = {
    **{name: partial(read_frames.read_columns, name) for name in read_frames.COLUMNS},
    "trajnet": read_frames.read_trajnet,
    "csv": read_table.read_csv,
    "parquet": read_table.read_parquet,
}
"""Each turns the bytes of a file into rows, and lets no error but `DataError` out."""
_WITH_CLOCK = ("csv", "parquet")  # Their times are seconds, not frames.
GRAND_CENTRAL = "gc"  # The format of an archive or a folder, as `read_gc` describes it.
_EXTENSIONS = {".csv": "csv", ".parquet": "parquet", ".ndjson": "trajnet"}
_Read: TypeAlias = "tuple[Tracks, tuple[Repair, ...], str, str]"  # Tracks, repairs, hash, format.
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
    simulated: bool  # True for the bundled crowd; of a file of one's own nothing is known: False.
    repairs: tuple[Repair, ...]
    notice: str | None  # Says that another data set than the preferred one was taken; to be shown.
    citation: str  # Whom to credit; empty if unknown.
    licence: str  # Empty if unknown.
    sessions: tuple[str, ...] = ()  # Paths of the files that were named as sessions.


def load(
    name: str | Path | None = None,
    *,
    format: str | None = None,  # noqa: A002 - the name of the option
    fps: float | None = None,
    unit: str | None = None,
    download: bool = True,
    sessions: Sequence[str | Path] = (),
    persistent_ids: bool = False,
) -> Dataset:
    """Load a known data set, a file, or the best data set that is on this machine.

    Parameters
    ----------
    name : str or Path, optional
        A known name, or else the path of a file, or of a folder of sessions. Without it: students03
        if it is here, otherwise the bundled crowd plaza, with a notice; never a download.
    format : str, optional
        Format of a file; ``.csv``, ``.parquet`` and ``.ndjson`` (trajnet) name theirs, and so does
        a header as PeTrack and PedPy write it, which names the columns.
    fps : float, optional
        Frames per second, for a format that counts frames, unless the file says so.
    unit : str, optional
        Of the lengths in a file: m (the default), cm or mm, unless the file says so.
    download : bool
        Whether a known data set that was named may be downloaded if it is not here.
    sessions : sequence of str or Path
        Two files or more that are sessions of one recording, instead of a name.
    persistent_ids : bool
        Whether an id is the same person in all sessions. Where a header names a markerID, as
        PeTrack's do, that says who it is, in any case.

    Returns
    -------
    Dataset
        Times in s from the first sample of the recording, positions in m. What cannot be had or
        read is a DataError that names file and line, or the way out.
    """
    if sessions and (name is not None or len(sessions) == 1):
        raise DataError("--session takes two files or more, and the place of --dataset")
    if sessions:
        name = Path(os.path.abspath(sessions[0])).parent  # noqa: PTH100 - never raises
    source, files, notice = _found(name, download=download, format=format, fps=fps, unit=unit)
    path = next(iter(files.values()))
    is_central = source.format == GRAND_CENTRAL
    several = [Path(one) for one in sessions]
    if not several and not is_central and os.path.isdir(path):  # noqa: PTH112 - never raises
        several = session_files(path, source.sessions or "*")
    if persistent_ids and not several:
        raise DataError("--persistent-ids is of sessions: a folder of files, or --session")
    if several:
        found = _sessions(several, source, unit=unit, same_people=persistent_ids)
        strange = [one.name for one in several if one.name not in source.sha256]
        if strange and source.name in KNOWN:
            notice = f"{source.name}: no known hash: {shown(listed(strange))}"
    elif is_central:
        found = _grand_central(path, source)
    else:
        found = _one_file(path, source, files=files, unit=unit)
    tracks, repairs, sha256, format_name = found
    if source.name in KNOWN:  # docs/data.md says how much of these stands.
        repairs = tuple(repair for repair in repairs if repair.kind != "frozen")
    return Dataset(
        name=source.name,
        tracks=tracks,
        path=shown(path) if source.session is None else f"isac_track/datasets/{path.name}",
        sha256=sha256,
        format=format_name,
        simulated=source.session is not None,
        repairs=repairs,
        notice=notice,
        citation=source.citation,
        licence=source.licence,
        sessions=tuple(map(str, sessions)),
    )


def _one_file(path: Path, source: Known, *, files: Mapping[str, Path], unit: str | None) -> _Read:
    """Return the tracks of one file, what was mended, its hash and format."""
    data, where = registry.read_bytes(path, data_set=source), shown(path)
    sha256 = hashlib.sha256(data).hexdigest()
    if source.session is not None:
        return crowd.read_npz(path), (), sha256, "npz"
    name, found = _format_of(path, source.format, data=data)
    groups = []
    if GROUPS_FILE in files:
        lines = registry.read_bytes(files[GROUPS_FILE], data_set=source).decode().splitlines()
        groups = [(member, line.split()[0]) for line in lines for member in line.split()]
    tracks, repairs = read(
        data=data, path=where, format=name, fps=source.fps, unit=unit, groups=groups
    )
    return tracks, (*found, *repairs), sha256, name


def _sessions(paths: list[Path], source: Known, *, unit: str | None, same_people: bool) -> _Read:
    """Return what sessions hold, as `_one_file` does; the digest is over the lines of sha256sum."""
    parts, notes, digest, formats, marked = [], list[Repair](), hashlib.sha256(), set(), {}
    for path in paths:
        data, where = registry.read_bytes(path, data_set=source), shown(path)
        format_name, found = _format_of(path, source.format, data=data)
        header = read_frames.read_header(format_name, data=data, path=where)
        by = marked[path.stem] = header.marker is not None
        tracks, repairs = read(
            data=data, path=where, format=format_name, fps=source.fps, unit=unit, by_marker=by
        )
        if by:  # Who wears no marker is nobody whom another session knows.
            own = [f"{path.stem}:{who}" if who.startswith("-") else who for who in tracks.group]
            tracks = replace(tracks, person=tuple(own))
        parts.append((shown(path.stem), tracks, unit or header.unit or "m"))
        notes += [*found, *repairs]
        digest.update(f"{hashlib.sha256(data).hexdigest()}  {path.name}\n".encode(errors="replace"))
        formats.add(format_name)
    if len(set(marked.values())) > 1:
        one, other = (next(at for at in marked if marked[at] is is_so) for is_so in (True, False))
        raise DataError(
            f"sessions {shown(one)} and {shown(other)}: a header names a markerID in the first "
            "alone, so that ids clash; leave the column out there, or add it to the other"
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
        return Known(title, format=format or "", fps=fps), {registry.MAIN_FILE: path}, None
    is_asked = name is not None or bool(registry.locate(KNOWN[DEFAULT])[0])
    source = registry.known((DEFAULT if is_asked else FALLBACK) if name is None else said)
    if (format, fps, unit) != (None, None, None):
        raise DataError(
            f"{'the default data set' if name is None else source.name} is known by name: "
            "leave --format, --fps and --unit out (they describe a file of your own)"
        )
    if source.session is None:
        return source, registry.files_of(source, download=download and name is not None), None
    notice = (
        f"{DEFAULT} is not here ({registry.searched()}): using the bundled simulated "
        f"crowd {FALLBACK}. To get it: python -m isac_track.datasets fetch {DEFAULT}"
    )
    files = {registry.MAIN_FILE: crowd.bundled_path(source.session)}
    return source, files, None if is_asked else notice


def _grand_central(path: Path, source: Known) -> _Read:
    """Return the tracks of a folder or archive of `GRAND_CENTRAL`, as `_one_file` does."""
    if source.fps is not None:
        raise DataError(f"{shown(path)}: format {GRAND_CENTRAL} has its own clock; leave --fps out")
    rows, digest = read_gc.read_gc(path, where=shown(path))
    registry.check(path, source, file_name=registry.WHOLE, actual=digest)
    tracks, repairs = to_tracks(rows)
    fast = read_gc.fast_pieces(tracks, where=shown(path))
    return tracks, (*repairs, *fast), digest, GRAND_CENTRAL


def _format_of(path: Path, name: str, *, data: bytes) -> tuple[str, tuple[Repair, ...]]:
    """Return the format, as named, by extension or by header; columns tell no id from frame."""
    name = name or _EXTENSIONS.get(path.suffix.lower(), "")
    known = ", ".join((*FORMATS, GRAND_CENTRAL))
    if not name:
        where = shown(path)
        header = read_frames.read_header("pedpy", data=data, path=where)
        if header.columns:
            rate = "" if header.fps is None else f", {header.fps:g} frames a second"
            order = sorted(header.columns, key=lambda column: header.columns[column])
            detail = f"{where}: line {header.line} names the columns: {' '.join(order)}{rate}"
            return "pedpy", (Repair("header", 1, detail),)
        raise DataError(
            f"{where}: the format is not known from the name, and no header names id, frame, x and "
            f"y; give --format ({known})"
        )
    if name not in FORMATS:
        raise DataError(f"unknown format {name!r}{did_you_mean(name, FORMATS)} (known: {known})")
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
) -> tuple[Tracks, tuple[Repair, ...]]:
    """Return the tracks in the bytes of one file, and what was mended or left out.

    `path` is its name, for messages, and `format` one of `FORMATS`; `fps`, frames a second, is for
    those that count frames; `unit`, of lengths, is m if neither it nor the file says. `groups` are
    (id, label) pairs of who walks together, if that is in another file. `by_marker`: who it is
    says the marker that a pedpy header names. DataError names file and line for anything that
    cannot be read as tracks.
    """
    if fps is not None:
        checked_fps(fps, where="--fps")
    if fps is not None and format in _WITH_CLOCK:
        raise DataError(f"{path}: format {format} has times in seconds (column t); leave --fps out")
    told: dict[str, float | bool | None] = {} if format in _WITH_CLOCK else {"fps": fps}
    told |= {"by_marker": True} if by_marker else {}
    # The rows have no name here: they are let go as soon as they are sorted.
    return to_tracks(in_metres(FORMATS[format](data=data, path=path, **told), unit=unit), groups)


def summarise(tracks: Tracks) -> DataFrame:
    """Return the statistics of every track; a step is from one sample to the next.

    The N rows have `steps`, their number; `duration_s`; `speed_mean_mps`, the length of the path
    over the duration; `speed_sd_mps`, the standard deviation over time of the step speed;
    `slow_share` and `still_share`, the shares of steps slower than `SLOW_MPS` and of exactly no
    length (all four NaN for a single sample); and `frozen`, nearly frozen tracks.
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
        return np.bincount(owner, weights=values, minlength=len(tracks)).astype(np.float64)

    duration = tracks.t[last] - tracks.t[first]
    with np.errstate(invalid="ignore"):  # 0 / 0 of a single sample is NaN, as promised
        mean = per_track(length) / duration
        summary = {
            "steps": steps,
            "duration_s": duration,
            "speed_mean_mps": mean,
            "speed_sd_mps": np.sqrt(per_track((speed - mean[owner]) ** 2 * lasting) / duration),
            "slow_share": per_track(speed < SLOW_MPS) / steps,
            "still_share": per_track(length == 0) / steps,
        }
    return pd.DataFrame(summary | {"frozen": summary["still_share"] >= FROZEN_SHARE})


def still_share(summary: DataFrame) -> float:
    """Return the share of exactly-zero steps among all steps; NaN without steps."""
    n_steps = summary["steps"].sum()
    return float((summary["still_share"] * summary["steps"]).sum() / n_steps) if n_steps else np.nan


def n_lasting(summary: DataFrame, duration_s: float) -> int:
    """Return how many tracks last at least this long."""
    # The clock rounds: 21.6 s at 25 frames a second is 540 frames.
    return int((summary["duration_s"] >= duration_s - 1e-9).sum())
