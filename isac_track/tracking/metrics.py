"""Metrics of the tracking field: GOSPA, OSPA, purity, switches, fragments.

References
----------
Rahmathullah, Garcia-Fernandez, Svensson, "Generalized optimal sub-pattern assignment
metric", FUSION 2017. Schuhmacher, Vo, Vo, "A consistent metric for performance
evaluation of multi-object filters", IEEE Trans. Signal Processing 56(8), 2008.
Bernardin, Stiefelhagen, "Evaluating multiple object tracking
performance: the CLEAR MOT metrics", EURASIP J. Image and Video Processing, 2008.
"""

from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

import numpy as np

from isac_track.patrols.patrol import Patrol
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.tracking.trackers import Tracked
from isac_track.types import Bools, Floats, Ints, positive, squared_lengths


@dataclass(frozen=True, slots=True)
class Gospa:
    """GOSPA of two sets of positions with alpha = 2, and its parts.

    ``distance^p = localisation + c^p / 2 * (missed + false)``, in m^p.
    """

    distance: float  # m
    localisation: float  # m^p, sum over matched pairs.
    matched: int
    missed: int
    false: int


def gospa(truth: Floats, tracks: Floats, *, cutoff_m: float, p: float = 2.0) -> Gospa:
    """Return the GOSPA of tracks, (B, 2) m, against the truth, (A, 2) m.

    A pair at the cut-off or beyond counts as a miss and a false track. ValueError if
    the cut-off is not positive or p is below 1.
    """
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - heavy to import

    positive("cutoff_m", cutoff_m)
    if not p >= 1.0:
        raise ValueError(f"p must be 1 or more, got {p}")
    limit = cutoff_m**p
    gap = truth[:, None] - tracks[None]
    cost = np.minimum(squared_lengths(gap) ** (p / 2.0), limit)
    rows, columns = linear_sum_assignment(cost)
    pairs = cost[rows, columns]
    matched = int((pairs < limit).sum())
    localisation = float(pairs[pairs < limit].sum())
    missed, false = len(truth) - matched, len(tracks) - matched
    total = localisation + limit / 2.0 * (missed + false)
    return Gospa(total ** (1.0 / p), localisation, matched, missed, false)


def ospa(truth: Floats, tracks: Floats, *, cutoff_m: float, p: float = 2.0) -> float:
    """Return the OSPA of tracks, (B, 2) m, against the truth, (A, 2) m, in m.

    It is the p-mean over the larger of both sets, where every position without a
    partner within the cut-off counts as the cut-off; 0 for two empty sets. ValueError
    as in `gospa`.
    """
    parts = gospa(truth, tracks, cutoff_m=cutoff_m, p=p)
    # The best assignment of GOSPA is that of OSPA: both minimise truncated costs.
    alone = max(parts.missed, parts.false)
    n = parts.matched + alone
    total = parts.localisation + cutoff_m**p * alone
    return float((total / n) ** (1.0 / p)) if n else 0.0


@dataclass(frozen=True, eq=False, slots=True)
class GospaScans:
    """GOSPA of each of K scans with p = 2, and its parts."""

    distance: Floats  # (K,) m
    localisation: Floats  # (K,) m^2
    matched: Ints  # (K,)
    missed: Ints  # (K,)
    false: Ints  # (K,)

    def ospa(self, *, cutoff_m: float) -> Floats:
        """Return the OSPA of each scan with the same cut-off, (K,) m; see `ospa`."""
        alone = np.maximum(self.missed, self.false)
        total = self.localisation + cutoff_m**2 * alone
        return np.asarray(np.sqrt(total / np.maximum(self.matched + alone, 1)))


def gospa_scans(patrol: Patrol, tracked: Tracked, *, cutoff_m: float) -> GospaScans:
    """Return the GOSPA of the reported tracks at each scan of a patrol."""
    n_scans = int(patrol.scan.max()) + 1
    order = np.argsort(patrol.scan, kind="stable")
    truth = np.split(patrol.people.xy[order], np.cumsum(np.bincount(patrol.scan))[:-1])
    row = np.flatnonzero(tracked.is_reported)
    row = row[np.argsort(tracked.scan[row], kind="stable")]
    counts = np.bincount(tracked.scan[row], minlength=n_scans)
    reported = np.split(tracked.xy[row], np.cumsum(counts)[:-1])
    scans = [
        gospa(people, tracks, cutoff_m=cutoff_m)
        for people, tracks in zip(truth, reported, strict=True)
    ]
    return GospaScans(
        distance=np.array([scan.distance for scan in scans]),
        localisation=np.array([scan.localisation for scan in scans]),
        matched=np.array([scan.matched for scan in scans]),
        missed=np.array([scan.missed for scan in scans]),
        false=np.array([scan.false for scan in scans]),
    )


def track_owners(shared: SharedTracks) -> Ints:
    """Return the person with a plurality of samples of each track, (N,), or `CLUTTER`.

    That is most samples, and need not be more than half. Of people with equally many it
    is the person of the lower row. A track with as many samples of clutter belongs to
    nobody.
    """
    n_tracks = len(shared.release)
    if not n_tracks:
        return np.zeros(0, dtype=np.int64)
    track = np.repeat(np.arange(n_tracks), np.diff(shared.release.offsets))
    pairs, count = np.unique(
        np.stack([track, shared.person]), axis=1, return_counts=True
    )
    order = np.lexsort((pairs[1], -count, pairs[0]))
    _, first = np.unique(pairs[0][order], return_index=True)
    return np.asarray(pairs[1][order][first])


def pure_samples(shared: SharedTracks) -> Bools:
    """Return which samples are of the person who owns their track, (S,).

    Purity is their share. Clutter is never pure.
    """
    owner = np.repeat(track_owners(shared), np.diff(shared.release.offsets))
    return np.asarray((shared.person == owner) & (owner != CLUTTER))


def identity_switches(shared: SharedTracks) -> Ints:
    """Return the scans at which a person's track changes, (W,), in time for each person.

    A person follows a track until a scan at which only other tracks have samples of the
    person. That is a switch, to the track of the lowest number. `jpda` may give a
    detection to several tracks: no switch while the track followed is among them.

    IDSW of CLEAR-MOT matches people and tracks at each scan by distance, a track for
    each person. Here the person behind each sample is known: no distance ends a match,
    and a person may keep a track that another person follows, too.
    """
    sizes = np.diff(shared.release.offsets)
    track = np.repeat(np.arange(sizes.size), sizes)
    is_person = shared.person != CLUTTER
    columns = (column[is_person] for column in (shared.person, shared.scan, track))
    samples = sorted(zip(*(column.tolist() for column in columns), strict=True))
    followed: dict[int, int] = {}
    switches = []
    for (person, scan), samples_at_scan in groupby(samples, key=itemgetter(0, 1)):
        tracks = [track for _, _, track in samples_at_scan]
        if followed.setdefault(person, tracks[0]) not in tracks:
            followed[person] = tracks[0]
            switches.append(scan)
    return np.array(switches, dtype=np.int64)


def fragment_starts(shared: SharedTracks) -> Ints:
    """Return the first scans of tracks whose owner has an earlier track, (F,)."""
    owner = track_owners(shared)
    first = shared.scan[shared.release.offsets[:-1]]
    row = np.flatnonzero(owner != CLUTTER)
    row = row[np.lexsort((first[row], owner[row]))]
    is_further = np.diff(owner[row], prepend=CLUTTER) == 0
    return np.asarray(first[row[is_further]])
