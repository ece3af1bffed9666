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


def test_too_few_fleets_have_no_number():
    _, known, instants = draw(n_fleets=LEAST_FLEETS - 1)
    options = {"instants": instants, "cluster": np.arange(200), "seed": 0}
    assert np.isnan(worst_tenth(known=known, **options).value)
