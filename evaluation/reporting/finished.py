"""A finished run, read from its tables: `evaluation.load`."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from evaluation.estimates.keys import row_addresses
from evaluation.estimates.metrics import PLR, RANK1, RANK1_JOINT
from evaluation.estimates.strongest import strongest_by_task
from evaluation.reporting.rows import Results
from evaluation.reporting.table import Table
from evaluation.store.csv_files import read_report_file
from evaluation.store.files import FRAMES
from evaluation.store.manifest import read_manifest


class _Value(NamedTuple):
    """An estimate without its interval: `Estimate` takes long to import."""

    value: float


def load(out: Path | str) -> Results:
    """Return the results of a finished run from its tables; they have no gallery.

    Nothing is computed: `evaluation.report` makes the tables anew from the cells.

    Parameters
    ----------
    out : Path or str
        Run folder.

    Raises
    ------
    DataError
        If the folder holds no run, or a table is missing or broken; the message says
        how to repair that.
    """
    out = Path(out)
    manifest = read_manifest(out)
    files = {**FRAMES, "flags": "flags.json", "verdict": "verdict.json"}
    tables: dict[str, Any] = {
        field: read_report_file(out, name) for field, name in files.items()
    }
    flags = tables["flags"]
    tables["flags"] = pd.DataFrame(flags["flags"], columns=flags.get("columns"))
    results = Results(out=out, manifest=manifest, **tables)
    rows = results.measured
    rows = rows[
        rows["metric"].isin([PLR, RANK1, RANK1_JOINT]) & (rows["knowledge"] != "")
    ]
    # The choice reads only the values.
    values = map(_Value, rows["value"])
    estimates: Any = dict(zip(row_addresses(rows), values, strict=True))
    best = strongest_by_task(estimates, results.families)
    attacks = {task: reader.without_task for task, reader in best.items()}
    return replace(results, strongest=attacks, make_first_table=_first_table)


def _first_table(results: Results) -> Table:
    """Return the table of the first screen; its module is slow to import, so late."""
    from evaluation.reporting.first_screen import first_table  # noqa: PLC0415 - as said

    return first_table(results)
