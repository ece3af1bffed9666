"""Errors that a user can meet: a base class and its children, each with a way out."""

import errno
import os
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from traceback import walk_tb

_MOST_CHARACTERS = 300  # Of the message of a plug-in's or a library's error.
_KNOWN_PACKAGES = frozenset(
    (
        "isac_track",
        "predictors",
        "attacks",
        "evaluation",
        "numpy",
        "scipy",
        "numba",
        "dataclasses",
    )
)
"""Packages that never hold the source of a third-party plug-in."""
_MOST_REPEATED = 100  # Characters of what a user typed.
_LIMITS = (errno.ENOMEM, errno.EAGAIN, errno.EMFILE, errno.ENFILE)
# Stands for the file name of a class that was sent without its file.
UNNAMED = "where it is defined"


class IsacTrackError(Exception):
    """A user's mistake or a missing resource; the message names the way out."""


class DataError(IsacTrackError):
    """A data set that cannot be read; the message names the file and the line."""


class SettingsError(IsacTrackError):
    """An option, setting or SPEC that is wrong, unknown or contradicts another."""


class PluginError(IsacTrackError):
    """A plug-in that cannot be loaded, or that breaks its contract."""


class KnowledgeDenied(IsacTrackError):  # noqa: N818 - the contract's name
    """An attack used knowledge that was not granted, or that it did not declare."""


def check_limits(error: BaseException) -> None:
    """Raise an error again as MemoryError or OSError if it is due to a system limit.

    A reader of data then does not blame the file. Libraries wrap such errors in their
    own, where the text of the operating system remains.
    """
    if isinstance(error, MemoryError):
        raise MemoryError from None  # noqa: TRY004 - no argument has a wrong type
    for code in _LIMITS:
        if getattr(error, "errno", None) == code or os.strerror(code) in str(error):
            raise OSError(code, os.strerror(code)) from None


def error_text(error: BaseException) -> str:
    """Return type and message of a foreign error, in one line that is safe to print."""
    name = type(error).__name__
    try:
        text = str(error)
    except BaseException:  # noqa: BLE001 - a plug-in may define it
        text = "(its message cannot be read)"
    words = " ".join(f"{name}: {text[: 10 * _MOST_CHARACTERS]}".split()).removesuffix(
        ":"
    )
    # Half a surrogate pair or an escape sequence is shown by its code.
    line = "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in words
    )
    return line if len(line) <= _MOST_CHARACTERS else f"{line[:_MOST_CHARACTERS]}..."


def raised_at(error: BaseException) -> str:
    """Return where a plug-in's code failed, as ` (file.py, line 3)`.

    It is the innermost line in the file by which that code was entered; empty if the
    error did not pass through such code.
    """
    file, line = "", 0
    for frame, number in walk_tb(error.__traceback__):
        name = frame.f_code.co_filename
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if name == file or not (file or package in _KNOWN_PACKAGES):
            file, line = name, number
    return code_at(file, line) if file else ""


def code_at(file: str, line: int) -> str:
    """Return a place in code as ` (file.py, line 3)`; code of a session has no file."""
    file_name = UNNAMED if file.startswith("<") else Path(file).name
    return f" ({file_name}, line {line})"


def quoted(value: object) -> str:
    """Return a user's value for a message: text in quotes, cut to a length."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write very long whole numbers
        return "a number with thousands of digits"
    return text if len(text) <= _MOST_REPEATED else f"{text[:_MOST_REPEATED]}..."


def did_you_mean(name: str, known: Iterable[str], *, quote: str = "") -> str:
    """Return the end of a message that offers the nearest known name, if any."""
    near = get_close_matches(name, list(known), n=1)
    return f"; did you mean {quote}{near[0]}{quote}?" if near else ""
