"""Build the sessions of a linkage task: windows of true walks, and their mates.

Sensing, sharing and the frames that an adversary sees come later. Where a task hides
the frame, each window is first moved to another place of the recording. A walk that is
sensed twice in one place would show by its distance from the base station, on which the
noise depends.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import combinations, pairwise
from typing import Final, TypeAlias

import numpy as np
from numpy.random import Generator

from attacks.tasks.sessions import (
    N_FOLDS,
    Sessions,
    Windows,
    circumstances,
    halves,
    roles,
)
from attacks.tasks.task_list import TASKS, Task, task_named
from isac_track.config import StageSettings
from isac_track.datasets import load, summarise
from isac_track.datasets.repair import FAST_STEP_MPS, walking_groups
from isac_track.errors import DataError, SettingsError
from isac_track.place import placed_together
from isac_track.resample import sampling_times, walk
from isac_track.rng import stream
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Tracks,
    end_to_end,
    sample_runs,
    squared_lengths,
)

# Fewer people cannot be split twice into teachers, calibrators and victims.
LEAST_PEOPLE = 24
# People of the two-session crowd: simulating more would not show more.
MOST_SIMULATED = 300
LEAST_COME_BACK = 8  # In a task that leaves one person out to learn.
# Step of the way along a walk: the mean step at which it is sensed.
WAY_STEP_S = 1 / 12
# Steps whose ratio is at least this have one rate: clocks are not exact.
_SAME_RATE = 0.98
# Room for the rounding of a clock: of frames at 25 Hz, of seconds since 1970.
CLOCK_S = 1e-6
_Starts: TypeAlias = Callable[[Floats, Floats, Generator], Floats]
"""Draws the starts of both windows of a person, (2,) s.

Arguments are the first samples of the tracks to cut, and by how much these tracks are
longer than needed, (2,) s each.
"""


# All tasks of a recording cut their windows from the same walks.
@lru_cache(maxsize=2048)
def _walk(
    tracks: Tracks, row: int, max_overshoot_m: float
) -> Callable[[Floats], Floats]:
    return walk(tracks[row], max_overshoot_m=max_overshoot_m)


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


# For the recording, and both sessions of the crowd.
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
        least = LEAST_COME_BACK if self.task.comes_back else LEAST_PEOPLE
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
        self, rows: Ints, *, group: tuple[str, ...], may_teach: Bools, **fields: object
    ) -> Sessions:
        """Return the sessions of the people of some tracks, with further `fields`."""
        learns, calibrates = may_teach, np.zeros_like(may_teach)
        if not self.task.comes_back:
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
        fields |= {
            "learns": learns,
            "calibrates": calibrates,
            "alone": alone,
            "moving": moving,
        }
        # mypy cannot check `fields`; each task names them where it builds its sessions.
        return Sessions(task=self.task, source=source, group=group, **fields)  # type: ignore[arg-type]


def track_rows(tracks: Tracks, source: Sequence[str]) -> Ints:
    """Return the rows of the tracks of these sources."""
    row = {name: number for number, name in enumerate(tracks.source)}
    return np.array([row[name] for name in source], dtype=np.int64)


# The sessions of each task. They raise DataError if too few tracks are long enough, or
# too few people present.


def rerelease(draft: Draft) -> Sessions:
    """Return two windows of each walk, which may overlap: a walk is shared twice."""
    most_s = draft.settings.linkage.rerelease_shift_s

    def starts_s(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
        reach_s = min(slack_s[0], most_s)
        base_s = first_s + rng.uniform(0.0, slack_s[0] - reach_s)
        return np.asarray(base_s + rng.uniform(0.0, reach_s, 2))

    return _closed(draft, draft.settings.linkage.window_s, starts_s)


def split(draft: Draft) -> Sessions:
    """Return two windows of each walk with a gap between them."""
    settings = draft.settings.linkage
    length_s, gap_s = settings.split_window_s, settings.split_gap_s
    apart_s = np.array([0.0, length_s + gap_s])

    def starts_s(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
        return np.asarray(first_s + apart_s + np.sort(rng.uniform(0.0, slack_s)))

    return _closed(draft, length_s, starts_s, needed_s=2.0 * length_s + gap_s)


def new_traversal(draft: Draft) -> Sessions:
    """Return a window of each person's walk in either session of a crowd."""
    return _closed(draft, draft.settings.linkage.window_s, _anywhere)


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
            " sessions with a markerID in their headers, or --persistent-ids if equal"
            " ids are the same person"
        )
    longest: dict[str, dict[str, int]] = {name: {} for name in tracks.session}
    long = draft.lasting(needed_s)
    by_duration = np.argsort((draft.end_s - draft.start_s)[long], kind="stable")
    for row in long[by_duration].tolist():
        longest[tracks.session[row]][tracks.person[row]] = row
    first_day, second_day = max(
        combinations(longest.values(), 2),
        key=lambda days: len(days[0].keys() & days[1].keys()),
    )
    names = sorted(first_day.keys() & second_day.keys())
    draft.require_people(len(names), f"people walk for {needed_s:g} s in two sessions")
    first_rows = np.array([first_day[name] for name in names])
    second_rows = np.array([second_day[name] for name in names])
    first = _named(tracks, first_rows, names)
    second = _named(tracks, second_rows, names)
    sessions = _closed(replace(draft, tracks=first, later=second), needed_s, _anywhere)
    number = np.array([names.index(name) for name in sessions.source])

    def with_circumstances(windows: Windows, rows: Ints) -> Windows:
        about = circumstances(tracks, rows[number[windows.person]], windows)
        return replace(windows, about=about)

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

    A sample stands for the time to the next one of its track, the last for that before
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


def _closed(
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
    searches: tuple[str, ...]
    if draft.task.comes_back:
        search = np.zeros(rows.size, dtype=np.int64)
        cluster = np.unique(group, return_inverse=True)[1]
        may_teach, searches = cluster[:, None] != cluster, ("everybody",)
    else:
        search = halves(group, rng=draft.rng("folds"))
        may_teach = np.stack([search == 1, search == 0])
        searches = ("half 1", "half 2")
    # In an order of its own, so that a place in the list does not give a person away.
    order = draft.rng("order").permutation(rows.size)
    everybody = np.arange(rows.size)
    return draft.sessions(
        rows,
        group=group,
        may_teach=may_teach,
        probe=_closed_windows(
            draft,
            "probe",
            rows=rows,
            start_s=starts[:, 0],
            length_s=length_s,
            person=everybody,
            search=search,
        ),
        gallery=_closed_windows(
            later,
            "gallery",
            rows=rows_later[order],
            start_s=starts[order, 1],
            length_s=length_s,
            person=order,
            search=search[order],
        ),
        mate=np.argsort(order),
        fold=np.arange(len(searches)),
        searches=searches,
        too_short=len(tracks) - len(long),
        not_drawn=len(long) - rows.size,
    )


def _long_in_both(draft: Draft, needed_s: float) -> list[int]:
    """Return the rows of the people whose tracks last `needed_s` in both sessions."""
    tracks, later = draft.tracks, replace(draft, tracks=draft.later)
    counted = f"of {len(tracks)} tracks last {needed_s:g} s"
    if not draft.task.is_one_walk:
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


def _closed_windows(
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


def handover(draft: Draft) -> Sessions:
    """Return windows before and after each instant at which all pseudonyms rotate.

    Some people come or go meanwhile. DataError if there are too few instants, too.
    """
    tracks, settings, gap_s = draft.tracks, draft.settings.linkage, draft.task.gap_s
    # The same instants whatever the gap, so that the gaps can be compared.
    longest_gap_s = max(task.gap_s for task in TASKS.values())
    at_s = _rotation_times(draft, longest_gap_s)
    before, after = _presence(draft, at_s)
    # An instant at which nobody can be linked has no search.
    used = np.flatnonzero((before & after).any(axis=1))
    n_everybody = int((before | after)[used].any(axis=0).sum())
    used = np.intersect1d(used, _draw_instants(draft, at_s, longest_gap_s))
    present = (before | after)[used]
    rows = np.flatnonzero(present.any(axis=0))
    draft.require_people(rows.size, "people are there when pseudonyms rotate")
    if used.size < N_FOLDS:
        raise DataError(
            f"task {draft.task.name}: {used.size} rotations of pseudonyms have people"
            " to link, but 2 are needed; use a longer recording or a shorter"
            " linkage.handover_period_s"
        )
    # By the time since the recording began: an instant has the same draws whatever the
    # clock says.
    labels = [f"{since_s:g} s" for since_s in at_s[used] - float(tracks.t.min())]
    window_s = settings.handover_window_s
    windows = partial(
        _rotation_windows, draft, used=used, at_s=at_s[used], rows=rows, labels=labels
    )
    probe = windows("probe", before, since_s=-window_s, until_s=0.0)
    gallery = windows("gallery", after, since_s=gap_s, until_s=gap_s + window_s)
    gallery_row = np.full((used.size, rows.size), -1)
    gallery_row[gallery.search, gallery.person] = np.arange(len(gallery))
    fold = (np.arange(used.size) * N_FOLDS) // used.size
    group = tuple(tracks.group[row] for row in rows)
    return draft.sessions(
        rows,
        group=group,
        may_teach=_seen_in_other_half(present[:, rows], fold=fold, group=group),
        probe=probe,
        gallery=gallery,
        mate=gallery_row[probe.search, probe.person],
        fold=fold,
        searches=tuple(labels),
        too_short=len(tracks) - n_everybody,
        not_drawn=n_everybody - rows.size,
    )


def _rotation_windows(
    draft: Draft,
    side: str,
    present: Bools,
    *,
    used: Ints,
    at_s: Floats,
    rows: Ints,
    labels: Sequence[str],
    since_s: float,
    until_s: float,
) -> Windows:
    """Return one side of every rotation, the walks of each in an order of its own.

    `present`, (S, N), tells the tracks at each instant. `used` are the numbers of the
    instants, `at_s` their times. Windows last from `since_s` to `until_s` after them.
    """
    # By number among all instants: an instant has the same draws whatever the gap.
    order = [
        draft.rng("order", side, number).permutation(np.flatnonzero(present[number]))
        for number in used.tolist()
    ]
    row = np.concatenate(order)
    search = np.repeat(np.arange(used.size), [part.size for part in order])
    keys = [labels[number] for number in search.tolist()]
    start_s, end_s = at_s[search] + since_s, at_s[search] + until_s
    stretches = draft.cut(side, row, start_s, end_s, keys)
    return stretches.windows(np.searchsorted(rows, row), search)


def _rotation_times(draft: Draft, longest_gap_s: float) -> Floats:
    """Return all instants at which pseudonyms rotate, (S,) s, evenly spaced."""
    settings = draft.settings.linkage
    first_s, last_s = float(draft.tracks.t.min()), float(draft.tracks.t.max())
    lasting_s = last_s - first_s - longest_gap_s - settings.handover_least_s
    count = int(lasting_s / settings.handover_period_s)
    every_s = settings.handover_period_s * max(1.0, count / settings.handover_instants)
    n_instants = min(count, settings.handover_instants)
    return np.asarray(first_s + every_s * np.arange(1.0, n_instants + 1))


def _presence(draft: Draft, at_s: Floats) -> tuple[Bools, Bools]:
    """Return the tracks present before each rotation, and after its gap, (S, N)."""
    least_s = draft.settings.linkage.handover_least_s
    ends_s, begins_s = at_s[:, None], at_s[:, None] + draft.task.gap_s
    began_s, left_s = draft.start_s - CLOCK_S, draft.end_s + CLOCK_S
    before = (began_s <= ends_s - least_s) & (left_s >= ends_s)
    after = (began_s <= begins_s) & (left_s >= begins_s + least_s)
    return before, after


def _seen_in_other_half(present: Bools, *, fold: Ints, group: tuple[str, ...]) -> Bools:
    """Return the people from whom the adversary of either half may learn, (2, K).

    They, and all people who walk with them, are present in the other half only.
    `present`, (S, K), tells the people at each rotation, `fold`, (S,), its half.
    """
    cluster = np.unique(group, return_inverse=True)[1]
    seen = np.stack([present[fold == half].any(axis=0) for half in range(N_FOLDS)])
    company_seen = np.stack([np.bincount(cluster, half) > 0 for half in seen])
    return np.asarray(seen[::-1] & ~company_seen[:, cluster])


def _draw_instants(draft: Draft, at_s: Floats, gap_s: float) -> Ints:
    """Return the instants to use: all, or as many as `linkage.most_people` allows."""
    began_s, left_s = draft.start_s - CLOCK_S, draft.end_s + CLOCK_S
    present = (began_s <= at_s[:, None] + gap_s) & (left_s >= at_s[:, None])
    drawn = draft.rng("instants").permutation(at_s.size)
    n_people = np.logical_or.accumulate(present[drawn], axis=0).sum(axis=1)
    few = int((n_people <= draft.settings.linkage.most_people).sum())
    return np.sort(drawn[: max(few, N_FOLDS)])


_MAKERS: Final[Mapping[str, Callable[[Draft], Sessions]]] = {
    make.__name__: make
    for make in (rerelease, split, new_traversal, cross_session, handover)
}
"""The function that makes the sessions of a task, by the task's family."""


def make_sessions(
    task: Task,
    *,
    tracks: Tracks,
    stages: StageSettings,
    seed: int,
    later: Tracks | None = None,
) -> Sessions:
    """Return the sessions of a task: of the recording, or of the two-session crowd.

    `later` is the second session, unless it is that of the bundled crowd. DataError if
    there are too few people for the task, or if a half of them has nobody to link or to
    learn from; SettingsError if there is no task of this name.
    """
    make = _MAKERS[task_named(task.name).family]
    if task.simulated and later is None:
        crowd = _crowd(stages.linkage.trait_strength)
        tracks, later = placed_together(crowd, settings=stages)
    sessions = make(
        Draft(
            task=task, tracks=tracks, later=later or tracks, settings=stages, seed=seed
        )
    )
    if task.comes_back:
        return sessions
    mated = sessions.mate >= 0
    fold = sessions.fold[sessions.probe.search[mated]]
    person = sessions.probe.person[mated]
    for half in range(N_FOLDS):
        victims, others = person[fold == half], person[fold != half]
        if victims.size < 2 or not sessions.learns[half][others].any():  # noqa: PLR2004 - linking takes two
            raise DataError(
                f"task {task.name}: half of the people have no mate, or no other people"
                " to train on, since too many share a walking group or are present all"
                " the time; use a recording of more people or leave the task out"
                " (--task)"
            )
    return sessions


def _crowd(trait_strength: float) -> tuple[Tracks, Tracks]:
    """Return the two sessions of the crowd: the bundled ones, or simulated anew."""
    if trait_strength == 1.0:
        return load("plaza").tracks, load("plaza-session2").tracks
    from isac_track.datasets.crowd import (  # noqa: PLC0415 - seldom needed
        BUNDLED_SEED,
        CrowdSettings,
        generate,
    )

    crowd = CrowdSettings(trait_strength=trait_strength)
    first, second = (
        generate(crowd, seed=BUNDLED_SEED, session=number) for number in (1, 2)
    )
    return first, second
