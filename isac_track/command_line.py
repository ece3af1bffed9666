"""What all commands share: errors in one line, exit codes, reliable Ctrl-C."""

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
"""Message for each error number by which the system reports a limit."""
# Part of the message when a shared library does not fit into memory.
_NO_PLACE: Final = "failed to map segment"
_NOT_LOADED: Final = f"{_LIMITS[errno.ENOMEM]} to load what a run takes"
_interrupt_requested = threading.Event()


class Parser(argparse.ArgumentParser):
    """A parser that raises SettingsError, keeps line breaks, takes no abbreviations."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - those of argparse
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        options.setdefault("allow_abbrev", False)
        super().__init__(**options)

    def add_repeated(self, option: str, about: str, **options: Any) -> None:  # noqa: ANN401 - as above
        """Add an option that may be given several times; none is an empty list."""
        options.setdefault("default", [])
        options.setdefault("metavar", "SPEC")
        self.add_argument(
            option, action="append", help=f"{about}; repeatable", **options
        )

    def error(self, message: str) -> NoReturn:
        """Raise a SettingsError of one line instead of printing the whole usage."""
        raise SettingsError(f"{message} (see --help)")


def exit_code(command: Callable[[], int], *, interrupted: str = "interrupted") -> int:
    """Run a command and return its exit code; errors are reported in one line.

    `interrupted` is the message after Ctrl-C.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # the calling process closed it
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115 - stays open
    if not sys.argv:  # a program that embeds Python gives no arguments
        sys.argv = [""]
    try:
        with _report_limits(), _listen_for_interrupt():
            code = command()
            sys.stdout.flush()
    except IsacTrackError as error:
        print(f"error: {error}", file=sys.stderr)  # noqa: T201 - a command prints
        return WRONG
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        _silence_stdout()
        return _PIPE_CLOSED
    except OSError as error:
        # An error about a file names it; this one is about standard output.
        if error.errno not in _NO_ROOM:
            raise
        _silence_stdout()
        fault = f"the output cannot be written ({error.strerror}); send it elsewhere"
        with contextlib.suppress(OSError):  # standard error may be full as well
            print(f"error: {fault}", file=sys.stderr)  # noqa: T201 - as above
        return WRONG
    except KeyboardInterrupt:
        print(interrupted, file=sys.stderr)  # noqa: T201 - as above
        return INTERRUPTED
    return code


@contextlib.contextmanager
def _report_limits() -> Iterator[None]:
    """Turn errors that report a limit of system or Python into IsacTrackError."""
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
        # Python reports this limit by the message alone.
        if "can't start new thread" not in str(error):
            raise
        raise IsacTrackError(f"{_LIMITS[errno.EAGAIN]}; use fewer --jobs") from None
    except OSError as error:
        # llvmlite wraps the message in an error of its own.
        if _NO_PLACE in f"{error} {error.__context__}":
            raise IsacTrackError(_NOT_LOADED) from None
        if error.errno not in _LIMITS:
            raise
        raise IsacTrackError(f"{_LIMITS[error.errno]}; use fewer --jobs") from None


def _silence_stdout() -> None:
    """Send standard output to the null device, also when Python flushes it at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if one was lost, as in a garbage collector's callback."""
    if _interrupt_requested.is_set():
        _interrupt_requested.clear()
        raise KeyboardInterrupt


def may_be_ctrl_c() -> bool:
    """Return whether a caught KeyboardInterrupt may be the user's, not a plug-in's."""
    handler = signal.getsignal(signal.SIGINT)
    if (
        handler is signal.SIG_IGN
        or threading.current_thread() is not threading.main_thread()
    ):
        return False
    return handler is not _remember or _interrupt_requested.is_set()


@contextlib.contextmanager
def _listen_for_interrupt() -> Iterator[None]:
    """Remember each Ctrl-C, so that one lost in a callback can be raised later."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # another handler decides
        return
    _interrupt_requested.clear()
    signal.signal(signal.SIGINT, _remember)
    previous_hook = sys.unraisablehook
    sys.unraisablehook = _report_unless_interrupt
    try:
        yield
    finally:
        sys.unraisablehook = previous_hook
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _interrupt_requested.clear()


def _remember(_signal: int, _frame: FrameType | None) -> None:
    _interrupt_requested.set()
    raise KeyboardInterrupt


def _report_unless_interrupt(lost: Any) -> None:  # noqa: ANN401 - typed in stubs alone
    # `check_interrupt` raises a lost KeyboardInterrupt again.
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
