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
from evaluation.reporting.announcements import command, data_notices, scenes_text
from evaluation.reporting.answer_tables import SECTIONS as QUESTIONS
from evaluation.reporting.answers import answers, headline_of
from evaluation.reporting.figures.drawing import figures_of
from evaluation.reporting.gallery import panels
from evaluation.reporting.markup import HTML
from evaluation.reporting.pictures import pictures, planes
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
    "level": "Which level",
    "gallery": "Tracks",
    "verdict": "What was decided, and how surely",
    "paper": "The paper's numbers and figures",
    "attacks": "Every attack",
    "doubts": "Weak attacks and invalid cells",
    "threat": "Threat model",
    "words": "Glossary",
    "again": "Run it again",
}
"""Of the page below the answers, in order."""
GLOSSARY: Final = {
    "FID": "Fisher information density: how well a point of the ground can be located, in "
    "1/(m² s). The mechanism fid adds the more noise, the more it exceeds a threshold η.",
    "PLR": "Privacy leakage ratio: share of positions that are closer to the truth than ε.",
    "AEL, MEL": "Average and mean maximum exposure length: how many seconds positions leak "
    "without a break, on average and at most.",
    "raw, clean": "What was sensed with nothing added; and without any error at all.",
    "linear, independent": "How added noise joins that of sensing: standard deviations add up, or "
    "variances do.",
    "missed conflicts": "Share of the conflicts with a person that a robot does not foresee; the "
    "paper's line predicts by least squares, the other by a Kalman filter.",
    "after attack": "The same of positions that a reconstruction attack has filtered: the "
    "strongest of the run, short of one that is told everything.",
    "rank 1": "Share of people whose other release comes first among the candidates; chance is one "
    "in so many.",
    "rerelease": "One walk, shared twice: an upper bound of what can be linked.",
    "handover": "All pseudonyms rotate after some seconds of silence, in one true frame.",
    "split, new_traversal": "Two windows of one walk that do not touch; the same person on another "
    "day, simulated.",
    "blind, informed, oracle": "What an adversary is told: nothing, the mechanism and examples of "
    "others, everything.",
}
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
    "#cc79a7": "#e09cc4",
    "#e69f00": "#f0b93c",
    "#56b4e9": "#8fd0f5",
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
_GROUP = re.compile(r"<g( [^>]*)?>|</g>")
_FONTS = re.compile(r"'DejaVu Sans'.*?sans-serif")
_FONT = "'DejaVu Sans',Verdana,sans-serif"
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
    flags, of = weak_attacks.lines(run.flags), headline_of(run)
    text = HTML.get_template("report.html.j2").render(
        contents=SECTIONS,
        run=run,
        answers=list(zip(answers(run, of), pictures(of), strict=True)),
        planes=planes(of),
        gallery=[] if run.gallery is None else panels(run.gallery),
        epsilon_m=f"{run.manifest['settings']['stages']['privacy.epsilon_m']:g}",
        glossary=GLOSSARY,
        questions=QUESTIONS,
        decision=decision,
        figures=figures,
        tables=page_tables(run),
        known_tasks=TASKS,
        flag_lines=[one.removeprefix("flag: ").removesuffix(": flags.json") for one in flags],
        failed_lines=failed_lines(run.failed),
        command=command(run.manifest),
        scenes=scenes_text(run.manifest["identity"]),
        data_notices=list(data_notices(run.manifest["dataset"])),
        figure_css=style_css(styles),
        dark_css=DARK_CSS,
    )
    return re.sub(r">\n+<", "><", text)  # a line's end between two elements would be a node


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
        name = styles.setdefault(_FONTS.sub(_FONT, one), f"s{len(styles)}")
        return f' class="{name}"'

    body = _ID.sub(lambda one: f' id="{short[one[1]]}"' if one[1] in short else "", body)
    body = _PATH.sub(path, _REFERENCE.sub(reference, body))
    body = _STYLE.sub(style, _PLACE.sub(lambda one: _rounded(one[0]), body))
    body = re.sub(r">\s+<", "><", body)
    before = ""
    while before != body:  # a group of empty groups is empty
        before, body = body, _EMPTY.sub("", body)
    telling: list[bool] = []

    def group(found: re.Match[str]) -> str:
        if found[0] == "</g>":
            return found[0] if telling.pop() else ""
        telling.append(found[1] is not None)
        return found[0] if telling[-1] else ""

    return _GROUP.sub(group, body).strip(), head[1]


def _rounded(text: str) -> str:
    """Return a text in which every number is short."""
    return _NUMBER.sub(lambda one: f"{round(float(one[0]), _DIGITS) + 0.0:.12g}", text)
