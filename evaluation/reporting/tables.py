"""Which tables of a run are shown where: terminal, page and LaTeX files."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from evaluation.analysis import weak_attacks
from evaluation.reporting import answer_tables as answers
from evaluation.reporting import linkage_tables as linkage
from evaluation.reporting import summary_tables as levels
from evaluation.reporting import terminal
from evaluation.reporting.markup import latex
from evaluation.runs.files import write_whole
from evaluation.runs.pieces import failed_lines

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rich.console import Console

    from evaluation.reporting.rows import Results
    from evaluation.reporting.table import Table
    from evaluation.reporting.terminal import Part


def show(run: Results, *, console: Console | None = None) -> None:
    """Print what was run, its tables, its doubts and its verdict.

    Parameters
    ----------
    run : Results
    console : Console, optional
        By default standard output, as wide as the terminal or 116 columns where there is none.
    """
    terminal.show(_printed(run), console=console)


def _printed(run: Results) -> Iterator[Part]:
    dataset, identity = run.manifest["dataset"], run.manifest["identity"]
    used = f"{dataset['tracks_used']} of {dataset['tracks']} tracks used"
    about = f"{used}, {identity['scenes']} scenes, seed {identity['seed']}"
    yield f"{dataset['name']}: {about}", "bold"
    notice = dataset.get("notice")
    if notice or dataset.get("simulated"):
        yield f"NOTICE: {notice or 'the tracks are simulated'}", "yellow"
    yield from levels.sweep_tables(run.ours)
    yield _exposure(run)
    yield levels.attack_table(run.ours)
    yield from (linkage.rank_table(run, task) for task in run.tasks)
    yield answers.paper_table(run)
    yield answers.claims_table(run)
    for name, why in run.manifest.get("linkage", {}).get("skipped", {}).items():
        yield ""
        yield f"{name} is left out: {why}", "yellow"
    if flags := weak_attacks.lines(run.flags):
        note = "(Not adjusted: of two equally good attacks, a flag at one level in 40.)"
        yield ""
        yield from ((line, "yellow") for line in [*flags, note])
    if run.verdict and run.verdict["items"]:
        yield ""
        yield "Verdict", "bold"
        yield from (f"- {one}" for one in run.verdict["answer"])
        yield from answers.short_tables(run.verdict)
        yield "(?: undecided, no statement either way. Items, intervals and reasons: verdict.json.)"
    for line in failed_lines(run.failed):
        yield f"failed: {line}", "red"


def page_tables(run: Results) -> dict[str, Table]:
    """Return the tables of the page by name; none of them is empty."""
    items = run.verdict["items"] if run.verdict else []
    found = [
        answers.paper_table(run),
        answers.claims_table(run),
        *levels.sweep_tables(run.ours),
        answers.matched_table(run),
        _exposure(run),
        levels.attack_table(run.ours),
        *(linkage.rank_table(run, task) for task in run.tasks),
        *(linkage.cells_table(run, task) for task in run.tasks),
        answers.decision_table(run),
        answers.flag_table(run),
        linkage.doubt_table(run),
        answers.contrast_table(items),
        *answers.item_tables(items).values(),
    ]
    return {one.name: one for one in found if one.rows}


def write_tex(run: Results, *, folder: Path) -> None:
    """Write sweep, attacks, paper, linkability and verdict as `.tex`: booktabs tabulars.

    Raises
    ------
    DataError
        If the folder cannot be written.
    """
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    sources = levels.sources_of(levels.after_attack(run.ours))
    attacks = [levels.attack_table(run.ours, only=source) for source in sources]
    files = {
        "sweep": levels.sweep_tables(run.ours),
        "attacks": attacks,
        "paper": [answers.paper_table(run)],
        "linkability": [linkage.rank_table(run, task) for task in run.tasks],
        "verdict": answers.short_tables(run.verdict) if run.verdict else [],
    }
    for name, tables in files.items():
        write_whole(folder / f"{name}.tex", latex(tables).encode())


def _exposure(run: Results) -> Table:
    return levels.exposure_table(run.ours, slow=weak_attacks.slow_attacks(run.manifest))
