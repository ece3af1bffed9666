"""Answers of policies from tracks that break and swap: logs and forecasts.

A policy sees the tracks that are alive at a query as it sees people on other patrols: a
track that holds two people is one of them to it, and a track of nobody is a person. Its
answers name samples of tracks. Whom they are about is the truth behind each sample.
"""

from dataclasses import dataclass, replace

import numpy as np

from isac_track.measurement import axis_share
from isac_track.noise import UNKNOWN_VARIANCE_M2
from isac_track.patrols.answers import Disclosure
from isac_track.patrols.knowledge import nearest_samples
from isac_track.patrols.network import Network
from isac_track.patrols.patrol import Patrol, Presences
from isac_track.patrols.utility import answer_forecasts
from isac_track.protocols import Mechanism, Predictor
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.tracking.utility import (
    LiveTracks,
    TrackForecasts,
    forecast_live_tracks,
    live_tracks,
)
from isac_track.types import Bools, ErrorLaw, Floats, Ints, Release, Sensed, Tracks


@dataclass(frozen=True, eq=False, slots=True)
class TrackNetwork:
    """A network that answers from tracks, as policies see it: a track is a person."""

    patrol: Patrol  # The true one.
    shared: SharedTracks
    live: LiveTracks
    network: Network  # Its presences are those of `live`.


def track_network(
    patrol: Patrol,
    raw: SharedTracks,
    shared: SharedTracks,
    *,
    mechanism: Mechanism,
    forecaster: Predictor,
    law: ErrorLaw,
    seed: int,
) -> TrackNetwork:
    """Return the network that answers from tracks.

    `raw` has the samples as its tracker got them, `shared` the same as a mechanism
    shares them. A policy may choose on either. `law` is that of the raw errors.
    """
    live, release = live_tracks(patrol, shared), raw.release
    sigma_m = np.sqrt(raw.variance / axis_share(law))
    names = tuple(map(str, range(len(release))))
    tracked_patrol = replace(
        patrol,
        people=Tracks(release.t, release.xy, release.offsets, names, names),
        scan=shared.scan,
        presences=Presences(live.query, live.track, live.sample),
    )
    raw_forecast, shared_forecast = (
        forecast_live_tracks(patrol, live, part.release, predictor=forecaster)
        for part in (raw, shared)
    )
    network = Network(
        patrol=tracked_patrol,
        mechanism=mechanism,
        forecaster=forecaster,
        sensed=Sensed(
            t=release.t,
            xy=release.xy,
            unit_error=np.zeros_like(release.xy),  # No policy reads errors.
            sigma_raw=sigma_m,
            information=np.ones_like(sigma_m),
            fid=np.ones_like(sigma_m),
            offsets=release.offsets,
            law=law,
        ),
        release=shared.release,
        raw_forecast=raw_forecast,
        shared_forecast=shared_forecast,
        seed=seed,
    )
    return TrackNetwork(patrol, shared, live, network)


def forecasts_by_robot(
    tracks: TrackNetwork, disclosure: Disclosure, *, predictor: Predictor
) -> list[TrackForecasts]:
    """Return the forecasts of each robot from its answers, or those of the network.

    The form of the answer decides which, as on other patrols (`answer_forecasts`).
    """
    live = tracks.live
    if not live.query.size:
        return []
    answers = answer_forecasts(tracks.network, disclosure, predictor)
    person = tracks.shared.person[live.sample]
    forecasts = []
    for robot in range(tracks.patrol.n_robots):
        rows = np.flatnonzero(answers.robot == robot)
        pairs = answers.presence[rows]
        forecasts.append(
            TrackForecasts(
                answers.mean[answers.row[rows]], live.query[pairs], person[pairs]
            )
        )
    return forecasts


def logged_tracks(
    tracks: TrackNetwork, disclosure: Disclosure, *, robots: Ints
) -> SharedTracks:
    """Return what the log of a fleet of `robots` has of each track.

    Samples are as they were sent (`Disclosure.sent_mask`). A state gives an entry at
    every scan until the next query, by its position and velocity; a later state
    replaces an earlier one. Tracks without an entry are left out.
    """
    if disclosure.form == "state":
        # By answer, not by sample: a track that coasts has one sample at many queries.
        is_ours = np.isin(disclosure.robot, robots)
        return _logged_states(tracks, np.unique(disclosure.presence[is_ours]))
    shared = tracks.shared
    row = np.flatnonzero(disclosure.sent_mask(tracks.network.patrol, robots=robots))
    track = np.searchsorted(shared.release.offsets, row, side="right") - 1
    return _logged(
        shared,
        track=track,
        scan=shared.scan[row],
        t=shared.release.t[row],
        xy=shared.release.xy[row],
        variance=shared.variance[row],
        person=shared.person[row],
    )


def _logged_states(tracks: TrackNetwork, rows: Ints) -> SharedTracks:
    """Return the entries of states that were sent, up to the last scan of a track.

    `rows`, (A,), are the rows of `tracks.live` that the states are of.
    """
    patrol, live, forecast = tracks.patrol, tracks.live, tracks.network.shared_forecast
    n_steps = int(np.diff(patrol.query_scan).max(initial=1))
    steps = np.arange(n_steps)
    scan = patrol.query_scan[live.query[rows]][:, None] + steps
    variance = np.full(scan.shape, UNKNOWN_VARIANCE_M2)
    if forecast.cov is not None:
        cov = forecast.cov[rows, :n_steps]
        variance = np.trace(cov, axis1=-2, axis2=-1) / 2.0
    goes_on = scan <= tracks.shared.last[live.track[rows]][:, None]
    pair, step = np.nonzero(goes_on)
    track, scan = live.track[rows][pair], scan[pair, step]
    # Of several states for a scan the latest has the fewest steps.
    order = np.lexsort((step, scan, track))
    is_latest = np.ones(order.size, dtype=bool)
    is_latest[1:] = (np.diff(track[order]) != 0) | (np.diff(scan[order]) != 0)
    order = order[is_latest]
    pair, step = pair[order], step[order]
    return _logged(
        tracks.shared,
        track=track[order],
        scan=scan[order],
        t=patrol.scan_s[scan[order]],
        xy=forecast.mean[rows[pair], step],
        variance=variance[pair, step],
        person=tracks.shared.person[live.sample[rows[pair]]],
    )


def _logged(
    shared: SharedTracks,
    *,
    track: Ints,
    scan: Ints,
    t: Floats,
    xy: Floats,
    variance: Floats,
    person: Ints,
) -> SharedTracks:
    """Return the tracks that L entries belong to; `track`, (L,), rises."""
    rows, first = np.unique(track, return_index=True)
    release = Release(
        t=t,
        xy=xy,
        sigma=None,
        offsets=np.append(first, track.size),
        pseudonym=tuple(shared.release.pseudonym[row] for row in rows.tolist()),
    )
    return SharedTracks(
        release=release,
        variance=variance,
        scan=scan,
        confirmed=shared.confirmed[rows],
        last=shared.last[rows],
        person=person,
    )


def disclosed_instants(tracks: TrackNetwork, sent: Bools) -> Bools:
    """Return which instants of the patrol's grid are disclosed, (G,).

    `sent`, (S,), are the samples of tracks that were sent. An instant is disclosed if
    one of them is of the person at the person's nearest scan.
    """
    patrol, shared = tracks.patrol, tracks.shared
    is_ours = sent & (shared.person != CLUTTER)
    is_sent = np.zeros((len(patrol.people), patrol.scan_s.size), dtype=bool)
    is_sent[shared.person[is_ours], shared.scan[is_ours]] = True
    grid = patrol.grid
    person = np.repeat(np.arange(len(grid)), np.diff(grid.offsets))
    return np.asarray(is_sent[person, patrol.scan[nearest_samples(patrol)]])
