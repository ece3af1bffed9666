"""Two runs side by side: `python -m evaluation.compare OUT_A OUT_B`.

What changed between them, and every number that both have: A, B, and B - A with an interval.
Nothing is written into either folder. docs/compare.md says how to read it.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluation.analysis.differences import DIFFERS, IDENTICAL, UNTESTED, compare, counts
from evaluation.reporting.difference_tables import show
from isac_track.command_line import Parser, exit_code
from isac_track.errors import DataError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from evaluation.analysis.differences import Comparison

_EXIT = """\
exit codes: 0 done, 1 a headline number differs (with --fail-on-change), 2 wrong usage or data

examples:
  python -m evaluation.compare runs/before runs/after
  python -m evaluation.compare runs/before runs/after --fail-on-change
  python -m evaluation.compare runs/mine --mechanism-a fid --mechanism-b fid:adding=independent
  python -m evaluation.compare runs/mine --mechanism-a fid:1 --mechanism-b fixed:0.7
"""


def to_json(comparison: Comparison, *, every: bool = False) -> dict[str, Any]:
    """Return a comparison as one object of plain values; what is unknown is None.

    `every` adds the numbers that are not in the headline.
    """
    rows = comparison.rows if every else comparison.rows[comparison.rows["headline"]]
    known = rows.replace([math.inf, -math.inf], math.nan).astype(object)
    return {
        "a": comparison.a,
        "b": comparison.b,
        "changed": {
            kind: {name: {"a": a, "b": b} for name, (a, b) in values.items()}
            for kind, values in comparison.changed.items()
        },
        "only": {axis: {"a": a, "b": b} for axis, (a, b) in comparison.only.items()},
        "numbers": {
            "in_both": len(comparison.rows),
            "only_a": comparison.only_numbers[0],
            "only_b": comparison.only_numbers[1],
            "headline": counts(comparison.rows[comparison.rows["headline"]]),
            "other": counts(comparison.rows[~comparison.rows["headline"]]),
            "pairing": comparison.rows["pairing"].value_counts().to_dict(),
        },
        "verdicts": comparison.verdicts,
        "differences": known.where(known.notna(), None).to_dict("records"),
    }


def _parser() -> argparse.ArgumentParser:
    command = Parser(
        prog="python -m evaluation.compare",
        description="Put two runs side by side: what changed, and which numbers differ.",
        epilog=_EXIT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = command.add_argument
    add("out_a", type=Path, metavar="OUT_A", help="folder of a run")
    add(
        "out_b",
        type=Path,
        metavar="OUT_B",
        nargs="?",
        help="folder of another; may be left out where two mechanisms of one run are compared",
    )
    for side in "ab":
        add(
            f"--mechanism-{side}",
            metavar="NAME|SPEC",
            help=f"mechanism of {side.upper()}, as in summary.csv (at every level that both have), "
            "or one level such as fid:1000",
        )
    add("--all", action="store_true", help="every metric, and every number that is not identical")
    add("--json", action="store_true", help="print one JSON object instead")
    add("--csv", type=Path, metavar="FILE", help="write all numbers as a tidy table")
    add(
        "--fail-on-change",
        action="store_true",
        help="exit code 1 if a headline number differs after Holm",
    )
    return command


def main(arguments: Iterable[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return exit_code(
        lambda: _run(_parser().parse_args(None if arguments is None else list(arguments)))
    )


def _run(options: argparse.Namespace) -> int:
    if options.out_b is None and options.mechanism_a is None:
        raise SettingsError("compare takes two run folders, or one with --mechanism-a and -b")
    comparison = compare(
        options.out_a,
        options.out_a if options.out_b is None else options.out_b,
        mechanism_a=options.mechanism_a,
        mechanism_b=options.mechanism_b,
    )
    if options.csv is not None:
        try:
            comparison.rows.to_csv(options.csv, index=False)
        except OSError as error:
            raise DataError(f"cannot write {options.csv}: {error.strerror or error}") from None
    if options.json:
        text = json.dumps(to_json(comparison, every=options.all), indent=1, allow_nan=False)
        print(text, flush=True)
    else:
        show(comparison, every=options.all)
    findings = comparison.rows.loc[comparison.rows["headline"], "finding"]
    if not options.fail_on_change:
        return 0
    if UNTESTED in set(findings) and set(findings) <= {UNTESTED, IDENTICAL}:
        # A gate that nothing can shut is none.
        raise DataError("--fail-on-change: no headline number that changed has an interval")
    return int((findings == DIFFERS).any())


if __name__ == "__main__":
    sys.exit(main())
