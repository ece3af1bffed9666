"""The tables of the page, from the frames of a run."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from evaluation.analysis.keys import Source
from evaluation.analysis.levels import HEADLINE, SHOWN, adding_of, is_attack, level_text
from evaluation.analysis.linkability import CLEAN
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.experiment.presets import IDENTITY, SHARED
from evaluation.reporting.figures.page_figures import (
    compared_levels,
    is_control,
    strongest_link,
    strongest_reconstruction,
)
from evaluation.reporting.page_cells import Cell, decision, number, table, word

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.analysis.levels import LinkedTask
    from evaluation.reporting.page_cells import Table

_LEVEL_ONLY = {name for name, level, _ in HEADLINE if level is None} | {CLEAN}
_CRITERIA = {
    "missed": "equal rise of missed conflicts",
    "missed_at_equal_false_alarms": "the same, at equal false alarms",
    "plr": "equal PLR as shared",
}
_UNITS = {"fraction": (100.0, 1, "points"), "s": (1.0, 3, "s"), "m": (1.0, 3, "m")}


def amount(metric: str, row: Mapping[str, Any]) -> Cell:
    """Return a metric of a row of the summary, in the units shown."""
    shown = SHOWN[metric]
    return number(
        row["value"], row["ci_low"], row["ci_high"], scale=shown.scale, digits=shown.digits
    )


def head(metric: str) -> str:
    """Return the head of a metric's column."""
    shown = SHOWN[metric]
    return f"{shown.head} ({shown.unit})" if shown.unit else shown.head


def level(value: float | None) -> Cell:
    """Return a level; empty for a mechanism without one."""
    known = value is not None and math.isfinite(value)
    return Cell(level_text(value), value if known else None)


def mechanism_cells(mechanism: str, value: float | None) -> list[Cell]:
    """Return mechanism, adding rule and level."""
    bare, rule = adding_of(mechanism)
    plain = "" if bare in _LEVEL_ONLY else rule or "linear"
    return [word(bare), word(plain), level(value)]


MECHANISM_HEADS = ("mechanism", "adding", "level")


def paper_tables(paper_table: pd.DataFrame, claims: pd.DataFrame) -> list[Table]:
    """Return the paper's numbers beside ours, and its claims."""
    rows = []
    for row in paper_table.to_dict("records"):
        shown = SHOWN[row["metric"]]
        paper, ours = row["paper"], row["ours"]
        style: dict[str, Any] = {"scale": shown.scale, "digits": shown.digits}
        within = row["within"]
        known = isinstance(within, bool | np.bool_)
        rows.append(
            [
                *mechanism_cells(row["mechanism"], row["level"]),
                word(head(row["metric"])),
                number(paper, **style),
                number(ours, row["ci_low"], row["ci_high"], **style),
                number(ours - paper, sign="+", **style),
                decision("yes" if within else "no") if known else word(""),
            ]
        )
    heads = [*MECHANISM_HEADS, "metric", "paper", "ours", "ours - paper", "in our interval"]
    asked = []
    for row in claims.to_dict("records"):
        scale, digits, unit = _UNITS.get(row["unit"], (1.0, 1, str(row["unit"])))
        effect = number(
            row["effect"], row["ci_low"], row["ci_high"], scale=scale, digits=digits, unit=unit
        )
        asked.append(
            [
                word(row["adding"]),
                word(row["claim"]),
                decision(row["answer"]),
                effect,
                word(row["evidence"]),
            ]
        )
    return [
        table("paper", "The paper's numbers and ours, with 95 % intervals", heads, rows),
        table(
            "claims",
            "The paper's claims",
            ["adding", "claim", "answer", "effect", "evidence"],
            asked,
        ),
    ]


def sweep_table(summary: pd.DataFrame, *, dataset: str) -> Table:
    """Return descriptors as shared and what every predictor misses, a row for each level."""
    of = summary[(summary["dataset"] == dataset) & ~is_attack(summary)]
    shared = of["consumer"] == SHARED
    predictors = list(of.loc[of["metric"] == "missed_conflict_rate", "consumer"].unique())
    columns = [(SHARED, metric) for metric in DESCRIPTORS]
    columns += [(name, "missed_conflict_rate") for name in predictors]
    columns += [(name, "false_alarm_rate") for name in predictors[:1]]
    wanted = of[shared & of["metric"].isin(DESCRIPTORS) | ~shared]
    heads = [
        *MECHANISM_HEADS,
        *(
            head(metric) if consumer == SHARED else f"{head(metric)}, {consumer}"
            for consumer, metric in columns
        ),
    ]
    rows = []
    for (mechanism, at), block in _by_level(wanted):
        known = {(row["consumer"], row["metric"]): row for row in block}
        rows.append(
            [
                *mechanism_cells(mechanism, at),
                *(
                    amount(column[1], known[column]) if column in known else word("")
                    for column in columns
                ),
            ]
        )
    return table("sweep", "Descriptors as shared and missed conflicts, all levels", heads, rows)


def attack_table(summary: pd.DataFrame, *, dataset: str) -> Table:
    """Return the descriptors as shared and after every attack, at the levels that tell."""
    metrics = (*DESCRIPTORS, "rmse")
    of = summary[(summary["dataset"] == dataset) & summary["metric"].isin(metrics)]
    of = of[is_attack(of) | (of["consumer"] == SHARED)]
    rows = []
    for (mechanism, at), block in _by_level(of[_tells(of)]):
        by_source: dict[Source, dict[str, Mapping[str, Any]]] = {}
        for row in block:
            known = row["knowledge"] if isinstance(row["knowledge"], str) else ""
            by_source.setdefault(Source(row["consumer"], known), {})[row["metric"]] = row
        for source, found in by_source.items():
            if source.consumer == IDENTITY:
                continue
            rows.append(
                [
                    *mechanism_cells(mechanism, at),
                    word("as shared" if source.consumer == SHARED else source.consumer),
                    word(source.knowledge),
                    *(amount(one, found[one]) if one in found else word("") for one in metrics),
                ]
            )
    heads = [*MECHANISM_HEADS, "positions", "adversary", *map(head, metrics)]
    return table("attacks", "Descriptors as shared and after attack, 95 % intervals", heads, rows)


def linkage_tables(tasks: Sequence[LinkedTask]) -> dict[str, Table]:
    """Return what links in each task, at the levels that tell, and what may be believed of it."""
    heads = [
        *MECHANISM_HEADS,
        "attack",
        "adversary",
        "rank 1 (%)",
        "chance (%)",
        "outcome",
        "shortcut",
        "candidates",
        "people",
    ]
    return {
        task.name: table(
            f"linkage-{task.name}",
            f"{task.name}: {task.about}; 95 % intervals",
            heads,
            _linked_rows(task),
        )
        for task in tasks
    }


def _linked_rows(task: LinkedTask) -> list[list[Cell]]:
    levels = pd.DataFrame(
        [(name, np.nan if at is None else at) for name, at in task.cells],
        columns=["mechanism", "level"],
    )
    told = _tells(levels)
    return [
        [
            *mechanism_cells(mechanism, at),
            word(source.consumer),
            word(source.knowledge),
            number(row["rank1"], row["ci_low"], row["ci_high"], scale=100.0),
            number(row["chance"], scale=100.0),
            word(row["outcome"]),
            word(row["invalid"]),
            number(row["gallery_mean"], digits=0),
            number(row["n_clusters"], digits=0),
        ]
        for ((mechanism, at), block), tells in zip(task.cells.items(), told, strict=True)
        if tells
        for source, row in block.items()
    ]


def matched_table(
    matched: pd.DataFrame,
    summary: pd.DataFrame,
    tasks: Sequence[LinkedTask],
    *,
    dataset: str,
) -> Table:
    """Return FID against fixed noise half way along each curve, of the strongest attacks."""
    sources = {Source(SHARED)}
    attack = strongest_reconstruction(summary, dataset=dataset)
    if attack is not None:
        sources.add(attack)
    for task in tasks:
        link = strongest_link(task)
        sources.add(Source(f"{task.name}/{link.consumer}", link.knowledge))
    rows = []
    keys = ["criterion", "adding", "predictor", "consumer", "knowledge", "metric"]
    for _, part in _texts(matched, keys).groupby(keys, sort=False):
        first = part.iloc[0]
        if Source(first["consumer"], first["knowledge"]) not in sources:
            continue
        known = part[part["ci_low"].notna()]
        row = (known if len(known) else part).sort_values("at").iloc[max(0, len(known) - 1) // 2]
        shown = SHOWN.get(row["metric"])
        scale, digits = (shown.scale, shown.digits) if shown else (100.0, 1)
        unit = shown.unit if shown else "%"
        rows.append(
            [
                word(_CRITERIA.get(row["criterion"], row["criterion"])),
                word(row["adding"]),
                word(row["predictor"]),
                word("as shared" if row["consumer"] == SHARED else row["consumer"]),
                word(row["knowledge"]),
                word(f"{shown.head if shown else row['metric']} ({unit})"),
                number(row["at"], scale=100.0),
                number(row["fid"], row["fid_low"], row["fid_high"], scale=scale, digits=digits),
                number(
                    row["fixed"], row["fixed_low"], row["fixed_high"], scale=scale, digits=digits
                ),
                number(
                    row["difference"],
                    row["ci_low"],
                    row["ci_high"],
                    scale=scale,
                    digits=digits,
                    sign="+",
                ),
            ]
        )
    heads = [
        "matched by",
        "adding",
        "predictor",
        "positions or attack",
        "adversary",
        "metric",
        "at (%)",
        "FID",
        "fixed",
        "FID - fixed",
    ]
    return table("matched", "FID against fixed noise where they cost or show the same", heads, rows)


def decision_table(decisions: pd.DataFrame, summary: pd.DataFrame, *, dataset: str) -> Table:
    """Return misses at equal false alarms, at the levels that the curves show."""
    rows = []
    for mechanism, at in compared_levels(summary, dataset=dataset):
        same = decisions["level"].isna() if at is None else np.isclose(decisions["level"], at)
        of = decisions[(decisions["mechanism"] == mechanism) & same]
        rows += [
            [
                *mechanism_cells(mechanism, at),
                word(row["consumer"]),
                word(row["score"]),
                number(row["area"], row["area_low"], row["area_high"], digits=3),
                number(row["false_alarm_rate"], scale=100.0),
                number(
                    row["missed_conflict_rate"], row["missed_low"], row["missed_high"], scale=100.0
                ),
                number(row["difference"], row["ci_low"], row["ci_high"], scale=100.0, sign="+"),
            ]
            for row in of.to_dict("records")
        ]
    heads = [
        *MECHANISM_HEADS,
        "predictor",
        "score",
        "area (0 perfect, 0.5 chance)",
        "at false alarms (%)",
        "missed (%)",
        "missed - reference (points)",
    ]
    return table("decisions", "Misses at equal false alarms", heads, rows)


def flag_table(flags: pd.DataFrame) -> Table:
    """Return the flags of weak attacks."""
    rows = [
        [
            word({"beaten": "beaten", "does_not_fall": "does not fall"}.get(row["kind"], "")),
            word(f"{row['attack']} ({row['knowledge']})"),
            word(f"{row['by']} ({row['by_knowledge']})" if row["by"] else ""),
            *mechanism_cells(row["mechanism"], row["level"]),
            number(row["difference"], row["ci_low"], row["ci_high"], scale=100.0, sign="+"),
        ]
        for row in _texts(flags, ["by", "by_knowledge"]).to_dict("records")
    ]
    heads = ["flag", "attack", "beaten by", *MECHANISM_HEADS, "PLR difference (points)"]
    return table("flags", "Attacks that may be too weak", heads, rows)


def doubt_table(linkability: pd.DataFrame) -> Table:
    """Return the linkage cells that measure nothing: invalid ones, and too weak attacks."""
    of = linkability[linkability["cohort"] == "all"]
    of = _texts(of, ["knowledge", "outcome", "invalid"])
    of = of[of["knowledge"] != ""]
    of = of[(of["invalid"] != "") | (of["outcome"] == "attack too weak")]
    rows = [
        [
            word(row["consumer"]),
            word(row["knowledge"]),
            *mechanism_cells(row["mechanism"], row["level"]),
            word(
                f"invalid: {row['invalid']} tells people apart"
                if row["invalid"]
                else "attack too weak: it fails on clean too"
            ),
        ]
        for row in of.to_dict("records")
    ]
    heads = ["task/attack", "adversary", *MECHANISM_HEADS, "why"]
    return table("doubts", "Linkage cells that measure nothing", heads, rows)


def verdict_tables(items: Sequence[Mapping[str, Any]]) -> dict[str, Table]:
    """Return the items of the verdict, a table for each section."""
    sections: dict[str, list[Mapping[str, Any]]] = {}
    for item in items:
        sections.setdefault(str(item["section"]), []).append(item)
    found = {}
    for section, of in sections.items():
        optional = [key for key in ("descriptor", "task", "criterion") if any(i[key] for i in of)]
        heads = ["decision", "what it says", "effect", "adding", *optional, "about", "people"]
        rows = [
            [
                decision(item["decision"]),
                word(_sentence(item)),
                _effect(item),
                word(item["adding"]),
                *(_aspect(key, item[key]) for key in optional),
                word(item["subject"]),
                number(item["n"], digits=0),
            ]
            for item in of
        ]
        found[section] = table(f"verdict-{section}", section.capitalize(), heads, rows)
    return found


def _sentence(item: Mapping[str, Any]) -> str:
    why = item.get("why_undecided")
    return f"{item['sentence']} Undecided: {why.rstrip('.')}." if why else str(item["sentence"])


def _aspect(key: str, value: str) -> Cell:
    if key == "criterion":
        return word(_CRITERIA.get(value, value))
    return word(value.upper() if key == "descriptor" else value)


def contrast_table(items: Sequence[Mapping[str, Any]]) -> Table:
    """Return the contrasts with the dissociation controls that validity rests on."""
    rows = [
        [
            word(item["adding"]),
            _aspect("descriptor", item["descriptor"]),
            word(item["task"]),
            word(contrast.get("subject") or item["subject"]),
            word(contrast["mechanism"]),
            level(contrast["level"]),
            decision(contrast["reading"]),
            _effect({**contrast, "unit": item["unit"]}),
        ]
        for item in items
        for contrast in item.get("contrasts") or ()
    ]
    heads = ["adding", "descriptor", "task", "attack", "against", "level", "reading", "effect"]
    return table(
        "contrasts",
        "FID and the controls against fixed noise where the descriptor is equal",
        heads,
        rows,
    )


def _effect(item: Mapping[str, Any]) -> Cell:
    scale, digits, unit = _UNITS.get(item["unit"], (1.0, 2, ""))
    is_ratio = item["unit"] == "ratio"
    return number(
        item["effect"],
        item["ci_low"],
        item["ci_high"],
        scale=scale,
        digits=digits,
        sign="-" if is_ratio else "+",
        unit="times" if is_ratio else unit,
    )


def _texts(frame: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Return the frame with empty texts where they are missing, as in one read from a file."""
    texts = frame[list(names)].astype(object)
    return frame.assign(**texts.where(texts.notna(), ""))


def _tells(frame: pd.DataFrame) -> pd.Series[bool]:
    """Return which rows are of the levels that tell the story, or of all if there is none."""
    bare = frame["mechanism"].map(lambda name: adding_of(name)[0])
    chosen = bare.isin(_LEVEL_ONLY) | frame["mechanism"].map(is_control).astype(bool)
    told = pd.Series(False, index=frame.index)
    for name, at, _ in HEADLINE:
        if at is not None:
            told |= (bare == name) & np.isclose(frame["level"].fillna(-1.0), float(at))
    return chosen | (told if told.any() else True)


def _by_level(
    frame: pd.DataFrame,
) -> list[tuple[tuple[str, float | None], list[Mapping[str, Any]]]]:
    blocks: dict[tuple[str, float | None], list[Mapping[str, Any]]] = {}
    for row in frame.to_dict("records"):
        at = None if math.isnan(row["level"]) else float(row["level"])
        blocks.setdefault((row["mechanism"], at), []).append({str(k): v for k, v in row.items()})
    return list(blocks.items())
