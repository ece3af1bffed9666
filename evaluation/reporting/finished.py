"""A finished run, read from its tables: `evaluation.load`."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from evaluation.estimates.keys import keys_of
from evaluation.estimates.metrics import ASSIGNED, EXPOSURE, SUCCESS
from evaluation.estimates.strongest import strongest
from evaluation.reporting.rows import Results
from evaluation.reporting.table import Table
from evaluation.store.files import FRAMES, made_of
from evaluation.store.manifest import read_manifest


class _Known(NamedTuple):
    value: float


def load(out: Path | str) -> Results:
    """Return the results of a finished run as its tables hold them, without the gallery of tracks.

    Nothing is made anew: that does `evaluation.report`, from the cells.

    Raises DataError if the folder holds no run, or a table is missing or broken, with
    the way out.
    """
    out = Path(out)
    manifest = read_manifest(out)
    files = {**FRAMES, "flags": "flags.json", "verdict": "verdict.json"}
    tables: dict[str, Any] = {
        field: made_of(out, name) for field, name in files.items()
    }
    flags = tables["flags"]
    tables["flags"] = pd.DataFrame(flags["flags"], columns=flags.get("columns"))
    results = Results(out=out, manifest=manifest, **tables)
    rows = results.measured
    rows = rows[
        rows["metric"].isin([EXPOSURE, SUCCESS, ASSIGNED]) & (rows["knowledge"] != "")
    ]
    # Their values alone are asked for, and what makes estimates takes long to import.
    known: Any = dict(zip(keys_of(rows), map(_Known, rows["value"]), strict=True))
    best = strongest(known, results.families)
    strongest_of = {task: source.attack for task, source in best.items()}
    results = replace(results, strongest=strongest_of)
    return replace(results, first_table_of=_first_table)


def _first_table(results: Results) -> Table:
    # What makes it takes long to import, and is needed only by who looks at it.
    from evaluation.reporting.first_screen import first_table  # noqa: PLC0415 - as said

    return first_table(results)
