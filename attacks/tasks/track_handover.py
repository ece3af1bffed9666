"""Handovers of tracks: all pseudonyms rotate while a tracker breaks and swaps tracks.

A window of a track belongs to the person who has more than half of its samples. A window
without such a person belongs to nobody: it is a probe and a candidate without a mate.

A trial is a person who is truly present on both sides of a rotation, as in the handover
of people (`attacks.tasks.handover`). Of the person's own windows, those with most of the
person's samples are probe and mate. Without either nobody can link the person: the trial
is lost. So a tracker that loses everybody has no link, not no trial.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from attacks.tasks.draft import CLOCK_S
from attacks.tasks.handover import rotation_times, seen_in_other_half
from attacks.tasks.sessions import N_FOLDS, Sessions, Windows, roles
from attacks.tasks.task_list import Task
from isac_track.config import LinkageSettings
from isac_track.patrols.patrol import Patrol
from isac_track.rng import stream
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Bools, Floats, Ints, Release, derived, stretches

NOBODY: Final = "nobody"  # Source and group of windows without an owner.
MISSING: Final = -1


@dataclass(frozen=True, eq=False, slots=True)
class Trials:
    """D people present on both sides of a rotation, and their windows."""

    rotation: Ints  # (D,) number of the rotation.
    person: Ints  # (D,) row of the patrol's people.
    probe: Ints  # (D,) window of the person before it, or `MISSING`.
    gallery: Ints  # (D,) window of the person after it, or `MISSING`.

    @property
    def is_linkable(self) -> Bools:
        """Whether the person has a probe and a mate, (D,)."""
        return np.asarray((self.probe != MISSING) & (self.gallery != MISSING))


@dataclass(frozen=True, eq=False, slots=True)
class TrackHandover:
    """Windows of tracks around rotations of pseudonyms, and what is to be linked."""

    trials: Trials
    # Without at least two rotations with somebody to link there is no search.
    sessions: Sessions | None
    releases: tuple[Release, ...]  # Of the windows before and after.


@dataclass(frozen=True, eq=False, slots=True)
class _Side:
    """W windows of tracks on a side of all rotations."""

    rotation: Ints  # (W,)
    rows: Ints  # (M,) samples of the windows, end to end.
    offsets: Ints  # (W + 1,)
    owner: Ints  # (W,) person with more than half of the samples, or `CLUTTER`.
    n_own: Ints  # (W,) samples of the owner.


def track_handover(
    task: Task,
    patrol: Patrol,
    shared: SharedTracks,
    *,
    settings: LinkageSettings,
    seed: int,
) -> TrackHandover:
    """Return the windows of tracks before and after each rotation of pseudonyms.

    A track counts under the rule of people: it goes on at the rotation, and has shown
    itself for `handover_least_s` on its side.
    """
    at_s = rotation_times(
        float(patrol.scan_s[0]), float(patrol.people.t.max()), settings=settings
    )
    least_s, window_s = settings.handover_least_s, settings.handover_window_s
    begin_s = at_s + task.gap_s
    start_s = shared.release.t[shared.release.offsets[:-1]]
    end_s = patrol.scan_s[shared.last]
    before = _present_throughout(start_s, end_s, at_s - least_s, at_s)
    after = _present_throughout(start_s, end_s, begin_s, begin_s + least_s)
    rng = stream(seed, "linkage", "tracks", task.family, "order")
    probe = _cut_windows(shared, before, at_s - window_s, at_s, rng)
    gallery = _cut_windows(shared, after, begin_s, begin_s + window_s, rng)
    people = patrol.people
    came_s = people.t[people.offsets[:-1]]
    left_s = people.t[people.offsets[1:] - 1]
    present_before = _present_throughout(came_s, left_s, at_s - least_s, at_s)
    present_after = _present_throughout(came_s, left_s, begin_s, begin_s + least_s)
    trials = _trials(present_before & present_after, probe, gallery)
    # A rotation with nobody to link has no search.
    used = np.unique(trials.rotation[trials.is_linkable])
    if used.size < N_FOLDS:
        return TrackHandover(trials, None, ())
    sides = tuple(_take_rotations(side, used) for side in (probe, gallery))
    trials = _trials(present_before & present_after, *sides)
    sessions = _sessions(
        task,
        patrol,
        shared,
        trials=trials,
        sides=sides,
        present=(present_before | present_after)[used],
        used=used,
        seed=seed,
    )
    return TrackHandover(
        trials, sessions, tuple(_release(shared, side) for side in sides)
    )


def _trials(present: Bools, probe: _Side, gallery: _Side) -> Trials:
    """Return the trials of people present on both sides of rotations, (S, N)."""
    rotation, person = np.nonzero(present)
    return Trials(
        rotation=rotation,
        person=person,
        probe=_largest_windows(probe, present.shape)[rotation, person],
        gallery=_largest_windows(gallery, present.shape)[rotation, person],
    )


def _take_rotations(side: _Side, used: Ints) -> _Side:
    """Return the windows of some rotations."""
    window = np.flatnonzero(np.isin(side.rotation, used))
    place, offsets = stretches(side.offsets[window], np.diff(side.offsets)[window])
    return _Side(
        rotation=side.rotation[window],
        rows=side.rows[place],
        offsets=offsets,
        owner=side.owner[window],
        n_own=side.n_own[window],
    )


def _present_throughout(
    start_s: Floats, end_s: Floats, first_s: Floats, last_s: Floats
) -> Bools:
    """Return who is there from a time to another at each rotation, (S, N)."""
    came = start_s - CLOCK_S <= first_s[:, None]
    return np.asarray(came & (end_s + CLOCK_S >= last_s[:, None]))


def _cut_windows(
    shared: SharedTracks,
    present: Bools,
    first_s: Floats,
    last_s: Floats,
    rng: np.random.Generator,
) -> _Side:
    """Return the windows of the tracks present at each rotation, in a drawn order."""
    t, offsets = shared.release.t, shared.release.offsets
    rotations, firsts, sizes = [], [], []
    for number in range(len(present)):
        track = rng.permutation(np.flatnonzero(present[number]))
        in_window = (t >= first_s[number] - CLOCK_S) & (t <= last_s[number] + CLOCK_S)
        before = np.append(0, np.cumsum(in_window))
        size = before[offsets[track + 1]] - before[offsets[track]]
        begins = np.append(0, np.cumsum(t < first_s[number] - CLOCK_S))
        first = offsets[track] + begins[offsets[track + 1]] - begins[offsets[track]]
        rotations.append(np.full(track.size, number)[size > 0])
        firsts.append(first[size > 0])
        sizes.append(size[size > 0])
    none = np.zeros(0, dtype=np.int64)
    size = np.concatenate([none, *sizes])
    rows, cuts = stretches(np.concatenate([none, *firsts]), size)
    owner, n_own = _owners(shared.person[rows], cuts)
    return _Side(np.concatenate([none, *rotations]), rows, cuts, owner, n_own)


def _owners(person: Ints, offsets: Ints) -> tuple[Ints, Ints]:
    """Return who has more than half of each window, or `CLUTTER`, and the samples."""
    sizes = np.diff(offsets)
    window = np.repeat(np.arange(sizes.size), sizes)
    owner, n_own = np.full(sizes.size, CLUTTER), np.zeros(sizes.size, dtype=np.int64)
    if not window.size:
        return owner, n_own
    pairs, count = np.unique(np.stack([window, person]), axis=1, return_counts=True)
    is_most = (2 * count > sizes[pairs[0]]) & (pairs[1] != CLUTTER)
    owner[pairs[0][is_most]] = pairs[1][is_most]
    n_own[pairs[0][is_most]] = count[is_most]
    return owner, n_own


def _largest_windows(side: _Side, shape: tuple[int, ...]) -> Ints:
    """Return the window with most samples of each person, (S, N), or `MISSING`."""
    best = np.full(shape, MISSING)
    window = np.flatnonzero(side.owner != CLUTTER)
    # The last that is written has the most samples; of equals it is the first window.
    window = window[np.lexsort((-window, side.n_own[window]))]
    best[side.rotation[window], side.owner[window]] = window
    return best


def _release(shared: SharedTracks, side: _Side) -> Release:
    """Return windows as a release, under pseudonyms of their own."""
    release = shared.release
    return derived(
        release,
        t=release.t[side.rows],
        xy=release.xy[side.rows],
        sigma=None if release.sigma is None else release.sigma[side.rows],
        cov=None if release.cov is None else release.cov[side.rows],
        offsets=side.offsets,
        pseudonym=tuple(map(str, range(side.rotation.size))),
    )


def _sessions(
    task: Task,
    patrol: Patrol,
    shared: SharedTracks,
    *,
    trials: Trials,
    sides: tuple[_Side, ...],
    present: Bools,
    used: Ints,
    seed: int,
) -> Sessions:
    """Return the windows of the `used` rotations, (U,), as sessions of people.

    `present`, (U, N), are the people on either side of each.
    """
    people, n_people = patrol.people, len(patrol.people)
    group = (*people.group, NOBODY)
    fold = (np.arange(used.size) * N_FOLDS) // used.size
    # The owner of a window is seen, and so is nobody: no adversary learns from those.
    seen = np.ones((used.size, n_people + 1), dtype=bool)
    seen[:, :n_people] = present
    for side in sides:
        owned = np.flatnonzero(side.owner != CLUTTER)
        number = np.searchsorted(used, side.rotation[owned])
        seen[number, side.owner[owned]] = True
    learns, calibrates = roles(
        group,
        may_teach=seen_in_other_half(seen, fold=fold, group=group),
        rng=stream(seed, "linkage", "tracks", task.family, "roles"),
    )
    probe, gallery = (_windows(patrol, shared, side, used) for side in sides)
    mate = np.full(len(probe), MISSING)
    linkable = trials.is_linkable
    mate[trials.probe[linkable]] = trials.gallery[linkable]
    everybody = np.ones(n_people + 1, dtype=bool)
    return Sessions(
        task=task,
        source=(*people.source, NOBODY),
        group=group,
        alone=everybody,
        moving=everybody,
        probe=probe,
        gallery=gallery,
        mate=mate,
        fold=fold,
        searches=tuple(map(str, used.tolist())),
        learns=learns,
        calibrates=calibrates,
        too_short=0,
        not_drawn=0,
    )


def _windows(patrol: Patrol, shared: SharedTracks, side: _Side, used: Ints) -> Windows:
    """Return one side with the true places behind its samples."""
    people, scan, person = (
        patrol.people,
        shared.scan[side.rows],
        shared.person[side.rows],
    )
    is_clutter = person == CLUTTER  # It has no truth and stays where it is.
    first = people.offsets[np.where(is_clutter, 0, person)]
    row = np.where(is_clutter, 0, first + scan - patrol.scan[first])
    released = shared.release.xy[side.rows]
    return Windows(
        t=shared.release.t[side.rows],
        xy=np.where(is_clutter[:, None], released, people.xy[row]),
        offsets=side.offsets,
        person=np.where(side.owner == CLUTTER, len(people), side.owner),
        search=np.searchsorted(used, side.rotation),
    )
