"""Patrols: the presence of people, the routes of robots, and the sensing."""

import numpy as np
import pytest
from helpers.patrols import ROUND, SETTINGS, make_network, straight_walks

from isac_track.errors import DataError, SettingsError
from isac_track.mechanisms.withholding import Window
from isac_track.patrols import horizon_scans, make_patrol, scans_per_query, sense_people
from isac_track.patrols.routes import draw_waypoints, places_along, walked_cells
from isac_track.plugins import parse
from isac_track.resample import walk
from isac_track.rng import stream
from isac_track.sharing import Raw

CROSSING = straight_walks(
    (0, 20, (-10, 0), (1, 0)), (3.25, 4.1, (5, 5), (0, 1)), step_s=0.05
)


def patrol_with(tracks=CROSSING, *, seed=0, settings=ROUND, **changes):
    changed = settings.changed(
        {f"patrol.{name}": value for name, value in changes.items()}
    )
    return make_patrol(tracks, settings=changed, seed=seed)


class TestPeople:
    def test_are_sampled_at_every_scan_of_their_presence_and_no_other(self):
        patrol = patrol_with()
        # At 0.0..20.0 s and 3.3..4.1 s.
        assert np.diff(patrol.people.offsets).tolist() == [201, 9]
        np.testing.assert_allclose(patrol.people[1].t, np.arange(3.3, 4.15, 0.1))
        np.testing.assert_allclose(patrol.people.t, patrol.scan_s[patrol.scan])

    def test_stand_where_their_continuous_walk_is(self, tracks):
        patrol = make_patrol(tracks, settings=SETTINGS, seed=0)
        for recorded, sampled in zip(tracks, patrol.people, strict=True):
            np.testing.assert_allclose(
                sampled.xy, walk(recorded)(sampled.t), atol=1e-12
            )

    def test_are_counted_if_no_scan_sees_them(self):
        tracks = straight_walks(
            (0, 5, (0, 0), (1, 0)), (1.02, 1.08, (0, 0), (1, 0)), step_s=0.01
        )
        patrol = patrol_with(tracks)
        assert patrol.people.source == ("w0",)
        assert patrol.n_left_out == 1

    def test_of_one_recorded_sample_are_not_seen(self):
        tracks = straight_walks((0, 5, (0, 0), (1, 0)), (1.0, 1.0, (0, 0), (1, 0)))
        assert patrol_with(tracks).n_left_out == 1

    def test_beyond_the_segment_are_left_out_and_cut_at_its_end(self):
        tracks = straight_walks((10, 30, (0, 0), (1, 0)), (18, 30, (0, 0), (1, 0)))
        patrol = patrol_with(tracks, segment_s=5.0)
        assert patrol.people.source == ("w0",)
        assert patrol.people.t[[0, -1]].tolist() == [10.0, 15.0]
        assert patrol.query_scan.size == 6

    def test_keep_the_cluster_that_they_walk_in(self, tracks):
        assert (
            make_patrol(tracks, settings=SETTINGS, seed=0).people.group == tracks.group
        )

    def test_that_are_never_present_are_one_clear_error(self):
        # A person of one sample, where the clock starts, and one between two scans.
        tracks = straight_walks(
            (0, 0, (0, 0), (1, 0)), (0.2, 0.8, (0, 0), (1, 0)), step_s=0.1
        )
        with pytest.raises(
            DataError,
            match=r"nobody of 2 people.*set patrol\.scan_s or patrol\.grid_s lower",
        ):
            patrol_with(tracks, scan_s=1.0)

    def test_that_are_present_at_no_query_are_one_clear_error(self):
        tracks = straight_walks((0.0, 0.0, (0, 0), (1, 0)), (1.0, 3.0, (0, 0), (1, 0)))
        with pytest.raises(DataError, match=r"set patrol\.query_s lower"):
            patrol_with(tracks, query_s=5.0)


class TestPresences:
    def test_are_those_of_a_plain_loop(self, tracks):
        patrol = make_patrol(tracks, settings=SETTINGS, seed=0)
        expected = [
            (query, person, first + int(np.flatnonzero(scans == now)[0]))
            for query, now in enumerate(patrol.query_scan)
            for person, (first, end) in enumerate(
                zip(patrol.people.offsets[:-1], patrol.people.offsets[1:], strict=True)
            )
            if now in (scans := patrol.scan[first:end])
        ]
        pairs = patrol.presences
        rows = zip(pairs.query, pairs.person, pairs.sample, strict=True)
        assert [tuple(map(int, row)) for row in rows] == expected

    def test_queries_are_the_last_scans_by_then(self):
        patrol = patrol_with(scan_s=0.0836)
        asked_s = patrol.scan_s[patrol.query_scan]
        assert patrol.query_scan.size == 20
        late_s = np.arange(20) - asked_s
        assert (late_s > -1e-9).all()
        assert (late_s < 0.0836).all()

    def test_horizons_are_the_papers_and_the_further_ones(self):
        assert horizon_scans(SETTINGS) == (11, 36)
        assert horizon_scans(ROUND) == (9, 30)
        assert patrol_with().ahead_s.size == 1 + 30 + scans_per_query(ROUND.patrol)


class TestRobots:
    def test_walk_at_their_speed(self):
        patrol = patrol_with(fleets=2)
        step_m = np.hypot(*np.diff(patrol.robot_xy, axis=1).T)
        assert step_m.max() <= 1.4 * 0.1 + 1e-9
        assert np.median(step_m) == pytest.approx(1.4 * 0.1)

    def test_turn_within_the_walked_area_only(self):
        cells = walked_cells(np.array([[0.5, 0.5], [7.2, -3.1]]))
        waypoints = draw_waypoints(cells, length_m=100.0, rng=stream(0, "test"))
        inside = [
            ((waypoints >= corner) & (waypoints <= np.array(corner) + 1.0)).all(axis=1)
            for corner in ((0, 0), (7, -4))
        ]
        assert np.any(inside, axis=0).all()
        assert np.any(inside, axis=1).all()

    def test_a_route_is_walked_leg_by_leg(self):
        waypoints = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])
        places = places_along(waypoints, np.array([0.0, 1.5, 3.0, 5.0, 7.0, 99.0]))
        expected = [[0, 0], [1.5, 0], [3, 0], [3, 2], [3, 4], [3, 4]]
        np.testing.assert_allclose(places, expected)

    @pytest.mark.parametrize(("robots", "fleets"), [(1, 5), (2, 3), (3, 7)])
    def test_another_robot_changes_no_other_route(self, robots, fleets):
        few = patrol_with(robots=1, fleets=3)
        many = patrol_with(robots=robots, fleets=fleets)
        assert many.n_robots == robots * fleets
        assert many.n_fleets == fleets
        np.testing.assert_array_equal(many.robot_xy[::robots][:3], few.robot_xy)
        assert np.unique(many.robot_xy[:, -1], axis=0).shape[0] == many.n_robots

    def test_a_longer_recording_begins_with_the_same_route(self):
        waypoints = [
            draw_waypoints(np.zeros((1, 2)), length_m=length_m, rng=stream(0, "test"))
            for length_m in (5.0, 50.0)
        ]
        np.testing.assert_array_equal(waypoints[1][: len(waypoints[0])], waypoints[0])

    def test_another_seed_is_another_route(self):
        assert not np.array_equal(patrol_with(seed=1).robot_xy, patrol_with().robot_xy)


class TestSensing:
    def test_errors_of_a_person_depend_on_no_other_person(self):
        both = sense_people(patrol_with(), settings=ROUND, seed=0)
        walk_alone = straight_walks((0, 20, (-10, 0), (1, 0)), step_s=0.05)
        alone = sense_people(patrol_with(walk_alone), settings=ROUND, seed=0)
        np.testing.assert_allclose(both[0].xy, alone.xy, atol=1e-12)

    def test_has_an_error_of_the_declared_size(self, tracks):
        patrol = make_patrol(tracks, settings=SETTINGS, seed=0)
        sensed = sense_people(patrol, settings=SETTINGS, seed=0)
        error = np.hypot(*(sensed.xy - patrol.people.xy).T) / sensed.sigma_raw
        assert np.sqrt(np.mean(error**2)) == pytest.approx(1.0, abs=0.05)

    def test_one_release_serves_everybody_and_depends_on_no_route(self):
        few, many = (make_network(patrol_with(fleets=fleets)) for fleets in (1, 4))
        np.testing.assert_array_equal(few.release.xy, many.release.xy)
        np.testing.assert_array_equal(few.release.xy, few.sensed.xy)

    def test_mechanisms_share_their_draws(self):
        patrol = patrol_with()
        names = [
            make_network(patrol, plugin.instance).release.pseudonym
            for plugin in parse("mechanisms", "fixed:0.1..0.5/2")
        ]
        assert names[0] == names[1] == make_network(patrol, Raw()).release.pseudonym

    def test_a_mechanism_that_leaves_samples_out_is_refused(self):
        with pytest.raises(
            SettingsError, match="a policy selects samples, such as window"
        ):
            make_network(patrol_with(), Window(1.0))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("robots", 0, "patrol.robots must lie within 1 to 100"),
        ("fleets", -1, "patrol.fleets must lie within 0 to 1000"),
        ("query_s", 0.0, "patrol.query_s must lie within"),
        ("query_s", 0.05, r"patrol.query_s \(0.05\) is below patrol.scan_s"),
        ("scan_s", -1.0, "patrol.scan_s must lie within"),
        ("segment_s", -1.0, "patrol.segment_s must lie within 0 to 1e.06, or be inf"),
        ("grid_s", "wide", "patrol.grid_s must be a number"),
    ],
)
def test_a_wrong_setting_is_one_clear_error(name, value, message):
    with pytest.raises(SettingsError, match=message):
        SETTINGS.changed({f"patrol.{name}": value})
