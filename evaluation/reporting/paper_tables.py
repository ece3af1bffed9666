"""Tables of what the paper says, of what costs the same, and of attacks that may be too weak."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from evaluation.analysis.keys import Source
from evaluation.analysis.metrics import EXPOSURE, METRICS
from evaluation.analysis.paper import DATASET, tolerance
from evaluation.experiment.presets import SHARED
from evaluation.reporting.rows import MECHANISM, family_of, mechanism_cells
from evaluation.reporting.table import Cell, Column, amount, decision, number, table, word, words

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Where
    from evaluation.reporting.table import Table

CRITERIA = {
    "missed": "equal rise of missed conflicts",
    "missed_at_equal_false_alarms": "the same, at equal false alarms",
    "plr": "equal PLR as shared",
}
"""By what operating points are matched."""
_EFFECTS = {"fraction": (100.0, 1, "points"), "s": (1.0, 3, "s"), "m": (1.0, 3, "m")}


def effect(row: Mapping[str, Any], *, signed: bool = False) -> Cell:
    """Return an effect with its interval and unit; a ratio has no sign, a difference may."""
    unit = str(row["unit"])
    is_ratio = unit == "ratio"
    scale, digits, name = _EFFECTS.get(unit, (1.0, 2, "times") if is_ratio else (1.0, 1, unit))
    return number(
        *(row[key] for key in ("effect", "ci_low", "ci_high")),
        scale=scale,
        digits=digits,
        unit=name,
        sign="+" if signed and not is_ratio else "-",
    )


def paper_table(frame: pd.DataFrame, known: Mapping[str, Family], *, dataset: str) -> Table:
    """Return the paper's numbers beside ours; judged only on the paper's own recording."""
    is_same = dataset == DATASET
    rows = []
    for row in frame.to_dict("records"):
        metric, ours = row["metric"], row["ours"]
        bias = ours - row["paper"]
        allowed = tolerance(row["mechanism"], metric, row["paper"])
        # A hair more: the difference of two rounded fractions may miss the limit itself.
        met = "yes" if abs(bias) <= allowed + 1e-12 else "no"
        within = row["within"] if np.isfinite(row["ci_low"]) else None
        is_judged = isinstance(within, bool | np.bool_)
        rows.append(
            [
                *mechanism_cells(family_of(known, row["mechanism"]), row["level"]),
                word(METRICS[metric].title),
                amount(metric, row["paper"]),
                amount(metric, ours, row["ci_low"], row["ci_high"]),
                amount(metric, bias, sign="+"),
                *[decision("yes" if within else "no") if is_judged else Cell()] * is_same,
                *[Cell(f"{met} ({amount(metric, allowed).text})" if np.isfinite(ours) else "")]
                * is_same,
            ]
        )
    judged = [Column("paper in our interval"), Column("tolerance at 5,000 scenes")]
    columns = [
        *MECHANISM,
        *words("metric"),
        Column("paper"),
        Column("ours"),
        Column("ours - paper"),
        *judged * is_same,
    ]
    note = f"The paper used {DATASET}; ours are of {dataset}, so they need not agree."
    return table(
        "paper",
        "The paper's numbers beside ours, privacy as shared; 95 % intervals",
        columns,
        rows,
        notes=[] if is_same else [note],
        n_headings=2,
        n_keys=4,
    )


def claims_table(claims: pd.DataFrame) -> Table:
    """Return the paper's claims, and whether they hold."""
    rows = [
        [
            word(row["adding"]),
            word(row["claim"]),
            decision(row["answer"]),
            effect(row),
            word(row["evidence"]),
        ]
        for row in claims.to_dict("records")
    ]
    columns = [
        *words("adding", "claim", "answer"),
        Column("effect"),
        Column("evidence", align="left", is_long=True),
    ]
    notes = ["Evidence: paper_claims.csv."]
    title = "The paper's claims; 95 % intervals"
    return table("claims", title, columns, rows, notes=notes, n_headings=1, n_keys=2)


def matched_table(matched: pd.DataFrame, *, strongest: Collection[Source]) -> Table:
    """Return FID against fixed noise half way along each curve, of the strongest attacks.

    Parameters
    ----------
    matched : DataFrame
        As in `matched.csv`.
    strongest : collection of Source
        Attacks that are shown, a linker with its task before it.
    """
    sources = {Source(SHARED), *strongest}
    keys = ["criterion", "adding", "predictor", "consumer", "knowledge", "metric"]
    texts = matched.assign(**matched[keys].astype(object).fillna(""))
    rows = []
    for _, part in texts.groupby(keys, sort=False):
        first = part.iloc[0]
        if Source(first["consumer"], first["knowledge"]) not in sources:
            continue
        known = part[part["ci_low"].notna()]
        row = (known if len(known) else part).sort_values("at").iloc[max(0, len(known) - 1) // 2]
        metric = row["metric"]
        rows.append(
            [
                word(CRITERIA.get(row["criterion"], row["criterion"])),
                word(row["adding"]),
                word(row["predictor"]),
                word("as shared" if row["consumer"] == SHARED else row["consumer"]),
                word(row["knowledge"]),
                word(METRICS[metric].title),
                number(row["at"], scale=100.0),
                amount(metric, row["fid"], row["fid_low"], row["fid_high"]),
                amount(metric, row["fixed"], row["fixed_low"], row["fixed_high"]),
                amount(metric, row["difference"], row["ci_low"], row["ci_high"], sign="+"),
            ]
        )
    columns = [
        *words("matched by", "adding", "predictor", "positions or attack", "adversary", "metric"),
        Column("at", "%"),
        Column("FID"),
        Column("fixed"),
        Column("FID - fixed"),
    ]
    title = "FID against fixed noise, half way along each curve: the strongest attacks"
    notes = ["All points, attacks and intervals: matched.csv."]
    return table("matched", title, columns, rows, notes=notes, n_headings=3, n_keys=6)


def decision_table(
    decisions: pd.DataFrame, known: Mapping[str, Family], *, wheres: Sequence[Where]
) -> Table:
    """Return misses at equal false alarms, at some levels."""
    rows = []
    for mechanism, at in wheres:
        same = decisions["level"].isna() if at is None else np.isclose(decisions["level"], at)
        of = decisions[(decisions["mechanism"] == mechanism) & same]
        rows += [
            [
                *mechanism_cells(family_of(known, mechanism), at),
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
    columns = [
        *MECHANISM,
        *words("predictor", "score"),
        Column("area (0 perfect, 0.5 chance)"),
        Column("at false alarms", "%"),
        Column("missed", "%"),
        Column("missed - reference", "points"),
    ]
    return table("decisions", "Misses at equal false alarms", columns, rows, n_headings=3, n_keys=5)


def flag_table(flags: pd.DataFrame, known: Mapping[str, Family]) -> Table:
    """Return the flags of weak attacks."""
    kinds = {"beaten": "beaten", "does_not_fall": "does not fall"}
    texts = flags.assign(**flags[["by", "by_knowledge"]].astype(object).fillna(""))
    rows = [
        [
            word(kinds.get(row["kind"], "")),
            word(Source(row["attack"], row["knowledge"]).label),
            word(Source(row["by"], row["by_knowledge"]).label),
            *mechanism_cells(family_of(known, row["mechanism"]), row["level"]),
            amount(EXPOSURE, row["difference"], row["ci_low"], row["ci_high"], sign="+"),
        ]
        for row in texts.to_dict("records")
    ]
    columns = [
        *words("flag", "attack", "beaten by"),
        *MECHANISM,
        Column("PLR difference", "points"),
    ]
    return table("flags", "All flags", columns, rows, n_keys=6)
