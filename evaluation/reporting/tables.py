"""Which tables of a run are shown where: terminal, page, LaTeX files, and README and docs.

In README and docs a block is ``<!-- table: NAME RUN -->`` ... ``<!-- end -->``: table NAME of
`docs/results/RUN.csv`, a copy of the `summary.csv` of a run.
"""

from __future__ import annotations

import contextlib
import re
from typing import TYPE_CHECKING, Final

import pandas as pd

from evaluation.analysis import weak_attacks
from evaluation.reporting import answer_tables as answers
from evaluation.reporting import linkage_tables as linkage
from evaluation.reporting import summary_tables as levels
from evaluation.reporting import terminal
from evaluation.reporting.markup import latex, markdown
from evaluation.runs.files import write_whole
from evaluation.runs.pieces import failed_lines
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rich.console import Console

    from evaluation.reporting.rows import Results
    from evaluation.reporting.table import Table
    from evaluation.reporting.terminal import Part


DOCS: Final[dict[str, Callable[[pd.DataFrame], Table]]] = {
    "sweep": lambda summary: levels.sweep_tables(summary)[0],
    "exposure": levels.exposure_table,
    "attacks": levels.attack_table,
}
"""By the name in a block."""
_BLOCK = re.compile(r"(<!-- table: (\S+) (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


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


def write_docs(run: Results, *, root: Path) -> list[Path]:
    """Write the summary of a run into `docs/results` and all blocks anew; return what changed.

    Parameters
    ----------
    run : Results
    root : Path
        With README.md and docs/.

    Raises
    ------
    DataError
        If there is no README.md, a block names what is not there, or a file cannot be written.
    """
    if not (root / "README.md").is_file():
        raise DataError(f"{root} has no README.md: run this in the repository")
    settings, results = run.manifest["settings"], root / "docs" / "results"
    results.mkdir(parents=True, exist_ok=True)
    path = results / f"{run.dataset}-{settings['preset']}-{settings['seed']}.csv"
    write_whole(path, run.summary.to_csv(index=False).encode())
    changed = [path]
    for page in (root / "README.md", *sorted((root / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        new = filled(text, results=results)
        if new != text:
            write_whole(page, new.encode())
            changed.append(page)
    return changed


def filled(text: str, *, results: Path) -> str:
    """Return a text with all of its blocks written anew.

    Raises
    ------
    DataError
        If a block names a table or a run that is not there.
    """

    def block(found: re.Match[str]) -> str:
        start, name, run, end = found.groups()
        path = results / f"{run}.csv"
        if name not in DOCS or not path.is_file():
            raise DataError(f"no table {name!r} of {path}; known: {', '.join(DOCS)}")
        return f"{start}{markdown(DOCS[name](pd.read_csv(path, keep_default_na=True)))}{end}"

    return _BLOCK.sub(block, text)


def _exposure(run: Results) -> Table:
    return levels.exposure_table(run.ours, slow=weak_attacks.slow_attacks(run.manifest))
