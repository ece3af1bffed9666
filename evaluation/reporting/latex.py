"""The results as LaTeX: booktabs tabulars, to be put into a table environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluation.analysis.keys import AS_SHARED
from evaluation.analysis.levels import (
    REMARKS,
    SHOWN,
    adding_of,
    after_attack,
    amount,
    level_text,
    linked_levels,
    linked_tasks,
    number,
    printable,
    remarks,
    shared_head,
    sources,
    sweeps,
)
from evaluation.analysis.metrics import DESCRIPTORS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from typing import Any

    import pandas as pd

    from evaluation.analysis.keys import Source, Where
    from evaluation.analysis.levels import LinkedTask, Number

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "%": r"\%",
    "#": r"\#",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
}
_MARKS = dict(zip(REMARKS, "abc", strict=True))
_MOST_LEVELS = 10
"""Columns that a page has room for."""
_PREAMBLE = "% Needs \\usepackage{booktabs}. Values with 95 % intervals.\n"


def escape(text: str) -> str:
    """Return text that LaTeX prints as it is."""
    return "".join(_SPECIAL.get(character, character) for character in printable(text))


def sweep_tex(summary: pd.DataFrame) -> str:
    """Return one tabular for the first predictor and the descriptors, and one for each other."""
    return _PREAMBLE + "\n".join(
        ("" if sweep.predictor is None else f"% predictor {escape(sweep.predictor)}\n")
        + _sweep(sweep.blocks, sweep.metrics)
        for sweep in sweeps(summary)
    )


def attacks_tex(summary: pd.DataFrame) -> str:
    """Return a tabular for what was shared, and one for each attack and adversary."""
    after = after_attack(summary)
    tabulars = []
    for source in sources(after.values()):
        blocks: dict[str, dict[float | None, dict[str, Number]]] = {}
        for (mechanism, level), block in after.items():
            if source in block:
                blocks.setdefault(mechanism, {})[level] = block[source]
        tabulars.append(_sweep(blocks, (*DESCRIPTORS, "rmse"), source=source))
    return _PREAMBLE + "\n".join(tabulars)


def paper_tex(paper_table: pd.DataFrame) -> str:
    """Return the paper's numbers beside ours."""
    head = ["Mechanism", "Level", "Metric", "Paper", "Ours", "Ours $-$ paper"]
    rows = []
    for row in paper_table.to_dict("records"):
        metric = row["metric"]
        ours = number(metric, row["ours"], row["ci_low"], row["ci_high"])
        rows.append(
            [
                escape(row["mechanism"]),
                level_text(row["level"]),
                escape(shared_head(metric)),
                amount(metric, row["paper"]),
                _number(ours),
                f"${amount(metric, row['ours'] - row['paper'], sign='+')}$" if ours.value else "",
            ]
        )
    return _PREAMBLE + _tabular("lrlrrr", head, [rows])


def linkability_tex(linkability: pd.DataFrame) -> str:
    """Return a tabular for each linkage task: rank 1 in % of each attack at the headline levels."""
    tabulars = []
    for task in linked_tasks(linkability):
        levels = linked_levels(task)
        tabulars += [
            f"% {escape(task.name)}: {escape(task.about)}; rank 1 in %\n"
            + _linked(task, levels[start : start + _MOST_LEVELS])
            for start in range(0, len(levels), _MOST_LEVELS)
        ]
    return _PREAMBLE + "\n".join(tabulars)


def _linked(task: LinkedTask, levels: Sequence[Where]) -> str:
    """Return a tabular with the attacks as rows, each interval below its value."""
    heads = [escape(f"{adding_of(name)[0]} {level_text(level)}".rstrip()) for name, level in levels]
    rules = [adding_of(name)[1] or ("" if level is None else "linear") for name, level in levels]
    above = " & ".join(["", *rules]) + " \\\\\n" if "independent" in rules else ""
    rows = []
    used: set[str] = set()
    for source in task.attacks:
        found = [task.cells[where].get(source) for where in levels]
        used.update(remark for row in found if row is not None for remark in remarks(row))
        rows.append([escape(source.label), *map(_marked, found)])
        rows.append(["", *map(_interval_below, found)])
    some = [next(iter(task.cells[where].values())) for where in levels]
    chance = ["chance", *(amount("rank1", row["chance"]) for row in some)]
    notes = [
        rf"\textsuperscript{{{mark}}}{escape(REMARKS[remark])}"
        for remark, mark in _MARKS.items()
        if remark in used
    ]
    below = (
        rf"\multicolumn{{{1 + len(levels)}}}{{l}}{{\scriptsize {'; '.join(notes)}}} \\" + "\n"
        if notes
        else ""
    )
    return _tabular(
        "l" + "r" * len(levels), ["Attack", *heads], [rows, [chance]], above=above, below=below
    )


def _marked(row: Mapping[str, Any] | None) -> str:
    value = "" if row is None else number("rank1", row["rank1"]).value
    if row is None or not value:
        return "--"
    marks = "".join(_MARKS[remark] for remark in remarks(row))
    return rf"{value}\textsuperscript{{{marks}}}" if marks else value


def _interval_below(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return ""
    shown = number("rank1", row["rank1"], row["ci_low"], row["ci_high"])
    return rf"{{\scriptsize [{shown.low}, {shown.high}]}}" if shown.low else ""


def _sweep(
    blocks: Mapping[str, Mapping[float | None, Mapping[str, Number]]],
    metrics: Sequence[str],
    *,
    source: Source | None = None,
) -> str:
    """Return a tabular over all levels; a `source` is named above its columns."""
    if source is None:
        titles = [shared_head(metric) for metric in metrics]
        above = ""
    else:
        titles = [f"{SHOWN[metric].head} ({SHOWN[metric].unit})" for metric in metrics]
        what = "As shared" if source == AS_SHARED else f"After {source.label}"
        above = f" & & \\multicolumn{{{len(metrics)}}}{{c}}{{{escape(what)}}} \\\\\n"
    groups = [
        [
            [
                escape(mechanism),
                level_text(level),
                *(_number(row.get(metric)) for metric in metrics),
            ]
            for level, row in levels.items()
        ]
        for mechanism, levels in blocks.items()
    ]
    head = ["Mechanism", "Level", *map(escape, titles)]
    return _tabular("lr" + "r" * len(metrics), head, groups, above=above)


def _number(value: Number | None) -> str:
    if value is None or not value.value:
        return "--"
    if not value.low:
        return value.value
    return f"{value.value} {{\\scriptsize [{value.low}, {value.high}]}}"


def _tabular(
    columns: str,
    head: list[str],
    groups: Iterable[list[list[str]]],
    *,
    above: str = "",
    below: str = "",
) -> str:
    body = "\\midrule\n".join(
        "".join(" & ".join(row) + " \\\\\n" for row in rows) for rows in groups
    )
    return (
        f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{above}{' & '.join(head)} \\\\\n\\midrule\n"
        f"{body}\\bottomrule\n{below}\\end{{tabular}}\n"
    )
