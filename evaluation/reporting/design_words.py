"""The answer of `evaluation.design`: words, a table, JSON."""

import math
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from evaluation.analysis.families import LEVEL_UNITS
from evaluation.analysis.levels import COLUMNS
from evaluation.analysis.metrics import EXPOSURE, MEDIAN, METRICS, MISSED_RATE, SUCCESS, WIDE
from evaluation.reporting import recommendation as words
from evaluation.reporting import table as make
from evaluation.reporting import terminal
from evaluation.reporting.announcements import scenes_text
from evaluation.reporting.noise_plan import told
from evaluation.reporting.table import Cell, Column, Table
from evaluation.runs.files import made_of
from evaluation.runs.manifest import read_manifest
from evaluation.verdict.what_to_share import (
    LIMITS,
    Attacked,
    Check,
    Linked,
    Offer,
    Question,
    Recommendation,
    recommend,
)
from isac_track.errors import SettingsError
from isac_track.intervals import Estimate
from isac_track.kalman import steady

_NUMBERS: Final = (EXPOSURE, WIDE, MEDIAN, "ael", "mel")
_ENDS: Final = ("value", "ci_low", "ci_high")


@dataclass(frozen=True, slots=True)
class Answer:
    """What `design` answers about a run."""

    out: Path
    manifest: Mapping[str, Any]
    recommendation: Recommendation


def answer_of(out: Path, question: Question) -> Answer:
    """Return the answer of a run to a question.

    Raises DataError if there is no run, or a file of it is missing or broken, and SettingsError if
    it lacks a mechanism, a robot or a family that the question is about.
    """
    manifest = read_manifest(out)
    table = made_of(out, "levels.csv", columns=COLUMNS)
    identity, dataset = manifest["identity"], manifest["dataset"]["name"]
    scenes = identity["scenes"], identity.get("scenes_utility", identity["scenes"])
    advice = recommend(table, question, dataset=dataset, scenes=scenes)
    if not (advice.proposals or advice.refused):
        raise SettingsError(
            f"{out} has no level that claims to protect, with {' or '.join(question.adding)} "
            "adding; add some with the command of the run and --mechanism "
            f"fid:1..1000/10,adding={question.adding[0]}"
        )
    return Answer(out, manifest, advice)


def to_json(answer: Answer) -> dict[str, Any]:
    """Return the answer as plain values; what is unknown is None."""
    advice, manifest = answer.recommendation, answer.manifest
    identity, dataset, question = manifest["identity"], manifest["dataset"], advice.question
    limits = {name: question.limits.get(name) for name in LIMITS}
    return {
        "met": advice.met,
        "answer": words.sentence(advice, simulated=dataset["simulated"]),
        "out": str(answer.out),
        "dataset": dataset["name"],
        "simulated": bool(dataset["simulated"]),
        "scenes": identity["scenes"],
        "seed": identity["seed"],
        "predictor": advice.robot or None,
        "predictor_by_half": [*advice.robots] if not question.robot else None,
        "criterion": question.criterion.conflicts,
        "horizon_s": question.criterion.horizon_s,
        "adding": list(question.adding),
        "against": ["blind", "informed", *question.against],
        "limits": limits | {"as_shared": question.as_shared},
        "not_answerable": list(advice.missing),
        "raw": _offer(advice.raw, advice) if advice.raw else None,
        "proposals": [_offer(offer, advice) for offer in advice.proposals],
        "nearest": _offer(advice.nearest, advice) if advice.nearest else None,
        "refused": [_offer(offer, advice) for offer in _nearest_levels(advice.refused)],
        "notes": notes(answer),
    }


def _offer(offer: Offer, advice: Recommendation) -> dict[str, Any]:
    """Return a level as plain values."""
    mechanism, level = offer.where
    return {
        "mechanism": mechanism,
        "level": level,
        "family": offer.family.name,
        "adding": offer.family.adding,
        "met": offer.met and not offer.lacks_rule,
        "missed": _number(offer.cost),
        "robots": {name: _number(rate) for name, rate in offer.robots.items()},
        "shared": _side(offer.shared),
        "after_attack": _side(offer.attacked),
        "beyond": [
            _side(side, limit=advice.question.limits.get(EXPOSURE)) for side in offer.beyond
        ],
        "linked": _linked(offer.linked) if offer.linked else None,
        "tasks": [_linked(task) for task in offer.tasks],
        "checks": [_check(check, advice) for check in offer.checks],
    }


def _side(side: Attacked, limit: float | None = None) -> dict[str, Any]:
    about: dict[str, Any] = {
        "adversary": side.adversary or None,
        "attack": side.source.consumer if side.source else None,
        "knowledge": side.source.knowledge if side.source else None,
    }
    if limit is not None:
        about["breaks"] = side.breaks(limit)
    return about | {name: _number(side.value(name)) for name in _NUMBERS}


def _linked(linked: Linked) -> dict[str, Any]:
    return {
        "task": linked.task,
        "attack": linked.source.attack.consumer if linked.source else None,
        "knowledge": linked.source.knowledge if linked.source else None,
        "metric": linked.metric,
        "rank1": _number(linked.rank1),
        "chance": _finite(linked.chance),
        "share_of_raw": _number(linked.share),
    }


def _check(check: Check, advice: Recommendation) -> dict[str, Any]:
    return {
        "name": check.name,
        "adversary": check.adversary or None,
        "limit": _finite(check.limit),
        "measured": _number(check.measured),
        "status": check.status,
        "reason": words.reason(check, advice),
    }


def _number(number: Estimate) -> dict[str, float | None]:
    return {name: _finite(getattr(number, name)) for name in _ENDS}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _nearest_levels(offers: Iterable[Offer]) -> list[Offer]:
    """Return of every mechanism the level that comes nearest."""
    nearest: dict[str, Offer] = {}
    for offer in offers:
        nearest.setdefault(offer.where[0], offer)
    return list(nearest.values())


def notes(answer: Answer) -> list[str]:
    """Return what else is to be known of the run and of the question."""
    advice, limits = answer.recommendation, answer.recommendation.question.limits
    limit, closed = limits.get(EXPOSURE, 0.0), list[str]()
    if 0.0 < limit < 1.0 and not advice.question.as_shared:
        epsilon_m = words.epsilon_m(answer.manifest)
        dt_s = float(answer.manifest["history"]["interval_s"])
        closed = told(plr=limit, epsilon_m=epsilon_m, q=steady.Q_M2_PER_S3, dt_s=dt_s)[:2]
    raw = advice.raw.checks if advice.raw else ()
    missed = [check for check in raw if check.name in ("missed", "false_alarm")]
    raw_misses = [words.reason(check, advice) for check in missed if check.status == "not met"]
    lacks = [
        (words.level_name(offer), offer.lacks_rule) for offer in advice.refused if offer.lacks_rule
    ]
    return words.said(
        "notes",
        dataset=answer.manifest["dataset"],
        raw_misses="; ".join(raw_misses),
        closed=" ".join(closed),
        lacks=lacks[:1],
    )


def show(answer: Answer, *, console: Console | None = None) -> None:
    """Print the answer in one sentence, the levels behind it, and why not others."""
    console, advice = console or terminal.standard_output(), answer.recommendation
    identity, epsilon = answer.manifest["identity"], words.epsilon_m(answer.manifest)
    about = (
        f"{answer.manifest['dataset']['name']}: {scenes_text(identity)}, seed {identity['seed']}; "
        f"robot {robot_text(advice)}; 95 % intervals, whose upper ends must meet the limits"
    )
    units = ", ".join(f"{family} {unit}" for family, unit in LEVEL_UNITS.items())
    parts: list[str | tuple[str, str] | Table] = [
        (words.sentence(advice, simulated=answer.manifest["dataset"]["simulated"]), "bold"),
        "",
        f"{about} (level: {units})",
        answer_table(advice),
        "",
    ]
    shown = advice.proposals or advice.unsettled or advice.refused[:1]
    parts += [f"- {words.offer_text(offer, advice, epsilon)}" for offer in shown]
    refused = [offer for offer in _nearest_levels(advice.refused) if offer not in shown]
    if refused:
        parts += ["", "What others fail, at the level of each that comes nearest:"]
    for offer in refused:
        failures = "; ".join(words.failures(offer, advice))
        parts.append(f"- {words.level_name(offer)}: {failures}")
    remarks = [f"NOTICE: {note}" for note in notes(answer)]
    if remarks:
        parts += ["", *remarks]
    _print(parts, console)


def _print(parts: Iterable[str | tuple[str, str] | Table], console: Console) -> None:
    for part in parts:
        if isinstance(part, Table):
            terminal.show([part], console=console)
            continue
        text, style = (part, "") if isinstance(part, str) else part
        # The further lines of an item stand below its first word.
        below = "  " if text.startswith("- ") else ""
        width = console.width
        lines = textwrap.wrap(text, width, break_on_hyphens=False, subsequent_indent=below)
        terminal.show([(line, style) for line in lines or [""]], console=console)


def robot_text(advice: Recommendation) -> str:
    """Return whose misses count, and how the robot was chosen."""
    if not advice.robots or advice.question.robot:
        return advice.robot or "none"
    first, second = advice.robots
    if first == second:
        return f"{first} (chosen by either half of the people, scored on the other)"
    return f"{first} and {second} (each chosen by a half of the people, scored on the other)"


def answer_table(advice: Recommendation) -> Table:
    """Return raw, the levels that are proposed, and the nearest of every other mechanism."""
    named = [*filter(None, [advice.raw]), *advice.proposals, *advice.unsettled]
    rows = named + [offer for offer in _nearest_levels(advice.refused) if offer not in named]
    columns = [
        make.said("", words.level_name),
        Column("missed", lambda offer: make.estimated(MISSED_RATE, offer.cost), "%"),
        Column("PLR", partial(_left, EXPOSURE), METRICS[EXPOSURE].unit, above="attacked"),
        Column("at 4/3", partial(_left, WIDE), METRICS[WIDE].unit),
        Column("error", partial(_left, MEDIAN), METRICS[MEDIAN].unit, above="median"),
        Column("of raw's", partial(_link, "share"), "%", above="linked"),
    ]
    return make.built("levels", "Proposed, or nearest", rows, columns)


def _left(metric: str, offer: Offer) -> Cell:
    side = offer.attacked if offer.attacked.source else offer.shared
    return make.estimated(metric, side.value(metric))


def _link(name: str, offer: Offer) -> Cell:
    if offer.linked is None:
        return Cell()
    return make.estimated(SUCCESS, getattr(offer.linked, name))
