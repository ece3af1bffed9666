"""The posterior adversary against exact posteriors, and its calibration."""

from itertools import product

import numpy as np
import pytest
from helpers.patrols import (
    SETTINGS,
    clean_network,
    make_network,
    patrol_past,
    straight_walks,
)
from scipy.linalg import block_diag
from scipy.sparse import csr_array, identity
from scipy.stats import norm

from attacks.following.answer_evidence import (
    Answers,
    flag_answers,
    positive_rates,
    sent_answers,
    state_levels,
)
from attacks.following.chain_smoother import smooth_chain
from attacks.following.experts import (
    N_GAPS,
    Entries,
    PosteriorOptions,
    chain_densities,
    entry_likelihood,
    gap_bins,
    make_clock,
    smooth_gaussians,
    state_opinions,
)
from attacks.following.pool import pool_weights, pooled_log_density
from attacks.following.posterior import chain_from, choose_targets, posterior_scores
from attacks.following.posterior_metrics import posterior_metrics, reliability_table
from attacks.following.walk_chain import (
    ChainOptions,
    fit_chain,
    make_chain,
    nominal_velocities,
    velocity_classes,
)
from isac_track.errors import DataError
from isac_track.measurement import scalar_covariance
from isac_track.patrols import make_patrol
from isac_track.patrols.answers import disclose
from isac_track.policies.samples import Ahead, Everything, Near
from isac_track.policies.summaries import Flag
from predictors.kalman import KalmanCV

NO_MOTION = np.zeros((1, 2))
OPTIONS = PosteriorOptions()


def tiny_chain(move, switch, stationary, *, shape, cell_m=1.0, step_s=0.5):
    n_classes = len(switch)
    return make_chain(
        low_m=np.zeros(2),
        shape=shape,
        options=ChainOptions(cell_m=cell_m, step_s=step_s),
        velocity_mps=np.zeros((n_classes, 2)),
        spread_mps=np.full(n_classes, 0.05),
        move=csr_array(move),
        switch=np.asarray(switch, dtype=float),
        stationary=np.asarray(stationary, dtype=float),
    )


def two_cells():
    """Two cells and two classes: one that moves on, one that stays."""
    stay, go = np.array([[0.9, 0.1], [0.1, 0.9]]), np.array([[0.2, 0.8], [0.7, 0.3]])
    move = np.zeros((4, 4))
    move[:2, :2], move[2:, 2:] = stay, go
    switch, law = [[0.8, 0.2], [0.4, 0.6]], [0.35, 0.25, 0.15, 0.25]
    return tiny_chain(move, switch, law, shape=(2, 1))


def open_floor():
    """A chain of one class whose people stay, on a floor of 5 by 5 cells."""
    return tiny_chain(np.eye(25), [[1.0]], np.full(25, 0.04), shape=(5, 5), cell_m=0.5)


def transition(chain):
    """The matrix of a chain, column by column."""
    return np.stack([chain.forward(row) for row in np.eye(chain.stationary.size)])


def walk_line(*, std_m, n=61, cell_m=0.25):
    """A random walk along a line of cells with a flat map."""
    shift = np.arange(n)[:, None] - np.arange(n)
    share = norm.cdf((shift + 0.5) * cell_m, scale=std_m) - norm.cdf(
        (shift - 0.5) * cell_m, scale=std_m
    )
    return tiny_chain(share, [[1.0]], np.full(n, 1.0 / n), shape=(n, 1), cell_m=cell_m)


class TestChain:
    def test_its_matrix_is_a_probability_that_keeps_the_map(self):
        chain = two_cells()
        matrix = transition(chain)
        np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-6)
        np.testing.assert_allclose(
            chain.stationary @ matrix, chain.stationary, atol=1e-6
        )

    def test_forward_and_backward_are_transposed(self):
        chain = two_cells()
        back = np.stack([chain.backward(row) for row in np.eye(4)])
        np.testing.assert_allclose(transition(chain), back.T, atol=1e-12)

    def test_smoothing_is_the_sum_over_all_paths(self):
        chain, rng = two_cells(), np.random.default_rng(0)
        matrix, likelihood = transition(chain), rng.random((4, 4))
        total, cells = 0.0, np.zeros((4, 2))
        for path in product(range(4), repeat=4):
            weight = chain.stationary[path[0]] * likelihood[0, path[0]]
            for step in range(1, 4):
                weight *= matrix[path[step - 1], path[step]]
                weight *= likelihood[step, path[step]]
            total += weight
            for step in range(4):
                cells[step, path[step] % 2] += weight
        smoothed = smooth_chain(chain, lambda step: likelihood[step], n_steps=4)
        np.testing.assert_allclose(smoothed.cells, cells / total, atol=1e-9)
        assert smoothed.log_evidence == pytest.approx(np.log(total))

    def test_a_random_walk_has_the_log_score_of_the_dense_gaussian_posterior(self):
        std_m, noise_m, rng = 0.5, 0.4, np.random.default_rng(1)
        chain, n_steps, seen = walk_line(std_m=std_m), 9, np.array([0, 3, 8])
        middle = chain.centres()[chain.n_cells // 2, 0]
        lag = np.arange(n_steps)
        # A broad start, as the flat map is.
        prior = 100.0 + std_m**2 * np.minimum(lag[:, None], lag)
        gain = prior[:, seen] @ np.linalg.inv(
            prior[np.ix_(seen, seen)] + noise_m**2 * np.eye(3)
        )
        variance = np.diag(prior - gain @ prior[seen])
        exact, on_grid = [], []
        for _ in range(60):
            walk = middle + np.cumsum(std_m * rng.standard_normal(n_steps))
            entries = walk[seen] + noise_m * rng.standard_normal(3)
            mean = middle + gain @ (entries - middle)
            exact.append(norm.logpdf(walk, mean, np.sqrt(variance)))
            density = chain_densities(
                chain,
                Entries(
                    0.5 * seen,
                    np.stack([entries, np.full(3, 0.125)], axis=1),
                    np.full(3, noise_m**2),
                ),
                make_clock(0.5 * lag, start_s=0.0, step_s=0.5),
                further=lambda _: 1.0,
            )
            cell = chain.cells_at(np.stack([walk, np.full(n_steps, 0.1)], axis=1))
            on_grid.append(np.log(density[lag, cell] * chain.cell_m))
        assert np.mean(on_grid) == pytest.approx(np.mean(exact), abs=0.03)

    def test_it_is_calibrated_on_people_from_its_prior(self):
        chain, rng = two_cells(), np.random.default_rng(2)
        matrix, claimed, hits = transition(chain), [], []
        right = 0.8  # Probability that a noisy observation shows the true cell.
        for _ in range(800):
            state = rng.choice(4, p=chain.stationary / chain.stationary.sum())
            path = [state]
            for _ in range(5):
                state = rng.choice(4, p=matrix[state] / matrix[state].sum())
                path.append(state)
            cell = np.array(path) % 2
            shown = np.where(rng.random(6) < right, cell, 1 - cell)
            shown[[1, 2, 4]] = -1  # Nothing is seen there.

            def likelihood(step, shown=shown):
                if shown[step] < 0:
                    return np.ones(4)
                return np.where(np.arange(4) % 2 == shown[step], right, 1.0 - right)

            density = smooth_chain(chain, likelihood, n_steps=6).cells
            claimed.append(density.max(axis=1))
            hits.append(density.argmax(axis=1) == cell)
        claimed, hits = np.concatenate(claimed), np.concatenate(hits)
        for low, high in ((0.5, 0.65), (0.65, 0.8), (0.8, 1.0)):
            rows = (claimed >= low) & (claimed < high)
            error = np.sqrt(0.25 / rows.sum())
            assert hits[rows].mean() == pytest.approx(
                claimed[rows].mean(), abs=4.0 * error
            )

    def test_classes_are_where_their_nominal_velocities_lie(self):
        options = ChainOptions()
        classes = velocity_classes(nominal_velocities(options), options)
        assert classes.tolist() == list(range(options.n_classes))

    def test_a_walk_to_the_right_is_predicted_to_the_right(self):
        # As many walk back: in a stationary flow nobody piles up at an end.
        there = [(0, 8, (0.1 * k, k), (1.2, 0)) for k in range(5)]
        back = [(0, 8, (9.6 + 0.1 * k, k), (-1.2, 0)) for k in range(5)]
        tracks = straight_walks(*there, *back)
        chain = fit_chain(
            tracks, people=np.ones(10, bool), options=ChainOptions(), grid_s=0.5
        )
        start = np.zeros(chain.stationary.size)
        kind = velocity_classes(np.array([[1.2, 0.0]]), ChainOptions())[0]
        start[kind * chain.n_cells + chain.cells_at(np.array([4.0, 2.0]))] = 1.0
        for _ in range(4):
            start = chain.forward(start)
        mean = chain.by_class(start).sum(axis=0) @ chain.centres()
        assert mean[0] == pytest.approx(4.0 + 2.4, abs=0.6)
        assert mean[1] == pytest.approx(2.0, abs=0.5)


class TestExperts:
    def test_a_smoother_is_the_dense_gaussian_posterior(self):
        rng = np.random.default_rng(3)
        entry_s, t = np.array([0.0, 0.5, 2.0, 4.0]), np.array([0.2, 1.3, 3.0])
        entries = Entries(entry_s, rng.standard_normal((4, 2)), np.full(4, 0.09))
        smoothed = smooth_gaussians(entries, t, options=OPTIONS)
        times = np.concatenate([entry_s, t])
        early = np.minimum(times[:, None], times)
        late = np.maximum(times[:, None], times)
        for number, q in enumerate(OPTIONS.q):
            # Integrated white acceleration, from a broad first place and velocity.
            prior = 100.0**2 + 1.4**2 * early * late
            prior += q * early**2 * (3.0 * late - early) / 6.0
            own, noise = prior[:4, :4], np.diag(entries.variance)
            gain = np.linalg.solve(own + noise, prior[:4, 4:]).T
            np.testing.assert_allclose(
                smoothed.mean[number], gain @ entries.xy, atol=2e-3
            )
            exact = np.diag(prior[4:, 4:] - gain @ prior[:4, 4:])
            np.testing.assert_allclose(smoothed.variance[number], exact, rtol=0.02)

    def test_a_smoother_of_shapes_is_the_dense_posterior_of_both_axes(self):
        rng = np.random.default_rng(3)
        entry_s, t = np.array([0.0, 0.5, 2.0, 4.0]), np.array([0.2, 1.3, 3.0])
        factor = 0.3 * rng.standard_normal((4, 2, 2))
        cov = factor @ factor.swapaxes(1, 2) + 0.01 * np.eye(2)
        variance = np.trace(cov, axis1=1, axis2=2) / 2.0
        entries = Entries(entry_s, rng.standard_normal((4, 2)), variance, cov)
        smoothed = smooth_gaussians(entries, t, options=OPTIONS)
        times = np.concatenate([entry_s, t])
        early, late = np.minimum.outer(times, times), np.maximum.outer(times, times)
        for number, q in enumerate(OPTIONS.q):
            prior = 100.0**2 + 1.4**2 * early * late
            prior += q * early**2 * (3.0 * late - early) / 6.0
            prior = np.kron(prior, np.eye(2))
            gain = np.linalg.solve(prior[:8, :8] + block_diag(*cov), prior[:8, 8:]).T
            np.testing.assert_allclose(
                smoothed.mean[number].ravel(), gain @ entries.xy.ravel(), atol=2e-3
            )
            exact = prior[8:, 8:] - gain @ prior[:8, 8:]
            for row in range(3):
                block = exact[2 * row : 2 * row + 2, 2 * row : 2 * row + 2]
                np.testing.assert_allclose(
                    smoothed.cov[number, row], block, rtol=0.02, atol=1e-3
                )

    def test_the_shape_of_entries_tells_the_cell(self):
        """Against counts of draws about the mean of the entries."""
        chain, rng = open_floor(), np.random.default_rng(5)
        cov = np.tile([[0.2, 0.15], [0.15, 0.2]], (3, 1, 1))
        entries = Entries(np.full(3, 1.0), np.full((3, 2), 1.3), np.full(3, 0.2), cov)
        likelihood = entry_likelihood(chain, entries, step_s=1.0)
        spread = cov[0] / 3.0 + 0.05**2 * np.eye(2)
        draws = rng.multivariate_normal([1.3, 1.3], spread, size=200_000)
        share = np.bincount(chain.cells_at(draws), minlength=chain.n_cells) / len(draws)
        np.testing.assert_allclose(likelihood, share / share.max(), atol=0.02)

    def test_round_shapes_change_nothing(self):
        rng, t = np.random.default_rng(7), np.array([0.9, 1.0, 1.1, 1.3])
        variance, clock = rng.uniform(0.05, 0.4, 4), np.array([1.05, 2.0])
        xy = rng.uniform(0.5, 2.0, (4, 2))
        plain = Entries(t, xy, variance)
        circular = Entries(t, xy, variance, scalar_covariance(variance))
        expected, got = (
            entry_likelihood(open_floor(), each, step_s=1.0)
            for each in (plain, circular)
        )
        np.testing.assert_allclose(got, expected, atol=1e-10)
        expected, got = (
            state_opinions(
                open_floor(),
                each,
                clock=make_clock(clock, start_s=0.0, step_s=0.5),
                t=clock,
                true_xy=np.ones((2, 2)),
                further=None,
                epsilon_m=0.3,
                options=OPTIONS,
            )
            for each in (plain, circular)
        )
        np.testing.assert_allclose(got.log_density, expected.log_density, atol=1e-7)
        np.testing.assert_allclose(got.mass, expected.mass, atol=1e-8)

    def test_gaps_tell_between_from_beyond_and_nothing(self):
        t = np.array([0.0, 1.0, 3.0, 9.0])
        bins = gap_bins(t, np.array([1.0, 5.0]))
        assert len(set(bins.tolist())) == 4
        assert gap_bins(t, np.zeros(0)).tolist() == [N_GAPS - 1] * 4

    def test_a_pool_trusts_the_expert_that_is_right(self):
        rng = np.random.default_rng(4)
        values = rng.standard_normal(2000)
        log_density = np.stack(
            [norm.logpdf(values), norm.logpdf(values, 3.0, 0.5)], axis=1
        )
        gap = np.zeros(2000, dtype=np.int64)
        weights = pool_weights(log_density, gap)
        assert weights[0, 0] > 0.95
        pooled = pooled_log_density(log_density, gap, weights)
        assert pooled.mean() == pytest.approx(log_density[:, 0].mean(), abs=0.01)


@pytest.fixture(scope="module")
def crowd(request):
    """A network that senses a small crowd for two robots."""
    settings = SETTINGS.changed({"patrol.segment_s": 10.0, "patrol.fleets": 2})
    return make_network(
        make_patrol(request.getfixturevalue("tracks"), settings=settings, seed=0),
        settings=settings,
    )


def score(network, policy, answers, *, targets):
    return posterior_scores(
        network,
        disclose(network, policy),
        answers=answers,
        targets=targets,
        epsilon_m=0.3,
        options=OPTIONS,
        seed=0,
    )


class TestAnswers:
    def test_the_policy_is_asked_about_every_state(self):
        patrol = patrol_past(straight_walks((0, 9, (0, 0), (1, 0))), (5.0, 0.0))
        chain = chain_from(patrol, people=np.ones(1, bool), options=OPTIONS)
        levels = state_levels(patrol, chain, Near(1.5), options=OPTIONS.chain, seed=0)
        away = np.hypot(*(chain.centres() - [5.0, 0.0]).T)
        by_class = levels[0, 0].reshape(-1, chain.n_cells)
        assert (by_class[:, away < 0.7] == 4).all()
        assert (by_class[:, away > 2.3] == 0).all()

    def test_rates_are_counted_shares(self):
        positive = np.array([[True], [False], [True], [True]])
        levels = np.array([[[0, 4]]], dtype=np.uint8)
        rates = positive_rates(
            Answers(positive, Near(1.0)),
            levels,
            query=np.zeros(4, dtype=np.int64),
            state=np.array([0, 0, 1, 1]),
            rows=np.array([True, True, True, False]),
        )
        assert rates[0] == pytest.approx(1.5 / 3.0)
        assert rates[4] == pytest.approx(1.5 / 2.0)

    def test_a_flag_says_yes_to_all_if_it_is_yes_for_anybody(self):
        walks = straight_walks((0, 9, (-3, 0), (1, 0)), (0, 9, (30, 30), (0.1, 0)))
        network = clean_network(patrol_past(walks, (3.0, 0.0)))
        named, anybody = (
            flag_answers(
                network,
                disclose(network, Flag()),
                predictor=KalmanCV(),
                safety_radius_m=0.9,
                horizon=30,
                is_named=is_named,
            ).positive[:, 0]
            for is_named in (True, False)
        )
        person = network.patrol.presences.person
        assert not named[person == 1].any()
        np.testing.assert_array_equal(named[person == 0], anybody[person == 0])
        np.testing.assert_array_equal(anybody[person == 0], anybody[person == 1])
        assert anybody.any()


class TestScores:
    def test_with_everything_nearly_every_place_is_known(self, crowd):
        targets = choose_targets(crowd.patrol.people.group, n_people=4, seed=0)
        known, same = score(crowd, Everything(), None, targets=targets)
        assert known.is_known.mean() > 0.7
        assert known.log_score.mean() > 3.0
        assert same.log_score.mean() == pytest.approx(known.log_score.mean(), abs=0.01)

    def test_metrics_and_reliability_count_the_same_instants(self, crowd):
        targets = choose_targets(crowd.patrol.people.group, n_people=4, seed=0)
        policy = Near(3.0)
        answers = sent_answers(crowd, disclose(crowd, policy), policy)
        _, informed = score(crowd, policy, answers, targets=targets)
        group = tuple(crowd.patrol.people.group[row] for row in targets)
        metrics = posterior_metrics(informed, group=group, n_fleets=2, seed=0)
        table = reliability_table(informed, group=group, n_fleets=2, seed=0)
        assert sum(row.share for row in table) == pytest.approx(1.0)
        known = sum(row.share * row.known.value for row in table if row.share)
        assert metrics["known_share"].value == pytest.approx(known)
        assert metrics["log_score"].value == pytest.approx(informed.log_score.mean())

    def test_a_robot_that_meets_nobody_leaves_the_map(self):
        walks = straight_walks(
            *[(0, 9, (0.3 * k, 0.3 * k), (0.4, 0)) for k in range(6)],
            *[(0, 9, (3.6 + 0.3 * k, 0.3 * k), (-0.4, 0)) for k in range(6)],
        )
        network = clean_network(patrol_past(walks, (90.0, 90.0)))
        targets = choose_targets(walks.group, n_people=4, seed=0)
        policy = Ahead(1.2)
        answers = sent_answers(network, disclose(network, policy), policy)
        assert answers.is_constant
        for scores in score(network, policy, answers, targets=targets):
            np.testing.assert_allclose(scores.log_score, 0.0, atol=0.02)

    def test_one_person_is_too_few(self):
        with pytest.raises(DataError, match="record more people"):
            choose_targets(("alone",), n_people=5, seed=0)

    def test_short_walks_are_refused_in_a_line(self):
        walks = straight_walks(*[(0, 0.5, (k, 0), (0.3, 0)) for k in range(4)])
        patrol = patrol_past(walks, (1.0, 0.0))
        with pytest.raises(DataError, match="cannot learn"):
            chain_from(patrol, people=np.ones(4, bool), options=OPTIONS)


def test_identity_moves_leave_people_where_they_are():
    chain = tiny_chain(identity(3), [[1.0]], np.full(3, 1 / 3), shape=(3, 1))
    np.testing.assert_allclose(transition(chain), np.eye(3), atol=1e-9)
