"""Gait of passages whose strides are known, and a metric of what lasts."""

import numpy as np
import pytest
from helpers.walks import context, moved, walk_release

from attacks.linkage.gait import NAMES, Gait, features, learn_metric
from attacks.linkage.learning import log_rank
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream
from isac_track.types import Release, derived


def stride(
    *,
    length_s=8.0,
    speed_m_s=1.2,
    stride_hz=0.9,
    sway_m=0.03,
    surge_m=0.012,
    skew_m=0.0,
    noise_m=0.0,
    seed=0,
):
    """A passage that sways once, and surges twice, in a stride."""
    rng = stream(seed, "test", "gait")
    t = np.arange(0.0, length_s, 0.04)
    phase = 2 * np.pi * stride_hz * t + rng.uniform(0, 2 * np.pi)
    x = speed_m_s * t + surge_m * np.sin(2 * phase) + skew_m * np.sin(phase)
    xy = np.column_stack([x, sway_m * np.sin(phase)])
    return t, xy + noise_m * rng.standard_normal(xy.shape)


def feature(walks, name):
    return features(walk_release(walks))[:, NAMES.index(name)]


# Slow strides come out up to 12 % too slow, as the docstring of `features` says.
@pytest.mark.parametrize(
    ("stride_hz", "bias"), [(0.6, 0.12), (0.7, 0.08), (0.8, 0.06), (1.0, 0.06)]
)
def test_cadence_speed_and_step_length_are_those_of_the_walk(stride_hz, bias):
    walks = [stride(stride_hz=stride_hz, seed=k) for k in range(5)]
    cadence_hz = np.exp(feature(walks, "cadence"))
    assert cadence_hz == pytest.approx(2 * stride_hz, rel=bias)
    assert np.exp(feature(walks, "speed")) == pytest.approx(1.2, rel=0.03)
    steps_m = np.exp(feature(walks, "step length"))
    assert steps_m * cadence_hz == pytest.approx(1.2, rel=0.03)


def test_amplitudes_grow_with_sway_and_surge():
    narrow, wide = (feature([stride(sway_m=sway)], "sway") for sway in (0.02, 0.04))
    assert (wide - narrow)[0] == pytest.approx(np.log(2), abs=0.1)
    weak, strong = (feature([stride(surge_m=surge)], "surge") for surge in (0.01, 0.02))
    assert (strong - weak)[0] == pytest.approx(np.log(2), abs=0.15)


def test_a_limp_shows_as_asymmetry():
    even, limping = (
        feature([stride(skew_m=skew)], "left-right asymmetry")[0] for skew in (0, 0.02)
    )
    assert limping > even + 1.0


def test_noise_moves_amplitudes_less_than_without_a_smoother():
    clean = feature([stride()], "sway")
    noisy = feature([stride(noise_m=0.01, seed=k) for k in range(8)], "sway")
    assert np.abs(noisy - clean).max() < 0.35


def test_frame_and_clock_do_not_matter_nor_do_declared_errors():
    release = walk_release([stride(seed=k, stride_hz=0.7 + 0.1 * k) for k in range(4)])
    turned = moved(release, seed=3)
    assert features(turned) == pytest.approx(features(release), abs=1e-6)
    declared = derived(release, sigma=np.linspace(0.1, 2.0, release.t.size))
    assert np.array_equal(features(declared), features(release))


def test_passages_of_any_length_have_finite_features():
    walks = [stride(length_s=length_s) for length_s in (0.1, 1.5, 3.0, 60.0, 75.0)]
    values = features(walk_release(walks))
    assert np.isfinite(values).all()
    assert not values[:2].any()
    still = np.arange(0.0, 5.0, 0.04), np.zeros((125, 2))
    assert np.isfinite(features(walk_release([still]))).all()


def returning(seed, n=24):
    """Two passages of each of n people, at a speed of the day and an own gait."""
    rng = stream(seed, "test", "returning")
    habits = rng.standard_normal((n, 2))
    sides = []
    for side in range(2):
        walks = []
        for row in range(n):
            speed = rng.uniform(0.7, 1.4)
            cadence = 0.9 * np.sqrt(speed) * np.exp(0.1 * habits[row, 0])
            walks.append(
                stride(
                    speed_m_s=speed,
                    stride_hz=cadence,
                    sway_m=0.03 * np.exp(0.3 * habits[row, 1]),
                    seed=100 * seed + 50 * side + row,
                )
            )
        sides.append(walk_release(walks))
    return LinkageTrainingSet(*sides, np.arange(n))


def test_gait_links_people_at_another_speed_and_learning_helps():
    train, test = returning(1), returning(2)
    blind = Gait().fit(context())(test.probe, test.gallery)
    informed = Gait().fit(context(train))(test.probe, test.gallery)
    by_chance = log_rank(np.zeros((24, 24)), mate=test.mate)
    assert log_rank(informed, mate=test.mate) < by_chance - 0.7
    assert log_rank(informed, mate=test.mate) < log_rank(blind, mate=test.mate)


def test_the_learnt_slope_of_cadence_is_that_of_the_crowd():
    metric = learn_metric(returning(3, n=60), shrinkage=0.5, q=1.0)
    assert metric.slopes[NAMES.index("cadence")] == pytest.approx(0.5, abs=0.2)
    assert np.linalg.eigvalsh(metric.matrix).min() > -1e-9


def test_a_pair_has_a_score_of_its_own():
    test = returning(4, n=12)
    link = Gait().fit(context(returning(5)))
    whole = link(test.probe, test.gallery)
    part: Release = test.gallery.tracks([7, 2])
    assert link(test.probe.tracks([3]), part) == pytest.approx(whole[[3]][:, [7, 2]])


def test_parameters_out_of_range_are_refused():
    with pytest.raises(ValueError, match="shrinkage"):
        Gait(shrinkage=1.5)
    with pytest.raises(ValueError, match="q must"):
        Gait(q=0.0)
