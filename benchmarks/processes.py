"""Memory of a process and of all that it started."""

from __future__ import annotations

import psutil

from isac_track.errors import DataError


def check_memory_is_told() -> None:
    """Raise DataError where the system does not tell the share of a process in its pages."""
    if not hasattr(psutil.Process().memory_full_info(), "pss"):
        raise DataError("the proportional set size of processes is told by Linux alone")


def tree_pss_mb(pid: int) -> float:
    """Return the memory of a process and all its descendants, shared pages once, MB."""
    return sum(_pss_mb(one) for one in (pid, *descendants(pid)))


def tree_rss_mb(pid: int) -> float:
    """Return the same with shared pages as often as they are shared, MB.

    Other programs do not change it, as they do the share of a page that they use, too.
    """
    return sum(rss_mb(one) for one in (pid, *descendants(pid)))


def rss_mb(pid: int) -> float:
    """Return the resident set of one process, MB; 0 if it is gone."""
    try:
        return float(psutil.Process(pid).memory_info().rss) / 1e6
    except psutil.Error:
        return 0.0


def descendants(pid: int) -> list[int]:
    """Return all processes that a process started, and those that they started."""
    try:
        return [one.pid for one in psutil.Process(pid).children(recursive=True)]
    except psutil.Error:
        return []


def command_of(pid: int) -> str:
    """Return the command line of a process; a dead one that nobody collected says so."""
    try:
        return " ".join(psutil.Process(pid).cmdline())
    except psutil.ZombieProcess:
        return f"process {pid}, not collected"
    except psutil.Error:
        return f"process {pid}, gone"


def _pss_mb(pid: int) -> float:
    try:
        return float(psutil.Process(pid).memory_full_info().pss) / 1e6
    except psutil.Error:
        return 0.0
