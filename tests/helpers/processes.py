"""Where the project is, and how to wait for what a process does."""

import time
from pathlib import Path

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent


def wait_for(condition, *, most_s):
    """Wait until something is so; it must be soon."""
    until = time.monotonic() + most_s
    while not condition():
        assert time.monotonic() < until, "it never came"
        time.sleep(0.01)
