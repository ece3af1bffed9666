from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest

from isac_track.types import (
    ESTIMATE_LIMIT_M,
    Prediction,
    Reconstruction,
    Release,
    Scenes,
    Sensed,
    Tracks,
    derived,
    end_to_end,
    sample_runs,
    within,
)

T = np.array([0.0, 0.1, 0.3, 5.0, 0.0, 2.0])  # three tracks of 3, 1 and 2 samples
XY = np.arange(12.0).reshape(6, 2)
OFFSETS = np.array([0, 3, 4, 6])
COV = np.arange(1.0, 7.0)[:, None, None] * np.array([[2.0, 0.5], [0.5, 1.0]])


def maker(kind, **usual):
    """Return a function that makes a container of these fields, some changed."""

    def make(**changes):
        return kind(**{"t": T, "xy": XY, "offsets": OFFSETS} | usual | changes)

    return make


tracks = maker(Tracks, source=("a", "b", "c"), group=("g", "g", "h"))
sensed = maker(
    Sensed,
    unit_error=XY / 10,
    sigma_raw=np.full(6, 0.5),
    information=np.full(6, 4.0),
    fid=np.full(6, 40.0),
    cov=COV,
)
release = maker(Release, sigma=np.full(6, 0.5), pseudonym=("p", "q", "r"), cov=COV)
scenes = maker(  # three agents in one scene, two steps
    Scenes,
    track=np.arange(3),
    index=np.array([7]),
    t_future=np.zeros((3, 2)),
    xy_future=np.zeros((3, 2, 2)),
    robot_start=np.zeros((1, 2)),
    robot_destination=np.ones((1, 2)),
    separation=np.zeros(1),
    conflict=np.array([True]),
    exhausted=np.zeros(1, dtype=int),
)
RAGGED = (tracks, sensed, release)
MADE = (*RAGGED, scenes)


@pytest.mark.parametrize(
    "rows",
    [[0, 1, 2], [2, 0, 1], [1], [0, 2], [1, 1, 2], [2, 1, 0], np.empty(0, dtype=int)],
)
def test_some_tracks_are_their_samples_end_to_end(rows):
    selected = release(xy=XY + np.pi).tracks(rows)
    singles = [release(xy=XY + np.pi)[row] for row in rows]
    for name in ("t", "xy", "sigma", "cov"):
        parts = [getattr(item, name) for item in singles] or [getattr(selected, name)]
        assert np.array_equal(getattr(selected, name), np.concatenate(parts))
    assert selected.offsets.tolist() == [
        0,
        *np.cumsum([item.t.size for item in singles]),
    ]
    assert selected.pseudonym == tuple("pqr"[row] for row in rows)
    Release(**{item.name: getattr(selected, item.name) for item in fields(selected)})


@pytest.mark.parametrize("row", [-1, 3])
def test_no_track_is_counted_from_the_end_or_beyond_it(row):
    with pytest.raises(IndexError):
        release().tracks([0, row])


def test_neighbours_are_one_stretch_and_one_stretch_is_a_view():
    runs, offsets = sample_runs(OFFSETS, np.array([1, 2]))
    assert (runs, offsets.tolist()) == ([(3, 6)], [0, 1, 3])
    assert np.shares_memory(end_to_end(XY, runs), XY)


@pytest.mark.parametrize("make", RAGGED)
def test_length_indexing_and_iteration_agree_on_views_of_each_track(make):
    batch = make()
    names = [
        item.name for item in fields(batch) if item.metadata.get("per") == "sample"
    ]
    assert len(batch) == 3
    assert [len(track) for track in batch] == [1, 1, 1]
    assert [track.t.tolist() for track in batch] == [[0.0, 0.1, 0.3], [5.0], [0.0, 2.0]]
    assert [track.offsets.tolist() for track in batch] == [[0, 3], [0, 1], [0, 2]]
    np.testing.assert_array_equal(batch[1].xy, XY[3:4])
    for row, track in enumerate(batch):
        for name in names:
            values = getattr(track, name)
            np.testing.assert_array_equal(values, getattr(batch[row - 3], name))
            assert np.shares_memory(values, getattr(batch, name)), name
            assert not values.flags.writeable
    for index in (3, -4):
        with pytest.raises(IndexError, match=f"track {index} of 3"):
            batch[index]


def test_one_track_keeps_its_names_and_law():
    assert [track.source + track.group for track in tracks()] == [
        ("a", "g"),
        ("b", "g"),
        ("c", "h"),
    ]
    assert (release()[-1].pseudonym, sensed(law="isotropic")[0].law) == (
        ("r",),
        "isotropic",
    )


def assert_read_only(container):
    for item in fields(container):
        value = getattr(container, item.name)
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[0] = value[0]


@pytest.mark.parametrize("make", MADE)
def test_arrays_are_read_only_no_copies_and_fields_frozen(make):
    times = T.copy()
    batch = make(t=times)
    assert np.shares_memory(batch.t, times)
    assert times.flags.writeable  # the caller may still write to it
    assert_read_only(batch)
    with pytest.raises(FrozenInstanceError):
        batch.t = T
    integers = make(xy=[[1, 2]] * 6)
    assert integers.xy.dtype == np.float64
    assert integers.offsets.dtype == np.int64


@pytest.mark.parametrize("make", MADE)
def test_derived_arrays_are_read_only_and_others_the_same_objects(make):
    batch, later = make(), T + 1.0
    new = derived(batch, t=later)
    assert type(new) is type(batch)
    assert np.shares_memory(new.t, later)
    assert later.flags.writeable
    assert_read_only(new)
    for item in fields(batch):
        assert (getattr(new, item.name) is getattr(batch, item.name)) == (
            item.name != "t"
        )
    assert batch.t.tolist() == T.tolist()
    assert (
        derived(Prediction(np.zeros((1, 1, 2)), np.zeros((1, 1, 2, 2))), cov=None).cov
        is None
    )


REFUSED = [
    *(
        (MADE, {"offsets": np.asarray(offsets)}, message)
        for offsets, message in (
            ([0, 3, 4], "offsets must run from 0 to 6"),
            ([1, 3, 6], "offsets must run from 0 to 6"),
            ([], "offsets must hold integers"),
            (np.array([], dtype=int), "offsets must run from 0 to 6"),
            ([0, 3, 3, 6], "at least one sample"),
            ([0, 4, 3, 6], "at least one sample"),
            ([0.0, 3.0, 4.0, 6.0], "offsets must hold integers"),
            ([[0, 3, 4, 6]], "offsets must have 1 dimension"),
        )
    ),
    *(
        (MADE, {"t": np.array(times)}, "strictly increasing within a track")
        for times in (
            [0.0, 0.1, 0.1, 5.0, 0.0, 2.0],  # repeated
            [0.0, 0.1, 0.05, 5.0, 0.0, 2.0],  # backwards
            [-np.inf, 0.1, 0.3, 5.0, 0.0, 2.0],
            [0.0, 0.1, 0.3, np.nan, 0.0, 2.0],  # the only sample of its track
            [0.0, 0.1, 0.3, 5.0, 0.0, np.inf],
        )
    ),
    (MADE, {"t": T[:, None]}, "t must have 1 dimension"),
    (RAGGED, {"xy": XY[:5]}, r"xy must have shape \(6, 2\)"),
    (RAGGED, {"xy": np.zeros((6, 3))}, r"xy must have shape \(6, 2\)"),
    (MADE, {"xy": np.zeros(6)}, "xy must have 2 dimension"),
    (
        MADE,
        {"xy": np.zeros((6, 2), complex)},
        "xy must hold real numbers, .* got a complex array",
    ),
    (
        MADE,
        {"t": np.ma.masked_less(T, 0.2)},
        "t must hold real numbers, all of them, got a masked",
    ),
    (RAGGED, {"xy": np.where(XY == 4, np.nan, XY)}, "a position is not finite"),
    (RAGGED, {"xy": np.where(XY == 4, np.inf, XY)}, "a position is not finite"),
    ([tracks], {"source": ("a", "b")}, "source must name 3 tracks, got 2"),
    ([tracks], {"group": ("a", "b", "c", "d")}, "group must name 3 tracks, got 4"),
    ([tracks], {"source": ("a", "b", "a")}, "source ids must be unique"),
    ([release], {"pseudonym": ("a",)}, "pseudonym must name 3 tracks, got 1"),
    ([release], {"sigma": np.ones(5)}, r"sigma must have shape \(6,\)"),
    *(
        ([sensed], {name: np.ones(4)}, f"{name} must have")
        for name in ("unit_error", "sigma_raw", "information", "fid")
    ),
    *(
        (
            [sensed],
            {"sigma_raw": np.r_[np.ones(5), wrong]},
            "sigma_raw must not be negative or N",
        )
        for wrong in (-1e-9, np.nan)
    ),
    ([scenes], {"index": np.arange(2)}, "do not fill"),
    ([scenes], {"index": np.array([], dtype=int)}, "do not fill"),
]


@pytest.mark.parametrize(("kinds", "changes", "message"), REFUSED)
def test_wrong_fields_are_refused(kinds, changes, message):
    for make in kinds:
        with pytest.raises(ValueError, match=message):
            make(**changes)
        with pytest.raises(ValueError, match=message):
            replace(make(), **changes)


def test_a_density_may_be_unbounded_a_sigma_missing_and_scenes_count_their_agents():
    assert np.isinf(sensed(fid=np.full(6, np.inf)).fid).all()
    assert release().without_sigma()[1].sigma is None
    assert (len(scenes()), scenes().n_agents) == (1, 3)


def covariances(*values):
    """Covariances of 2 tracks and 3 steps; the last has these values."""
    cov = np.tile(np.eye(2), (2, 3, 1, 1))
    cov[1, 2] = np.reshape(values, (2, 2))
    return cov


@pytest.mark.parametrize(
    "values",
    [
        (0, 0, 0, 0),
        (1e24, 0, 0, 0),
        (1, 1, 1, 1),  # on a line
        (3, 1 + 1e-7, 1 - 1e-7, 2),  # single precision
        (1e6, 0, 0, -1e-3),
        (1, 1 + 1e-8, 1 + 1e-8, 1),
        (1e-20, 1e-20, 1e-20, 1e-20),
    ],
)
def test_a_covariance_may_be_off_by_rounding(values):
    prediction = Prediction(np.zeros((2, 3, 2)), covariances(*values))
    assert prediction.cov[1, 2].ravel().tolist() == list(map(float, values))


def test_a_single_precision_covariance_is_one():
    """Rounded products of random matrices, not symmetric to the last bit."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(50, 20, 2, 2)) * 10.0 ** rng.uniform(-6, 6, (50, 20, 2, 1))
    cov = (root @ np.swapaxes(root, -2, -1)).astype(np.float32)
    cov[..., 0, 1] *= 1 + 1e-7
    assert Prediction(np.zeros((50, 20, 2)), cov).cov.dtype == np.float64


def test_an_estimate_may_lie_at_the_limit_is_read_only_and_needs_no_claim():
    xy = ESTIMATE_LIMIT_M * np.array([[-1.0, 1.0], [0.5, 0.0]])
    std = np.array([0.0, 1e12])
    estimate = Reconstruction(xy, std)
    assert (estimate.xy.tolist(), estimate.std.tolist()) == (xy.tolist(), std.tolist())
    assert Prediction(xy[None]).mean.tolist() == [xy.tolist()]
    for container in (
        estimate,
        Prediction(np.zeros((2, 3, 2)), np.zeros((2, 3, 2, 2))),
    ):
        assert_read_only(container)
    assert xy.flags.writeable
    assert Reconstruction([[1, 2]]).std is Prediction(np.zeros((2, 3, 2))).cov is None
    assert Reconstruction([[1, 2]]).xy.dtype == np.float64
    # Without a shared sample the estimates are empty.
    assert Prediction(np.zeros((0, 3, 2)), np.zeros((0, 3, 2, 2))).mean.shape == (
        0,
        3,
        2,
    )
    assert Reconstruction(np.zeros((0, 2)), np.zeros(0)).xy.shape == (0, 2)


@pytest.mark.parametrize(
    ("kind", "estimate", "spread", "message"),
    [
        (
            Prediction,
            np.zeros((2, 3, 3)),
            None,
            r"mean must have shape \(N, H, 2\), got",
        ),
        (Prediction, np.zeros((3, 2)), None, "3 dimension"),
        (Prediction, np.full((2, 3, 2), np.nan), None, "not finite"),
        (
            Prediction,
            np.full((1, 1, 2), 1.01e12),
            None,
            r"^a predicted .* beyond 1e\+12 m$",
        ),
        (
            Prediction,
            np.full((1, 1, 2), -1.01e12),
            None,
            r"^a predicted .* beyond 1e\+12 m$",
        ),
        (
            Reconstruction,
            np.array([[0, 1.01e12]]),
            None,
            r"^a reconstructed .* beyond 1e\+12 m$",
        ),
        (
            Reconstruction,
            np.array([[0, -1.01e12]]),
            None,
            r"^a reconstructed .* beyond 1e\+12 m$",
        ),
        (Prediction, np.zeros((2, 3, 2)), np.zeros((2, 4, 2, 2)), r"\(2, 3, 2, 2\)"),
        (Prediction, np.zeros((2, 3, 2)), np.zeros((2, 3, 2)), "4 dimension"),
        *(
            (Prediction, np.zeros((2, 3, 2)), covariances(*values), message)
            for values, message in (
                ((1, 0, 0, np.nan), "not finite"),
                ((np.inf, 0, 0, 1), "not finite"),
                ((1.01e24, 0, 0, 1), r"beyond 1e\+24 m\^2"),
                ((1, 0.1, 0, 1), "not symmetric"),
                ((0, 1e-9, 0, 0), "not symmetric"),
                ((-1, 0, 0, 1), "not positive semidefinite"),
                ((1, 0, 0, -1e-4), "not positive semidefinite"),
                ((1, 1.1, 1.1, 1), "not positive semidefinite"),
                ((0, 1, 1, 0), "not positive semidefinite"),
                # Also at a small scale.
                ((1e-8, 2e-8, 2e-8, 1e-8), "not positive semidefinite"),
            )
        ),
        (
            Reconstruction,
            np.zeros(4),
            None,
            r"xy must have 2 dimension\(s\), got shape \(4,\)",
        ),
        (
            Reconstruction,
            np.zeros((4, 3)),
            None,
            r"xy must have shape \(M, 2\), got \(4, 3\)",
        ),
        (Reconstruction, np.array([[0.0, np.nan]]), None, "position is not finite"),
        (
            Reconstruction,
            np.zeros((4, 2)),
            np.zeros(3),
            r"std must have shape \(4,\), got \(3,\)",
        ),
        (
            Reconstruction,
            np.zeros((4, 2)),
            np.zeros((4, 2)),
            "std must have 1 dimension",
        ),
        (
            Reconstruction,
            np.zeros((2, 2)),
            np.array([0.1, -0.1]),
            "finite and not negative",
        ),
        (
            Reconstruction,
            np.zeros((2, 2)),
            np.array([0.1, np.inf]),
            "finite and not negative",
        ),
        (Reconstruction, np.zeros((1, 2)), np.array([1.01e12]), r"at most 1e\+12 m"),
    ],
)
def test_a_wrong_estimate_is_refused(kind, estimate, spread, message):
    with pytest.raises(ValueError, match=message):
        kind(estimate, spread)


def test_some_samples_with_their_covariances():
    rows = np.array([0, 2, 3, 5])
    part = release().samples(rows, offsets=np.array([0, 2, 3, 4]))
    for name in ("t", "xy", "sigma", "cov"):
        assert np.array_equal(getattr(part, name), getattr(release(), name)[rows])
    assert part.pseudonym == release().pseudonym


def test_without_sigma_nothing_says_how_large_errors_are():
    hidden = release().without_sigma()
    assert hidden.sigma is hidden.cov is None
    assert hidden.tracks([1]).cov is None


@pytest.mark.parametrize("make", [sensed, release])
@pytest.mark.parametrize(
    ("cov", "message"),
    [
        (COV[:5], r"cov must have shape \(6, 2, 2\)"),
        (np.full(6, 0.5), "3 dimension"),
        (COV * np.array([[1.0, 0.5], [1.0, 1.0]]), "a covariance is not symmetric"),
        (-COV, "a covariance is not positive semidefinite"),
        (COV * np.nan, "a covariance is not finite"),
    ],
)
def test_a_wrong_covariance_is_refused(make, cov, message):
    with pytest.raises(ValueError, match=message):
        make(cov=cov)


def test_within_both_bounds():
    assert within(np.array([1.0, 2.0]), 1.0, 2.0)
    assert within(np.zeros(0), 1.0, 2.0)
    for outside in (0.9, 2.1, np.nan, np.inf, -np.inf):
        assert not within(np.array([1.5, outside, 1.5]), 1.0, 2.0)
