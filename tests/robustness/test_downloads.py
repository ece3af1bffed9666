"""Downloads that go wrong, by real processes from a real server: whole and right, or not at all."""

import hashlib
import os
import signal

import pytest
from helpers.commands import assert_refused, run, start
from helpers.mirror import closed, endless, serving, silent, trickling
from helpers.processes import wait_for

pytestmark = pytest.mark.slow

WALK = b"1 1 0 0 0 0 0 0\n11 1 0.4 0 0 0 0 0\n"
OTHER = WALK + b"\n"
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


def answers(header, *, then=None):
    """Answer with a whole header, as it is, and what comes after it."""

    def answer(handler):
        handler.wfile.write(header)
        if then:
            then(handler)

    return answer


def redirected(to):
    return answers(f"HTTP/1.0 302 Found\r\nLocation: {to}\r\nContent-Length: 0\r\n\r\n".encode())


def slow_header(handler):
    while not handler.server.over.wait(0.2):
        handler.wfile.write(b"X-Patience: a virtue\r\n")


FAILS = {
    # What the server does: and what is said of it.
    "not there": (404, "the server answered 404"),
    "forbidden": (403, "the server answered 403"),
    "overloaded": (503, "the server answered 503"),
    "another file": (OTHER, "not the expected file: sha256 is"),
    "nothing": (b"", "not the expected file: sha256 is e3b0c442"),
    "cut short": ((len(WALK), WALK[:10], None), "the connection broke off"),
    "longer than announced": ((10, WALK, None), "not the expected file: sha256 is"),
    "hangs up": (closed, "no connection, or it broke off"),
    "says nothing": (silent, "no answer in time"),
    "falls silent": ((len(WALK), WALK[:10], silent), "no answer in time"),
    "trickles": ((len(WALK), WALK[:10], trickling), "no answer in time"),
    "a slow header": (answers(b"HTTP/1.0 200 OK\r\n", then=slow_header), "no answer in time"),
    "without end": ((None, b"", endless), "not the expected file: over 100000000 bytes"),
    "of a terabyte": ((10**12, b"", endless), "not the expected file: over 100000000 bytes"),
    "no HTTP": (answers(b"SSH-2.0-what\r\n"), "no connection, or it broke off"),
    "turns in a circle": (redirected("obsmat.txt"), "cannot be downloaded (TooManyRedirects)"),
    "points into the machine": (redirected("file:///obsmat.txt"), "cannot be downloaded"),
    "points to nobody": (redirected("http://127.0.0.1:1/"), "no connection, or it broke off"),
}


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
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("what", FAILS)
def test_a_server_that(what, mirror, fetch, tmp_path):
    answer, says = FAILS[what]
    mirror.files["/base/small/obsmat.txt"] = answer
    ended = fetch(timeout_s=MOST_S)
    place = "save in DIR/small and set ISAC_TRACK_DATA=DIR"
    assert_refused(ended, f"{mirror.address}small/obsmat.txt: {says}", "Way out: get", place)
    assert files(tmp_path) == {}
    mirror.files["/base/small/obsmat.txt"] = WALK
    assert fetch().code == 0
    assert files(tmp_path) == {"obsmat.txt": WALK}


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_what_is_ended_halfway_leaves_nothing_that_the_next_keeps(sign, mirror, fetch, tmp_path):
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
