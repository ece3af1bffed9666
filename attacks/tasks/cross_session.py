"""The task of real people who come back: a window of each in either of two sessions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from attacks.tasks.paired_windows import paired_windows, start_anywhere
from attacks.tasks.task_input import TaskInput
from attacks.tasks.task_list import NAMED_SESSIONS
from attacks.tasks.window_circumstances import measure_circumstances
from attacks.tasks.windows import TaskWindows
from isac_track.errors import DataError
from isac_track.types import Ints, Tracks, end_to_end, sample_runs


@dataclass(frozen=True, eq=False, slots=True)
class _SharedPeople:
    """The K people of two sessions of a recording, and their tracks in it."""

    names: list[str]  # (K,)
    first_rows: Ints  # (K,) tracks in the first of both sessions.
    second_rows: Ints  # (K,)


def cross_session(task_input: TaskInput) -> TaskWindows:
    """Return a window of each person's walk in the two sessions that most people share.

    If a person has several tracks in a session, the longest counts.
    """
    tracks, needed_s = task_input.tracks, task_input.settings.linkage.window_s
    people = _shared_people(task_input, needed_s)
    task_input.require_people(
        len(people.names), f"people walk for {needed_s:g} s in two sessions"
    )
    both_sessions = replace(
        task_input,
        tracks=_select_named(tracks, people.first_rows, people.names),
        second_tracks=_select_named(tracks, people.second_rows, people.names),
    )
    task_windows = paired_windows(both_sessions, start_anywhere, length_s=needed_s)
    # The people of the task, some of those of both sessions.
    number = np.array([people.names.index(name) for name in task_windows.source])
    probe, gallery = (
        replace(
            windows,
            circumstances=measure_circumstances(
                tracks, rows[number[windows.person]], windows
            ),
        )
        for windows, rows in (
            (task_windows.probe, people.first_rows),
            (task_windows.gallery, people.second_rows),
        )
    )
    return replace(task_windows, probe=probe, gallery=gallery)


def _shared_people(task_input: TaskInput, needed_s: float) -> _SharedPeople:
    """Return the people of the two sessions that share most; DataError without two.

    Only tracks that last `needed_s` count.
    """
    tracks = task_input.tracks
    # A folder of a single file is a recording of a single session.
    if (
        tracks.session is None or tracks.person is None or len(set(tracks.session)) < 2  # noqa: PLR2004 - a pair
    ):
        raise DataError(
            f"task {task_input.task.name}: no person is known to be in two sessions;"
            f" give {NAMED_SESSIONS}"
        )
    # Longer tracks come later, and replace the shorter.
    longest: dict[str, dict[str, int]] = {name: {} for name in tracks.session}
    long = task_input.rows_lasting(needed_s)
    lasts_s = (task_input.end_s - task_input.start_s)[long]
    for row in long[np.argsort(lasts_s, kind="stable")].tolist():
        longest[tracks.session[row]][tracks.person[row]] = row
    first, second = max(
        combinations(longest.values(), 2),
        key=lambda pair: len(pair[0].keys() & pair[1].keys()),
    )
    names = sorted(first.keys() & second.keys())
    return _SharedPeople(
        names=names,
        first_rows=np.array([first[name] for name in names]),
        second_rows=np.array([second[name] for name in names]),
    )


def _select_named(tracks: Tracks, rows: Ints, names: Sequence[str]) -> Tracks:
    """Return the tracks in `rows` under the names of their people."""
    runs, offsets = sample_runs(tracks.offsets, rows)
    t, xy = end_to_end(tracks.t, runs), end_to_end(tracks.xy, runs)
    group = tuple(tracks.group[row] for row in rows)
    return Tracks(t, xy, offsets, source=tuple(names), group=group)
