"""Pieces of walks in a log: answers that repeat a sample belong to one person.

Pseudonyms are fresh in every answer. Errors are continuous, so no two people share a
sample: an adversary joins two answers with a common sample without doubt. A window
longer than the time between two queries therefore yields a chain by itself.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from isac_track.kalman import Batch, kalman_last
from isac_track.noise import MIN_VARIANCE_M2
from isac_track.patrols.answers import Disclosure, Network
from isac_track.patrols.knowledge import declared_variance
from isac_track.types import Floats, Ints, stretches

Q: Final = 0.05  # m^2/s^3, of people's acceleration: that of the linker `kinematic`.
PRIOR_STD: Final = (100.0, 1.4)  # m around the first sample and m/s around rest.


@dataclass(frozen=True, eq=False, slots=True)
class States:
    """Kalman states of K pieces at one of their ends; both axes share a covariance."""

    t: Floats  # (K,) s
    mean: Floats  # (K, 2, 2) m and m/s: per axis position and velocity.
    cov: Floats  # (K, 2, 2) m^2, m^2/s, m^2/s^2


@dataclass(frozen=True, eq=False, slots=True)
class Pieces:
    """K pieces of the log of one fleet, in the order of their starts.

    Only scoring reads `person`: an adversary does not hold it.
    """

    person: Ints  # (K,) row of the true person.
    sample: Ints  # (L,) samples of the patrol, rising within a piece.
    offsets: Ints  # (K + 1,) piece k owns the samples ``offsets[k]:offsets[k + 1]``.
    start: States  # States at the first sample, from the samples after it.
    end: States  # States at the last sample, from the samples before it.

    def __len__(self) -> int:
        """Return their number."""
        return self.person.size


def collect_pieces(network: Network, disclosure: Disclosure, *, robots: Ints) -> Pieces:
    """Return the pieces that the log of some robots of a fleet holds.

    A `flag` has no pieces. A `state` is a piece of its own at the instant of its query:
    no later state repeats it.
    """
    received = np.flatnonzero(np.isin(disclosure.robot, robots))
    if disclosure.form == "flag":
        received = received[:0]
    presence = disclosure.presence[received]
    first, end = disclosure.first[received], disclosure.end[received]
    label = _joined_runs(presence=presence, first=first, end=end)
    sample, piece = _samples_of_pieces(first, end, label)
    begins = np.searchsorted(piece, np.arange(int(label.max(initial=-1)) + 1))
    started_s = network.patrol.people.t[sample[begins]]
    order = np.lexsort((sample[begins], started_s))
    sizes = np.diff(np.append(begins, sample.size))
    rows, offsets = stretches(begins[order], sizes[order])
    owner = (
        np.searchsorted(network.patrol.people.offsets, sample[begins], side="right") - 1
    )
    start, final = _end_states(network, disclosure, sample[rows], offsets)
    return Pieces(
        person=owner[order],
        sample=sample[rows],
        offsets=offsets,
        start=start,
        end=final,
    )


def _joined_runs(*, presence: Ints, first: Ints, end: Ints) -> Ints:
    """Return the piece of each run of samples, (A,).

    Runs of one answer, or with a common sample, are one piece. Two robots that ask at
    once get the same samples of a person, which join their runs.
    """
    if not first.size:
        return np.zeros(0, dtype=np.int64)
    by_start = np.lexsort((end, first))
    reached = np.maximum.accumulate(end[by_start])
    # Samples of different people have different numbers: runs that overlap are of one
    # person.
    overlaps = first[by_start][1:] < reached[:-1]
    by_answer = np.argsort(presence, kind="stable")
    is_same = np.diff(presence[by_answer]) == 0
    left = np.concatenate([by_start[:-1][overlaps], by_answer[:-1][is_same]])
    right = np.concatenate([by_start[1:][overlaps], by_answer[1:][is_same]])
    graph = coo_array(
        (np.ones(left.size), (left, right)), shape=(first.size, first.size)
    )
    _, label = connected_components(graph, directed=False)
    return np.asarray(label, dtype=np.int64)


def _samples_of_pieces(first: Ints, end: Ints, label: Ints) -> tuple[Ints, Ints]:
    """Return each piece's samples once, and the piece of each sample, (L,)."""
    sample, _ = stretches(first, end - first)
    piece = np.repeat(label, end - first)
    # A single number a pair: numbers sort much faster than rows.
    n_samples = int(sample.max(initial=-1)) + 1
    pieces, samples = np.divmod(
        np.unique(piece * n_samples + sample), max(n_samples, 1)
    )
    return samples, pieces


def _end_states(
    network: Network, disclosure: Disclosure, sample: Ints, offsets: Ints
) -> tuple[States, States]:
    """Return the states at the first and the last sample of each piece."""
    release, sizes = network.release, np.diff(offsets)
    if not sizes.size:
        nothing = States(np.zeros(0), np.zeros((0, 2, 2)), np.zeros((0, 2, 2)))
        return nothing, nothing
    variance = np.maximum(declared_variance(network), MIN_VARIANCE_M2)
    if disclosure.form == "state":
        # The answer is the network's filter over a person's whole shared history.
        begins = network.patrol.people.offsets[
            np.searchsorted(network.patrol.people.offsets, sample, side="right") - 1
        ]
        history, within = stretches(begins, sample + 1 - begins)
        state = _last_states(
            release.t[history], release.xy[history], variance[history], within
        )
        return state, state
    t, xy, variance = release.t[sample], release.xy[sample], variance[sample]
    end = _last_states(t, xy, variance, offsets)
    # Back in time: from the last sample of a piece to its first.
    turned = np.repeat(offsets[:-1] + offsets[1:] - 1, sizes) - np.arange(t.size)
    back = _last_states(-t[turned], xy[turned], variance[turned], offsets)
    flip = np.array([1.0, -1.0])  # A velocity back in time is the opposite one.
    start = States(-back.t, back.mean * flip, back.cov * np.outer(flip, flip))
    return start, end


def _last_states(t: Floats, xy: Floats, variance: Floats, offsets: Ints) -> States:
    state = kalman_last(Batch(t, xy, variance, offsets, PRIOR_STD), q=Q)
    return States(t[offsets[1:] - 1], state.mean, state.cov)
