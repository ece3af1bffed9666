"""No room, no folder, no lock: one line with the way out; finished cells stay."""

import fcntl
import os
import resource
import shutil
from pathlib import Path

import pytest
from helpers.commands import FEW, UNDRAWN, assert_refused, assert_same, content, run
from helpers.small_runs import write_walks

pytestmark = pytest.mark.slow

REPORT = ("-c", UNDRAWN[1].replace("matrix", "report"))
CELLS_STAY = "finished cells stay"
OTHER = "choose another --out"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("disks")
    write_walks(folder / "walks.csv", n_people=24)
    assert matrix(folder, "undisturbed").code == 0
    return folder


def matrix(folder, out, **how):
    options = (
        *FEW,
        "--scenes",
        8,
        "--jobs",
        1,
        "--dataset",
        folder / "walks.csv",
        "--out",
        out,
    )
    return run(folder, *UNDRAWN, *options, **how)


def limit(most_bytes):
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))


@pytest.mark.parametrize("most_bytes", [0, 200, 1_000, 4_000, 12_000])
def test_without_room_for_a_file_of_some_size(most_bytes, place, tmp_path):
    out = tmp_path / "run"
    ended = matrix(place, out, preexec_fn=limit(most_bytes))
    assert_refused(ended, f"cannot write {out}", "File too large", CELLS_STAY)
    remaining = {item: item.stat().st_mtime_ns for item in out.glob("cells/*.parquet")}
    assert matrix(place, out).code == 0
    assert_same(out, content(place / "undisturbed"))
    assert all(path.stat().st_mtime_ns == at for path, at in remaining.items())


def a_file(path):
    path.write_text("precious")


def a_link(path):
    path.symlink_to(path.parents[1] / "precious")


NO_FOLDER = {
    # What the folder is called; what stands in place of which of its files; what is
    # said.
    "a file": ("run", "", a_file, "is a file"),
    "below a file": ("at/run", "..", a_file, "is a file"),
    "a link to nowhere": (
        "run",
        "",
        lambda path: path.symlink_to("gone/far"),
        "cannot write",
    ),
    "a name too long": ("n" * 300, "..", None, "File name too long"),
    "cells is a file": ("run", "cells", a_file, "cells"),
    "the manifest is a folder": ("run", "manifest.json", Path.mkdir, "manifest.json"),
    "the manifest is nonsense": ("run", "manifest.json", a_file, "manifest.json"),
    "a table is a folder": (
        "run",
        "summary.csv",
        Path.mkdir,
        "summary.csv: Is a directory",
    ),
    "the checksums are a pipe": ("run", "SHA256SUMS", os.mkfifo, "SHA256SUMS"),
    "the lock is a link": ("run", ".lock", a_link, ".lock"),
    "the tables are a link": ("run", "tables", a_link, "tables is a link"),
}


@pytest.mark.parametrize("case", NO_FOLDER)
def test_where_no_run_can_be(case, place, tmp_path):
    name, inside, plant, says = NO_FOLDER[case]
    out = tmp_path / name
    if inside not in ("", ".."):
        shutil.copytree(place / "undisturbed", out)
        if (out / inside).exists():
            (shutil.rmtree if (out / inside).is_dir() else Path.unlink)(out / inside)
    (tmp_path / "precious").mkdir()
    if plant:
        plant(out.parent if inside == ".." else out / inside)
    ended = matrix(place, out)
    assert_refused(ended, says)
    assert any(
        way in ended.err
        for way in (OTHER, CELLS_STAY, "--fresh", "elete it", "remove it")
    ), ended
    assert list((tmp_path / "precious").iterdir()) == []


@pytest.mark.parametrize("second", ["matrix", "report"])
def test_while_somebody_else_writes(second, place, tmp_path):
    out = shutil.copytree(place / "undisturbed", tmp_path / "run")
    with (out / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        ended = matrix(place, out) if second == "matrix" else run(place, *REPORT, out)
        assert_refused(
            ended, f"another run is writing to {out}", f"wait for it or {OTHER}"
        )
    assert matrix(place, out).code == 0
    assert_same(out, content(place / "undisturbed"))


def test_a_lock_that_a_dead_run_left_keeps_nobody_out(place, tmp_path):
    out = shutil.copytree(place / "undisturbed", tmp_path / "run")
    (out / ".lock").write_text("1\n")
    assert matrix(place, out).code == 0
    assert_same(out, content(place / "undisturbed"))
