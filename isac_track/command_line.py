"""What all commands share: errors in one line, exit codes, and a Ctrl-C that is never lost."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING, Any, Final, NoReturn

from isac_track.errors import IsacTrackError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

DONE: Final = 0
LIMIT_NOT_MET: Final = 1
WRONG: Final = 2
"""Usage or data."""
FAILED_CELLS: Final = 3
INTERRUPTED: Final = 130
_PIPE_CLOSED: Final = 141
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
    """Run a command and return its exit code, its errors told in one line.

    `interrupted` is what is said after Ctrl-C.
    """
    try:
        with _heard():
            code = command()
            sys.stdout.flush()
    except IsacTrackError as error:
        print(f"error: {error}", file=sys.stderr)  # noqa: T201 - a command speaks
        return WRONG
    except BrokenPipeError:  # whoever read along, `head` say, has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _PIPE_CLOSED
    except KeyboardInterrupt:
        print(interrupted, file=sys.stderr)  # noqa: T201 - as above
        return INTERRUPTED
    return code


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if one was asked for and lost.

    Python raises it wherever it is at the time; in a callback of the garbage collector, say, it is
    printed and forgotten.
    """
    if _asked.is_set():
        _asked.clear()
        raise KeyboardInterrupt


def may_be_ctrl_c() -> bool:
    """Whether a KeyboardInterrupt that was caught may be the user's; else a plug-in raised it."""
    handler = signal.getsignal(signal.SIGINT)
    if handler is signal.SIG_IGN or threading.current_thread() is not threading.main_thread():
        return False
    return handler is not _remember or _asked.is_set()


@contextlib.contextmanager
def _heard() -> Iterator[None]:
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):  # somebody else decides
        yield
        return
    _asked.clear()
    signal.signal(signal.SIGINT, _remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _asked.clear()


def _remember(_signal: int, _frame: FrameType | None) -> None:
    _asked.set()
    raise KeyboardInterrupt
