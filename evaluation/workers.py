"""Worker processes: how many there are."""

from __future__ import annotations

import os

MOST_DEFAULT_JOBS = 8
"""Unless more are asked for: each takes a few hundred MB."""


def default_jobs() -> int:
    """Return how many workers this machine has cores for, at most `MOST_DEFAULT_JOBS`."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return min(cores or 1, MOST_DEFAULT_JOBS)
