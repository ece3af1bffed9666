"""Tables of answers: the paper's numbers and claims, equal costs, weak attacks, and the verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from evaluation.estimates import paper
from evaluation.estimates.frontier import GAP, LEVEL_READ, VALUE, usual_price
from evaluation.estimates.keys import AS_SHARED, Source, rows_of, where_text
from evaluation.estimates.matching import AT_EQUAL_ALARMS, FUTURE, MISSED
from evaluation.estimates.metrics import (
    EXPOSURE,
    METRICS,
    OF_ROBOT,
    SUCCESS,
    SUCCESS_OF_100,
)
from evaluation.estimates.strongest import HEADLINE
from evaluation.plan.constants import horizon_of
from evaluation.reporting import table as make
from evaluation.reporting.lookups import family_of
from evaluation.reporting.result_tables import laplace_notes
from evaluation.reporting.rows import Results, mechanism_columns
from evaluation.reporting.table import Cell, Column, Table
from evaluation.verdict import rules

CRITERIA = {  # By what operating points are matched.
    MISSED: "equal rise of missed conflicts",
    AT_EQUAL_ALARMS: "the same, at equal false alarms",
    FUTURE: "equal rise of missed future conflicts, at equal false alarms",
    "plr": "equal PLR as shared",
}
_EFFECTS = {
    "fraction": (100.0, 1, "points"),
    "s": (1.0, 3, "s"),
    "m": (1.0, 3, "m"),
    "correlation": (1.0, 2, ""),
    "ratio": (1.0, 2, "times"),
}


def effect(row: Mapping[str, Any], *, signed: bool = False) -> Cell:
    """Return an effect with its interval and unit; a ratio has no sign, a difference may."""
    unit = str(row["unit"])
    scale, digits, name = _EFFECTS.get(unit, (1.0, 1, unit))
    sign = "+" if signed and unit != "ratio" else "-"
    ends = (row[key] for key in ("effect", "ci_low", "ci_high"))
    return make.number(*ends, scale=scale, digits=digits, unit=name, sign=sign)


def paper_table(run: Results) -> Table:
    """Return the paper's numbers beside ours; judged only on the paper's own recording."""
    judged = "paper in our interval", "tolerance at 5,000 scenes"
    frame = run.paper_table
    records = frame.assign(bias=frame["ours"] - frame["paper"]).to_dict("records")
    for row in records:
        metric, published = row["metric"], row["paper"]
        row["paper_error"] = paper.monte_carlo_error(metric, published)
        is_judged = isinstance(row["within"], bool | np.bool_) and np.isfinite(
            row["ci_low"]
        )
        answer = "fitted" if paper.is_fitted(row) else "yes" if row["within"] else "no"
        row[judged[0]] = answer if is_judged else ""
        allowed = paper.tolerance(row["mechanism"], metric, published)
        # A hair more: the difference of two rounded fractions may miss the limit
        # itself.
        met = "yes" if abs(row["bias"]) <= allowed + 1e-12 else "no"
        text = f"{met} ({make.amount(metric, allowed).text})"
        row[judged[1]] = text if np.isfinite(row["ours"]) else ""
    linear = [row for row in records if "adding=" not in row["mechanism"]]
    seen = [row for row in linear if not paper.is_fitted(row)]
    rates = [
        row for row in records if np.isfinite(row["paper_error"])
    ]  # the missed ones
    is_own = run.dataset == paper.DATASET
    identity = run.manifest["identity"]
    n_scenes = identity.get("scenes_utility", identity["scenes"])
    n_attacked = identity["scenes"]
    notes = [f"Missed rates rest on {n_scenes:,} scenes, the others on {n_attacked:,}."]
    if is_own:
        notes += _own_recording_notes(linear, seen, rates, judged[1])
    else:
        notes.append(
            f"The paper used {paper.DATASET}; ours are of {run.dataset}, so they need"
            " not agree."
        )
    columns = [
        *mechanism_columns(run.families),
        make.said("metric", lambda row: METRICS[row["metric"]].title),
        make.measured("paper", "paper"),
        make.measured("ours", "ours", "ci_low", "ci_high"),
        make.measured("ours - paper", "bias", sign="+"),
        make.measured("paper's own error", "paper_error"),
        *(replace(make.decided(name), align="right") for name in judged if is_own),
    ]
    title = "The paper's numbers beside ours, privacy as shared; 95 % intervals"
    return make.built(
        "paper", title, records, columns, notes=notes, n_headings=2, n_keys=4
    )


def _own_recording_notes(
    linear: Sequence[Mapping[Any, Any]],
    seen: Sequence[Mapping[Any, Any]],
    rates: Sequence[Mapping[Any, Any]],
    tolerance: str,
) -> list[str]:
    """Return how many numbers were fitted and how many agree, on the recording of the paper.

    `linear` are the numbers under the adding rule of the paper, `seen` those that were
    not fitted, `rates` the missed rates, and `tolerance` the column that says whether
    they agree.
    """
    n_within = sum(row[tolerance].startswith("yes") for row in seen)
    far = [
        where_text(row["mechanism"], row["level"])
        for row in rates
        if paper.differs(row)
    ]
    fitted = (
        f"Of {len(linear)} numbers under linear adding {len(linear) - len(seen)} are"
        f" fitted. The other {len(seen)} were seen when the readings were chosen:"
        f" {n_within} are within the tolerance."
    )
    error = (
        f"The paper's own error is that of a share of {paper.CONFLICTS} conflicts."
        f" Missed rates that differ at 5 % by both errors: {', '.join(far) or 'none'}"
        f" (of {len(rates)}, each by itself)."
    )
    return [fitted, error]


def claims_table(run: Results) -> Table:
    """Return the paper's claims, and whether they hold."""
    columns = [
        *map(make.said, ("adding", "claim")),
        make.decided("answer"),
        Column("effect", effect),
        replace(make.said("evidence"), is_long=True),
    ]
    title, notes = "The paper's claims; 95 % intervals", ["Evidence: paper_claims.csv."]
    records = run.claims.to_dict("records")
    return make.built(
        "claims", title, records, columns, notes=notes, n_headings=1, n_keys=2
    )


def frontier_table(run: Results) -> Table:
    """Return what is left, and at which level, where missed conflicts have risen by a target."""
    names, of = ["robot", "mechanism", "target"], run.frontier
    is_told = of["metric"].isin([EXPOSURE, OF_ROBOT, SUCCESS, SUCCESS_OF_100])
    records: dict[tuple[Any, ...], dict[str, Any]] = {}
    heads: dict[str, None] = {}
    priced = usual_price(of[is_told]) if len(of) else of
    for row in rows_of(priced):
        source = Source(row["consumer"], row["knowledge"])
        whose = (
            "attacked" if source.knowledge in HEADLINE else f"after {source.knowledge}"
        )
        whose = "shared" if source == AS_SHARED else whose
        head = f"{source.task or METRICS[row['metric']].head}, {whose}"
        if row["metric"] == OF_ROBOT:
            head = METRICS[OF_ROBOT].head
        record = records.setdefault(tuple(row[name] for name in names), dict(row))
        for key, ends in ((head, VALUE), (f"{head}, less white", GAP)):
            if key == head or head == f"{METRICS[EXPOSURE].head}, attacked":
                record[key] = make.number(*(row[name] for name in ends), scale=100.0)
                heads[key] = None
    columns = [
        make.said("robot"),
        make.said(
            "mechanism", lambda row: family_of(run.families, row["mechanism"]).name
        ),
        make.said("adding"),
        make.counted("rise", "points", "target", scale=100.0, sign="+"),
        make.counted("level", "", *LEVEL_READ, digits=2),
        *(replace(make.held(head), unit="%") for head in heads),
        make.said("beaten", lambda row: "yes" if row["dominated"] is True else ""),
    ]
    title = (
        "What is left where missed conflicts have risen so far over raw, at raw's false"
        " alarms"
    )
    notes = [
        price_text(priced),
        "Empty: out of reach of the levels that were run. More: frontier.csv.",
        "No interval: fewer than 4 levels within 3 points, or too few people.",
        (
            "Beaten: another is surely better by over 2 points in attacked PLR or"
            " linkage, it in none."
        ),
        (
            "An error that is constant over a track is drawn once a person: 5 seeds"
            " tell more."
        ),
        *laplace_notes(of.round({"level": 2}), n_reports=run.n_reports),
    ]
    return make.built(
        "frontier", title, records.values(), columns, notes=notes, n_keys=4
    )


def price_text(priced: pd.DataFrame) -> str:
    """Return by which missed conflicts rows of a frontier are priced, in a sentence."""
    if not (priced["criterion"] == FUTURE).any():
        return "The price: missed conflicts, at raw's false alarms."
    horizon_s = horizon_of(str(priced["dataset"].iloc[0]).rpartition(":")[2])
    ahead = "" if horizon_s is None else f" {horizon_s:g} s ahead"
    return (
        f"The price: missed conflicts that are still to come{ahead}, at raw's false"
        " alarms."
    )


def flag_table(run: Results) -> Table:
    """Return the flags of weak attacks."""
    ends = ("difference", "ci_low", "ci_high")
    texts = run.flags.assign(
        **run.flags[["by", "by_knowledge"]].astype(object).fillna("")
    )
    columns = [
        make.said("flag", lambda row: row["kind"].replace("_", " ")),
        make.said("attack", lambda row: Source(row["attack"], row["knowledge"]).label),
        make.said(
            "beaten by", lambda row: Source(row["by"], row["by_knowledge"]).label
        ),
        *mechanism_columns(run.families),
        make.counted("PLR difference", "points", *ends, scale=100.0, sign="+"),
    ]
    return make.built("flags", "All flags", rows_of(texts), columns, n_keys=6)


def item_tables(items: Sequence[Mapping[str, Any]]) -> dict[str, Table]:
    """Return the items of the verdict, a table for each section."""
    found = {}
    for section in dict.fromkeys(
        [*rules.SECTIONS, *(str(one["section"]) for one in items)]
    ):
        records = [_told(one) for one in items if one["section"] == section]
        if not records:
            continue
        aspects = "mechanism", "descriptor", "task", "criterion", "about"
        keys = ["adding", *(key for key in aspects if any(one[key] for one in records))]
        columns = [
            make.decided("decision"),
            replace(make.said("what it says"), is_long=True),
            *map(make.said, keys),
            Column("effect", partial(effect, signed=True)),
            make.counted("people", "", "n", digits=0),
        ]
        if all("power" in one for one in records):
            ends = ("prediction_error", "prediction_error_low", "prediction_error_high")
            columns += [
                Column("people that show an equal", _people_needed),
                make.said("evidence", lambda row: ", ".join(row["evidence"])),
                make.said("power to show", _power),
                make.counted("prediction error", "points", *ends, scale=100.0),
            ]
        about = f"verdict-{section}", section.capitalize()
        notes, n_keys = _untestable(records), 1 + len(keys)
        found[section] = make.built(
            *about, records, columns, notes=notes, n_keys=n_keys
        )
    return found


def _untestable(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return why some items could not be tested: a note for each reason, and whom it concerns."""
    reasons: dict[str, list[str]] = {}
    for row in records:
        if row["decision"] == rules.NOT_TESTABLE:
            about = " ".join(
                filter(None, (row[key] for key in ("task", "adding", "mechanism")))
            )
            reasons.setdefault(row["why"], []).append(about)
    return [
        f"Not testable, {len(of)} of {len(records)} ({', '.join(dict.fromkeys(of))}):"
        f" {why}."
        for why, of in reasons.items()
    ]


def _criterion_text(item: Mapping[str, Any]) -> str:
    horizon_s = item.get("horizon_s")
    text = CRITERIA.get(item["criterion"], item["criterion"])
    return text if horizon_s is None else f"{text}, {horizon_s:g} s ahead"


def _people_needed(row: Mapping[str, Any]) -> Cell:
    """Return how many people would show that linkage is equal, where anybody could record them."""
    needed = row["n_needed"]
    if needed is not None and needed >= rules.MOST_PEOPLE:
        return make.word("no realistic number")
    return make.number(needed, digits=0)


def _power(item: Mapping[str, Any]) -> str:
    power = item["power"]
    return (
        f"equal {100 * power[rules.TRACKS]:.0f} %, 10 points"
        f" {100 * power[rules.DOES_NOT]:.0f} %"
    )


def _told(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return an item with what it says in one sentence, and what it is about as over a column."""
    descriptor, decision = item["descriptor"], item["decision"].capitalize()
    why = "" if item["why"] in item["sentence"] else item["why"]
    of, is_claim = item.get("of", ""), item["section"] == rules.CLAIM
    return {
        **item,
        "mechanism": item.get("mechanism", "fid") if is_claim else of,
        "about": item["subject"] or ("as shared" if is_claim else ""),
        "what it says": (
            item["sentence"] + (f" {decision}: {why.rstrip('.')}." if why else "")
        ),
        "descriptor": METRICS[descriptor].head if descriptor in METRICS else descriptor,
        "criterion": _criterion_text(item),
    }
