"""Which tables of a run are shown where: in the terminal, on the page and as LaTeX files."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from evaluation.analysis import weak_attacks
from evaluation.analysis.keys import Source
from evaluation.reporting.linkage_tables import cells_table, doubt_table, rank_table
from evaluation.reporting.markup import latex
from evaluation.reporting.paper_tables import (
    claims_table,
    decision_table,
    flag_table,
    matched_table,
    paper_table,
)
from evaluation.reporting.schemes import compared_levels
from evaluation.reporting.summary_tables import (
    after_attack,
    attack_table,
    exposure_table,
    sources_of,
    sweep_tables,
)
from evaluation.reporting.terminal import say, show_table, standard_output
from evaluation.reporting.verdict_tables import contrast_table, item_tables, short_tables
from evaluation.runs.files import write_whole
from evaluation.runs.pieces import failed_lines

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from rich.console import Console

    from evaluation.reporting.run_results import Results
    from evaluation.reporting.table import Table


def show(run: Results, *, console: Console | None = None) -> None:
    """Print what was run, its tables, its doubts and its verdict.

    Parameters
    ----------
    run : Results
    console : Console, optional
        By default standard output, as wide as the terminal or 116 columns where there is none.
    """
    console = standard_output() if console is None else console
    _show_header(run, console=console)
    for one in _printed(run):
        show_table(one, console=console)
    for name, why in run.manifest.get("linkage", {}).get("skipped", {}).items():
        console.print()
        say(console, f"{name} is left out: {why}", "yellow", wrap=True)
    flags = weak_attacks.lines(run.flags)
    if flags:
        console.print()
        flags.append("(Not adjusted: of two equally good attacks, a flag at one level in 40.)")
    for line in flags:
        say(console, line, "yellow", wrap=True)
    _show_verdict(run, console=console)
    for line in failed_lines(run.failed):
        say(console, f"failed: {line}", "red", wrap=True)


def page_tables(run: Results) -> dict[str, Table]:
    """Return the tables of the page by name; none of them is empty."""
    items = run.verdict["items"] if run.verdict else []
    strongest = [
        Source(f"{task}/{source.consumer}" if task else source.consumer, source.knowledge)
        for task, source in run.strongest.items()
    ]
    found = [
        paper_table(run.paper_table, run.families, dataset=run.dataset),
        claims_table(run.claims),
        *sweep_tables(run.ours),
        matched_table(run.matched, strongest=strongest),
        exposure_table(run.ours, slow=weak_attacks.slow_attacks(run.manifest)),
        attack_table(run.ours),
        *(_ranks(run)),
        *(cells_table(task, run.families) for task in run.tasks),
        decision_table(run.decisions, run.families, wheres=compared_levels(run.ours)),
        flag_table(run.flags, run.families),
        doubt_table(run.linkability, run.families),
        contrast_table(items),
        *item_tables(items).values(),
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
    attacks = [attack_table(run.ours, only=source) for source in sources_of(after_attack(run.ours))]
    files = {
        "sweep": sweep_tables(run.ours),
        "attacks": attacks,
        "paper": [paper_table(run.paper_table, run.families, dataset=run.dataset)],
        "linkability": _ranks(run),
        "verdict": short_tables(run.verdict) if run.verdict else [],
    }
    for name, tables in files.items():
        write_whole(folder / f"{name}.tex", latex(tables).encode())


def _printed(run: Results) -> list[Table]:
    return [
        *sweep_tables(run.ours),
        exposure_table(run.ours, slow=weak_attacks.slow_attacks(run.manifest)),
        attack_table(run.ours),
        *_ranks(run),
        paper_table(run.paper_table, run.families, dataset=run.dataset),
        claims_table(run.claims),
    ]


def _ranks(run: Results) -> list[Table]:
    known: Mapping[str, Mapping[str, int]] = run.manifest.get("linkage", {}).get("tasks", {})
    return [
        rank_table(task, run.families, people=known.get(task.name, {}).get("people"))
        for task in run.tasks
    ]


def _show_header(run: Results, *, console: Console) -> None:
    dataset, identity = run.manifest["dataset"], run.manifest["identity"]
    text = (
        f"{dataset['name']}: {dataset['tracks_used']} of {dataset['tracks']} tracks used, "
        f"{identity['scenes']} scenes, seed {identity['seed']}"
    )
    say(console, text, "bold", wrap=True)
    notice = dataset.get("notice")
    if notice or dataset.get("simulated"):
        say(console, f"NOTICE: {notice or 'the tracks are simulated'}", "yellow", wrap=True)


def _show_verdict(run: Results, *, console: Console) -> None:
    if not run.verdict or not run.verdict["items"]:
        return
    console.print()
    say(console, "Verdict", "bold")
    for sentence in run.verdict["answer"]:
        say(console, f"- {sentence}", wrap=True)
    for one in short_tables(run.verdict):
        show_table(one, console=console)
    say(
        console,
        "(?: undecided, no statement either way. Items, intervals and reasons: verdict.json.)",
        wrap=True,
    )
