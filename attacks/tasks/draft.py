"""Where every task begins: who lasts long enough, and windows cut from their walks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from attacks.tasks.roles import alone, roles
from attacks.tasks.sessions import Sessions, Windows
from isac_track.datasets.summary import summarise
from isac_track.errors import DataError, SettingsError
from isac_track.resample import sampling_times, walk
from isac_track.rng import stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

    from attacks.tasks.task_list import Task
    from isac_track.config import StageSettings
    from isac_track.types import Bools, Floats, Ints, Tracks

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

    def chosen(self, rows: Ints, what: str) -> Ints:
        """Return who of these is linked: all, or as many as the settings allow.

        Raises
        ------
        DataError
            If they are too few; `what` says of whom.
        SettingsError
            If the settings allow too few.
        """
        most = self.settings.linkage.most_people
        if most < LEAST_PEOPLE:
            raise SettingsError(f"linkage.most_people must be at least {LEAST_PEOPLE}, got {most}")
        self.need_people(rows.size, what)
        return np.sort(self.rng("people").permutation(rows)[:most])

    def windows(
        self,
        side: str,
        rows: Ints,
        *,
        start_s: Floats,
        length_s: Floats | float,
        person: Ints,
        search: Ints,
        keys: Sequence[str] | None = None,
    ) -> Windows:
        """Return stretches of walks, each at sampling instants of its own.

        Parameters
        ----------
        side : str
            "probe" or "gallery".
        rows : (N,) int
            Tracks; one may be there more than once.
        start_s, length_s : (N,) float, or float for a length that all share
        person, search : (N,) int
            As in `Windows`.
        keys : sequence of N str, optional
            Names of windows, needed where a track is cut more than once.
        """
        walks = {row: walk(self.tracks[row]) for row in np.unique(rows).tolist()}
        # A recorded duration carries the rounding of the frame clock, and so may the last window.
        end_s = np.minimum(start_s + length_s, self.end_s[rows])
        t_parts, xy_parts = [], []
        for row, start, end, key in zip(
            rows.tolist(), start_s, end_s.tolist(), keys or [""] * rows.size, strict=True
        ):
            rng = self.rng("sampling", side, self.tracks.source[row], key)
            t = sampling_times(start_s=start, end_s=end, settings=self.settings.resample, rng=rng)
            t_parts.append(t)
            xy_parts.append(walks[row](t))
        return Windows(
            t=np.concatenate(t_parts),
            xy=np.concatenate(xy_parts),
            offsets=np.concatenate([[0], np.cumsum([part.size for part in t_parts])]),
            person=person,
            search=search,
        )

    def sessions(
        self, rows: Ints, *, group: tuple[str, ...], may_teach: Bools, **found: Any
    ) -> Sessions:
        """Return the sessions of the people of these tracks; `found` is what else they hold."""
        learns, calibrates = roles(group, may_teach=may_teach, rng=self.rng("roles"))
        source = tuple(self.tracks.source[row] for row in rows)
        by_itself, frozen = alone(self.tracks, rows), summarise(self.tracks).frozen[rows]
        if self.later is not None:
            there = {name: row for row, name in enumerate(self.later.source)}
            rows_later = np.array([there[name] for name in source])
            by_itself &= alone(self.later, rows_later)
            frozen |= summarise(self.later).frozen[rows_later]
        return Sessions(
            task=self.task,
            source=source,
            group=group,
            alone=by_itself,
            moving=~frozen,
            learns=learns,
            calibrates=calibrates,
            **found,
        )
