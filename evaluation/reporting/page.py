"""`report.html`: the whole run on one page that asks nothing of anybody.

One file without a request to anywhere, readable on a phone and in print, light and dark.

A figure becomes a part of it: no prolog, ids of its own, few bytes, and colours that can change.
Styles become classes of the page, so that each is written once and the dark page can turn black
and white over. What must keep its colour on coloured ground is a shade off black or white.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from attacks.tasks.task_list import TASKS
from evaluation.analysis import weak_attacks
from evaluation.reporting.announcements import command, data_notices
from evaluation.reporting.answer_tables import SECTIONS as QUESTIONS
from evaluation.reporting.figures.drawing import figures_of
from evaluation.reporting.markup import HTML
from evaluation.reporting.table import decision
from evaluation.reporting.tables import page_tables
from evaluation.runs.files import write_whole
from evaluation.runs.pieces import failed_lines
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from evaluation.reporting.rows import Results

PAGE: Final = "report.html"
SECTIONS: Final = {
    "verdict": "Verdict",
    "paper": "The paper's numbers",
    "figures": "The paper's figures",
    "plane": "Operating points",
    "after": "After attack",
    "linkability": "Linkability",
    "against": "Descriptor against linkability",
    "alarms": "Misses and false alarms",
    "gallery": "Tracks",
    "doubts": "Weak attacks and invalid cells",
    "threat": "Threat model",
    "again": "Run it again",
}
"""Of the page, in order."""
_PER_POINT = 4.0 / 3.0
"""CSS pixels of a point."""
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
DARK_CSS: Final = "".join(f"--f-{old[1:]}:{new};" for old, new in DARK.items())
_HEAD = re.compile(r'^.*?<svg\b[^>]*viewBox="([\d. +-]+)"[^>]*>', re.DOTALL)
_DROPPED = re.compile(
    r"<metadata>.*?</metadata>|<!--.*?-->|<defs>\s*<style.*?</style>\s*</defs>|<title>.*?</title>",
    re.DOTALL,
)
_REFERENCE = re.compile(r'(?:xlink:)?href="#([^"]+)"|url\(#([^)]+)\)')
_ID = re.compile(r'\sid="([^"]+)"')
_STYLE = re.compile(r'\sstyle="([^"]*)"')
_PATH = re.compile(r'\sd="([^"]*)"')
_PLACE = re.compile(r'\s[xy]="-?\d+\.\d+"|translate\([^)]*\)')
_NUMBER = re.compile(r"-?\d+\.\d+")
_EMPTY = re.compile(r"<g(?:\s[^<>]*)?/>|<g(?:\s[^<>]*)?>\s*</g>")
_DIGITS = 2


def write(run: Results, *, drawn: Iterable[Path]) -> Path:
    """Write `report.html` into the run folder with the figures that were drawn; return its path.

    Raises DataError if the page cannot be written, or a figure not be read.
    """
    svgs = {path.stem: path.read_bytes() for path in drawn if path.suffix == ".svg"}
    path = run.out / PAGE
    write_whole(path, render(run, svgs=svgs).encode())
    return path


def render(run: Results, *, svgs: Mapping[str, bytes]) -> str:
    """Return the page; `svgs` is the SVG of each figure by its name."""
    styles: dict[str, str] = {}
    figures: list[dict[str, Any]] = []
    for one in figures_of(run):
        if one.name in svgs:
            content, box = inline(svgs[one.name], name=f"f{len(figures)}", styles=styles)
            width_px = round(float(box.split()[2]) * _PER_POINT)  # at the size of print
            figures.append({"of": one, "box": box, "width": width_px, "content": content})
    flags = weak_attacks.lines(run.flags)
    return HTML.get_template("report.html.j2").render(
        contents=SECTIONS,
        run=run,
        questions=QUESTIONS,
        decision=decision,
        figures=figures,
        tables=page_tables(run),
        known_tasks=TASKS,
        flag_lines=[one.removeprefix("flag: ").removesuffix(": flags.json") for one in flags],
        failed_lines=failed_lines(run.failed),
        command=command(run.manifest),
        data_notices=list(data_notices(run.manifest["dataset"])),
        figure_css=style_css(styles),
        dark_css=DARK_CSS,
    )


def style_css(styles: Mapping[str, str]) -> str:
    """Return the rules of all styles, of which each has a class; colours may change in the dark."""
    rules = "\n".join(f".{name}{{{style}}}" for style, name in styles.items())
    return re.sub("|".join(DARK), lambda found: f"var(--f-{found[0][1:]},{found[0]})", rules)


def inline(svg: bytes, *, name: str, styles: dict[str, str]) -> tuple[str, str]:
    """Return what stands inside the svg element of a page, and its view box: `x y width height`.

    `name` is unique on the page and goes in front of every id; `styles` are those of the whole
    page, a class by style, and get those of the figure. Raises DataError if it is no SVG with a
    view box.
    """
    text = svg.decode()
    head = _HEAD.match(text)
    if head is None:
        raise DataError(f"figure {name} is no SVG with a view box; draw it again")
    body = _DROPPED.sub("", text[head.end() : text.rindex("</svg>")])
    referred = {one or other for one, other in _REFERENCE.findall(body)}
    short = {old: f"{name}-{place}" for place, old in enumerate(sorted(referred))}

    def reference(found: re.Match[str]) -> str:
        by_href, by_url = found.groups()
        return f'href="#{short[by_href]}"' if by_href else f"url(#{short[by_url]})"

    def path(found: re.Match[str]) -> str:
        text = re.sub(r" *([MLQCzZ]) *", r"\1", _rounded(" ".join(found[1].split())))
        return f' d="{text}"'

    def style(found: re.Match[str]) -> str:
        one = re.sub(r"\s*([:;,])\s*", r"\1", found[1].strip().rstrip(";"))
        name = styles.setdefault(one, f"s{len(styles)}")
        return f' class="{name}"'

    body = _ID.sub(lambda one: f' id="{short[one[1]]}"' if one[1] in short else "", body)
    body = _PATH.sub(path, _REFERENCE.sub(reference, body))
    body = _STYLE.sub(style, _PLACE.sub(lambda one: _rounded(one[0]), body))
    body = re.sub(r">\s+<", "><", body)
    before = ""
    while before != body:  # a group of empty groups is empty
        before, body = body, _EMPTY.sub("", body)
    return body.strip(), head[1]


def _rounded(text: str) -> str:
    """Return a text in which every number is short."""
    return _NUMBER.sub(lambda one: f"{round(float(one[0]), _DIGITS) + 0.0:.12g}", text)
