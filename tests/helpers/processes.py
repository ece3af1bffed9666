"""Commands as a user starts them: a process of their own, in a folder of their own."""

import os
import subprocess
import sys
import time
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent


def run_python(folder, *arguments, timeout_s=120):
    """Run this Python with the project and the tests' helpers on its path; text comes back."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(TESTS)])},
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )


def wait_for(condition, *, most_s):
    """Wait until something is so; it must be soon."""
    until = time.monotonic() + most_s
    while not condition():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.01)
