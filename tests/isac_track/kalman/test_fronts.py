"""What all filters and smoothers have in common: batches, and arguments that cannot be."""

import numpy as np
import pytest
from helpers.kalman_cases import batch, no_tracks, some_tracks

from isac_track import kalman

MODES = {
    "q": np.array([0.05, 0.5, 4.0]),
    "rates": np.array([[0.0, 0.3, 0.1], [0.7, 0.0, 0.01], [2.0, 9.0, 0.0]]),
    "initial_probability": np.array([0.5, 0.3, 0.2]),
}


def smoothed(**case):
    rest = {name: case[name] for name in ("t", "offsets", "q", "rates")}
    return kalman.imm_smoother(filtered=kalman.imm_filter(**case), **rest)


FRONTS = {
    "last cv": (kalman.kalman_last, {"model": "cv"}),
    "last ca": (kalman.kalman_last, {"model": "ca"}),
    "positions": (kalman.smooth_positions, {}),
    "positions, 5 passes": (kalman.smooth_positions, {"passes": 5, "anneal": 0.15}),
    "imm, last": (kalman.imm_last, MODES),
    "imm, every sample": (kalman.imm_filter, MODES),
    "imm, smoothed": (smoothed, MODES),
}


@pytest.fixture(params=FRONTS)
def front(request):
    return FRONTS[request.param]


def make(options, **changes):
    return batch(d=3 if options.get("model") == "ca" else 2, **changes) | options


def arrays(result):
    """Per sample or per track, in the order of the tracks."""
    if isinstance(result, tuple):
        return result
    return tuple(getattr(result, name) for name in result.__slots__)


@pytest.mark.parametrize("seed", range(3))
def test_no_bit_depends_on_the_order_of_the_tracks_or_on_which_others_are_there(front, seed):
    run, options = front
    sizes = (1, 2, 3, 7, 7, 7, 7, 7, 7, 7, 30)  # ties across eight lanes
    case = make(options, sizes=sizes, seed=seed)
    alone = [arrays(run(**some_tracks(case, [i]))) for i in range(len(sizes))]
    for order in (np.arange(11), np.random.default_rng(seed).permutation(11)):
        together = arrays(run(**some_tracks(case, order)))
        for values, *single in zip(together, *(alone[i] for i in order), strict=True):
            np.testing.assert_array_equal(values, np.concatenate(single))


def test_inputs_stay_as_they_are_and_may_be_read_only_strided_or_narrow(front):
    run, options = front
    case = make(options)
    expected = arrays(run(**case))
    copies = {name: np.copy(value) for name, value in case.items()}
    other = case | {
        "xy": np.asfortranarray(case["xy"]),
        "t": np.repeat(case["t"], 2)[::2],
        "offsets": case["offsets"].astype(np.int32),
    }
    for value in other.values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    for values, wanted in zip(arrays(run(**other)), expected, strict=True):
        np.testing.assert_array_equal(values, wanted)
    for name, value in copies.items():
        np.testing.assert_array_equal(other[name], value)
    for value in MODES.values():
        value.flags.writeable = True


def test_no_track_at_all(front):
    run, options = front
    case = make(options)
    for values, empty in zip(arrays(run(**case)), arrays(run(**no_tracks(case))), strict=True):
        assert empty.shape == (0, *values.shape[1:])


WRONG = {
    "t of a wrong length": ("t", lambda c: c["t"][:-1], "offsets must run from 0 to 49"),
    "t with two dimensions": ("t", lambda c: c["t"][:, None], "t must have shape"),
    "t that stands still": ("t", lambda c: np.repeat(c["t"][::2], 2), "strictly increasing"),
    "t not a number": ("t", lambda c: c["t"] * np.nan, "strictly increasing"),
    "an infinite time": ("t", lambda c: np.append(c["t"][:-1], np.inf), "finite"),
    "xy of a wrong shape": ("xy", lambda c: c["xy"].T, r"xy must have shape \(50, 2\)"),
    "a position not a number": ("xy", lambda c: c["xy"] * np.nan, "xy must be finite"),
    "a variance too few": ("variance", lambda c: c["variance"][1:], "variance must have shape"),
    "no variance": ("variance", lambda c: c["variance"] * 0, "variance must be positive"),
    "an infinite variance": ("variance", lambda c: c["variance"] + np.inf, "must be finite"),
    "an empty track": ("offsets", lambda _: np.array([0, 3, 3, 50]), "at least one sample"),
    "no offsets": ("offsets", lambda _: np.array([], dtype=int), "offsets must run"),
    "offsets not from zero": ("offsets", lambda _: np.array([1, 50]), "offsets must run"),
    "offsets that are no integers": ("offsets", lambda c: c["offsets"] * 1.0, "integers"),
    "q of zero": ("q", lambda c: 0.0 * c["q"], "q must be positive"),
    "q infinite": ("q", lambda c: np.inf * c["q"], "q must be (positive|finite)"),
    "a mean too few": ("initial_mean", lambda c: c["initial_mean"][1:], "initial_mean must have"),
    "a prior of another model": ("initial_cov", lambda _: np.ones((4, 4, 4)), "must have shape"),
    "an asymmetric prior": (
        "initial_cov",
        lambda c: c["initial_cov"] + np.triu(np.ones(c["initial_cov"].shape[1:]), 1),
        "symmetric",
    ),
    "a singular prior": ("initial_cov", lambda c: c["initial_cov"] * 0, "positive definite"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_arguments_are_named(front, what):
    run, options = front
    case = make(options)
    name, change, message = WRONG[what]
    with pytest.raises(ValueError, match=message):
        run(**case | {name: change(case)})


@pytest.mark.parametrize(
    ("front", "change", "message"),
    [
        ("last cv", {"model": "ct"}, "model must be one of"),
        ("last cv", {"gate": np.nan}, "gate must be positive"),
        ("positions", {"passes": 0}, "passes >= 1"),
        ("positions", {"passes": -1}, "passes >= 1"),
        ("positions", {"anneal": 1.0}, "anneal < 1"),
        ("positions", {"anneal": -0.1}, "0 <= anneal"),
        ("positions", {"anneal": np.nan}, "0 <= anneal"),
        ("imm, last", {"q": np.array([1.0])}, "J >= 2"),
        ("imm, last", {"q": np.array([1.0, np.nan, 1.0])}, "q must be finite"),
        ("imm, last", {"rates": np.ones((2, 2))}, "rates must have shape"),
        ("imm, last", {"rates": -MODES["rates"]}, "rates must be finite and not"),
        ("imm, last", {"initial_probability": np.array([0.5, 0.6, 0.1])}, "add up to 1"),
        ("imm, last", {"initial_probability": np.array([1.5, -0.5, 0.0])}, "not be negative"),
        ("imm, last", {"gate": 0.0}, "gate must be positive"),
    ],
    indirect=["front"],
)
def test_settings_that_cannot_be_are_named(front, change, message):
    run, options = front
    with pytest.raises(ValueError, match=message):
        run(**make(options) | change)


def test_the_smoother_checks_that_the_filter_ran_on_these_samples():
    filtered = kalman.imm_filter(**make(MODES))
    other = make(MODES, sizes=(5,))
    with pytest.raises(ValueError, match=r"filtered\.mean must have shape"):
        kalman.imm_smoother(
            filtered=filtered, **{name: other[name] for name in ("t", "offsets", "q", "rates")}
        )
