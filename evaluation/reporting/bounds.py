"""The best attacks beside the optimum of model worlds, and the ceiling of the recorded walks."""

from collections.abc import Sequence

import pandas as pd

from evaluation.analysis.bounds import Gap, gaps
from evaluation.analysis.keys import Where
from evaluation.analysis.metrics import CEILING, EXPOSURE, GAP, RANK_GAP, SUCCESS
from evaluation.experiment.constants import MODEL, OTHER_LAW, OTHER_LAW_WORLD
from evaluation.reporting import table as make
from evaluation.reporting.rows import Results, mechanism_columns
from evaluation.reporting.table import Cell, Table

_MODEL = (
    "Everybody walks as the fitted motion says, with the errors of the recording. optimum: the "
    "exact posterior, which no attack exceeds in the fitted model world, in expectation."
)
_GENIE = (
    "ceiling: a genie who is told the scale of every error; the gap is at most that. On recorded "
    "walks, under the motion of who is easiest to smooth, it is no bound."
)


_RATIO = (
    "Of linkers: the exact likelihood ratio of each pair, of Gaussian errors of known variance. "
    "Nobody who looks at one probe at a time finds more people, in expectation."
)
_ENDS = ("value", "ci_low", "ci_high")


def law_of(world: str, run: Results) -> str:
    """Return the error law of a world of a run."""
    own = run.manifest["settings"]["stages"]["sensing.law"]
    return OTHER_LAW if OTHER_LAW_WORLD in world else str(own)


def bound_table(run: Results) -> Table:
    """Return what the attack that comes closest lacks at every level of every model world."""
    ceilings = _ceilings(run.ours)
    records = [
        {
            "mechanism": one.where[0],
            "level": one.where[1],
            "error law": law_of(one.world, run),
            "closest attack": one.attack.label,
            "attacked": make.estimated(EXPOSURE, one.reached),
            "bound": make.estimated(EXPOSURE, one.bound),
            "is": "optimum" if one.is_exact else "ceiling",
            "gap": make.estimated(GAP, one.gap),
            "recorded": ceilings.get(one.where, Cell()) if one.world == MODEL else Cell(),
        }
        for one in gaps(run.summary)
        if not one.attack.task
    ]
    columns = [
        *mechanism_columns(run.families),
        *map(make.said, ("error law", "closest attack")),
        make.held("PLR there", "attacked", unit="%"),
        make.held("bound", unit="%"),
        make.said("is"),
        make.held("gap", unit="points"),
        make.held("genie, recorded walks", "recorded", unit="%"),
    ]
    title = "How far the attacks are from the optimum of model worlds; 95 % intervals"
    return make.built(
        "bounds", title, records, columns, notes=[_MODEL, _GENIE], n_headings=2, n_keys=3
    )


def linked_bound_table(run: Results) -> Table:
    """Return what the linker that comes closest lacks of the optimal likelihood ratio, by level."""
    records = [
        {
            "mechanism": one.where[0],
            "level": one.where[1],
            "task": one.attack.task,
            "closest linker": one.attack.attack.label,
            "found": make.estimated(SUCCESS, one.reached),
            "optimum": make.estimated(SUCCESS, one.bound),
            "gap": make.estimated(RANK_GAP, one.gap),
        }
        for one in gaps(run.summary)
        if one.attack.task
    ]
    columns = [
        *mechanism_columns(run.families),
        *map(make.said, ("task", "closest linker")),
        make.held("rank 1 there", "found", unit="%"),
        make.held("optimum", unit="%"),
        make.held("gap", unit="points"),
    ]
    title = "How far the linkers are from the optimum of a model world; 95 % intervals"
    return make.built(
        "bounds-linked", title, records, columns, notes=[_MODEL, _RATIO], n_headings=2, n_keys=3
    )


def gap_text(known: Sequence[Gap], where: Where) -> str:
    """Return in words how far the attacks are from the optimum at a level; empty if unknown."""
    own, *others = [
        f"{'' if one.is_exact else 'at most '}{max(100 * one.gap.value, 0.0):.1f}"
        for one in known
        if one.where == where and not one.attack.task
    ] or [""]
    other = "".join(f" ({one} if errors are isotropic)" for one in others)
    return f"in the model world {own} points below the optimum{other}" * bool(own)


def _ceilings(rows: pd.DataFrame) -> dict[Where, Cell]:
    of = rows[rows["metric"] == CEILING]
    numbers = of[list(_ENDS)].itertuples(index=False)
    wheres = zip(of["mechanism"], of["level"], strict=True)
    return {
        (name, None if pd.isna(level) else level): make.amount(EXPOSURE, *one)
        for (name, level), one in zip(wheres, numbers, strict=True)
    }
