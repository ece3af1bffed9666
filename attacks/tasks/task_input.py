"""What the windows of a task are made from: recorded tracks, settings and a seed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from attacks.tasks.task_list import Task
from isac_track.config import StageSettings
from isac_track.errors import DataError
from isac_track.rng import stream
from isac_track.types import Floats, Ints, Tracks

# Fewer people cannot be split twice into people to train on, calibrators and victims.
LEAST_PEOPLE = 24
LEAST_COME_BACK = 8  # In a task that leaves one person out to train.
# Room for the rounding of a clock: of frames at 25 Hz, of seconds since 1970.
CLOCK_S = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class TaskInput:
    """The task, N recorded tracks of a session, settings and seed."""

    task: Task
    tracks: Tracks  # The recording, or the first of two sessions.
    second_tracks: Tracks  # The recording again, or the second session.
    settings: StageSettings
    seed: int

    @property
    def second_session(self) -> "TaskInput":
        """The same input with the second session in place of the first."""
        return replace(self, tracks=self.second_tracks)

    @property
    def start_s(self) -> Floats:
        """First sample of each recorded track, (N,)."""
        return self.tracks.t[self.tracks.offsets[:-1]]

    @property
    def end_s(self) -> Floats:
        """Last sample of each recorded track, (N,)."""
        return self.tracks.t[self.tracks.offsets[1:] - 1]

    def rng(self, *names: str | int) -> Generator:
        """Return a stream of the task's family: all silences share its draws."""
        return stream(self.seed, "linkage", self.task.family, *names)

    def rows_lasting(self, duration_s: float) -> Ints:
        """Return the rows of the tracks that last at least so long."""
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


def track_rows(tracks: Tracks, source: Sequence[str]) -> Ints:
    """Return the rows of the tracks of these sources."""
    row = {name: number for number, name in enumerate(tracks.source)}
    return np.array([row[name] for name in source], dtype=np.int64)
