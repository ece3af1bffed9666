"""What is read off the scores of a linkage attack: the scorecard, with and without confounders."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isac_track.intervals import Estimate, cluster_sums, ratio_estimate
from isac_track.linkability import (
    Calibration,
    Scorecard,
    Search,
    fit_calibration,
    rank1,
    rank1_p,
    scorecard,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.random import Generator

    from evaluation.cells.link_setup import Pairing, SensedSessions
    from isac_track.types import Bools, Floats, Ints

WITHOUT_GROUPS, WITHOUT_FROZEN = "without_groups", "without_frozen"
"""Without people who walk in a group, and move alike; without nearly frozen annotations."""
SHUFFLES, AUDIT_SHUFFLES = 999, 1999
"""Of the permutation tests; the audit's must be able to reject at a hundredth over six of them."""
_NEVER = 1e300
"""A score that no pair reaches."""


@dataclass(frozen=True, eq=False, slots=True)
class Cohort:
    """Rank 1 among some of the people: probes and candidates are theirs alone."""

    rank1: Estimate
    chance: float
    p_rank1: float
    n_mated: int


@dataclass(frozen=True, eq=False, slots=True)
class Linked:
    """Outcome of one cell: raw scores, and all that is read off them."""

    searches: tuple[Search, ...]
    probe_person: tuple[Ints, ...]
    """Person of each probe, search by search."""
    gallery_person: tuple[Ints, ...]
    calibration: Mapping[int, Calibration]
    """By fold."""
    scored: Scorecard
    cohorts: Mapping[str, Cohort]
    """By cohort, without the confounders; none for a control."""
    is_control: bool
    is_assigned: bool
    """Whether probes can be left alone at a known cost, or need not be."""


def read_off(
    scores: Mapping[int, Floats],
    *,
    known: SensedSessions,
    calibration: Mapping[int, Calibration],
    no_match: Mapping[int, float] | None,
    rng: Generator,
    is_control: bool,
    n_shuffles: int = SHUFFLES,
) -> Linked:
    """Return the scorecard of an attack, and rank 1 without confounders.

    Parameters
    ----------
    scores : mapping
        (P, G) of every search, by its number.
    known : SensedSessions
    calibration : mapping
        By fold; none where there is nobody to calibrate on.
    no_match : mapping or None
        By search: what a pair must score to be linked. None in a closed gallery, where everybody
        is; a search that is not in it has no assignment.
    rng : Generator
    is_control : bool
        Whether it is none of the attacks, of which confounders are left out as well.
    n_shuffles : int, optional
    """
    sessions = known.sessions
    pairing_of = {number: pairing for half in known.halves for number, pairing in half.searches}
    numbers = sorted(scores)
    probe_person = [sessions.probe.person[pairing_of[number].probe] for number in numbers]
    gallery_person = [sessions.gallery.person[pairing_of[number].gallery] for number in numbers]
    searches = [
        Search(
            scores=scores[number],
            mate=pairing_of[number].mate,
            probe_cluster=known.cluster[probe],
            gallery_cluster=known.cluster[gallery],
            scale=int(sessions.fold[number]),
        )
        for number, probe, gallery in zip(numbers, probe_person, gallery_person, strict=True)
    ]
    scales = {search.scale for search in searches}
    needed = None
    if no_match is not None and set(numbers) <= set(no_match):
        needed = [no_match[number] for number in numbers]
    scored = scorecard(
        searches,
        weights=known.weights,
        calibration=calibration if scales <= set(calibration) else None,
        no_match_score=needed,
        rng=rng,
        n_shuffles=n_shuffles,
    )
    is_assigned = no_match is None or needed is not None
    if not is_assigned:
        scored = _without_assignment(scored)
    apart = {}
    if not is_control:
        apart = {
            name: _cohort(
                searches,
                [among[one] for one in probe_person],
                [among[one] for one in gallery_person],
                weights=known.weights,
            )
            for name, among in (
                (WITHOUT_GROUPS, sessions.alone),
                (WITHOUT_FROZEN, sessions.moving),
            )
        }
    return Linked(
        searches=tuple(searches),
        probe_person=tuple(probe_person),
        gallery_person=tuple(gallery_person),
        calibration=calibration,
        scored=scored,
        cohorts=apart,
        is_control=is_control,
        is_assigned=is_assigned,
    )


def _without_assignment(scored: Scorecard) -> Scorecard:
    """Return the scored of an open gallery without a cost for leaving somebody alone."""
    estimates = dict(scored.estimates)
    for name in ("rank1_assigned", "false_link_rate"):
        if name in estimates:
            unknown = np.full_like(estimates[name].replicates, np.nan)
            estimates[name] = Estimate(np.nan, np.nan, np.nan, estimates[name].n, unknown)
    return replace(scored, estimates=estimates)


def _cohort(
    searches: Sequence[Search],
    probes: Sequence[Bools],
    galleries: Sequence[Bools],
    *,
    weights: Floats,
) -> Cohort:
    """Return rank 1 where only some people are probes and candidates."""
    hits, chances, clusters = [], [], []
    for search, probe, gallery in zip(searches, probes, galleries, strict=True):
        has = np.flatnonzero(probe & (search.mate >= 0) & gallery[search.mate])
        if not has.size:
            continue
        place = np.cumsum(gallery) - 1
        columns = np.flatnonzero(gallery)
        hits.append(
            rank1(scores=search.scores[has[:, None], columns], mate=place[search.mate[has]])
        )
        chances.append(np.full(has.size, 1.0 / columns.size))
        clusters.append(search.probe_cluster[has])
    hit, chance = (np.concatenate([*some, np.zeros(0)]) for some in (hits, chances))
    cluster = np.concatenate([*clusters, np.zeros(0, dtype=np.int64)])
    sums = [
        cluster_sums(values=values, cluster=cluster, n_clusters=weights.shape[1])
        for values in (hit, np.ones_like(hit))
    ]
    return Cohort(
        rank1=ratio_estimate(
            numerator=sums[0], denominator=sums[1], weights=weights, is_share=True
        ),
        chance=float(chance.mean()) if chance.size else float("nan"),
        p_rank1=rank1_p(hits=hit, chance=chance) if chance.size else float("nan"),
        n_mated=hit.size,
    )


def calibrated(found: Sequence[tuple[Floats, Pairing]]) -> Calibration | None:
    """Return the calibration on people who are neither attacked nor learnt from."""
    mated, non_mated = [np.zeros(0)], [np.zeros(0)]
    for scores, pairing in found:
        is_mate = np.zeros(scores.shape, dtype=bool)
        has = np.flatnonzero(pairing.mate >= 0)
        is_mate[has, pairing.mate[has]] = True
        mated.append(scores[is_mate])
        non_mated.append(scores[~is_mate])
    first, second = np.concatenate(mated), np.concatenate(non_mated)
    if not (first.size and second.size):
        return None
    return fit_calibration(mated=first, non_mated=second)


def no_match_score(calibration: Calibration, pairing: Pairing, *, mate_rate: float) -> float:
    """Return what a pair of a search must score to be linked rather than left alone.

    Of the matchings of P probes with G candidates the most probable one is sought, where a probe
    has a mate with probability r, anybody as likely as another. Linking one pair more then takes a
    likelihood ratio of (1 - r) / r times the candidates that are nobody's mate, G - r P.

    Parameters
    ----------
    calibration : Calibration
    pairing : Pairing
        The search.
    mate_rate : float
        r, of other people.
    """
    if calibration.slope <= 0.0:  # scores tell nothing: nobody is linked
        return _NEVER
    nobodys = max(pairing.gallery.size - mate_rate * pairing.probe.size + 1.0, 1.0)
    needed = float(np.log((1.0 - mate_rate) / mate_rate * nobodys))
    return float(np.clip((needed - calibration.intercept) / calibration.slope, -_NEVER, _NEVER))
