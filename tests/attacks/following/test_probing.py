"""Probing: beliefs by hand and by brute force, small hunts, and countermeasures."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.patrols import (
    ROUND,
    clean_network,
    patrol_past,
    straight_walks,
)
from scipy.stats import multivariate_normal

from attacks.following.belief import (
    NOBODY,
    Belief,
    Motion,
    SentStates,
    _association,
    make_crowd,
    route_gaps,
    standing_gaps,
    updated_by_flag,
    updated_by_states,
)
from attacks.following.probing import (
    CommittedRoute,
    ProbingOptions,
    Rules,
    choose_probed,
    probe_targets,
    probing_metrics,
)
from isac_track.errors import DataError
from isac_track.patrols.refusals import refused_conflicts, refused_queries
from isac_track.patrols.utility import NEVER
from isac_track.policies.samples import Ahead, Near
from isac_track.policies.summaries import Flag

OFTEN = ROUND.changed({"patrol.query_s": 0.1})
FEW = ProbingOptions(n_particles=150, longest_s=12.0)


def some_belief(n=4000, seed=0):
    rng = np.random.default_rng(seed)
    return Belief(
        0.0,
        rng.standard_normal((n, 2)),
        0.3 * rng.standard_normal((n, 2)),
        np.full(n, NOBODY),
    )


def some_crowd(n_present=2.0):
    rng = np.random.default_rng(1)
    return make_crowd(
        6.0 * rng.random((200, 2)) - 3.0,
        rng.standard_normal((200, 2)),
        n_present=n_present,
        margin_m=1.0,
        horizon_s=3.0,
        soft_m=0.1,
    )


class TestBelief:
    def test_gaps_are_those_of_a_fine_clock(self):
        rng = np.random.default_rng(2)
        places, xy, velocity = (rng.standard_normal((5, 2)) for _ in range(3))
        clock_s = np.linspace(0.0, 3.0, 30_001)
        walked = xy[:, None] + clock_s[:, None] * velocity[:, None]
        for place, gaps in zip(
            places, standing_gaps(places, xy, velocity, 3.0), strict=True
        ):
            exact = np.hypot(*(walked - place).transpose(2, 0, 1)).min(axis=1)
            np.testing.assert_allclose(gaps, exact, atol=1e-3)
        route = np.stack([np.sin(clock_s), clock_s], axis=1)
        exact = np.hypot(*(walked - route).transpose(2, 0, 1)).min(axis=1)
        np.testing.assert_allclose(route_gaps(route, clock_s, xy, velocity), exact)

    def test_a_flag_is_the_rule_of_bayes(self):
        belief, rng = some_belief(), np.random.default_rng(3)
        inside = np.where(belief.xy[:, 0] > 0.5, 0.9, 0.1)
        right = (belief.xy[:, 0] > 0.5).mean()
        by_others = 1.0 - np.exp(-0.4)
        for is_yes in (True, False):
            yes = np.array([0.9, 0.1]) + np.array([0.1, 0.9]) * by_others
            chance = yes if is_yes else 1.0 - yes
            exact = right * chance[0] / (right * chance[0] + (1 - right) * chance[1])
            after = updated_by_flag(
                belief, inside, others=0.4, is_yes=is_yes, power=1.0, rng=rng
            )
            assert (after.xy[:, 0] > 0.5).mean() == pytest.approx(exact, abs=0.01)

    def test_a_new_person_at_the_belief_is_the_target_and_another_is_not(self):
        belief = some_belief()
        still = np.zeros((4000, 2))
        belief = replace(belief, xy=0.05 * belief.xy, velocity_mps=still)
        state = np.zeros((1, 2, 2))
        sent = SentStates(
            np.array([7]), np.ones(1, bool), state, 0.01 * np.eye(2)[None]
        )
        options = {"crowd": some_crowd(), "power": 1.0, "rng": np.random.default_rng(4)}
        near = updated_by_states(belief, np.full(4000, 0.99), sent=sent, **options)
        assert (near.person == 7).mean() > 0.95
        far = replace(sent, mean=state + np.array([[3.0, 0.0], [3.0, 0.0]]))
        away = updated_by_states(belief, np.full(4000, 0.99), sent=far, **options)
        assert (away.person == 7).mean() < 0.01

    def test_states_behind_shapes_couple_both_axes(self):
        belief, rng = some_belief(), np.random.default_rng(6)
        factor = 0.2 * rng.standard_normal((4, 4))
        planar = (factor @ factor.T + 0.01 * np.eye(4)).reshape(1, 2, 2, 2, 2)
        mean = 0.3 * rng.standard_normal((1, 2, 2))
        sent = SentStates(
            np.array([7]), np.ones(1, bool), mean, np.eye(2)[None], planar
        )
        places, speeds = sent.draw(0, 100_000, rng)
        both = np.stack([places, speeds], axis=-1).reshape(-1, 4)
        np.testing.assert_allclose(np.cov(both.T), planar.reshape(4, 4), atol=0.005)
        # How much likelier than clutter: a Gaussian in place, and one in velocity.
        got = _association(belief, sent, np.zeros(1, int), some_crowd())[0]
        blurred = [planar[0, :, k, :, k] + 0.09 * np.eye(2) for k in (0, 1)]
        exact = multivariate_normal(mean[0, :, 0], blurred[0]).pdf(belief.xy)
        exact *= multivariate_normal(mean[0, :, 1], blurred[1]).pdf(belief.velocity_mps)
        np.testing.assert_allclose(got / got.max(), exact / exact.max(), atol=1e-9)
        axes = 0.02 * np.eye(2)[None]
        circular = np.einsum("ab,jde->jadbe", np.eye(2), axes)
        expected, got = (
            _association(
                belief,
                replace(sent, cov=axes, planar=each),
                np.zeros(1, int),
                some_crowd(),
            )
            for each in (None, circular)
        )
        np.testing.assert_allclose(got, expected, rtol=1e-10)

    def test_a_person_who_is_followed_takes_the_state_that_is_sent(self):
        belief = replace(some_belief(), person=np.full(4000, 7))
        mean = np.array([[[2.0, 0.5], [1.0, 0.0]]])
        sent = SentStates(
            np.array([7]), np.zeros(1, bool), mean, 0.01 * np.eye(2)[None]
        )
        after = updated_by_states(
            belief,
            np.zeros(4000),
            sent=sent,
            crowd=some_crowd(),
            power=1.0,
            rng=np.random.default_rng(5),
        )
        np.testing.assert_allclose(after.xy.mean(axis=0), [2.0, 1.0], atol=0.01)
        np.testing.assert_allclose(after.xy.std(axis=0), 0.1, rtol=0.1)

    def test_without_turns_it_spreads_as_white_acceleration_does(self):
        belief = replace(
            some_belief(), xy=np.zeros((4000, 2)), velocity_mps=np.zeros((4000, 2))
        )
        rng, motion = np.random.default_rng(6), Motion(q=0.05, turns_per_s=0.0)
        for step in range(1, 41):
            belief = belief.moved(0.1 * step, np.zeros((1, 2)), motion, rng)
        exact = np.sqrt(0.05 * 4.0**3 / 3.0)
        np.testing.assert_allclose(belief.xy.std(axis=0), exact, rtol=0.05)


@pytest.fixture(scope="module")
def walkers():
    """A network that senses twelve people far apart, at every scan.

    Either half of them walks in both directions.
    """
    walks = [(0, 14, (0, 8.0 * k), (1.1, 0)) for k in range(6)]
    walks += [(0, 14, (15, 8.0 * k + 4), (-1.1, 0)) for k in range(6)]
    patrol = patrol_past(straight_walks(*walks), (90.0, 90.0), settings=OFTEN)
    return clean_network(patrol, settings=OFTEN)


def hunt(network, policy, *, probes_per_s, rules=None, targets=None):
    targets = np.arange(4) if targets is None else targets
    return probe_targets(
        network,
        policy,
        targets=targets,
        probes_per_s=probes_per_s,
        rules=rules or Rules(),
        safety_radius_m=0.9,
        epsilon_m=0.3,
        options=FEW,
        seed=0,
    )


class TestProbing:
    def test_samples_on_request_give_a_lonely_target_away(self, walkers):
        blind = hunt(walkers, Ahead(1.2), probes_per_s=0.0)
        asked = hunt(walkers, Ahead(1.2), probes_per_s=3.0)
        assert blind.known.sum() < 0.4 * blind.instants.sum()
        assert asked.known.sum() > 0.8 * asked.instants.sum()
        assert asked.answered.tolist() == [36] * 4

    def test_flags_on_request_help(self, walkers):
        blind = hunt(walkers, Flag(), probes_per_s=0.0)
        asked = hunt(walkers, Flag(), probes_per_s=10.0)
        assert asked.known.sum() > 1.5 * blind.known.sum()

    def test_a_limit_makes_a_higher_rate_the_lower_one(self, walkers):
        rules = Rules(limit_per_s=1.0)
        limited = hunt(walkers, Flag(), probes_per_s=10.0, rules=rules)
        slow = hunt(walkers, Flag(), probes_per_s=1.0)
        assert limited.known.tolist() == slow.known.tolist()
        assert limited.answered.tolist() == slow.answered.tolist()

    def test_a_commitment_protects(self, walkers):
        free = hunt(walkers, Ahead(1.2), probes_per_s=3.0)
        bound = hunt(walkers, Ahead(1.2), probes_per_s=3.0, rules=Rules(3.0))
        assert bound.known.sum() < free.known.sum()

    def test_a_target_depends_on_no_other(self, walkers):
        alone = hunt(walkers, Flag(), probes_per_s=1.0, targets=np.array([2]))
        among = hunt(walkers, Flag(), probes_per_s=1.0)
        assert alone.known[0] == among.known[2]
        assert alone.claimed[0] == among.claimed[2]

    def test_metrics_are_shares_of_all_instants(self, walkers):
        probed = hunt(walkers, Flag(), probes_per_s=1.0)
        metrics = probing_metrics(probed, group=("a", "a", "b", "c"), seed=0)
        share = probed.known.sum() / probed.instants.sum()
        assert metrics["known_share"].value == pytest.approx(share)
        assert metrics["known_share"].n == 3

    def test_other_policies_and_short_stays_are_refused(self, walkers):
        with pytest.raises(DataError, match="ahead and flag"):
            hunt(walkers, Near(1.0), probes_per_s=1.0)
        short = patrol_past(straight_walks((0, 5, (0, 0), (1, 0))), (1.0, 0.0))
        with pytest.raises(DataError, match="record longer"):
            choose_probed(short, n_people=3, seed=0)

    def test_one_person_has_nobody_to_learn_from(self):
        walk = straight_walks((0, 14, (0, 0), (1, 0)))
        patrol = patrol_past(walk, (1.0, 0.0), settings=OFTEN)
        network = clean_network(patrol, settings=OFTEN)
        with pytest.raises(DataError, match="record more people"):
            hunt(network, Flag(), probes_per_s=1.0, targets=np.array([0]))


class TestCountermeasures:
    def test_a_committed_route_is_never_changed_and_not_too_fast(self):
        belief = replace(some_belief(50), xy=np.full((50, 2), 9.0))
        route = CommittedRoute([0.0, 3.0], [np.zeros(2), np.zeros(2)], 3.0, 1.4)
        clock_s = np.arange(0.0, 3.0, 0.05)
        before = route.places(clock_s)
        for step in range(1, 60):
            route.follow(replace(belief, t=0.1 * step))
        np.testing.assert_allclose(route.places(clock_s), before)
        speed = np.hypot(*np.diff(np.array(route.xy), axis=0)[1:].T) / np.diff(
            route.t[1:]
        )
        assert speed.max() <= 1.4 + 1e-9
        assert np.hypot(*(route.xy[-1] - 9.0)) < np.hypot(9.0, 9.0) - 5.0

    def test_a_robot_that_turns_away_is_refused_for_the_time_of_the_commitment(self):
        patrol = patrol_past(straight_walks((0, 8, (0, 0), (1, 0))), (5.0, 0.0))
        foreseen = np.full((len(patrol.presences), 1), NEVER)
        foreseen[[1, 2, 6], 0] = 10  # Alarms at 1, 2 and 6 s.
        refused = refused_queries(patrol, foreseen, horizon=30, commitment_s=3.0)
        assert np.flatnonzero(refused[:, 0]).tolist() == [2, 3, 7, 8]
        lost = refused_conflicts(patrol, foreseen, foreseen, refused, horizon=30)
        assert lost.rate == pytest.approx(1.0 / 3.0)
