"""`report.html`: the whole run on one page that asks nothing of anybody.

One file without a request to anywhere, readable on a phone and in print, light and dark.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from markupsafe import Markup

from attacks.tasks.task_list import TASKS
from evaluation.analysis import weak_attacks
from evaluation.reporting.figures.drawing import figures_of
from evaluation.reporting.markup import HTML, TEMPLATES
from evaluation.reporting.page_command import command
from evaluation.reporting.page_svg import Styles, dark_css, inline
from evaluation.reporting.table import decision
from evaluation.reporting.tables import page_tables
from evaluation.reporting.verdict_tables import section_of
from evaluation.runs.files import write_whole
from evaluation.runs.pieces import failed_lines

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from evaluation.reporting.run_results import Results
    from evaluation.reporting.table import Table

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


@dataclass(frozen=True, slots=True)
class Shown:
    """A figure of the page."""

    name: str
    section: str
    title: str
    caption: str
    task: str
    text: str
    box: str
    width: float
    """Of the view box, px at the size of print."""
    content: Markup


def write(run: Results, *, drawn: Iterable[Path]) -> Path:
    """Write `report.html` into the run folder and return its path.

    Parameters
    ----------
    run : Results
    drawn : iterable of Path
        What `draw_all` returned.

    Raises
    ------
    DataError
        If the page cannot be written, or a figure not be read.
    """
    svgs = {path.stem: path.read_bytes() for path in drawn if path.suffix == ".svg"}
    path = run.out / PAGE
    write_whole(path, render(run, svgs=svgs).encode())
    return path


def render(run: Results, *, svgs: Mapping[str, bytes]) -> str:
    """Return the page.

    Parameters
    ----------
    run : Results
    svgs : mapping of str to bytes
        Name of a figure to its SVG.
    """
    styles = Styles()
    figures = _figures(run, svgs, styles=styles)
    tables = page_tables(run)
    return HTML.get_template("report.html.j2").render(
        contents=SECTIONS,
        manifest=run.manifest,
        dataset=run.dataset,
        notice=run.manifest["dataset"].get("notice") or "",
        verdict=run.verdict,
        questions=_questions(run.verdict, tables),
        figures=figures,
        tables=tables,
        tasks=[
            {
                "name": task.name,
                "about": task.about,
                "simulated": task.name in TASKS and TASKS[task.name].simulated,
            }
            for task in run.tasks
        ],
        flag_lines=[
            one.removeprefix("flag: ").removesuffix(": flags.json")
            for one in weak_attacks.lines(run.flags)
        ],
        failed_lines=failed_lines(run.failed),
        about_tasks=_about_tasks(run.manifest),
        command=command(run.manifest),
        css=Markup((TEMPLATES / "report.css").read_text(encoding="utf-8")),  # noqa: S704 - ours
        figure_css=Markup(styles.css()),  # noqa: S704 - classes of matplotlib's styles
        dark_css=Markup(dark_css()),  # noqa: S704 - colours
        js=Markup((TEMPLATES / "report.js").read_text(encoding="utf-8")),  # noqa: S704 - ours
    )


def _figures(run: Results, svgs: Mapping[str, bytes], *, styles: Styles) -> list[Shown]:
    figures: list[Shown] = []
    for one in figures_of(run):
        if one.name not in svgs:
            continue
        content, box = inline(svgs[one.name], name=f"f{len(figures)}", styles=styles)
        figures.append(
            Shown(
                name=one.name,
                section=one.section,
                title=one.title,
                caption=one.caption,
                task=one.task,
                text=one.words(),
                box=box,
                width=round(float(box.split()[2]) * _PER_POINT),
                content=Markup(content),  # noqa: S704 - matplotlib's, without any text
            )
        )
    return figures


def _questions(
    verdict: Mapping[str, Any] | None, tables: Mapping[str, Table]
) -> list[dict[str, Any]]:
    """Return the sections of the verdict that have items, with how often each decision fell."""
    names = [name.removeprefix("verdict-") for name in tables if name.startswith("verdict-")]
    counts = (verdict or {}).get("counts") or {}
    return [
        {
            "title": section_of(name).question,
            "about": section_of(name).about,
            "counts": [(decision(what), count) for what, count in counts.get(name, {}).items()],
            "table": tables[f"verdict-{name}"],
        }
        for name in names
    ]


def _about_tasks(manifest: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Return what is known of each task: who is linked, among how many, and what shows."""
    tasks = (manifest.get("linkage") or {}).get("tasks", {})
    return [
        {
            "name": name,
            "about": said["about"],
            "people": said["people"],
            "low": min(said["candidates"].values(), default=0),
            "high": max(said["candidates"].values(), default=0),
            "scene": name in TASKS and TASKS[name].shows_scene,
        }
        for name, said in tasks.items()
    ]
