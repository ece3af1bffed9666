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
    for row in answer.rows:
        name = row["recording"]
        if row["recording"] in simulated:
            name += " (simulated)"
        if row["recording"] == SET_CONSTANTS:
            name += " *"
        rows[name] = [row[end] for end in ENDS]
    if pooled := answer.pooled:
        rows["pooled"] = [pooled.value, pooled.ci_low, pooled.ci_high]
        rows[_PREDICTED] = [pooled.value, pooled.predicted_low, pooled.predicted_high]
    left = min(150.0, 10.0 + CHARACTER * max(map(len, rows)))
    chart = Chart("points", 12.0 + _STEP * len(rows) + 30.0, left)
    values = PERCENT * np.array([*rows.values()], dtype=np.float64)
    to_x = chart.x_axis(values)
    chart.lines.append(("across k6", [chart.down(to_x(0.0))]))
    for place, (name, numbers) in enumerate(zip(rows, values, strict=True)):
        y = 8.0 + _STEP * (place + 0.5)
        look = Look(
            1 if name in ("pooled", _PREDICTED) else 0,
            hollow=name.endswith("(simulated)"),
        )
        chart.y_ticks.append((y, name))
        x, *ends = to_x(numbers)
        chart.lines.append((f"bar k{look.place}", bar(ends, at=y)))
        value, low, high = numbers
        interval = f" [{low:.1f}, {high:.1f}]"
        if not np.isfinite(numbers).all():
            interval = ", too few people for an interval"
        chart.marks.append((look, [(x, y)], f"{name}: {value:+.1f}{interval}"))
    title = f"{answer.adding} adding, {answer.law} error"
    return Forest(title, answer.sentence, chart)
