"""Recordings that cannot be read, by commands: one line, and no file written."""

import os

import pytest
from helpers.bad_recordings import CSV, GAN, ROWS
from helpers.commands import assert_refused, run

pytestmark = pytest.mark.slow

SHOW = ("-m", "isac_track.datasets", "show")
RUN = ("-m", "evaluation.matrix", "--out", "run", "--dataset")


def assert_refusal(folder, command, *words, says):
    before = sorted(folder.iterdir())
    assert_refused(run(folder, *command, *words, timeout_s=30), *says)
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("row", ROWS, ids=[f"{row[0]}: {row[2]}" for row in ROWS])
def test_of_such_content(row, tmp_path):
    format_name, data, message, fps = row
    (tmp_path / "f").write_bytes(data)
    rate = () if fps is None else ("--fps", fps)
    assert_refusal(tmp_path, SHOW, "f", "--format", format_name, *rate, says=[message])


def a_loop(path):
    path.symlink_to(path)


PLACES = {
    # How it is made; what it is called, and more words; what is said.
    "nothing": (None, ["walks.csv"], "walks.csv: no such file"),
    "nearly a name": (None, ["stuednts03"], "did you mean students03?"),
    "a folder": (
        os.mkdir,
        ["f.csv"],
        "f.csv: this is a folder, and holds no session (.csv",
    ),
    "a pipe": (os.mkfifo, ["f.csv"], "f.csv: no such file"),
    "a link to nowhere": (
        lambda path: path.symlink_to("gone"),
        ["f.csv"],
        "f.csv: no such file",
    ),
    "a link to itself": (a_loop, ["f.csv"], "f.csv: "),
    "a name that is too long": (
        None,
        [f"{'x' * 300}.csv"],
        "cannot be read (File name too long)",
    ),
    "a name that is no text": (None, [os.fsdecode(b"\xff.csv")], "no such file"),
    "lines in its name": (None, ["a\nb.csv"], "no such file"),
    "no format": (GAN, ["f.dat"], "--format"),
    "an unknown format": (CSV, ["f.csv", "--format", "cvs"], "csv"),
    "an extension that is not it": (
        GAN,
        ["f.parquet"],
        "f.parquet: not a parquet file",
    ),
    "a rate of no number": (GAN, ["f", "--format", "pedpy", "--fps", "fast"], "--fps"),
}


@pytest.mark.parametrize("command", [SHOW, RUN], ids=["show", "matrix"])
@pytest.mark.parametrize("case", PLACES)
def test_at_such_a_place(case, command, tmp_path):
    made, words, says = PLACES[case]
    if isinstance(made, bytes):
        (tmp_path / words[0]).write_bytes(made)
    elif made:
        made(tmp_path / words[0])
    assert_refusal(tmp_path, command, *words, says=[says])
