"""The results as text: in the terminal, as LaTeX files and as Markdown."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import pandas as pd
from rich.table import Table
from rich.text import Text

from evaluation.analysis import weak_attacks as flags
from evaluation.analysis.keys import AS_SHARED, ORACLE, Source
from evaluation.analysis.levels import (
    HEADLINE,
    SHOWN,
    after_attack,
    amount,
    heading,
    level_text,
    number,
    shared_head,
    sweeps,
)
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.analysis.paper import DATASET, tolerance
from evaluation.reporting import verdict_tables
from evaluation.reporting.attack_tables import show_attacks
from evaluation.reporting.latex import attacks_tex, linkability_tex, paper_tex, sweep_tex
from evaluation.reporting.linkage_tables import show_linkage
from evaluation.reporting.terminal import aligned, literal, say, show_grouped, standard_output
from evaluation.runs.failures import failed_lines
from evaluation.runs.files import write_whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from collections.abc import Set as AbstractSet
    from pathlib import Path

    from rich.console import Console

    from evaluation.analysis.levels import Number, Sweep

# The metrics that keep their interval, from wide terminals to narrow ones.
_INTERVALS = (
    frozenset(SHOWN),
    frozenset({"missed_conflict_rate", "plr", "ael", "mel"}),
    frozenset({"missed_conflict_rate", "plr"}),
    frozenset[str](),
)
_LONGEST_LABEL = 8
_TELLING = (
    AS_SHARED,
    Source("kalman_rts", "informed"),
    Source("radial_rts", "informed"),
    Source("averaging", ORACLE),
)
_ANSWER_STYLES = {"holds": "green", "does not hold": "red", "undecided": "yellow"}


def show(
    summary: pd.DataFrame,
    paper_table: pd.DataFrame,
    claims: pd.DataFrame,
    *,
    manifest: Mapping[str, Any],
    linkability: pd.DataFrame | None = None,
    console: Console | None = None,
) -> None:
    """Print what was run, the sweep, what attacks leave and link, and the paper's numbers.

    Parameters
    ----------
    summary, paper_table, claims : DataFrame
        As in `summary.csv`, `paper_table.csv` and `paper_claims.csv`.
    manifest : mapping
        As in `manifest.json`.
    linkability : DataFrame, optional
        As in `linkability.csv`.
    console : Console, optional
        By default standard output, as wide as the terminal or 116 columns where there is none.
    """
    console = standard_output() if console is None else console
    _show_header(manifest, console=console)
    for sweep in sweeps(summary):
        _show_sweep(sweep, console=console)
    show_attacks(summary, slow=flags.slow_attacks(manifest), console=console)
    if linkability is not None:
        show_linkage(linkability, manifest=manifest, console=console)
    if not paper_table.empty:
        _show_paper(paper_table, dataset=manifest["dataset"]["name"], console=console)
    if not claims.empty:
        _show_claims(claims, console=console)


def show_verdict(said: Mapping[str, Any], *, console: Console | None = None) -> None:
    """Print the verdict, in three sentences and a table for each section."""
    verdict_tables.show_verdict(said, console=standard_output() if console is None else console)


def show_flags(rows: pd.DataFrame, *, console: Console | None = None) -> None:
    """Print the flags of weak attacks, in short; nothing without any."""
    console = standard_output() if console is None else console
    lines = flags.lines(rows)
    if not lines:
        return
    console.print()
    for line in lines:
        say(console, line, "yellow", wrap=True)
    say(
        console,
        "(Not adjusted: of two equally good attacks, a flag at one level in 40.)",
        wrap=True,
    )


def show_failed(rows: pd.DataFrame, *, console: Console | None = None) -> None:
    """Print which cells failed, a line for each reason; nothing without any."""
    console = standard_output() if console is None else console
    for line in failed_lines(rows):
        say(console, f"failed: {line}", "red", wrap=True)


def write_tex(
    summary: pd.DataFrame,
    paper_table: pd.DataFrame,
    *,
    folder: Path,
    linkability: pd.DataFrame | None = None,
    said: Mapping[str, Any] | None = None,
) -> None:
    """Write sweep, attacks, paper, linkability and verdict as `.tex`: booktabs tabulars.

    The last two are left out without `linkability` and `said` (as in `verdict.json`).

    Raises
    ------
    DataError
        If the folder cannot be written.
    """
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / "sweep.tex", sweep_tex(summary).encode())
    write_whole(folder / "attacks.tex", attacks_tex(summary).encode())
    write_whole(folder / "paper.tex", paper_tex(paper_table).encode())
    if linkability is not None:
        write_whole(folder / "linkability.tex", linkability_tex(linkability).encode())
    if said is not None:
        write_whole(folder / "verdict.tex", verdict_tables.verdict_tex(said).encode())


def headline_markdown(summary: pd.DataFrame) -> str:
    """Return the few rows that tell the story, as a table in GitHub's Markdown."""
    metrics = ("missed_conflict_rate", *DESCRIPTORS)
    tables = sweeps(summary)
    blocks = tables[0].blocks if tables else {}
    return _markdown(
        [shared_head(metric) for metric in metrics],
        {
            (mechanism, level): [row.get(metric) for metric in metrics]
            for mechanism, levels in blocks.items()
            for level, row in levels.items()
        },
    )


def attacks_markdown(summary: pd.DataFrame) -> str:
    """Return PLR at the headline levels, as shared and after the telling attacks, in Markdown."""
    after = after_attack(summary)
    return _markdown(
        [f"PLR, {source.label} (%)" for source in _TELLING],
        {
            where: [block.get(source, {}).get("plr") for source in _TELLING]
            for where, block in after.items()
        },
    )


def _markdown(
    heads: Sequence[str], rows: Mapping[tuple[str, float | None], Sequence[Number | None]]
) -> str:
    """Return the headline levels of both adding rules, as far as they are there."""
    lines = ["| sharing | adding | " + " | ".join(heads) + " |", "|:--|:--|" + "--:|" * len(heads)]
    for adding, suffix in ADDING_SUFFIX.items():
        for mechanism, level, name in HEADLINE:
            if level is None and suffix:  # raw adds nothing
                continue
            row = rows.get((mechanism if level is None else mechanism + suffix, level))
            if row is None:
                continue
            cells = [
                ""
                if shown is None
                else f"{shown.value} [{shown.low}, {shown.high}]"
                if shown.low
                else shown.value
                for shown in row
            ]
            lines.append(f"| {name} | {'' if level is None else adding} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _show_header(manifest: Mapping[str, Any], *, console: Console) -> None:
    dataset, identity = manifest["dataset"], manifest["identity"]
    say(
        console,
        f"{dataset['name']}: {dataset['tracks_used']} of {dataset['tracks']} tracks used, "
        f"{identity['scenes']} scenes, seed {identity['seed']}",
        "bold",
        wrap=True,
    )
    notice = dataset.get("notice")
    if notice or dataset.get("simulated"):
        say(console, f"NOTICE: {notice or 'the tracks are simulated'}", "yellow", wrap=True)


def _show_sweep(sweep: Sweep, *, console: Console) -> None:
    for intervals in _INTERVALS:
        grid = _sweep_grid(sweep, intervals=intervals)
        lines = aligned([cells for _, cells in grid], close=_interval_columns(sweep, intervals))
        if max(map(len, lines)) <= console.width:
            break
    predictor = "" if sweep.predictor is None else f", predictor {sweep.predictor}"
    left_out = "" if intervals >= set(sweep.metrics) else " where there is room"
    console.print()
    shared = "; privacy as shared" if set(DESCRIPTORS) & set(sweep.metrics) else ""
    text = f"Sweep{predictor}{shared}: values with 95 % intervals{left_out}"
    say(console, text, "bold", wrap=True)
    show_grouped(grid, lines, console=console)


def _sweep_grid(sweep: Sweep, *, intervals: AbstractSet[str]) -> list[tuple[str | None, list[str]]]:
    """Return the rows of cells, each under its heading; the head has none."""
    heads: list[list[str]] = [[""], ["level"]]
    for metric in sweep.metrics:
        first, _, rest = SHOWN[metric].head.partition(" ")
        pad = [""] * (metric in intervals)
        heads[0] += [first, *pad]
        heads[1] += [f"{rest} {SHOWN[metric].unit}".strip(), *pad]
    grid: list[tuple[str | None, list[str]]] = [(None, cells) for cells in heads]
    for mechanism, levels in sweep.blocks.items():
        for level, row in levels.items():
            alone = level is None and len(mechanism) <= _LONGEST_LABEL
            cells = [mechanism if alone else level_text(level)]
            for metric in sweep.metrics:
                shown = row.get(metric)
                cells.append("-" if shown is None or not shown.value else shown.value)
                if metric in intervals:
                    cells.append("" if shown is None else shown.interval)
            grid.append((heading(mechanism), cells))
    return grid


def _interval_columns(sweep: Sweep, intervals: AbstractSet[str]) -> set[int]:
    """Return which columns of the grid hold intervals."""
    columns = ["level"]
    for metric in sweep.metrics:
        columns += [metric, *["interval"] * (metric in intervals)]
    return {index for index, name in enumerate(columns) if name == "interval"}


def _show_paper(paper_table: pd.DataFrame, *, dataset: str, console: Console) -> None:
    same = dataset == DATASET
    console.print()
    say(console, "The paper's numbers beside ours, privacy as shared", "bold", wrap=True)
    if not same:
        say(
            console,
            f"The paper used {DATASET}; ours are of {dataset}, so they need not agree.",
            "yellow",
            wrap=True,
        )
    heads = [
        ["", "", "", "", "95 %", "ours -", "paper in", "tolerance at"],
        ["level", "metric", "paper", "ours", "interval", "paper", "interval", "5,000 scenes"],
    ]
    rows: list[tuple[str | None, list[str]]] = [(None, head) for head in heads]
    rows += [
        (heading(row["mechanism"]), _paper_cells(row)) for row in paper_table.to_dict("records")
    ]
    lines = aligned([cells if same else cells[:6] for _, cells in rows], left={1})
    show_grouped(rows, lines, console=console)


def _paper_cells(row: Mapping[Any, Any]) -> list[str]:
    metric = row["metric"]
    ours = number(metric, row["ours"], row["ci_low"], row["ci_high"])
    bias = row["ours"] - row["paper"]
    allowed = tolerance(row["mechanism"], metric, row["paper"])
    # A hair more: the difference of two rounded fractions may miss the limit itself.
    met = "yes" if abs(bias) <= allowed + 1e-12 else "no"
    return [
        level_text(row["level"]),
        f"{SHOWN[metric].head} {SHOWN[metric].unit}",
        amount(metric, row["paper"]),
        ours.value or "-",
        ours.interval,
        amount(metric, bias, sign="+") if ours.value else "",
        "" if pd.isna(row["within"]) or not ours.low else "yes" if row["within"] else "no",
        f"{met} ({amount(metric, allowed)})" if ours.value else "",
    ]


def _show_claims(claims: pd.DataFrame, *, console: Console) -> None:
    console.print()
    say(console, "The paper's claims (evidence: paper_claims.csv)", "bold")
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, show_edge=False)
    table.add_column("claim", ratio=1, overflow="fold")
    table.add_column("answer", no_wrap=True)
    for name in ("effect", "95 % interval", "unit"):
        table.add_column(name, no_wrap=True, justify="left" if name == "unit" else "right")
    adding = None
    for row in claims.to_dict("records"):
        if row["adding"] != adding and isinstance(row["adding"], str) and row["adding"]:
            table.add_row(Text(f"{row['adding']} adding", style="bold cyan"))
        adding = row["adding"]
        scale, digits, unit = {"fraction": (100.0, 1, "%-points"), "s": (1.0, 3, "s")}.get(
            row["unit"], (1.0, 1, str(row["unit"]))
        )
        effect, low, high = (row[key] * scale for key in ("effect", "ci_low", "ci_high"))
        table.add_row(
            Text(literal(console, row["claim"])),
            Text(row["answer"], style=_ANSWER_STYLES.get(row["answer"], "")),
            Text("-" if pd.isna(effect) else f"{effect:.{digits}f}"),
            Text("" if pd.isna(low) else f"[{low:.{digits}f}, {high:.{digits}f}]"),
            Text(unit),
        )
    console.print(table)
