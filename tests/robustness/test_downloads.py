"""Downloads that go wrong, from a real server: whole and right, or not at all."""

import hashlib
import os
import signal

import pytest
from helpers.commands import assert_refused, run, start
from helpers.mirror import FAILS, WALK, serving, silent
from helpers.processes import wait_for

pytestmark = pytest.mark.slow

FETCH = f"""
import sys
from isac_track.datasets import registry
from isac_track.datasets.__main__ import main
sha256 = {{"obsmat.txt": {hashlib.sha256(WALK).hexdigest()!r}}}
registry.KNOWN = registry.KNOWN | {{"small": registry.Known("small", sha256=sha256)}}
registry.LEAST_S, registry.READ_TIMEOUT_S = 2.0, 0.4
sys.exit(main(["fetch", "small"]))
"""
"""The command, of a data set of two rows, with less patience."""
MOST_S = 8.0


@pytest.fixture
def mirror():
    with serving() as server:
        yield server


@pytest.fixture
def fetch(mirror, tmp_path):
    """How to start or run the command; the cache is in the folder of the test."""
    usual = {"ISAC_TRACK_DATA": None, "ISAC_TRACK_CACHE": str(tmp_path / "cache")}
    usual |= {"ISAC_TRACK_MIRROR": mirror.address, "NO_PROXY": "127.0.0.1"}

    def fetching(how=run, *, changed=(), **options):
        return how(tmp_path, "-c", FETCH, changed=usual | dict(changed), **options)

    return fetching


def files(folder):
    return {
        path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


@pytest.mark.parametrize("case", FAILS)
def test_a_server_that(case, mirror, fetch, tmp_path):
    answer, says = FAILS[case]
    mirror.files["/base/small/obsmat.txt"] = answer
    ended = fetch(timeout_s=MOST_S)
    place = "save in DIR/small and set ISAC_TRACK_DATA=DIR"
    assert_refused(
        ended, f"{mirror.address}small/obsmat.txt: {says}", "Way out: get", place
    )
    assert files(tmp_path) == {}
    mirror.files["/base/small/obsmat.txt"] = WALK
    assert fetch().code == 0
    assert files(tmp_path) == {"obsmat.txt": WALK}


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_what_is_ended_halfway_leaves_nothing_that_the_next_keeps(
    sign, mirror, fetch, tmp_path
):
    mirror.files["/base/small/obsmat.txt"] = (len(WALK), WALK[:10], silent)
    process = fetch(start)
    wait_for(lambda: files(tmp_path), most_s=20)
    os.killpg(process.pid, sign)
    _, errors = process.communicate(timeout=MOST_S)
    assert process.returncode == (130 if sign == signal.SIGINT else -sign)
    assert "Traceback" not in errors
    assert "obsmat.txt" not in files(tmp_path)
    mirror.files["/base/small/obsmat.txt"] = WALK
    assert fetch().code == 0
    assert files(tmp_path) == {"obsmat.txt": WALK}
