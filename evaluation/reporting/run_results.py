"""A finished run as data frames: all that tables, figures and page are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd


@dataclass(frozen=True, eq=False, slots=True)
class Results:
    """A finished run as data frames; the columns are those of the files in `out`."""

    out: Path
    manifest: dict[str, Any]
    summary: pd.DataFrame
    paper_table: pd.DataFrame
    claims: pd.DataFrame
    matched: pd.DataFrame
    decisions: pd.DataFrame
    curves: pd.DataFrame
    flags: pd.DataFrame
    linkability: pd.DataFrame
    verdict: dict[str, Any]
    """As in `verdict.json`."""
    failed: pd.DataFrame
    """Cells that could not be computed, and why; no other table holds their levels."""
