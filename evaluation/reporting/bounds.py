"""The best attacks beside the optimum of model worlds and a genie on recorded walks."""

from collections.abc import Mapping, Sequence
from typing import Any

from evaluation.estimates.bounds import ClosestAttack
from evaluation.estimates.metrics import (
    METRICS,
    PLR,
    PLR_CEILING,
    PLR_GAP,
    RANK1,
    RANK1_GAP,
)
from evaluation.plan.address import MechanismLevel
from evaluation.plan.world import World
from evaluation.reporting import table as make
from evaluation.reporting.amounts import PERCENT
from evaluation.reporting.lookups import estimates
from evaluation.reporting.rows import Results, mechanism_columns
from evaluation.reporting.table import Cell, Column, Table

_MODEL = (
    "People walk by the fitted motion, with the errors of the recording. Where attacks"
    " rebuild, each person has an own motion, else all share one. optimum: the exact"
    " posterior of an adversary that knows the motion. In the fitted model world no"
    " attack exceeds it, in expectation."
)
_GENIE = (
    "ceiling: a genie that knows the scale of every error; the gap is at most that. On"
    " recorded walks, which follow no model, the genie's value is no bound: attacks do"
    " exceed it."
)
_RATIO = (
    "Of linkers: the exact likelihood ratio of each pair, of Gaussian errors of known"
    " variance. No linker that treats each probe alone re-identifies more people, in"
    " expectation."
)


def world_error_law(world: World, run: Results) -> str:
    """Return the error law of a world of a run."""
    return world.law or str(run.manifest["settings"]["stages"]["sensing.law"])


def bound_table(run: Results) -> Table:
    """Return the gap between the closest attack and the optimum of each model world."""
    ceilings = {
        key.mechanism_level: make.estimate_cell(PLR, ceiling)
        for key, ceiling in estimates(
            run.ours[run.ours["metric"] == PLR_CEILING]
        ).items()
    }

    def recorded(row: Mapping[str, Any]) -> Cell:
        has_own_law = not row["world"].law
        return ceilings.get(row["mechanism_level"], Cell()) if has_own_law else Cell()

    columns = [
        make.text_column("error law", lambda row: world_error_law(row["world"], run)),
        make.text_column("closest attack", lambda row: row["attack"].label),
        _column("PLR there", PLR, "reached"),
        _column("bound", PLR, "bound"),
        make.text_column("is", lambda row: "optimum" if row["is_exact"] else "ceiling"),
        _column("gap", PLR_GAP, "gap"),
        Column("genie, recorded walks", recorded, "%"),
    ]
    title = "How far the attacks are from the optimum of model worlds; 95 % intervals"
    return _table(run, title, columns, links=False)


def linked_bound_table(run: Results) -> Table:
    """Return the gap between the closest linker and the optimal likelihood ratio."""
    columns = [
        make.text_column("task", lambda row: row["attack"].task),
        make.text_column(
            "closest linker", lambda row: row["attack"].without_task.label
        ),
        _column("rank 1 there", RANK1, "reached"),
        _column("optimum", RANK1, "bound"),
        _column("gap", RANK1_GAP, "gap"),
    ]
    title = "How far the linkers are from the optimum of a model world; 95 % intervals"
    return _table(run, title, columns, links=True)


def _column(name: str, metric: str, key: str) -> Column:
    return Column(
        name, lambda row: make.estimate_cell(metric, row[key]), METRICS[metric].unit
    )


def _table(
    run: Results, title: str, columns: Sequence[Column], *, links: bool
) -> Table:
    """Return a table with a row for each gap of linkers, or of the other attacks."""
    records = []
    for gap in run.headline.gaps:
        if bool(gap.attack.task) == links:
            mechanism, level = gap.mechanism_level
            records.append(gap._asdict() | {"mechanism": mechanism, "level": level})
    return make.build_table(
        "bounds-linked" if links else "bounds",
        title,
        records,
        [*mechanism_columns(run.families), *columns],
        notes=[_MODEL, _RATIO if links else _GENIE],
        n_headings=2,
        n_keys=4,
    )


def gap_text(
    known: Sequence[ClosestAttack], where: MechanismLevel, task: str = ""
) -> str:
    """Return how far the attacks on a level are from the optimum; empty if unknown."""
    lacks = [
        f"{'' if gap.is_exact else 'at most '}{max(PERCENT * gap.gap.value, 0.0):.1f}"
        for gap in known
        if gap.mechanism_level == where and gap.attack.task == task
    ]
    if not lacks:
        return ""
    unit = "of 100 people" if task else "points"
    isotropic = [f" With isotropic errors it lacks {other}." for other in lacks[1:]]
    return (
        f"In the model world the closest attack lacks {lacks[0]} {unit} of the"
        f" optimum.{''.join(isotropic)}"
    )
