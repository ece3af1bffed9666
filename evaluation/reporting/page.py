"""`report.html`: the whole run on one page that asks nothing of anybody.

One file without a request to anywhere, readable on a phone and in print, light and dark.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from attacks.tasks.task_list import TASKS
from evaluation.analysis import weak_attacks as flagging
from evaluation.reporting import page_cells, page_tables, page_words
from evaluation.reporting.figures.page_figures import tasks_of
from evaluation.reporting.page_svg import Styles, dark_css, inline
from evaluation.runs.failures import failed_lines
from evaluation.runs.files import write_whole
from evaluation.runs.folder import DISSOCIATION, HEAT_MAP
from evaluation.runs.gallery import read_gallery

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from evaluation.analysis.levels import LinkedTask
    from evaluation.reporting.page_cells import Table
    from evaluation.reporting.run_results import Results

PAGE = "report.html"
_TEMPLATES = Path(__file__).with_name("templates")
_PER_POINT = 4.0 / 3.0
"""CSS pixels of a point."""
_SECTIONS = {
    "validity": (
        "Do the descriptors tell how linkable a person is?",
        "Across mechanisms, controls among them: where the descriptor is equal, is linkability?",
    ),
    "within": (
        "And whether this very person is linked?",
        "Within a level, among tracks alike in length, speed and noise: is who leaks more linked?",
    ),
    "claim": (
        "Is FID-controlled noise better than fixed noise?",
        "Where both cost the same, or show the same PLR; negative effects are in favour of FID.",
    ),
    "inflation": (
        "How much more is left than the descriptor says?",
        "The descriptor after attack against the same as shared.",
    ),
}


@dataclass(frozen=True, slots=True)
class Shown:
    """A figure of the page."""

    name: str
    title: str
    text: str
    box: str
    width: float
    """Of the view box, px at the size of print."""
    content: Markup


def write(results: Results, *, drawn: Iterable[Path], verdict: Mapping[str, Any] | None) -> Path:
    """Write `report.html` into the run folder and return its path.

    Parameters
    ----------
    results : Results
        Of `report.build`.
    drawn : iterable of Path
        What `figures.draw_all` returned.
    verdict : mapping, optional
        As in `verdict.json`; without it the page says that there is none.

    Raises
    ------
    DataError
        If the page cannot be written, or a figure not be read.
    """
    svgs = {path.stem: path.read_bytes() for path in drawn if path.suffix == ".svg"}
    path = results.out / PAGE
    write_whole(path, render(results, svgs=svgs, verdict=verdict).encode())
    return path


def render(
    results: Results, *, svgs: Mapping[str, bytes], verdict: Mapping[str, Any] | None
) -> str:
    """Return the page.

    Parameters
    ----------
    results : Results
    svgs : mapping of str to bytes
        Name of a figure to its SVG.
    verdict : mapping, optional
    """
    manifest = results.manifest
    dataset = manifest["dataset"]["name"]
    styles = Styles()
    linked = tasks_of(results.linkability, dataset=dataset)
    figures = _figures(results, svgs, tasks=linked, styles=styles)
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    tables = _tables(results, verdict, tasks=linked)
    return environment.get_template("report.html.j2").render(
        manifest=manifest,
        dataset=dataset,
        notice=manifest["dataset"].get("notice") or "",
        verdict=verdict,
        sections=_sections(verdict, tables),
        figures=figures,
        tables=tables,
        linked=page_tables.linkage_tables(linked),
        tasks=_tasks(linked, figures),
        flag_lines=[
            one.removeprefix("flag: ").removesuffix(": flags.json")
            for one in flagging.lines(results.flags)
        ],
        failed_lines=failed_lines(results.failed),
        about_tasks=_about_tasks(manifest),
        command=page_words.command(manifest),
        css=Markup((_TEMPLATES / "report.css").read_text(encoding="utf-8")),  # noqa: S704 - ours
        figure_css=Markup(styles.css()),  # noqa: S704 - classes of matplotlib's styles
        dark_css=Markup(dark_css()),  # noqa: S704 - colours
        js=Markup((_TEMPLATES / "report.js").read_text(encoding="utf-8")),  # noqa: S704 - ours
    )


def _figures(
    results: Results,
    svgs: Mapping[str, bytes],
    *,
    tasks: Sequence[LinkedTask],
    styles: Styles,
) -> dict[str, Shown]:
    gallery = read_gallery(results.out)
    figures = {}
    for place, (name, svg) in enumerate(svgs.items()):
        content, box = inline(svg, name=f"f{place}", styles=styles)
        said = page_words.words(
            name,
            summary=results.summary,
            tasks=tasks,
            gallery=gallery,
            dataset=results.manifest["dataset"]["name"],
        )
        figures[name] = Shown(
            name=name,
            title=said.title,
            text=said.text,
            box=box,
            width=round(float(box.split()[2]) * _PER_POINT),
            content=Markup(content),  # noqa: S704 - matplotlib's, without any text
        )
    return figures


def _tables(
    results: Results, verdict: Mapping[str, Any] | None, *, tasks: Sequence[LinkedTask]
) -> dict[str, Table]:
    dataset = results.manifest["dataset"]["name"]
    items = verdict["items"] if verdict else []
    found = [
        *page_tables.paper_tables(results.paper_table, results.claims),
        page_tables.sweep_table(results.summary, dataset=dataset),
        page_tables.matched_table(results.matched, results.summary, tasks, dataset=dataset),
        page_tables.attack_table(results.summary, dataset=dataset),
        page_tables.decision_table(results.decisions, results.summary, dataset=dataset),
        page_tables.flag_table(results.flags),
        page_tables.doubt_table(results.linkability),
        page_tables.contrast_table(items),
        *page_tables.verdict_tables(items).values(),
    ]
    return {one.name: one for one in found if one.rows}


def _sections(
    verdict: Mapping[str, Any] | None, tables: Mapping[str, Table]
) -> list[dict[str, Any]]:
    """Return the sections of the verdict that have items, with how often each decision fell."""
    if not verdict:
        return []
    names = dict.fromkeys([*_SECTIONS, *(str(item["section"]) for item in verdict["items"])])
    return [
        {
            "title": _SECTIONS.get(name, (name, ""))[0],
            "about": _SECTIONS.get(name, (name, ""))[1],
            "counts": [
                (page_cells.decision(what), count)
                for what, count in (verdict.get("counts") or {}).get(name, {}).items()
            ],
            "table": tables[f"verdict-{name}"],
        }
        for name in names
        if f"verdict-{name}" in tables
    ]


def _tasks(tasks: Sequence[LinkedTask], figures: Mapping[str, Shown]) -> list[dict[str, Any]]:
    """Return the tasks that were run, in their order, with their figures."""
    return [
        {
            "name": task.name,
            "about": task.about,
            "simulated": task.name in TASKS and TASKS[task.name].simulated,
            "heat": figures.get(f"{HEAT_MAP}-{task.name}"),
            "dissociation": figures.get(f"{DISSOCIATION}-{task.name}"),
        }
        for task in tasks
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
