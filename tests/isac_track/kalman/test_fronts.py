"""All filters and smoothers: their batches, and arguments out of range."""

from dataclasses import astuple, fields, replace

import numpy as np
import pytest
from helpers.kalman_cases import PRIOR_STD, Q, batch, some_tracks

from isac_track import kalman
from isac_track.kalman.slow_errors import SlowError, smooth_tracks

MOODS = kalman.Moods((0.05, 4.0), (2.5, 1.25))
LINEAR = {
    "last cv": lambda case, q=Q, **options: kalman.kalman_last(case, q=q, **options),
    "last ca": lambda case, q=Q: kalman.kalman_last(
        replace(case, prior_std=PRIOR_STD), q=q
    ),
    "positions": lambda case, q=Q, **options: kalman.smooth_positions(
        case, q=q, **options
    ),
}
FRONTS = LINEAR | {
    "positions, 5 passes": lambda case: kalman.smooth_positions(
        case, q=Q, passes=5, anneal=0.15
    ),
    "slow error": lambda case: smooth_tracks(case, SlowError(0.7, 2.0), q=Q, passes=3),
    "imm, last": lambda case, **options: kalman.imm_last(case, MOODS, **options),
    "imm, states": lambda case, **options: kalman.imm_states(case, MOODS, **options),
}


@pytest.fixture(params=FRONTS)
def front(request):
    """A run that returns arrays per sample or per track, in the order of the tracks."""

    def run(case):
        result = FRONTS[request.param](case)
        return result if isinstance(result, tuple) else astuple(result)

    return run


@pytest.mark.parametrize("seed", range(3))
def test_no_bit_depends_on_the_order_of_the_tracks_or_on_which_others_are_there(
    front, seed
):
    sizes = (1, 2, 3, 7, 7, 7, 7, 7, 7, 7, 30)  # ties across eight lanes
    case = batch(sizes=sizes, seed=seed)
    alone = [front(some_tracks(case, [i])) for i in range(len(sizes))]
    for order in (np.arange(11), np.random.default_rng(seed).permutation(11)):
        together = front(some_tracks(case, order))
        for values, *single in zip(together, *(alone[i] for i in order), strict=True):
            np.testing.assert_array_equal(values, np.concatenate(single))


def test_inputs_stay_as_they_are_and_may_be_read_only_strided_or_narrow(front):
    case = batch()
    given = {
        "t": np.repeat(case.t, 2)[::2],
        "xy": np.asfortranarray(case.xy),
        "variance": case.variance.copy(),
        "offsets": case.offsets.astype(np.int32),
    }
    for value in given.values():
        value.flags.writeable = False
    for values, wanted in zip(front(replace(case, **given)), front(case), strict=True):
        np.testing.assert_array_equal(values, wanted)
    for name, value in given.items():
        np.testing.assert_array_equal(value, getattr(batch(), name))


def test_no_track_at_all(front):
    for values, empty in zip(
        front(batch()), front(some_tracks(batch(), [])), strict=True
    ):
        assert empty.shape == (0, *values.shape[1:])


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("t", lambda c: c.t[:-1], "offsets must run from 0 to 49"),
        ("t", lambda c: c.t[:, None], r"t must have shape \(50,\)"),
        ("xy", lambda c: c.xy.T, r"xy must have shape \(50, 2\)"),
        ("variance", lambda c: c.variance[1:], "variance must have shape"),
        ("variance", lambda c: c.variance * 0, "variance must be positive"),
        ("variance", lambda c: c.variance + np.inf, "positive and finite"),
        ("offsets", lambda _: np.array([0, 3, 3, 50]), "at least one sample"),
        ("offsets", lambda _: np.array([1, 50]), "offsets must run"),
        ("prior_std", lambda _: (1.0, 0.0), "prior_std must be positive"),
        ("prior_std", lambda _: (np.nan, 1.0), "prior_std must be positive"),
    ],
)
def test_wrong_batches_are_named(name, change, message):
    given = {field.name: getattr(batch(), field.name) for field in fields(kalman.Batch)}
    with pytest.raises(ValueError, match=message):
        kalman.Batch(**given | {name: change(batch())})


@pytest.mark.parametrize(
    ("front", "options", "message"),
    [
        *(
            (front, {"q": q}, "q must be positive")
            for front in LINEAR
            for q in (0.0, -1.0, np.inf, np.nan)
        ),
        ("last cv", {"gate": np.nan}, "gate must be positive"),
        ("imm, last", {"gate": 0.0}, "gate must be positive"),
        ("imm, states", {"gate": np.nan}, "gate must be positive"),
        ("positions", {"passes": 0}, "passes >= 1"),
        *(
            ("positions", {"anneal": anneal}, "0 <= anneal < 1")
            for anneal in (1.0, -0.1, np.nan)
        ),
    ],
)
def test_settings_that_cannot_be_are_named(front, options, message):
    with pytest.raises(ValueError, match=message):
        FRONTS[front](batch(), **options)


@pytest.mark.parametrize("front", ["last cv", "positions", "imm, last", "imm, states"])
def test_a_prior_of_another_model_is_named(front):
    with pytest.raises(ValueError, match="prior_std must have two"):
        FRONTS[front](replace(batch(), prior_std=(1.0,)))


@pytest.mark.parametrize(
    ("q", "stay_s", "message"),
    [
        ((1.0, 0.0), (1.0, 1.0), "q must be positive"),
        ((1.0, 1.0), (1.0, np.inf), "mean times must be positive"),
    ],
)
def test_moods_that_cannot_be_are_named(q, stay_s, message):
    with pytest.raises(ValueError, match=message):
        kalman.Moods(q, stay_s)
