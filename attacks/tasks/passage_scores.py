"""Score all pairs of passages: nobody is linked by what was learnt on that person.

Few people come back. So each person is a fold: the linker is trained on all others.
"""

from collections.abc import Callable

import numpy as np

from attacks.remembered import select_tracks
from isac_track.linkability.returns import Returning
from isac_track.protocols import AttackContext, LinkageAttack, LinkageTrainingSet
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Ints, Knowledge, Release, read_only


def score_passages(
    attack: LinkageAttack, release: Release, returning: Returning, *, seed: int
) -> Floats:
    """Return the scores of all pairs of N passages, (K + 1, N, N); K people come back.

    The row of a probe in slice k comes from an adversary who was trained on all
    returning people but the probe's person and ``returning.people[k]``; in the last
    slice, on all but the probe's person. The rows of slice k calibrate the scores of
    person k. A linker that is not trained has a single slice, (1, N, N). ValueError for
    an attack that needs knowledge besides TRAIN.
    """
    if not attack.requires <= {Knowledge.TRAIN}:
        raise ValueError("returning people are linked with training people at most")
    if Knowledge.TRAIN in attack.requires | attack.uses:
        return read_only(_trained_scores(attack, release, returning, seed))
    linker = attack.fit(_context(None, seed))
    scores = np.asarray(linker(release, release), dtype=np.float64)
    return read_only(scores[None])


def _trained_scores(
    attack: LinkageAttack, release: Release, returning: Returning, seed: int
) -> Floats:
    """Return the scores of a linker that is trained, (K + 1, N, N)."""
    fitted: dict[frozenset[int], Callable[[Release, Release], Floats]] = {}

    def fit_without(left_out: frozenset[int]) -> Callable[[Release, Release], Floats]:
        if left_out not in fitted:
            may_train_on = np.isin(returning.person, [*left_out], invert=True)
            train = mated_passages(release, returning, may_train_on)
            fitted[left_out] = attack.fit(_context(train, seed))
        return fitted[left_out]

    everybody, n = returning.people.tolist(), len(release)
    values = np.empty((len(everybody) + 1, n, n))
    for slot, aside in enumerate([*everybody, -1]):
        for person in np.unique(returning.person).tolist():
            rows = np.flatnonzero(returning.person == person)
            left_out = frozenset({aside, person} & set(everybody))
            probe = select_tracks(release, rows)
            values[slot, rows] = fit_without(left_out)(probe, release)
    return values


def _context(train: LinkageTrainingSet | None, seed: int) -> AttackContext:
    granted = frozenset() if train is None else frozenset({Knowledge.TRAIN})
    return AttackContext(
        rng=stream(seed, "returns", "attack"),
        epsilon_m=0.5,
        granted=granted,
        train=train,
    )


def mated_passages(
    release: Release, returning: Returning, may_train_on: Bools
) -> LinkageTrainingSet:
    """Return a training set of pairs of a person's passages in two sessions.

    `may_train_on`, (N,), are the passages to choose from. Of two sessions of a person
    the first passages are paired, then the second, and so on. A passage stands in a
    pair of each two sessions, by a copy of its own.
    """
    rows = np.flatnonzero(may_train_on)
    person, session = returning.person, returning.session
    order = rows[np.lexsort((rows, session[rows], person[rows]))]
    person, session = person[order], session[order]
    number = _numbers_in_session(person, session)
    is_pair = (person[:, None] == person) & (session[:, None] < session)
    first, second = np.nonzero(is_pair & (number[:, None] == number))
    return LinkageTrainingSet(
        select_tracks(release, order[first]),
        select_tracks(release, order[second]),
        np.arange(first.size),
    )


def _numbers_in_session(person: Ints, session: Ints) -> Ints:
    """Return the number of each passage among those of its person and session, (N,).

    `person` and `session`, (N,), are sorted by person, then by session.
    """
    place = np.arange(person.size)
    is_first = np.append(True, (np.diff(person) != 0) | (np.diff(session) != 0))
    return place - np.maximum.accumulate(np.where(is_first, place, 0))
