"""A calibrated posterior adversary: a density of position for every instant of people.

It is a slow reference for about fifty people, to hold fast attacks against. It knows
which entries of a log belong to a person, and when she is present: a ceiling. `experts`
states densities, `pool` weighs them by the time to the nearest entry. Chain, rates of
answers and weights are all fitted on other people: those of either half of the groups
serve the other half.

References
----------
Good, "Rational decisions", J. Royal Statistical Society B 14, 1952 (the log score).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from attacks.following.answer_evidence import (
    Answers,
    Levels,
    positive_rates,
    presence_states,
    state_levels,
)
from attacks.following.experts import (
    Clock,
    Entries,
    Opinions,
    PosteriorOptions,
    make_clock,
    state_opinions,
)
from attacks.following.logs import first_half
from attacks.following.pool import pool_weights, pooled_log_density
from attacks.following.walk_chain import Chain, fit_chain
from isac_track.errors import DataError
from isac_track.patrols import Patrol
from isac_track.patrols.answers import Disclosure
from isac_track.patrols.fleet_logs import Log, fleet_log
from isac_track.patrols.network import Network
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Ints


@dataclass(frozen=True, eq=False, slots=True)
class PosteriorScores:
    """Scores of the adversary at K instants of P people, in the logs of F fleets."""

    person: Ints  # (K,) number among the targets.
    fleet: Ints  # (K,)
    log_score: Floats  # (K,) nats, relative to the map.
    claimed: Floats  # (K,) stated probability of the best place.
    is_known: Bools  # (K,) whether the truth lies within epsilon of it.


@dataclass(frozen=True, eq=False, slots=True)
class _Evidence:
    """Answers of a patrol, and what a positive answer says about a state."""

    positive: Bools  # (E, R)
    levels: Levels  # (Q, R, S)
    rates: Floats  # (5,) probability of a positive answer at each level.


def choose_targets(group: tuple[str, ...], *, n_people: int, seed: int) -> Ints:
    """Draw people, half of them from each half of the groups, rising (P,).

    DataError if a half has nobody.
    """
    is_first = first_half(group)
    if is_first.all() or not is_first.any():
        raise DataError(
            "the posterior adversary learns from other people, and"
            f" {len(set(group))} group(s) do not make two halves; record more people"
        )
    rng = stream(seed, "following", "posterior", "targets")
    drawn = []
    for half, size in ((is_first, (n_people + 1) // 2), (~is_first, n_people // 2)):
        people = np.flatnonzero(half)
        drawn.append(rng.permutation(people)[: max(size, 1)])
    return np.sort(np.concatenate(drawn))


def posterior_scores(
    network: Network,
    disclosure: Disclosure,
    *,
    answers: Answers | None,
    targets: Ints,
    epsilon_m: float,
    options: PosteriorOptions,
    seed: int,
) -> tuple[PosteriorScores, PosteriorScores]:
    """Return the scores of a blind and of an informed adversary on P people.

    The informed adversary also uses `answers`; without them both are equal.
    """
    patrol = network.patrol
    is_first = first_half(patrol.people.group)
    levels: Levels | None = None  # The same for both halves.
    person, fleet, opinions = [], [], []
    for half in (is_first, ~is_first):
        chain = chain_from(patrol, people=~half, options=options)
        evidence = None
        if answers is not None and not answers.is_constant:
            if levels is None:
                levels = state_levels(
                    patrol, chain, answers.policy, options=options.chain, seed=seed
                )
            rates = positive_rates(
                answers,
                levels,
                query=patrol.presences.query,
                state=presence_states(patrol, chain, options.chain),
                rows=~half[patrol.presences.person],
            )
            evidence = _Evidence(answers.positive, levels, rates)
        for result in _opinions_on(
            network,
            disclosure,
            chain,
            evidence=evidence,
            targets=targets[half[targets]],
            epsilon_m=epsilon_m,
            options=options,
        ):
            n = result.opinions.gap.size
            person.append(np.full(n, result.target))
            fleet.append(np.full(n, result.fleet))
            opinions.append(result.opinions)
    owner, joined = np.concatenate(person), _join_opinions(opinions)
    blind, informed = (
        _score_pool(
            joined,
            n_experts=options.n_gaussians + n_chains,
            is_first=is_first[owner],
            person=np.searchsorted(targets, owner),
            fleet=np.concatenate(fleet),
        )
        for n_chains in (1, 2)
    )
    return blind, informed


def chain_from(patrol: Patrol, *, people: Bools, options: PosteriorOptions) -> Chain:
    """Return the chain of some people's walks, (N,); DataError if they are too few."""
    grid = patrol.grid
    grid_s = float(np.min(np.diff(grid.t)[np.diff(grid.t) > 0.0], initial=np.inf))
    try:
        return fit_chain(grid, people=people, options=options.chain, grid_s=grid_s)
    except ValueError as error:
        raise DataError(f"the posterior adversary cannot learn: {error}") from error


@dataclass(frozen=True, eq=False, slots=True)
class _FleetOpinions:
    """The opinions about a person from a fleet's log."""

    target: int
    fleet: int
    opinions: Opinions


def _opinions_on(
    network: Network,
    disclosure: Disclosure,
    chain: Chain,
    *,
    evidence: _Evidence | None,
    targets: Ints,
    epsilon_m: float,
    options: PosteriorOptions,
) -> Iterator[_FleetOpinions]:
    """Yield the opinions about each target from each fleet's log."""
    patrol = network.patrol
    grid = patrol.grid
    # Of each target: opinions by log, for this call alone. Fleets hold equal logs often.
    by_log: dict[tuple[int, bytes], Opinions] = {}
    for fleet in range(patrol.n_fleets):
        robots = np.arange(patrol.robots_per_fleet) + fleet * patrol.robots_per_fleet
        log = fleet_log(network, disclosure, robots=robots)
        for target in targets.tolist():
            entries = _person_entries(log, target)
            key = target, entries.t.tobytes()
            is_new = evidence is not None or key not in by_log
            if is_new:
                rows = slice(grid.offsets[target], grid.offsets[target + 1])
                clock = make_clock(
                    grid.t[rows], start_s=float(patrol.scan_s[0]), step_s=chain.step_s
                )
                further = None
                if evidence is not None:
                    further = _likelihood_of_answers(
                        patrol, evidence, clock, person=target, robots=robots
                    )
                by_log[key] = state_opinions(
                    chain,
                    entries,
                    clock=clock,
                    t=grid.t[rows],
                    true_xy=grid.xy[rows],
                    further=further,
                    epsilon_m=epsilon_m,
                    options=options,
                )
            yield _FleetOpinions(target, fleet, by_log[key])
            if evidence is not None:
                by_log.clear()


def _person_entries(log: Log, person: int) -> Entries:
    rows = slice(log.offsets[person], log.offsets[person + 1])
    cov = None if log.cov is None else log.cov[rows]
    return Entries(log.t[rows], log.xy[rows], log.variance[rows], cov)


def _likelihood_of_answers(
    patrol: Patrol, evidence: _Evidence, clock: Clock, *, person: int, robots: Ints
) -> Callable[[int], Floats | float]:
    """Return the likelihood of all answers to a fleet at each step of a clock.

    A query counts at the nearest step, if the person is present.
    """
    pairs = patrol.presences
    rows = np.flatnonzero(pairs.person == person)
    query_s = patrol.scan_s[patrol.query_scan[pairs.query[rows]]]
    nearest = np.abs(query_s[:, None] - clock.step_s).argmin(axis=1)
    say_no, say_yes = 1.0 - evidence.rates, evidence.rates

    def likelihood(step: int) -> Floats | float:
        product: Floats | float = 1.0
        for row in rows[nearest == step].tolist():
            for robot in robots.tolist():
                rates = say_yes if evidence.positive[row, robot] else say_no
                product = product * rates[evidence.levels[pairs.query[row], robot]]
        return product

    return likelihood


def _join_opinions(opinions: list[Opinions]) -> Opinions:
    return Opinions(
        log_density=np.concatenate([part.log_density for part in opinions]),
        log_map=np.concatenate([part.log_map for part in opinions]),
        mass=np.concatenate([part.mass for part in opinions]),
        is_hit=np.concatenate([part.is_hit for part in opinions]),
        gap=np.concatenate([part.gap for part in opinions]),
    )


def _score_pool(
    opinions: Opinions,
    *,
    n_experts: int,
    is_first: Bools,
    person: Ints,
    fleet: Ints,
) -> PosteriorScores:
    """Return the scores of the first experts, pooled by weights of the other half."""
    log_density = opinions.log_density[:, :n_experts]
    pooled, mass = np.empty(len(log_density)), np.empty(opinions.is_hit.shape)
    for half in (is_first, ~is_first):
        weights = pool_weights(log_density[~half], opinions.gap[~half])
        pooled[half] = pooled_log_density(
            log_density[half], opinions.gap[half], weights
        )
        by_expert = opinions.mass[half, :, :n_experts]
        mass[half] = np.einsum("kjx,kx->kj", by_expert, weights[opinions.gap[half]])
    best, rows = mass.argmax(axis=1), np.arange(len(mass))
    return PosteriorScores(
        person=person,
        fleet=fleet,
        log_score=pooled - opinions.log_map,
        claimed=mass[rows, best],
        is_known=opinions.is_hit[rows, best],
    )
