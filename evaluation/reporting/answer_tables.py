"""Tables of answers: paper's numbers and claims, frontier, weak attacks, verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from evaluation.estimates import paper
from evaluation.estimates.frontier import LEVEL_READ, VALUE, VS_WHITE, usual_price
from evaluation.estimates.keys import row_dicts, where_text
from evaluation.estimates.metrics import (
    METRICS,
    PLR,
    RANK1,
    RANK1_AMONG_100,
    ROBOT_PLR,
)
from evaluation.estimates.strongest import HEADLINE
from evaluation.estimates.sweeps import AT_EQUAL_ALARMS, FUTURE, MISSED
from evaluation.plan.address import AS_SHARED, parse_consumer, parse_dataset
from evaluation.reporting import table as make
from evaluation.reporting.amounts import PERCENT, whole_percent
from evaluation.reporting.lookups import find_family
from evaluation.reporting.result_tables import laplace_notes
from evaluation.reporting.rows import Results, mechanism_columns
from evaluation.reporting.table import Cell, Column, Table
from evaluation.verdict import rules
from evaluation.verdict.number_text import is_realistic

# How operating points are matched.
CRITERIA = {
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
"""By the unit of an effect: the scale, the digits and the unit of its text."""
_JUDGED = "paper in our interval"
_TOLERANCE = "tolerance at 5,000 scenes"
_ROUNDING = 1e-12  # The difference of two rounded fractions may exceed a limit by this.


def effect(row: Mapping[str, Any], *, signed: bool = False) -> Cell:
    """Return an effect with its interval and unit; a ratio never has a sign."""
    unit = str(row["unit"])
    scale, digits, name = _EFFECTS.get(unit, (1.0, 1, unit))
    sign = "+" if signed and unit != "ratio" else "-"
    ends = (row[key] for key in ("effect", "ci_low", "ci_high"))
    return make.number_cell(*ends, scale=scale, digits=digits, unit=name, sign=sign)


def paper_table(run: Results) -> Table:
    """Return the paper's numbers beside ours; judged on the paper's recording alone."""
    frame = run.paper_table
    records = frame.assign(bias=frame["ours"] - frame["paper"]).to_dict("records")
    for row in records:
        row["paper_error"] = paper.monte_carlo_error(row["metric"], row["paper"])
        row[_JUDGED] = _interval_answer(row)
        row[_TOLERANCE] = _tolerance_answer(row)
    is_own = run.dataset == paper.DATASET
    identity = run.manifest["identity"]
    n_scenes = identity.get("scenes_utility", identity["scenes"])
    n_attacked = identity["scenes"]
    notes = [f"Missed rates rest on {n_scenes:,} scenes, the others on {n_attacked:,}."]
    if is_own:
        notes += _own_recording_notes(records)
    else:
        notes.append(
            f"The paper used {paper.DATASET}; ours are of {run.dataset}, so they need"
            " not agree."
        )
    columns = [
        *mechanism_columns(run.families),
        make.text_column("metric", lambda row: METRICS[row["metric"]].title),
        make.metric_column("paper", "paper"),
        make.metric_column("ours", "ours", "ci_low", "ci_high"),
        make.metric_column("ours - paper", "bias", sign="+"),
        make.metric_column("paper's own error", "paper_error"),
    ]
    if is_own:
        columns += [
            replace(make.decision_column(name), align="right")
            for name in (_JUDGED, _TOLERANCE)
        ]
    title = "The paper's numbers beside ours, privacy as shared; 95 % intervals"
    return make.build_table(
        "paper", title, records, columns, notes=notes, n_headings=2, n_keys=4
    )


def _interval_answer(row: Mapping[Any, Any]) -> str:
    """Return whether our interval holds the paper's number; empty if not judged."""
    is_judged = isinstance(row["within"], bool | np.bool_)
    if not (is_judged and np.isfinite(row["ci_low"])):
        return ""
    if paper.is_fitted(row):
        return "fitted"
    return "yes" if row["within"] else "no"


def _tolerance_answer(row: Mapping[Any, Any]) -> str:
    """Return whether our number is within the tolerance; empty where we have none."""
    if not np.isfinite(row["ours"]):
        return ""
    metric = row["metric"]
    allowed = paper.tolerance(row["mechanism"], metric, row["paper"])
    answer = "yes" if abs(row["bias"]) <= allowed + _ROUNDING else "no"
    return f"{answer} ({make.metric_cell(metric, allowed).text})"


def _own_recording_notes(records: Sequence[Mapping[Any, Any]]) -> list[str]:
    """Return how many numbers were fitted and agree, on the recording of the paper.

    `records` have the columns `paper_error` and whether they are within the tolerance.
    """
    linear = [row for row in records if "adding=" not in row["mechanism"]]
    seen = [row for row in linear if not paper.is_fitted(row)]
    missed_rates = [row for row in records if np.isfinite(row["paper_error"])]
    n_within = sum(row[_TOLERANCE].startswith("yes") for row in seen)
    far = [
        where_text(row["mechanism"], row["level"])
        for row in missed_rates
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
        f" (of {len(missed_rates)}, each by itself)."
    )
    return [fitted, error]


def claims_table(run: Results) -> Table:
    """Return the paper's claims, and whether they hold."""
    columns = [
        make.text_column("adding"),
        make.text_column("claim"),
        make.decision_column("answer"),
        Column("effect", effect),
        replace(make.text_column("evidence"), is_long=True),
    ]
    return make.build_table(
        "claims",
        "The paper's claims; 95 % intervals",
        run.claims.to_dict("records"),
        columns,
        notes=["Evidence: paper_claims.csv."],
        n_headings=1,
        n_keys=2,
    )


def frontier_table(run: Results) -> Table:
    """Return privacy and level where missed conflicts have risen by a target."""
    frontier = run.frontier
    is_shown = frontier["metric"].isin([PLR, ROBOT_PLR, RANK1, RANK1_AMONG_100])
    priced = usual_price(frontier[is_shown]) if len(frontier) else frontier
    records: dict[tuple[Any, ...], dict[str, Any]] = {}
    heads: dict[str, None] = {}  # A set that keeps its order.
    for row in row_dicts(priced):
        point = row["robot"], row["mechanism"], row["target"]
        record = records.setdefault(point, dict(row))
        head = _frontier_head(row)
        ends_of_heads = {head: VALUE}
        if head == f"{METRICS[PLR].head}, attacked":
            ends_of_heads[f"{head}, less white"] = VS_WHITE
        for name, ends in ends_of_heads.items():
            record[name] = make.number_cell(*(row[end] for end in ends), scale=PERCENT)
            heads[name] = None
    columns = [
        make.text_column("robot"),
        make.text_column(
            "mechanism", lambda row: find_family(run.families, row["mechanism"]).name
        ),
        make.text_column("adding"),
        make.share_column("rise", "target", unit="points", sign="+"),
        make.number_column("level", "", *LEVEL_READ, digits=2),
        *(replace(make.cell_column(head), unit="%") for head in heads),
        make.text_column(
            "beaten", lambda row: "yes" if row["dominated"] is True else ""
        ),
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
        *laplace_notes(frontier.round({"level": 2}), n_reports=run.n_reports),
    ]
    return make.build_table(
        "frontier", title, records.values(), columns, notes=notes, n_keys=4
    )


def _frontier_head(row: Mapping[str, Any]) -> str:
    """Return the head of the column in which a row of the frontier stands."""
    if row["metric"] == ROBOT_PLR:
        return METRICS[ROBOT_PLR].head
    reader = parse_consumer(row["consumer"], row["knowledge"])
    if reader == AS_SHARED:
        state = "shared"
    elif reader.adversary in HEADLINE:
        state = "attacked"
    else:
        state = f"after {reader.adversary}"
    return f"{reader.task or METRICS[row['metric']].head}, {state}"


def price_text(priced: pd.DataFrame) -> str:
    """Return a sentence on the missed conflicts that price the rows of a frontier."""
    if not (priced["criterion"] == FUTURE).any():
        return "The price: missed conflicts, at raw's false alarms."
    horizon_s = parse_dataset(str(priced["dataset"].iloc[0])).world.horizon_s
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
        make.text_column("flag", lambda row: row["kind"].replace("_", " ")),
        make.text_column(
            "attack", lambda row: parse_consumer(row["attack"], row["knowledge"]).label
        ),
        make.text_column(
            "beaten by",
            lambda row: parse_consumer(row["by"], row["by_knowledge"]).label,
        ),
        *mechanism_columns(run.families),
        make.share_column("PLR difference", *ends, unit="points", sign="+"),
    ]
    return make.build_table("flags", "All flags", row_dicts(texts), columns, n_keys=6)


def item_tables(items: Sequence[Mapping[str, Any]]) -> dict[str, Table]:
    """Return the items of the verdict, a table for each section."""
    own_sections = [str(item["section"]) for item in items]
    tables = {}
    for section in dict.fromkeys([*rules.SECTIONS, *own_sections]):
        records = [_item_record(item) for item in items if item["section"] == section]
        if records:
            tables[section] = _section_table(section, records)
    return tables


def _section_table(section: str, records: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of the items of a section of the verdict."""
    aspects = "mechanism", "descriptor", "task", "criterion", "about"
    keys = ["adding", *(key for key in aspects if any(row[key] for row in records))]
    columns = [
        make.decision_column("decision"),
        replace(make.text_column("what it says"), is_long=True),
        *map(make.text_column, keys),
        Column("effect", partial(effect, signed=True)),
        make.number_column("people", "", "n", digits=0),
    ]
    if all("power" in row for row in records):
        ends = ("prediction_error", "prediction_error_low", "prediction_error_high")
        columns += [
            Column("people that show an equal", _people_needed),
            make.text_column("evidence", lambda row: ", ".join(row["evidence"])),
            make.text_column("power to show", _power),
            make.share_column("prediction error", *ends, unit="points"),
        ]
    return make.build_table(
        f"verdict-{section}",
        section.capitalize(),
        records,
        columns,
        notes=_untestable(records),
        n_keys=1 + len(keys),
    )


def _untestable(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a note for each reason why items could not be tested, with these items."""
    reasons: dict[str, list[str]] = {}
    for row in records:
        if row["decision"] == rules.NOT_TESTABLE:
            about = " ".join(
                filter(None, (row[key] for key in ("task", "adding", "mechanism")))
            )
            reasons.setdefault(row["why"], []).append(about)
    return [
        f"Not testable, {len(names)} of {len(records)}"
        f" ({', '.join(dict.fromkeys(names))}): {why}."
        for why, names in reasons.items()
    ]


def _criterion_text(item: Mapping[str, Any]) -> str:
    horizon_s = item.get("horizon_s")
    text = CRITERIA.get(item["criterion"], item["criterion"])
    return text if horizon_s is None else f"{text}, {horizon_s:g} s ahead"


def _people_needed(row: Mapping[str, Any]) -> Cell:
    """Return how many people would show that linkage is equal, if so many can exist."""
    needed = row["n_needed"]
    if needed is not None and not is_realistic(needed):
        return make.text_cell("no realistic number")
    return make.number_cell(needed, digits=0)


def _power(item: Mapping[str, Any]) -> str:
    power = item["power"]
    return (
        f"equal {whole_percent(power[rules.TRACKS])}, 10 points"
        f" {whole_percent(power[rules.DOES_NOT])}"
    )


def _item_record(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return an item as a record of its table, with what it says in one text."""
    descriptor, is_claim = item["descriptor"], item["section"] == rules.CLAIM
    text = item["sentence"]
    if item["why"] not in text:
        text += f" {item['decision'].capitalize()}: {item['why'].rstrip('.')}."
    mechanism = item.get("mechanism", "fid") if is_claim else item.get("of", "")
    return {
        **item,
        "mechanism": mechanism,
        "about": item["subject"] or ("as shared" if is_claim else ""),
        "what it says": text,
        "descriptor": METRICS[descriptor].head if descriptor in METRICS else descriptor,
        "criterion": _criterion_text(item),
    }
