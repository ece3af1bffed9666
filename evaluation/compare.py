"""Compare two runs: `python -m evaluation.compare OUT_A OUT_B`; see docs/how-to/compare.md."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from evaluation.estimates.differences import compare
from evaluation.reporting.difference_tables import show, to_json
from evaluation.store.csv_files import to_csv
from isac_track.command_line import Parser, exit_code
from isac_track.errors import DataError

_EPILOG = """\
exit codes: 0 done, 1 a headline number differs (with --fail-on-change), 2 wrong usage or data

examples:
  python -m evaluation.compare runs/before runs/after
  python -m evaluation.compare runs/before runs/after --fail-on-change
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.compare",
        description="Compare two runs: what changed, and which numbers differ.",
        epilog=_EPILOG,
    )
    add = command.add_argument
    add("out_a", type=Path, metavar="OUT_A", help="folder of the first run")
    add("out_b", type=Path, metavar="OUT_B", help="folder of the second run")
    add("--all", action="store_true", help="show every number that is not identical")
    add("--json", action="store_true", help="print one JSON object instead")
    add("--csv", type=Path, metavar="FILE", help="write all numbers as a tidy table")
    about = "end with exit code 1 if a headline number differs after Holm's correction"
    add("--fail-on-change", action="store_true", help=about)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    comparison = compare(options.out_a, options.out_b)
    if options.csv is not None:
        try:
            options.csv.write_bytes(to_csv(comparison.rows))
        except OSError as error:
            raise DataError(
                f"cannot write {options.csv}: {error.strerror or error}"
            ) from None
    if options.json:
        content = to_json(comparison, every=options.all)
        print(json.dumps(content, indent=1, allow_nan=False), flush=True)
    else:
        show(comparison, every=options.all)
    return int(options.fail_on_change and comparison.has_changed())


if __name__ == "__main__":
    sys.exit(main())
