"""A figure as part of a page: no prolog, ids of its own, few bytes, and colours that can change.

Styles become classes of the page, so that each is written once and the dark page can turn black
and white over. What must keep its colour on coloured ground is a shade off black or white.
"""

from __future__ import annotations

import re

from isac_track.errors import DataError

DARK = {
    "#000000": "#e8e8e6",
    "#ffffff": "#17191c",
    "#dddddd": "#3a3d42",
    "#777777": "#a2a6ab",
    "#999999": "#8d9196",
    "#0072b2": "#4ba9e8",
    "#d55e00": "#f0883c",
    "#009e73": "#2bc299",
}
"""Colours of the figures that change in the dark: the others can be read on either ground."""
_HEAD = re.compile(r"^.*?<svg\b([^>]*)>", re.DOTALL)
_VIEW_BOX = re.compile(r'viewBox="([\d. +-]+)"')
_DROPPED = re.compile(
    r"<metadata>.*?</metadata>|<!--.*?-->|<defs>\s*<style.*?</style>\s*</defs>|<title>.*?</title>",
    re.DOTALL,
)
_REFERENCE = re.compile(r'(?:xlink:)?href="#([^"]+)"|url\(#([^)]+)\)')
_ID = re.compile(r'\sid="([^"]+)"')
_STYLE = re.compile(r'\sstyle="([^"]*)"')
_PATH = re.compile(r'\sd="([^"]*)"')
_PLACE = re.compile(r'\s(x|y)="(-?\d+\.\d+)"')
_MOVE = re.compile(r"translate\([^)]*\)")
_NUMBER = re.compile(r"-?\d+\.\d+")
_EMPTY = re.compile(r"<g(?:\s[^<>]*)?/>|<g(?:\s[^<>]*)?>\s*</g>")
_COLOUR = re.compile(r"#[0-9a-f]{6}\b")
_DIGITS = 2


class Styles:
    """The styles of all figures of a page, each under a short class name."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}

    def name(self, style: str) -> str:
        """Return the class of a style."""
        return self._names.setdefault(style, f"s{len(self._names)}")

    def css(self) -> str:
        """Return the rules of all styles."""
        return "\n".join(
            f".{name}{{{_COLOUR.sub(_variable, style)}}}" for style, name in self._names.items()
        )


def inline(svg: bytes, *, name: str, styles: Styles) -> tuple[str, str]:
    """Return what stands inside the svg element of a page, and the view box.

    Parameters
    ----------
    svg : bytes
        As matplotlib writes it.
    name : str
        Unique on the page; in front of every id.
    styles : Styles
        Gets the styles of the figure.

    Returns
    -------
    (content, view box)
        The view box as `x y width height`.

    Raises
    ------
    DataError
        If it is no SVG with a view box.
    """
    text = svg.decode()
    head = _HEAD.match(text)
    box = _VIEW_BOX.search(head.group(1)) if head else None
    if head is None or box is None:
        raise DataError(f"figure {name} is no SVG with a view box; draw it again")
    body = _DROPPED.sub("", text[head.end() : text.rindex("</svg>")])
    referred = {one or other for one, other in _REFERENCE.findall(body)}
    short = {old: f"{name}-{place}" for place, old in enumerate(sorted(referred))}
    body = _ID.sub(lambda found: _renamed(found.group(1), short), body)
    body = _REFERENCE.sub(lambda found: _referred(found, short), body)
    body = _PATH.sub(lambda found: f' d="{_compact(found.group(1))}"', body)
    body = _PLACE.sub(lambda found: f' {found.group(1)}="{_rounded(found.group(2))}"', body)
    body = _MOVE.sub(
        lambda found: _NUMBER.sub(lambda one: _rounded(one.group(0)), found.group(0)), body
    )
    body = _STYLE.sub(lambda found: f' class="{styles.name(_trimmed(found.group(1)))}"', body)
    body = re.sub(r">\s+<", "><", body)
    before = ""
    while before != body:  # a group of empty groups is empty
        before, body = body, _EMPTY.sub("", body)
    return body.strip(), box.group(1)


def dark_css() -> str:
    """Return the colours of the dark page."""
    return "".join(f"--f-{old[1:]}:{new};" for old, new in DARK.items())


def _variable(found: re.Match[str]) -> str:
    colour = found.group(0)
    return f"var(--f-{colour[1:]},{colour})" if colour in DARK else colour


def _renamed(old: str, short: dict[str, str]) -> str:
    return f' id="{short[old]}"' if old in short else ""


def _referred(found: re.Match[str], short: dict[str, str]) -> str:
    by_href, by_url = found.groups()
    return f'href="#{short[by_href]}"' if by_href else f"url(#{short[by_url]})"


def _compact(path: str) -> str:
    text = _NUMBER.sub(lambda found: _rounded(found.group(0)), " ".join(path.split()))
    return re.sub(r"\s*([MLQCzZ])\s*", r"\1", text)


def _rounded(number: str) -> str:
    text = f"{float(number):.{_DIGITS}f}".rstrip("0").rstrip(".")
    return "0" if text in {"-0", ""} else text


def _trimmed(style: str) -> str:
    return re.sub(r"\s*([:;,])\s*", r"\1", style.strip().rstrip(";"))
