"""Link people who come back: fuse scores over passages and linkers, and rank them.

N passages, V people, L linkers, K people who come back. A person has several passages
in several sessions. Every number is a mean over people of equal weight, and every
interval is a jackknife that deletes people as probes and as candidates at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from scipy.special import stdtrit
from sklearn.linear_model import LogisticRegression

from isac_track.intervals import (
    CONFIDENCE,
    LEAST_CLUSTERS,
    Estimate,
    jackknife_interval,
)
from isac_track.linkability.ranks import expected_hit
from isac_track.linkability.scores import auc, eer
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Ints, read_only

Probe: TypeAlias = Literal["another session", "same session"]
"""Where the enrolled passages of a probe come from; *same session* is a control only."""
FPIR: Final = 0.1
"""Share of people who are not enrolled for whom the open set names a candidate."""


@dataclass(frozen=True, eq=False, slots=True)
class Returning:
    """Who walks in which passage.

    Attributes
    ----------
    person : Ints
        Person of each passage, (N,), from 0.
    session : Ints
        Session of each passage, (N,), from 0.
    people : Ints
        People who come back, (K,).
    """

    person: Ints
    session: Ints
    people: Ints

    def __post_init__(self) -> None:
        if self.person.shape != self.session.shape or self.person.ndim != 1:
            raise ValueError("person and session must have one shape (N,)")
        for name in ("person", "session", "people"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def n_people(self) -> int:
        """People, those who do not come back included."""
        return int(self.person.max()) + 1


@dataclass(frozen=True, eq=False, slots=True)
class PersonScores:
    """Scores of N probes against V people; NaN where a person is not enrolled.

    Attributes
    ----------
    values : Floats
        Log likelihood ratios up to a constant of the probe's person, (N, V).
    """

    values: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", read_only(self.values))


def enrolment(
    returning: Returning,
    *,
    most: int | None = None,
    probe: Probe = "another session",
    session: int | None = None,
    seed: int = 0,
) -> Floats:
    """Return the weight of each gallery passage for each probe and person, (S, N, V).

    The first axis is the session of the probe. Weights of a person sum to 1, or to 0 if
    the person is not enrolled: the mean of scores, unlike their sum, favours nobody for
    the number of passages. At most `most` passages of a person are drawn. The gallery
    of a probe has the passages of all other sessions, or only those of `session`; as a
    control (``same session``) those of its own session.
    """
    n, sessions = returning.person.size, np.unique(returning.session)
    weights = np.zeros((sessions.size, n, returning.n_people))
    order = stream(seed, "returns", "enrolment").permutation(n)
    for place, name in enumerate(sessions.tolist()):
        here = returning.session == name
        usable = here if probe == "same session" else ~here
        if session is not None:
            usable = usable & (returning.session == session)
        for person in np.unique(returning.person[usable]).tolist():
            drawn = order[(usable & (returning.person == person))[order]][:most]
            weights[place, drawn, person] = 1.0 / drawn.size
    return weights


def person_scores(scores: Floats, returning: Returning, weights: Floats) -> Floats:
    """Return mean scores of every probe against every person, (N, V); NaN: no passage.

    `scores` are (N, N), `weights` come from `enrolment`. A probe is never compared with
    itself.
    """
    sums = np.full((returning.person.size, returning.n_people), np.nan)
    for place, name in enumerate(np.unique(returning.session).tolist()):
        rows = np.flatnonzero(returning.session == name)
        itself = weights[place][rows, returning.person[rows]]
        total = weights[place].sum(axis=0)[None] * np.ones((rows.size, 1))
        value = scores[rows] @ weights[place]
        own = returning.person[rows]
        at = np.arange(rows.size)
        value[at, own] -= itself * scores[rows, rows]
        total[at, own] -= itself
        sums[rows] = np.where(total > 1e-9, value / np.maximum(total, 1e-9), np.nan)  # noqa: PLR2004 - rounding
    return sums


def fusion_laws(
    scores: Sequence[Floats], returning: Returning, weights: Floats
) -> Floats:
    """Return how each person's probes fuse L linkers, (K + 1, L + 1).

    `scores`, L of (K + 1, N, N): slice k has scores of an adversary who knows nothing
    of person ``people[k]`` (the last: who leaves out nobody but the probe's person); or
    of (1, N, N) for a linker that learns nothing. Row k has the slope of each linker
    and the intercept that turn mean scores into a log ratio for the probes of person k.
    They come from a logistic regression on slice
    k, on probes and candidates that are other people. No slope is negative: a higher
    score never speaks against the same person. The last row is for the probes of
    people who do not come back.
    """
    comes_back = np.isin(returning.person, returning.people)
    laws = []
    means_by_slot = _MeanScores(scores, returning, weights)
    for slot, aside in enumerate([*returning.people.tolist(), -1]):
        means = means_by_slot[slot]
        other = np.flatnonzero(comes_back & (returning.person != aside))
        laws.append(_logistic(means, returning, other, aside))
    return np.stack(laws)


def fuse(
    scores: Sequence[Floats], laws: Floats, returning: Returning, weights: Floats
) -> PersonScores:
    """Return the sum of the linkers' log ratios, calibrated on other people.

    `laws` come from `fusion_laws`, of the same or of other `weights`.
    """
    fused = np.full((returning.person.size, returning.n_people), np.nan)
    means_by_slot = _MeanScores(scores, returning, weights)
    for slot, aside in enumerate([*returning.people.tolist(), -1]):
        own = returning.person == aside
        if aside < 0:
            own = ~np.isin(returning.person, returning.people)
        if own.any():
            part = means_by_slot[slot][:, own]
            total = np.tensordot(laws[slot, :-1], np.nan_to_num(part), axes=1)
            enrolled = np.isfinite(part).all(axis=0)
            fused[own] = np.where(enrolled, total + laws[slot, -1], np.nan)
    return PersonScores(fused)


class _MeanScores:
    """Mean scores of L linkers by slice, (L, N, V); those that learn nothing once."""

    def __init__(
        self, scores: Sequence[Floats], returning: Returning, weights: Floats
    ) -> None:
        self._inputs = scores, returning, weights
        self._constant = {
            place: person_scores(linker[0], returning, weights)
            for place, linker in enumerate(scores)
            if len(linker) == 1
        }

    def __getitem__(self, slot: int) -> Floats:
        scores, returning, weights = self._inputs
        return np.stack(
            [
                self._constant[place]
                if place in self._constant
                else person_scores(linker[slot], returning, weights)
                for place, linker in enumerate(scores)
            ]
        )


@dataclass(frozen=True, eq=False, slots=True)
class NodeScores:
    """Scores between U nodes; a node is a person in a session."""

    values: Floats  # (U, U), probes by candidates
    person: Ints  # (U,)
    session: Ints  # (U,)


def node_scores(
    scores: Sequence[Floats], laws: Floats, returning: Returning
) -> NodeScores:
    """Return the scores between people in sessions.

    The score of a probe and a candidate is the mean over the probe's passages of the
    fused score against the candidate's; 0 in the same session.
    """
    nodes = np.unique(np.stack([returning.session, returning.person]), axis=1)
    session, person = nodes
    values = np.zeros((person.size, person.size))
    member = (returning.session[:, None] == session) & (
        returning.person[:, None] == person
    )
    share = member / member.sum(axis=0)
    for name in np.unique(session).tolist():
        weights = enrolment(returning, session=name)
        fused = fuse(scores, laws, returning, weights).values
        rows, columns = np.flatnonzero(session != name), np.flatnonzero(session == name)
        part = np.nan_to_num(fused[:, person[columns]])
        values[np.ix_(rows, columns)] = share[:, rows].T @ part
    return NodeScores(values, person.astype(np.int64), session.astype(np.int64))


def _logistic(means: Floats, returning: Returning, rows: Ints, aside: int) -> Floats:
    """Return the slope of each linker and the intercept, (L + 1,), from some probes."""
    person = returning.person[rows]
    part = means[:, rows]
    usable: Bools = np.asarray(np.isfinite(part).all(axis=0))
    if aside >= 0:
        usable[:, aside] = False
    same = np.zeros(usable.shape, dtype=bool)
    same[np.arange(rows.size), person] = True
    features, labels = part[:, usable].T, same[usable]
    zero = np.zeros(features.shape[1] + 1)
    if labels.all() or not labels.any():
        return zero
    spread = np.maximum(features.std(axis=0), 1e-12)
    middle = features.mean(axis=0)
    fit = LogisticRegression(class_weight="balanced", max_iter=1000)
    fit.fit((features - middle) / spread, labels)
    slopes = np.maximum(fit.coef_[0], 0.0) / spread
    return np.append(slopes, fit.intercept_[0] - slopes @ middle)


@dataclass(frozen=True, eq=False, slots=True)
class Hits:
    """Hits at rank 1 of each probe, and how they change without each person.

    Attributes
    ----------
    whole : Floats
        Expected hit of each mated probe, (P,): ties share.
    without : Floats
        The same where a person is no candidate, (V, P).
    person : Ints
        Person of each mated probe, (P,).
    chance : Floats
        1 over the candidates of each probe, (P,).
    """

    whole: Floats
    without: Floats
    person: Ints
    chance: Floats


def hits(scores: PersonScores, returning: Returning, rows: Ints) -> Hits:
    """Return the hits of the probes in `rows` whose person is enrolled."""
    values, own = scores.values[rows], returning.person[rows]
    mated = np.isfinite(values[np.arange(rows.size), own])
    values, own = values[mated], own[mated]
    at = np.arange(own.size)
    mate = values[at, own][:, None]
    above, level = values > mate, values == mate
    n_above, n_level = above.sum(axis=1), level.sum(axis=1)
    others = np.arange(values.shape[1])[:, None] != own
    without = expected_hit(
        (n_above[:, None] - above).T, (n_level[:, None] - (level & others.T)).T
    )
    candidates = np.isfinite(values).sum(axis=1)
    return Hits(expected_hit(n_above, n_level), without, own, 1.0 / candidates)


def _by_person(values: Floats, person: Ints, people: Ints) -> Floats:
    """Return the mean over the probes of each of some people, (..., K)."""
    member = (person[:, None] == people).astype(float)
    return np.asarray(values @ member / member.sum(axis=0))


def _estimate(whole: Floats, without: Floats, *, is_share: bool) -> Estimate:
    """Return the mean over people, (K,), with the jackknife that deletes each.

    `without`, (K, K): the people's values where person k is no candidate. Replicate k
    is their mean without person k as a probe. Replicates are centred, since a smaller
    gallery is easier.
    """
    n = whole.size
    value = float(whole.mean())
    rest = (without.sum(axis=1) - np.diag(without)) / max(n - 1, 1)
    if n < LEAST_CLUSTERS:
        return Estimate(value, n=n, effective=float(n))
    shifted = np.append(value, rest - rest.mean() + value)
    if is_share:
        low, high = jackknife_interval(shifted, effective=float(n))
    else:
        error = float(np.sqrt((n - 1.0) / n * ((shifted[1:] - value) ** 2).sum()))
        half = float(stdtrit(n - 1.0, 0.5 + CONFIDENCE / 2.0)) * error
        low, high = value - half, value + half
    return Estimate(value, low, high, n, effective=float(n))


@dataclass(frozen=True, eq=False, slots=True)
class ReturnCell:
    """Rank 1 of a linker and of the control, by person.

    Attributes
    ----------
    rank1 : Estimate
        Share of probes whose own person ranks first, 0..1.
    chance : float
        Rank 1 of guesses.
    control : Estimate
        Rank 1 of the control chosen on other people.
    chosen : Mapping
        How many people each control was chosen for.
    gain : Estimate
        Rank 1 less that of the control, -1..1, paired by person.
    auc : float
        Of mated and non-mated pairs of the closed set.
    eer : float
        Equal error rate of the same pairs.
    """

    rank1: Estimate
    chance: float
    control: Estimate
    chosen: Mapping[str, int]
    gain: Estimate
    auc: float
    eer: float


def return_cell(
    scores: PersonScores,
    controls: Mapping[str, PersonScores],
    returning: Returning,
    *,
    rows: Ints | None = None,
) -> ReturnCell:
    """Return rank 1 of a linker, of the control, and their difference.

    `rows` are the probes, all by default; those without an enrolled mate are left out.
    The control of a person has the highest rank 1 among the other people's probes; a
    tie goes to the first by name. The jackknife does not choose anew: a choice flips
    with a single hit, and its replicates would not tell how the gain varies.
    """
    rows = np.arange(returning.person.size) if rows is None else rows
    linked = hits(scores, returning, rows)
    if not linked.person.size:
        raise ValueError("no probe has an enrolled mate")
    people = np.unique(linked.person)
    whole, without = _tables(linked, people)
    names = sorted(controls)
    tables = [_tables(hits(controls[name], returning, rows), people) for name in names]
    control_whole = np.stack([table[0] for table in tables])
    control_without = np.stack([table[1] for table in tables])
    picked = _choose(control_whole)
    at = np.arange(people.size)
    best = control_whole[picked, at]
    best_without = control_without[picked, :, at].T
    mated, non_mated = pair_scores(scores, returning, rows)
    counts = {name: int((picked == k).sum()) for k, name in enumerate(names)}
    return ReturnCell(
        rank1=_estimate(whole, without, is_share=True),
        chance=float(_by_person(linked.chance, linked.person, people).mean()),
        control=_estimate(best, best_without, is_share=True),
        chosen={name: count for name, count in counts.items() if count},
        gain=_estimate(whole - best, without - best_without, is_share=False),
        auc=auc(mated=mated, non_mated=non_mated),
        eer=eer(mated=mated, non_mated=non_mated),
    )


def _tables(linked: Hits, people: Ints) -> tuple[Floats, Floats]:
    """Return hits by person, (K,), and without each of them as a candidate, (K, K)."""
    return (
        _by_person(linked.whole, linked.person, people),
        _by_person(linked.without[people], linked.person, people),
    )


def _choose(by_person: Floats) -> Ints:
    """Return the control with the most hits among other people, (K,), from (C, K)."""
    rest = by_person.sum(axis=1, keepdims=True) - by_person
    return np.asarray(np.round(rest, 9).argmax(axis=0), dtype=np.int64)


def pair_scores(
    scores: PersonScores, returning: Returning, rows: Ints
) -> tuple[Floats, Floats]:
    """Return the scores of mated and of non-mated pairs of the mated probes."""
    values, own = scores.values[rows], returning.person[rows]
    at = np.arange(rows.size)
    mated_rows = np.isfinite(values[at, own])
    values, own = values[mated_rows], own[mated_rows]
    same = own[:, None] == np.arange(values.shape[1])
    enrolled: Bools = np.isfinite(values)
    return values[same & enrolled], values[~same & enrolled]


@dataclass(frozen=True, slots=True)
class OpenSet:
    """Identification where some probes are of nobody enrolled.

    Attributes
    ----------
    identified : float
        Share of the enrolled people's probes that rank first, above the threshold.
    fpir : float
        Share of the other probes that name a candidate at that threshold.
    n_enrolled : int
        People with probes and enrolled passages.
    n_strangers : int
        People with probes who are not enrolled.
    """

    identified: float
    fpir: float
    n_enrolled: int
    n_strangers: int


def open_set(
    scores: PersonScores, returning: Returning, *, fpir: float = FPIR
) -> OpenSet:
    """Return the identification rate at a false positive rate of at most `fpir`.

    All probes are searched among the enrolled people; the threshold is the lowest with
    at most `fpir` of the strangers' probes above it. NaN without a stranger.
    """
    values, own = scores.values, returning.person
    mate = values[np.arange(own.size), own]
    stranger = ~np.isfinite(mate)
    people, strangers = np.unique(own[~stranger]), np.unique(own[stranger])
    if not strangers.size or not people.size:
        return OpenSet(np.nan, np.nan, people.size, strangers.size)
    top = np.nanmax(values, axis=1)
    alarms = np.sort(top[stranger])[::-1]
    threshold = alarms[min(int(fpir * alarms.size), alarms.size - 1)]
    first = (mate >= top) & (mate > threshold)
    share = _by_person(first[~stranger].astype(float), own[~stranger], people).mean()
    return OpenSet(
        float(share),
        float((alarms > threshold).mean()),
        people.size,
        strangers.size,
    )
