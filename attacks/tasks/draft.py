"""Where every task begins: who lasts long enough, and windows cut from their walks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from attacks.tasks.sessions import Windows
from isac_track.errors import DataError, SettingsError
from isac_track.resample import sampling_times, walk
from isac_track.rng import stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

    from attacks.tasks.task_list import Task
    from isac_track.config import StageSettings
    from isac_track.types import Floats, Ints, Tracks

LEAST_PEOPLE = 24
"""Fewer cannot be split into people to learn from, to calibrate on and to attack, twice."""
CLOCK_S = 1e-9
"""Room for the rounding of a frame clock: 12 s at 25 Hz is 300 frames."""


@dataclass(frozen=True, eq=False, slots=True)
class Draft:
    """What a task is made from."""

    task: Task
    tracks: Tracks
    """The recording; of a crowd, its first session."""
    later: Tracks | None
    """The crowd's second session."""
    settings: StageSettings
    seed: int
    start_s: Floats = field(init=False)
    """(N,) first sample of each recorded track."""
    end_s: Floats = field(init=False)
    """(N,) last sample."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "start_s", self.tracks.t[self.tracks.offsets[:-1]])
        object.__setattr__(self, "end_s", self.tracks.t[self.tracks.offsets[1:] - 1])

    def rng(self, *names: str | int) -> Generator:
        """Return a stream of the task; where everything but the gap is alike, so are the draws."""
        return stream(self.seed, "linkage", self.task.family, *names)

    def lasting(self, duration_s: float) -> Ints:
        """Return the tracks that are long enough."""
        return np.flatnonzero(self.end_s - self.start_s >= duration_s - CLOCK_S)

    def chosen(self, rows: Ints, what: str) -> Ints:
        """Return who of these is linked: all, or as many as the settings allow.

        Raises
        ------
        DataError
            If they are too few; `what` says of whom.
        SettingsError
            If the settings allow too few.
        """
        if self.settings.linkage.most_people < LEAST_PEOPLE:
            raise SettingsError(
                f"linkage.most_people must be at least {LEAST_PEOPLE}, "
                f"got {self.settings.linkage.most_people}"
            )
        self.need_people(rows.size, what)
        drawn = self.rng("people").permutation(rows)[: self.settings.linkage.most_people]
        return np.sort(drawn)

    def need_people(self, found: int, what: str) -> None:
        """Refuse a recording with too few people for the task; `what` says which were counted.

        Raises
        ------
        DataError
        """
        if found < LEAST_PEOPLE:
            raise DataError(
                f"task {self.task.name}: {found} {what}, but it takes {LEAST_PEOPLE}; use a longer "
                "recording, shorter windows (--set linkage....) or leave the task out (--task)"
            )


def windows_of(
    draft: Draft,
    side: str,
    tracks: Tracks,
    *,
    rows: Ints,
    start_s: Floats,
    length_s: Floats | float,
    person: Ints,
    search: Ints,
    keys: Sequence[str] | None = None,
) -> Windows:
    """Return stretches of walks, each at sampling instants of its own.

    Parameters
    ----------
    draft : Draft
    side : str
        "probe" or "gallery".
    tracks : Tracks
        Where they are cut from.
    rows : (N,) int
        Tracks; one may be there more than once.
    start_s, length_s : (N,) float, or float for a length that all share
    person, search : (N,) int
        As in `Windows`.
    keys : sequence of N str, optional
        Names of windows, needed where a track is cut more than once.
    """
    walks = {row: walk(tracks[row]) for row in np.unique(rows).tolist()}
    lengths = np.broadcast_to(np.asarray(length_s, dtype=np.float64), rows.shape)
    t_parts, xy_parts = [], []
    for row, start, length, key in zip(
        rows.tolist(), start_s, lengths, keys or [""] * rows.size, strict=True
    ):
        rng = draft.rng("sampling", side, tracks.source[row], key)
        # A recorded duration carries the rounding of the frame clock, and so may the last window.
        end = min(start + length, float(tracks.t[tracks.offsets[row + 1] - 1]))
        t = sampling_times(start_s=start, end_s=end, settings=draft.settings.resample, rng=rng)
        t_parts.append(t)
        xy_parts.append(walks[row](t))
    return Windows(
        t=np.concatenate(t_parts),
        xy=np.concatenate(xy_parts),
        offsets=np.concatenate([[0], np.cumsum([part.size for part in t_parts])]),
        person=person,
        search=search,
    )


def elsewhere(
    draft: Draft, side: str, tracks: Tracks, windows: Windows, source: tuple[str, ...]
) -> Windows:
    """Return windows whose middles lie where somebody, anybody, once was."""
    shift_m = np.empty((len(windows), 2))
    middle_m = np.add.reduceat(windows.xy, windows.offsets[:-1])
    middle_m /= np.diff(windows.offsets)[:, None]
    for row, person in enumerate(windows.person):
        rng = draft.rng("place", side, source[person])
        shift_m[row] = tracks.xy[int(rng.random() * tracks.t.size)] - middle_m[row]
    moved = windows.xy + np.repeat(shift_m, np.diff(windows.offsets), axis=0)
    return replace(windows, xy=moved)
