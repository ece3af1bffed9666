"""HOTA: how well tracks detect people and hold them, in one number.

References
----------
Luiten et al., "HOTA: a higher order metric for evaluating multi-object tracking",
International Journal of Computer Vision 129, 2021.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from isac_track.patrols.patrol import Patrol
from isac_track.tracking.trackers import Tracked
from isac_track.types import Floats, Ints, positive, squared_lengths

LEVELS: Final = np.arange(1, 20) / 20.0
"""Least similarities of a match, alpha of the paper: 0.05 to 0.95."""
CUTOFF_M: Final = 1.0  # Distance of similarity 0.


@dataclass(frozen=True, eq=False, slots=True)
class Places:
    """Positions of N people or tracks, M in all, each at a scan."""

    scan: Ints  # (M,)
    number: Ints  # (M,) person or track, from 0; at most one position a scan.
    xy: Floats  # (M, 2) m


@dataclass(frozen=True, eq=False, slots=True)
class HotaScans:
    """Parts of HOTA at each of K scans, for the A least similarities of `LEVELS`."""

    association: Floats  # (K, A) sum over matches of how well their tracks agree.
    # (K, A) matches, people without a match and tracks without one: TP + FN + FP.
    n_union: Floats

    @property
    def hota(self) -> float:
        """HOTA of all scans, 0 to 1."""
        return float(hota_from_sums(self.association.sum(0), self.n_union.sum(0)))


def hota_from_sums(association: Floats, n_union: Floats) -> Floats:
    """Return HOTA of parts that are summed over scans, (..., A) -> (...).

    At each level it is sqrt(DetA AssA) = sqrt(association / n_union), since the number
    of matches cancels. HOTA is the mean over levels, and nan without people and tracks.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(association / n_union).mean(axis=-1))


@dataclass(frozen=True, eq=False, slots=True)
class _Candidates:
    """Possible matches: a person and a track with some similarity at a scan, C in all."""

    scan: Ints  # (C,)
    person: Ints  # (C,)
    track: Ints  # (C,)
    similarity: Floats  # (C,)
    # (C,) share of the similarities of person and track at the scan that is the pair's.
    overlap: Floats


@dataclass(frozen=True, eq=False, slots=True)
class _Pairs:
    """P pairs of a person and a track that are candidates at some scan."""

    candidate_pair: Ints  # (C,) pair of each candidate.
    total_size: Ints  # (P,) positions of the person and positions of the track, summed.
    agreement: Floats  # (P,) overlap of both over all scans, over their union.


def hota_scans(patrol: Patrol, tracked: Tracked) -> HotaScans:
    """Return the parts of HOTA of the reported tracks at each scan of a patrol."""
    people, row = patrol.people, np.flatnonzero(tracked.is_reported)
    owner = np.repeat(np.arange(people.offsets.size - 1), np.diff(people.offsets))
    return hota_parts(
        Places(patrol.scan, owner, people.xy),
        Places(tracked.scan[row], tracked.track[row], tracked.xy[row]),
        n_scans=int(patrol.scan.max()) + 1,
    )


def hota_parts(
    people: Places, tracks: Places, *, n_scans: int, cutoff_m: float = CUTOFF_M
) -> HotaScans:
    """Return the parts of HOTA of tracks against the true places of people.

    The similarity is 1 less the distance over the cut-off, at least 0. Matches of a
    scan have the largest sum of similarity times the agreement of the whole tracks
    (eq. 9 of the paper, as its authors compute it). ValueError if the cut-off is not
    positive.
    """
    positive("cutoff_m", cutoff_m)
    candidates = _candidates(people, tracks, n_scans=n_scans, cutoff_m=cutoff_m)
    pairs = _pairs(candidates, people, tracks)
    match = _matches(candidates, pairs.agreement[pairs.candidate_pair])
    n_present = np.bincount(people.scan, minlength=n_scans)
    n_present = n_present + np.bincount(tracks.scan, minlength=n_scans)
    association, n_union = np.zeros((2, n_scans, LEVELS.size))
    for column, level in enumerate(LEVELS):
        is_similar = candidates.similarity[match] >= level - np.finfo(float).eps
        similar = match[is_similar]
        scan = candidates.scan[similar]
        accuracy = _match_accuracy(pairs, pairs.candidate_pair[similar])
        association[:, column] = np.bincount(scan, accuracy, minlength=n_scans)
        # A match is a person and a track that are present, and counts once.
        n_union[:, column] = n_present - np.bincount(scan, minlength=n_scans)
    return HotaScans(association, n_union)


def _pairs(candidates: _Candidates, people: Places, tracks: Places) -> _Pairs:
    """Return the pairs of candidates, and how well person and track agree (eq. 9)."""
    n_tracks = int(tracks.number.max(initial=-1)) + 1
    key = candidates.person * n_tracks + candidates.track
    pair, candidate_pair = np.unique(key, return_inverse=True)
    person, track = pair // max(n_tracks, 1), pair % max(n_tracks, 1)
    total_size = _sizes(people)[person] + _sizes(tracks)[track]
    overlap = np.bincount(
        candidate_pair, weights=candidates.overlap, minlength=pair.size
    )
    return _Pairs(candidate_pair, total_size, overlap / (total_size - overlap))


def _match_accuracy(pairs: _Pairs, match_pair: Ints) -> Floats:
    """Return the association accuracy A(c) of matches by their pairs, (M,).

    It is TPA / (TPA + FNA + FPA): matches of the pair over the union of both tracks.
    """
    n_matches = np.bincount(match_pair, minlength=pairs.total_size.size)
    accuracy = n_matches / (pairs.total_size - n_matches)
    return np.asarray(accuracy[match_pair])


def _sizes(places: Places) -> Ints:
    """Return the number of positions of each person or track, (N,)."""
    return np.bincount(places.number, minlength=1)


def _candidates(
    people: Places, tracks: Places, *, n_scans: int, cutoff_m: float
) -> _Candidates:
    """Return the pairs nearer than the cut-off, scan by scan."""
    rows = [_rows_by_scan(places, n_scans) for places in (people, tracks)]
    parts = []
    for scan, (person, track) in enumerate(zip(*rows, strict=True)):
        gap = people.xy[person][:, None] - tracks.xy[track][None]
        similarity = np.maximum(0.0, 1.0 - np.sqrt(squared_lengths(gap)) / cutoff_m)
        a, b = np.nonzero(similarity)
        shared = similarity[a, b]
        union = similarity.sum(axis=1)[a] + similarity.sum(axis=0)[b] - shared
        parts.append(
            (
                np.full(a.size, scan),
                people.number[person[a]],
                tracks.number[track[b]],
                shared,
                shared / union,
            )
        )
    return _Candidates(
        *(np.concatenate(columns) for columns in zip(*parts, strict=True))
    )


def _rows_by_scan(places: Places, n_scans: int) -> list[Ints]:
    """Return the rows of each scan."""
    order = np.argsort(places.scan, kind="stable")
    counts = np.bincount(places.scan, minlength=n_scans)
    return np.split(order, np.cumsum(counts)[:-1])


def _matches(candidates: _Candidates, agreement: Floats) -> Ints:
    """Return the candidates that are the matches of their scan."""
    score = agreement * candidates.similarity
    begins = np.flatnonzero(np.diff(candidates.scan)) + 1
    matches = [np.zeros(0, dtype=np.int64)]
    for rows in np.split(np.arange(score.size), begins):
        people, person = np.unique(candidates.person[rows], return_inverse=True)
        tracks, track = np.unique(candidates.track[rows], return_inverse=True)
        scores = np.zeros((people.size, tracks.size))
        scores[person, track] = score[rows]
        number = np.full(scores.shape, -1)
        number[person, track] = rows
        best = number[linear_sum_assignment(scores, maximize=True)]
        matches.append(best[best >= 0])
    return np.concatenate(matches)
