"""People who come back: their passages, what the run shows of them, and scores.

A passage is a whole track of a person in a session. Frame and clock are hidden: every
passage is turned, shifted and put on another clock. Circumstances are properties of the
run, not of the person; controls compare them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from attacks.remembered import select_tracks
from attacks.tasks.task_list import NAMED_SESSIONS
from isac_track.errors import DataError
from isac_track.protocols import AttackContext, LinkageAttack, LinkageTrainingSet
from isac_track.rng import stream
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Knowledge,
    Release,
    Tracks,
    end_to_end,
    lengths,
    read_only,
    sample_runs,
)

LEAST_S: Final = 3.0
"""A shorter passage is left out."""
LONGEST_S: Final = 60.0
"""A longer passage is cut to its first minute."""
MOST_SCORES: Final = 10_000_000
"""Scores of a linker in a run: passages squared, times the people who come back and are
left out in turn. It bounds memory and time."""
CIRCUMSTANCES: Final = (
    "queue place",
    "density",
    "speed",
    "length",
    "time of day",
    "neighbours",
)
"""Properties of the run: a control for each."""
_TOGETHER_S = 1.0  # Starts within it are simultaneous: the queue is on a ring.
_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False, slots=True)
class Passages:
    """N passages of people in sessions, still true.

    Attributes
    ----------
    t : Floats
        Times, (M,) s.
    xy : Floats
        True positions, (M, 2) m.
    offsets : Ints
        First sample of each passage, then M: (N + 1,).
    source : tuple of str
        Id of the recorded track, (N,).
    person : Ints
        Row in `people`, (N,).
    session : Ints
        Row in `sessions`, (N,).
    people : tuple of str
        Names of the people.
    sessions : tuple of str
        Names of the sessions.
    closeness : Mapping
        Likeness of each pair of passages by each of `CIRCUMSTANCES`, (N, N); higher for
        passages of more similar circumstances.
    not_drawn : int
        People with passages who were left out at random, to limit the scores.
    """

    t: Floats
    xy: Floats
    offsets: Ints
    source: tuple[str, ...]
    person: Ints
    session: Ints
    people: tuple[str, ...]
    sessions: tuple[str, ...]
    closeness: Mapping[str, Floats]
    not_drawn: int = 0

    def __post_init__(self) -> None:
        for name in ("t", "xy", "offsets", "person", "session"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __len__(self) -> int:
        return self.offsets.size - 1

    @property
    def returning(self) -> Ints:
        """People with passages in two sessions or more, (K,) rows in `people`."""
        pairs = np.unique(np.stack([self.person, self.session]), axis=1)
        return np.flatnonzero(
            np.bincount(pairs[0], minlength=len(self.people)) > 1
        ).astype(np.int64)


def passages(
    tracks: Tracks,
    *,
    least_s: float = LEAST_S,
    longest_s: float = LONGEST_S,
    most_scores: int | None = None,
    seed: int = 0,
) -> Passages:
    """Return the passages of a recording with people and sessions.

    Passages shorter than `least_s` are left out; longer are cut to `longest_s`. If
    a linker would have more than `most_scores` scores, people are drawn by `seed`.
    Circumstances come from whole tracks, those of short passages included. DataError
    without people or sessions, if nobody comes back, or for a single person.
    """
    if tracks.person is None or tracks.session is None:
        raise DataError(
            "returning people need a person and a session of every track; give"
            f" {NAMED_SESSIONS}"
        )
    begin_s = tracks.t[tracks.offsets[:-1]]
    end_s = tracks.t[tracks.offsets[1:] - 1]
    rows = np.flatnonzero(end_s - begin_s >= least_s)
    people, person = np.unique(tracks.person, return_inverse=True)
    sessions, session = np.unique(tracks.session, return_inverse=True)
    n_all = np.unique(person[rows]).size
    if most_scores is not None:
        rows = rows[
            _drawn(person[rows], session[rows], most_scores=most_scores, seed=seed)
        ]
    runs, _ = sample_runs(tracks.offsets, rows)
    owner = np.repeat(np.arange(rows.size), np.diff(tracks.offsets)[rows])
    t, xy = end_to_end(tracks.t, runs), end_to_end(tracks.xy, runs)
    inside = t <= begin_s[rows][owner] + longest_s
    cut = Passages(
        t=t[inside],
        xy=xy[inside],
        offsets=np.append(
            0, np.cumsum(np.bincount(owner[inside], minlength=rows.size))
        ),
        source=tuple(tracks.source[row] for row in rows.tolist()),
        person=person[rows].astype(np.int64),
        session=session[rows].astype(np.int64),
        people=tuple(people.tolist()),
        sessions=tuple(sessions.tolist()),
        closeness=_closeness(tracks, person, session, rows),
        not_drawn=n_all - np.unique(person[rows]).size,
    )
    _check_returning(cut, least_s)
    return cut


def _check_returning(walks: Passages, least_s: float) -> None:
    """Raise DataError if nobody comes back, or there is nobody else."""
    if not walks.returning.size:
        raise DataError(
            f"nobody walks in two sessions for {least_s:g} s: returning people need a"
            " person with passages in several sessions"
        )
    if np.unique(walks.person).size == 1:
        raise DataError(
            f"all passages of {least_s:g} s are of a single person: there is no other"
            " for whom a passage could be taken; give sessions of more people"
        )


def _drawn(person: Ints, session: Ints, *, most_scores: int, seed: int) -> Bools:
    """Return which passages, (N,), are of people who are drawn; usually all.

    People are drawn at random, each with all passages, as long as a linker has at most
    so many scores. `person` and `session`, (N,), begin at 0.
    """
    n_people = int(person.max(initial=-1)) + 1
    pairs = np.unique(np.stack([person, session]), axis=1)
    comes_back = np.bincount(pairs[0], minlength=n_people) > 1
    order = stream(seed, "returns", "people").permutation(n_people)
    n_passages = np.bincount(person, minlength=n_people)[order].cumsum()
    fits = (comes_back[order].cumsum() + 1.0) * n_passages**2.0 <= most_scores
    return np.isin(person, order[fits])


def _slices(offsets: Ints, rows: Ints) -> list[slice]:
    return [slice(int(offsets[row]), int(offsets[row + 1])) for row in rows.tolist()]


@dataclass(frozen=True, eq=False, slots=True)
class _Circumstances:
    """How each of T tracks was walked, apart from the person."""

    place: Floats  # (T,) place in the queue of its session, 0 to 1
    ahead: Ints  # (T,) person in front in the queue, or -1
    behind: Ints  # (T,)
    scalars: Mapping[str, Floats]  # (T,) by name: logarithms, and a time in s.


def _circumstances(tracks: Tracks, person: Ints, session: Ints) -> _Circumstances:
    """Measure the circumstances of all tracks, session by session."""
    n = len(tracks)
    place, ahead, behind = np.empty(n), np.empty(n, np.int64), np.empty(n, np.int64)
    density, speed, length_s, time_s = np.empty((4, n))
    begin_s = tracks.t[tracks.offsets[:-1]]
    end_s = tracks.t[tracks.offsets[1:] - 1]
    for name in np.unique(session):
        here = np.flatnonzero(session == name)
        order = here[_queue_order(tracks, here)]
        ahead[order] = np.append(-1, person[order[:-1]])
        behind[order] = np.append(person[order[1:]], -1)
        firsts = np.unique(person[order], return_index=True)[1]
        rank = np.empty(person.max() + 1)
        rank[person[order][np.sort(firsts)]] = np.arange(firsts.size) / firsts.size
        place[here] = rank[person[here]]
        time_s[here] = begin_s[here] - begin_s[here].min()
        density[here] = _density(begin_s[here], end_s[here])
    for row, run in enumerate(_slices(tracks.offsets, np.arange(n))):
        length_s[row] = end_s[row] - begin_s[row]
        steps_m = lengths(tracks.xy[run][-1] - tracks.xy[run][0])
        way_m = lengths(np.diff(_every_second(tracks, run), axis=0)).sum()
        speed[row] = max(steps_m, way_m) / max(length_s[row], 1e-9)
    scalars = {
        "density": np.log(density),
        "speed": np.log(np.maximum(speed, 1e-3)),
        "length": np.log(np.maximum(length_s, 1e-3)),
        "time of day": time_s,
    }
    return _Circumstances(place, ahead, behind, scalars)


def _closeness(
    tracks: Tracks, person: Ints, session: Ints, rows: Ints
) -> dict[str, Floats]:
    """Return the closeness of chosen tracks by each circumstance, (N, N) each."""
    walked = _circumstances(tracks, person, session)
    place, ahead, behind = walked.place[rows], walked.ahead[rows], walked.behind[rows]
    apart = np.abs(place[:, None] - place)
    shared = (ahead[:, None] == ahead) & (ahead >= 0)
    next_shared = (behind[:, None] == behind) & (behind >= 0)
    closeness = {
        "queue place": -np.minimum(apart, 1.0 - apart),
        "neighbours": shared.astype(float) + next_shared,
    }
    for name, values in walked.scalars.items():
        chosen = values[rows]
        scale = float(chosen.std()) or 1.0
        closeness[name] = -np.abs(chosen[:, None] - chosen) / scale
    return {name: read_only(closeness[name]) for name in CIRCUMSTANCES}


def _every_second(tracks: Tracks, run: slice) -> Floats:
    """Return the positions at every full second of a walk, (K, 2) m."""
    t = tracks.t[run]
    wanted = np.arange(t[0], t[-1] + 1e-9, 1.0)
    return np.column_stack(
        [np.interp(wanted, t, tracks.xy[run, axis]) for axis in (0, 1)]
    )


def _queue_order(tracks: Tracks, here: Ints) -> Ints:
    """Return the order of a session's tracks in the queue.

    It is that of entry. Where most people are there from the start, on a ring, it is
    that of their bearing from the middle of the session.
    """
    first = tracks.offsets[:-1][here]
    begin_s = tracks.t[first]
    if (begin_s <= begin_s.min() + _TOGETHER_S).mean() > 0.5:  # noqa: PLR2004 - most
        middle_m = np.concatenate(
            [tracks.xy[run] for run in _slices(tracks.offsets, here)]
        )
        bearing = tracks.xy[first] - middle_m.mean(axis=0)
        return np.argsort(np.arctan2(bearing[:, 1], bearing[:, 0]), kind="stable")
    return np.argsort(begin_s, kind="stable")


def _density(begin_s: Floats, end_s: Floats) -> Floats:
    """Return the mean number of people present during each track, (N,), itself too."""
    shared_s = np.minimum(end_s[:, None], end_s) - np.maximum(begin_s[:, None], begin_s)
    lasts_s = np.maximum(end_s - begin_s, 1e-9)
    return np.asarray(np.maximum(shared_s, 0.0).sum(axis=1) / lasts_s)


def hide(
    *, t: Floats, xy: Floats, offsets: Ints, sigma: Floats | None, seed: int
) -> Release:
    """Return the release of N walks without frame or clock.

    Every walk is turned, begins within 10 m of the origin, and on a clock of its own.
    """
    rng = stream(seed, "returns", "frames")
    n = offsets.size - 1
    owner = np.repeat(np.arange(n), np.diff(offsets))
    turn = np.exp(1j * rng.uniform(0.0, _TURN, n))[owner]
    z = (xy[:, 0] + 1j * xy[:, 1] - (xy[offsets[:-1]] @ [1.0, 1j])[owner]) * turn
    origin = rng.uniform(-10.0, 10.0, (n, 2))[owner]
    clock_s = (rng.uniform(0.0, 1000.0, n) - t[offsets[:-1]])[owner]
    return Release(
        t=t + clock_s,
        xy=np.column_stack([z.real, z.imag]) + origin,
        sigma=sigma,
        offsets=offsets,
        pseudonym=tuple(f"passage {row}" for row in rng.permutation(n).tolist()),
    )


@dataclass(frozen=True, eq=False, slots=True)
class ReturnScores:
    """Scores of all pairs of passages by a linker that leaves people out.

    Attributes
    ----------
    values : Floats
        Scores, (K + 1, N, N). Slice k leaves out the returning person k besides the
        probe's person; the last leaves out nobody else. (1, N, N) of a linker that
        learns nothing.
    """

    values: Floats


def score_passages(
    attack: LinkageAttack,
    release: Release,
    *,
    person: Ints,
    session: Ints,
    returning: Ints,
    seed: int,
) -> ReturnScores:
    """Score all pairs of passages; nobody is linked by what was learnt on them.

    The row of a probe in slice k comes from an adversary who learnt on all returning
    people but the probe's person and person ``returning[k]``. Those rows calibrate the
    scores of person k. ValueError for an attack that needs knowledge besides TRAIN.
    """
    if not attack.requires <= {Knowledge.TRAIN}:
        raise ValueError("returning people are linked with training people at most")
    learns = Knowledge.TRAIN in attack.requires | attack.uses
    n = len(release)
    if not learns:
        linker = attack.fit(_context(None, seed))
        scores = np.asarray(linker(release, release), dtype=np.float64)
        return ReturnScores(read_only(scores[None]))
    values = np.empty((returning.size + 1, n, n))
    fits: dict[frozenset[int], Callable[[Release, Release], Floats]] = {}

    def fit(left_out: frozenset[int]) -> Callable[[Release, Release], Floats]:
        if left_out not in fits:
            teaches = np.isin(person, [*left_out], invert=True)
            train = mated_passages(release, person, session, teaches)
            fits[left_out] = attack.fit(_context(train, seed))
        return fits[left_out]

    everybody = returning.tolist()
    for slot, aside in enumerate([*everybody, -1]):
        for name in np.unique(person).tolist():
            rows = np.flatnonzero(person == name)
            left_out = frozenset({aside, name} & set(everybody))
            probe = select_tracks(release, rows)
            values[slot, rows] = fit(left_out)(probe, release)
    return ReturnScores(read_only(values))


def _context(train: LinkageTrainingSet | None, seed: int) -> AttackContext:
    granted = frozenset() if train is None else frozenset({Knowledge.TRAIN})
    return AttackContext(
        rng=stream(seed, "returns", "attack"),
        epsilon_m=0.5,
        granted=granted,
        train=train,
    )


def mated_passages(
    release: Release, person: Ints, session: Ints, teaches: Bools
) -> LinkageTrainingSet:
    """Return a training set of pairs of a person's passages in two sessions.

    `teaches`, (N,), tells the passages that may be learnt from. Of two sessions of a
    person the first passages are paired, then the second, and so on. A passage stands
    in a pair of each two sessions, by a copy of its own.
    """
    rows = np.flatnonzero(teaches)
    order = rows[np.lexsort((rows, session[rows], person[rows]))]
    new = np.append(
        True, (np.diff(person[order]) != 0) | (np.diff(session[order]) != 0)
    )
    lap = np.arange(order.size) - np.maximum.accumulate(
        np.where(new, np.arange(order.size), 0)
    )
    walker = person[order]
    pairs = (walker[:, None] == walker) & (session[order][:, None] < session[order])
    first, second = np.nonzero(pairs & (lap[:, None] == lap))
    return LinkageTrainingSet(
        select_tracks(release, order[first]),
        select_tracks(release, order[second]),
        np.arange(first.size),
    )
