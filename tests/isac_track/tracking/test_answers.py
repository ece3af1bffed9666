"""Policies that answer from tracks: made-up tracks that break, swap and are missed."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.patrols import patrol_past, straight_walks

from isac_track.patrols.answers import disclose
from isac_track.patrols.utility import NEVER
from isac_track.policies.samples import Ahead, Everything, Near, Window
from isac_track.policies.summaries import Flag, State
from isac_track.sharing import Raw
from isac_track.tracking.answers import (
    disclosed_instants,
    forecasts_by_robot,
    logged_tracks,
    track_network,
)
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.tracking.utility import foresee_from_forecasts, foresee_from_tracks
from isac_track.types import Release
from predictors.kalman import KalmanCV

RADIUS_M = 0.9
ROBOT = np.arange(1)
# One crosses the robots' place at 10 s, one at 15 s, one stands far away.
WALKS = straight_walks(
    (0, 20, (-10, 0.3), (1, 0)), (0, 20, (0, -15), (0, 1)), (0, 20, (9, 9), (0, 0))
)


@pytest.fixture(scope="module")
def patrol():
    return patrol_past(WALKS, (0, 0))


def shared(patrol, tracks, *, alive=(), nobody=()):
    """Tracks of the true samples with these numbers; some may be of nobody."""
    sample = np.concatenate([np.array(row) for row in tracks])
    offsets = np.cumsum([0, *map(len, tracks)])
    people, scan = patrol.people, patrol.scan[sample]
    person = np.searchsorted(people.offsets, sample, side="right") - 1
    for track in nobody:
        person[offsets[track] : offsets[track + 1]] = CLUTTER
    last = scan[offsets[1:] - 1]
    last[: len(alive)] = alive
    return SharedTracks(
        release=Release(
            t=people.t[sample],
            xy=people.xy[sample],
            sigma=np.full(sample.size, 0.01),
            offsets=offsets,
            pseudonym=tuple(map(str, range(len(tracks)))),
        ),
        variance=np.full(sample.size, 1e-4),
        scan=scan,
        confirmed=scan[offsets[:-1]],
        last=last,
        person=person,
    )


def rows_of(patrol, person, first_s=0.0, last_s=20.0):
    """The samples of a person between two times."""
    row = np.arange(*patrol.people.offsets[person : person + 2])
    t = patrol.people.t[row]
    return row[(t >= first_s - 1e-9) & (t <= last_s + 1e-9)]


def network_of(patrol, tracks):
    return track_network(
        patrol,
        tracks,
        tracks,
        mechanism=Raw(),
        forecaster=KalmanCV(),
        law="isotropic",
        seed=0,
    )


def log_of(patrol, tracks, policy):
    return answer(patrol, tracks, policy)[0]


def answer(patrol, tracks, policy):
    """The log of a policy's answers, and the disclosed instants."""
    network = network_of(patrol, tracks)
    disclosure = disclose(network.network, policy)
    sent = disclosure.sent_mask(network.network.patrol, robots=ROBOT)
    log = logged_tracks(network, disclosure, robots=ROBOT)
    return log, disclosed_instants(network, sent)


def foresight_of(patrol, tracks, policy):
    network = network_of(patrol, tracks)
    forecasts = forecasts_by_robot(
        network, disclose(network.network, policy), predictor=KalmanCV()
    )
    return foresee_from_forecasts(
        patrol, forecasts, safety_radius_m=RADIUS_M, horizons=(20,)
    )


@pytest.fixture(scope="module")
def broken(patrol):
    """Two people swap their tracks at 9 s; a third track begins late and ends early."""
    crossing = [
        np.concatenate([rows_of(patrol, a, 0, 8.9), rows_of(patrol, b, 9.0, 20)])
        for a, b in ((0, 1), (1, 0))
    ]
    return shared(patrol, [*crossing, rows_of(patrol, 2, 4.05, 12.0)])


def test_everything_is_what_robots_foresee_from_the_whole_release(patrol, broken):
    ours = foresight_of(patrol, broken, Everything())
    whole = foresee_from_tracks(
        patrol,
        broken,
        predictor=KalmanCV(),
        safety_radius_m=RADIUS_M,
        horizons=(20,),
    )
    assert np.array_equal(ours.foreseen, whole.foreseen)
    assert np.array_equal(ours.ghost, whole.ghost)
    assert np.array_equal(ours.gaps_m[20], whole.gaps_m[20])
    log = log_of(patrol, broken, Everything())
    last = patrol.query_scan[-1]
    assert log.scan.size == (broken.scan <= last).sum()


def test_a_policy_chooses_tracks_and_is_wrong_about_people(patrol, broken):
    log = log_of(patrol, broken, Near(2.0, window_s=0.5))
    # At 9 s the first track goes on with the other person, 6 m away: nobody near is
    # sent until the second track, which now holds the first person, is near.
    sent = set(zip(log.scan.tolist(), log.person.tolist(), strict=True))
    expected = set()
    for query in patrol.query_scan:
        now = int(query)
        for track in range(3):
            rows = np.arange(*broken.release.offsets[track : track + 2])
            rows = rows[broken.scan[rows] <= now]
            if (
                not rows.size
                or not broken.confirmed[track] <= now <= broken.last[track]
            ):
                continue
            place = broken.release.xy[rows[-1]]
            if np.hypot(*(place - patrol.robot_xy[0, now])) < 2.0:
                age_s = broken.release.t[rows[-1]] - broken.release.t[rows]
                expected |= {
                    (int(broken.scan[row]), int(broken.person[row]))
                    for row in rows[age_s <= 0.5 + 1e-9]
                }
    assert sent == expected
    assert {person for _, person in sent} == {0, 1}


def test_a_track_that_is_born_late_and_dies_early_is_answered_while_it_lives(
    patrol, broken
):
    log, is_disclosed = answer(patrol, broken, Window(1.0))
    t = log.release.t[log.person == 2]
    # Queries every second: the first after its birth is at 5 s, the last at 12 s.
    assert t.min() == pytest.approx(4.1, abs=0.11)
    assert t.max() == pytest.approx(12.0, abs=0.11)
    grid = patrol.grid
    third = slice(*grid.offsets[2:4])
    times = grid.t[third][is_disclosed[third]]
    assert times.min() >= t.min() - 0.1
    assert times.max() <= t.max() + 0.1


def test_a_person_who_is_hidden_at_the_query_is_answered_by_the_last_detection(patrol):
    rows = rows_of(patrol, 2)
    visible = rows[
        (patrol.people.t[rows] % 1.0 > 0.25) & (patrol.people.t[rows] % 1.0 < 0.95)
    ]
    tracks = shared(patrol, [visible], alive=[patrol.scan[rows[-1]]])
    for policy in (Window(0.2), State()):
        assert log_of(patrol, tracks, policy).scan.size


def test_states_are_entries_until_the_next_query_or_the_end_of_the_track(patrol):
    tracks = shared(patrol, [rows_of(patrol, 0, 0.0, 7.5)])
    log = log_of(patrol, tracks, State())
    assert (np.diff(log.scan) == 1).all()
    assert log.scan.max() == tracks.last[0]
    # Of a straight walk the filter knows place and velocity after some seconds.
    truth = patrol.people.xy[rows_of(patrol, 0, 0.0, 7.5)]
    late = log.release.t > 4.0
    np.testing.assert_allclose(log.release.xy[late], truth[log.scan[late]], atol=0.05)


def test_a_coasting_track_logs_only_the_states_that_were_sent(patrol):
    # Detected up to 9.4 s and alive until 12.5 s: queries at 10, 11 and 12 s share the
    # last sample. Only the state of the first was sent.
    row = rows_of(patrol, 0, 0.0, 9.4)
    network = network_of(
        patrol, shared(patrol, [row], alive=[patrol.scan[row[-1]] + 31])
    )
    disclosure = disclose(network.network, State())
    at_ten = np.flatnonzero(network.live.query[disclosure.presence] == 10)
    sent = replace(
        disclosure,
        **{
            name: getattr(disclosure, name)[at_ten]
            for name in ("robot", "presence", "first", "end")
        },
    )
    log = logged_tracks(network, sent, robots=ROBOT)
    begin, end = patrol.query_scan[10:12]
    assert log.scan.tolist() == list(range(begin, end))


def test_a_flag_sends_nothing_and_warns_of_a_track_of_nobody(patrol):
    tracks = shared(patrol, [rows_of(patrol, 0)], nobody=[0])
    assert not log_of(patrol, tracks, Flag()).scan.size
    foresight = foresight_of(patrol, tracks, Flag())
    assert (foresight.ghost < NEVER).any()
    assert (foresight.foreseen == NEVER).all()
    assert not answer(patrol, tracks, Ahead(1.2))[1].any()


def test_without_a_track_nothing_is_sent_and_nothing_foreseen(patrol):
    late = patrol.query_scan[-1] + 1
    tracks = replace(shared(patrol, [rows_of(patrol, 0)]), confirmed=np.array([late]))
    assert not log_of(patrol, tracks, Everything()).scan.size
    assert (foresight_of(patrol, tracks, Everything()).foreseen == NEVER).all()
