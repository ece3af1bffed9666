"""`report.html`: a run in a single file, for phone and print, light and dark."""

import re
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

from attacks.tasks.task_list import TASKS
from evaluation.estimates import weak_attacks
from evaluation.estimates.keys import is_attack
from evaluation.plan.address import parse_consumer
from evaluation.plan.presets import IDENTITY, SHARED
from evaluation.reporting.amounts import counted
from evaluation.reporting.announcements import (
    changed_settings,
    rerun_command,
    scenes_text,
)
from evaluation.reporting.answers import Answer, answers
from evaluation.reporting.error_sources import DOCS_PAGE, ERROR_SOURCES
from evaluation.reporting.failed_cells import failed_lines
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.glossary import GLOSSARY, plain_name
from evaluation.reporting.headline import Headline
from evaluation.reporting.markup import HTML
from evaluation.reporting.my_plugin import plugin_lines
from evaluation.reporting.names import attack_name, dataset_title, spec_text
from evaluation.reporting.notices import data_notices, geometry, used_are_slower
from evaluation.reporting.pictures import (
    Picture,
    panels,
    pictures,
    planes,
    walks_takeaway,
)
from evaluation.reporting.protection_record import OPINION, protection_record
from evaluation.reporting.return_words import no_scenes_line, return_sentence
from evaluation.reporting.rows import Results
from evaluation.reporting.table import decision_cell
from evaluation.reporting.tables import page_tables
from evaluation.store.files import PAGE, write_whole


def write(run: Results, *, figures: Sequence[Figure]) -> Path:
    """Write `report.html` with the figures of a run, and return its path.

    Raises DataError if it cannot be written.
    """
    path = run.out / PAGE
    write_whole(path, render(run, figures=figures).encode())
    return path


def render(run: Results, *, figures: Sequence[Figure] = ()) -> str:
    """Return the page."""
    flags, table = weak_attacks.lines(run.flags), run.headline
    walks = [] if run.gallery is None else panels(run.gallery)
    text = HTML.get_template("report.html.j2").render(
        run=run,
        title=title(run),
        own_lines=plugin_lines(run),
        error_sources=ERROR_SOURCES,
        docs_page=DOCS_PAGE,
        returning=return_sentence(run),
        no_scenes=no_scenes_line(run.manifest),
        answers=_pictured_answers(run, table),
        record=protection_record(run, table),
        opinion=OPINION,
        planes=planes(table),
        gallery=walks,
        walks_caption=walks_takeaway(walks),
        level_names=level_names(table),
        rebuilt_by=(
            "" if run.gallery is None else attack_name(run.gallery.iloc[0]["attack"])
        ),
        epsilon_m=f"{table.epsilon_m:g}",
        decision=decision_cell,
        figures=figures,
        tables=page_tables(run),
        glossary=GLOSSARY,
        plain_name=plain_name,
        known_tasks=TASKS,
        flag_lines=[
            line.removeprefix("flag: ").removesuffix(": flags.json") for line in flags
        ],
        failed_lines=failed_lines(run.failed),
        command=rerun_command(run.manifest),
        scenes=_size_text(run),
        data_notices=data_notices(run.manifest["dataset"]),
        slower=used_are_slower(run.manifest),
        changed=changed_settings(run.manifest),
        geometry=geometry(run.manifest),
    )
    # A line's end between two elements would be a node of its own.
    return re.sub(r">\n+<", "><", text)


def _pictured_answers(
    run: Results, table: Headline
) -> list[tuple[Answer, Picture | None]]:
    """Return the answers, the first five with their pictures.

    People who come back have a section of the page.
    """
    drawn = pictures(table) if run.has_scenes else []
    return list(zip_longest(answers(run, table), drawn))


def _size_text(run: Results) -> str:
    """Return the number of scenes, or of passages without any scene."""
    if run.has_scenes:
        return scenes_text(run.manifest["identity"])
    return counted(run.manifest["dataset"]["tracks"], "passage")


def title(run: Results) -> str:
    """Return recording, levels and attacks of a run, in a line."""
    if not run.has_scenes:
        people = counted(
            run.manifest["dataset"]["returning"]["people"], "person", "people"
        )
        returning = run.returns[["mechanism", "level"]].drop_duplicates()
        noise = counted(len(returning), "level")
        return f"{dataset_title(run.dataset)}: {people} who come back, at {noise}"
    shared = run.ours[run.ours["consumer"] == SHARED]
    levels = len(shared[["mechanism", "level"]].drop_duplicates())
    rows = run.without_policy
    consumers = rows.loc[is_attack(rows), "consumer"].unique()
    attacks = {parse_consumer(name).plugin for name in consumers}
    attacks.discard(IDENTITY)
    parts = [
        f"{counted(run.manifest['dataset']['tracks_used'], 'pedestrian track')}",
        f"shared with robots at {counted(levels, 'noise level')}",
        f"under {counted(len(attacks), 'attack')}" if attacks else "",
    ]
    return f"{dataset_title(run.dataset)}: {' '.join(filter(None, parts))}"


def level_names(table: Headline) -> dict[str, str]:
    """Return the plain name of each level by its SPEC, as `gallery.parquet` has it."""
    return {
        spec_text(table.families[where.mechanism], where.level): table.name(where)
        for where in table.levels
    }
