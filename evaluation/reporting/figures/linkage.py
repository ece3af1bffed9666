"""Re-identified people over the level: a row of panels for each kind of task."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import RAW
from evaluation.estimates.linkability import TaskOutcomes
from evaluation.plan.address import Address
from evaluation.reporting.amounts import PERCENT, round_percent, sentence_case
from evaluation.reporting.charts import (
    GUIDE_COLOUR,
    Axis,
    Chart,
    Curve,
    Guide,
    Look,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS
from evaluation.reporting.names import INDEPENDENT_MARK, task_head, task_phrase
from evaluation.reporting.rows import Results
from evaluation.reporting.schemes import Scheme, schemes

_KINDS: Final[Mapping[str, tuple[str, ...]]] = {
    "after a silence": ("handover-1s", "handover-2s", "handover-5s"),
    "two logs of the same steps": ("rerelease", "rerelease-framed"),
    "different steps": ("split", "new_traversal", "cross_session"),
}
"""Tasks by kind; a task of a user is a kind of its own."""
# Mechanisms with panels: more would be unreadable at the width of a page.
_MOST_SWEPT: Final = 4
_AXIS: Final = Axis("re-identified (rank 1, %)")


class _Linked(NamedTuple):
    """A linkage task by the strongest attack on it."""

    task: str
    # Columns mechanism, level, value, ci_low, ci_high, chance: fractions.
    rows: pd.DataFrame

    def at_raw(self) -> list[float]:
        """Return rank 1 of raw positions in %; empty where it is not known."""
        raw = self.rows.loc[self.rows["mechanism"] == RAW, "value"]
        return (PERCENT * raw).to_list()

    def chance(self) -> list[float]:
        """Return rank 1 of a random guess in %; empty where it is not known."""
        return (PERCENT * self.rows["chance"].dropna().iloc[:1]).to_list()


def figures(run: Results) -> Iterator[Figure]:
    """Yield the figure of linkage, by the strongest attack on each task."""
    tasks = {task.name: _strongest(run, task) for task in run.tasks}
    swept = schemes(run.without_policy)
    names = list(dict.fromkeys(scheme.name for scheme in swept))
    shown = names[:_MOST_SWEPT]
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for title, members in _kinds(tasks).items():
        for name in shown:
            rules = [scheme for scheme in swept if scheme.name == name]
            curves, guides = _drawn([tasks[task] for task in members], rules)
            if curves:
                x = Axis(rules[0].label, rules[0].log)
                chart = curves_chart(curves, x=x, y=_AXIS, guides=guides)
                panels.append((f"{rules[0].title}: {title}", chart))
                if not label_room(curves):
                    key |= {curve.label: curve.look for curve in curves}
    note = (
        "Hollow, *: noise independent of the sensing error. Dashed: raw positions;"
        " black: chance."
    )
    if names != shown:
        note += f" Drawn: {len(shown)} of {len(names)} mechanisms."
    yield Figure(
        name="linkability",
        section="linkability",
        title="Re-identified people over the level, task by task",
        panels=panels,
        columns=2,
        key=key,
        caption=_caption(
            list(tasks.values()), [scheme for scheme in swept if scheme.name in shown]
        ),
        note=note,
    )


def _strongest(run: Results, task: TaskOutcomes) -> _Linked:
    """Return a task by the run's strongest attack, else by the best on average."""
    rows = {reader: _rank1_rows(task, reader) for reader in task.attacks}
    named = run.strongest.get(task.name)
    if named in rows:
        return _Linked(task.name, rows[named])
    return _Linked(task.name, max(rows.values(), key=_mean))


def _kinds(tasks: Iterable[str]) -> dict[str, list[str]]:
    """Return the tasks of a run by kind, each kind a row of panels."""
    names = list(tasks)
    kinds = {
        title: [task for task in known if task in names]
        for title, known in _KINDS.items()
    }
    usual = {task for known in _KINDS.values() for task in known}
    kinds |= {task: [task] for task in names if task not in usual}
    return {title: members for title, members in kinds.items() if members}


def _drawn(
    tasks: Sequence[_Linked], rules: Sequence[Scheme]
) -> tuple[list[Curve], list[Guide]]:
    """Return a curve for each task and adding rule of a mechanism, and lines across."""
    curves, guides = list[Curve](), list[Guide]()
    for place, linked in enumerate(tasks):
        for scheme in rules:
            is_hollow = scheme.rules == ("independent",) and len(rules) > 1
            rows = scheme.select_rows(linked.rows)
            if len(rows):
                curves.append(
                    _curve(linked.task, scheme, rows, Look(place, hollow=is_hollow))
                )
        guides += [Guide(place, value) for value in linked.at_raw()]
        guides += [Guide(GUIDE_COLOUR, value) for value in linked.chance()]
    return curves, list(dict.fromkeys(guides))


def _curve(task: str, scheme: Scheme, rows: pd.DataFrame, look: Look) -> Curve:
    """Return the curve of a task under an adding rule; its name tells both ends."""
    x = rows["level"].to_numpy(dtype=np.float64)
    values = PERCENT * rows[ENDS].to_numpy(dtype=np.float64).T
    ends = [
        f"{values[0, place]:.1f} % at {scheme.describe_level(x[place])}"
        for place in (0, -1)
    ]
    name = f"{task}, {scheme.rule_text}: {' to '.join(dict.fromkeys(ends))}"
    label = task_head(task)
    if look.hollow:
        label += INDEPENDENT_MARK
    return Curve(look, name, x, values, label)


def _caption(tasks: Sequence[_Linked], shown: Sequence[Scheme]) -> str:
    """Tell the range of re-identified people in the first task that has values."""
    leading = [
        task for kind in _kinds(task.task for task in tasks).values() for task in kind
    ]
    by_name = {task.task: task for task in tasks}
    for linked in (by_name[name] for name in leading):
        values = pd.concat(
            [scheme.select_rows(linked.rows)["value"] for scheme in shown]
            or [pd.Series()]
        )
        if len(values):
            low, high = (
                round_percent(PERCENT * end) for end in (values.min(), values.max())
            )
            beside = "".join(
                f"; chance is {round_percent(value)} %" for value in linked.chance()
            )
            phrase = sentence_case(task_phrase(linked.task))
            return (
                f"{phrase}, an attack re-identifies {low} % to {high} % of"
                f" people{beside}."
            )
    return ""


def _rank1_rows(task: TaskOutcomes, reader: Address) -> pd.DataFrame:
    """Return finite rank 1 of an attack, and chance, with the columns of a summary."""
    keys = "mechanism", "level", "rank1", "ci_low", "ci_high", "chance"
    known = (block[reader] for block in task.cells.values() if reader in block)
    rows = [[row[key] for key in keys] for row in known if math.isfinite(row["rank1"])]
    return pd.DataFrame(rows, columns=["mechanism", "level", *ENDS, "chance"])


def _mean(rows: pd.DataFrame) -> float:
    """Return mean rank 1 over the levels; -1 without any."""
    mean = rows.loc[rows["level"].notna(), "value"].mean()
    return float(np.nan_to_num(mean, nan=-1.0))
