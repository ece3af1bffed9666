"""What is to be linked: windows of true walks, and who is who in them.

Sensing, sharing and the frames that an adversary sees come later. Where a task hides
the frame, each window is first put in another place of the recording: sensed twice in
one place, a walk would be known by its distance from the base station, on which the
noise depends.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
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
    runs_of,
    squared_lengths,
)

# Fewer cannot be split into who teaches, calibrates and is attacked, twice.
LEAST_PEOPLE = 24
# People of the two-session crowd: more can be simulated, and show no more.
MOST_SIMULATED = 300
LEAST_COME_BACK = 8  # In a task that learns leaving one person out.
WAY_STEP_S = 1 / 12  # Of the way along a walk: the mean step at which it is sensed.
_ALIKE = 0.98  # Steps that differ by less are one rate, on a clock that is not exact.
# Room for the rounding of a clock: of frames at 25 Hz, of seconds since 1970.
CLOCK_S = 1e-6
_Starts: TypeAlias = Callable[[Floats, Floats, Generator], Floats]
"""Draws where both windows of a person begin, from the first samples of the tracks that they are
cut from and by how much these are longer than needed, (2,) s each."""


@lru_cache(
    maxsize=2048
)  # all tasks of a recording cut their windows from the same walks
def _walk(
    tracks: Tracks, row: int, max_overshoot_m: float
) -> Callable[[Floats], Floats]:
    return walk(tracks[row], max_overshoot_m=max_overshoot_m)


@lru_cache(maxsize=2048)  # as above
def _way(tracks: Tracks, row: int, max_overshoot_m: float) -> tuple[Floats, Floats]:
    """Return instants of a whole recorded walk, and how far it has come at them in m.

    They follow each other in even steps from its first sample on, wherever windows are
    cut.
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


@lru_cache(maxsize=4)  # of the recording, and both sessions of the crowd
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
        """Return them as windows of these people in these searches, each shifted, (N, 2) m."""
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
    """What a task is made from."""

    task: Task
    tracks: Tracks  # The recording; of a crowd, its first session.
    later: Tracks  # The crowd's second session; of a recording, itself.
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
        """Return a stream of the task; where everything but the gap is alike, so are the draws."""
        return stream(self.seed, "linkage", self.task.family, *names)

    def lasting(self, duration_s: float) -> Ints:
        """Return the tracks that are long enough."""
        return np.flatnonzero(self.end_s - self.start_s >= duration_s - CLOCK_S)

    def need_people(self, found: int, what: str) -> None:
        """Refuse a recording with too few people for the task; `what` says which were counted."""
        least = LEAST_COME_BACK if self.task.comes_back else LEAST_PEOPLE
        if found < least:
            raise DataError(
                f"task {self.task.name}: {found} {what}, but it takes {least}; use a"
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
        """Return stretches of walks as far as these go, at instants of their own.

        All are (N,). `rows` may hold a track more than once, each time with another of
        `keys`.
        """
        start_s = np.maximum(start_s, self.start_s[rows])
        end_s = np.minimum(end_s, self.end_s[rows])
        t, xy, walked_m, resample = [], [], [], self.settings.resample
        each = zip(
            rows.tolist(),
            start_s,
            end_s.tolist(),
            keys or [""] * rows.size,
            strict=True,
        )
        for row, start, end, key in each:
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
        self, rows: Ints, *, group: tuple[str, ...], may_teach: Bools, **found: object
    ) -> Sessions:
        """Return the sessions of the people of these tracks; `found` is what else they hold."""
        learns, calibrates = may_teach, np.zeros_like(may_teach)
        if not self.task.comes_back:
            learns, calibrates = roles(
                group, may_teach=may_teach, rng=self.rng("roles")
            )
        source = tuple(self.tracks.source[row] for row in rows)
        alone, moving = np.ones((2, rows.size), dtype=bool)
        for tracks in (self.tracks, self.later):
            there = rows_of(tracks, source)
            _, cluster, sizes = np.unique(
                tracks.group, return_inverse=True, return_counts=True
            )
            alone &= sizes[cluster][there] == 1
            moving &= _moving(tracks)[there]
        found |= {
            "learns": learns,
            "calibrates": calibrates,
            "alone": alone,
            "moving": moving,
        }
        # mypy cannot follow what a task holds beside its people: that is named where it
        # is built.
        return Sessions(task=self.task, source=source, group=group, **found)  # type: ignore[arg-type]


def rows_of(tracks: Tracks, source: Sequence[str]) -> Ints:
    """Return the tracks of these sources."""
    row = {name: place for place, name in enumerate(tracks.source)}
    return np.array([row[name] for name in source], dtype=np.int64)


# The sessions of each task; it is a DataError if too few tracks are long enough or
# people there


def rerelease(draft: Draft) -> Sessions:
    """Return two windows of each walk, which may overlap: the same walk is shared twice."""
    most_s = draft.settings.linkage.rerelease_shift_s

    def starts_s(first_s: Floats, slack_s: Floats, rng: Generator) -> Floats:
        reach_s = min(slack_s[0], most_s)
        base_s = first_s + rng.uniform(0.0, slack_s[0] - reach_s)
        return np.asarray(base_s + rng.uniform(0.0, reach_s, 2))

    return _closed(draft, draft.settings.linkage.window_s, starts_s)


def split(draft: Draft) -> Sessions:
    """Return two windows of each walk with a gap between them."""
    length_s, gap_s = (
        draft.settings.linkage.split_window_s,
        draft.settings.linkage.split_gap_s,
    )
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
    """Return a window of each person's walk in both of the two sessions that most people share.

    Of a person with several tracks in a session it is the longest.
    """
    tracks, needed_s = draft.tracks, draft.settings.linkage.window_s
    if tracks.session is None or tracks.person is None:
        raise DataError(
            f"task {draft.task.name}: no person is known to be in two sessions; give"
            " sessions with a markerID in their headers, or --persistent-ids if equal"
            " ids are the same person"
        )
    longest: dict[str, dict[str, int]] = {name: {} for name in tracks.session}
    long = draft.lasting(needed_s)
    for row in long[
        np.argsort((draft.end_s - draft.start_s)[long], kind="stable")
    ].tolist():
        longest[tracks.session[row]][tracks.person[row]] = row
    pairs = [*combinations(longest.values(), 2)]
    both_of = [sorted(one.keys() & other.keys()) for one, other in pairs]
    names, days = max(zip(both_of, pairs, strict=True), key=lambda found: len(found[0]))
    draft.need_people(len(names), f"people walk for {needed_s:g} s in two sessions")
    rows = [np.array([day[name] for name in names]) for day in days]
    first, second = (_named(tracks, of_day, names) for of_day in rows)
    found = _closed(replace(draft, tracks=first, later=second), needed_s, _anywhere)
    place = np.array([names.index(name) for name in found.source])
    probe, gallery = (
        replace(side, about=circumstances(tracks, of_day[place[side.person]], side))
        for of_day, side in zip(rows, (found.probe, found.gallery), strict=True)
    )
    return replace(found, probe=probe, gallery=gallery)


def _named(tracks: Tracks, rows: Ints, names: Sequence[str]) -> Tracks:
    """Return some tracks, called by other names."""
    runs, offsets = runs_of(tracks.offsets, rows)
    t, xy = end_to_end(tracks.t, runs), end_to_end(tracks.xy, runs)
    group = tuple(tracks.group[row] for row in rows)
    return Tracks(t, xy, offsets, source=tuple(names), group=group)


def sample_at(shares: Floats, tracks: Tracks) -> Ints:
    """Return the samples at these shares, (N,) from 0 up to 1, of all time that people were seen.

    A sample stands for the time to the next one of its track, the last for that before
    it, and none for more than the usual step of the slowest track, lest a gap draw
    everybody. Where all samples stand for alike long each is as likely as another.
    """
    step_s = np.full(tracks.t.size, np.inf)  # a track of one sample tells of no step
    usual_s = []
    for first, end in pairwise(tracks.offsets.tolist()):
        steps_s = np.diff(tracks.t[first:end])
        if steps_s.size:
            step_s[first:end] = np.append(steps_s, steps_s[-1])
            usual_s.append(float(np.median(steps_s)))
    longest_s = max(usual_s, default=0.0)
    step_s = np.minimum(step_s, longest_s)
    if longest_s == 0.0 or step_s.min() >= _ALIKE * longest_s:
        return np.asarray((shares * tracks.t.size).astype(np.int64))
    until_s = np.cumsum(step_s)
    places = np.searchsorted(until_s, shares * until_s[-1], side="right")
    return np.asarray(np.minimum(places, tracks.t.size - 1))


def _closed(
    draft: Draft, length_s: float, starts_s: _Starts, *, needed_s: float = 0.0
) -> Sessions:
    """Return sessions in which everybody is in both: one search for each half of the people."""
    tracks, later = draft.tracks, replace(draft, tracks=draft.later)
    needed_s = needed_s or length_s
    what = f"of {len(tracks)} tracks last {needed_s:g} s"
    if not draft.task.is_one_walk:
        what = f"people walk for {needed_s:g} s in both sessions"
    # Who stays at home on the second day is left out.
    there = {later.tracks.source[row] for row in later.lasting(needed_s)}
    long = [
        row for row in draft.lasting(needed_s).tolist() if tracks.source[row] in there
    ]
    most = draft.settings.linkage.most_people
    if most < LEAST_PEOPLE:
        raise SettingsError(
            f"linkage.most_people must be at least {LEAST_PEOPLE}, got {most}"
        )
    draft.need_people(len(long), what)
    if draft.task.simulated:
        most = min(most, MOST_SIMULATED)
    rows = np.sort(draft.rng("people").permutation(long)[:most])
    source = [tracks.source[row] for row in rows]
    rows_later = rows_of(later.tracks, source)
    first_s = np.column_stack([draft.start_s[rows], later.start_s[rows_later]])
    last_s = np.column_stack([draft.end_s[rows], later.end_s[rows_later]])
    slack_s = np.maximum(last_s - first_s - needed_s, 0.0)
    streams = [draft.rng("windows", name) for name in source]
    starts = np.array(list(map(starts_s, first_s, slack_s, streams)))
    whose = (tracks.group, rows), (later.tracks.group, rows_later)
    group = joined(*([group[row] for row in some] for group, some in whose))
    if draft.task.comes_back:
        fold_of = np.zeros(rows.size, dtype=np.int64)
        cluster = np.unique(group, return_inverse=True)[1]
        may_teach, searches = cluster[:, None] != cluster, ["everybody"]
    else:
        fold_of = halves(group, rng=draft.rng("folds"))
        may_teach, searches = (
            np.stack([fold_of == 1, fold_of == 0]),
            ["half 1", "half 2"],
        )

    def windows(
        side: str, day: Draft, track: Ints, start_s: Floats, person: Ints
    ) -> Windows:
        start_s = start_s[person]
        found = day.cut(side, track[person], start_s, start_s + length_s)
        if draft.task.shows_scene:
            return found.windows(person, fold_of[person])
        # Put where somebody, anybody, once was.
        sizes = np.diff(found.offsets)
        middle_m = np.add.reduceat(found.xy, found.offsets[:-1]) / sizes[:, None]
        draws = [draft.rng("place", side, source[one]).random() for one in person]
        there_m = day.tracks.xy[sample_at(np.array(draws), day.tracks)]
        return found.windows(person, fold_of[person], shift_m=there_m - middle_m)

    # In an order of its own, lest a place in the list tell who is who.
    order = draft.rng("order").permutation(rows.size)
    return draft.sessions(
        rows,
        group=group,
        may_teach=may_teach,
        probe=windows("probe", draft, rows, starts[:, 0], np.arange(rows.size)),
        gallery=windows("gallery", later, rows_later, starts[:, 1], order),
        mate=np.argsort(order),
        fold=np.arange(len(searches)),
        searches=tuple(searches),
        too_short=len(tracks) - len(long),
        not_drawn=len(long) - rows.size,
    )


def joined(first: Sequence[str], second: Sequence[str]) -> tuple[str, ...]:
    """Return the cluster of each person: who shares a group in either session, or over others.

    Each is called by the first name, in alphabetical order, of its groups in the first
    session.
    """
    ids = tuple(map(str, range(len(first))))
    days = [
        (ids, [f"{day}{name}" for name in of]) for day, of in enumerate((first, second))
    ]
    members = [one for day in days for one in zip(*day, strict=True)]
    return tuple(
        one.removeprefix("group:0") for one in walking_groups(ids=ids, members=members)
    )


def handover(draft: Draft) -> Sessions:
    """Return windows before and after each instant at which every pseudonym rotates at once.

    Some people come or go meanwhile. Too few instants are refused, too.
    """
    tracks, settings, gap_s = draft.tracks, draft.settings.linkage, draft.task.gap_s
    least_s, window_s = settings.handover_least_s, settings.handover_window_s
    # The same instants whatever the gap, so that the gaps can be compared.
    longest_gap_s = max(task.gap_s for task in TASKS.values())
    first_s, last_s = float(tracks.t.min()), float(tracks.t.max())
    count = int(
        (last_s - first_s - longest_gap_s - least_s) / settings.handover_period_s
    )
    every_s = settings.handover_period_s * max(1.0, count / settings.handover_instants)
    at_s = first_s + every_s * np.arange(
        1.0, min(count, settings.handover_instants) + 1
    )
    # Which tracks are there until then, and after the gap, (S, N).
    ends_s, begins_s = at_s[:, None], at_s[:, None] + gap_s
    began_s, left_s = draft.start_s - CLOCK_S, draft.end_s + CLOCK_S
    before = (began_s <= ends_s - least_s) & (left_s >= ends_s)
    after = (began_s <= begins_s) & (left_s >= begins_s + least_s)
    # Where nobody is to be linked there is nothing to search.
    used = np.flatnonzero((before & after).any(axis=1))
    n_everybody = int((before | after)[used].any(axis=0).sum())
    used = np.intersect1d(used, _instants(draft, at_s, longest_gap_s))
    there = (before | after)[used]
    rows = np.flatnonzero(there.any(axis=0))
    draft.need_people(rows.size, "people are there when pseudonyms rotate")
    if used.size < N_FOLDS:
        raise DataError(
            f"task {draft.task.name}: {used.size} rotations of pseudonyms have people"
            " to link, but 2 are needed; use a longer recording or a shorter"
            " linkage.handover_period_s"
        )
    # Since the recording began: whatever its clock says, the same instant has the same
    # draws.
    labels = [f"{after:g} s" for after in at_s[used] - first_s]

    def windows(side: str, present: Bools, since_s: float, until_s: float) -> Windows:
        """Return those of one side of every rotation, those of each in an order of its own."""
        # By number among all instants: whatever the gap, the same instant has the same
        # draws.
        orders = {n: draft.rng("order", side, n) for n in used.tolist()}
        order = [
            rng.permutation(np.flatnonzero(present[n])) for n, rng in orders.items()
        ]
        row = np.concatenate(order)
        search = np.repeat(np.arange(used.size), [part.size for part in order])
        start_s, end_s = (
            at_s[used][search] + after_s for after_s in (since_s, until_s)
        )
        stretches = draft.cut(side, row, start_s, end_s, [labels[n] for n in search])
        return stretches.windows(np.searchsorted(rows, row), search)

    probe = windows("probe", before, -window_s, 0.0)
    gallery = windows("gallery", after, gap_s, gap_s + window_s)
    place = np.full((used.size, rows.size), -1)
    place[gallery.search, gallery.person] = np.arange(len(gallery))
    fold = (np.arange(used.size) * N_FOLDS) // used.size
    # Whoever is seen in the other half alone may teach, company included.
    group = tuple(tracks.group[row] for row in rows)
    cluster = np.unique(group, return_inverse=True)[1]
    seen = np.stack(
        [there[fold == half][:, rows].any(axis=0) for half in range(N_FOLDS)]
    )
    company = np.stack([np.bincount(cluster, one) > 0 for one in seen])[:, cluster]
    return draft.sessions(
        rows,
        group=group,
        may_teach=seen[::-1] & ~company,
        probe=probe,
        gallery=gallery,
        mate=place[probe.search, probe.person],
        fold=fold,
        searches=tuple(labels),
        too_short=len(tracks) - n_everybody,
        not_drawn=n_everybody - rows.size,
    )


def _instants(draft: Draft, at_s: Floats, gap_s: float) -> Ints:
    """Return which instants are used: all, or some with `linkage.most_people` people, drawn."""
    began_s, left_s = draft.start_s - CLOCK_S, draft.end_s + CLOCK_S
    there = (began_s <= at_s[:, None] + gap_s) & (left_s >= at_s[:, None])
    drawn = draft.rng("instants").permutation(at_s.size)
    n_people = np.logical_or.accumulate(there[drawn], axis=0).sum(axis=1)
    few = int((n_people <= draft.settings.linkage.most_people).sum())
    return np.sort(drawn[: max(few, N_FOLDS)])


_MAKERS: Final[Mapping[str, Callable[[Draft], Sessions]]] = {
    make.__name__: make
    for make in (rerelease, split, new_traversal, cross_session, handover)
}
"""By the family of the task."""


def sessions_of(
    task: Task,
    *,
    tracks: Tracks,
    stages: StageSettings,
    seed: int,
    later: Tracks | None = None,
) -> Sessions:
    """Return the sessions of a task: of the recording, or of the two-session crowd.

    `later` is the second session, if it is another than that of the bundled crowd.
    DataError if there are too few people for the task, or a half of them has nobody to
    link or to learn from; SettingsError if there is no task of this name.
    """
    make = _MAKERS[task_named(task.name).family]
    if task.simulated and later is None:
        crowd = _crowd(stages.linkage.trait_strength)
        tracks, later = placed_together(crowd, settings=stages)
    found = make(
        Draft(
            task=task, tracks=tracks, later=later or tracks, settings=stages, seed=seed
        )
    )
    if task.comes_back:
        return found
    mated = found.mate >= 0
    fold, person = found.fold[found.probe.search[mated]], found.probe.person[mated]
    for half in range(N_FOLDS):
        mine, others = person[fold == half], person[fold != half]
        if mine.size < 2 or not found.learns[half][others].any():  # noqa: PLR2004 - one alone has no other
            raise DataError(
                f"task {task.name}: half of the people have no mate, or no other people"
                " to train on, since too many share a walking group or are present all"
                " the time; use a recording of more people or leave the task out"
                " (--task)"
            )
    return found


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
