"""What is to be linked: windows of true walks, and who is who in them.

All start from the recorded tracks; sensing, sharing and the frames that an adversary sees come
later. Where a task hides the frame, each window is first put in another place of the recording:
sensed twice in one place, a walk would be known by its distance from the base station, on which
the noise depends. `attacks.linkage.task_list` says which tasks there are.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from attacks.linkage.task_list import TASKS, Task
from isac_track.datasets.summary import summarise
from isac_track.errors import DataError, SettingsError
from isac_track.resample import sampling_times, walk
from isac_track.rng import stream
from isac_track.types import read_only

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.random import Generator

    from isac_track.config import StageSettings
    from isac_track.types import Bools, Floats, Ints, Tracks

LEAST_PEOPLE = 24
"""Fewer cannot be split into people to learn from, to calibrate on and to attack, twice."""
CALIBRATING_SHARE = 1 / 3
"""Of the people to learn from, who are kept apart for the calibration of scores."""
_CLOCK_S = 1e-9
"""Room for the rounding of a frame clock: 12 s at 25 Hz is 300 frames."""
_N_FOLDS = 2


@dataclass(frozen=True, eq=False, slots=True)
class Windows:
    """N stretches of true walks, M samples in all, where they are sensed."""

    t: Floats
    """(M,) s"""
    xy: Floats
    """(M, 2) m"""
    offsets: Ints
    """(N + 1,)"""
    person: Ints
    """(N,) row in the people of the `Sessions`."""
    search: Ints
    """(N,) which search it belongs to: candidates are compared within one."""

    def __post_init__(self) -> None:
        for name in ("t", "xy", "offsets", "person", "search"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __len__(self) -> int:
        return self.offsets.size - 1


@dataclass(frozen=True, eq=False, slots=True)
class Sessions:
    """Both releases of a task, still true, and who may learn from whom."""

    task: Task
    source: tuple[str, ...]
    """(K,) id of each person's recorded track."""
    group: tuple[str, ...]
    """(K,) cluster: people who walk together, in either session."""
    alone: Bools
    """(K,) False for members of a walking group, who move alike."""
    moving: Bools
    """(K,) False for nearly frozen annotations."""
    probe: Windows
    gallery: Windows
    mate: Ints
    """(P,) gallery window of the same person in the same search, or -1."""
    fold: Ints
    """(S,) half of each search; its adversary learns on the other half."""
    searches: tuple[str, ...]
    """(S,) for people: a fold's number, or the instant of a handover."""
    learns: Bools
    """(2, K) people from whom the adversary of either fold learns."""
    calibrates: Bools
    """(2, K) people on whose scores those of either fold are calibrated."""
    too_short: int
    """Recorded tracks that are left out: shorter than the windows, or not there at the time."""
    not_drawn: int
    """Further ones beyond `linkage.most_people`."""

    def __post_init__(self) -> None:
        for name in ("alone", "moving", "mate", "fold", "learns", "calibrates"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        _assert_apart(self)


def build(
    task: Task, *, tracks: Tracks, later: Tracks | None, settings: StageSettings, seed: int
) -> Sessions:
    """Return the two sessions of a task.

    Parameters
    ----------
    task : Task
    tracks : Tracks
        The recording; for ``new_traversal`` the crowd's first session.
    later : Tracks or None
        The crowd's second session.
    settings : StageSettings
    seed : int

    Raises
    ------
    DataError
        If the recording has too few people for the task.
    """
    draft = _Draft(task=task, tracks=tracks, later=later, settings=settings, seed=seed)
    make: dict[str, Callable[[_Draft], Sessions]] = {
        "rerelease": _rerelease,
        "split": _split,
        "new_traversal": _new_traversal,
    }
    found = make.get(task.name, _handover)(draft)
    _need_halves(found)
    return found


@dataclass(frozen=True, eq=False, slots=True)
class _Draft:
    task: Task
    tracks: Tracks
    later: Tracks | None
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
        return np.flatnonzero(self.end_s - self.start_s >= duration_s - _CLOCK_S)

    def chosen(self, rows: Ints, what: str) -> Ints:
        """Return who of these is linked: all, or as many as the settings allow.

        Raises
        ------
        DataError
            If they are too few; `what` says of whom.
        """
        if self.settings.linkage.most_people < LEAST_PEOPLE:
            raise SettingsError(
                f"linkage.most_people must be at least {LEAST_PEOPLE}, "
                f"got {self.settings.linkage.most_people}"
            )
        _need_people(rows.size, self.task, what)
        drawn = self.rng("people").permutation(rows)[: self.settings.linkage.most_people]
        return np.sort(drawn)


def _need_people(found: int, task: Task, what: str) -> None:
    if found < LEAST_PEOPLE:
        raise DataError(
            f"task {task.name}: {found} {what}, but it takes {LEAST_PEOPLE}; use a longer "
            "recording, shorter windows (--set linkage....) or leave the task out (--task)"
        )


def _need_halves(sessions: Sessions) -> None:
    """Refuse a task where a half has nobody to link, or nobody to learn from.

    Raises
    ------
    DataError
    """
    mated = np.flatnonzero(sessions.mate >= 0)
    fold = sessions.fold[sessions.probe.search[mated]]
    person = sessions.probe.person[mated]
    for half in range(_N_FOLDS):
        mine, others = person[fold == half], person[fold != half]
        if mine.size < 2 or not sessions.learns[half][others].any():  # noqa: PLR2004 - one alone has no other
            raise DataError(
                f"task {sessions.task.name}: half of the people has nobody to link, or nobody "
                "else to learn from: too many belong to one walking group, or are there all the "
                "time; use a recording of more people or leave the task out (--task)"
            )


def _rerelease(draft: _Draft) -> Sessions:
    length_s = draft.settings.linkage.window_s
    shift_s = draft.settings.linkage.rerelease_shift_s
    long = draft.lasting(length_s)
    rows = draft.chosen(long, f"of {len(draft.tracks)} tracks last {length_s:g} s")
    starts = np.empty((2, rows.size))
    for place, row in enumerate(rows):
        rng = draft.rng("windows", draft.tracks.source[row])
        slack_s = max(float(draft.end_s[row] - draft.start_s[row]) - length_s, 0.0)
        reach_s = min(slack_s, shift_s)
        base_s = draft.start_s[row] + rng.uniform(0.0, slack_s - reach_s)
        starts[:, place] = base_s + rng.uniform(0.0, reach_s, 2)
    return _closed(draft, rows=rows, starts=starts, length_s=length_s, n_long=long.size)


def _split(draft: _Draft) -> Sessions:
    length_s, gap_s = draft.settings.linkage.split_window_s, draft.settings.linkage.split_gap_s
    needed_s = 2.0 * length_s + gap_s
    long = draft.lasting(needed_s)
    rows = draft.chosen(long, f"of {len(draft.tracks)} tracks last {needed_s:g} s")
    starts = np.empty((2, rows.size))
    for place, row in enumerate(rows):
        rng = draft.rng("windows", draft.tracks.source[row])
        slack_s = max(float(draft.end_s[row] - draft.start_s[row]) - needed_s, 0.0)
        first_s, second_s = np.sort(rng.uniform(0.0, slack_s, 2))
        starts[:, place] = (
            draft.start_s[row] + first_s,
            (draft.start_s[row] + length_s + gap_s + second_s),
        )
    return _closed(draft, rows=rows, starts=starts, length_s=length_s, n_long=long.size)


def _new_traversal(draft: _Draft) -> Sessions:
    assert draft.later is not None
    length_s, later = draft.settings.linkage.window_s, draft.later
    row_later = {source: row for row, source in enumerate(later.source)}
    lasts_s = later.t[later.offsets[1:] - 1] - later.t[later.offsets[:-1]]
    both = [
        row
        for row in draft.lasting(length_s)
        if draft.tracks.source[row] in row_later  # who stays at home on the second day is left out
        and lasts_s[row_later[draft.tracks.source[row]]] >= length_s - _CLOCK_S
    ]
    rows = draft.chosen(
        np.array(both, dtype=np.int64), f"people walk for {length_s:g} s in both sessions"
    )
    rows_later = np.array([row_later[draft.tracks.source[row]] for row in rows])
    starts = np.empty((2, rows.size))
    for place, row in enumerate(rows):
        rng = draft.rng("windows", draft.tracks.source[row])
        slack_s = float(draft.end_s[row] - draft.start_s[row]) - length_s
        slack_later_s = float(lasts_s[rows_later[place]]) - length_s
        start_later_s = later.t[later.offsets[rows_later[place]]]
        starts[0, place] = draft.start_s[row] + rng.uniform(0.0, max(slack_s, 0.0))
        starts[1, place] = start_later_s + rng.uniform(0.0, max(slack_later_s, 0.0))
    return _closed(
        draft,
        rows=rows,
        starts=starts,
        length_s=length_s,
        n_long=len(both),
        rows_later=rows_later,
    )


def _closed(
    draft: _Draft,
    *,
    rows: Ints,
    starts: Floats,
    length_s: float,
    n_long: int,
    rows_later: Ints | None = None,
) -> Sessions:
    """Return sessions in which everybody is in both: one search for each half of the people."""
    tracks, later = draft.tracks, draft.tracks if draft.later is None else draft.later
    rows_later = rows if rows_later is None else rows_later
    source = tuple(tracks.source[row] for row in rows)
    group = _joined([tracks.group[row] for row in rows], [later.group[row] for row in rows_later])
    fold_of = _halves(group, rng=draft.rng("folds"))
    cut = partial(_windows, draft, length_s=length_s)
    everybody = np.arange(rows.size)
    probe = cut("probe", tracks, rows=rows, start_s=starts[0], person=everybody, search=fold_of)
    # In an order of its own, lest a place in the list tell who is who.
    order = draft.rng("order").permutation(rows.size)
    probe = _elsewhere(draft, "probe", tracks, probe, source)
    gallery = cut(
        "gallery",
        later,
        rows=rows_later[order],
        start_s=starts[1][order],
        person=order,
        search=fold_of[order],
    )
    gallery = _elsewhere(draft, "gallery", later, gallery, source)
    learns, calibrates = _roles(
        group, may_teach=np.stack([fold_of == 1, fold_of == 0]), rng=draft.rng("roles")
    )
    return Sessions(
        task=draft.task,
        source=source,
        group=group,
        alone=_alone(tracks, rows) & _alone(later, rows_later),
        moving=~(summarise(tracks).frozen[rows] | summarise(later).frozen[rows_later]),
        probe=probe,
        gallery=gallery,
        mate=np.argsort(order),
        fold=np.arange(_N_FOLDS),
        searches=("half 1", "half 2"),
        learns=learns,
        calibrates=calibrates,
        too_short=len(tracks) - n_long,
        not_drawn=n_long - rows.size,
    )


def _handover(draft: _Draft) -> Sessions:
    settings, tracks = draft.settings.linkage, draft.tracks
    gap_s, least_s = draft.task.gap_s, settings.handover_least_s
    # The same instants whatever the gap, so that the gaps can be compared.
    longest_gap_s = max(task.gap_s for task in TASKS.values())
    first_s, last_s = float(tracks.t.min()), float(tracks.t.max())
    count = int((last_s - first_s - longest_gap_s - least_s) / settings.handover_period_s)
    every_s = settings.handover_period_s * max(1.0, count / settings.handover_instants)
    count = min(count, settings.handover_instants)
    instants = first_s + every_s * np.arange(1, count + 1)
    before = [
        np.flatnonzero((draft.start_s <= at - least_s) & (draft.end_s >= at)) for at in instants
    ]
    after = [
        np.flatnonzero((draft.start_s <= at + gap_s) & (draft.end_s >= at + gap_s + least_s))
        for at in instants
    ]
    # Where nobody is to be linked there is nothing to search.
    used = [n for n in range(count) if np.intersect1d(before[n], after[n]).size]
    there = [present[n] for present in (before, after) for n in used]
    rows = np.unique(np.concatenate([*there, np.zeros(0, dtype=np.int64)]))
    _need_people(rows.size, draft.task, "people are there when pseudonyms rotate")
    if len(used) < _N_FOLDS:
        raise DataError(
            f"task {draft.task.name}: pseudonyms rotate {len(used)} times with somebody to link, "
            "but it takes 2; use a longer recording or a shorter linkage.handover_period_s"
        )
    person_of = np.full(len(tracks), -1)
    person_of[rows] = np.arange(rows.size)
    fold = (np.arange(len(used)) * _N_FOLDS) // len(used)
    labels = tuple(f"{instants[n]:g} s" for n in used)
    sides = []
    for side, present in (("probe", before), ("gallery", after)):
        order = [draft.rng("order", side, n).permutation(present[n]) for n in used]
        row = np.concatenate(order)
        search = np.repeat(np.arange(len(used)), [part.size for part in order])
        at = instants[used][search] + (gap_s if side == "gallery" else 0.0)
        if side == "probe":
            start_s = np.maximum(draft.start_s[row], at - settings.handover_window_s)
            length_s = at - start_s
        else:
            start_s = at
            length_s = np.minimum(draft.end_s[row], at + settings.handover_window_s) - start_s
        sides.append(
            _windows(
                draft,
                side,
                tracks,
                rows=row,
                start_s=start_s,
                length_s=length_s,
                person=person_of[row],
                search=search,
                keys=[labels[n] for n in search],
            )
        )
    probe, gallery = sides
    place = {
        (int(n), int(who)): column
        for column, (n, who) in enumerate(zip(gallery.search, gallery.person, strict=True))
    }
    group = tuple(tracks.group[row] for row in rows)
    # Whoever is seen in a half, or has company that is, teaches nobody who attacks that half.
    seen = np.zeros((_N_FOLDS, rows.size), dtype=bool)
    for one_side in sides:
        seen[fold[one_side.search], one_side.person] = True
    cluster = np.unique(group, return_inverse=True)[1]
    seen_cluster = np.stack([np.bincount(cluster, one) > 0 for one in seen])
    may_teach = seen[::-1] & ~seen_cluster[:, cluster]
    learns, calibrates = _roles(group, may_teach=may_teach, rng=draft.rng("roles"))
    return Sessions(
        task=draft.task,
        source=tuple(tracks.source[row] for row in rows),
        group=group,
        alone=_alone(tracks, rows),
        moving=~summarise(tracks).frozen[rows],
        probe=probe,
        gallery=gallery,
        mate=np.array(
            [
                place.get((int(n), int(who)), -1)
                for n, who in zip(probe.search, probe.person, strict=True)
            ]
        ),
        fold=fold,
        searches=labels,
        learns=learns,
        calibrates=calibrates,
        too_short=len(tracks) - rows.size,
        not_drawn=0,
    )


def _windows(
    draft: _Draft,
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
    """Return stretches of walks, each at sampling instants of its own."""
    walks = {row: walk(tracks[row]) for row in np.unique(rows).tolist()}
    lengths = np.broadcast_to(np.asarray(length_s, dtype=np.float64), rows.shape)
    t_parts, xy_parts = [], []
    # Where a walk is cut more than once its windows have a key each.
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


def _elsewhere(
    draft: _Draft, side: str, tracks: Tracks, windows: Windows, source: tuple[str, ...]
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


def _joined(first: Sequence[str], second: Sequence[str]) -> tuple[str, ...]:
    """Return the cluster of each person: who shares a group in either session, or over others."""
    parent: dict[tuple[int, str], tuple[int, str]] = {}

    def root(name: tuple[int, str]) -> tuple[int, str]:
        while parent[name] != name:
            parent[name] = parent[parent[name]]
            name = parent[name]
        return name

    for one, other in zip(first, second, strict=True):
        names = [(0, one), (0 if first == second else 1, other)]
        for name in names:
            parent.setdefault(name, name)
        low, high = sorted(map(root, names))
        parent[high] = low
    return tuple(root((0, one))[1] for one in first)


def _halves(group: tuple[str, ...], *, rng: Generator) -> Ints:
    """Return the half of each person, (K,) 0 or 1: groups stay whole, halves are of like size."""
    names, cluster, sizes = np.unique(group, return_inverse=True, return_counts=True)
    half = np.empty(names.size, dtype=np.int64)
    count = [0, 0]
    # Large groups first, each to the smaller half.
    drawn = rng.permutation(names.size)
    for name in drawn[np.argsort(-sizes[drawn], kind="stable")]:
        half[name] = int(count[1] < count[0])
        count[half[name]] += sizes[name]
    return half[cluster]


def _roles(group: tuple[str, ...], *, may_teach: Bools, rng: Generator) -> tuple[Bools, Bools]:
    """Return who is learnt from and who calibrates, (2, K) each: groups stay whole."""
    cluster = np.unique(group, return_inverse=True)[1]
    calibrates = np.zeros_like(may_teach)
    for fold, teachers in enumerate(may_teach):
        clusters = rng.permutation(np.unique(cluster[teachers]))
        # One at least, where there is another one to learn from.
        few = min(max(round(CALIBRATING_SHARE * clusters.size), 1), clusters.size - 1)
        calibrates[fold] = teachers & np.isin(cluster, clusters[: max(few, 0)])
    return may_teach & ~calibrates, calibrates


def _alone(tracks: Tracks, rows: Ints) -> Bools:
    """Return which of these tracks are the only ones of their group in the recording."""
    _, cluster, sizes = np.unique(tracks.group, return_inverse=True, return_counts=True)
    alone: Bools = sizes[cluster][rows] == 1
    return alone


def _assert_apart(sessions: Sessions) -> None:
    """Assert that nobody is attacked by who learnt from them or from their group."""
    cluster = np.unique(sessions.group, return_inverse=True)[1]
    for fold in range(_N_FOLDS):
        teaches = sessions.learns[fold] | sessions.calibrates[fold]
        for side in (sessions.probe, sessions.gallery):
            attacked = side.person[sessions.fold[side.search] == fold]
            if np.intersect1d(cluster[attacked], cluster[teaches]).size:
                raise AssertionError("a victim's group is among the training people")
    if np.intersect1d(
        cluster[sessions.learns.any(axis=0)], cluster[sessions.calibrates.any(axis=0)]
    ).size:
        raise AssertionError("scores are calibrated on people who were learnt from")
