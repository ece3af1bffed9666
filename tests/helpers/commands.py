"""Commands as users give them: each in a process and session of its own."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from helpers.processes import ROOT, TESTS

MATRIX = ("-m", "evaluation.matrix")
_UNDRAWN = "import sys; from evaluation import matrix; from evaluation.api import run_results; "
_UNDRAWN += "run_results._draw = lambda *_, **__: None; sys.exit(matrix.main())"
UNDRAWN = ("-c", _UNDRAWN)
"""The matrix, but for pictures: they take most of the time of a small run."""
FEW = (
    "--preset",
    "smoke",
    "--predictor",
    "least_squares",
    "--attack",
    "none",
    "--task",
    "none",
)
FEW += ("--mechanism", "raw", "--mechanism", "fixed:0.7")
FEW += (
    "--keep-ids",
)  # Pseudonyms are others in another folder: bytes could not be compared.


class Ended(NamedTuple):
    code: int
    out: str
    err: str


def start(folder, *words, changed=(), **process):
    """Start this Python in a folder; `changed` sets its environment, None removes."""
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{TESTS}"} | dict(changed)
    pipes = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
    }
    return subprocess.Popen(
        [sys.executable, *map(str, words)],
        cwd=folder,
        env={name: value for name, value in environment.items() if value is not None},
        text=True,
        errors="replace",
        start_new_session=True,
        **pipes | process,
    )


def run(folder, *words, timeout_s=180, **how):
    """Run this Python to its end; nobody ever sees a traceback."""
    process = start(folder, *words, **how)
    try:
        shown = [item or "" for item in process.communicate(timeout=timeout_s)]
    finally:
        end(process)
    assert "Traceback" not in "".join(shown), shown
    return Ended(process.returncode, *shown)


def end(process):
    """End a process with all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def assert_refused(ended, *says):
    """Exit code 2, and last of all one line that says what is wrong and what to do."""
    assert ended.code == 2, ended
    (line,) = [line for line in ended.err.splitlines() if line.startswith("error: ")]
    assert ended.err.splitlines()[-1] == line
    assert line.isprintable()
    assert len(line) < 1000
    assert [say for say in says if say not in line] == [], line


def content(out):
    """All files that a run computed, without the times in the manifest and the page."""
    kinds = (
        "cells/*",
        "*.csv",
        "tables/*",
        "*.parquet",
        "figures/*",
        "flags.json",
        "verdict.json",
    )
    files = (path for kind in kinds for path in out.glob(kind))
    return {str(path.relative_to(out)): path.read_bytes() for path in files}


def assert_same(out, expected):
    """The run in a folder is finished, whole, and byte by byte as elsewhere."""
    result = content(out)
    assert result.keys() ^ expected.keys() == set(), result.keys() ^ expected.keys()
    assert [name for name, held in expected.items() if result[name] != held] == []
    assert json.loads((out / "manifest.json").read_text())["state"] == "finished"
    left = [
        path.name for path in out.rglob("*") if path.name.endswith((".tmp", ".lock"))
    ]
    assert left == []


def in_session(number):
    """Processes of a session that still run."""
    result = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, session, *_ = path.read_text().rpartition(")")[2].split()
            if int(session) == number and state not in "ZX":
                result.append(int(path.parent.name))
    return result
