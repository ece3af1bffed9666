"""Descriptors beyond the metric suite: refusals, segments and intervals."""

from __future__ import annotations

import re
from itertools import pairwise
from math import pi

import numpy as np
import pytest
from helpers import oracles

from isac_track.config import PrivacySettings
from isac_track.privacy import (
    alignment_error,
    described,
    exposure,
    leakage_indicator,
    mean_interval_s,
)
from isac_track.rng import stream


def raises(message):
    return pytest.raises(ValueError, match=f"^{re.escape(message)}$")


@pytest.mark.parametrize(
    ("shared", "truth"),
    [
        ((3, 2), (2, 2)),
        ((3, 2), (1, 2)),
        ((3, 3), (3, 3)),
        ((3,), (3,)),
        ((3, 2, 1),) * 2,
    ],
)
def test_positions_come_in_pairs(shared, truth):
    with raises(
        f"shared_xy and true_xy must have one shape (M, 2), got {shared} and {truth}"
    ):
        leakage_indicator(
            shared_xy=np.zeros(shared), true_xy=np.zeros(truth), epsilon_m=0.3
        )


@pytest.mark.parametrize("epsilon_m", [0.0, -0.3, np.nan])
def test_epsilon_is_positive(epsilon_m):
    with raises(f"epsilon_m must be positive, got {epsilon_m}"):
        leakage_indicator(
            shared_xy=np.zeros((1, 2)), true_xy=np.zeros((1, 2)), epsilon_m=epsilon_m
        )


def test_segments_end_with_their_track():
    leaked = np.array([sample == "1" for sample in "001111001110011"])
    result = exposure(
        leaked=leaked,
        t=np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15], dtype=float),
        offsets=np.array([0, 4, 8, 9, 15]),
    )
    assert result.segments.tolist() == [1, 1, 1, 2]
    # The samples at 9 and 11 s last 2 and 1.5 s, those at 14 and 15 s one each.
    assert result.mel_s.tolist() == pytest.approx([2.0, 2.0, np.nan, 3.5], nan_ok=True)
    nothing = exposure(leaked=~leaked[2:4], t=np.arange(2.0), offsets=np.array([0, 2]))
    assert nothing.segments.tolist() == [0]


@pytest.mark.parametrize(
    ("leaked", "t"),
    [((3,), (4,)), ((4,), (3,)), ((3, 1), (3, 1)), ((3, 1), (3,)), ((), ())],
)
def test_every_sample_has_a_time(leaked, t):
    with raises(f"leaked and t must have one shape (M,), got {leaked}, {t}"):
        exposure(leaked=np.zeros(leaked, bool), t=np.zeros(t), offsets=np.array([0, 3]))


@pytest.mark.parametrize(
    "offsets", [[1, 3], [0, 2], [0, 4], [0, 1, 1, 3], [0, 2, 1, 3]]
)
def test_offsets(offsets):
    with raises("offsets must run from 0 to M without an empty trajectory"):
        exposure(leaked=np.zeros(3, bool), t=np.arange(3.0), offsets=np.array(offsets))


@pytest.mark.parametrize("intervals", ["segment", "trajectory"])
@pytest.mark.parametrize("is_moved", [False, True])
def test_descriptors_in_one_pass_follow_their_definitions(is_moved, intervals):
    rng = stream(0, "test", "described")
    sizes = np.array([1, 1, 1, 1, 1, 1, 2, 3, 7, 40, 300])
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    t = np.cumsum(rng.uniform(0.05, 0.5, offsets[-1]))
    truth = rng.normal(size=(offsets[-1], 2))
    xy = truth + rng.normal(scale=0.6 if is_moved else 0.3, size=truth.shape)
    moved_xy, moves = xy, (xy, xy)
    if is_moved:  # halfway to the truth, in a frame turned by 2 and shifted
        turned = np.array([[np.cos(2.0), np.sin(2.0)], [-np.sin(2.0), np.cos(2.0)]])
        moved_xy = (xy + truth) / 2.0
        moves = (moved_xy @ turned + 5.0, xy @ turned + 5.0)
    moved = {"moved": moves, "turn": np.exp(2j)} if is_moved else {}
    settings = PrivacySettings(intervals=intervals)
    descriptors = described(
        xy=xy, truth=truth, t=t, offsets=offsets, settings=settings, **moved
    )
    leaked = leakage_indicator(shared_xy=moved_xy, true_xy=truth, epsilon_m=0.3)
    assert set(leaked[:6]) == {False, True}  # also of a single sample
    expected = exposure(leaked=leaked, t=t, offsets=offsets, intervals=intervals)
    by_oracle = oracles.total_exposure(
        leaked=leaked, t=t, offsets=offsets, intervals=intervals
    )
    np.testing.assert_allclose(
        [expected.plr, expected.ael_s, expected.mel_s], by_oracle[:3]
    )
    parts = np.split(((moved_xy - truth) ** 2).sum(axis=1), offsets[1:-1])
    rows = (expected.plr, expected.ael_s, expected.mel_s, expected.segments)
    np.testing.assert_allclose(descriptors[:4], rows, rtol=1e-12)
    np.testing.assert_allclose(
        descriptors[4], [part.mean() for part in parts], rtol=1e-11
    )
    away_m = [np.sqrt(part) for part in parts]
    np.testing.assert_allclose(
        descriptors[5], [(part < 0.4).mean() for part in away_m], rtol=1e-12
    )
    np.testing.assert_allclose(
        descriptors[6], [np.median(part) for part in away_m], rtol=1e-9
    )


def test_mean_interval():
    t = np.array([0.0, 1.0, 2.0, 10.0, 7.0, 0.0, pi])
    interval_s = mean_interval_s(t=t, offsets=np.array([0, 4, 5, 7]))
    assert interval_s.tolist() == pytest.approx(
        [10 / 3, np.nan, pi], rel=1e-15, nan_ok=True
    )


def test_the_alignment_error_remains_after_any_turn_and_shift():
    rng = np.random.default_rng(8)
    sizes = (1, 2, 3, 40)
    offsets = np.append(0, np.cumsum(sizes))
    truth = rng.normal(size=(offsets[-1], 2)).cumsum(axis=0)
    noisy, mirrored = truth + rng.normal(size=truth.shape), truth * [1.0, -1.0]
    turned = truth @ [[0.6, 0.8], [-0.8, 0.6]] + [500.0, -900.0]
    for xy in (noisy, mirrored, turned):
        error_m = alignment_error(xy=xy, truth=truth, offsets=offsets)
        rows = [slice(*ends) for ends in pairwise(offsets)][1:]
        assert error_m[1:] == pytest.approx(
            [oracles.aligned(xy[own], truth[own]) for own in rows], abs=1e-6
        )
        assert np.isnan(error_m[0])
    assert error_m[1:] == pytest.approx(0.0, abs=1e-6)
