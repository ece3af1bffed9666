"""Tasks in which everybody is on both sides: re-release, split, two sessions.

Every person has a probe and a gallery window. A search has half of the people, so that
an adversary is trained on the other half.

Where a task hides the frame, each window is first moved to another place of the
recording. A walk that is sensed twice in one place would show by its distance from the
base station, on which the noise depends.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np
from numpy.random import Generator

from attacks.tasks.assembly import Searches, assemble
from attacks.tasks.cutting import cut_windows
from attacks.tasks.folds import split_people
from attacks.tasks.task_input import LEAST_PEOPLE, TaskInput, track_rows
from attacks.tasks.windows import TaskWindows, Windows
from isac_track.datasets.repair import walking_groups
from isac_track.errors import SettingsError
from isac_track.types import Floats, Ints, Tracks

# People of the two-session crowd: simulating more would not show more.
MOST_SIMULATED = 300
# Steps whose ratio is at least this have one rate: clocks are not exact.
_SAME_RATE = 0.98
StartDraw: TypeAlias = Callable[[Floats, Floats, Generator], Floats]
"""Draws the starts of both windows of a person, (2,) s.

Arguments are the first samples of the tracks to cut, and by how much these tracks are
longer than needed, (2,) s each.
"""


def rerelease(task_input: TaskInput) -> TaskWindows:
    """Return two windows of each walk, which may overlap: a walk is shared twice."""
    most_s = task_input.settings.linkage.rerelease_shift_s

    def draw_starts(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
        reach_s = min(slack_s[0], most_s)
        base_s = first_s + rng.uniform(0.0, slack_s[0] - reach_s)
        return np.asarray(base_s + rng.uniform(0.0, reach_s, 2))

    length_s = task_input.settings.linkage.window_s
    return paired_windows(task_input, draw_starts, length_s=length_s)


def split(task_input: TaskInput) -> TaskWindows:
    """Return two windows of each walk with a gap between them."""
    settings = task_input.settings.linkage
    length_s, gap_s = settings.split_window_s, settings.split_gap_s
    apart_s = np.array([0.0, length_s + gap_s])

    def draw_starts(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
        return np.asarray(first_s + apart_s + np.sort(rng.uniform(0.0, slack_s)))

    return paired_windows(
        task_input, draw_starts, length_s=length_s, needed_s=2.0 * length_s + gap_s
    )


def new_traversal(task_input: TaskInput) -> TaskWindows:
    """Return a window of each person's walk in either session of a crowd."""
    length_s = task_input.settings.linkage.window_s
    return paired_windows(task_input, start_anywhere, length_s=length_s)


def start_anywhere(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
    """Draw the starts of both windows anywhere in their tracks, a `StartDraw`."""
    return np.asarray(first_s + rng.uniform(0.0, slack_s))


def paired_windows(
    task_input: TaskInput,
    draw_starts: StartDraw,
    *,
    length_s: float,
    needed_s: float | None = None,
) -> TaskWindows:
    """Return windows of people who are on both sides, with a search for each fold.

    Windows last `length_s`, and tracks must last `needed_s`, by default as long.
    """
    second = task_input.second_session
    needed_s = length_s if needed_s is None else needed_s
    long = _rows_long_in_both(task_input, needed_s)
    rows = _draw_people(task_input, long)
    second_rows = track_rows(
        second.tracks, [task_input.tracks.source[row] for row in rows]
    )
    start_s = _draw_windows(
        task_input, draw_starts, rows, second_rows, needed_s=needed_s
    )
    group = join_groups(
        [task_input.tracks.group[row] for row in rows],
        [second.tracks.group[row] for row in second_rows],
    )
    search = _number_searches(task_input, group)
    # The gallery is in an order of its own, so that no place in the list gives a person
    # away.
    order = task_input.rng("order").permutation(rows.size)
    return assemble(
        task_input,
        rows,
        group=group,
        searches=_searches(task_input, group, search),
        probe=_cut_side(
            task_input,
            "probe",
            rows=rows,
            start_s=start_s[:, 0],
            length_s=length_s,
            person=np.arange(rows.size),
            search=search,
        ),
        gallery=_cut_side(
            second,
            "gallery",
            rows=second_rows[order],
            start_s=start_s[order, 1],
            length_s=length_s,
            person=order,
            search=search[order],
        ),
        mate=np.argsort(order),
        too_short=len(task_input.tracks) - len(long),
        not_drawn=len(long) - rows.size,
    )


def _rows_long_in_both(task_input: TaskInput, needed_s: float) -> list[int]:
    """Return the rows of the people whose tracks last `needed_s` in both sessions."""
    tracks, second = task_input.tracks, task_input.second_session
    counted = f"of {len(tracks)} tracks last {needed_s:g} s"
    if not task_input.task.is_single_walk:
        counted = f"people walk for {needed_s:g} s in both sessions"
    # People who are absent from the second session are left out.
    in_second = {second.tracks.source[row] for row in second.rows_lasting(needed_s)}
    long = [
        row
        for row in task_input.rows_lasting(needed_s).tolist()
        if tracks.source[row] in in_second
    ]
    most = task_input.settings.linkage.most_people
    if most < LEAST_PEOPLE:
        raise SettingsError(
            f"linkage.most_people must be at least {LEAST_PEOPLE}, got {most}"
        )
    task_input.require_people(len(long), counted)
    return long


def _draw_people(task_input: TaskInput, rows: Sequence[int]) -> Ints:
    """Return `linkage.most_people` of some rows, drawn; fewer for a simulated crowd."""
    most = task_input.settings.linkage.most_people
    if task_input.task.simulated:
        most = min(most, MOST_SIMULATED)
    return np.sort(task_input.rng("people").permutation(rows)[:most])


def _draw_windows(
    task_input: TaskInput,
    draw_starts: StartDraw,
    rows: Ints,
    second_rows: Ints,
    *,
    needed_s: float,
) -> Floats:
    """Return the starts of each person's probe and gallery window, (K, 2) s.

    `rows` and `second_rows`, (K,), are the people's tracks in either session.
    """
    second = task_input.second_session
    first_s = np.column_stack([task_input.start_s[rows], second.start_s[second_rows]])
    last_s = np.column_stack([task_input.end_s[rows], second.end_s[second_rows]])
    slack_s = np.maximum(last_s - first_s - needed_s, 0.0)
    streams = [task_input.rng("windows", task_input.tracks.source[row]) for row in rows]
    return np.array(list(map(draw_starts, first_s, slack_s, streams)))


def _number_searches(task_input: TaskInput, group: tuple[str, ...]) -> Ints:
    """Return the search of each person, (K,): that of the fold, or a single search."""
    if task_input.task.links_returning_people:
        return np.zeros(len(group), dtype=np.int64)
    return split_people(group, rng=task_input.rng("folds"))


def _searches(task_input: TaskInput, group: tuple[str, ...], search: Ints) -> Searches:
    """Return the searches of the people of some groups; `search` is theirs, (K,).

    Who comes back is linked by an adversary that may know all other groups. Anybody
    else is linked by an adversary that may know the other fold.
    """
    if task_input.task.links_returning_people:
        cluster = np.unique(group, return_inverse=True)[1]
        return Searches(("everybody",), np.arange(1), cluster[:, None] != cluster)
    other_fold = np.stack([search == 1, search == 0])
    return Searches(("half 1", "half 2"), np.arange(2), other_fold)


def _cut_side(
    task_input: TaskInput,
    side: str,
    *,
    rows: Ints,
    start_s: Floats,
    length_s: float,
    person: Ints,
    search: Ints,
) -> Windows:
    """Return one side; `rows`, `start_s`, `person` and `search` are (K,).

    If the task hides the scene, each window is moved to the place of a drawn sample.
    """
    tracks = task_input.tracks
    cut = cut_windows(task_input, side, rows, start_s, start_s + length_s)
    if task_input.task.shows_scene:
        return cut.in_searches(person, search)
    sizes = np.diff(cut.offsets)
    middle_m = np.add.reduceat(cut.xy, cut.offsets[:-1]) / sizes[:, None]
    sources = [tracks.source[row] for row in rows]
    shares = [task_input.rng("place", side, name).random() for name in sources]
    target_m = tracks.xy[samples_at_shares(np.array(shares), tracks)]
    return cut.in_searches(person, search, shift_m=target_m - middle_m)


def samples_at_shares(shares: Floats, tracks: Tracks) -> Ints:
    """Return the samples at shares, (N,) in [0, 1), of the time that people were seen.

    A sample stands for the time to the next of its track, the last for that before
    it. No sample stands for more than the usual step of the slowest track: otherwise a
    gap would be drawn too often. If all samples stand for equal times, each is as
    likely as another.
    """
    step_s = np.full(tracks.t.size, np.inf)  # a track of one sample has no step
    usual_s = []
    for first, end in pairwise(tracks.offsets.tolist()):
        steps_s = np.diff(tracks.t[first:end])
        if steps_s.size:
            step_s[first:end] = np.append(steps_s, steps_s[-1])
            usual_s.append(float(np.median(steps_s)))
    longest_s = max(usual_s, default=0.0)
    step_s = np.minimum(step_s, longest_s)
    if longest_s == 0.0 or step_s.min() >= _SAME_RATE * longest_s:
        return np.asarray((shares * tracks.t.size).astype(np.int64))
    until_s = np.cumsum(step_s)
    places = np.searchsorted(until_s, shares * until_s[-1], side="right")
    return np.asarray(np.minimum(places, tracks.t.size - 1))


def join_groups(first: Sequence[str], second: Sequence[str]) -> tuple[str, ...]:
    """Return the cluster of each person, given the groups in either session.

    People who share a group in a session are in one cluster, also by way of others. A
    cluster has the first name, in alphabetical order, of its groups in the first
    session.
    """
    ids = tuple(map(str, range(len(first))))
    members = [(person, f"0{name}") for person, name in zip(ids, first, strict=True)]
    members += [(person, f"1{name}") for person, name in zip(ids, second, strict=True)]
    groups = walking_groups(ids=ids, members=members)
    return tuple(group.removeprefix("group:0") for group in groups)


PAIRED: Final[Mapping[str, Callable[[TaskInput], TaskWindows]]] = {
    "rerelease": rerelease,
    "split": split,
    "new_traversal": new_traversal,
}
"""The functions that make the windows of these tasks, by the task's family."""
