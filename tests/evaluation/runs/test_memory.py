"""What is freed goes back to the system, and a user's own pool is left alone."""

import ctypes
import sys
import threading

import numpy as np
import pyarrow as pa
import pytest

from evaluation.runs.workers import given_back


def resident_mb():
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - no file to keep
        return int(file.read().split()[1]) * 4096 / 1e6


def test_the_pool_is_the_users_again_even_after_an_error():
    before = pa.default_memory_pool().backend_name
    with pytest.raises(LookupError, match="system"), given_back():
        raise LookupError(pa.default_memory_pool().backend_name)
    assert pa.default_memory_pool().backend_name == before


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "malloc_trim"),
    reason="only glibc's malloc can be asked to",
)
def test_what_threads_freed_goes_back():
    """80 MB in pieces of 40 kB, which malloc keeps: each is below what it maps by itself."""
    kept = []

    def fill():
        pieces = [np.ones(5_000) for _ in range(2_000)]
        kept.append(pieces[-1].copy())  # holds the end of the arena

    def use():
        thread = threading.Thread(target=fill)
        thread.start()
        thread.join()

    with given_back():
        use()  # whatever is made once
    before = resident_mb()
    with given_back():
        use()
        held = resident_mb()
    after = resident_mb()
    assert after - before < 8
    assert held - after > 20
