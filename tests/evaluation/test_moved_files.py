"""A file that is shifted gives the same run, and one that is turned nearly so."""

import numpy as np
import pytest
from helpers.small_runs import smoke
from helpers.walkers import walkers

from evaluation import run

UTM_M = (512_345.67, 5_476_543.21)
TURN = np.array([[np.cos(2.1), -np.sin(2.1)], [np.sin(2.1), np.cos(2.1)]])
MIRROR = np.array([[-1.0, 0.0], [0.0, 1.0]])
AXES = {
    "mechanisms": ("raw", "fixed:0.7", "fid:100"),
    "attacks": ("kalman_rts", "kinematic", "histogram"),
    "tasks": ("rerelease", "handover-1s"),
}
KEYS = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]


def write(path, tracks, *, matrix=None, shift_m=(0.0, 0.0), clock_s=0.0):
    """Write tracks to the last digit, elsewhere and at another time."""
    xy = tracks.xy @ (np.eye(2) if matrix is None else matrix).T + np.array(shift_m)
    owner = np.repeat(tracks.source, np.diff(tracks.offsets))
    rows = zip((tracks.t + clock_s).tolist(), owner, *xy.T.tolist(), strict=True)
    lines = [f"{t!r},{person},{x!r},{y!r}" for t, person, x, y in rows]
    path.write_text("\n".join(["t,id,x,y", *lines, ""]), encoding="utf-8")
    return path


def summary(path, **settings):
    """All metrics of a run of a recording."""
    whole = smoke(path, path.with_suffix(""), **settings)
    result = run(whole, progress=False, pictures=False).summary
    # Of controls that see one number a track many joint matchings have the same total,
    # to rounding.
    has_many = result["consumer"].str.contains("control-") & (
        result["metric"] == "rank1_assigned"
    )
    result = result[~has_many]
    return result.drop(columns="dataset").set_index(KEYS[1:])


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    return tmp_path_factory.mktemp("moved"), walkers(60)


@pytest.fixture(scope="module")
def ours(walks):
    folder, tracks = walks
    return summary(write(folder / "file.csv", tracks), **AXES)


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("near", {"shift_m": (3.7, -41.0)}),
        ("utm", {"shift_m": UTM_M}),
        ("clock", {"clock_s": 1e6}),
    ],
)
def test_a_file_in_another_place_or_on_another_clock_changes_no_metric(
    walks, ours, name, how
):
    folder, tracks = walks
    moved = summary(write(folder / f"{name}.csv", tracks, **how), **AXES)
    assert moved.index.equals(ours.index)
    for column in ("value", "ci_low", "ci_high", "n"):
        assert np.allclose(
            moved[column], ours[column], rtol=1e-6, atol=1e-6, equal_nan=True
        )


def moved_share(moved, ours):
    """The share of metrics that moved by more than half of their half-width."""
    assert moved.index.equals(ours.index)
    half = (ours["ci_high"] - ours["ci_low"]) / 2
    apart = ((moved["value"] - ours["value"]).abs() / half)[half > 0]
    assert apart.size > 500
    return float((apart > 0.5).mean())


@pytest.fixture(scope="module")
def by_another_seed(walks, ours):
    folder, tracks = walks
    return moved_share(
        summary(write(folder / "seed.csv", tracks), seed=1, **AXES), ours
    )


@pytest.mark.parametrize(("name", "matrix"), [("turned", TURN), ("mirrored", MIRROR)])
def test_a_turned_file_moves_fewer_metrics_than_another_seed(
    walks, ours, by_another_seed, name, matrix
):
    """The station stands in another direction from the crowd, some 20 m wide."""
    folder, tracks = walks
    moved = summary(write(folder / f"{name}.csv", tracks, matrix=matrix), **AXES)
    assert moved_share(moved, ours) < by_another_seed / 2
