"""Which tables of a run are shown where: terminal, text file, page, LaTeX, README and docs.

In README and docs a block is ``<!-- table: NAME RUN -->`` ... ``<!-- end -->``: table
NAME of `docs/results/RUN.csv`, the rows of a run's `summary.csv` that are shown, of the
smoke run all.
"""

import contextlib
import io
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from rich.console import Console
from rich.text import Text

from evaluation.estimates import weak_attacks
from evaluation.estimates.families import families_in
from evaluation.estimates.keys import INFORMED, Source, keys_of, worlds_of
from evaluation.estimates.metrics import (
    RECONSTRUCTION,
    SUCCESS,
    SUCCESS_OF_100,
    UTILITY,
)
from evaluation.estimates.strongest_table import ONE_RELEASE
from evaluation.pool.pieces import failed_lines
from evaluation.reporting import answer_tables, terminal
from evaluation.reporting import result_tables as measured
from evaluation.reporting.announcements import changed_settings
from evaluation.reporting.answers import answers, headline_of
from evaluation.reporting.bounds import bound_table, linked_bound_table
from evaluation.reporting.first_screen import (
    TABLES,
    data_line,
    doubts,
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
    notices,
    used_are_slower,
    who_is_linked,
)
from evaluation.reporting.rows import Results, by_level, telling
from evaluation.reporting.table import Table, built, estimated, held, said
from evaluation.reporting.terminal import Part
from evaluation.store.files import to_csv, write_whole
from isac_track.errors import DataError

_BLOCK = re.compile(r"(<!-- table: (\S+) (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
_WIDE: Final = 160  # Columns of `tables.txt`.
# The preset whose numbers the tests hold a fresh run against.
_REFERENCE: Final = "smoke"
_SHOWN: Final = (*UTILITY, *RECONSTRUCTION, SUCCESS, SUCCESS_OF_100, "chance")


def show(run: Results, *, before: int = 0, verbose: bool = False) -> None:
    """Print the first screen, of which `before` lines were printed already, or all tables."""
    console = terminal.standard_output()
    if verbose:
        terminal.show(_everything(run), console=console)
        return
    for line in first_screen(run, before=before):
        console.print(Text(terminal.literal(console, line)), soft_wrap=True)


def write_text(run: Results) -> None:
    """Write `tables.txt`: all that is not on the first screen. DataError if it cannot be."""
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
    yield from geometry(run.manifest)
    yield from who_is_linked(run.manifest)
    yield from _answer_lines(run)
    yield from plugin_lines(run)
    yield from measured.sweep_tables(run.ours, n_reports=run.n_reports)
    yield from measured.horizon_tables(run.summary)
    yield measured.standing_table(run.verdict.get("robots", ()))
    yield measured.exposure_table(
        run.ours, slow=weak_attacks.slow_attacks(run.manifest)
    )
    yield measured.attack_table(run.ours)
    yield from (bound_table(run), linked_bound_table(run))
    yield from (measured.rank_table(run, task) for task in run.tasks)
    yield measured.strength_table(run)
    yield from (answer_tables.paper_table(run), answer_tables.claims_table(run))
    for name, why in run.manifest.get("linkage", {}).get("skipped", {}).items():
        yield ""
        yield f"{name} is left out: {why}", "yellow"
    if flags := weak_attacks.lines(run.flags):
        note = "(Not adjusted: of two equally good attacks, a flag at one level in 40.)"
        yield ""
        yield from ((line, "yellow") for line in [*flags, note])
    if items := run.verdict.get("items"):
        yield from ("", ("Verdict", "bold"))
        yield from answer_tables.item_tables(items).values()
        yield "(In words, with reasons: verdict.json.)"
    for line in failed_lines(run.failed):
        yield f"failed: {line}", "red"


def _answer_lines(run: Results) -> Iterator[Part]:
    """Yield the five answers with their details, and all doubts."""
    table = headline_of(run)
    yield ""
    for answer in answers(run, table):
        yield " ".join([f"{answer.topic}: {answer.sentence}", *answer.details])
    yield from (f"Doubt: {text}." for text in doubts(run, table))


def page_tables(run: Results) -> dict[str, Table]:
    """Return the tables of the page by name; none of them is empty."""
    title = "The pictures in numbers, at every level; 95 % intervals"
    tables = [
        replace(headline_table(headline_of(run)), title=title),
        answer_tables.paper_table(run),
        answer_tables.claims_table(run),
        *measured.sweep_tables(run.ours, n_reports=run.n_reports)[:1],
        *measured.horizon_tables(run.summary),
        measured.standing_table(run.verdict.get("robots", ())),
        answer_tables.frontier_table(run),
        measured.exposure_table(run.ours, slow=weak_attacks.slow_attacks(run.manifest)),
        bound_table(run),
        linked_bound_table(run),
        *(measured.rank_table(run, task) for task in run.tasks),
        measured.strength_table(run),
        answer_tables.flag_table(run),
        measured.doubt_table(run),
        *answer_tables.item_tables(run.verdict.get("items", ())).values(),
    ]
    return {table.name: table for table in tables if table.rows}


def write_tex(run: Results, *, folder: Path) -> None:
    """Write sweep, attacks, paper, linkability and verdict as `.tex`. DataError if it cannot be."""
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    attacked = measured.after_attack(run.ours)
    sources = measured.sources_of(attacked)
    files = {
        "sweep": measured.sweep_tables(run.ours, n_reports=run.n_reports),
        "attacks": [measured.attack_table(attacked, only=source) for source in sources],
        "paper": [answer_tables.paper_table(run)],
        "linkability": [measured.rank_table(run, task) for task in run.tasks],
        "verdict": answer_tables.item_tables(run.verdict.get("items", ())).values(),
    }
    for name, tables in files.items():
        write_whole(folder / f"{name}.tex", latex(tables).encode())


def _linkage(summary: pd.DataFrame) -> Table:
    """Return rank 1 of every informed linker, a column for each level."""
    rows = summary[
        summary["metric"].isin([SUCCESS, "chance"]) & (summary["knowledge"] == INFORMED)
    ]
    known, numbers = families_in(rows), by_level(rows)
    columns = [
        said("task"),
        replace(said("chance"), unit="%", align="right"),
        said("linker"),
    ]
    records: dict[Source, dict[str, Any]] = {}
    for where in telling(numbers, known, controls=False):
        heading = mechanism_name(known[where[0]], where[1])
        columns.append(held(heading, f"{where}"))
        for source, metrics in numbers[where].items():
            about: dict[str, Any] = {
                "task": source.task,
                "linker": source.attack.consumer,
            }
            about["chance"] = f"{100 * metrics['chance'].value:.1f}"
            records.setdefault(source, about)[f"{where}"] = estimated(
                SUCCESS, metrics.get(SUCCESS)
            )
    return built(
        "linkage",
        "Rank 1 (%) of every linker; 95 % intervals",
        records.values(),
        columns,
    )


_FIRST: Final[dict[str, Callable[[Headline], Table]]] = {
    "headline": headline_table,
    "screen": short_table,
}
"""First tables of a run by the name in a block: they take all error laws and strongest attacks."""
# Of the name of a file: the numbers of the strongest attacks.
_STRONGEST: Final = "-strongest"
DOCS: Final[dict[str, Callable[[pd.DataFrame], Table]]] = {  # By the name in a block.
    "sweep": lambda summary: measured.sweep_tables(summary)[0],
    "exposure": measured.exposure_table,
    "attacks": measured.attack_table,
    "linkage": _linkage,
}


def published(run: Results) -> pd.DataFrame:
    """Return the rows of a run's summary that go into `docs/results`."""
    summary = run.summary
    if run.manifest["settings"]["preset"] == _REFERENCE:
        return summary
    shown = set(telling(by_level(summary), run.families, controls=False))
    is_shown = np.array([key.where in shown for key in keys_of(summary)])
    is_control = summary["consumer"].str.contains("/control-")
    return summary[summary["metric"].isin(_SHOWN) & ~is_control & is_shown]


def write_docs(run: Results, *, root: Path) -> list[Path]:
    """Write what is shown of a run into `docs/results`, and all blocks anew; return what changed.

    `root` has README.md and docs/. Raises DataError if there is no README.md, a setting
    of the run is not the usual one (the heads of these tables name the usual epsilon),
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
    is_usual = run.attacked["adversary"] == ONE_RELEASE
    write_whole(strongest, to_csv(run.attacked[is_usual]))
    written = [path, strongest]
    for page in (root / "README.md", *sorted((root / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        if (new := filled(text, results=results)) != text:
            write_whole(page, new.encode())
            written.append(page)
    return written


def filled(text: str, *, results: Path) -> str:
    """Return a text, its blocks written anew. DataError for a table or run that is not there."""

    def block(match: re.Match[str]) -> str:
        start, name, run, end = match.groups()
        path = results / f"{run}.csv"
        if name not in (*_FIRST, *DOCS) or not path.is_file():
            known = ", ".join((*_FIRST, *DOCS))
            raise DataError(f"no table {name!r} of {path}; known: {known}")
        rows = pd.read_csv(path, keep_default_na=True)
        if name in _FIRST:
            attacked = pd.read_csv(path.with_stem(path.stem + _STRONGEST))
            return f"{start}{markdown(_FIRST[name](headline(rows, attacked=attacked)))}{end}"
        return f"{start}{markdown(DOCS[name](rows[worlds_of(rows) == '']))}{end}"

    return _BLOCK.sub(block, text)
