"""Passages of people who come back, at their true positions, not yet sensed.

A passage is a track of a person in a session: whole, from entry to exit, or its first
minute.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from attacks.tasks.passage_circumstances import compare_circumstances
from attacks.tasks.task_list import NAMED_SESSIONS
from isac_track.errors import DataError
from isac_track.rng import stream
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Tracks,
    end_to_end,
    read_only,
    sample_runs,
)

LEAST_S: Final = 3.0
"""A shorter passage is left out."""
LONGEST_S: Final = 60.0
"""A longer passage is cut to its first minute."""
MOST_SCORES: Final = 10_000_000
"""Scores of a linker: passages squared, times the people who come back and are left out
in turn. It bounds memory and time."""


@dataclass(frozen=True, eq=False, slots=True)
class Passages:
    """N passages of people in sessions: whole, or their first minute; not yet sensed.

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
        By each of `CIRCUMSTANCES` the closeness of each pair of passages, (N, N);
        higher for more similar circumstances.
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
        return returning_people(self.person, self.session, n_people=len(self.people))


def returning_people(person: Ints, session: Ints, *, n_people: int) -> Ints:
    """Return the people with passages in two sessions or more, (K,).

    `person` and `session`, (N,), are numbers from 0 of each passage.
    """
    pairs = np.unique(np.stack([person, session]), axis=1)
    n_sessions = np.bincount(pairs[0], minlength=n_people)
    return np.flatnonzero(n_sessions > 1).astype(np.int64)


def find_passages(
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
    without people or sessions, if nobody comes back or is drawn, or for a single
    person.
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
    _check_returning(person[rows], session[rows], least_s)
    n_all = np.unique(person[rows]).size
    if most_scores is not None:
        is_drawn = _draw_people(
            person[rows], session[rows], most_scores=most_scores, seed=seed
        )
        rows = rows[is_drawn]
        _check_drawn(person[rows], session[rows], most_scores)
    samples = _first_seconds(tracks, rows, longest_s)
    return Passages(
        t=samples.t,
        xy=samples.xy,
        offsets=samples.offsets,
        source=tuple(tracks.source[row] for row in rows.tolist()),
        person=person[rows].astype(np.int64),
        session=session[rows].astype(np.int64),
        people=tuple(people.tolist()),
        sessions=tuple(sessions.tolist()),
        closeness=compare_circumstances(tracks, person, session, rows),
        not_drawn=n_all - np.unique(person[rows]).size,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Samples:
    """Samples of N passages."""

    t: Floats  # (M,) s
    xy: Floats  # (M, 2) m
    offsets: Ints  # (N + 1,)


def _first_seconds(tracks: Tracks, rows: Ints, longest_s: float) -> _Samples:
    """Return the samples of some tracks, each up to `longest_s` after its first."""
    runs, _ = sample_runs(tracks.offsets, rows)
    owner = np.repeat(np.arange(rows.size), np.diff(tracks.offsets)[rows])
    t, xy = end_to_end(tracks.t, runs), end_to_end(tracks.xy, runs)
    begin_s = tracks.t[tracks.offsets[:-1]][rows]
    inside = t <= begin_s[owner] + longest_s
    sizes = np.bincount(owner[inside], minlength=rows.size)
    return _Samples(t[inside], xy[inside], np.append(0, np.cumsum(sizes)))


def _check_returning(person: Ints, session: Ints, least_s: float) -> None:
    """Raise DataError if nobody comes back, or there is nobody else."""
    if not _anybody_returns(person, session):
        raise DataError(
            f"nobody walks in two sessions for {least_s:g} s: returning people need a"
            " person with passages in several sessions"
        )
    if np.unique(person).size == 1:
        raise DataError(
            f"all passages of {least_s:g} s are of a single person: there is no other"
            " for whom a passage could be taken; give sessions of more people"
        )


def _check_drawn(person: Ints, session: Ints, most_scores: int) -> None:
    """Raise DataError if the draw has nobody who comes back, or nobody else."""
    if not _anybody_returns(person, session):
        lack = "nobody walks in two sessions"
    elif np.unique(person).size == 1:
        lack = "there is a single person"
    else:
        return
    raise DataError(
        f"linking all people takes over {most_scores:,} scores; among those drawn at"
        f" random {lack}; give fewer passages, or another seed"
    )


def _anybody_returns(person: Ints, session: Ints) -> bool:
    """Return whether a person has passages in two sessions or more."""
    n_people = int(person.max(initial=-1)) + 1
    return returning_people(person, session, n_people=n_people).size > 0


def _draw_people(person: Ints, session: Ints, *, most_scores: int, seed: int) -> Bools:
    """Return which passages, (N,), are of people who are drawn; usually all.

    People are drawn at random, each with all passages, as long as a linker has at most
    so many scores. `person` and `session`, (N,), begin at 0.
    """
    n_people = int(person.max(initial=-1)) + 1
    comes_back = np.zeros(n_people, dtype=bool)
    comes_back[returning_people(person, session, n_people=n_people)] = True
    order = stream(seed, "returns", "people").permutation(n_people)
    n_passages = np.bincount(person, minlength=n_people)[order].cumsum()
    fits = (comes_back[order].cumsum() + 1.0) * n_passages**2.0 <= most_scores
    return np.isin(person, order[fits])
