"""Tables of what the paper says, of what costs the same, and of attacks that may be too weak."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.keys import Source
from evaluation.analysis.metrics import METRICS, MISSED_RATE
from evaluation.analysis.paper import DATASET, tolerance
from evaluation.experiment.presets import SHARED
from evaluation.reporting.rows import by_level, mechanism_columns
from evaluation.reporting.table import (
    Cell,
    Column,
    amount,
    built,
    counted,
    decided,
    decision,
    measured,
    number,
    said,
    word,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    import pandas as pd

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Where
    from evaluation.reporting.table import Table

CRITERIA = {
    "missed": "equal rise of missed conflicts",
    "missed_at_equal_false_alarms": "the same, at equal false alarms",
    "plr": "equal PLR as shared",
}
"""By what operating points are matched."""
_POINT = ("criterion", "adding", "predictor", "consumer", "knowledge", "metric")
_AS_SHARED = {SHARED: "as shared"}
_EFFECTS = {
    "fraction": (100.0, 1, "points"),
    "s": (1.0, 3, "s"),
    "m": (1.0, 3, "m"),
    "correlation": (1.0, 2, ""),
}


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
    note = f"The paper used {DATASET}; ours are of {dataset}, so they need not agree."
    records = frame.assign(bias=frame["ours"] - frame["paper"]).to_dict("records")
    judged = [
        (Column("paper in our interval"), _within),
        (Column("tolerance at 5,000 scenes"), _tolerated),
    ]
    return built(
        "paper",
        "The paper's numbers beside ours, privacy as shared; 95 % intervals",
        records,
        [
            *mechanism_columns(known),
            said("metric", lambda row: METRICS[row["metric"]].title),
            measured("paper", "paper"),
            measured("ours", "ours", "ci_low", "ci_high"),
            measured("ours - paper", "bias", sign="+"),
            *judged * is_same,
        ],
        notes=[] if is_same else [note],
        n_headings=2,
        n_keys=4,
    )


def _within(row: Mapping[str, Any]) -> Cell:
    is_judged = isinstance(row["within"], bool | np.bool_) and np.isfinite(row["ci_low"])
    return decision("yes" if row["within"] else "no") if is_judged else Cell()


def _tolerated(row: Mapping[str, Any]) -> Cell:
    allowed = tolerance(row["mechanism"], row["metric"], row["paper"])
    # A hair more: the difference of two rounded fractions may miss the limit itself.
    met = "yes" if abs(row["bias"]) <= allowed + 1e-12 else "no"
    text = f"{met} ({amount(row['metric'], allowed).text})"
    return Cell(text if np.isfinite(row["ours"]) else "")


def claims_table(claims: pd.DataFrame) -> Table:
    """Return the paper's claims, and whether they hold."""
    return built(
        "claims",
        "The paper's claims; 95 % intervals",
        claims.to_dict("records"),
        [
            said("adding"),
            said("claim"),
            decided("answer"),
            (Column("effect"), effect),
            (Column("evidence", align="left", is_long=True), lambda row: word(row["evidence"])),
        ],
        notes=["Evidence: paper_claims.csv."],
        n_headings=1,
        n_keys=2,
    )


def matched_table(matched: pd.DataFrame, *, strongest: Collection[Source]) -> Table:
    """Return every mechanism against fixed noise half way along each curve, strongest attacks.

    Parameters
    ----------
    matched : DataFrame
        As in `matched.csv`.
    strongest : collection of Source
        Attacks that are shown, a linker with its task before it.
    """
    sources = {Source(SHARED), *strongest}
    keys = [*_POINT, "mechanism"]
    texts = matched.assign(**matched[keys].astype(object).fillna(""))
    rows = []
    for _, part in texts.groupby(keys, sort=False):
        first = part.iloc[0]
        if Source(first["consumer"], first["knowledge"]) in sources:
            known = part[part["ci_low"].notna()]
            middle = max(0, len(known) - 1) // 2
            rows.append((known if len(known) else part).sort_values("at").iloc[middle].to_dict())
    return built(
        "matched",
        "Every mechanism against fixed noise, half way along each curve: the strongest attacks",
        rows,
        [
            said("matched by", lambda row: CRITERIA.get(row["criterion"], row["criterion"])),
            said("adding"),
            said("predictor"),
            said(
                "positions or attack", lambda row: _AS_SHARED.get(row["consumer"], row["consumer"])
            ),
            said("adversary", "knowledge"),
            said("metric", lambda row: METRICS[row["metric"]].title),
            said("mechanism"),
            counted("at", "%", "at", scale=100.0),
            measured("of the mechanism", "fid", "fid_low", "fid_high"),
            measured("of fixed noise", "fixed", "fixed_low", "fixed_high"),
            measured("difference", "difference", "ci_low", "ci_high", sign="+"),
        ],
        notes=["All points, attacks and intervals: matched.csv."],
        n_headings=3,
        n_keys=7,
    )


def decision_table(
    decisions: pd.DataFrame, known: Mapping[str, Family], *, wheres: Sequence[Where]
) -> Table:
    """Return misses at equal false alarms, at some levels."""
    told = by_level(decisions)
    return built(
        "decisions",
        "Misses at equal false alarms",
        [row for where in wheres for row in told.get(where, ())],
        [
            *mechanism_columns(known),
            said("predictor", "consumer"),
            said("score"),
            counted("area (0 perfect, 0.5 chance)", "", "area", "area_low", "area_high", digits=3),
            counted("at false alarms", "%", "false_alarm_rate", scale=100.0),
            measured("missed", MISSED_RATE, "missed_low", "missed_high", metric=MISSED_RATE),
            counted(
                *("missed - reference", "points", "difference", "ci_low", "ci_high"),
                scale=100.0,
                sign="+",
            ),
        ],
        n_headings=3,
        n_keys=5,
    )


def flag_table(flags: pd.DataFrame, known: Mapping[str, Family]) -> Table:
    """Return the flags of weak attacks."""
    texts = flags.assign(**flags[["by", "by_knowledge"]].astype(object).fillna(""))
    return built(
        "flags",
        "All flags",
        texts.to_dict("records"),
        [
            said("flag", lambda row: row["kind"].replace("_", " ")),
            said("attack", lambda row: Source(row["attack"], row["knowledge"]).label),
            said("beaten by", lambda row: Source(row["by"], row["by_knowledge"]).label),
            *mechanism_columns(known),
            counted(
                *("PLR difference", "points", "difference", "ci_low", "ci_high"),
                scale=100.0,
                sign="+",
            ),
        ],
        n_keys=6,
    )
