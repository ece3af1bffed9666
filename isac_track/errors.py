"""What can go wrong for a user: one error and a handful of children, each with a way out."""

from collections.abc import Iterable
from difflib import get_close_matches

_MOST_TOLD = 300
"""Characters of a stranger's message."""


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


def meant(name: str, known: Iterable[str], *, otherwise: str = "") -> str:
    """Return what a user may have meant by a wrong name, else `otherwise` or all that is known."""
    names = list(known)
    near = get_close_matches(name, names, n=1)
    return f"did you mean {near[0]!r}?" if near else otherwise or f"known: {', '.join(names)}"


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
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in words
    )
    return line if len(line) <= _MOST_TOLD else f"{line[:_MOST_TOLD]}..."
