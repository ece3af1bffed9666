"""Follow people through the logs of all fleets of a patrol, scored by the truth."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from hashlib import sha256
from typing import Final

import numpy as np

from attacks.following.absence import contradictions
from attacks.following.chains import Chains, follow
from attacks.following.links import Links, candidate_links, entropy_bits, next_pieces
from attacks.following.pieces import Pieces, Pseudonyms, collect_pieces
from isac_track.patrols import Patrol
from isac_track.patrols.answers import Disclosure
from isac_track.patrols.estimators import estimate_positions
from isac_track.patrols.fleet_logs import Log
from isac_track.patrols.network import Network
from isac_track.patrols.reports import average_draws
from isac_track.protocols import Policy
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Ints, squared_lengths

CONFUSED_BITS: Final = 0.4
"""Entropy from which an adversary counts as confused (Hoh et al., CCS 2007)."""
_LEAST_PROBABILITY: Final = 1e-3  # Of links for which the policy is consulted.


class Ending(IntEnum):
    """Why an adversary who started at the first answer about a person stops there."""

    UNSEEN = 0  # There is no answer about her.
    LEFT = 1  # She has no further answer; the adversary was never confused nor wrong.
    CONFUSED = 2  # There are too many likely candidates.
    WRONG = 3  # The adversary is sure of a wrong candidate.


@dataclass(frozen=True, eq=False, slots=True)
class Following:
    """How long F fleets follow N people by their logs."""

    present_s: Floats  # (N,) between the first and the last instant of a walk.
    ceiling_s: Floats  # (N, F) between the first and the last answer about a person.
    followed_s: Floats  # (N, F) the same within one chain whose answers are all hers.
    until_s: Floats  # (N, F) from the first answer until `ending`.
    ending: Ints  # (N, F) an `Ending`.
    instants: Ints  # (N,) of the grid.
    known: Ints  # (N, F) instants at which a person's chain states her place.


@dataclass(frozen=True, eq=False, slots=True)
class _FleetFollowing:
    """How long one fleet's log lets an adversary follow N people; see `Following`."""

    ceiling_s: Floats
    followed_s: Floats
    until_s: Floats
    ending: Ints
    known: Ints


def follow_fleets(
    network: Network,
    disclosure: Disclosure,
    *,
    estimator: str,
    guesses: Floats,
    epsilon_m: float,
    seed: int,
    pseudonyms: Pseudonyms = "query",
    knows_policy: Policy | None = None,
    shuffled: bool = False,
) -> Following:
    """Return how long each fleet's log lets an adversary follow each person.

    `estimator` states positions between the answers of a chain
    (`knowledge.ESTIMATORS`), and `guesses`, (N, 2) m, those of people without a
    chain. `pseudonyms` last for a query or for an encounter. With `knows_policy` the
    adversary counts queries at which that policy would have sent a person and nothing
    was sent. `shuffled` is the control: first states change places among all pieces.
    """
    patrol = network.patrol
    # Results by log, for this call alone: fleets often hold equal logs.
    by_log: dict[bytes, _FleetFollowing] = {}
    fleets = []
    for fleet in range(patrol.n_fleets):
        robots = np.arange(patrol.robots_per_fleet) + fleet * patrol.robots_per_fleet
        key = disclosure.key(robots=robots)
        if knows_policy is not None or pseudonyms == "encounter":
            # The result depends on the routes, too: they decide who should be sent, and
            # on the robot that each answer went to.
            key += str(fleet).encode()
        if key not in by_log:
            by_log[key] = _follow_fleet(
                network,
                disclosure,
                robots,
                estimator=estimator,
                guesses=guesses,
                epsilon_m=epsilon_m,
                seed=seed,
                pseudonyms=pseudonyms,
                policy=knows_policy,
                shuffled=shuffled,
            )
        fleets.append(by_log[key])
    t, offsets = patrol.grid.t, patrol.grid.offsets
    return Following(
        present_s=t[offsets[1:] - 1] - t[offsets[:-1]],
        ceiling_s=np.stack([fleet.ceiling_s for fleet in fleets], axis=-1),
        followed_s=np.stack([fleet.followed_s for fleet in fleets], axis=-1),
        until_s=np.stack([fleet.until_s for fleet in fleets], axis=-1),
        ending=np.stack([fleet.ending for fleet in fleets], axis=-1),
        instants=np.diff(offsets),
        known=np.stack([fleet.known for fleet in fleets], axis=-1),
    )


def _follow_fleet(
    network: Network,
    disclosure: Disclosure,
    robots: Ints,
    *,
    estimator: str,
    guesses: Floats,
    epsilon_m: float,
    seed: int,
    pseudonyms: Pseudonyms,
    policy: Policy | None,
    shuffled: bool,
) -> _FleetFollowing:
    """Follow people through the log of one fleet; parameters as of `follow_fleets`."""
    pieces = collect_pieces(network, disclosure, robots=robots, pseudonyms=pseudonyms)
    rng = stream(seed, "following", "shuffled")
    begins = rng.permutation(len(pieces)) if shuffled else None
    links, chains = _follow_log(
        network.patrol,
        pieces,
        begins=begins,
        robots=robots,
        policy=policy,
        seed=seed,
    )
    known = _known_by_chains(
        network,
        pieces,
        chains,
        estimator=estimator,
        guesses=guesses,
        epsilon_m=epsilon_m,
    )
    n_people = known.size
    ceiling_s, followed_s = _pure_chains(pieces, chains.chain, n_people=n_people)
    until_s, ending = _until_confused(
        pieces, links, chains.probability, n_people=n_people
    )
    return _FleetFollowing(ceiling_s, followed_s, until_s, ending, known)


def _follow_log(
    patrol: Patrol,
    pieces: Pieces,
    *,
    begins: Ints | None,
    robots: Ints,
    policy: Policy | None,
    seed: int,
) -> tuple[Links, Chains]:
    """Return the candidate links of a log and the adversary's chains."""
    half = first_half(patrol.people.group)[pieces.person]
    links = candidate_links(pieces, begins=begins)
    chains = follow(pieces, links, is_first_half=half)
    if policy is None:
        return links, chains
    links = links[chains.probability >= _LEAST_PROBABILITY]
    absent = contradictions(
        pieces, links, patrol=patrol, policy=policy, robots=robots, seed=seed
    )
    links = links.with_feature(absent)
    return links, follow(pieces, links, is_first_half=half)


def first_half(group: tuple[str, ...]) -> Bools:
    """Return whether each person is in the first half, (N,), by a hash of the group."""
    return np.array(
        [sha256(name.encode()).digest()[0] % 2 == 0 for name in group], dtype=bool
    )


def _pure_chains(
    pieces: Pieces, chain: Ints, *, n_people: int
) -> tuple[Floats, Floats]:
    """Return the times from first to last answer, and in a pure chain, (N,) s."""
    ceiling_s, followed_s = np.zeros(n_people), np.zeros(n_people)
    if not len(pieces):
        return ceiling_s, followed_s
    ceiling_s = _spans(pieces, pieces.person, n_people)
    n_chains = int(chain.max()) + 1
    span_s = _spans(pieces, chain, n_chains)
    lowest, highest = np.full(n_chains, n_people), np.full(n_chains, -1)
    np.minimum.at(lowest, chain, pieces.person)
    np.maximum.at(highest, chain, pieces.person)
    pure = np.flatnonzero(lowest == highest)
    np.maximum.at(followed_s, lowest[pure], span_s[pure])
    return ceiling_s, followed_s


def _spans(pieces: Pieces, label: Ints, n_labels: int) -> Floats:
    """Return the time from first start to last end of the pieces of each label."""
    first, last = np.full(n_labels, np.inf), np.full(n_labels, -np.inf)
    np.minimum.at(first, label, pieces.start.t)
    np.maximum.at(last, label, pieces.end.t)
    return np.where(last >= first, last - first, 0.0)


def _until_confused(
    pieces: Pieces, links: Links, probability: Floats, *, n_people: int
) -> tuple[Floats, Ints]:
    """Return the time from first answer to `Ending` of each person, and the ending."""
    following = next_pieces(pieces)
    bits = entropy_bits(links, probability)
    stop_probability = 1.0 - np.bincount(
        links.before, weights=probability, minlength=len(pieces)
    )
    is_next = following[links.before] == links.after
    true_probability = np.zeros(len(pieces))
    true_probability[links.before[is_next]] = probability[is_next]
    best = np.zeros(len(pieces))
    np.maximum.at(best, links.before, probability)
    is_right = true_probability > np.maximum(
        stop_probability, np.where(true_probability < best, best, 0.0)
    )
    # For a piece, UNSEEN means that the adversary follows on.
    ending = np.full(len(pieces), Ending.UNSEEN)
    ending[~is_right] = Ending.WRONG
    ending[bits > CONFUSED_BITS] = Ending.CONFUSED
    ending[following < 0] = Ending.LEFT
    until_s, outcome = np.zeros(n_people), np.full(n_people, Ending.UNSEEN)
    started_s = np.full(n_people, np.inf)
    np.minimum.at(started_s, pieces.person, pieces.start.t)
    stops = np.flatnonzero(ending != Ending.UNSEEN)
    # Pieces are in the order of their starts: the first stop of each person counts.
    person, first = np.unique(pieces.person[stops], return_index=True)
    stop = stops[first]
    until_s[person] = pieces.end.t[stop] - started_s[person]
    outcome[person] = ending[stop]
    return until_s, outcome


def _known_by_chains(
    network: Network,
    pieces: Pieces,
    chains: Chains,
    *,
    estimator: str,
    guesses: Floats,
    epsilon_m: float,
) -> Ints:
    """Return how many instants of each person have her place known by a chain, (N,).

    A chain belongs to the person who has most of its samples. Of several chains of a
    person the nearest in time counts.
    """
    grid = network.patrol.grid
    estimate = np.repeat(guesses, np.diff(grid.offsets), axis=0)
    if len(pieces):
        log = _chain_log(network, pieces, chains.chain)
        row, chain = _instants_of_chains(
            network.patrol, log, _owners(pieces, chains.chain)
        )
        order = np.lexsort((row, chain))
        row, chain = row[order], chain[order]
        offsets = np.searchsorted(chain, np.arange(log.offsets.size))
        estimate[row] = estimate_positions(
            log,
            t=grid.t[row],
            offsets=offsets,
            estimator=estimator,
            fallback_xy=estimate[row],
        )
    is_known = squared_lengths(estimate - grid.xy) < epsilon_m**2
    return np.asarray(np.add.reduceat(is_known.astype(np.int64), grid.offsets[:-1]))


def _chain_log(network: Network, pieces: Pieces, chain: Ints) -> Log:
    """Return the entries of each chain in turn."""
    sizes = np.diff(pieces.offsets)
    label = np.repeat(chain, sizes)
    # Chains may hold several draws of a sample.
    n_samples = network.patrol.people.t.size
    key, reports = average_draws(label * n_samples + pieces.sample, pieces.reports)
    label, sample = np.divmod(key, n_samples)
    t = network.patrol.people.t[sample]
    # A chain may hold another person, whose samples have numbers of their own.
    order = np.lexsort((t, label))
    reports = reports[order].floored()
    return Log(
        sample=sample[order],
        t=t[order],
        xy=reports.xy,
        variance=reports.variance,
        offsets=np.searchsorted(label, np.arange(int(chain.max()) + 2)),
        cov=reports.cov,
    )


def _owners(pieces: Pieces, chain: Ints) -> Ints:
    """Return the person who has most samples of each chain; of equals the first row."""
    size = np.diff(pieces.offsets)
    pairs, row = np.unique(
        np.stack([chain, pieces.person]), axis=1, return_inverse=True
    )
    total = np.bincount(row.ravel(), weights=size)
    order = np.lexsort((pairs[1], -total, pairs[0]))
    _, first = np.unique(pairs[0][order], return_index=True)
    return np.asarray(pairs[1][order][first])


def _instants_of_chains(patrol: Patrol, log: Log, owner: Ints) -> tuple[Ints, Ints]:
    """Return the instants of people who own a chain, and the nearest chain of each."""
    start_s, end_s = log.t[log.offsets[:-1]], log.t[log.offsets[1:] - 1]
    rows, chains = [], []
    for person, owned in _by_owner(owner):
        row = np.arange(patrol.grid.offsets[person], patrol.grid.offsets[person + 1])
        t = patrol.grid.t[row][:, None]
        away_s = np.maximum(np.maximum(start_s[owned] - t, t - end_s[owned]), 0.0)
        rows.append(row)
        chains.append(owned[away_s.argmin(axis=1)])
    return np.concatenate(rows), np.concatenate(chains)


def _by_owner(owner: Ints) -> Iterator[tuple[int, Ints]]:
    """Yield each person who owns a chain, and her chains."""
    order = np.argsort(owner, kind="stable")
    people, first_rows = np.unique(owner[order], return_index=True)
    yield from zip(people.tolist(), np.split(order, first_rows[1:]), strict=True)
