"""The results as LaTeX: booktabs tabulars, to be put into a table environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluation.sweeps import SHOWN, amount, level_text, number, printable, sweeps

if TYPE_CHECKING:
    from collections.abc import Iterable

    import pandas as pd

    from evaluation.sweeps import Number, Sweep

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
_PREAMBLE = "% Needs \\usepackage{booktabs}. Values with 95 % intervals.\n"


def escape(text: str) -> str:
    """Return text that LaTeX prints as it is."""
    return "".join(_SPECIAL.get(character, character) for character in printable(text))


def sweep_tex(summary: pd.DataFrame) -> str:
    """Return one tabular for the first predictor and the descriptors, and one for each other."""
    return _PREAMBLE + "\n".join(_sweep(sweep) for sweep in sweeps(summary))


def paper_tex(paper_table: pd.DataFrame) -> str:
    """Return the paper's numbers beside ours."""
    head = ["Mechanism", "Level", "Metric", "Paper", "Ours", "Ours $-$ paper"]
    rows = []
    for row in paper_table.to_dict("records"):
        metric = row["metric"]
        shown = SHOWN[metric]
        ours = number(metric, row["ours"], row["ci_low"], row["ci_high"])
        rows.append(
            [
                escape(row["mechanism"]),
                level_text(row["level"]),
                escape(f"{shown.head} ({shown.unit})"),
                amount(metric, row["paper"]),
                _number(ours),
                f"${amount(metric, row['ours'] - row['paper'], sign='+')}$" if ours.value else "",
            ]
        )
    return _PREAMBLE + _tabular("lrlrrr", head, [rows])


def _sweep(sweep: Sweep) -> str:
    shown = [SHOWN[metric] for metric in sweep.metrics]
    head = ["Mechanism", "Level", *(escape(f"{s.head} ({s.unit})") for s in shown)]
    groups = [
        [
            [
                escape(mechanism),
                level_text(level),
                *(_number(row.get(metric)) for metric in sweep.metrics),
            ]
            for level, row in levels.items()
        ]
        for mechanism, levels in sweep.blocks.items()
    ]
    comment = "" if sweep.predictor is None else f"% predictor {escape(sweep.predictor)}\n"
    return comment + _tabular("lr" + "r" * len(shown), head, groups)


def _number(value: Number | None) -> str:
    if value is None or not value.value:
        return "--"
    if not value.low:
        return value.value
    return f"{value.value} {{\\scriptsize [{value.low}, {value.high}]}}"


def _tabular(columns: str, head: list[str], groups: Iterable[list[list[str]]]) -> str:
    body = "\\midrule\n".join(
        "".join(" & ".join(row) + " \\\\\n" for row in rows) for rows in groups
    )
    return (
        f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{' & '.join(head)} \\\\\n\\midrule\n"
        f"{body}\\bottomrule\n\\end{{tabular}}\n"
    )
