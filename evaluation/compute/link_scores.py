"""The scorecard of a linkage attack or control.

The scorecard takes a bootstrap and a permutation test. The cell stores it, so that a
report computes neither again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.random import Generator

from evaluation.compute.link_setup import Pairing, SensedTask
from isac_track import linkability
from isac_track.intervals import Estimate, cluster_sums, exact_binomial, ratio_estimates
from isac_track.linkability.ranks import expected_hit
from isac_track.linkability.scoring import Drawn, draw, scorecard_from_draws
from isac_track.linkability.significance import People, searched_people
from isac_track.rng import stream
from isac_track.types import Floats, Ints

WITHOUT_GROUPS, WITHOUT_FROZEN = "without_groups", "without_frozen"
"""Cohorts without groups, whose members move together, or frozen annotations."""
SHUFFLES = 999
AUDIT_SHUFFLES = 1999  # Enough to reject at a hundredth over six tests.
# Probes that are compared at a time: thousands at once would take 200 MB.
_AT_ONCE = 256
_NOTHING: Final[Mapping[int, Any]] = MappingProxyType({})


@dataclass(frozen=True, eq=False, slots=True)
class LinkResult:
    """Outcome of one linkage cell: raw scores, and all that is computed from them."""

    searches: tuple[linkability.Search, ...]
    calibration: Mapping[int, linkability.Calibration]  # By fold.
    scorecard: linkability.Scorecard
    # Rank 1 by the people that are left out; none for a control.
    cohorts: Mapping[str, Mapping[str, float]]
    is_assigned: bool  # Whether scores have a known scale, or need none.
    losses: Floats | None = None
    """(n,) hits lost by each fully searched probe if only candidates are scored."""


def evaluate_links(
    scores: Mapping[int, Floats],
    *,
    setup: SensedTask,
    control_rng: Generator | None = None,
    attack_names: tuple[str, ...] = (),
    calibration: Mapping[int, linkability.Calibration] = _NOTHING,
    matched: Mapping[int, Floats] = _NOTHING,
    is_audit: bool = False,
    losses: Floats | None = None,
) -> LinkResult:
    """Return the scorecard of an attack or a control.

    An attack also has its rank 1 without confounders. `scores` has the scores of every
    search, (P, G) each, by its number; `calibration` has that of every fold with people
    to calibrate on. `matched` has by search the probabilities of the pairs of an open
    gallery (`match_pairs`): without them an open gallery has no assignment.
    `control_rng` is the random stream of a control. Without it the scores are of an
    attack: the stream of its `attack_names` is the same at all levels. With
    `setup.n_candidates` all metrics follow from the ranks, and `losses` holds what the
    attack lost.
    """
    task_windows = setup.task_windows
    searches = _make_searches(scores, setup)
    is_matched = task_windows.task.is_open and scores.keys() <= matched.keys()
    is_assigned = is_matched or not task_windows.task.is_open
    # Scores of candidates alone cannot be summed into an assignment.
    is_assigned &= not setup.n_candidates
    scorecard = _scorecard(
        searches,
        setup,
        control_rng=control_rng,
        attack_names=attack_names,
        calibration=calibration,
        matched=[matched[number] for number in sorted(scores)] if is_matched else None,
        n_shuffles=AUDIT_SHUFFLES if is_audit else SHUFFLES,
    )
    scorecard = _with_known_estimates(
        scorecard,
        is_assigned=is_assigned,
        links_returning_people=task_windows.task.links_returning_people,
    )
    is_control = control_rng is not None
    return LinkResult(
        searches=searches,
        calibration=calibration,
        scorecard=scorecard,
        cohorts={} if is_control else _cohort_hits(searches, setup),
        is_assigned=is_assigned,
        losses=losses,
    )


def _scorecard(
    searches: tuple[linkability.Search, ...],
    setup: SensedTask,
    *,
    control_rng: Generator | None,
    attack_names: tuple[str, ...],
    calibration: Mapping[int, linkability.Calibration],
    matched: Sequence[Floats] | None,
    n_shuffles: int,
) -> linkability.Scorecard:
    """Return the scorecard of all searches; `matched` has the pairs of each, if any."""
    if setup.n_candidates:
        rng = control_rng
        if rng is None:
            rng = _stream(setup.seed, *attack_names)
        return linkability.rank_scorecard(
            searches, weights=setup.weights, rng=rng, n_shuffles=n_shuffles
        )
    is_calibrated = {search.scale for search in searches} <= set(calibration)
    people = tuple(searched_people(search) for search in searches)
    if control_rng is not None:
        draws = draw(people, control_rng, n_shuffles)
    else:
        draws = _draws(people, setup.seed, *attack_names)
    return scorecard_from_draws(
        searches,
        weights=setup.weights,
        calibration=calibration if is_calibrated else None,
        no_match_score=None,
        draws=draws,
        matched=matched,
    )


def _make_searches(
    scores: Mapping[int, Floats], setup: SensedTask
) -> tuple[linkability.Search, ...]:
    """Return every search with its scores, mates and clusters, by number."""
    probe, gallery = setup.task_windows.probe, setup.task_windows.gallery
    return tuple(
        linkability.Search(
            scores=scores[number],
            mate=pairing.mate,
            probe_cluster=setup.cluster[probe.person[pairing.probe]],
            gallery_cluster=setup.cluster[gallery.person[pairing.gallery]],
            scale=int(setup.task_windows.fold[number]),
        )
        for number, pairing in sorted(setup.searches.items())
    )


def _with_known_estimates(
    scorecard: linkability.Scorecard, *, is_assigned: bool, links_returning_people: bool
) -> linkability.Scorecard:
    """Return a scorecard without unknown assignments, exact for few people."""
    estimates = dict(scorecard.estimates)
    if not is_assigned:  # the cost of leaving a probe without a mate is unknown
        for name in estimates.keys() & {"rank1_assigned", "false_link_rate"}:
            unknown = np.full_like(estimates[name].replicates, np.nan)
            estimates[name] = Estimate(np.nan, n=estimates[name].n, replicates=unknown)
    if links_returning_people:  # a single outcome per person, and few people
        # Ties leave fractions of hits.
        hits = int(estimates["rank1"].value * scorecard.n_mated + 1e-9)
        low, high = exact_binomial(hits=hits, n=scorecard.n_mated)
        estimates["rank1"] = replace(estimates["rank1"], ci_low=low, ci_high=high)
    return replace(scorecard, estimates=estimates)


def _stream(seed: int, *names: str) -> Generator:
    """Return the stream of the scorecard of the attack of this name, at any level."""
    return stream(seed, "linkage", "scorecard", *names)


# The draws of a task's attacks, shared by its levels; of a thousand people 2 MB each.
# The 21st makes the oldest go.
@lru_cache(maxsize=20)
def _draws(people: tuple[People, ...], seed: int, *names: str) -> tuple[Drawn, ...]:
    return draw(people, _stream(seed, *names), SHUFFLES)


@dataclass(frozen=True, eq=False, slots=True)
class _CohortSearch:
    """The mated probes of one search, and the cohorts of people that they count in."""

    mated: Ints  # (p,) probes that have a mate.
    mate: Ints  # (p,) their mates' places in the gallery.
    candidates: Floats  # (G, cohorts) 1 for a candidate of the cohort, else 0.
    probe: Ints  # (t,) place among `mated` of each trial.
    cohort: Ints  # (t,) cohort of each trial.


@dataclass(frozen=True, eq=False, slots=True)
class _CohortTrials:
    """All trials of a task in its cohorts: the same for every attack."""

    searches: tuple[_CohortSearch, ...]
    cohort: Ints  # (T,) cohort of each trial, search after search.
    chance: Floats  # (T,) chance of rank 1.
    place: Ints  # (T,) place in `counts`, flattened.
    counts: Floats  # (cohorts, C) trials by cohort and cluster.


def _cohort_hits(
    searches: Sequence[linkability.Search], setup: SensedTask
) -> dict[str, dict[str, float]]:
    """Return rank 1 of each cohort: only its people are probes and candidates."""
    trials = _cohort_trials(setup)
    hit = np.concatenate(
        [
            _trial_hits(search, part)
            for search, part in zip(searches, trials.searches, strict=True)
        ]
    )
    n_places, shape = trials.counts.size, trials.counts.shape
    sums = cluster_sums(values=hit, cluster=trials.place, n_clusters=n_places)
    estimates = ratio_estimates(
        numerator=sums.reshape(shape),
        denominator=trials.counts,
        weights=setup.weights,
        is_share=[True] * len(trials.counts),
    )
    names = (WITHOUT_GROUPS, WITHOUT_FROZEN)
    cohorts = {}
    for number, (name, estimate) in enumerate(zip(names, estimates, strict=True)):
        in_cohort = trials.cohort == number
        chance, has_trials = trials.chance[in_cohort], bool(in_cohort.any())
        p_rank1 = mean_chance = np.nan
        if has_trials:
            mean_chance = float(chance.mean())
            p_rank1 = linkability.rank1_p(hits=hit[in_cohort], chance=chance)
        cohorts[name] = {
            "rank1": estimate.value,
            "ci_low": estimate.ci_low,
            "ci_high": estimate.ci_high,
            "n_clusters": estimate.n,
            "chance": mean_chance,
            "p_rank1": p_rank1,
            "n_mated": int(in_cohort.sum()),
        }
    return cohorts


def _trial_hits(search: linkability.Search, part: _CohortSearch) -> Floats:
    """Return the expected hit of each trial of a search, (t,)."""
    mate_scores = search.scores[part.mated, part.mate][:, None]
    counts = np.empty((2, part.mated.size, 2), np.float32)
    for first in range(0, part.mated.size, _AT_ONCE):
        rows = slice(first, first + _AT_ONCE)
        scores, own = search.scores[part.mated[rows]], mate_scores[rows]
        # How many candidates of each cohort score above the mate, and as high: exact
        # in single precision.
        for place, is_counted in enumerate((scores > own, scores == own)):
            counts[place, rows] = is_counted.astype(np.float32) @ part.candidates
    above, tied = counts[:, part.probe, part.cohort]
    return expected_hit(above, tied.astype(np.float64))


# Of the newest four tasks of this process.
@lru_cache(maxsize=4)
def _cohort_trials(setup: SensedTask) -> _CohortTrials:
    """Return the trials of a task's cohorts: without groups, and without frozen."""
    task_windows = setup.task_windows
    is_member = np.stack([task_windows.alone, task_windows.moving])  # (cohorts, K)
    searches, chances, clusters = [], [], []
    for _, pairing in sorted(setup.searches.items()):
        mated = np.flatnonzero(pairing.mate >= 0)
        mate, person = (
            pairing.mate[mated],
            task_windows.probe.person[pairing.probe[mated]],
        )
        candidates = is_member[:, task_windows.gallery.person[pairing.gallery]].T
        probe, cohort = np.nonzero(is_member[:, person].T & candidates[mate])
        searches.append(
            _CohortSearch(mated, mate, candidates.astype(np.float32), probe, cohort)
        )
        chances.append(1.0 / candidates.sum(axis=0)[cohort])
        clusters.append(setup.cluster[person[probe]])
    cohort = np.concatenate([search.cohort for search in searches])
    n_cohorts, n_clusters = len(is_member), setup.weights.shape[1]
    place = cohort * n_clusters + np.concatenate(clusters)
    counts = np.bincount(place, minlength=n_cohorts * n_clusters).astype(np.float64)
    return _CohortTrials(
        searches=tuple(searches),
        cohort=cohort,
        chance=np.concatenate(chances),
        place=place,
        counts=counts.reshape(n_cohorts, n_clusters),
    )


def fit_calibration(
    scored_searches: Sequence[tuple[Floats, Pairing]],
) -> linkability.Calibration | None:
    """Return the calibration on people neither attacked nor learnt from.

    None without pairs of mates, or without other pairs.
    """
    mated, non_mated = [np.zeros(0)], [np.zeros(0)]
    for scores, pairing in scored_searches:
        is_mate = pairing.mate[:, None] == np.arange(scores.shape[1])
        mated.append(scores[is_mate])
        non_mated.append(scores[~is_mate])
    first, second = np.concatenate(mated), np.concatenate(non_mated)
    if not (first.size and second.size):
        return None
    return linkability.fit_calibration(mated=first, non_mated=second)


def fit_score_scale(
    scored_searches: Sequence[tuple[Floats, Pairing]],
) -> float | None:
    """Return the factor that turns scores of an open gallery into log ratios.

    Fitted on the same people as `fit_calibration`, within the gallery of each: the
    scale must separate a mate from the candidates nearby, not from those at the other
    end of the scene. None without mates.
    """
    if not any(pairing.has_mates for _, pairing in scored_searches):
        return None
    scores, pairings = zip(*scored_searches, strict=True)
    return linkability.fit_scale(scores, [pairing.mate for pairing in pairings])


def match_pairs(scores: Floats, *, scale: float, mate_rate: float) -> Floats:
    """Return the probability of each pair of an open search, matched at once, (P, G).

    The expected share of probes with a mate is `mate_rate`, as among other people. An
    adversary that wants the most correct links names the most probable candidate of
    every probe.
    """
    return linkability.open_matches(scale * scores, n_links=mate_rate * len(scores))
