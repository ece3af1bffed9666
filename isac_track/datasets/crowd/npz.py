"""The files of the crowd: whole millimetres in a compressed archive, and the two bundled ones."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track.datasets.recording import brief, steps_within
from isac_track.datasets.registry import shown
from isac_track.errors import DataError
from isac_track.types import Tracks

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

FILES = {1: "plaza.npz", 2: "plaza_session2.npz"}
"""Name of each bundled session's file, in the package `isac_track.datasets`."""
SESSIONS = tuple(FILES)
_FORMAT = 1
_MM = np.iinfo(np.int16)
_MOST_BYTES = 16_000_000
"""A bundled session is a tenth of this when unpacked; an archive can claim anything."""
_LONGEST_FRAME_S = 3600.0
_CLOCK_S = 1e-6


def bundled(session: int) -> Tracks:
    """Return a bundled session, 1 or 2, of the plaza."""
    return read_npz(bundled_path(session))


def bundled_path(session: int) -> Path:
    """Return the file of a bundled session, 1 or 2; ValueError if there is no such session."""
    if session not in FILES:
        raise ValueError(f"the bundled plaza has sessions 1 and 2, not {session}")
    return Path(__file__).parents[1] / FILES[session]


def write_npz(
    path: Path, tracks: Tracks, *, frame_s: float = 0.4, about: dict[str, object] | None = None
) -> None:
    """Write tracks as whole millimetres in int16, at whole multiples of `frame_s`.

    `about`, where the tracks come from, is kept in the file as JSON. It is a DataError if a
    coordinate does not fit in int16 millimetres (+-32.767 m), or if a track has not a sample at
    every multiple of `frame_s` from its first to its last.
    """
    frame = np.rint(tracks.t / frame_s).astype(np.int64)
    is_late = np.abs(frame * frame_s - tracks.t) > _CLOCK_S
    if is_late.any() or (np.diff(frame)[steps_within(tracks.offsets)] != 1).any():
        raise DataError(f"{path}: every track needs a sample every {frame_s:g} s, without gaps")
    xy_mm = np.rint(tracks.xy * 1e3)
    if (np.abs(xy_mm) > _MM.max).any():
        way_out = f"coordinates must lie within +-{_MM.max / 1e3:g} m; move the origin"
        raise DataError(f"{path}: the walks do not fit in int16 millimetres: {way_out}")
    # Steps compress better than positions. They may wrap around: so does the sum in read_npz.
    steps = np.diff(xy_mm.astype(np.int16), axis=0, prepend=np.zeros((1, 2), dtype=np.int16))
    np.savez_compressed(
        path,
        format=np.int64(_FORMAT),
        frame_s=np.float64(frame_s),
        first_frame=frame[tracks.offsets[:-1]].astype(np.int32),
        samples=np.diff(tracks.offsets).astype(np.int32),
        steps_mm=np.ascontiguousarray(steps.T),
        source=np.array(tracks.source),
        group=np.array(tracks.group),
        about=np.array(json.dumps(about or {}, sort_keys=True)),
    )


def read_npz(path: Path) -> Tracks:
    """Read what `write_npz` wrote; DataError if the file is missing or not of this format."""
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked_bytes = sum(member.file_size for member in archive.infolist())
        if unpacked_bytes > _MOST_BYTES:
            raise ValueError(f"{unpacked_bytes} bytes when unpacked, more than {_MOST_BYTES}")  # noqa: TRY301 - told below
        with np.load(path, allow_pickle=False) as file:
            return _unpacked(file)
    except Exception as error:  # noqa: BLE001 - a damaged archive makes numpy raise nearly anything
        raise DataError(f"{shown(path)}: not a readable crowd file ({brief(error)})") from None


def _unpacked(file: Mapping[str, NDArray[Any]]) -> Tracks:
    version = file["format"].item()
    if version != _FORMAT:
        raise ValueError(f"format {version} is not known")
    whole = {}
    for name, n_dimensions in (("first_frame", 1), ("samples", 1), ("steps_mm", 2)):
        if file[name].dtype.kind != "i" or file[name].ndim != n_dimensions:
            raise ValueError(f"{name} must hold whole numbers in {n_dimensions} dimension(s)")
        whole[name] = file[name].astype(np.int64)
    frame_s = float(file["frame_s"].item())
    if not 0 < frame_s < _LONGEST_FRAME_S:
        raise ValueError(f"frame_s is {frame_s:g}")
    samples = whole["samples"]
    offsets = np.concatenate([[0], np.cumsum(samples)])
    # Before anything of that length is made: the numbers in a damaged file may claim any.
    if (samples < 1).any() or whole["steps_mm"].shape != (2, offsets[-1]):
        raise ValueError("samples and steps_mm do not fit together")
    frame = np.arange(offsets[-1]) + np.repeat(whole["first_frame"] - offsets[:-1], samples)
    return Tracks(
        t=frame * frame_s,
        xy=np.cumsum(whole["steps_mm"], axis=1, dtype=np.int16).T / 1e3,
        offsets=offsets,
        source=tuple(map(str, file["source"].tolist())),
        group=tuple(map(str, file["group"].tolist())),
    )
