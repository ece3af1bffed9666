"""What is to be linked: windows of true walks, and who is who in them.

All start from the recorded tracks; sensing, sharing and the frames that an adversary sees come
later. Where a task hides the frame, each window is first put in another place of the recording:
sensed twice in one place, a walk would be known by its distance from the base station, on which
the noise depends. `attacks.tasks.task_list` says which tasks there are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from attacks.tasks.sessions import N_FOLDS, Sessions, Windows, roles
from attacks.tasks.task_list import Task, task_named
from isac_track.datasets import load, summarise
from isac_track.errors import DataError, SettingsError
from isac_track.resample import sampling_times, walk
from isac_track.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.random import Generator

    from isac_track.config import StageSettings
    from isac_track.types import Bools, Floats, Ints, Tracks

LEAST_PEOPLE = 24
"""Fewer cannot be split into people to learn from, to calibrate on and to attack, twice."""
CLOCK_S = 1e-9
"""Room for the rounding of a frame clock: 12 s at 25 Hz is 300 frames."""


@lru_cache(maxsize=2048)  # all tasks of a recording cut their windows from the same walks
def _walk(tracks: Tracks, row: int) -> Callable[[Floats], Floats]:
    return walk(tracks[row])


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
        """Refuse a recording with too few people for the task; `what` says which were counted."""
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

        `rows`, (N,), may hold a track more than once, each time with another of `keys`; `start_s`,
        `person` and `search`, (N,), are those of each window.
        """
        # A recorded duration carries the rounding of the frame clock, and so may the last window.
        end_s = np.minimum(start_s + length_s, self.end_s[rows])
        t_parts, xy_parts = [], []
        for row, start, end, key in zip(
            rows.tolist(), start_s, end_s.tolist(), keys or [""] * rows.size, strict=True
        ):
            rng = self.rng("sampling", side, self.tracks.source[row], key)
            t = sampling_times(start_s=start, end_s=end, settings=self.settings.resample, rng=rng)
            t_parts.append(t)
            xy_parts.append(_walk(self.tracks, row)(t))
        return Windows(
            t=np.concatenate(t_parts),
            xy=np.concatenate(xy_parts),
            offsets=np.concatenate([[0], np.cumsum([part.size for part in t_parts])]),
            person=person,
            search=search,
        )

    def sessions(
        self, rows: Ints, *, group: tuple[str, ...], may_teach: Bools, **found: object
    ) -> Sessions:
        """Return the sessions of the people of these tracks; `found` is what else they hold."""
        learns, calibrates = roles(group, may_teach=may_teach, rng=self.rng("roles"))
        source = tuple(self.tracks.source[row] for row in rows)
        by_itself, moving = np.ones((2, rows.size), dtype=bool)
        for tracks in (self.tracks, self.later or self.tracks):
            there = rows_of(tracks, source)
            _, cluster, sizes = np.unique(tracks.group, return_inverse=True, return_counts=True)
            by_itself &= sizes[cluster][there] == 1
            moving &= ~summarise(tracks)["frozen"].to_numpy()[there]
        return Sessions(
            task=self.task,
            source=source,
            group=group,
            alone=by_itself,
            moving=moving,
            learns=learns,
            calibrates=calibrates,
            **found,  # type: ignore[arg-type]  # the other fields of Sessions
        )


def rows_of(tracks: Tracks, source: Sequence[str]) -> Ints:
    """Return the tracks of these sources."""
    row = {name: place for place, name in enumerate(tracks.source)}
    return np.array([row[name] for name in source], dtype=np.int64)


def sessions_of(
    task: Task, *, tracks: Tracks, stages: StageSettings, seed: int, later: Tracks | None = None
) -> Sessions:
    """Return the sessions of a task: of the recording, or of the two-session crowd.

    `later` is the second session, if it is another than that of the bundled crowd.

    Raises
    ------
    DataError
        If the recording has too few people for the task, or a half of them has nobody to link, or
        nobody to learn from.
    SettingsError
        If there is no task of this name.
    """
    make: Callable[[Draft], Sessions] = getattr(
        import_module("attacks.tasks.makers"), task_named(task.name).family
    )
    if task.simulated and later is None:
        tracks, later = _crowd(stages.linkage.trait_strength)
    found = make(Draft(task=task, tracks=tracks, later=later, settings=stages, seed=seed))
    mated = found.mate >= 0
    fold, person = found.fold[found.probe.search[mated]], found.probe.person[mated]
    for half in range(N_FOLDS):
        mine, others = person[fold == half], person[fold != half]
        if mine.size < 2 or not found.learns[half][others].any():  # noqa: PLR2004 - one alone has no other
            raise DataError(
                f"task {task.name}: half of the people has nobody to link, or nobody "
                "else to learn from: too many belong to one walking group, or are there all the "
                "time; use a recording of more people or leave the task out (--task)"
            )
    return found


def _crowd(trait_strength: float) -> tuple[Tracks, Tracks]:
    """Return the two sessions of the crowd: the bundled ones, or simulated anew."""
    if trait_strength == 1.0:
        return load("plaza").tracks, load("plaza-session2").tracks
    from isac_track.datasets.crowd import BUNDLED_SEED, CrowdSettings, generate  # noqa: PLC0415 - seldom needed

    crowd = CrowdSettings(trait_strength=trait_strength)
    first, second = (generate(crowd, seed=BUNDLED_SEED, session=number) for number in (1, 2))
    return first, second
