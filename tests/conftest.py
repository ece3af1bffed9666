"""Tracks for tests: small made-up ones, and the real recording if it is there."""

# ruff: noqa: E402 - numpy reads these variables when it is imported
import gc
import os
import sys

# Tests run side by side; BLAS threads that compete for the cores double the time.
for library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Without written bytecode, each process that tests start would compile all again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

import signal
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import Ended
from helpers.recordings import build_tracks, write_csv
from helpers.small_runs import cut_once, single_process, without_pictures

from isac_track import datasets
from isac_track.rng import stream

pytest_plugins = ["pytester"]  # for tests that strangers run, in this process

_LONGEST = (
    "plugin_values",
    "dask",
    "compare",
    "faults",
    "sensitivity",
    "execute",
    "tutorial",
)
LONG = {f"test_{name}" for name in (*_LONGEST, "testing")}
"""Files of tests that take ten seconds and more."""
_RARELY = 20_000, 20, 50
"""Thresholds of garbage collection; 700, 10, 10 are Python's own."""


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """Let the whole suite take two processes, where pytest-xdist is installed.

    Files stay whole, since their tests share finished runs. Tests named on the command
    line, and tests in a debugger, run in this process.
    """
    option = config.option
    is_debugged = config.getoption("usepdb")
    is_whole = config.args == config.getini("testpaths") and not is_debugged
    # A worker must not start workers of its own.
    is_worker = "PYTEST_XDIST_WORKER" in os.environ
    if is_whole and not is_worker and getattr(option, "numprocesses", 0) is None:
        option.numprocesses, option.dist, option.loadscopereorder = 2, "loadfile", False


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Import and collect without garbage collection, as nothing is garbage.

    Later collections are rarer, and pass over all that was imported and collected:
    every run ends with one, which is a tenth of the CPU time of many small tests.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        if "hypothesis" in sys.modules:
            _try_an_example()
        gc.freeze()
        gc.set_threshold(*_RARELY)
        gc.enable()


def _try_an_example():
    """Let hypothesis register its random numbers, which it does once a process.

    Version 6.130, the lowest, looks for them among the objects that are collected: it
    must not be later than these are frozen.
    """
    from hypothesis import given, settings, strategies  # noqa: PLC0415 - as said

    @settings(max_examples=1, database=None)
    @given(strategies.none())
    def hold(_nothing):
        pass

    hold()


def pytest_collection_modifyitems(items):
    """Run the longest files first: at the end they would leave a process idle."""
    items.sort(key=lambda item: item.path.stem not in LONG)


# A shell that starts tests in the background makes them and their children ignore
# Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def made_up_tracks(*, n_tracks=12, duration_s=30.0, seed=0):
    """Smooth random walks at 0.4 s steps, around (0, 0), each a group of its own."""
    t = np.arange(0.0, duration_s + 1e-9, 0.4)
    parts = []
    for row in range(n_tracks):
        rng = stream(seed, "test", "track", row)
        mean = rng.normal(0, 0.6, 2)
        velocity = mean + 0.1 * rng.standard_normal((t.size, 2)).cumsum(axis=0)
        parts.append(rng.uniform(-3, 3, 2) + 0.4 * velocity.cumsum(axis=0))
    return build_tracks(*parts)


@pytest.fixture(scope="session")
def tracks():
    return made_up_tracks()


@pytest.fixture(scope="session")
def students03():
    root = os.environ.get("ISAC_TRACK_DATA")
    if root is None or not (Path(root) / "students03" / "obsmat.txt").is_file():
        pytest.skip("needs students03 in the folder that ISAC_TRACK_DATA names")
    return datasets.load("students03")


@pytest.fixture
def csv_recording(tmp_path, tracks):
    """The made-up tracks as a user's file."""
    path = tmp_path / "walks.csv"
    write_csv(path, tracks)
    return path


@pytest.fixture
def ran(capsys):
    """Run a command in this process: exit code, output and errors."""

    def run(command, *words):
        capsys.readouterr()
        return Ended(command.main([str(word) for word in words]), *capsys.readouterr())

    return run


@pytest.fixture(name="single_process")
def _single_process():
    with single_process():
        yield


@pytest.fixture(scope="module", name="cut_once")
def _cut_once():
    with cut_once():
        yield


@pytest.fixture
def undrawn():
    """Runs draw no pictures."""
    with without_pictures():
        yield
