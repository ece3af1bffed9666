"""A run folder from a stranger, with links and pipes: no file outside is touched.

What the links lead to are throw-away files.
"""

import os
import re
import shutil

import pytest
from helpers.small_runs import smoke, write_walks

import evaluation
from evaluation.api import rebuild
from evaluation.store.files import write_whole
from evaluation.store.lock import locked
from isac_track.errors import DataError, SettingsError

REPLACED = ("summary.csv", "verdict.json", "tables/sweep.tex")
GUESSED = (".report.html.tmp", ".summary.csv.tmp", "tables/.sweep.tex.tmp")
"""Temporary names as they were once."""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    write_walks(folder / "walks.csv")
    settings = smoke(folder / "walks.csv", folder / "run", scenes=4)
    evaluation.run(settings)
    return folder / "run"


@pytest.fixture
def run(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "run")


@pytest.fixture
def victim(tmp_path):
    """A throw-away file, which must stay what it is."""
    path = tmp_path / "victim" / "precious.txt"
    path.parent.mkdir()
    path.write_text("precious")
    yield path
    assert path.read_text() == "precious"
    assert [item.name for item in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("name", [*REPLACED, *GUESSED])
def test_a_linked_file_is_not_written_to(run, victim, name):
    (run / name).unlink(missing_ok=True)
    (run / name).symlink_to(victim)
    rebuild(run)
    assert (run / name).is_symlink() == (name in GUESSED)


@pytest.mark.parametrize("name", ["cells", "tables", "figures"])
def test_a_linked_folder_is_refused(run, victim, name):
    if (run / name).exists():
        shutil.rmtree(run / name)
    (run / name).symlink_to(victim.parent)
    with pytest.raises(
        (DataError, SettingsError), match=re.escape(f"{run / name} is a link")
    ):
        rebuild(run)


@pytest.mark.parametrize(
    "name", [".lock", "SHA256SUMS", "manifest.json", "gallery.parquet"]
)
@pytest.mark.parametrize("planted", ["link", "pipe"])
def test_what_is_no_file_of_the_run_is_refused(run, victim, name, planted):
    (run / name).unlink(missing_ok=True)
    (run / name).symlink_to(victim) if planted == "link" else os.mkfifo(run / name)
    with pytest.raises((DataError, SettingsError), match=re.escape(str(run / name))):
        rebuild(run)


def test_a_linked_cell_counts_as_damaged(run, victim):
    cell = next((run / "cells").iterdir())
    (victim.parent.parent / "elsewhere").write_bytes(cell.read_bytes())
    cell.unlink()
    cell.symlink_to(victim.parent.parent / "elsewhere")
    with pytest.raises((DataError, SettingsError), match=re.escape(cell.name)):
        rebuild(run)


def test_what_a_killed_run_left_goes(run):
    write_whole(run / "summary.csv", b"")
    left = [
        run / f".{name}.{16 * '0'}.tmp" for name in ("report.html", "manifest.json")
    ]
    for item in (*left, run / "cells" / left[0].name, run / ".mine.tmp"):
        item.write_text("half")
    with locked(run):
        assert not any(item.exists() for item in left)
        assert not (run / "cells" / left[0].name).exists()
    assert (run / ".mine.tmp").exists()
