"""Knowledge from a log: closed forms, a dense posterior, and plain loops."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.patrols import (
    SETTINGS,
    clean_network,
    make_network,
    patrol_past,
    straight_walks,
    with_shapes,
)

from isac_track.measurement import scalar_covariance
from isac_track.patrols import make_patrol, walked_map
from isac_track.patrols.answers import disclose
from isac_track.patrols.estimators import ESTIMATORS, estimate_positions
from isac_track.patrols.fleet_logs import Log, fleet_log
from isac_track.patrols.knowledge import guesses_from_map, known_places, nearest_samples
from isac_track.patrols.metrics import knowledge_metrics
from isac_track.patrols.reports import Reports, average_draws
from isac_track.patrols.walked_map import map_guesses
from isac_track.policies.samples import Ahead, Everything, Near, RandomPeople
from isac_track.policies.summaries import Flag, State
from isac_track.sharing import Fid
from predictors.constant_position import ConstantPosition

EPSILON_M = 0.3
CROSSING = straight_walks((0, 20, (-10.05, 0), (1, 0)))
"""A person within 2 m of the robot at (0, 0) at the queries of 9, 10, 11 and 12 s."""


def know_places(network, policy, *, epsilon_m=EPSILON_M):
    guesses = guesses_from_map(network.patrol, epsilon_m=epsilon_m)
    disclosure = disclose(network, policy)
    return known_places(network, disclosure, guesses=guesses, epsilon_m=epsilon_m)


def positions_on_grid(log, patrol, **options):
    """Estimated positions at all instants of the grid of a patrol."""
    return estimate_positions(
        log, t=patrol.grid.t, offsets=patrol.grid.offsets, **options
    )


def shares(known):
    """The share of instants that each estimator knows."""
    total = known.instants.sum() * known.disclosed.shape[1]
    return dict(zip(ESTIMATORS, known.known.sum(axis=(1, 2)) / total, strict=True))


class TestOneCrossing:
    def test_everything_discloses_all_up_to_the_last_query(self):
        tracks = straight_walks((0, 20.4, (-10.05, 0), (1, 0)), step_s=0.1)
        known = know_places(clean_network(patrol_past(tracks, (0, 0))), Everything())
        assert known.instants.tolist() == [205]
        assert known.disclosed.tolist() == [[201]]  # The last query is at 20 s.
        assert known.seen.all()

    def test_near_discloses_a_stretch_and_holding_adds_what_it_may(self):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        known = know_places(network, Near(2.0, window_s=0.5), epsilon_m=0.25)
        assert known.disclosed.tolist() == [[24]]  # six scans at each of four queries
        # The last entry is 0.1 m and 0.2 m away at the next two instants, the first
        # entry at the two instants before it.
        hold = ESTIMATORS.index("hold")
        assert known.known_undisclosed[hold].tolist() == [[4 * 2 + 2]]
        assert known.known[hold].tolist() == [[24 + 10]]

    @pytest.mark.parametrize("estimator", ["smooth", "extrapolate"])
    def test_a_straight_walk_is_known_entirely_from_a_part(self, estimator):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        known = know_places(network, Near(2.0, window_s=0.5))
        share = shares(known)[estimator]
        # Before the first entry, at 8.5 s, the filter knows nothing, the smoother all.
        assert share == pytest.approx(
            {"smooth": 1.0, "extrapolate": 116 / 201}[estimator], abs=0.02
        )

    def test_lines_join_the_entries_and_no_further(self):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        known = know_places(network, Near(2.0, window_s=0.5), epsilon_m=0.25)
        # 36 instants from 8.5 s to 12 s, and two on either side.
        assert known.known[ESTIMATORS.index("interpolate")].tolist() == [[36 + 4]]

    def test_a_state_tells_the_time_until_the_next_query(self):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        known = know_places(network, State())
        assert known.disclosed.tolist() == [[21]]
        assert shares(known)["interpolate"] > 0.9
        log = make_log(network, State())
        assert log.t.size == 201
        late = log.t > 2.0
        np.testing.assert_allclose(
            log.xy[late], network.patrol.people.xy[log.sample[late]], atol=0.01
        )

    def test_a_flag_tells_no_position(self):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        known = know_places(network, Flag())
        assert not known.seen.any()
        assert not known.disclosed.any()
        np.testing.assert_array_equal(
            known.known[:, :, 0], [known.known_by_map] * len(ESTIMATORS)
        )

    def test_a_robot_that_meets_nobody_learns_what_the_map_says(self):
        network = clean_network(patrol_past(CROSSING, (0, 50)))
        known = know_places(network, Near(2.0))
        metrics = knowledge_metrics(known, group=network.patrol.people.group, seed=0)
        assert metrics["people_seen"].value == 0.0
        assert metrics["disclosed_share"].value == 0.0
        assert metrics["known_share"].value == metrics["known_by_map"].value

    def test_plr_of_the_walk_counts_samples_that_were_not_sent_as_safe(self):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        known = know_places(network, Near(2.0, window_s=0.5))
        assert known.leaked.tolist() == [[24 / 201]]


def make_log(network, policy, robots=(0,)):
    disclosure = disclose(network, policy)
    return fleet_log(network, disclosure, robots=np.array(robots))


@pytest.fixture(scope="module")
def crowd(request):
    """A small crowd with three robots, and the network that senses it."""
    tracks = request.getfixturevalue("tracks")
    settings = SETTINGS.changed({"patrol.segment_s": 12.0})
    return make_network(make_patrol(tracks, settings=settings, seed=0))


def dense_posterior(t, xy, variance, at_s, *, start_s, start_xy):
    """The posterior mean of positions by the joint Gaussian, without recursion.

    Integrated Brownian motion with an uncertain place and velocity: Rasmussen and
    Williams, Gaussian Processes for Machine Learning, 2006, eq. 2.25 and sec. 6.3.
    """

    def covariance(a, b):
        a, b = a[:, None] - start_s, b[None] - start_s
        low, high = np.minimum(a, b), np.maximum(a, b)
        return 100.0**2 + 10.0**2 * a * b + 0.04 * low**2 * (3.0 * high - low) / 6.0

    gram = covariance(t, t) + np.diag(variance)
    return start_xy + covariance(at_s, t) @ np.linalg.solve(gram, xy - start_xy)


class TestEstimators:
    @pytest.mark.parametrize("policy", [Near(6.0), RandomPeople(0.2), State(4.0)])
    def test_the_smoother_is_the_mean_of_the_dense_posterior(self, crowd, policy):
        log, grid = make_log(crowd, policy, robots=(0, 1, 2)), crowd.patrol.grid
        estimate = positions_on_grid(
            log, crowd.patrol, estimator="smooth", fallback_xy=np.zeros(grid.xy.shape)
        )
        people = np.flatnonzero(np.diff(log.offsets) > 0)
        assert people.size > 3
        for person in people:
            entries = slice(*log.offsets[person : person + 2])
            instants = slice(*grid.offsets[person : person + 2])
            expected = dense_posterior(
                log.t[entries],
                log.xy[entries],
                log.variance[entries],
                grid.t[instants],
                start_s=min(log.t[entries][0], grid.t[instants][0]),
                start_xy=log.xy[entries][0],
            )
            np.testing.assert_allclose(estimate[instants], expected, atol=2e-3)

    def test_extrapolating_uses_no_later_entry(self, crowd):
        log, patrol = make_log(crowd, Near(3.0)), crowd.patrol
        person = int(np.diff(log.offsets).argmax())
        entries = slice(*log.offsets[person : person + 2])
        middle = log.offsets[person] + (entries.stop - entries.start) // 2
        moved = log.xy.copy()
        moved[middle : entries.stop] += 5.0
        before, after = (
            positions_on_grid(
                replace(log, xy=xy),
                patrol,
                estimator="extrapolate",
                fallback_xy=np.zeros(patrol.grid.xy.shape),
            )
            for xy in (log.xy, moved)
        )
        instants = slice(*patrol.grid.offsets[person : person + 2])
        is_earlier = patrol.grid.t[instants] + 1e-5 < log.t[middle]
        np.testing.assert_array_equal(
            before[instants][is_earlier], after[instants][is_earlier]
        )
        assert not np.allclose(
            before[instants][~is_earlier], after[instants][~is_earlier]
        )

    @pytest.mark.parametrize("policy", [Near(3.0), Ahead(1.5), RandomPeople(0.2)])
    def test_lines_and_held_places_are_those_of_a_plain_loop(self, crowd, policy):
        log, grid = make_log(crowd, policy, robots=(0, 1, 2)), crowd.patrol.grid
        fallback_xy = np.full(grid.xy.shape, 99.0)
        lines, held = (
            positions_on_grid(
                log, crowd.patrol, estimator=name, fallback_xy=fallback_xy
            )
            for name in ("interpolate", "hold")
        )
        for person in range(len(grid)):
            t, xy = (
                part[log.offsets[person] : log.offsets[person + 1]]
                for part in (log.t, log.xy)
            )
            for k in range(grid.offsets[person], grid.offsets[person + 1]):
                if not t.size:
                    assert (lines[k] == 99.0).all()
                    continue
                expected = [np.interp(grid.t[k], t, xy[:, axis]) for axis in range(2)]
                np.testing.assert_allclose(lines[k], expected, atol=1e-6)
                earlier = [
                    place
                    for at_s, place in zip(t, xy, strict=True)
                    if at_s <= grid.t[k]
                ]
                np.testing.assert_array_equal(
                    held[k], earlier[-1] if earlier else xy[0]
                )

    def test_more_entries_with_less_error_tell_more(self, crowd):
        everything = shares(know_places(crowd, Everything()))
        few = shares(know_places(crowd, Near(3.0)))
        noisy = shares(know_places(make_network(crowd.patrol, Fid(1.0)), Everything()))
        for name in ESTIMATORS:
            assert few[name] < everything[name]
            assert noisy[name] < everything[name]


class TestCounts:
    def test_a_fleet_knows_what_its_robots_were_sent_together(self, tracks):
        settings = SETTINGS.changed({"patrol.segment_s": 12.0, "patrol.robots": 3})
        network = make_network(make_patrol(tracks, settings=settings, seed=0))
        disclosure = disclose(network, Near(2.5))
        guesses = np.zeros((len(network.patrol.people), 2))
        known = known_places(network, disclosure, guesses=guesses, epsilon_m=EPSILON_M)
        nearest = nearest_samples(network.patrol)
        for fleet in range(3):
            sent = np.any(
                [
                    disclosure.sent_mask(network.patrol, robots=np.array([robot]))
                    for robot in range(3 * fleet, 3 * fleet + 3)
                ],
                axis=0,
            )
            expected = np.add.reduceat(
                sent[nearest].astype(int), network.patrol.grid.offsets[:-1]
            )
            assert known.disclosed[:, fleet].tolist() == expected.tolist()
        assert (known.disclosed[:, 0] != known.disclosed[:, 1]).any()

    def test_sent_samples_are_those_of_the_answers(self, crowd):
        disclosure = disclose(crowd, Near(3.0))
        sent = np.zeros(crowd.patrol.people.t.size, dtype=bool)
        for robot, first, end in zip(
            disclosure.robot, disclosure.first, disclosure.end, strict=True
        ):
            if robot == 1:
                sent[first:end] = True
        np.testing.assert_array_equal(
            disclosure.sent_mask(crowd.patrol, robots=np.array([1])), sent
        )

    def test_the_nearest_sample_is_nearest(self, crowd):
        patrol = crowd.patrol
        nearest = nearest_samples(patrol)
        for person in range(len(patrol.people)):
            samples = slice(*patrol.people.offsets[person : person + 2])
            instants = slice(*patrol.grid.offsets[person : person + 2])
            gap = np.abs(patrol.grid.t[instants, None] - patrol.people.t[samples])
            ours = np.abs(patrol.grid.t[instants] - patrol.people.t[nearest[instants]])
            np.testing.assert_allclose(ours, gap.min(axis=1), atol=1e-9)

    def test_forecasts_without_a_covariance_will_do_for_a_state(self):
        patrol = patrol_past(CROSSING, (0, 0))
        network = clean_network(patrol, forecaster=ConstantPosition())
        assert (make_log(network, State()).variance == 0.25).all()

    def test_metrics_are_ratios_over_people_and_fleets(self, crowd):
        known = know_places(crowd, Near(3.0))
        metrics = knowledge_metrics(known, group=crowd.patrol.people.group, seed=0)
        total = 3 * known.instants.sum()
        assert metrics["disclosed_share"].value == pytest.approx(
            known.disclosed.sum() / total
        )
        assert metrics["known_share"].value == pytest.approx(
            max(shares(known).values())
        )
        assert metrics["people_seen"].value == pytest.approx(known.seen.mean())
        assert metrics["plr_walk"].value == pytest.approx(known.leaked.mean())
        assert np.isnan(metrics["known_share"].ci_low)  # Three routes are too few.


class TestMap:
    def test_guesses_where_others_stand_and_not_the_person_itself(self):
        place = {"a": (0.0, 0.0), "b": (5.0, 0.0), "c": (5.1, 0.0), "d": (9.0, 9.0)}
        xy = np.repeat(np.array(list(place.values())), 10, axis=0)
        offsets = np.arange(5) * 10
        guesses = map_guesses(xy, offsets, group=tuple("abcd"), epsilon_m=EPSILON_M)
        for row in (0, 3):  # Two others stand at 5 m.
            assert np.hypot(*(guesses[row] - (5.05, 0.0))) < EPSILON_M

    def test_each_person_weighs_the_same_for_any_length_of_stay(self):
        xy = np.concatenate(
            [np.zeros((1000, 2)), np.full((5, 2), 7.0), np.full((5, 2), 7.0)]
        )
        xy = np.concatenate([xy, np.full((5, 2), 3.0)])
        offsets = np.array([0, 1000, 1005, 1010, 1015])
        guesses = map_guesses(xy, offsets, group=tuple("abcd"), epsilon_m=EPSILON_M)
        assert np.hypot(*(guesses[3] - 7.0)) < EPSILON_M

    def test_companions_are_no_others(self):
        xy = np.repeat(np.array([[0.0, 0.0], [0.0, 0.0], [4.0, 0.0]]), 5, axis=0)
        guesses = map_guesses(
            xy, np.array([0, 5, 10, 15]), group=("g", "g", "h"), epsilon_m=EPSILON_M
        )
        assert np.hypot(*(guesses[0] - (4.0, 0.0))) < EPSILON_M
        assert np.hypot(*(guesses[2] - (0.0, 0.0))) < EPSILON_M

    @pytest.mark.parametrize("most_cells", [walked_map._MOST_CELLS, 0.0])
    def test_of_a_single_person_is_the_middle(self, monkeypatch, most_cells):
        monkeypatch.setattr(walked_map, "_MOST_CELLS", most_cells)
        xy = np.array([[0.0, 0.0], [2.0, 4.0]])
        half_cell_m = EPSILON_M / 8.0
        guesses = map_guesses(xy, np.array([0, 2]), group=("a",), epsilon_m=EPSILON_M)
        np.testing.assert_allclose(guesses, [[1.0, 2.0]], atol=half_cell_m)
        thin = map_guesses(0.0 * xy, [0, 2], group=("a",), epsilon_m=EPSILON_M)
        np.testing.assert_allclose(thin, [[half_cell_m, half_cell_m]])


def test_an_empty_log_is_no_error():
    patrol = patrol_past(CROSSING, (0, 0))
    nothing = Log(
        np.zeros(0, int), np.zeros(0), np.zeros((0, 2)), np.zeros(0), np.zeros(2, int)
    )
    fallback_xy = np.ones(patrol.grid.xy.shape)
    for name in ESTIMATORS:
        estimate = positions_on_grid(
            nothing, patrol, estimator=name, fallback_xy=fallback_xy
        )
        np.testing.assert_array_equal(estimate, fallback_xy)


def test_a_map_of_walked_cells_alone_gives_the_same_guesses(monkeypatch):
    rng = np.random.default_rng(5)
    places = rng.uniform(0.0, 3.0, (9, 2))
    xy = np.repeat(places, 20, axis=0) + rng.normal(0.0, 0.2, (180, 2))
    offsets, group = np.arange(0, 181, 20), ["a", "a", *"bcdefgh"]
    whole = map_guesses(xy, offsets, group=group, epsilon_m=0.3)
    monkeypatch.setattr(walked_map, "_MOST_CELLS", 0.0)
    sparse = map_guesses(xy, offsets, group=group, epsilon_m=0.3)
    # Other sums of the same times: equal times may be told apart by rounding.
    near_m = np.hypot(*(whole - sparse).T)
    assert (near_m < 0.05).mean() > 0.8


def test_a_map_of_a_town_fits_into_memory():
    rng = np.random.default_rng(6)
    xy = np.repeat(rng.uniform(0.0, 2e4, (5, 2)), 10, axis=0)
    xy[40:] = xy[30:40]  # The last two stand at one place.
    guesses = map_guesses(xy, np.arange(0, 51, 10), group=list("abcde"), epsilon_m=0.3)
    assert np.hypot(*(guesses[0] - xy[30])) < 0.4


@pytest.fixture(scope="module")
def networks(request):
    """Networks whose errors last, and whose errors are drawn anew at every query."""
    tracks = request.getfixturevalue("tracks")
    made = {}
    for errors in ("walk", "query"):
        settings = SETTINGS.changed({"patrol.segment_s": 12.0, "patrol.errors": errors})
        patrol = make_patrol(tracks, settings=settings, seed=0)
        made[errors] = make_network(patrol, Fid(1.0), settings=settings)
    return made


class TestErrorsOfEveryQuery:
    def test_an_answer_repeats_a_sample_with_another_error(self, networks):
        network = networks["query"]
        pairs, offsets = network.patrol.presences, network.sent_release.offsets
        both = np.flatnonzero(pairs.person == pairs.person[0])[:2]
        n_common = np.diff(offsets)[both[0]]
        first, second = (
            network.sent_release.xy[offsets[row] :][:n_common] for row in both
        )
        assert n_common > 0
        assert (first != second).all()

    def test_draws_of_a_sample_average_away(self, networks):
        patrol, everything = networks["query"].patrol, Everything()
        once, again = (
            fleet_log(
                networks[errors],
                disclose(networks[errors], everything),
                robots=np.arange(1),
            )
            for errors in ("walk", "query")
        )
        np.testing.assert_array_equal(once.sample, again.sample)
        person = np.searchsorted(patrol.people.offsets, again.sample, "right") - 1
        pairs = patrol.presences
        n_draws = np.array(
            [
                ((pairs.person == row) & (pairs.sample >= sample)).sum()
                for row, sample in zip(person, again.sample, strict=True)
            ]
        )
        truth = patrol.people.xy[again.sample]
        square = [((log.xy - truth) ** 2).sum(axis=1) for log in (once, again)]
        many = n_draws >= 6
        expected = square[0][many].mean() * (1.0 / n_draws[many]).mean()
        assert square[1][many].mean() == pytest.approx(expected, rel=0.3)
        ratio = again.variance[many] * n_draws[many] / once.variance[many]
        assert np.median(ratio) == pytest.approx(1.0, abs=0.2)

    def test_more_is_known(self, networks):
        once, again = (
            shares(know_places(networks[errors], Everything()))
            for errors in ("walk", "query")
        )
        assert again["smooth"] > once["smooth"] + 0.02
        assert again["interpolate"] > once["interpolate"] + 0.1


class TestShapes:
    @pytest.mark.parametrize("policy", [Near(3.0, window_s=0.8), State(), Everything()])
    def test_round_shapes_change_no_estimate(self, crowd, policy):
        logs = [
            fleet_log(network, disclose(network, policy), robots=np.arange(3))
            for network in (crowd, with_shapes(crowd, ratio=1.0))
        ]
        fallback_xy = np.zeros_like(crowd.patrol.grid.xy)
        for estimator in ESTIMATORS:
            expected, got = (
                positions_on_grid(
                    log, crowd.patrol, estimator=estimator, fallback_xy=fallback_xy
                )
                for log in logs
            )
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-10)

    def test_draws_are_averaged_by_their_information(self):
        rng, key = np.random.default_rng(0), np.array([3, 1, 3, 3])
        factor = rng.standard_normal((4, 2, 2))
        cov = factor @ factor.swapaxes(1, 2) + 0.1 * np.eye(2)
        reports = Reports(rng.standard_normal((4, 2)), np.ones(4), cov)
        keys, mean = average_draws(key, reports)
        assert keys.tolist() == [1, 3]
        weights = np.linalg.inv(cov[key == 3])
        total = np.linalg.inv(weights.sum(axis=0))
        pull = np.einsum("lab,lb->a", weights, reports.xy[key == 3])
        np.testing.assert_allclose(mean.xy[1], total @ pull)
        np.testing.assert_allclose(mean.cov[1], total)
        np.testing.assert_allclose(mean.xy[0], reports.xy[1])
        variance = rng.uniform(0.1, 1.0, 4)
        plain = Reports(reports.xy, variance, None)
        circular = Reports(reports.xy, variance, scalar_covariance(variance))
        expected, got = (average_draws(key, each)[1] for each in (plain, circular))
        np.testing.assert_allclose(got.xy, expected.xy, atol=1e-10)
        np.testing.assert_allclose(got.variance, expected.variance, atol=1e-10)

    @pytest.mark.parametrize("estimator", ["smooth", "extrapolate"])
    def test_estimates_are_those_of_the_dense_posterior(self, estimator):
        rng, t = np.random.default_rng(2), np.array([0.0, 0.4, 1.1, 2.0])
        factor = 0.3 * rng.standard_normal((4, 2, 2))
        cov = factor @ factor.swapaxes(1, 2) + 0.01 * np.eye(2)
        log = Log(
            sample=np.arange(4),
            t=t,
            xy=rng.standard_normal((4, 2)),
            variance=np.trace(cov, axis1=1, axis2=2) / 2.0,
            offsets=np.array([0, 4]),
            cov=cov,
        )
        at_s = np.array([0.2, 1.5, 3.0])
        got = estimate_positions(
            log,
            t=at_s,
            offsets=np.array([0, 3]),
            estimator=estimator,
            fallback_xy=np.zeros((3, 2)),
        )
        for row, now_s in enumerate(at_s):
            used = t <= now_s if estimator == "extrapolate" else t >= 0.0
            times = np.append(t[used], now_s)
            early = np.minimum.outer(times, times)
            late = np.maximum.outer(times, times)
            prior = 100.0**2 + 10.0**2 * early * late
            prior += 0.04 * early**2 * (3.0 * late - early) / 6.0
            noise = np.kron(np.diag(used[used]), np.zeros((2, 2)))
            for k, shape in enumerate(cov[used]):
                noise[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = shape
            seen = np.kron(prior[:-1, :-1], np.eye(2)) + noise
            across = np.kron(prior[-1:, :-1], np.eye(2))
            start = log.xy[0]
            off = (log.xy[used] - start).ravel()
            exact = start + across @ np.linalg.solve(seen, off)
            np.testing.assert_allclose(got[row], exact, atol=1e-4)

    def test_shapes_tell_more(self, crowd):
        """Errors are round; what is declared is wrong, and so known less."""
        right, wrong = (
            know_places(network, Everything()).known.sum(axis=(1, 2))
            for network in (crowd, with_shapes(crowd, ratio=8.0))
        )
        assert wrong[0] < right[0]
