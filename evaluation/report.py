"""Redraw a report from a run's finished cells: `python -m evaluation.report OUT`."""

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from evaluation.api import rebuild
from evaluation.reporting.docs_pages import write_pages
from evaluation.reporting.tables import show, write_docs
from isac_track.command_line import DONE, FAILED_CELLS, Parser, exit_code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.report",
        description=(
            "Redraw summary, tables and figures of a run folder from its finished"
            " cells."
        ),
    )
    add = command.add_argument
    add("out", type=Path, help="folder of a run, as given to the matrix by --out")
    add("--pdf", action="store_true", help="also write every figure as PDF, for print")
    add("--verbose", action="store_true", help="print all tables, as in tables.txt")
    about = (
        "also write its tables, the glossary and a picture of a walk into README and"
        " docs"
    )
    add("--docs", action="store_true", help=about)
    return exit_code(lambda: _redraw(command.parse_args(arguments)))


def _redraw(options: Namespace) -> int:
    results = rebuild(options.out, pdf=options.pdf)
    show(results, verbose=options.verbose)
    if options.docs:
        root = Path.cwd()
        for path in [*write_docs(results, root=root), *write_pages(results, root=root)]:
            print(f"written: {path}")
    return FAILED_CELLS if len(results.failed) else DONE


if __name__ == "__main__":
    sys.exit(main())
