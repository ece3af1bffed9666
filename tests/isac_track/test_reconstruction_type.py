"""What an attack may hand back: positions for every sample, and standard deviations or none."""

import numpy as np
import pytest

from isac_track.types import Reconstruction


def test_positions_and_claims_come_back_and_are_read_only():
    xy, std = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.0, 0.5])
    found = Reconstruction(xy, std)
    assert found.xy.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert found.std.tolist() == [0.0, 0.5]
    for array in (found.xy, found.std):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 9.0
    assert xy.flags.writeable  # what the caller holds stays theirs to write


def test_no_claim_is_needed():
    assert Reconstruction(np.zeros((3, 2))).std is None


def test_whole_numbers_are_taken_as_floats():
    assert Reconstruction([[1, 2]]).xy.dtype == np.float64


def test_nothing_was_shared_nothing_is_reconstructed():
    assert Reconstruction(np.zeros((0, 2)), np.zeros(0)).xy.shape == (0, 2)


@pytest.mark.parametrize(
    ("xy", "std", "message"),
    [
        (np.zeros(4), None, r"xy must have 2 dimension\(s\), got shape \(4,\)"),
        (np.zeros((4, 3)), None, r"xy must have shape \(M, 2\), got \(4, 3\)"),
        (np.zeros((2, 2, 2)), None, "xy must have 2 dimension"),
        (np.array([[0.0, np.nan]]), None, "position is not finite"),
        (np.array([[np.inf, 0.0]]), None, "position is not finite"),
        (np.zeros((4, 2)), np.zeros(3), r"std must have shape \(M,\), got \(3,\)"),
        (np.zeros((4, 2)), np.zeros((4, 2)), "std must have 1 dimension"),
        (np.zeros((2, 2)), np.array([0.1, -0.1]), "finite and not negative"),
        (np.zeros((2, 2)), np.array([0.1, np.nan]), "finite and not negative"),
        (np.zeros((2, 2)), np.array([0.1, np.inf]), "finite and not negative"),
    ],
)
def test_anything_else_is_refused(xy, std, message):
    with pytest.raises(ValueError, match=message):
        Reconstruction(xy, std)
