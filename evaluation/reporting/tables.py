"""Choice of tables for terminal, text file, page, LaTeX, README and docs.

In README and docs a block is ``<!-- table: NAME RUN -->`` ... ``<!-- end -->``: table
NAME of `docs/results/RUN.csv`, the rows of a run's `summary.csv` that are shown, of the
smoke run all.
"""

import contextlib
import io
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from rich.console import Console
from rich.text import Text

from evaluation.estimates import weak_attacks
from evaluation.estimates.families import families_in
from evaluation.estimates.keys import INFORMED, row_addresses, row_worlds
from evaluation.estimates.metrics import (
    RANK1,
    RANK1_AMONG_100,
    RECONSTRUCTION,
    UTILITY,
)
from evaluation.estimates.strongest_table import SINGLE_RELEASE
from evaluation.plan.address import Address, parse_consumer
from evaluation.plan.world import OWN_WORLD
from evaluation.reporting import answer_tables, result_tables, terminal
from evaluation.reporting.amounts import PERCENT
from evaluation.reporting.announcements import changed_settings
from evaluation.reporting.answers import answers
from evaluation.reporting.bounds import bound_table, linked_bound_table
from evaluation.reporting.doubts import doubts
from evaluation.reporting.failed_cells import failed_lines
from evaluation.reporting.first_screen import (
    TABLES,
    data_line,
    first_screen,
    short_table,
)
from evaluation.reporting.headline import Headline, headline, headline_table
from evaluation.reporting.markup import latex, markdown
from evaluation.reporting.my_plugin import plugin_lines
from evaluation.reporting.names import mechanism_name
from evaluation.reporting.notices import (
    data_notices,
    geometry,
    linked_people,
    notices,
    used_are_slower,
)
from evaluation.reporting.patrol_tables import patrol_tables
from evaluation.reporting.return_tables import return_tables
from evaluation.reporting.return_words import no_scenes_line
from evaluation.reporting.rows import Results, estimates_by_level, representative_levels
from evaluation.reporting.table import (
    Table,
    build_table,
    cell_column,
    estimate_cell,
    text_column,
)
from evaluation.reporting.terminal import Part
from evaluation.reporting.tracking_table import tracking_sentence, tracking_table
from evaluation.store.csv_files import to_csv
from evaluation.store.files import write_whole
from isac_track.errors import DataError

_BLOCK = re.compile(r"(<!-- table: (\S+) (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
_WIDE: Final = 160  # Columns of `tables.txt`.
# The preset whose numbers the tests hold a fresh run against.
_REFERENCE: Final = "smoke"
_SHOWN: Final = (*UTILITY, *RECONSTRUCTION, RANK1, RANK1_AMONG_100, "chance")


@dataclass(frozen=True, eq=False, slots=True)
class PlacedTable:
    """A table of a run, and where it stands."""

    table: Table
    in_text: bool = True  # In `tables.txt`, and with `--verbose`.
    on_page: bool = True


def show(run: Results, *, before: int = 0, verbose: bool = False) -> None:
    """Print the first screen, or all tables if `verbose`.

    `before` lines of the screen were printed already.
    """
    console = terminal.standard_output()
    if verbose:
        terminal.show(_everything(run), console=console)
        return
    for line in first_screen(run, before=before):
        console.print(Text(terminal.literal(console, line)), soft_wrap=True)


def write_text(run: Results) -> None:
    """Write `tables.txt`: all tables and notices. DataError if it cannot be written."""
    sink = io.StringIO()
    # In a notebook's kernel rich would write into the cell instead of the file.
    console = Console(file=sink, width=_WIDE, highlight=False, force_jupyter=False)
    terminal.show(_everything(run), console=console)
    write_whole(run.out / TABLES, sink.getvalue().encode())


def _everything(run: Results) -> Iterator[Part]:
    yield f"{data_line(run.manifest)}, seed {run.manifest['identity']['seed']}", "bold"
    if changed := changed_settings(run.manifest):
        yield f"settings changed: {' '.join(changed)}"
    if slower := used_are_slower(run.manifest):
        yield slower
    data = run.manifest["dataset"]
    for notice in filter(
        None, [data.get("notice"), *data_notices(data), *notices(run.manifest)]
    ):
        yield f"NOTICE: {notice}", "yellow"
    if line := no_scenes_line(run.manifest):
        yield f"{line} A way out: {data.get('would_help')}."
    yield from geometry(run.manifest)
    yield from linked_people(run.manifest)
    yield from _answer_lines(run)
    yield from plugin_lines(run)
    yield from (placed.table for placed in _placed_tables(run) if placed.in_text)
    for name, reason in run.manifest.get("linkage", {}).get("skipped", {}).items():
        yield ""
        yield f"{name} is left out: {reason}", "yellow"
    if flags := weak_attacks.lines(run.flags):
        note = "(Not adjusted: of two equally good attacks, a flag at one level in 40.)"
        yield ""
        yield from ((line, "yellow") for line in [*flags, note])
    if items := run.verdict.get("items"):
        yield ""
        yield "Verdict", "bold"
        yield from answer_tables.item_tables(items).values()
        yield "(In words, with reasons: verdict.json.)"
    for line in failed_lines(run.failed):
        yield f"failed: {line}", "red"


def _answer_lines(run: Results) -> Iterator[Part]:
    """Yield the five answers with their details, the tracking, and all doubts.

    Patrols are in the details of what to share.
    """
    table = run.headline
    yield ""
    for answer in answers(run, table):
        yield " ".join([f"{answer.topic}: {answer.sentence}", *answer.details])
    if sentence := tracking_sentence(run):
        yield f"Tracking: {sentence}"
    yield from (f"Doubt: {text}." for text in doubts(run))


def page_tables(run: Results) -> dict[str, Table]:
    """Return the tables of the page by name; none of them is empty."""
    tables = [placed.table for placed in _placed_tables(run) if placed.on_page]
    tables += answer_tables.item_tables(run.verdict.get("items", ())).values()
    return {table.name: table for table in tables if table.rows}


def _placed_tables(run: Results) -> Iterator[PlacedTable]:
    """Yield all tables of a run in the order of `tables.txt`, without the verdict's.

    The page finds a table by its name.
    """
    title = "The pictures in numbers, at every level; 95 % intervals"
    pictures = replace(headline_table(run.headline), title=title)
    yield PlacedTable(pictures, in_text=False)
    sweeps = result_tables.sweep_tables(run.ours, n_reports=run.n_reports)
    for place, sweep in enumerate(sweeps):
        yield PlacedTable(sweep, on_page=place == 0)
    yield from map(PlacedTable, result_tables.horizon_tables(run.without_policy))
    yield PlacedTable(result_tables.standing_table(run.verdict.get("robots", ())))
    yield PlacedTable(answer_tables.frontier_table(run), in_text=False)
    slow = weak_attacks.slow_attacks(run.manifest)
    yield PlacedTable(result_tables.exposure_table(run.ours, slow=slow))
    yield PlacedTable(result_tables.attack_table(run.ours), on_page=False)
    yield PlacedTable(bound_table(run))
    yield PlacedTable(linked_bound_table(run))
    for task in run.tasks:
        yield PlacedTable(result_tables.rank_table(run, task))
    yield PlacedTable(result_tables.strength_table(run))
    yield from map(PlacedTable, return_tables(run))
    yield from map(PlacedTable, patrol_tables(run))
    yield PlacedTable(tracking_table(run))
    yield PlacedTable(answer_tables.paper_table(run))
    yield PlacedTable(answer_tables.claims_table(run))
    yield PlacedTable(answer_tables.flag_table(run), in_text=False)
    yield PlacedTable(result_tables.doubt_table(run), in_text=False)


def write_tex(run: Results, *, folder: Path) -> None:
    """Write sweep, attacks, paper, linkability and verdict as `.tex`.

    Raises DataError if a file cannot be written.
    """
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    attacked = result_tables.after_attack(run.ours)
    readers = result_tables.list_readers(attacked)
    files = {
        "sweep": result_tables.sweep_tables(run.ours, n_reports=run.n_reports),
        "attacks": [
            result_tables.attack_table(attacked, only=reader) for reader in readers
        ],
        "paper": [answer_tables.paper_table(run)],
        "linkability": [result_tables.rank_table(run, task) for task in run.tasks],
        "verdict": answer_tables.item_tables(run.verdict.get("items", ())).values(),
    }
    for name, tables in files.items():
        write_whole(folder / f"{name}.tex", latex(tables).encode())


def _linkage(summary: pd.DataFrame) -> Table:
    """Return rank 1 of every informed linker, a column for each level."""
    rows = summary[
        summary["metric"].isin([RANK1, "chance"]) & (summary["knowledge"] == INFORMED)
    ]
    families, numbers = families_in(rows), estimates_by_level(rows)
    columns = [
        text_column("task"),
        replace(text_column("chance"), unit="%", align="right"),
        text_column("linker"),
    ]
    records: dict[Address, dict[str, Any]] = {}
    for where in representative_levels(numbers, families, controls=False):
        heading = mechanism_name(families[where.mechanism], where.level)
        columns.append(cell_column(heading, f"{where}"))
        for reader, metrics in numbers[where].items():
            keys: dict[str, Any] = {
                "task": reader.task,
                "linker": reader.attack_spec,
                "chance": f"{PERCENT * metrics['chance'].value:.1f}",
            }
            record = records.setdefault(reader, keys)
            record[f"{where}"] = estimate_cell(RANK1, metrics.get(RANK1))
    return build_table(
        "linkage",
        "Rank 1 (%) of every linker; 95 % intervals",
        records.values(),
        columns,
    )


_FIRST: Final[dict[str, Callable[[Headline], Table]]] = {
    "headline": headline_table,
    "screen": short_table,
}
"""First tables by the name in a block: they need all laws and strongest attacks."""
# Suffix of the file with the numbers of the strongest attacks.
_STRONGEST: Final = "-strongest"
# Further tables by the name in a block.
DOCS: Final[dict[str, Callable[[pd.DataFrame], Table]]] = {
    "sweep": lambda summary: result_tables.sweep_tables(summary)[0],
    "exposure": result_tables.exposure_table,
    "attacks": result_tables.attack_table,
    "linkage": _linkage,
}


def published(run: Results) -> pd.DataFrame:
    """Return the rows of a run's summary that go into `docs/results`."""
    summary = run.without_policy
    if run.manifest["settings"]["preset"] == _REFERENCE:
        return summary
    by_level = estimates_by_level(summary)
    shown = set(representative_levels(by_level, run.families, controls=False))
    is_shown = np.array(
        [key.mechanism_level in shown for key in row_addresses(summary)]
    )
    is_control = np.array(
        [bool(parse_consumer(name).control) for name in summary["consumer"]],
        dtype=bool,
    )
    return summary[summary["metric"].isin(_SHOWN) & ~is_control & is_shown]


def write_docs(run: Results, *, root: Path) -> list[Path]:
    """Write published rows of a run into `docs/results` and fill all blocks anew.

    Returns the files that changed.

    `root` has README.md and docs/. Raises DataError if there is no README.md, a setting
    of the run is not the usual (the heads of these tables name the usual epsilon),
    a block names what is not there, or a file cannot be written.
    """
    if changed := changed_settings(run.manifest):
        raise DataError(
            f"docs show runs of the usual settings; this one has {' '.join(changed)}"
        )
    if not (root / "README.md").is_file():
        raise DataError(f"{root} has no README.md: run this in the repository")
    settings, results = run.manifest["settings"], root / "docs" / "results"
    results.mkdir(parents=True, exist_ok=True)
    path = results / f"{run.dataset}-{settings['preset']}-{settings['seed']}.csv"
    write_whole(path, to_csv(published(run)))
    strongest = path.with_stem(path.stem + _STRONGEST)
    is_usual = run.attacked["adversary"] == SINGLE_RELEASE
    write_whole(strongest, to_csv(run.attacked[is_usual]))
    written = [path, strongest]
    for page in (root / "README.md", *sorted((root / "docs").rglob("*.md"))):
        text = page.read_text(encoding="utf-8")
        if (new := filled(text, results=results)) != text:
            write_whole(page, new.encode())
            written.append(page)
    return written


def filled(text: str, *, results: Path) -> str:
    """Return a text with all blocks filled anew.

    Raises DataError for an unknown table or run.
    """

    def block(match: re.Match[str]) -> str:
        start, name, run, end = match.groups()
        path = results / f"{run}.csv"
        if name not in (*_FIRST, *DOCS) or not path.is_file():
            known = ", ".join((*_FIRST, *DOCS))
            raise DataError(f"no table {name!r} of {path}; known: {known}")
        rows = pd.read_csv(path, keep_default_na=True)
        if name in _FIRST:
            attacked = pd.read_csv(path.with_stem(path.stem + _STRONGEST))
            table = _FIRST[name](headline(rows, attacked=attacked))
        else:
            table = DOCS[name](rows[row_worlds(rows) == OWN_WORLD])
        return f"{start}{markdown(table)}{end}"

    return _BLOCK.sub(block, text)
