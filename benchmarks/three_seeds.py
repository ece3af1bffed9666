"""Does a sentence hold for other draws? `python -m benchmarks.three_seeds OUT OUT OUT`.

Of finished runs that differ in their seed alone: each number of the README's table as the median
over the runs, and the least and the most, with levels of both adding rules; and each item of the
verdict with what the runs decide, and its effect.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from evaluation.reporting.headline import headline, levels_of
from isac_track.command_line import DONE, Parser, exit_code

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables; return the exit code."""
    command = Parser(prog="python -m benchmarks.three_seeds", description=__doc__)
    command.add_argument("out", nargs="+", type=Path, metavar="OUT", help="folder of a run")
    return exit_code(lambda: _show(command.parse_args(arguments).out))


def _show(outs: Sequence[Path]) -> int:
    runs = [headline(pd.read_csv(out / "summary.csv")) for out in outs]
    first = runs[0]
    # The levels of the first table, under both adding rules.
    tabled = {(first.known[name].name, level) for name, level in levels_of(first)[0]}
    for where in first.wheres:
        if (first.known[where[0]].name, where[1]) not in tabled:
            continue
        for number, column in enumerate(first.columns):
            values = [run.at(where, run.columns[number]) for run in runs]
            found = [100 * one.value for one in values if one is not None]
            if found:
                print(f"{first.name(where):24} {column.measure.source.label:44} {_range(found)}")
    verdicts = [json.loads((out / "verdict.json").read_text())["items"] for out in outs]
    items: dict[str, list[dict[str, Any]]] = {}
    for item in (item for verdict in verdicts for item in verdict):
        if item["section"] != "inflation":  # its unit is another
            items.setdefault(item["id"], []).append(item)
    for name, of in items.items():
        decided = ", ".join(sorted({str(one["decision"]) for one in of}))
        effects = [one.get("spread", one.get("effect")) for one in of]
        print(f"{name:60} {_range([100 * one for one in effects if one is not None])} {decided}")
    return DONE


def _range(values: Iterable[float]) -> str:
    """Return the median of some numbers with the least and the most."""
    known = [one for one in values if math.isfinite(one)]
    return f"{np.median(known):6.1f} [{min(known):.1f}, {max(known):.1f}]" if known else ""


if __name__ == "__main__":
    sys.exit(main())
