"""A finished run as data frames: all that tables, figures and page are made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from evaluation.analysis.families import families_in
from evaluation.analysis.linkability import dataset_of, linked_tasks

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Source
    from evaluation.analysis.linkability import LinkedTask


@dataclass(frozen=True, eq=False)
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
    strongest: Mapping[str, Source] = field(default_factory=dict)
    """Of every linkage task the attack that the verdict is about; under "" the reconstruction."""
    gallery: pd.DataFrame | None = None
    """Sample tracks, as in `gallery.parquet`."""

    @cached_property
    def dataset(self) -> str:
        """Name of the data set."""
        name: str = self.manifest["dataset"]["name"]
        return name

    @cached_property
    def ours(self) -> pd.DataFrame:
        """The summary without the tasks that have a data set of their own."""
        return self.summary[self.summary["dataset"] == self.dataset]

    @cached_property
    def families(self) -> dict[str, Family]:
        """The mechanisms of the run by name."""
        return families_in(self.summary)

    @cached_property
    def tasks(self) -> list[LinkedTask]:
        """The tasks in which somebody links, of the run's data set or of their own."""
        expected = self.linkability["consumer"].map(
            lambda name: dataset_of(name, dataset=self.dataset)
        )
        return linked_tasks(self.linkability[self.linkability["dataset"] == expected])

    def link_of(self, task: LinkedTask) -> Source:
        """Return the attack that stands for a task: the strongest, or the first of the run."""
        return self.strongest.get(task.name, task.attacks[0])
