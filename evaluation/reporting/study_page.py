"""`study.html`: questions over several recordings, a forest plot for each."""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np

from evaluation.estimates.pooled import FEWEST, OWN_GALLERY, QUESTIONS, Answered
from evaluation.reporting.amounts import PERCENT
from evaluation.reporting.charts import (
    CHARACTER,
    GUIDE_COLOUR,
    Chart,
    ChartMark,
    Line,
    Look,
    Tick,
    bar,
)
from evaluation.reporting.lookups import ENDS
from evaluation.reporting.markup import HTML

# The constants of the sensing model were fitted on it.
SET_CONSTANTS: Final = "students03"
# Of the picture, in its units: distance of rows, and space above and below them.
_STEP: Final = 14.0
_ABOVE, _BELOW = 12.0, 30.0
_NARROWEST, _WIDEST = 10.0, 150.0  # Of the column of names.
_POOLED: Final = "pooled"
_PREDICTED: Final = "a further recording"
"""Row of the interval in which the number of a further recording is expected."""


class Forest(NamedTuple):
    """A question under one adding rule and law."""

    title: str
    sentence: str
    chart: Chart


def render(
    answers: Sequence[Answered], *, simulated: frozenset[str], runs: Iterable[str]
) -> str:
    """Return the page; `runs` are the folders of the runs."""
    answered = {answer.question for answer in answers}
    questions = {
        text: [
            _forest(answer, simulated) for answer in answers if answer.question == name
        ]
        for name, text in QUESTIONS.items()
        if not name.endswith(OWN_GALLERY) or name in answered
    }
    rows = [row for answer in answers for row in answer.rows]
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


def _forest(answer: Answered, simulated: frozenset[str]) -> Forest:
    """Return the chart of an answer: a row for each recording, in points."""
    rows: dict[str, list[float]] = {}
    looks: dict[str, Look] = {}
    for row in answer.rows:
        name = row["recording"]
        is_simulated = row["recording"] in simulated
        if is_simulated:
            name += " (simulated)"
        if row["recording"] == SET_CONSTANTS:
            name += " *"
        rows[name] = [row[end] for end in ENDS]
        looks[name] = Look(0, hollow=is_simulated)
    if pooled := answer.pooled:
        rows[_POOLED] = [pooled.value, pooled.ci_low, pooled.ci_high]
        rows[_PREDICTED] = [pooled.value, pooled.predicted_low, pooled.predicted_high]
        looks |= dict.fromkeys((_POOLED, _PREDICTED), Look(1))
    chart = Chart(
        x_label="points",
        height=_ABOVE + _STEP * len(rows) + _BELOW,
        left=min(_WIDEST, _NARROWEST + CHARACTER * max(map(len, rows))),
    )
    values = PERCENT * np.array([*rows.values()], dtype=np.float64)
    to_x = chart.x_axis(values)
    chart.lines.append(Line("across", [chart.down(to_x(0.0))], GUIDE_COLOUR))
    for place, (name, numbers) in enumerate(zip(rows, values, strict=True)):
        y, look = 8.0 + _STEP * (place + 0.5), looks[name]
        chart.y_ticks.append(Tick(y, name))
        x, *ends = to_x(numbers)
        chart.lines.append(Line("bar", bar(ends, at=y), look.colour))
        value, low, high = numbers
        interval = f" [{low:.1f}, {high:.1f}]"
        if not np.isfinite(numbers).all():
            interval = ", too few people for an interval"
        chart.marks.append(ChartMark(look, [(x, y)], f"{name}: {value:+.1f}{interval}"))
    title = f"{answer.adding} adding, {answer.law} error"
    return Forest(title, answer.sentence, chart)
