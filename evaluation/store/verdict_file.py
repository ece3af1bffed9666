"""The verdict of a finished run, read from its folder."""

from operator import itemgetter
from pathlib import Path
from typing import Any

from evaluation.store.csv_files import read_report_file
from isac_track.errors import DataError

VERDICT = "verdict.json"


def load_verdict(out: Path) -> dict[str, Any]:
    """Return the verdict of a run folder; each of its items has an id and a decision.

    Raises DataError if there is none or it cannot be read.
    """
    verdict: dict[str, Any] = read_report_file(out, VERDICT)
    try:
        list(map(itemgetter("id", "decision"), verdict["items"]))
    except (KeyError, TypeError):
        raise DataError(
            f"{out / VERDICT} cannot be read: it is no verdict of a run"
        ) from None
    return verdict
