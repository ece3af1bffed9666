"""Give freed memory back to the system: one process may do many runs, or many works."""

import contextlib
import ctypes
import gc
from collections.abc import Iterator
from typing import Any, Final

import pyarrow as pa

_M_ARENA_MAX: Final = -8  # Of glibc's malloc.h.


@contextlib.contextmanager
def release_memory_after() -> Iterator[None]:
    """Return freed memory to the system at the end: one process may do many runs.

    glibc gives threads arenas of their own, whose ends ``malloc_trim`` cannot reach,
    and pyarrow's pools keep pieces that the next run does not quite fill. So threads
    share an arena from now on, and pyarrow takes its memory from malloc meanwhile.
    Another C library's malloc is left as it is.
    """
    pool, libc = pa.default_memory_pool(), _glibc()
    if libc is not None:
        libc.mallopt(_M_ARENA_MAX, 1)
    pa.set_memory_pool(pa.system_memory_pool())
    try:
        yield
    finally:
        pa.set_memory_pool(pool)
        trim_memory()


def trim_memory() -> None:
    """Return freed memory to the system now."""
    gc.collect()
    if (libc := _glibc()) is not None:
        libc.malloc_trim(ctypes.c_size_t(0))


def _glibc() -> Any | None:  # noqa: ANN401 - untyped
    # Windows has no name for "this process".
    with contextlib.suppress(OSError, TypeError):
        libc = ctypes.CDLL(None)
        return libc if hasattr(libc, "malloc_trim") else None
    return None
