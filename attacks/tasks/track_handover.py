"""Handovers of tracks: all pseudonyms rotate while a tracker breaks and swaps tracks.

The majority owner of a window is the person with more than half of its samples. Whole
tracks are judged by a plurality instead, the person with most samples
(`isac_track.tracking.metrics`). A window without a majority owner belongs to nobody: it
is a probe and a candidate without a mate.

A trial is a person who is truly present on both sides of a rotation, as in the handover
of people (`attacks.tasks.handover`). Of the person's own windows, those with most of the
person's samples are probe and mate. Without either nobody can link the person: the trial
is lost. So a tracker that loses everybody has no link, not no trial.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from attacks.tasks.folds import (
    N_FOLDS,
    present_in_other_fold,
    set_calibrators_aside,
)
from attacks.tasks.rotations import find_rotations
from attacks.tasks.task_input import CLOCK_S
from attacks.tasks.task_list import Task
from attacks.tasks.windows import TaskWindows, Windows
from isac_track.config import LinkageSettings
from isac_track.patrols.patrol import Patrol
from isac_track.rng import stream
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Bools, Floats, Ints, Release, derived, stretches

NOBODY: Final = "nobody"  # Source and group of windows without a majority owner.
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
    task_windows: TaskWindows | None
    releases: tuple[Release, ...]  # Of the windows before and after.


@dataclass(frozen=True, eq=False, slots=True)
class _TrackWindows:
    """W windows of tracks on one side, before or after all rotations."""

    rotation: Ints  # (W,)
    rows: Ints  # (M,) samples of the windows, end to end.
    offsets: Ints  # (W + 1,)
    majority_owner: Ints  # (W,) person with more than half of them, or `CLUTTER`.
    n_owned: Ints  # (W,) samples of that person.


@dataclass(frozen=True, eq=False, slots=True)
class _Sides:
    """Windows of tracks and N truly present people on both sides of S rotations."""

    probe: _TrackWindows
    gallery: _TrackWindows
    present_before: Bools  # (S, N)
    present_after: Bools  # (S, N)

    def trials(self) -> Trials:
        """Return the trials: everybody present on both sides of a rotation."""
        shape = self.present_before.shape
        rotation, person = np.nonzero(self.present_before & self.present_after)
        return Trials(
            rotation=rotation,
            person=person,
            probe=_largest_windows(self.probe, shape)[rotation, person],
            gallery=_largest_windows(self.gallery, shape)[rotation, person],
        )

    def at_rotations(self, used: Ints) -> "_Sides":
        """Return the same sides with the windows of some rotations alone."""
        return _Sides(
            probe=_select_rotations(self.probe, used),
            gallery=_select_rotations(self.gallery, used),
            present_before=self.present_before,
            present_after=self.present_after,
        )


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
    sides = _cut_sides(task, patrol, shared, settings=settings, seed=seed)
    trials = sides.trials()
    # A rotation with nobody to link has no search.
    used = np.unique(trials.rotation[trials.is_linkable])
    if used.size < N_FOLDS:
        return TrackHandover(trials, None, ())
    # Windows have other numbers without those of the other rotations.
    sides = sides.at_rotations(used)
    trials = sides.trials()
    return TrackHandover(
        trials,
        _task_windows(task, patrol, shared, sides, trials, used=used, seed=seed),
        (_release(shared, sides.probe), _release(shared, sides.gallery)),
    )


def _cut_sides(
    task: Task,
    patrol: Patrol,
    shared: SharedTracks,
    *,
    settings: LinkageSettings,
    seed: int,
) -> _Sides:
    """Return the windows of all tracks around all rotations."""
    people, window_s = patrol.people, settings.handover_window_s
    rotations = find_rotations(
        float(patrol.scan_s[0]), float(people.t.max()), task=task, settings=settings
    )
    start_s = shared.release.t[shared.release.offsets[:-1]]
    end_s = patrol.scan_s[shared.last]
    rng = stream(seed, "linkage", "tracks", task.family, "order")
    # The gallery is drawn after the probes, from the same stream.
    probe = _cut_windows(
        shared,
        rotations.present_before(start_s, end_s),
        rotations.old_end_s - window_s,
        rotations.old_end_s,
        rng,
    )
    gallery = _cut_windows(
        shared,
        rotations.present_after(start_s, end_s),
        rotations.new_begin_s,
        rotations.new_begin_s + window_s,
        rng,
    )
    came_s, left_s = people.t[people.offsets[:-1]], people.t[people.offsets[1:] - 1]
    return _Sides(
        probe=probe,
        gallery=gallery,
        present_before=rotations.present_before(came_s, left_s),
        present_after=rotations.present_after(came_s, left_s),
    )


def _select_rotations(side: _TrackWindows, used: Ints) -> _TrackWindows:
    """Return the windows of some rotations."""
    window = np.flatnonzero(np.isin(side.rotation, used))
    rows, offsets = stretches(side.offsets[window], np.diff(side.offsets)[window])
    return _TrackWindows(
        rotation=side.rotation[window],
        rows=side.rows[rows],
        offsets=offsets,
        majority_owner=side.majority_owner[window],
        n_owned=side.n_owned[window],
    )


def _cut_windows(
    shared: SharedTracks,
    present: Bools,
    first_s: Floats,
    last_s: Floats,
    rng: np.random.Generator,
) -> _TrackWindows:
    """Return the windows of the tracks present at each rotation, in a drawn order.

    `present` is (S, number of tracks); windows last from `first_s` to `last_s`, (S,).
    """
    cuts = [
        _cut_tracks(
            shared.release, rng.permutation(np.flatnonzero(is_present)), begin_s, end_s
        )
        for is_present, begin_s, end_s in zip(present, first_s, last_s, strict=True)
    ]
    n_windows = np.array([cut.size.size for cut in cuts], dtype=np.int64)
    none = np.zeros(0, dtype=np.int64)
    rows, offsets = stretches(
        np.concatenate([none, *(cut.first for cut in cuts)]),
        np.concatenate([none, *(cut.size for cut in cuts)]),
    )
    owners = _find_majority_owners(shared.person[rows], offsets)
    return _TrackWindows(
        rotation=np.repeat(np.arange(len(cuts)), n_windows),
        rows=rows,
        offsets=offsets,
        majority_owner=owners.person,
        n_owned=owners.n_samples,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Cut:
    """The samples of W tracks in the window of a rotation, none without any."""

    first: Ints  # (W,) row of the first.
    size: Ints  # (W,)


def _cut_tracks(release: Release, track: Ints, begin_s: float, end_s: float) -> _Cut:
    """Return the samples of some tracks, (T,), from `begin_s` to `end_s`."""
    is_early = release.t < begin_s - CLOCK_S
    in_window = ~is_early & (release.t <= end_s + CLOCK_S)
    first = release.offsets[track] + _count_in_tracks(is_early, release, track)
    size = _count_in_tracks(in_window, release, track)
    return _Cut(first[size > 0], size[size > 0])


def _count_in_tracks(is_counted: Bools, release: Release, track: Ints) -> Ints:
    """Return the counted samples of some tracks, (T,); `is_counted` has all samples."""
    total = np.append(0, np.cumsum(is_counted))
    return np.asarray(total[release.offsets[track + 1]] - total[release.offsets[track]])


@dataclass(frozen=True, eq=False, slots=True)
class _Owners:
    """The majority owners of W windows."""

    person: Ints  # (W,), or `CLUTTER`.
    n_samples: Ints  # (W,)


def _find_majority_owners(person: Ints, offsets: Ints) -> _Owners:
    """Return the person with more than half of each window, or `CLUTTER`.

    `person` is that of each sample.
    """
    sizes = np.diff(offsets)
    window = np.repeat(np.arange(sizes.size), sizes)
    owner = np.full(sizes.size, CLUTTER)
    n_owned = np.zeros(sizes.size, dtype=np.int64)
    if window.size:
        pairs, count = np.unique(np.stack([window, person]), axis=1, return_counts=True)
        is_majority = (2 * count > sizes[pairs[0]]) & (pairs[1] != CLUTTER)
        owner[pairs[0][is_majority]] = pairs[1][is_majority]
        n_owned[pairs[0][is_majority]] = count[is_majority]
    return _Owners(owner, n_owned)


def _largest_windows(side: _TrackWindows, shape: tuple[int, ...]) -> Ints:
    """Return the window with most samples of each person, (S, N), or `MISSING`."""
    best = np.full(shape, MISSING)
    window = np.flatnonzero(side.majority_owner != CLUTTER)
    # The last that is written has the most samples; of equals it is the first window.
    window = window[np.lexsort((-window, side.n_owned[window]))]
    best[side.rotation[window], side.majority_owner[window]] = window
    return best


def _release(shared: SharedTracks, side: _TrackWindows) -> Release:
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


def _task_windows(
    task: Task,
    patrol: Patrol,
    shared: SharedTracks,
    sides: _Sides,
    trials: Trials,
    *,
    used: Ints,
    seed: int,
) -> TaskWindows:
    """Return the windows of the `used` rotations, (U,), as those of N people.

    Windows without a majority owner belong to one person more, called `NOBODY`.
    """
    people, n_people = patrol.people, len(patrol.people)
    group = (*people.group, NOBODY)
    fold = (np.arange(used.size) * N_FOLDS) // used.size
    trained_on, calibrated_on = set_calibrators_aside(
        present_in_other_fold(_seen_people(sides, used), fold=fold, group=group),
        group,
        rng=stream(seed, "linkage", "tracks", task.family, "roles"),
    )
    mate = np.full(sides.probe.rotation.size, MISSING)
    linkable = trials.is_linkable
    mate[trials.probe[linkable]] = trials.gallery[linkable]
    everybody = np.ones(n_people + 1, dtype=bool)
    return TaskWindows(
        task=task,
        source=(*people.source, NOBODY),
        group=group,
        alone=everybody,
        moving=everybody,
        probe=_true_windows(patrol, shared, sides.probe, used),
        gallery=_true_windows(patrol, shared, sides.gallery, used),
        mate=mate,
        search_names=tuple(map(str, used.tolist())),
        fold=fold,
        trained_on=trained_on,
        calibrated_on=calibrated_on,
        too_short=0,
        not_drawn=0,
    )


def _seen_people(sides: _Sides, used: Ints) -> Bools:
    """Return who is there or majority owner at each used rotation, (U, N + 1).

    The last is nobody, who is always there: no adversary is trained on windows without
    a majority owner.
    """
    present = (sides.present_before | sides.present_after)[used]
    seen = np.ones((used.size, present.shape[1] + 1), dtype=bool)
    seen[:, :-1] = present
    for side in (sides.probe, sides.gallery):
        owned = np.flatnonzero(side.majority_owner != CLUTTER)
        number = np.searchsorted(used, side.rotation[owned])
        seen[number, side.majority_owner[owned]] = True
    return seen


def _true_windows(
    patrol: Patrol, shared: SharedTracks, side: _TrackWindows, used: Ints
) -> Windows:
    """Return one side with the true places behind its samples."""
    people = patrol.people
    scan, person = shared.scan[side.rows], shared.person[side.rows]
    is_clutter = person == CLUTTER  # It has no truth and stays where it is.
    first = people.offsets[np.where(is_clutter, 0, person)]
    row = np.where(is_clutter, 0, first + scan - patrol.scan[first])
    released = shared.release.xy[side.rows]
    return Windows(
        t=shared.release.t[side.rows],
        xy=np.where(is_clutter[:, None], released, people.xy[row]),
        offsets=side.offsets,
        person=np.where(
            side.majority_owner == CLUTTER, len(people), side.majority_owner
        ),
        search=np.searchsorted(used, side.rotation),
    )
