"""Estimates of people who come back: rank 1 of linkers and controls, and the evidence.

Cells hold the numbers with their intervals, which delete people. The unit is the person.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from evaluation.compute.return_columns import CHOSEN, COLUMNS
from evaluation.estimates.metrics import METRICS
from evaluation.store.cell_files import read_rows
from isac_track.intervals import Estimate

if TYPE_CHECKING:
    from evaluation.plan.address import Address
    from evaluation.store.entries import Entry

KIND: Final = "returns"  # Of the consumer.


@dataclass(frozen=True, eq=False, slots=True)
class ReturnNumbers:
    """Numbers of people who come back."""

    # Of every metric of linkers and controls.
    estimates: dict[Address, Estimate] = field(default_factory=dict)
    # Of how many people each control was chosen for; by the control's address.
    chosen: dict[Address, int] = field(default_factory=dict)


def return_numbers(out: Path, manifest: Mapping[str, Any]) -> ReturnNumbers:
    """Return the numbers of a run; none without people who come back.

    Raises DataError if a cell cannot be read.
    """
    numbers = ReturnNumbers()
    for entry in manifest["cells"]:
        if entry.kind == KIND:
            _add_numbers(numbers, out, entry)
    return numbers


def _add_numbers(numbers: ReturnNumbers, out: Path, entry: Entry) -> None:
    """Add the numbers of a cell, which is a level of a mechanism."""
    rows = read_rows(out, entry, columns=COLUMNS).to_pylist()
    for row in rows:
        address = replace(
            entry.address.within(),
            plugin=row["row"],
            adversary=row["knowledge"],
            metric=row["metric"],
        )
        if row["metric"] == CHOSEN:
            numbers.chosen[address] = round(row["value"])
        elif row["metric"] in METRICS:
            ends = row["value"], row["ci_low"], row["ci_high"]
            numbers.estimates[address] = Estimate(
                *ends, n=row["n"], effective=float(row["n"])
            )
