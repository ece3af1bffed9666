"""A small table in lines of text: two lines of heads, then rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

_GAP: Final = "  "


@dataclass(frozen=True, slots=True)
class Group:
    """Heads of neighbouring columns, and the title above them all."""

    title: str
    heads: tuple[str, ...]


def grid_lines(
    rows: Sequence[Sequence[str]], groups: Sequence[Group], *, corner: tuple[str, str]
) -> list[str]:
    """Return a table in lines: the first column left-aligned, all others right-aligned.

    `rows` have a label and a text for each head of the groups; `corner` stands above
    the labels. A title that is wider than its columns makes the first of them wider.
    """
    heads = [head for group in groups for head in group.heads]
    below = [[corner[1], *heads], *rows]
    widths = [max(map(len, column)) for column in zip(*below, strict=True)]
    widths[0] = max(widths[0], len(corner[0]))
    place, above = 1, [corner[0].ljust(widths[0])]
    for group in groups:
        n = len(group.heads)
        room = sum(widths[place : place + n]) + len(_GAP) * (n - 1)
        widths[place] += max(0, len(group.title) - room)
        above.append(group.title.rjust(max(room, len(group.title))))
        place += n
    lines = [_GAP.join(above).rstrip()]
    for row in below:
        cells = [
            text.rjust(width) for text, width in zip(row[1:], widths[1:], strict=True)
        ]
        lines.append(_GAP.join([row[0].ljust(widths[0]), *cells]).rstrip())
    return lines
