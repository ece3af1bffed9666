"""Following people through logs: hand-made walks, plain loops, brute force."""

from itertools import product

import numpy as np
import pytest
from helpers.patrols import (
    ROUND,
    SETTINGS,
    clean_network,
    make_network,
    patrol_past,
    straight_walks,
    with_shapes,
)
from scipy.stats import multivariate_t

from attacks.following.absence import contradictions
from attacks.following.chains import join
from attacks.following.followed import LONGEST_S, following_metrics, restricted_mean_s
from attacks.following.links import (
    MOST_CANDIDATES,
    Links,
    candidate_links,
    entropy_bits,
    learn_weights,
    next_pieces,
    probabilities,
)
from attacks.following.logs import Ending, _chain_log, follow_fleets
from attacks.following.pieces import Q, collect_pieces
from isac_track.patrols import make_patrol
from isac_track.patrols.answers import disclose
from isac_track.patrols.knowledge import guesses_from_map
from isac_track.policies.samples import Everything, Near, RandomPeople, Window
from isac_track.policies.summaries import Flag, State

CROSSING = straight_walks((0, 20, (-10.05, 0), (1, 0)))
"""She is within 2 m of the robot at (0, 0) at the queries of 9, 10, 11 and 12 s."""


def pieces_past(policy, *robots, tracks=CROSSING):
    network = clean_network(patrol_past(tracks, *(robots or ((0, 0),))))
    numbers = np.arange(len(robots) or 1)
    return network, collect_pieces(network, disclose(network, policy), robots=numbers)


APPROACH = straight_walks((0, 20, (-10.05, 0), (1, 0)), (21, 40, (8.95, 0), (-1, 0)))
"""She passes the robot at (0, 0) and another person passes it later."""


def pieces_of(network, policy, **options):
    disclosure = disclose(network, policy)
    return collect_pieces(network, disclosure, robots=np.arange(1), **options)


class TestKeptPseudonyms:
    def test_join_the_answers_of_an_encounter_and_no_others(self):
        network = clean_network(patrol_past(APPROACH, (0, 0)))
        brief = Near(2.0, window_s=0.5)
        assert len(pieces_of(network, brief)) == 8
        pieces = pieces_of(network, brief, pseudonyms="encounter")
        assert pieces.person.tolist() == [0, 1]
        np.testing.assert_allclose(pieces.start.t, [8.5, 27.5])
        np.testing.assert_allclose(pieces.end.t, [12.0, 31.0])

    def test_a_query_without_an_answer_ends_an_encounter(self):
        network = clean_network(patrol_past(CROSSING, (-6, 0), (0, 0)))
        pieces = collect_pieces(
            network,
            disclose(network, Near(2.0, window_s=0.5)),
            robots=np.arange(2),
            pseudonyms="encounter",
        )
        # With the first robot at 3 to 6 s, with the second at 9 to 12 s.
        np.testing.assert_allclose(pieces.start.t, [2.5, 8.5], atol=0.11)
        np.testing.assert_allclose(pieces.end.t, [6.0, 12.0])

    @pytest.mark.parametrize("policy", [State(2.0), Near(2.0, window_s=0.05)])
    def test_people_are_followed_for_as_long_as_an_encounter_lasts(self, policy):
        once, kept_s = (
            follow_past(policy, CROSSING, pseudonyms=pseudonyms).followed_s[0, 0]
            for pseudonyms in ("query", "encounter")
        )
        assert once == 0.0  # Alone nobody else is there to learn from.
        ahead = isinstance(policy, State)  # It is sent before she is near.
        assert kept_s == pytest.approx(12.0 - (6.0 if ahead else 9.0))


class TestErrorsOfEveryQuery:
    def test_an_answer_is_a_piece_that_begins_after_the_query_before(self):
        settings = ROUND.changed({"patrol.errors": "query"})
        patrol = patrol_past(CROSSING, (0, 0), settings=settings)
        network = clean_network(patrol, settings=settings)
        long = Near(2.0, window_s=1.3)
        pieces = pieces_of(network, long)
        np.testing.assert_allclose(pieces.end.t, [9, 10, 11, 12])
        np.testing.assert_allclose(pieces.start.t, [8.1, 9.1, 10.1, 11.1])
        np.testing.assert_allclose(pieces.start.mean[:, 0, 1], 1.0, atol=0.1)
        (piece,) = (pieces_of(network, long, pseudonyms="encounter"),)
        assert piece.offsets.tolist() == [0, 44]  # 4.3 s of scans, each once.

    def test_they_are_harder_to_join_than_repeated_samples(self, crowd, request):
        settings = SETTINGS.changed(
            {"patrol.segment_s": 20.0, "patrol.errors": "query"}
        )
        patrol = make_patrol(
            request.getfixturevalue("tracks"), settings=settings, seed=0
        )
        fresh = make_network(patrol, settings=settings)
        guesses = guesses_from_map(patrol, epsilon_m=0.3)
        lasting_s, fresh_s = (
            follow_fleets(
                network,
                disclose(network, Window(1.3)),
                estimator="interpolate",
                guesses=guesses,
                epsilon_m=0.3,
                seed=0,
            ).followed_s.mean()
            for network in (crowd, fresh)
        )
        assert 0.0 < fresh_s < lasting_s


def test_entries_of_a_chain_that_mixes_people_are_in_the_order_of_time(crowd):
    pieces = pieces_of(crowd, Near(3.0))
    assert np.unique(pieces.person).size > 1
    log = _chain_log(crowd, pieces, np.zeros(len(pieces), dtype=np.int64))
    assert log.t.size == pieces.sample.size
    assert (np.diff(log.t) >= 0.0).all()
    np.testing.assert_array_equal(log.xy, crowd.release.xy[log.sample])


def follow_past(policy, tracks, *robots, **options):
    network = clean_network(patrol_past(tracks, *(robots or ((0, 0),))))
    guesses = guesses_from_map(network.patrol, epsilon_m=0.3)
    return follow_fleets(
        network,
        disclose(network, policy),
        estimator="interpolate",
        guesses=guesses,
        epsilon_m=0.3,
        seed=0,
        **options,
    )


@pytest.fixture(scope="module")
def crowd(request):
    """A network that senses a small crowd for three robots."""
    settings = SETTINGS.changed({"patrol.segment_s": 20.0})
    return make_network(
        make_patrol(request.getfixturevalue("tracks"), settings=settings, seed=0),
        settings=settings,
    )


class TestPieces:
    def test_a_window_longer_than_a_query_interval_chains_itself(self):
        _, pieces = pieces_past(Near(2.0, window_s=1.3))
        assert len(pieces) == 1
        assert pieces.start.t[0] == pytest.approx(9 - 1.3, abs=0.11)
        assert pieces.end.t[0] == pytest.approx(12)

    def test_a_shorter_window_leaves_a_piece_for_each_query(self):
        _, pieces = pieces_past(Near(2.0, window_s=0.5))
        np.testing.assert_allclose(pieces.end.t, [9, 10, 11, 12])
        assert pieces.offsets.tolist() == [0, 6, 12, 18, 24]

    def test_a_state_is_a_piece_of_its_own_whichever_robots_receive_it(self):
        _, pieces = pieces_past(State(), (0, 0), (3, 0))
        np.testing.assert_allclose(pieces.start.t, np.arange(21.0))
        assert np.diff(pieces.offsets).tolist() == [1] * 21

    def test_a_flag_leaves_none(self):
        _, pieces = pieces_past(Flag())
        assert len(pieces) == 0

    def test_states_at_both_ends_have_the_place_and_the_velocity_of_a_straight_walk(
        self,
    ):
        _, pieces = pieces_past(Near(2.0, window_s=1.3))
        for states in (pieces.start, pieces.end):
            np.testing.assert_allclose(
                states.mean[0, :, 0], [-10.05 + states.t[0], 0], atol=0.01
            )
            np.testing.assert_allclose(states.mean[0, :, 1], [1, 0], atol=0.05)

    @pytest.mark.parametrize(
        "policy",
        [Near(3.0, window_s=1.3), RandomPeople(0.5, window_s=0.8), Window(0.6)],
    )
    def test_they_are_what_equal_samples_join(self, crowd, policy):
        disclosure = disclose(crowd, policy)
        pieces = collect_pieces(crowd, disclosure, robots=np.arange(3))
        answers = []
        for presence, first, end in zip(
            disclosure.presence, disclosure.first, disclosure.end, strict=True
        ):
            del presence
            samples = range(first, end)
            answers.append(
                {(crowd.release.t[n], *crowd.release.xy[n]) for n in samples}
            )
        joined = []
        for answer in answers:  # A plain loop that sees values alone.
            common = [other for other in joined if other & answer]
            joined = [other for other in joined if not other & answer]
            joined.append(set().union(answer, *common))
        ours = {
            frozenset(
                (crowd.release.t[n], *crowd.release.xy[n])
                for n in pieces.sample[pieces.offsets[k] : pieces.offsets[k + 1]]
            )
            for k in range(len(pieces))
        }
        assert ours == {frozenset(some) for some in joined}


class TestLinks:
    def test_the_evidence_is_the_density_of_the_difference_of_states(self, crowd):
        disclosure = disclose(crowd, Near(3.0, window_s=0.8))
        pieces = collect_pieces(crowd, disclosure, robots=np.arange(3))
        links = candidate_links(pieces)
        assert len(links.before) > 100
        constants = []
        for row in range(0, len(links.before), 17):
            i, j = links.before[row], links.after[row]
            gap_s = pieces.start.t[j] - pieces.end.t[i]
            move = np.array([[1.0, gap_s], [0.0, 1.0]])
            noise = Q * np.array([[gap_s**3 / 3, gap_s**2 / 2], [gap_s**2 / 2, gap_s]])
            cov = move @ pieces.end.cov[i] @ move.T + noise + pieces.start.cov[j]
            off = pieces.start.mean[j] - pieces.end.mean[i] @ move.T
            exact = multivariate_t(shape=np.kron(np.eye(2), cov), df=5).logpdf(
                off.ravel()
            )
            constants.append(exact - links.features[row, 0])
        np.testing.assert_allclose(constants, constants[0], rtol=1e-9)

    def test_with_shapes_it_is_that_density_of_both_axes(self, crowd):
        network = with_shapes(crowd, ratio=8.0)
        disclosure = disclose(network, Near(3.0, window_s=0.8))
        pieces = collect_pieces(network, disclosure, robots=np.arange(3))
        links, constants = candidate_links(pieces), []
        for row in range(0, len(links.before), 17):
            i, j = links.before[row], links.after[row]
            gap_s = pieces.start.t[j] - pieces.end.t[i]
            move = np.array([[1.0, gap_s], [0.0, 1.0]])
            noise = Q * np.array([[gap_s**3 / 3, gap_s**2 / 2], [gap_s**2 / 2, gap_s]])
            both, drawn = np.kron(np.eye(2), move), np.kron(np.eye(2), noise)
            cov = both @ pieces.end.planar[i].reshape(4, 4) @ both.T + drawn
            cov += pieces.start.planar[j].reshape(4, 4)
            off = pieces.start.mean[j] - pieces.end.mean[i] @ move.T
            exact = multivariate_t(shape=cov, df=5).logpdf(off.ravel())
            constants.append(exact - links.features[row, 0])
        np.testing.assert_allclose(constants, constants[0], rtol=1e-8)

    @pytest.mark.parametrize("policy", [Near(3.0, window_s=0.8), State()])
    def test_round_shapes_change_nothing(self, crowd, policy):
        pieces = [
            collect_pieces(network, disclose(network, policy), robots=np.arange(3))
            for network in (crowd, with_shapes(crowd, ratio=1.0))
        ]
        expected, got = (candidate_links(each) for each in pieces)
        np.testing.assert_array_equal(got.after, expected.after)
        np.testing.assert_allclose(got.features, expected.features, atol=1e-8)
        for name in ("start", "end"):
            plain, shaped = (getattr(each, name) for each in pieces)
            np.testing.assert_allclose(shaped.mean, plain.mean, rtol=0, atol=1e-10)
            np.testing.assert_allclose(shaped.cov, plain.cov, rtol=0, atol=1e-10)
        np.testing.assert_allclose(
            pieces[1].reports.variance, pieces[0].reports.variance, atol=1e-10
        )

    def test_only_later_pieces_within_the_longest_gap_are_candidates(self):
        tracks = straight_walks((0, 4, (0, 0), (0.1, 0)), (20, 24, (1, 0), (0.1, 0)))
        _, pieces = pieces_past(Window(0.5), tracks=tracks)
        links = candidate_links(pieces)
        gaps_s = pieces.start.t[links.after] - pieces.end.t[links.before]
        assert gaps_s.min() > 0
        assert gaps_s.max() <= 30
        for i in range(len(pieces)):
            n_later = sum(
                0 < pieces.start.t[j] - pieces.end.t[i] <= 30
                for j in range(len(pieces))
            )
            assert (links.before == i).sum() == n_later

    def test_of_many_candidates_the_likeliest_stay(self, crowd):
        pieces = collect_pieces(
            crowd, disclose(crowd, Window(0.6)), robots=np.arange(3)
        )
        links = candidate_links(pieces)
        n_later = (pieces.start.t > pieces.end.t[:, None] + 1e-6).sum(axis=1)
        n_candidates = np.bincount(links.before, minlength=len(pieces))
        assert n_candidates.tolist() == np.minimum(n_later, MOST_CANDIDATES).tolist()
        assert n_later.max() > MOST_CANDIDATES
        is_next = next_pieces(pieces)[links.before] == links.after
        assert is_next.sum() > 0.9 * (next_pieces(pieces) >= 0).sum()

    def test_the_constant_alone_learns_how_often_somebody_comes_back(self):
        # One candidate a piece: the learnt odds are those of the data.
        n_pieces, n_next = 400, 300
        before = np.arange(n_pieces)
        features = np.column_stack(
            [np.zeros(n_pieces), np.ones(n_pieces), np.zeros(n_pieces)]
        )
        links = Links(before, before, features, n_pieces)
        weights = learn_weights(
            links, before < n_next, learn_from=np.ones(n_pieces, dtype=bool)
        )
        probability = probabilities(links, weights)
        # The ridge of 1e-3 pulls the log odds, 1.1, by about one percent.
        np.testing.assert_allclose(probability, n_next / n_pieces, atol=0.005)

    def test_planted_weights_are_learnt(self):
        rng, n_pieces, each = np.random.default_rng(0), 3000, 4
        before = np.repeat(np.arange(n_pieces), each)
        features = np.column_stack(
            [
                rng.normal(-3, 2, before.size),
                np.ones(before.size),
                rng.uniform(0, 2, before.size),
            ]
        )
        planted = np.array([0.8, 2.0, -1.0])
        links = Links(before, np.arange(before.size), features, n_pieces)
        share = probabilities(links, planted).reshape(n_pieces, each)
        chances = np.column_stack([share, 1 - share.sum(axis=1)])
        drawn = (rng.random((n_pieces, 1)) > np.cumsum(chances, axis=1)).sum(axis=1)
        is_next = (np.arange(each) == drawn[:, None]).ravel()
        weights = learn_weights(
            links, is_next, learn_from=np.ones(n_pieces, dtype=bool)
        )
        np.testing.assert_allclose(weights, planted, atol=0.2)

    def test_without_a_training_link_nobody_is_joined(self):
        features = np.array([[50.0, 1.0, 0.0]])
        links = Links(np.array([0]), np.array([1]), features, 2)
        weights = learn_weights(
            links, np.array([False]), learn_from=np.ones(2, dtype=bool)
        )
        assert probabilities(links, weights).tolist() == [0.0]

    def test_entropy_counts_candidates_and_no_return(self):
        links = Links(np.array([0, 0, 1]), np.array([1, 2, 2]), np.zeros((3, 3)), 3)
        bits = entropy_bits(links, np.array([0.5, 0.25, 1.0]))
        np.testing.assert_allclose(bits, [1.5, 0.0, 0.0])


class TestChains:
    @pytest.mark.parametrize("seed", range(20))
    def test_the_assignment_is_the_best_of_all(self, seed):
        rng = np.random.default_rng(seed)
        n_pieces = 5
        pairs = [(i, j) for i in range(n_pieces) for j in range(i + 1, n_pieces)]
        before, after = np.array(pairs).T
        raw = rng.exponential(size=before.size) * (rng.random(before.size) < 0.8)
        none = rng.exponential(size=n_pieces)
        total = none + np.bincount(before, weights=raw, minlength=n_pieces)
        probability = raw / total[before]
        links = Links(before, after, np.zeros((before.size, 3)), n_pieces)

        def value(chosen):
            """The log probability of a set of links; None if a piece is used twice."""
            if len(set(before[chosen])) < len(chosen) or len(set(after[chosen])) < len(
                chosen
            ):
                return None
            idle = [i for i in range(n_pieces) if i not in set(before[chosen])]
            with np.errstate(divide="ignore"):
                ends = np.log(none[idle] / total[idle]).sum()
                return float(np.log(probability[chosen]).sum() + ends)

        sets = [
            np.flatnonzero(flags)
            for flags in product([False, True], repeat=before.size)
        ]
        best = max(
            sets, key=lambda chosen: -np.inf if value(chosen) is None else value(chosen)
        )
        label = np.arange(n_pieces)
        for link in best:
            label[label == label[after[link]]] = label[before[link]]
        chain = join(links, probability)
        assert (chain[:, None] == chain).tolist() == (label[:, None] == label).tolist()


class TestFollowed:
    def test_everything_is_followed_from_the_first_to_the_last_query(self):
        following = follow_past(Everything(), CROSSING)
        assert following.followed_s.tolist() == [[20.0]]
        assert following.ending.tolist() == [[Ending.LEFT]]
        assert following.until_s.tolist() == [[20.0]]

    def test_a_person_whom_no_answer_holds_is_unseen(self):
        following = follow_past(Near(2.0), CROSSING, (0, 50))
        assert following.followed_s.tolist() == [[0.0]]
        assert following.ending.tolist() == [[Ending.UNSEEN]]

    def test_without_other_people_to_learn_from_a_gap_ends_it_with_certainty_of_leaving(
        self,
    ):
        following = follow_past(Near(2.0, window_s=0.5), CROSSING)
        assert following.followed_s.tolist() == [[pytest.approx(0.5)]]
        assert following.ceiling_s.tolist() == [[pytest.approx(3.5)]]
        assert following.ending.tolist() == [[Ending.WRONG]]

    def test_walks_far_apart_are_followed_over_gaps(self):
        lanes = [(0, 20, (-10, 8.0 * row), (1.0, 0)) for row in range(12)]
        following = follow_past(Window(0.5), straight_walks(*lanes))
        np.testing.assert_allclose(following.followed_s, following.ceiling_s)
        assert (following.known / following.instants[:, None] > 0.95).all()

    def test_the_control_joins_less_than_the_attack(self, crowd):
        disclosure = disclose(crowd, Window(0.6))
        guesses = guesses_from_map(crowd.patrol, epsilon_m=0.3)
        options = {
            "estimator": "smooth",
            "guesses": guesses,
            "epsilon_m": 0.3,
            "seed": 0,
        }
        attack = follow_fleets(crowd, disclosure, **options)
        control = follow_fleets(crowd, disclosure, shuffled=True, **options)
        assert attack.followed_s.mean() > 2 * control.followed_s.mean()
        assert (attack.followed_s <= attack.ceiling_s + 1e-9).all()

    def test_too_many_candidates_confuse(self):
        # Everybody walks in the same place at once: nobody can be distinguished.
        walks = [(0, 20, (0.001 * row, 0.0), (0.5, 0)) for row in range(12)]
        following = follow_past(Window(0.5), straight_walks(*walks))
        assert (following.ending == Ending.CONFUSED).all()
        assert following.until_s.max() < 5


class TestMetrics:
    def test_of_walks_that_are_followed_to_the_end(self):
        lanes = [(0, 20, (-10, 8.0 * row), (1.0, 0)) for row in range(12)]
        tracks = straight_walks(*lanes)
        following = follow_past(Window(0.5), tracks)
        metrics = following_metrics(following, group=tracks.group, seed=0)
        assert metrics["followed_10s"].value == 1.0
        assert np.isnan(metrics["followed_30s"].value)  # Nobody is present so long.
        assert metrics["followed_s"].value == pytest.approx(20, abs=0.6)
        assert metrics["followed_ceiling_s"].value == pytest.approx(20, abs=0.6)
        assert metrics["followed_90_s"].value == pytest.approx(20, abs=0.6)
        assert metrics["time_to_confusion_s"].value == LONGEST_S
        assert metrics["confident_wrong_share"].value == 0.0

    def test_the_mean_time_is_the_area_under_a_slow_survival_curve(self):
        rng = np.random.default_rng(1)
        times = rng.integers(1, 50, 200).astype(float)
        is_event, weights = (
            rng.random(200) < 0.6,
            rng.integers(0, 3, (3, 200)).astype(float),
        )
        for weight, area in zip(
            weights, restricted_mean_s(times, is_event, weights), strict=True
        ):
            survival, at, expected = 1.0, 0.0, 0.0
            for t in np.unique(times):
                expected += survival * (min(t, LONGEST_S) - at)
                at = min(t, LONGEST_S)
                events = weight[(times == t) & is_event].sum()
                at_risk = weight[times >= t].sum()
                survival *= 1 - events / at_risk if at_risk else 1.0
            expected += survival * (LONGEST_S - at)
            assert area == pytest.approx(expected)


class TestAbsence:
    def test_queries_without_an_expected_answer_are_counted(self):
        # She passes the robot, but the log of the adversary has her two ends alone.
        network, pieces = pieces_past(Window(0.5))
        ends = Links(
            np.array([0]), np.array([len(pieces) - 1]), np.zeros((1, 3)), len(pieces)
        )
        count = contradictions(
            pieces,
            ends,
            patrol=network.patrol,
            policy=Near(2.0),
            robots=np.array([0]),
            seed=0,
        )
        assert count.tolist() == [4]  # Within 2 m of the robot at four queries.

    def test_a_way_that_the_policy_would_not_tell_of_has_none(self):
        network, pieces = pieces_past(Window(0.5), (0, 50))
        ends = Links(
            np.array([0]), np.array([len(pieces) - 1]), np.zeros((1, 3)), len(pieces)
        )
        count = contradictions(
            pieces,
            ends,
            patrol=network.patrol,
            policy=Near(2.0),
            robots=np.array([0]),
            seed=0,
        )
        assert count.tolist() == [0]

    def test_the_informed_adversary_stays_below_true_identities(self, crowd):
        policy = Near(3.0, window_s=0.8)
        disclosure = disclose(crowd, policy)
        guesses = guesses_from_map(crowd.patrol, epsilon_m=0.3)
        options = {
            "estimator": "smooth",
            "guesses": guesses,
            "epsilon_m": 0.3,
            "seed": 0,
        }
        following = follow_fleets(crowd, disclosure, knows_policy=policy, **options)
        assert (following.followed_s <= following.ceiling_s + 1e-9).all()
        assert following.followed_s.max() > 0
