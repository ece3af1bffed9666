"""Thirty ends, five at each moment of a run: the same command gives the same bytes."""

import os
import signal
import time

import pytest
from helpers.commands import (
    FEW,
    MATRIX,
    UNDRAWN,
    assert_same,
    content,
    in_session,
    run,
    start,
)
from helpers.processes import wait_for
from helpers.small_runs import write_walks

pytestmark = pytest.mark.slow

END_S = 2.0
"""Within this, everything must be over."""
MOMENTS = {
    # What a run has just begun with: the files that tell, and how many of them.
    "its folder": (".lock", 1),
    "its manifest": ("manifest.json", 1),
    "its cells": ("cells/*.parquet", 1),
    "the last of its cells": ("cells/*.parquet", 4),
    "its tables": ("*.csv", 2),
    "its pictures": ("figures/*", 1),
}
KILLS = (
    (os.killpg, signal.SIGKILL),
    (os.kill, signal.SIGKILL),  # the parent alone
    (os.killpg, signal.SIGTERM),
    (os.kill, signal.SIGTERM),
    (os.killpg, signal.SIGINT),  # as a terminal sends it
)
SCENES = ("--scenes", 1000)
"""Four blocks, each with a file."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kills")
    write_walks(folder / "walks.csv", n_people=24)
    return folder


def words(out, *, drawn):
    return (MATRIX if drawn else UNDRAWN), (
        *FEW,
        *SCENES,
        "--dataset",
        "walks.csv",
        "--out",
        out,
    )


@pytest.fixture(scope="module")
def undisturbed(place):
    """What a run holds that nothing happened to, with pictures and without."""
    held = {}
    for drawn in (False, True):
        command, options = words(f"undisturbed-{drawn}", drawn=drawn)
        assert run(place, *command, *options, "--jobs", 2).code == 0
        held[drawn] = content(place / f"undisturbed-{drawn}")
    return held


@pytest.mark.parametrize("moment", MOMENTS)
def test_five_ends_when_a_run_has_begun_with(moment, place, undisturbed):
    pattern, number = MOMENTS[moment]
    drawn = pattern == "figures/*"
    out = place / moment.replace(" ", "-")
    command, options = words(out, drawn=drawn)
    for kill, sign in KILLS:
        before = {item: item.stat().st_mtime_ns for item in out.glob(pattern)}
        if pattern.startswith("cells/") and len(before) >= number:
            for item in (*before, out / "SHA256SUMS"):  # begin with them once more
                item.unlink()
            before = {}

        def has_begun(before=before):
            result = {
                item: item.stat().st_mtime_ns
                for item in out.glob(pattern)
                if item.exists()
            }
            assert process.poll() is None, process.communicate()  # noqa: B023 - of this turn
            return len(result.items() - before.items()) >= number

        process = start(place, *command, *options, "--jobs", 2)
        wait_for(has_begun, most_s=60)
        finished = {
            item: item.stat().st_mtime_ns for item in out.glob("cells/*.parquet")
        }
        kill(process.pid, sign)
        began = time.monotonic()
        shown = process.communicate()
        assert process.returncode == (130 if sign == signal.SIGINT else -sign), shown
        assert "Traceback" not in "".join(shown)
        wait_for(lambda pid=process.pid: not in_session(pid), most_s=END_S)
        assert time.monotonic() - began < 2 * END_S
    ended = run(place, *command, *options, "--jobs", 1)
    assert ended.code == 0, ended
    assert "damaged cell" not in ended.err
    assert_same(out, undisturbed[drawn])
    # What was there is not computed again.
    assert all(path.stat().st_mtime_ns == at for path, at in finished.items())
