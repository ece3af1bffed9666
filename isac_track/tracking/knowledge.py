"""How much of people's time an adversary knows from tracks that break and swap.

The adversary knows to whom each track belongs: to the person who has most of its
samples. Where the track holds another person, the adversary is wrong.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from isac_track.patrols.estimators import ESTIMATORS, estimate_positions
from isac_track.patrols.fleet_logs import Log
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.reports import Reports
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.metrics import track_owners
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Bools, Floats, Ints, squared_lengths

TRACK_ESTIMATORS: Final = ("smooth", "radial", "radial_smooth", "interpolate")
"""Estimators of an adversary with tracks; those for logs with long gaps know less."""


def known_instants(
    patrol: Patrol,
    shared: SharedTracks,
    *,
    guesses: Floats,
    epsilon_m: float,
    estimators: Sequence[str] = ESTIMATORS,
) -> Bools:
    """Return which instants of the patrol's grid are known, (J, G), by J estimators.

    An instant of a person is estimated by the nearest in time of the tracks that belong
    to the person. People without a track are at their guess from the map: `guesses`,
    (N, 2) m, of `guesses_from_map`. An instant is known if the estimate lies within
    `epsilon_m` of the truth.
    """
    grid = patrol.grid
    fallback_xy = np.repeat(guesses, np.diff(grid.offsets), axis=0)
    row, track = _nearest_tracks(patrol, shared)
    offsets = np.searchsorted(track, np.arange(len(shared.release) + 1))
    release = shared.release
    reports = Reports(release.xy, shared.variance, release.cov).floored()
    log = Log(
        sample=np.arange(shared.scan.size),
        t=release.t,
        xy=reports.xy,
        variance=reports.variance,
        offsets=release.offsets,
        cov=reports.cov,
    )
    known = []
    for estimator in estimators:
        estimate = fallback_xy.copy()
        if row.size:
            estimate[row] = estimate_positions(
                log,
                t=grid.t[row],
                offsets=offsets,
                estimator=estimator,
                fallback_xy=fallback_xy[row],
            )
        known.append(squared_lengths(estimate - grid.xy) < epsilon_m**2)
    return np.stack(known)


def _nearest_tracks(patrol: Patrol, shared: SharedTracks) -> tuple[Ints, Ints]:
    """Return the instants of people who own a track, and the nearest track of each.

    Both are (I,), in the order of tracks, then of instants.
    """
    owner, grid = track_owners(shared), patrol.grid
    t, offsets = shared.release.t, shared.release.offsets
    start_s, end_s = t[offsets[:-1]], t[offsets[1:] - 1]
    rows, tracks = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for person in np.unique(owner[owner != CLUTTER]).tolist():
        owned = np.flatnonzero(owner == person)
        row = np.arange(grid.offsets[person], grid.offsets[person + 1])
        now_s = grid.t[row][:, None]
        away_s = np.maximum(
            np.maximum(start_s[owned] - now_s, now_s - end_s[owned]), 0.0
        )
        rows.append(row)
        tracks.append(owned[away_s.argmin(axis=1)])
    row, track = np.concatenate(rows), np.concatenate(tracks)
    order = np.lexsort((row, track))
    return row[order], track[order]
