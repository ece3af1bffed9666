"""The results as LaTeX: booktabs tabulars, to be put into a table environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluation.sweeps import (
    AS_SHARED,
    DESCRIPTORS,
    SHOWN,
    after_attack,
    amount,
    level_text,
    number,
    printable,
    shared_head,
    sources,
    sweeps,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import pandas as pd

    from evaluation.sweeps import Number, Source

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
    columns: str, head: list[str], groups: Iterable[list[list[str]]], *, above: str = ""
) -> str:
    body = "\\midrule\n".join(
        "".join(" & ".join(row) + " \\\\\n" for row in rows) for rows in groups
    )
    return (
        f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{above}{' & '.join(head)} \\\\\n\\midrule\n"
        f"{body}\\bottomrule\n\\end{{tabular}}\n"
    )
