"""Tables of a report as CSV files, in which a spreadsheet takes no name for a formula."""

from __future__ import annotations

import csv
import io
import json
import shlex
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

from evaluation.store.files import read_regular_file
from isac_track.errors import DataError

if TYPE_CHECKING:
    import pandas as pd

# Columns of text; all others are numbers or truth values.
_TEXTS: Final = {
    "dataset",
    "mechanism",
    "family",
    "adding",
    "consumer",
    "knowledge",
    "metric",
    "unit",
    "claim",
    "answer",
    "evidence",
    "criterion",
    "predictor",
    "robot",
    "score",
    "reference",
    "cohort",
    "outcome",
    "invalid",
    "spec",
    "kind",
    "why",
    "task",
    "adversary",
    "first_choice",
    "second_choice",
    "policy",
}
_FORMULA_STARTS: Final = ("=", "+", "-", "@", "\t", "\r")


def to_csv(frame: pd.DataFrame) -> bytes:
    """Return a table as CSV; a spreadsheet takes no text in it for a formula."""
    columns = []  # frame.to_csv would take ten times as long
    for name in frame.columns:
        column = frame[name].to_numpy(dtype=object, na_value="").tolist()
        is_number = frame[name].dtype.kind in "biuf"
        columns.append(column if is_number else map(_escape_formula, column))
    lines: list[str] = []
    # With this end of line, either half of it is quoted within a field.
    writer = csv.writer(SimpleNamespace(write=lines.append), lineterminator="\r\n")
    writer.writerow(frame.columns)
    writer.writerows(zip(*columns, strict=True))
    return "".join(f"{line[:-2]}\n" for line in lines).encode()


def from_csv(content: bytes) -> pd.DataFrame:
    """Return the table that `to_csv` wrote; ValueError if it is none."""
    import pandas as pd  # noqa: PLC0415 - 40 MB, of readers alone

    texts = _TEXTS.intersection(content.partition(b"\n")[0].decode().split(","))
    kinds = dict.fromkeys(texts, str)
    # A name may be "NA".
    frame = pd.read_csv(
        io.BytesIO(content), dtype=kinds, keep_default_na=False, na_values=[""]
    )
    for name in texts:
        column = frame[name].fillna("")
        quoted = (
            text
            for text in column.unique()
            if text.startswith("'") and _escape_formula(text[1:]) == text
        )
        frame[name] = column.replace({text: text[1:] for text in quoted})
    return frame


# The same few names recur in every row; for the life of the process.
@lru_cache(maxsize=4096, typed=True)
def _escape_formula(value: object) -> object:
    """Return a text so that no spreadsheet takes it for a formula; else the value."""
    if not isinstance(value, str) or not value.startswith(_FORMULA_STARTS):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value  # a number in a column of names


def read_report_file(out: Path, name: str, *, columns: Iterable[str] = ()) -> Any:  # noqa: ANN401 - as said
    """Return a file of a report: some `columns` of a CSV, or JSON.

    Raises DataError, which says how to write the file anew.
    """
    advice = f"python -m evaluation.report {shlex.quote(str(out))} writes it anew"
    try:
        content = read_regular_file(out / name)
        if not name.endswith(".csv"):
            return json.loads(content)
        frame = from_csv(content)
        return frame[list(columns or frame.columns)]
    except FileNotFoundError:
        raise DataError(
            f"{out / name} is missing; {advice} if the run has finished"
        ) from None
    except (OSError, ValueError, KeyError) as error:
        reason = str(error).partition("\n")[0]
        raise DataError(f"{out / name} cannot be read ({reason}); {advice}") from None
