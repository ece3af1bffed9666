"""People who come back: who is named first in another session, at a mechanism's level.

A cell has a row for each linker, their fusion and each control. Only the level without
error decides (`isac_track.linkability.return_rule`); there the passages are shown as
recorded. At all others the network senses and shares them at its own instants.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from attacks.tasks.passage_releases import hide_frames, sense_passages
from attacks.tasks.return_study import FUSION, LINKERS, study_returns
from attacks.tasks.task_list import RETURNS
from evaluation.compute import sharing
from evaluation.compute.return_columns import (
    CHANCE,
    CHOSEN,
    CLEAN,
    CONFIRMING_GAIN,
    CONFIRMING_P,
    GAIN,
    NESTED_P,
    RANK1,
    SAME_SESSION,
    STRONGEST,
)
from evaluation.compute.tables import ROWS, Tables, table
from evaluation.plan.address import control_name
from isac_track.intervals import Estimate
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from attacks.tasks.passages import Passages
    from attacks.tasks.return_study import ReturnStudy
    from isac_track.config import StageSettings
    from isac_track.linkability.return_rule import ReturnEvidence
    from isac_track.linkability.returns import ReturnCell
    from isac_track.plugins import Plugin
    from isac_track.types import Release, Sensed


@dataclass(frozen=True, eq=False)
class ReturnSetup:
    """Passages of people who come back, and what all levels share."""

    passages: Passages
    stages: StageSettings
    seed: int
    confirming: str | None = None  # Session that is left aside.

    @cached_property
    def sensed(self) -> Sensed:
        """What the network senses; made at first use, and held as long as this."""
        return sense_passages(self.passages, stages=self.stages, seed=self.seed)


class _Row(NamedTuple):
    """A number of a cell."""

    row: str  # `fusion`, a linker, or a control with its prefix.
    metric: str
    estimate: Estimate


def shared_passages(mechanism: Plugin, setup: ReturnSetup) -> Release:
    """Return the passages under a mechanism, without frame, clock or declared errors.

    Raises PluginError for a mechanism that raises or breaks its contract.
    """
    shared: Passages | Release = setup.passages
    if mechanism.spec != CLEAN:
        names = ("linkage", RETURNS.name)
        shared = sharing.share(mechanism, setup.sensed, *names, seed=setup.seed)
    return hide_frames(
        t=shared.t, xy=shared.xy, offsets=shared.offsets, seed=setup.seed
    )


def return_tables(mechanism: Plugin, setup: ReturnSetup) -> Tables:
    """Return the table of a cell, `COLUMNS`: all passages enrolled, another session.

    Only the level without error has a nested p-value that decides; the others' is
    to be looked at. Raises PluginError as `shared_passages` does.
    """
    study = study_returns(
        setup.passages,
        shared_passages(mechanism, setup),
        enrolled=(None,),
        confirming=setup.confirming,
        seed=setup.seed,
    )
    rows = [*_study_rows(study)]
    columns: dict[str, Any] = {
        "row": [row.row for row in rows],
        "knowledge": [_adversary(row.row) for row in rows],
        "metric": [row.metric for row in rows],
    }
    for name in ("value", "ci_low", "ci_high"):
        ends = [float(getattr(row.estimate, name)) for row in rows]
        columns[name] = np.array(ends)
    columns["n"] = np.array([row.estimate.n for row in rows], dtype=np.int64)
    return {ROWS: table(columns)}


def _study_rows(study: ReturnStudy) -> Iterator[_Row]:
    """Yield the rows of a study: linkers and fusion, controls, evidence."""
    for (name, _), cell in study.cells.items():
        yield from _linker_rows(name, cell)
    primary = study.primary
    n = primary.rank1.n
    yield from _confirming_rows(study.confirming)
    yield _Row(FUSION, NESTED_P, Estimate(study.regression.p_value, n=n))
    yield from _control_rows(STRONGEST, primary.control, primary.chance)
    for name, cell in study.controls.items():
        control = control_name(name.replace(" ", "-"))
        yield from _control_rows(control, cell.rank1, cell.chance)
    for name, n_chosen in Counter(primary.chosen).items():
        control = control_name(name.replace(" ", "-"))
        yield _Row(control, CHOSEN, Estimate(float(n_chosen), n=n))
    if (same_session := study.same_session) is not None:
        yield from _control_rows(SAME_SESSION, same_session.rank1, same_session.chance)


def _linker_rows(name: str, cell: ReturnCell) -> Iterator[_Row]:
    yield from _control_rows(name, cell.rank1, cell.chance)
    yield _Row(name, GAIN, cell.gain)


def _control_rows(name: str, rank1: Estimate, chance: float) -> Iterator[_Row]:
    yield _Row(name, RANK1, rank1)
    yield _Row(name, CHANCE, Estimate(chance, n=rank1.n))


def _confirming_rows(evidence: ReturnEvidence | None) -> Iterator[_Row]:
    """Yield the evidence of the session left aside, where it can change the answer."""
    if evidence is not None:
        yield _Row(FUSION, CONFIRMING_GAIN, evidence.gain)
        p_value = Estimate(evidence.p_value, n=evidence.gain.n)
        yield _Row(FUSION, CONFIRMING_P, p_value)


def _adversary(row: str) -> str:
    """Return who links: informed if it learns on other people; no control has any."""
    if row == FUSION:
        return "informed"
    if row not in LINKERS:
        return ""
    known = LINKERS[row].requires | LINKERS[row].uses
    return "informed" if Knowledge.TRAIN in known else "blind"
