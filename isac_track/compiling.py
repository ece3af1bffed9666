"""Compile a loop with numba at first use, say so in one line, and cache it where possible.

Only the private modules of compiled loops import this one, and they are imported at first use:
importing numba takes longer than a command may take to print its help.
"""

import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core import event

_Loop = TypeVar("_Loop", bound="Callable[..., object]")
FLOAT, INT = numba.float64, numba.int64

# The cache does not notice a change of these options: delete it after one (__pycache__/*.nb?).
# FMA only: "contract" leaves NaN, infinity and the order of operations as IEEE 754 has them.
# The numpy error model drops a test for zero before every division.
_OPTIONS: dict[str, Any] = {"nogil": True, "fastmath": {"contract"}, "error_model": "numpy"}


def read(n_dims: int, kind: str = "float64") -> object:
    """Return the type of an array that a loop reads, writable or not: compiled once for both."""
    return numba.types.Array(getattr(numba, kind), n_dims, "C", readonly=True)


def written(n_dims: int, kind: str = "float64") -> object:
    """Return the type of an array that a loop writes to."""
    return numba.types.Array(getattr(numba, kind), n_dims, "C")


def together(*arguments: object) -> object:
    """Return the type of a tuple of arguments."""
    return cast("Any", numba.types.Tuple)(arguments)


class _Notice(event.Listener):
    """Speak up once, when numba is about to compile: a load from the cache is silent."""

    said, cached = False, True

    def on_start(self, event: object) -> None:  # noqa: ARG002 - numba's signature
        once = "once, a few seconds"
        if not self.cached:
            once = "a few seconds, on every start: no cache can be written "
            once += "(NUMBA_CACHE_DIR may name a folder for it)"
        # A line, not a warning: users who turn warnings into errors must not lose their run.
        if not self.said:
            print(f"isac-track: compiling filters, {once}", file=sys.stderr, flush=True)  # noqa: T201 - so that users know why they wait
        self.said = True

    def on_end(self, event: object) -> None:
        pass


_notice = _Notice()


def compiled(*arguments: object) -> Callable[[_Loop], _Loop]:
    """Return a decorator that compiles a loop without a result for these argument types, now.

    The machine code comes from numba's cache where there is one. Where none can be written, or
    it cannot take the code (a full disk), the loop is compiled for this process alone.
    """

    def decorate(loop: _Loop) -> _Loop:
        signature = numba.void(*arguments)
        with event.install_listener("numba:compile", _notice):
            if _notice.cached:
                try:
                    return cast("_Loop", numba.njit(signature, cache=True, **_OPTIONS)(loop))
                except (RuntimeError, OSError):  # numba: "no locator available"
                    _notice.cached = False
            return cast("_Loop", numba.njit(signature, **_OPTIONS)(loop))

    return decorate


def part_of_loop(function: _Loop) -> _Loop:
    """Compile a helper into the loops that call it; it must lie in their file.

    The cache notices a change of a loop's own file, not of another.
    """
    return cast("_Loop", numba.njit(**_OPTIONS)(function))
