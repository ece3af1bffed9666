"""What can go wrong for a user: one error and a handful of children, each with a way out."""

import errno
import os
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from traceback import walk_tb

_MOST_TOLD = 300  # Characters of a stranger's message.
_NOT_STRANGE = frozenset(
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
"""Packages that a plug-in's own source is not in."""
_MOST_REPEATED = 100  # Characters of what a user typed.
_LIMITS = (errno.ENOMEM, errno.EAGAIN, errno.EMFILE, errno.ENFILE)
# Stands for the file of a class whose code travelled without it.
UNNAMED = "where it is defined"


class IsacTrackError(Exception):
    """A user's mistake or a missing resource; the message names it and the way out."""


class DataError(IsacTrackError):
    """A data set that cannot be read; the message names file and line."""


class SettingsError(IsacTrackError):
    """An option, a setting or a SPEC that is wrong, unknown or contradicts another."""


class PluginError(IsacTrackError):
    """A plug-in that cannot be loaded, or that breaks its contract."""


class KnowledgeDenied(IsacTrackError):  # noqa: N818 - the contract's name
    """An attack touched what its adversary was not granted, or what it did not declare."""


def check_limits(error: BaseException) -> None:
    """Raise an error again, as MemoryError or OSError, if the machine is short of something.

    A reader then does not blame a file. Libraries hide such errors in their own; the
    words of the system remain.
    """
    if isinstance(error, MemoryError):
        raise MemoryError from None  # noqa: TRY004 - no argument has a wrong type
    for code in _LIMITS:
        if getattr(error, "errno", None) == code or os.strerror(code) in str(error):
            raise OSError(code, os.strerror(code)) from None


def told(error: BaseException) -> str:
    """Return type and message of a stranger's error: short, on one line, and safe to print."""
    name = type(error).__name__
    try:
        text = str(error)
    except BaseException:  # noqa: BLE001 - the message is a stranger's as well
        text = "(its message cannot be read)"
    words = " ".join(f"{name}: {text[: 10 * _MOST_TOLD]}".split()).removesuffix(":")
    # Half a surrogate pair or an escape sequence is shown as what it is.
    line = "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in words
    )
    return line if len(line) <= _MOST_TOLD else f"{line[:_MOST_TOLD]}..."


def raised_at(error: BaseException) -> str:
    """Return where a stranger's code failed, as ` (file.py, line 3)`; empty if it had no part.

    It is the innermost line in the file that the stranger's code was entered by.
    """
    file, line = "", 0
    for frame, number in walk_tb(error.__traceback__):
        name = frame.f_code.co_filename
        is_ours = (
            str(frame.f_globals.get("__name__", "")).partition(".")[0] in _NOT_STRANGE
        )
        if name == file or not (file or is_ours):
            file, line = name, number
    return code_at(file, line) if file else ""


def code_at(file: str, line: int) -> str:
    """Return a place in a stranger's code, as ` (file.py, line 3)`; a session's has no file."""
    where = UNNAMED if file.startswith("<") else Path(file).name
    return f" ({where}, line {line})"


def quoted(value: object) -> str:
    """Return what a user gave as messages repeat it: text in quotes, all of it cut to a length."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write very long whole numbers
        return "a number with thousands of digits"
    return text if len(text) <= _MOST_REPEATED else f"{text[:_MOST_REPEATED]}..."


def did_you_mean(name: str, known: Iterable[str], *, quote: str = "") -> str:
    """Return the end of a message that offers the nearest of `known`; empty if none is near."""
    near = get_close_matches(name, list(known), n=1)
    return f"; did you mean {quote}{near[0]}{quote}?" if near else ""
