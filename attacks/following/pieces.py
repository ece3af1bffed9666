"""Pieces of walks in a log: answers that repeat a sample belong to one person.

Pseudonyms are fresh in every answer, or last for an encounter. Errors are continuous,
so no two people share a sample: an adversary joins two answers with a common sample
without doubt. A window longer than the time between two queries therefore yields a
chain by itself.
"""

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from isac_track.kalman import kalman_last, planar_last
from isac_track.patrols.answers import Disclosure
from isac_track.patrols.fleet_logs import sent_samples
from isac_track.patrols.network import Network
from isac_track.patrols.reports import Reports, average_draws, sent_reports
from isac_track.types import Floats, Ints, stretches

Pseudonyms: TypeAlias = Literal["query", "encounter"]
"""How long an answer's pseudonym lasts."""
Q: Final = 0.05  # m^2/s^3, of people's acceleration: that of the linker `kinematic`.
PRIOR_STD: Final = (100.0, 1.4)  # m around the first sample and m/s around rest.


@dataclass(frozen=True, eq=False, slots=True)
class States:
    """Kalman states of K pieces at one of their ends.

    Both axes share a covariance, unless the errors have a shape.
    """

    t: Floats  # (K,) s
    mean: Floats  # (K, 2, 2) m and m/s: per axis position and velocity.
    cov: Floats  # (K, 2, 2) m^2, m^2/s, m^2/s^2, of an axis; the mean of both axes.
    # (K, 2, 2, 2, 2), of both axes, behind errors with a shape.
    planar: Floats | None = None

    def __getitem__(self, rows: Ints) -> "States":
        """Return some of the states."""
        planar = None if self.planar is None else self.planar[rows]
        return States(self.t[rows], self.mean[rows], self.cov[rows], planar)


@dataclass(frozen=True, eq=False, slots=True)
class Pieces:
    """K pieces of the log of one fleet, in the order of their starts.

    Only scoring reads `person`: an adversary does not hold it.
    """

    person: Ints  # (K,) row of the true person.
    sample: Ints  # (L,) samples of the patrol, rising within a piece.
    reports: Reports  # Positions of the samples in the log, or of states.
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
    answers share a sample. `pseudonyms` that last for an encounter join the answers to
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
    states = _piece_states(
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
        reports=states.reports[rows],
        offsets=offsets,
        start=states.start,
        end=states.end,
    )


def _state_reports(states: States) -> Reports:
    """Return the positions of states with their covariances."""
    planar = states.planar
    cov = None if planar is None else planar[:, :, 0, :, 0]
    return Reports(states.mean[:, :, 0], states.cov[:, 0, 0], cov)


def _no_pieces() -> Pieces:
    nothing = np.zeros(0, dtype=np.int64)
    states = States(np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2, 2)))
    return Pieces(
        person=nothing,
        sample=nothing,
        reports=Reports(np.zeros((0, 2)), np.zeros(0), None),
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
    reports: Reports
    row: Ints  # (L,) its latest row in the release that answers are cut from.
    query: Ints  # (L,) first query at which its piece was sent.
    offsets: Ints  # (K + 1,)


def _piece_entries(network: Network, runs: _Runs, label: Ints) -> _Entries:
    """Return the samples of pieces; `label` is the piece of each run, (A,)."""
    sizes = runs.end - runs.begin
    row, _ = stretches(runs.begin, sizes)
    # A single number a pair: numbers sort much faster than rows.
    n_rows = network.sent_release.t.size
    piece, row = np.divmod(np.unique(np.repeat(label, sizes) * n_rows + row), n_rows)
    n_samples = network.patrol.people.t.size
    key = piece * n_samples + sent_samples(network, row)
    keys, reports = average_draws(key, sent_reports(network).floored()[row])
    latest = np.full(keys.size, -1)
    np.maximum.at(latest, np.searchsorted(keys, key), row)
    piece, sample = np.divmod(keys, n_samples)
    n_pieces = int(label.max(initial=-1)) + 1
    first_query = np.full(n_pieces, np.iinfo(np.int64).max)
    np.minimum.at(first_query, label, network.patrol.presences.query[runs.presence])
    return _Entries(
        sample=sample,
        t=network.patrol.people.t[sample],
        reports=reports,
        row=latest,
        query=first_query[piece],
        offsets=np.searchsorted(piece, np.arange(n_pieces + 1)),
    )


def _first_new(network: Network, entries: _Entries) -> Ints:
    """Return the entry at which each piece begins for a link to an earlier piece, (K,).

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


@dataclass(frozen=True, eq=False, slots=True)
class _PieceStates:
    """States of K pieces at both ends, and positions of all M entries."""

    start: States  # (K,)
    end: States  # (K,)
    reports: Reports  # (M,)


def _piece_states(
    network: Network,
    disclosure: Disclosure,
    entries: _Entries,
    *,
    starts: Ints,
    begins: Ints,
    ends: Ints,
) -> _PieceStates:
    """Return the states at the start and the end of each piece."""
    if disclosure.form == "state":
        states = _filtered_states(network, entries.row)
        return _PieceStates(states[starts], states[ends - 1], _state_reports(states))
    t, reports = entries.t, entries.reports
    rows, offsets = stretches(begins, ends - begins)
    end = last_states(t[rows], reports[rows], offsets)
    start = _first_states(t, reports, starts=starts, ends=ends)
    return _PieceStates(start, end, reports)


def end_states(t: Floats, reports: Reports, offsets: Ints) -> tuple[States, States]:
    """Return the states at the first and the last sample of K runs of samples."""
    if offsets.size == 1:
        nothing = _no_pieces()
        return nothing.start, nothing.end
    start = _first_states(t, reports, starts=offsets[:-1], ends=offsets[1:])
    return start, last_states(t, reports, offsets)


def _first_states(t: Floats, reports: Reports, *, starts: Ints, ends: Ints) -> States:
    """Return the states at the first samples, filtered back from the last."""
    sizes = ends - starts
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    turned = np.repeat(ends + offsets[:-1] - 1, sizes) - np.arange(offsets[-1])
    back = last_states(-t[turned], reports[turned], offsets)
    flip = np.array([1.0, -1.0])  # Back in time a velocity is the opposite.
    both, planar = np.outer(flip, flip), back.planar
    return States(
        -back.t,
        back.mean * flip,
        back.cov * both,
        None if planar is None else planar * both[:, None, :],
    )


def _filtered_states(network: Network, row: Ints) -> States:
    """Return the network's filter over a person's whole shared history, (L,) states."""
    release, reports = network.sent_release, sent_reports(network).floored()
    begins = release.offsets[np.searchsorted(release.offsets, row, side="right") - 1]
    history, within = stretches(begins, row + 1 - begins)
    return last_states(release.t[history], reports[history], within)


def last_states(t: Floats, reports: Reports, offsets: Ints) -> States:
    """Return the states at the last samples of K runs of samples."""
    batch = reports.batch(t, offsets, prior_std=PRIOR_STD)
    last_s = t[offsets[1:] - 1]
    if batch.ellipse is None:
        state = kalman_last(batch, q=Q)
        return States(last_s, state.mean, state.cov)
    shaped = planar_last(batch, q=Q)
    mean_cov = np.einsum("kaiaj->kij", shaped.cov) / 2.0
    return States(last_s, shaped.mean, mean_cov, shaped.cov)
