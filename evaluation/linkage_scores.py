"""What is read off the scores of a linkage attack: the scorecard, with and without confounders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isac_track.intervals import cluster_sums, ratio_estimate
from isac_track.linkability import (
    Calibration,
    Search,
    fit_calibration,
    rank1,
    rank1_p,
)
from isac_track.scorecard import Scorecard, scorecard

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.random import Generator

    from evaluation.linkage_ground import Ground, Half, Part
    from isac_track.intervals import Estimate
    from isac_track.types import Bools, Floats, Ints

WITHOUT_GROUPS, WITHOUT_FROZEN = "without_groups", "without_frozen"
"""Without people who walk in a group, and move alike; without nearly frozen annotations."""
SHUFFLES, AUDIT_SHUFFLES = 999, 4999
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
    card: Scorecard
    parts: Mapping[str, Cohort]
    """By cohort, without the confounders; none for a control."""


def read_off(
    scores: Mapping[int, Floats],
    *,
    ground: Ground,
    calibration: Mapping[int, Calibration],
    no_match: Mapping[int, float],
    rng: Generator,
    cohorts: bool,
    n_shuffles: int = SHUFFLES,
) -> Linked:
    """Return the scorecard of an attack, and rank 1 without confounders.

    Parameters
    ----------
    scores : mapping
        (P, G) of every search, by its number.
    ground : Ground
    calibration, no_match : mapping
        By fold; none where there is nobody to calibrate on, or nobody may stay alone.
    rng : Generator
    cohorts : bool
        Whether to leave confounders out as well.
    n_shuffles : int, optional
    """
    sessions = ground.sessions
    part_of = {number: part for half in ground.halves for number, part in half.searches}
    numbers = sorted(scores)
    probe_person = [sessions.probe.person[part_of[number].probe] for number in numbers]
    gallery_person = [sessions.gallery.person[part_of[number].gallery] for number in numbers]
    searches = [
        Search(
            scores=scores[number],
            mate=part_of[number].mate,
            probe_cluster=ground.cluster[probe],
            gallery_cluster=ground.cluster[gallery],
            scale=int(sessions.fold[number]),
        )
        for number, probe, gallery in zip(numbers, probe_person, gallery_person, strict=True)
    ]
    scales = {search.scale for search in searches}
    card = scorecard(
        searches,
        weights=ground.weights,
        calibration=calibration if scales <= set(calibration) else None,
        no_match_score=no_match if scales <= set(no_match) else None,
        rng=rng,
        n_shuffles=n_shuffles,
    )
    parts = {}
    if cohorts:
        parts = {
            name: _cohort(
                searches,
                [kept[one] for one in probe_person],
                [kept[one] for one in gallery_person],
                weights=ground.weights,
            )
            for name, kept in (
                (WITHOUT_GROUPS, sessions.alone),
                (WITHOUT_FROZEN, sessions.moving),
            )
        }
    return Linked(
        searches=tuple(searches),
        probe_person=tuple(probe_person),
        gallery_person=tuple(gallery_person),
        calibration=calibration,
        card=card,
        parts=parts,
    )


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
        place = np.cumsum(gallery) - 1
        mate = np.where((search.mate >= 0) & gallery[search.mate], place[search.mate], -1)[probe]
        if not (mate >= 0).any():
            continue
        hit = rank1(scores=search.scores[probe][:, gallery], mate=mate)
        has = mate >= 0
        hits.append(hit[has])
        chances.append(np.full(int(has.sum()), 1.0 / gallery.sum()))
        clusters.append(search.probe_cluster[probe][has])
    hit, chance = (np.concatenate([*parts, np.zeros(0)]) for parts in (hits, chances))
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


def calibrated(found: Sequence[tuple[Floats, Part]]) -> Calibration | None:
    """Return the calibration on people who are neither attacked nor learnt from."""
    mated, non_mated = [np.zeros(0)], [np.zeros(0)]
    for scores, part in found:
        is_mate = np.zeros(scores.shape, dtype=bool)
        has = np.flatnonzero(part.mate >= 0)
        is_mate[has, part.mate[has]] = True
        mated.append(scores[is_mate])
        non_mated.append(scores[~is_mate])
    first, second = np.concatenate(mated), np.concatenate(non_mated)
    if not (first.size and second.size):
        return None
    return fit_calibration(mated=first, non_mated=second)


def no_match_score(calibration: Calibration, half: Half) -> float:
    """Return the score at which a pair is as likely mates as not, among so many candidates."""
    n_mated = sum(int((part.mate >= 0).sum()) for part in half.calibrates)
    n_pairs = sum(part.probe.size * part.gallery.size for part in half.calibrates)
    needed = float(np.log((n_pairs - n_mated) / n_mated))
    if calibration.slope <= 0.0:  # scores tell nothing, and mates are rare: nobody is linked
        return _NEVER
    return min((needed - calibration.intercept) / calibration.slope, _NEVER)
