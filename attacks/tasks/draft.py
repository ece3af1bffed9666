"""What the sessions of all linkage tasks are made from: parts of recorded walks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.random import Generator

from attacks.tasks.sessions import Sessions, Windows, roles
from attacks.tasks.task_list import Task
from isac_track.config import StageSettings
from isac_track.datasets import summarise
from isac_track.datasets.repair import FAST_STEP_MPS
from isac_track.errors import DataError
from isac_track.resample import sampling_times, walk
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Ints, Tracks, squared_lengths

# Fewer people cannot be split twice into teachers, calibrators and victims.
LEAST_PEOPLE = 24
LEAST_COME_BACK = 8  # In a task that leaves one person out to learn.
# Step of the way along a walk: the mean step at which it is sensed.
WAY_STEP_S = 1 / 12
# Room for the rounding of a clock: of frames at 25 Hz, of seconds since 1970.
CLOCK_S = 1e-6


# All tasks of a recording cut their windows from the same walks; the oldest of 2,048
# goes, and all with the process.
@lru_cache(maxsize=2048)
def _walk(
    tracks: Tracks, row: int, max_overshoot_m: float
) -> Callable[[Floats], Floats]:
    return walk(tracks[row], max_overshoot_m=max_overshoot_m)


# As above.
@lru_cache(maxsize=2048)
def _way(tracks: Tracks, row: int, max_overshoot_m: float) -> tuple[Floats, Floats]:
    """Return instants of a whole recorded walk, and the way walked until each, m.

    The instants have even steps from the first sample of the walk on, wherever windows
    are cut.
    """
    track = tracks[row]
    n_steps = int((track.t[-1] - track.t[0]) / WAY_STEP_S)
    t = np.append(track.t[0] + WAY_STEP_S * np.arange(n_steps + 1), track.t[-1])
    steps_m = np.sqrt(
        squared_lengths(np.diff(_walk(tracks, row, max_overshoot_m)(t), axis=0))
    )
    return t, np.concatenate(
        [[0.0], np.cumsum(np.minimum(steps_m, WAY_STEP_S * FAST_STEP_MPS))]
    )


# For the recording, and both sessions of the crowd; the oldest of four goes.
@lru_cache(maxsize=4)
def _moving(tracks: Tracks) -> Bools:
    return np.asarray(~summarise(tracks)["frozen"].to_numpy())


@dataclass(frozen=True, eq=False, slots=True)
class Stretches:
    """N parts of recorded walks, M samples in all."""

    t: Floats  # (M,) s
    xy: Floats  # (M, 2) m
    walked_m: Floats  # (M,) m since the recorded walk began.
    offsets: Ints  # (N + 1,)

    def windows(
        self, person: Ints, search: Ints, *, shift_m: Floats | float = 0.0
    ) -> Windows:
        """Return them as windows of people in searches, each shifted by (N, 2) m."""
        moved = np.repeat(
            np.broadcast_to(shift_m, (person.size, 2)), np.diff(self.offsets), axis=0
        )
        return Windows(
            self.t,
            self.xy + moved,
            self.offsets,
            person,
            search,
            walked_m=self.walked_m,
        )


@dataclass(frozen=True, eq=False, slots=True)
class Draft:
    """The task, tracks, settings and seed from which sessions are made."""

    task: Task
    tracks: Tracks  # The recording, or the first session of a crowd.
    later: Tracks  # The recording again, or the second session of a crowd.
    settings: StageSettings
    seed: int

    @property
    def start_s(self) -> Floats:
        """First sample of each recorded track, (N,)."""
        return self.tracks.t[self.tracks.offsets[:-1]]

    @property
    def end_s(self) -> Floats:
        """Last sample of each recorded track, (N,)."""
        return self.tracks.t[self.tracks.offsets[1:] - 1]

    def rng(self, *names: str | int) -> Generator:
        """Return a stream of the task's family: tasks of other gaps share its draws."""
        return stream(self.seed, "linkage", self.task.family, *names)

    def lasting(self, duration_s: float) -> Ints:
        """Return the rows of the tracks that last that long."""
        return np.flatnonzero(self.end_s - self.start_s >= duration_s - CLOCK_S)

    def require_people(self, count: int, counted: str) -> None:
        """Raise DataError for too few people; `counted` describes them in words."""
        least = LEAST_COME_BACK if self.task.links_returning_people else LEAST_PEOPLE
        if count < least:
            raise DataError(
                f"task {self.task.name}: {count} {counted}, but it takes {least}; use a"
                " longer recording, shorter windows (--set linkage....) or leave the"
                " task out (--task)"
            )

    def cut(
        self,
        side: str,
        rows: Ints,
        start_s: Floats,
        end_s: Floats,
        keys: Sequence[str] = (),
    ) -> Stretches:
        """Return stretches of walks, resampled at instants of their own.

        All arguments are (N,). A stretch ends where its walk ends. `rows` may hold a
        track more than once, each time with another of `keys`.
        """
        start_s = np.maximum(start_s, self.start_s[rows])
        end_s = np.minimum(end_s, self.end_s[rows])
        resample = self.settings.resample
        t, xy, walked_m = [], [], []
        keys = keys or [""] * rows.size
        stretches = zip(rows.tolist(), start_s, end_s.tolist(), keys, strict=True)
        for row, start, end, key in stretches:
            rng = self.rng("sampling", side, self.tracks.source[row], key)
            t.append(
                sampling_times(start_s=start, end_s=end, settings=resample, rng=rng)
            )
            xy.append(_walk(self.tracks, row, resample.max_overshoot_m)(t[-1]))
            way = _way(self.tracks, row, resample.max_overshoot_m)
            walked_m.append(np.interp(t[-1], *way))
        return Stretches(
            t=np.concatenate(t),
            xy=np.concatenate(xy),
            walked_m=np.concatenate(walked_m),
            offsets=np.cumsum([0, *map(len, t)]),
        )

    def sessions(
        self,
        rows: Ints,
        *,
        group: tuple[str, ...],
        may_teach: Bools,
        probe: Windows,
        gallery: Windows,
        mate: Ints,
        fold: Ints,
        searches: tuple[str, ...],
        too_short: int,
        not_drawn: int,
    ) -> Sessions:
        """Return the sessions of the people of some tracks.

        `may_teach`, (2, K), are the people from whom the adversary of either fold may
        learn; all others are fields of `Sessions`.
        """
        learns, calibrates = may_teach, np.zeros_like(may_teach)
        if not self.task.links_returning_people:
            learns, calibrates = roles(
                group, may_teach=may_teach, rng=self.rng("roles")
            )
        source = tuple(self.tracks.source[row] for row in rows)
        alone, moving = np.ones((2, rows.size), dtype=bool)
        for tracks in (self.tracks, self.later):
            session_rows = track_rows(tracks, source)
            _, cluster, sizes = np.unique(
                tracks.group, return_inverse=True, return_counts=True
            )
            alone &= sizes[cluster][session_rows] == 1
            moving &= _moving(tracks)[session_rows]
        return Sessions(
            task=self.task,
            source=source,
            group=group,
            alone=alone,
            moving=moving,
            probe=probe,
            gallery=gallery,
            mate=mate,
            fold=fold,
            searches=searches,
            learns=learns,
            calibrates=calibrates,
            too_short=too_short,
            not_drawn=not_drawn,
        )


def track_rows(tracks: Tracks, source: Sequence[str]) -> Ints:
    """Return the rows of the tracks of these sources."""
    row = {name: number for number, name in enumerate(tracks.source)}
    return np.array([row[name] for name in source], dtype=np.int64)
