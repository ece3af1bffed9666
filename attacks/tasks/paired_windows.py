"""Tasks in which everybody is in both releases: re-release, split, two sessions.

Where a task hides the frame, each window is first moved to another place of the
recording. A walk that is sensed twice in one place would show by its distance from the
base station, on which the noise depends.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Final, TypeAlias

import numpy as np
from numpy.random import Generator

from attacks.tasks.draft import LEAST_PEOPLE, Draft, track_rows
from attacks.tasks.sessions import Sessions, Windows, halves, measure_circumstances
from attacks.tasks.task_list import NAMED_SESSIONS
from isac_track.datasets.repair import walking_groups
from isac_track.errors import DataError, SettingsError
from isac_track.types import Bools, Floats, Ints, Tracks, end_to_end, sample_runs

# People of the two-session crowd: simulating more would not show more.
MOST_SIMULATED = 300
# Steps whose ratio is at least this have one rate: clocks are not exact.
_SAME_RATE = 0.98
_Starts: TypeAlias = Callable[[Floats, Floats, Generator], Floats]
"""Draws the starts of both windows of a person, (2,) s.

Arguments are the first samples of the tracks to cut, and by how much these tracks are
longer than needed, (2,) s each.
"""


def rerelease(draft: Draft) -> Sessions:
    """Return two windows of each walk, which may overlap: a walk is shared twice."""
    most_s = draft.settings.linkage.rerelease_shift_s

    def starts_s(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
        reach_s = min(slack_s[0], most_s)
        base_s = first_s + rng.uniform(0.0, slack_s[0] - reach_s)
        return np.asarray(base_s + rng.uniform(0.0, reach_s, 2))

    return _paired_sessions(draft, draft.settings.linkage.window_s, starts_s)


def split(draft: Draft) -> Sessions:
    """Return two windows of each walk with a gap between them."""
    settings = draft.settings.linkage
    length_s, gap_s = settings.split_window_s, settings.split_gap_s
    apart_s = np.array([0.0, length_s + gap_s])

    def starts_s(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
        return np.asarray(first_s + apart_s + np.sort(rng.uniform(0.0, slack_s)))

    return _paired_sessions(draft, length_s, starts_s, needed_s=2.0 * length_s + gap_s)


def new_traversal(draft: Draft) -> Sessions:
    """Return a window of each person's walk in either session of a crowd."""
    return _paired_sessions(draft, draft.settings.linkage.window_s, _anywhere)


def _anywhere(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
    return np.asarray(first_s + rng.uniform(0.0, slack_s))


def cross_session(draft: Draft) -> Sessions:
    """Return a window of each person's walk in the two sessions that most people share.

    If a person has several tracks in a session, the longest counts.
    """
    tracks, needed_s = draft.tracks, draft.settings.linkage.window_s
    # A folder of a single file is a recording of a single session.
    if (
        tracks.session is None or tracks.person is None or len(set(tracks.session)) < 2  # noqa: PLR2004 - a pair
    ):
        raise DataError(
            f"task {draft.task.name}: no person is known to be in two sessions; give"
            f" {NAMED_SESSIONS}"
        )
    longest: dict[str, dict[str, int]] = {name: {} for name in tracks.session}
    long = draft.lasting(needed_s)
    by_duration = np.argsort((draft.end_s - draft.start_s)[long], kind="stable")
    for row in long[by_duration].tolist():
        longest[tracks.session[row]][tracks.person[row]] = row
    first_session, second_session = max(
        combinations(longest.values(), 2),
        key=lambda days: len(days[0].keys() & days[1].keys()),
    )
    names = sorted(first_session.keys() & second_session.keys())
    draft.require_people(len(names), f"people walk for {needed_s:g} s in two sessions")
    first_rows = np.array([first_session[name] for name in names])
    second_rows = np.array([second_session[name] for name in names])
    first = _named(tracks, first_rows, names)
    second = _named(tracks, second_rows, names)
    sessions = _paired_sessions(
        replace(draft, tracks=first, later=second), needed_s, _anywhere
    )
    number = np.array([names.index(name) for name in sessions.source])

    def with_circumstances(windows: Windows, rows: Ints) -> Windows:
        measured = measure_circumstances(tracks, rows[number[windows.person]], windows)
        return replace(windows, circumstances=measured)

    return replace(
        sessions,
        probe=with_circumstances(sessions.probe, first_rows),
        gallery=with_circumstances(sessions.gallery, second_rows),
    )


def _named(tracks: Tracks, rows: Ints, names: Sequence[str]) -> Tracks:
    """Return some tracks, called by other names."""
    runs, offsets = sample_runs(tracks.offsets, rows)
    t, xy = end_to_end(tracks.t, runs), end_to_end(tracks.xy, runs)
    group = tuple(tracks.group[row] for row in rows)
    return Tracks(t, xy, offsets, source=tuple(names), group=group)


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


def _paired_sessions(
    draft: Draft, length_s: float, starts_s: _Starts, *, needed_s: float = 0.0
) -> Sessions:
    """Return sessions in which everybody is in both, with a search for each half.

    Windows last `length_s`, and tracks must last `needed_s`, by default as long.
    """
    tracks, later = draft.tracks, replace(draft, tracks=draft.later)
    needed_s = needed_s or length_s
    long = _long_in_both(draft, needed_s)
    rows = _draw_people(draft, long)
    rows_later = track_rows(later.tracks, [tracks.source[row] for row in rows])
    first_s = np.column_stack([draft.start_s[rows], later.start_s[rows_later]])
    last_s = np.column_stack([draft.end_s[rows], later.end_s[rows_later]])
    slack_s = np.maximum(last_s - first_s - needed_s, 0.0)
    streams = [draft.rng("windows", tracks.source[row]) for row in rows]
    starts = np.array(list(map(starts_s, first_s, slack_s, streams)))
    group = joined(
        [tracks.group[row] for row in rows],
        [later.tracks.group[row] for row in rows_later],
    )
    searches = _searches(draft, group)
    # In an order of its own, so that a place in the list does not give a person away.
    order = draft.rng("order").permutation(rows.size)
    everybody = np.arange(rows.size)
    return draft.sessions(
        rows,
        group=group,
        may_teach=searches.may_teach,
        probe=_paired_windows(
            draft,
            "probe",
            rows=rows,
            start_s=starts[:, 0],
            length_s=length_s,
            person=everybody,
            search=searches.search,
        ),
        gallery=_paired_windows(
            later,
            "gallery",
            rows=rows_later[order],
            start_s=starts[order, 1],
            length_s=length_s,
            person=order,
            search=searches.search[order],
        ),
        mate=np.argsort(order),
        fold=np.arange(len(searches.names)),
        searches=searches.names,
        too_short=len(tracks) - len(long),
        not_drawn=len(long) - rows.size,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Searches:
    """The searches that the N people of a task are linked in."""

    search: Ints  # (N,) number of each person's search.
    may_teach: Bools  # (2 or N, N) from whom the adversary of a half or person learns.
    names: tuple[str, ...]


def _searches(draft: Draft, group: tuple[str, ...]) -> _Searches:
    """Return a search for each half of the people, or a search in which all come back.

    Who comes back is linked by an adversary who learns from all other groups.
    """
    if draft.task.links_returning_people:
        cluster = np.unique(group, return_inverse=True)[1]
        everybody = np.zeros(len(group), dtype=np.int64)
        return _Searches(everybody, cluster[:, None] != cluster, ("everybody",))
    search = halves(group, rng=draft.rng("folds"))
    may_teach = np.stack([search == 1, search == 0])
    return _Searches(search, may_teach, ("half 1", "half 2"))


def _long_in_both(draft: Draft, needed_s: float) -> list[int]:
    """Return the rows of the people whose tracks last `needed_s` in both sessions."""
    tracks, later = draft.tracks, replace(draft, tracks=draft.later)
    counted = f"of {len(tracks)} tracks last {needed_s:g} s"
    if not draft.task.is_single_walk:
        counted = f"people walk for {needed_s:g} s in both sessions"
    # People who are absent from the second session are left out.
    in_second = {later.tracks.source[row] for row in later.lasting(needed_s)}
    long = [
        row
        for row in draft.lasting(needed_s).tolist()
        if tracks.source[row] in in_second
    ]
    most = draft.settings.linkage.most_people
    if most < LEAST_PEOPLE:
        raise SettingsError(
            f"linkage.most_people must be at least {LEAST_PEOPLE}, got {most}"
        )
    draft.require_people(len(long), counted)
    return long


def _draw_people(draft: Draft, rows: Sequence[int]) -> Ints:
    """Return `linkage.most_people` of some rows, drawn; fewer for a simulated crowd."""
    most = draft.settings.linkage.most_people
    if draft.task.simulated:
        most = min(most, MOST_SIMULATED)
    return np.sort(draft.rng("people").permutation(rows)[:most])


def _paired_windows(
    draft: Draft,
    side: str,
    *,
    rows: Ints,
    start_s: Floats,
    length_s: float,
    person: Ints,
    search: Ints,
) -> Windows:
    """Return one side of closed sessions; `rows`, `start_s` and so on are (N,).

    If the task hides the scene, each window is moved to the place of a drawn sample.
    """
    stretches = draft.cut(side, rows, start_s, start_s + length_s)
    if draft.task.shows_scene:
        return stretches.windows(person, search)
    sizes = np.diff(stretches.offsets)
    middle_m = np.add.reduceat(stretches.xy, stretches.offsets[:-1]) / sizes[:, None]
    sources = [draft.tracks.source[row] for row in rows]
    shares = np.array([draft.rng("place", side, name).random() for name in sources])
    target_m = draft.tracks.xy[samples_at_shares(shares, draft.tracks)]
    return stretches.windows(person, search, shift_m=target_m - middle_m)


def joined(first: Sequence[str], second: Sequence[str]) -> tuple[str, ...]:
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


PAIRED: Final[tuple[Callable[[Draft], Sessions], ...]] = (
    rerelease,
    split,
    new_traversal,
    cross_session,
)
"""The functions that make the sessions of these tasks, named as the tasks' families."""
