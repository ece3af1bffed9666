"""Compile a loop with numba at its first call, say so in one line, and cache it where possible.

Only the private modules of compiled loops import this one, and they are imported at
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
    compiled = 0  # How often numba had to compile.

    def on_start(self, event: object) -> None:  # noqa: ARG002 - numba's signature
        self.compiled += 1
        once = "once, a few seconds"
        if not self.cached:
            once = "a few seconds, on every start: no cache can be written "
            once += "(NUMBA_CACHE_DIR may name a folder for it)"
        # A line, not a warning: users who turn warnings into errors must not lose their
        # run.
        if not self.said:
            print(f"isac-track: compiling filters, {once}", file=sys.stderr, flush=True)  # noqa: T201 - so that users know why they wait
        self.said = True

    def on_end(self, event: object) -> None:
        pass


_notice = _Notice()
_compiling = threading.RLock()  # Threads of a process compile a loop once.


class Loop:
    """A loop without a result for fixed argument types, compiled when it is first needed.

    The machine code comes from numba's cache where there is one. Where none can be
    written, or it cannot take the code (a full disk), the loop is compiled for this
    process alone. Cached code that is damaged is removed and compiled again.
    """

    def __init__(
        self, function: Callable[..., None], arguments: tuple[object, ...]
    ) -> None:
        self.function = function
        self._arguments = arguments
        self._machine_code: Callable[..., None] | None = None
        update_wrapper(self, function)

    def __call__(self, *arguments: object) -> None:
        """Run the machine code."""
        (self._machine_code or self.prepare())(*arguments)

    @property
    def is_cached(self) -> bool:
        """Whether numba's cache holds files of the loop; they may be of an older source."""
        return bool(_CachedLoop(self.function).files())

    def prepare(self) -> Callable[..., None]:
        """Load the machine code, or compile it; return it."""
        with _compiling, event.install_listener("numba:compile", _notice):
            if self._machine_code is None:
                self._machine_code = self._made()
        return self._machine_code

    def _made(self) -> Callable[..., None]:
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


def prepared(name: str, *, quietly: bool = False) -> bool:
    """Load or compile a loop; return whether that filled the cache.

    The `name` is ``package.module:loop``. If `quietly`, no line says that it is
    compiled once.
    """
    module, _, loop = name.partition(":")
    before = _notice.compiled
    _notice.said |= quietly and _notice.cached
    getattr(import_module(module), loop).prepare()
    return _notice.cached and _notice.compiled > before


def is_cached(name: str) -> bool:
    """Tell whether numba's cache holds files of a loop, named as in `prepared`."""
    module, _, loop = name.partition(":")
    return bool(getattr(import_module(module), loop).is_cached)


def loops_in(module: ModuleType) -> list[Loop]:
    """Return the compiled loops of a module."""
    return [value for value in vars(module).values() if isinstance(value, Loop)]


def _from_cache(loop: Callable[..., None], signature: object) -> Callable[..., None]:
    """Return a loop from numba's cache, compiled into it if need be; raises what numba does."""
    cache = _CachedLoop(loop)
    if cache.is_damaged():
        cache.remove()
    before = _notice.compiled
    try:
        machine_code = numba.njit(signature, cache=True, **_OPTIONS)(loop)
    except Exception:  # garbled, a file can make its reader raise anything
        if not cache.remove():
            raise
        machine_code = numba.njit(signature, cache=True, **_OPTIONS)(loop)
    cache.note_checksum(is_new=_notice.compiled > before)
    return cast("Callable[..., None]", machine_code)


class _CachedLoop:
    """The files that numba's cache holds of a loop, and their checksum in a file beside them.

    numba notices neither a file that a power loss cut short nor code that was garbled:
    the first ends the program, the second computes something else.
    """

    def __init__(self, loop: Callable[..., object]) -> None:
        code = loop.__code__
        stem = (
            f"{Path(code.co_filename).stem}.{loop.__qualname__}-{code.co_firstlineno}."
        )
        self._folder: Path | None = None
        self._name = ""
        tag = f"py{sys.version_info.major}{sys.version_info.minor}{getattr(sys, 'abiflags', '')}"
        with contextlib.suppress(
            Exception
        ):  # no folder can be written to: there are no files
            dispatcher: Any = numba.njit(**_OPTIONS)(loop)
            dispatcher.enable_caching()
            self._folder = Path(dispatcher.stats.cache_path)
            self._name = f"{stem}{tag}"

    def files(self) -> list[Path]:
        """Return what numba wrote: the index, and the code of each signature."""
        if self._folder is None:
            return []
        return sorted(self._folder.glob(f"{glob.escape(self._name)}*.nb[ci]"))

    @property
    def _note(self) -> Path:
        return (self._folder or Path()) / f"{self._name}{_CHECKSUM}"

    def _checksum(self) -> str:
        whole = hashlib.sha256()
        for path in self.files():
            whole.update(
                path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest()
            )
        return whole.hexdigest()

    def is_damaged(self) -> bool:
        """Whether the files are not those whose checksum was noted."""
        try:
            return (
                bool(self.files()) and self._note.read_text("ascii") != self._checksum()
            )
        except UnicodeDecodeError:
            return True
        except OSError:  # nothing was noted: an older cache
            return False

    def remove(self) -> bool:
        """Remove the files, so that the loop is compiled anew; say so, return whether any went."""
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
            print(f"{text}; it is compiled again", file=sys.stderr, flush=True)  # noqa: T201 - as above
        return bool(removed)

    def note_checksum(self, *, is_new: bool) -> None:
        """Note the checksum of files that numba has just written, or that have none."""
        with contextlib.suppress(
            OSError
        ):  # the files are good; without a note they are trusted
            if self.files() and (is_new or not self._note.exists()):
                temporary = self._note.with_name(f".{secrets.token_hex(8)}{_CHECKSUM}")
                temporary.write_text(self._checksum(), "ascii")
                os.replace(temporary, self._note)  # noqa: PTH105 - atomic on one file system


def part_of_loop(function: _Loop) -> _Loop:
    """Compile a helper into the loops that call it; it must lie in their file.

    The cache notices a change of a loop's own file, not of another.
    """
    return cast("_Loop", numba.njit(**_OPTIONS)(function))
