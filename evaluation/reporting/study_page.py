"""`study.html`: the five questions over several recordings, a forest plot for each."""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from evaluation.estimates.pooled import FEWEST, OWN_GALLERY, QUESTIONS, Answered
from evaluation.reporting.charts import CHARACTER, PERCENT, Chart, Look, bar
from evaluation.reporting.lookups import ENDS
from evaluation.reporting.markup import HTML

# The constants of the sensing model were fitted on it.
SET_CONSTANTS: Final = "students03"
_STEP: Final = 14.0
_PREDICTED: Final = "a further recording"


class Forest(NamedTuple):
    """A question under one adding rule and law."""

    title: str
    sentence: str
    chart: Chart


def render(
    of: Sequence[Answered], *, simulated: frozenset[str], runs: Iterable[str]
) -> str:
    """Return the page; `runs` are the folders of the runs."""
    questions = {
        text: [_forest(one, simulated) for one in of if one.question == name]
        for name, text in QUESTIONS.items()
        if not name.endswith(OWN_GALLERY) or name in {one.question for one in of}
    }
    rows = [row for answer in of for row in answer.rows]
    return HTML.get_template("study.html.j2").render(
        questions=questions,
        runs=list(runs),
        fewest=FEWEST,
        set_constants=SET_CONSTANTS,
        settings="; ".join(
            dict.fromkeys(row["settings"] for row in rows if row["settings"])
        ),
        distances={row["recording"]: row["distance_m"] for row in rows},
    )


def _forest(one: Answered, simulated: frozenset[str]) -> Forest:
    """Return a row for each recording with its value and interval, fractions shown in points."""
    rows = {
        row["recording"]
        + " (simulated)" * (row["recording"] in simulated)
        + " *" * (row["recording"] == SET_CONSTANTS): [row[end] for end in ENDS]
        for row in one.rows
    }
    if pooled := one.pooled:
        rows["pooled"] = [pooled.value, pooled.ci_low, pooled.ci_high]
        rows[_PREDICTED] = [pooled.value, pooled.predicted_low, pooled.predicted_high]
    left = min(150.0, 10.0 + CHARACTER * max(map(len, rows)))
    chart = Chart("points", 12.0 + _STEP * len(rows) + 30.0, left)
    values = PERCENT * np.array([*rows.values()], dtype=np.float64)
    at = chart.x_axis(values)
    chart.lines.append(("across k6", [chart.down(at(0.0))]))
    for place, (name, of) in enumerate(zip(rows, values, strict=True)):
        y = 8.0 + _STEP * (place + 0.5)
        look = Look(
            1 if name in ("pooled", _PREDICTED) else 0,
            hollow=name.endswith("(simulated)"),
        )
        chart.y_ticks.append((y, name))
        x, *ends = at(of)
        chart.lines.append((f"bar k{look.place}", bar(ends, at=y)))
        interval = " [{:.1f}, {:.1f}]".format(*of[1:])
        if not np.isfinite(of).all():
            interval = ", too few people for an interval"
        chart.marks.append((look, [(x, y)], f"{name}: {of[0]:+.1f}{interval}"))
    return Forest(f"{one.adding} adding, {one.law} error", one.sentence, chart)
