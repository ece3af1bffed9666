"""No room, no folder, no lock: one line with the way out, and what is finished is kept."""

import resource

import pytest
from helpers.commands import FEW, UNDRAWN, assert_refused, assert_same, content, run
from helpers.small_runs import write_walks

pytestmark = pytest.mark.slow

KEPT = "finished cells are kept"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("disks")
    write_walks(folder / "walks.csv", n_people=24)
    assert matrix(folder, "undisturbed").code == 0
    return folder


def matrix(folder, out, **how):
    options = (*FEW, "--scenes", 8, "--jobs", 1, "--dataset", folder / "walks.csv", "--out", out)
    return run(folder, *UNDRAWN, *options, **how)


def limit(most_bytes):
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))


@pytest.mark.parametrize("most_bytes", [0, 200, 1_000, 4_000, 12_000])
def test_without_room_for_a_file_of_some_size(most_bytes, place, tmp_path):
    out = tmp_path / "run"
    ended = matrix(place, out, preexec_fn=limit(most_bytes))
    assert_refused(ended, f"cannot write {out}", "File too large", KEPT)
    kept = {one: one.stat().st_mtime_ns for one in out.glob("cells/*.parquet")}
    assert matrix(place, out).code == 0
    assert_same(out, content(place / "undisturbed"))
    assert all(one.stat().st_mtime_ns == at for one, at in kept.items())
