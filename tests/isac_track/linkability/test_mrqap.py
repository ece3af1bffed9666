"""The permutation regression against least squares, and its size on null data."""

import numpy as np
import pytest

from isac_track.linkability.mrqap import nested_permutation
from isac_track.rng import stream

BLOCK = np.repeat([0, 1, 2], [6, 7, 8])
PERSON = np.concatenate([np.arange(6), np.arange(2, 9), np.arange(8)])
SAME = (PERSON[:, None] == PERSON).astype(float)
COUNTS = BLOCK[:, None] != BLOCK


def world(rng, *, effect=0.0):
    """Scores that depend on probe, candidate, a control, and perhaps the person."""
    n = BLOCK.size
    place = rng.standard_normal(n)
    control = -np.abs(place[:, None] - place)
    row, column = rng.standard_normal((2, n))
    mutual = rng.standard_normal((n, n))
    noise = mutual + mutual.T + rng.standard_normal((n, n))
    response = 2.0 * control + row[:, None] + column + noise + effect * SAME
    return response, control[None]


def regress(response, controls, rng, n_permutations=999):
    return nested_permutation(
        response,
        SAME,
        controls,
        counts=COUNTS,
        block=BLOCK,
        rng=rng,
        n_permutations=n_permutations,
    )


def test_coefficient_and_t_are_those_of_least_squares_with_dummies():
    response, controls = world(stream(0, "test", "mrqap"), effect=3.0)
    measured = regress(response, controls, stream(1, "test", "mrqap"))
    rows, columns = np.nonzero(COUNTS)
    design = [SAME[COUNTS], controls[0][COUNTS]]
    for other in range(3):
        # A dummy of each probe against each block, and of each candidate likewise.
        for node in range(BLOCK.size):
            design.append((rows == node) & (BLOCK[columns] == other))
            design.append((columns == node) & (BLOCK[rows] == other))
    x = np.column_stack(design).astype(float)
    y = response[COUNTS]
    coefficient = np.linalg.lstsq(x, y, rcond=None)[0]
    residual = y - x @ coefficient
    free = y.size - np.linalg.matrix_rank(x)
    variance = residual @ residual / free * np.linalg.pinv(x.T @ x)[0, 0]
    assert measured.coefficient == pytest.approx(coefficient[0], abs=1e-9)
    assert measured.t == pytest.approx(coefficient[0] / np.sqrt(variance), rel=1e-9)
    assert measured.p_value < 0.01


def test_the_test_has_its_size_where_pairs_depend_and_a_control_matters():
    rng = stream(0, "test", "mrqap", "size")
    p_values = np.array([regress(*world(rng), rng).p_value for _ in range(40)])
    # 40 tests at 10 %: 0 to 10 rejections in 99.8 of 100 experiments.
    assert (p_values <= 0.1).sum() <= 10
    assert 0.3 < p_values.mean() < 0.7


def test_a_predictor_that_a_control_explains_says_nothing():
    rng = stream(0, "test", "mrqap", "collinear")
    response, _ = world(rng, effect=3.0)
    assert regress(response, SAME[None], rng).p_value == 1.0


@pytest.mark.parametrize("scale", [1e-5, 1e-10, 1e6])
def test_the_unit_of_a_predictor_changes_neither_t_nor_p(scale):
    response, controls = world(stream(0, "test", "mrqap"), effect=3.0)
    first, second = (
        nested_permutation(
            response,
            factor * SAME,
            controls,
            counts=COUNTS,
            block=BLOCK,
            rng=stream(1, "test", "mrqap"),
        )
        for factor in (1.0, scale)
    )
    assert second.t == pytest.approx(first.t, rel=1e-9)
    assert second.p_value == first.p_value
    assert second.coefficient * scale == pytest.approx(first.coefficient, rel=1e-9)


def test_wolves_and_runs_alone_do_not_count():
    rng = stream(0, "test", "mrqap", "wolves")
    response, controls = world(rng)
    lifted = response + 50.0 * (BLOCK == 1)[:, None] + 9.0 * np.arange(BLOCK.size)
    first = regress(response, controls, stream(1, "test"))
    second = regress(lifted, controls, stream(1, "test"))
    assert first.t == pytest.approx(second.t, rel=1e-6)
    assert first.p_value == second.p_value


def test_blocks_that_count_in_part_and_few_permutations_are_refused():
    response, controls = world(stream(0, "test"))
    partial = COUNTS.copy()
    partial[0, 10] = False
    with pytest.raises(ValueError, match="all pairs"):
        nested_permutation(
            response, SAME, controls, counts=partial, block=BLOCK, rng=stream(0, "t")
        )
    with pytest.raises(ValueError, match="999"):
        regress(response, controls, stream(0, "t"), n_permutations=99)
    with pytest.raises(ValueError, match="no pair"):
        nested_permutation(
            response,
            SAME,
            controls,
            counts=np.zeros_like(COUNTS),
            block=BLOCK,
            rng=stream(0, "t"),
        )
