"""Pieces of walks in a log: answers that repeat a sample belong to one person.

Pseudonyms are fresh in every answer, or kept for an encounter. Errors are continuous,
so no two people share a sample: an adversary joins two answers with a common sample
without doubt. A window longer than the time between two queries therefore yields a
chain by itself.
"""

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from isac_track.kalman import Batch, kalman_last
from isac_track.noise import MIN_VARIANCE_M2
from isac_track.patrols.answers import Disclosure, Network
from isac_track.patrols.knowledge import average_draws, sent_samples, sent_variance
from isac_track.types import Floats, Ints, stretches

Pseudonyms: TypeAlias = Literal["query", "encounter"]
"""How long an answer's pseudonym lasts."""
Q: Final = 0.05  # m^2/s^3, of people's acceleration: that of the linker `kinematic`.
PRIOR_STD: Final = (100.0, 1.4)  # m around the first sample and m/s around rest.


@dataclass(frozen=True, eq=False, slots=True)
class States:
    """Kalman states of K pieces at one of their ends; both axes share a covariance."""

    t: Floats  # (K,) s
    mean: Floats  # (K, 2, 2) m and m/s: per axis position and velocity.
    cov: Floats  # (K, 2, 2) m^2, m^2/s, m^2/s^2

    def __getitem__(self, rows: Ints) -> "States":
        """Return some of the states."""
        return States(self.t[rows], self.mean[rows], self.cov[rows])


@dataclass(frozen=True, eq=False, slots=True)
class Pieces:
    """K pieces of the log of one fleet, in the order of their starts.

    Only scoring reads `person`: an adversary does not hold it.
    """

    person: Ints  # (K,) row of the true person.
    sample: Ints  # (L,) samples of the patrol, rising within a piece.
    xy: Floats  # (L, 2) m, positions of the samples in the log, or of states.
    variance: Floats  # (L,) m^2 per axis.
    offsets: Ints  # (K + 1,) piece k owns the samples ``offsets[k]:offsets[k + 1]``.
    start: States  # States at the first sample, from the samples after it.
    end: States  # States at the last sample, from the samples before it.

    def __len__(self) -> int:
        """Return their number."""
        return self.person.size


def collect_pieces(
    network: Network,
    disclosure: Disclosure,
    *,
    robots: Ints,
    pseudonyms: Pseudonyms = "query",
) -> Pieces:
    """Return the pieces that the log of some robots of a fleet holds.

    A `flag` has no pieces. A `state` is a piece of its own at the instant of its query:
    no later state repeats it. With errors that are drawn anew at every query no two
    answers share a sample. `pseudonyms` kept for an encounter join the answers to
    queries of a robot in a row.
    """
    runs = _received_runs(network, disclosure, robots)
    entries = _piece_entries(network, runs, _joined_runs(network, runs, pseudonyms))
    if not entries.sample.size:
        return _no_pieces()
    starts = _first_new(network, entries)
    order = np.lexsort((entries.sample[starts], entries.t[starts]))
    sizes = np.diff(entries.offsets)
    rows, offsets = stretches(entries.offsets[:-1][order], sizes[order])
    people = network.patrol.people
    begins = entries.offsets[:-1][order]
    start, end, states = _end_states(
        network,
        disclosure,
        entries,
        starts=starts[order],
        begins=begins,
        ends=begins + sizes[order],
    )
    return Pieces(
        person=np.searchsorted(people.offsets, entries.sample[begins], side="right")
        - 1,
        sample=entries.sample[rows],
        xy=(entries.xy if states is None else states.mean[:, :, 0])[rows],
        variance=(entries.variance if states is None else states.cov[:, 0, 0])[rows],
        offsets=offsets,
        start=start,
        end=end,
    )


def _no_pieces() -> Pieces:
    nothing = np.zeros(0, dtype=np.int64)
    states = States(np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2, 2)))
    return Pieces(
        person=nothing,
        sample=nothing,
        xy=np.zeros((0, 2)),
        variance=np.zeros(0),
        offsets=np.zeros(1, dtype=np.int64),
        start=states,
        end=states,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Runs:
    """A runs of samples that robots of a fleet received."""

    robot: Ints  # (A,)
    presence: Ints  # (A,)
    begin: Ints  # (A,) first row in the release that answers are cut from.
    end: Ints  # (A,) first row after the run.


def _received_runs(network: Network, disclosure: Disclosure, robots: Ints) -> _Runs:
    received = np.flatnonzero(np.isin(disclosure.robot, robots))
    if disclosure.form == "flag":
        received = received[:0]
    presence, first = disclosure.presence[received], disclosure.first[received]
    begin = network.sent_rows(presence, first)
    return _Runs(
        robot=disclosure.robot[received],
        presence=presence,
        begin=begin,
        end=begin + disclosure.end[received] - first,
    )


def _joined_runs(network: Network, runs: _Runs, pseudonyms: Pseudonyms) -> Ints:
    """Return the piece of each run of samples, (A,).

    Runs of one answer, or with a common sample, are one piece. Two robots that ask at
    once get the same samples of a person, which join their runs.
    """
    if not runs.begin.size:
        return np.zeros(0, dtype=np.int64)
    from scipy.sparse import coo_array  # noqa: PLC0415 - heavy to import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415 - heavy to import

    by_start = np.lexsort((runs.end, runs.begin))
    reached = np.maximum.accumulate(runs.end[by_start])
    # Samples of different people have different rows: runs that overlap are of one
    # person.
    overlaps = runs.begin[by_start][1:] < reached[:-1]
    by_answer = np.argsort(runs.presence, kind="stable")
    is_same = np.diff(runs.presence[by_answer]) == 0
    pairs = [(by_start, overlaps), (by_answer, is_same)]
    if pseudonyms == "encounter":
        presences = network.patrol.presences
        person, query = (
            column[runs.presence] for column in (presences.person, presences.query)
        )
        by_query = np.lexsort((query, person, runs.robot))
        is_met = (np.diff(person[by_query]) == 0) & (np.diff(query[by_query]) <= 1)
        is_met &= np.diff(runs.robot[by_query]) == 0
        pairs.append((by_query, is_met))
    left = np.concatenate([order[:-1][joins] for order, joins in pairs])
    right = np.concatenate([order[1:][joins] for order, joins in pairs])
    graph = coo_array(
        (np.ones(left.size), (left, right)), shape=(runs.begin.size, runs.begin.size)
    )
    _, label = connected_components(graph, directed=False)
    return np.asarray(label, dtype=np.int64)


@dataclass(frozen=True, eq=False, slots=True)
class _Entries:
    """L samples of K pieces, each once; several draws of a sample are averaged."""

    sample: Ints  # (L,) of the patrol, rising within a piece.
    t: Floats  # (L,) s
    xy: Floats  # (L, 2) m
    variance: Floats  # (L,) m^2 per axis.
    row: Ints  # (L,) its latest row in the release that answers are cut from.
    query: Ints  # (L,) first query at which its piece was sent.
    offsets: Ints  # (K + 1,)


def _piece_entries(network: Network, runs: _Runs, label: Ints) -> _Entries:
    """Return the samples of pieces; `label` is the piece of each run, (A,)."""
    sizes = runs.end - runs.begin
    row, _ = stretches(runs.begin, sizes)
    # A single number a pair: numbers sort much faster than rows.
    n_rows = network.sent.t.size
    piece, row = np.divmod(np.unique(np.repeat(label, sizes) * n_rows + row), n_rows)
    n_samples = network.patrol.people.t.size
    key = piece * n_samples + sent_samples(network, row)
    variance = np.maximum(sent_variance(network), MIN_VARIANCE_M2)[row]
    keys, xy, variance = average_draws(key, network.sent.xy[row], variance)
    latest = np.full(keys.size, -1)
    np.maximum.at(latest, np.searchsorted(keys, key), row)
    piece, sample = np.divmod(keys, n_samples)
    n_pieces = int(label.max(initial=-1)) + 1
    first_query = np.full(n_pieces, np.iinfo(np.int64).max)
    np.minimum.at(first_query, label, network.patrol.presences.query[runs.presence])
    return _Entries(
        sample=sample,
        t=network.patrol.people.t[sample],
        xy=xy,
        variance=variance,
        row=latest,
        query=first_query[piece],
        offsets=np.searchsorted(piece, np.arange(n_pieces + 1)),
    )


def _first_new(network: Network, entries: _Entries) -> Ints:
    """Return the entry at which each piece begins for a link to an earlier one, (K,).

    With errors drawn anew at every query answers overlap in time without a common
    sample. A piece then begins after the query before its first; it keeps at least its
    last sample.
    """
    begins, ends = entries.offsets[:-1], entries.offsets[1:]
    if network.histories is None:
        return begins
    patrol = network.patrol
    before = np.append(-1, patrol.query_scan[:-1])[entries.query]
    is_old = patrol.scan[entries.sample] <= before
    n_old = np.add.reduceat(is_old.astype(np.int64), begins)
    return np.minimum(begins + n_old, ends - 1)


def _end_states(
    network: Network,
    disclosure: Disclosure,
    entries: _Entries,
    *,
    starts: Ints,
    begins: Ints,
    ends: Ints,
) -> tuple[States, States, States | None]:
    """Return the states at the start and the end of each piece, and of all states.

    The third is None for a log of samples.
    """
    if disclosure.form == "state":
        states = _filtered_states(network, entries.row)
        return states[starts], states[ends - 1], states
    t, xy, variance = entries.t, entries.xy, entries.variance
    rows, offsets = stretches(begins, ends - begins)
    end = _last_states(t[rows], xy[rows], variance[rows], offsets)
    return _first_states(t, xy, variance, starts=starts, ends=ends), end, None


def end_states(
    t: Floats, xy: Floats, variance: Floats, offsets: Ints
) -> tuple[States, States]:
    """Return the states at the first and the last sample of K runs of samples."""
    if offsets.size == 1:
        nothing = _no_pieces()
        return nothing.start, nothing.end
    start = _first_states(t, xy, variance, starts=offsets[:-1], ends=offsets[1:])
    return start, _last_states(t, xy, variance, offsets)


def _first_states(
    t: Floats, xy: Floats, variance: Floats, *, starts: Ints, ends: Ints
) -> States:
    """Return the states at the first samples, filtered back from the last ones."""
    sizes = ends - starts
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    turned = np.repeat(ends + offsets[:-1] - 1, sizes) - np.arange(offsets[-1])
    back = _last_states(-t[turned], xy[turned], variance[turned], offsets)
    flip = np.array([1.0, -1.0])  # A velocity back in time is the opposite one.
    return States(-back.t, back.mean * flip, back.cov * np.outer(flip, flip))


def _filtered_states(network: Network, row: Ints) -> States:
    """Return the network's filter over a person's whole shared history, (L,) states."""
    release, variance = network.sent, sent_variance(network)
    begins = release.offsets[np.searchsorted(release.offsets, row, side="right") - 1]
    history, within = stretches(begins, row + 1 - begins)
    return _last_states(
        release.t[history],
        release.xy[history],
        np.maximum(variance, MIN_VARIANCE_M2)[history],
        within,
    )


def _last_states(t: Floats, xy: Floats, variance: Floats, offsets: Ints) -> States:
    state = kalman_last(Batch(t, xy, variance, offsets, PRIOR_STD), q=Q)
    return States(t[offsets[1:] - 1], state.mean, state.cov)
