"""Small patrols to test on: made-up people, robots of one's own, and slow answers."""

from dataclasses import replace

import numpy as np

from isac_track.config import StageSettings
from isac_track.patrols import make_patrol
from isac_track.patrols.answers import disclose
from isac_track.patrols.network import share_patrol
from isac_track.sharing import Clean, Raw
from isac_track.types import Tracks, derived
from predictors.kalman import KalmanCV

SETTINGS = StageSettings().changed({"patrol.fleets": 3})
ROUND = StageSettings().changed(
    {"patrol.fleets": 1, "patrol.scan_s": 0.1, "conflict.horizon_steps": 10}
)
"""Scans of 0.1 s; horizons of 0.9 s and 3 s, 9 and 30 scans."""


def straight_walks(*walks, step_s=0.5):
    """Tracks of straight walks: (start_s, end_s, place at start, velocity) each."""
    times, places = [], []
    for start_s, end_s, place, velocity in walks:
        t = np.arange(start_s, end_s + 1e-9, step_s)
        times.append(t)
        places.append(np.array(place) + (t - start_s)[:, None] * np.array(velocity))
    names = tuple(f"w{row}" for row in range(len(walks)))
    offsets = np.cumsum([0, *map(len, times)])
    return Tracks(np.concatenate(times), np.concatenate(places), offsets, names, names)


def patrol_past(tracks, *robots, settings=ROUND):
    """A patrol whose robots stand still at places of one's own."""
    patrol = make_patrol(tracks, settings=settings, seed=0)
    still = np.array(robots, dtype=float)[:, None, :]
    return replace(patrol, robot_xy=np.repeat(still, patrol.scan_s.size, axis=1))


def make_network(patrol, mechanism=None, *, settings=SETTINGS, forecaster=None, seed=0):
    """A network that shares raw samples and forecasts by a Kalman filter."""
    return share_patrol(
        patrol,
        mechanism=mechanism or Raw(),
        forecaster=forecaster or KalmanCV(),
        settings=settings,
        seed=seed,
    )


def clean_network(patrol, *, settings=ROUND, forecaster=None):
    """A network that senses and shares the truth."""
    silent = settings.changed({"sensing.sigma_cap_m": 1e-6})
    return make_network(patrol, Clean(), settings=silent, forecaster=forecaster)


def with_shapes(network, *, ratio):
    """The network, which declares ellipses with the variances of a radial error.

    Their long axes turn from sample to sample, and are `ratio` times the short ones.
    """
    release, slow = network.release, 0.1 * np.arange(network.release.t.size)
    axis = np.stack([np.cos(slow), np.sin(slow)], axis=1)
    along = 2.0 / (1.0 + ratio**2)
    shape = along * (np.eye(2) + (ratio**2 - 1.0) * axis[:, :, None] * axis[:, None, :])
    cov = 0.5 * np.square(release.sigma)[:, None, None] * shape
    return replace(network, release=derived(release, cov=cov))


def sent_answers(network, policy):
    """All samples sent, by (robot, presence): a plain loop over runs."""
    disclosure, sent = disclose(network, policy), {}
    for robot, presence, first, end in zip(
        disclosure.robot,
        disclosure.presence,
        disclosure.first,
        disclosure.end,
        strict=True,
    ):
        sent.setdefault((int(robot), int(presence)), []).extend(range(first, end))
    return sent
