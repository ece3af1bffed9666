"""Logs of fleets that answers from tracks leave: by hand, on a made-up track."""

from dataclasses import replace

import numpy as np
from helpers.patrols import ROUND, patrol_past, straight_walks

from evaluation.compute.track_policies import LOG_COLUMNS, _Answers, _count_logs
from evaluation.compute.tracking_setup import TrackingSetup
from isac_track.patrols.answers import disclose
from isac_track.policies.summaries import State
from isac_track.sharing import Raw
from isac_track.tracking.answers import track_network
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Release
from predictors.kalman import KalmanCV

TWO_FLEETS = ROUND.changed({"patrol.fleets": 2, "patrol.robots": 1})


def coasting_track(people, *, last_s, alive_s):
    """The track of the first person, detected up to a time and alive until another."""
    row = np.flatnonzero(people.t[: people.offsets[1]] < last_s)
    return SharedTracks(
        release=Release(
            t=people.t[row],
            xy=people.xy[row],
            sigma=np.full(row.size, 0.01),
            offsets=np.array([0, row.size]),
            pseudonym=("0",),
        ),
        variance=np.full(row.size, 1e-4),
        scan=row,
        confirmed=np.array([0]),
        last=np.array([round(alive_s / 0.1)]),
        person=np.zeros(row.size, dtype=np.int64),
    )


def test_fleets_that_were_sent_other_states_of_a_sample_have_logs_of_their_own():
    walks = straight_walks((0, 20, (-10, 0.3), (1, 0)), (0, 20, (9, 9), (0, 0)))
    patrol = patrol_past(walks, (0, 0), (0, 0), settings=TWO_FLEETS)
    shared = coasting_track(patrol.people, last_s=9.4, alive_s=12.5)
    tracks = track_network(
        patrol,
        shared,
        shared,
        mechanism=Raw(),
        forecaster=KalmanCV(),
        law="isotropic",
        seed=0,
    )
    everything = disclose(tracks.network, State())
    setup = TrackingSetup(patrol, TWO_FLEETS, seed=0)
    query = tracks.live.query[everything.presence]
    first = (everything.robot == 0) & (query == 10)
    second = (everything.robot == 1) & (query >= 10)

    def answers(is_sent):
        fields = ("robot", "presence", "first", "end")
        return replace(
            everything, **{name: getattr(everything, name)[is_sent] for name in fields}
        )

    def known(is_sent):
        row = LOG_COLUMNS[2:].index("known_interpolate")
        return _count_logs(_Answers(tracks, answers(is_sent)), setup)[row].sum()

    masks = [
        answers(is_sent).sent_mask(tracks.network.patrol, robots=np.array([robot]))
        for robot, is_sent in enumerate((first, second))
    ]
    assert masks[0].sum() == 1
    assert np.array_equal(*masks)
    assert known(first) < known(second)
    nothing = known(np.zeros_like(first))
    assert known(first | second) + nothing == known(first) + known(second)
