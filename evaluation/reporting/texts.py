"""Texts as they fit: names of others' making, short and harmless."""

from __future__ import annotations


def shortened(name: str, *, room: int) -> str:
    """Return a name without its middle if it is too long: its settings are at the end."""
    if len(name) <= room:
        return name
    end = (room - 3) // 2
    return f"{name[: room - 3 - end]}...{name[-end:]}"


def printable(text: str) -> str:
    """Return a name without what could move a cursor or break a line."""
    return "".join(character if character.isprintable() else "?" for character in text)
