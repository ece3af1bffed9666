"""`report.html`: the whole run in a file without requests, for phone and print, light and dark."""

import re
from collections.abc import Sequence
from pathlib import Path

from attacks.tasks.task_list import TASKS
from evaluation.analysis import weak_attacks
from evaluation.reporting.announcements import changed_settings, command, scenes_text
from evaluation.reporting.answers import answers, headline_of
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.markup import HTML
from evaluation.reporting.notices import data_notices, geometry, used_are_slower
from evaluation.reporting.pictures import panels, pictures, planes
from evaluation.reporting.rows import Results
from evaluation.reporting.table import decision
from evaluation.reporting.tables import page_tables
from evaluation.runs.files import PAGE, write_whole
from evaluation.runs.pieces import failed_lines


def write(run: Results, *, figures: Sequence[Figure]) -> Path:
    """Write `report.html` with the figures of a run; return its path. DataError if it cannot be."""
    path = run.out / PAGE
    write_whole(path, render(run, figures=figures).encode())
    return path


def render(run: Results, *, figures: Sequence[Figure] = ()) -> str:
    """Return the page."""
    flags, of = weak_attacks.lines(run.flags), headline_of(run)
    text = HTML.get_template("report.html.j2").render(
        run=run,
        answers=list(zip(answers(run, of), pictures(of), strict=True)),
        planes=planes(of),
        gallery=[] if run.gallery is None else panels(run.gallery),
        epsilon_m=f"{run.manifest['settings']['stages']['privacy.epsilon_m']:g}",
        decision=decision,
        figures=figures,
        tables=page_tables(run),
        known_tasks=TASKS,
        flag_lines=[one.removeprefix("flag: ").removesuffix(": flags.json") for one in flags],
        failed_lines=failed_lines(run.failed),
        command=command(run.manifest),
        scenes=scenes_text(run.manifest["identity"]),
        data_notices=data_notices(run.manifest["dataset"]),
        slower=used_are_slower(run.manifest),
        changed=changed_settings(run.manifest),
        geometry=geometry(run.manifest),
    )
    return re.sub(r">\n+<", "><", text)  # a line's end between two elements would be a node
