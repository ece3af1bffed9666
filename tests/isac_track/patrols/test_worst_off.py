"""The worst-off tenth against a plain loop, and for people of equal exposure."""

import numpy as np
import pytest

from isac_track.patrols.worst_off import LEAST_FLEETS, worst_tenth


def draw(n_people=200, n_fleets=20, share=0.3, seed=0, spread=0.0):
    """Known instants of people whose true shares spread around one."""
    rng = np.random.default_rng(seed)
    truth = np.clip(share + spread * rng.standard_normal(n_people), 0, 1)
    instants = rng.integers(20, 60, n_people)
    return (
        truth,
        rng.binomial(instants[:, None], truth[:, None], (n_people, n_fleets)),
        instants,
    )


def test_it_is_the_mean_on_one_half_of_the_tenth_that_the_other_half_chose():
    _, known, instants = draw(n_people=40, spread=0.2)
    estimate = worst_tenth(
        known=known, instants=instants, cluster=np.arange(40), seed=0
    )
    scores = []
    for choosing, scoring in ((0, 1), (1, 0)):
        by_person = known[:, choosing::2].sum(axis=1) / instants
        chosen = np.argsort(-by_person, kind="stable")[:4]
        scores.append(np.mean(known[chosen, scoring::2] / instants[chosen, None]))
    assert estimate.value == pytest.approx(np.mean(scores))
    assert estimate.ci_low < estimate.value < estimate.ci_high


def test_chance_adds_no_exposure():
    # All are equally exposed: a quantile of noisy shares would be two points higher.
    values = []
    for seed in range(30):
        _, known, instants = draw(seed=seed)
        shares = np.sort(known.mean(axis=1) / instants)[-20:]
        assert shares.mean() > 0.32
        values.append(
            worst_tenth(
                known=known, instants=instants, cluster=np.arange(200), seed=0
            ).value
        )
    # 600 binomial means of 400 instants: the standard error is 0.001.
    assert np.mean(values) == pytest.approx(0.3, abs=0.003)


def test_differing_people_are_identified():
    truth, known, instants = draw(spread=0.15)
    estimate = worst_tenth(
        known=known, instants=instants, cluster=np.arange(200), seed=0
    )
    assert estimate.value == pytest.approx(np.sort(truth)[-20:].mean(), abs=0.02)


@pytest.mark.parametrize("n_people", [30, 41, 200])
def test_the_order_of_people_does_not_matter(n_people):
    # Few instants: many people have equal shares, at the edge of the tenth too.
    rng = np.random.default_rng(n_people)
    instants = rng.integers(1, 4, n_people)
    known = rng.binomial(instants[:, None], 0.05, (n_people, 20))
    cluster = rng.integers(0, n_people, n_people)
    _, cluster = np.unique(cluster, return_inverse=True)
    order = rng.permutation(n_people)
    first = worst_tenth(known=known, instants=instants, cluster=cluster, seed=0)
    second = worst_tenth(
        known=known[order], instants=instants[order], cluster=cluster[order], seed=0
    )
    assert second.value == pytest.approx(first.value, abs=1e-12)
    np.testing.assert_allclose(second.replicates, first.replicates, atol=1e-12)


def test_equals_at_the_edge_of_the_tenth_count_with_equal_parts():
    # The tenth of 20 people are two. All are equal in the even fleets; in the odd
    # fleets the first person alone is known.
    known = np.ones((20, 16), dtype=np.int64)
    known[1:, 1::2] = 0
    estimate = worst_tenth(
        known=known, instants=np.ones(20, dtype=np.int64), cluster=np.arange(20), seed=0
    )
    # Even fleets choose all with a tenth of their weight: 1/20. Odd fleets score 1.
    assert estimate.value == pytest.approx((1 / 20 + 1.0) / 2)


def test_too_few_fleets_have_no_number():
    _, known, instants = draw(n_fleets=LEAST_FLEETS - 1)
    options = {"instants": instants, "cluster": np.arange(200), "seed": 0}
    assert np.isnan(worst_tenth(known=known, **options).value)
