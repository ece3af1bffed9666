"""What all commands share: errors in one line, exit codes, and a Ctrl-C that is never lost."""

import argparse
import contextlib
import errno
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, Final, NoReturn

from isac_track.errors import IsacTrackError, SettingsError

DONE: Final = 0
LIMIT_NOT_MET: Final = 1
WRONG: Final = 2  # Usage or data.
FAILED_CELLS: Final = 3
INTERRUPTED: Final = 130
_PIPE_CLOSED: Final = 141
_NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_LIMITS: Final = {
    errno.EAGAIN: (
        "the system starts no further process or thread (see ulimit -u and -v)"
    ),
    errno.EMFILE: "too many files are open (see ulimit -n)",
    errno.ENFILE: "too many files are open in the whole system",
    errno.ENOMEM: "there is not enough memory",
}
"""What the system says when it has no more to give."""
# Of a library that finds no place in memory.
_NO_PLACE: Final = "failed to map segment"
_NOT_LOADED: Final = f"{_LIMITS[errno.ENOMEM]} to load what a run takes"
_asked = threading.Event()


class Parser(argparse.ArgumentParser):
    """A parser whose errors are SettingsError; it keeps lines and takes no abbreviations."""

    def __init__(self, **words: Any) -> None:  # noqa: ANN401 - those of argparse
        shape = argparse.RawDescriptionHelpFormatter
        super().__init__(**{"formatter_class": shape, "allow_abbrev": False, **words})

    def error(self, message: str) -> NoReturn:
        """Raise a SettingsError of one line: the way out is what counts, not the whole usage."""
        raise SettingsError(f"{message} (see --help)")


def exit_code(command: Callable[[], int], *, interrupted: str = "interrupted") -> int:
    """Run a command and return its exit code; errors and `interrupted` are told in one line."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who started this: nobody listens
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115 - stays open
    if not sys.argv:  # of a program that embeds Python: no words were given
        sys.argv = [""]
    try:
        with _limits_told(), _heard():
            code = command()
            sys.stdout.flush()
    except IsacTrackError as error:
        print(f"error: {error}", file=sys.stderr)  # noqa: T201 - a command speaks
        return WRONG
    except BrokenPipeError:  # whoever read along, `head` say, has enough
        _hush()
        return _PIPE_CLOSED
    except OSError as error:
        if (
            error.errno not in _NO_ROOM
        ):  # files are told by their names: it is what is said here
            raise
        _hush()
        fault = f"the output cannot be written ({error.strerror}); send it elsewhere"
        with contextlib.suppress(OSError):  # nor may this find a place
            print(f"error: {fault}", file=sys.stderr)  # noqa: T201 - as above
        return WRONG
    except KeyboardInterrupt:
        print(interrupted, file=sys.stderr)  # noqa: T201 - as above
        return INTERRUPTED
    return code


@contextlib.contextmanager
def _limits_told() -> Iterator[None]:
    """Make an IsacTrackError of what says that the machine, or Python, has no more to give."""
    try:
        yield
    except MemoryError:
        fault = (
            f"{_LIMITS[errno.ENOMEM]}; ask for less at once (fewer --jobs or --scenes)"
        )
        raise IsacTrackError(fault) from None
    except ImportError as error:
        if _NO_PLACE not in str(error):
            raise
        raise IsacTrackError(_NOT_LOADED) from None
    except RecursionError:
        depth = sys.getrecursionlimit()
        fault = (
            f"calls go deeper than this Python allows (sys.setrecursionlimit: {depth})"
        )
        raise IsacTrackError(fault) from None
    except RuntimeError as error:
        if "can't start new thread" not in str(
            error
        ):  # Python's only name for that limit
            raise
        raise IsacTrackError(f"{_LIMITS[errno.EAGAIN]}; use fewer --jobs") from None
    except OSError as error:
        if (
            _NO_PLACE in f"{error} {error.__context__}"
        ):  # of llvmlite, which hides it in its own
            raise IsacTrackError(_NOT_LOADED) from None
        if error.errno not in _LIMITS:
            raise
        raise IsacTrackError(f"{_LIMITS[error.errno]}; use fewer --jobs") from None


def _hush() -> None:
    """Let nothing more be said on standard output, nor complained about when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if one was asked for and lost: in a garbage collector's call, say."""
    if _asked.is_set():
        _asked.clear()
        raise KeyboardInterrupt


def may_be_ctrl_c() -> bool:
    """Whether a KeyboardInterrupt that was caught may be the user's; else a plug-in raised it."""
    handler = signal.getsignal(signal.SIGINT)
    if (
        handler is signal.SIG_IGN
        or threading.current_thread() is not threading.main_thread()
    ):
        return False
    return handler is not _remember or _asked.is_set()


@contextlib.contextmanager
def _heard() -> Iterator[None]:
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # somebody else decides
        return
    _asked.clear()
    signal.signal(signal.SIGINT, _remember)
    unheard, sys.unraisablehook = sys.unraisablehook, _unless_interrupted
    try:
        yield
    finally:
        sys.unraisablehook = unheard
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _asked.clear()


def _remember(_signal: int, _frame: FrameType | None) -> None:
    _asked.set()
    raise KeyboardInterrupt


def _unless_interrupted(lost: Any) -> None:  # noqa: ANN401 - typed in stubs alone
    if not issubclass(
        lost.exc_type, KeyboardInterrupt
    ):  # of that `check_interrupt` knows
        sys.__unraisablehook__(lost)
