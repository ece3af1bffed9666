"""Tables of results in README and docs: written between marks, from committed summaries.

A block is ``<!-- table: NAME RUN -->`` ... ``<!-- end -->``: table NAME of `docs/results/RUN.csv`,
a copy of the `summary.csv` of a run.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import pandas as pd

from evaluation.reporting.markup import markdown
from evaluation.reporting.summary_tables import attack_table, exposure_table, sweep_tables
from evaluation.runs.files import write_whole
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from evaluation.reporting.run_results import Results
    from evaluation.reporting.table import Table

TABLES: Final[dict[str, Callable[[pd.DataFrame], Table]]] = {
    "sweep": lambda summary: sweep_tables(summary)[0],
    "exposure": exposure_table,
    "attacks": attack_table,
}
"""By the name in a block."""
_BLOCK = re.compile(r"(<!-- table: (\S+) (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


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
    files = {path: run.summary.to_csv(index=False)}
    write_whole(path, files[path].encode())
    for page in (root / "README.md", *sorted((root / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        files[page] = filled(text, results=results)
        if files[page] == text:
            del files[page]
        else:
            write_whole(page, files[page].encode())
    return list(files)


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
        if name not in TABLES or not path.is_file():
            raise DataError(f"no table {name!r} of {path}; known: {', '.join(TABLES)}")
        return f"{start}{markdown(TABLES[name](pd.read_csv(path, keep_default_na=True)))}{end}"

    return _BLOCK.sub(block, text)
