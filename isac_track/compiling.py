"""Compile loops with numba at their first call, and cache them where possible.

Only the private modules of compiled loops import this file, and they are imported at
first use: importing numba takes longer than a command may take to print its help.
"""

import contextlib
import glob
import hashlib
import os
import secrets
import sys
import threading
from collections.abc import Callable
from functools import update_wrapper
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeVar, cast

import numba
from numba.core import event

_Loop = TypeVar("_Loop", bound="Callable[..., object]")
FLOAT, INT = numba.float64, numba.int64

# The cache does not notice a change of these options: delete it after one
# (__pycache__/*.nb?). FMA only: "contract" leaves NaN, infinity and the order of
# operations as IEEE 754 has them. The numpy error model drops a test for zero before
# every division.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "fastmath": {"contract"},
    "error_model": "numpy",
}
_CHECKSUM: Final = ".sha256"  # Ends the name of the file that holds a loop's checksum.


def read(n_dims: int, kind: str = "float64") -> object:
    """Return the type of an array that a loop reads, be it writable or read-only."""
    return numba.types.Array(getattr(numba, kind), n_dims, "C", readonly=True)


def written(n_dims: int, kind: str = "float64") -> object:
    """Return the type of an array that a loop writes to."""
    return numba.types.Array(getattr(numba, kind), n_dims, "C")


def together(*arguments: object) -> object:
    """Return the type of a tuple of arguments."""
    return cast("Any", numba.types.Tuple)(arguments)


class _Notice(event.Listener):
    """Print one line when numba first compiles; loading from the cache is silent."""

    said = False  # Whether the line was printed.
    cached = True  # Whether a cache can be written.
    compiled = 0  # How often numba had to compile.

    def on_start(self, event: object) -> None:  # noqa: ARG002 - numba's signature
        self.compiled += 1
        duration = "once, a few seconds"
        if not self.cached:
            duration = "a few seconds, on every start: no cache can be written "
            duration += "(NUMBA_CACHE_DIR may name a folder for it)"
        # No warning: users who turn warnings into errors must not lose their run.
        if not self.said:
            text = f"isac-track: compiling filters, {duration}"
            print(text, file=sys.stderr, flush=True)  # noqa: T201 - users wait
        self.said = True

    def on_end(self, event: object) -> None:
        pass


_notice = _Notice()
_compiling = threading.RLock()  # Threads of a process compile a loop once.


class Loop:
    """A loop for fixed argument types, compiled when it is first needed.

    The loop returns nothing; it writes to its arguments. The machine code comes from
    numba's cache where it is there. Where no cache can be written, or its disk is
    full, the loop is compiled for this process alone. Damaged code in the cache is
    removed and compiled again.
    """

    def __init__(
        self, function: Callable[..., None], arguments: tuple[object, ...]
    ) -> None:
        self.function = function
        self._arguments = arguments
        self._machine_code: Callable[..., None] | None = None
        self._held_types: set[object] = set()  # For the life of the process.
        update_wrapper(self, function)

    def __call__(self, *arguments: object) -> None:
        """Run the machine code; TypeError if it does not take such arguments."""
        machine_code = self._machine_code or self.prepare()
        try:
            machine_code(*arguments)
        except TypeError:
            # numba 0.60 may forget the type of a tuple while it looks for a conversion,
            # before any code has run. It finds one once the types are held.
            self._held_types.update(map(numba.typeof, arguments))
            machine_code(*arguments)

    @property
    def is_cached(self) -> bool:
        """Whether numba's cache holds files of the loop, maybe of an older source."""
        return bool(_CachedLoop(self.function).files())

    def prepare(self) -> Callable[..., None]:
        """Load or compile the machine code, and return it."""
        with _compiling, event.install_listener("numba:compile", _notice):
            if self._machine_code is None:
                self._machine_code = self._load_or_compile()
        return self._machine_code

    def _load_or_compile(self) -> Callable[..., None]:
        signature = numba.void(*self._arguments)
        if _notice.cached:
            try:
                return _from_cache(self.function, signature)
            except (RuntimeError, OSError):  # numba: "no locator available"
                _notice.cached = False
        machine_code: Callable[..., None] = numba.njit(signature, **_OPTIONS)(
            self.function
        )
        return machine_code


def compiled(*arguments: object) -> Callable[[Callable[..., None]], Loop]:
    """Return a decorator that makes a `Loop` for these argument types."""

    def decorate(function: Callable[..., None]) -> Loop:
        return Loop(function, arguments)

    return decorate


def prepare_loop(name: str, *, quietly: bool = False) -> bool:
    """Load or compile a loop; return whether the cache grew.

    The `name` is ``package.module:loop``. If `quietly`, no line announces the
    compilation.
    """
    module, _, loop = name.partition(":")
    before = _notice.compiled
    _notice.said |= quietly and _notice.cached
    getattr(import_module(module), loop).prepare()
    return _notice.cached and _notice.compiled > before


def is_cached(name: str) -> bool:
    """Tell whether numba's cache holds files of a loop, named as in `prepare_loop`."""
    module, _, loop = name.partition(":")
    return bool(getattr(import_module(module), loop).is_cached)


def loops_in(module: ModuleType) -> list[Loop]:
    """Return the compiled loops of a module."""
    return [value for value in vars(module).values() if isinstance(value, Loop)]


def _from_cache(loop: Callable[..., None], signature: object) -> Callable[..., None]:
    """Return a loop from numba's cache, compiled into it if needed."""
    cache = _CachedLoop(loop)
    if cache.is_damaged():
        cache.remove()
    before = _notice.compiled
    try:
        machine_code = numba.njit(signature, cache=True, **_OPTIONS)(loop)
    except Exception:  # numba may raise anything on a damaged file
        if not cache.remove():
            raise
        machine_code = numba.njit(signature, cache=True, **_OPTIONS)(loop)
    cache.note_checksum(is_new=_notice.compiled > before)
    return cast("Callable[..., None]", machine_code)


class _CachedLoop:
    """The files of a loop in numba's cache, and a file with their checksum.

    numba notices neither a truncated file nor garbled code: the first ends the program,
    the second computes something else.
    """

    def __init__(self, loop: Callable[..., object]) -> None:
        code = loop.__code__
        stem = (
            f"{Path(code.co_filename).stem}.{loop.__qualname__}-{code.co_firstlineno}."
        )
        self._folder: Path | None = None
        self._name = ""
        version = f"{sys.version_info.major}{sys.version_info.minor}"
        tag = f"py{version}{getattr(sys, 'abiflags', '')}"
        # Without a folder that can be written to there are no files.
        with contextlib.suppress(Exception):
            dispatcher: Any = numba.njit(**_OPTIONS)(loop)
            dispatcher.enable_caching()
            self._folder = Path(dispatcher.stats.cache_path)
            self._name = f"{stem}{tag}"

    def files(self) -> list[Path]:
        """Return the files that numba wrote: the index, and code for each signature."""
        if self._folder is None:
            return []
        return sorted(self._folder.glob(f"{glob.escape(self._name)}*.nb[ci]"))

    @property
    def _note(self) -> Path:
        return (self._folder or Path()) / f"{self._name}{_CHECKSUM}"

    def _checksum(self) -> str:
        digest = hashlib.sha256()
        for path in self.files():
            content = hashlib.sha256(path.read_bytes()).digest()
            digest.update(path.name.encode() + b"\0" + content)
        return digest.hexdigest()

    def is_damaged(self) -> bool:
        """Return whether the files differ from those whose checksum was noted."""
        try:
            if not self.files():
                return False
            return self._note.read_text("ascii") != self._checksum()
        except UnicodeDecodeError:
            return True
        except OSError:  # an older cache has no checksum
            return False

    def remove(self) -> bool:
        """Remove the files, with a message; return whether any was removed."""
        removed: list[Path] = []
        for path in self.files():
            with contextlib.suppress(OSError):
                path.unlink()
                removed.append(path)
        if removed:
            text = (
                f"isac-track: {removed[0].parent} holds a damaged compiled filter,"
                f" {self._name}"
            )
            text += "; it is compiled again"
            print(text, file=sys.stderr, flush=True)  # noqa: T201 - as above
        return bool(removed)

    def note_checksum(self, *, is_new: bool) -> None:
        """Note the checksum of files that numba has just written, or that have none."""
        # Files without a checksum are trusted.
        with contextlib.suppress(OSError):
            if self.files() and (is_new or not self._note.exists()):
                temporary = self._note.with_name(f".{secrets.token_hex(8)}{_CHECKSUM}")
                temporary.write_text(self._checksum(), "ascii")
                os.replace(temporary, self._note)  # noqa: PTH105 - atomic on one file system


def part_of_loop(function: _Loop) -> _Loop:
    """Compile a helper function into the loops of its file that call it.

    It must lie in their file, the only file whose changes the cache notices.
    """
    return cast("_Loop", numba.njit(**_OPTIONS)(function))
