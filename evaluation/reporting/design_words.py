"""The answer of `evaluation.design`: words, a table, JSON."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from evaluation.estimates.levels import COLUMNS
from evaluation.estimates.metrics import (
    EXPOSURE,
    MEDIAN,
    METRICS,
    MISSED_RATE,
    SUCCESS,
    WIDE,
)
from evaluation.reporting import recommendation as words
from evaluation.reporting import table as make
from evaluation.reporting import terminal
from evaluation.reporting.amounts import percent_cell, sentence_case
from evaluation.reporting.announcements import scenes_text, wrapped
from evaluation.reporting.grid import Group, grid_lines
from evaluation.reporting.names import (
    INDEPENDENT_MARK,
    adding_phrase,
    mechanism_name,
    short_mechanism_name,
)
from evaluation.reporting.noise_plan import plan_lines
from evaluation.reporting.notices import few_people
from evaluation.reporting.table import Cell, Column, Table, shortened
from evaluation.reporting.terminal import Part
from evaluation.store.files import made_of
from evaluation.store.manifest import read_manifest
from evaluation.verdict.what_to_share import (
    LIMITS,
    MISSED,
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
from isac_track.privacy import WIDE_TIMES

_NUMBERS: Final = (EXPOSURE, WIDE, MEDIAN, "ael", "mel")
_LINES: Final = 12  # Of the short answer.
_HEADS, _LEAST_ROWS = 2, 2  # Of its table, in lines.
_NAME_WIDTH: Final = 28  # Characters of a level in it.
_ENDS: Final = ("value", "ci_low", "ci_high")


@dataclass(frozen=True, slots=True)
class Answer:
    """What `design` answers about a run."""

    out: Path
    manifest: Mapping[str, Any]
    recommendation: Recommendation


def answer_of(out: Path, question: Question) -> Answer:
    """Return the answer of a run to a question.

    Raises DataError if there is no run, or a file of it is missing or broken, and
    SettingsError if it lacks a mechanism, a robot or a family that the question is
    about.
    """
    manifest = read_manifest(out)
    table = made_of(out, "levels.csv", columns=COLUMNS)
    identity, dataset = manifest["identity"], manifest["dataset"]["name"]
    scenes = identity["scenes"], identity.get("scenes_utility", identity["scenes"])
    advice = recommend(table, question, dataset=dataset, scenes=scenes)
    if not (advice.proposals or advice.refused):
        raise SettingsError(
            f"{out} has no level that claims to protect and adds noise by the rule "
            f"{' or '.join(question.adding)}; run it again with --mechanism "
            f"fid:1..1000/10,adding={question.adding[0]}"
        )
    return Answer(out, manifest, advice)


def to_json(answer: Answer) -> dict[str, Any]:
    """Return the answer as plain values; what is unknown is None."""
    advice, manifest = answer.recommendation, answer.manifest
    identity, dataset, question = (
        manifest["identity"],
        manifest["dataset"],
        advice.question,
    )
    limits = {name: question.limits.get(name) for name in LIMITS}
    return {
        "met": advice.met,
        "answer": words.answer_text(
            advice, simulated=dataset["simulated"], epsilon_m=words.epsilon_m(manifest)
        ),
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
        "raw": _offer(advice.raw, answer) if advice.raw else None,
        "proposals": [_offer(offer, answer) for offer in advice.proposals],
        "nearest": _offer(advice.nearest, answer) if advice.nearest else None,
        "refused": [_offer(offer, answer) for offer in _nearest_levels(advice.refused)],
        "notes": notes(answer),
    }


def _offer(offer: Offer, answer: Answer) -> dict[str, Any]:
    """Return a level as plain values."""
    advice = answer.recommendation
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
            _side(side, limit=advice.question.limits.get(EXPOSURE))
            for side in offer.beyond
        ],
        "linked": _linked(offer.linked) if offer.linked else None,
        "tasks": [_linked(task) for task in offer.tasks],
        "checks": [_check(check, answer) for check in offer.checks],
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


def _check(check: Check, answer: Answer) -> dict[str, Any]:
    epsilon = words.epsilon_m(answer.manifest)
    return {
        "name": check.name,
        "adversary": check.adversary or None,
        "limit": _finite(check.limit),
        "measured": _number(check.measured),
        "status": check.status,
        "reason": words.reason(check, answer.recommendation, epsilon_m=epsilon),
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
    """Return what else a reader must know of the run and of the question."""
    advice, dataset = answer.recommendation, answer.manifest["dataset"]
    epsilon = words.epsilon_m(answer.manifest)
    texts = (
        [dataset["notice"] or "The people are simulated."]
        if dataset["simulated"]
        else []
    )
    if few := few_people(dataset):
        texts.append(few)
    raw = advice.raw.checks if advice.raw else ()
    missed = [check for check in raw if check.name in (MISSED, "false_alarm")]
    reasons = [
        words.reason(check, advice, epsilon_m=epsilon)
        for check in missed
        if check.status == "not met"
    ]
    if reasons:
        texts.append(
            f"Raw positions exceed the limit themselves: {'; '.join(reasons)}. No level"
            " can be expected to keep within it."
        )
    texts += _closed_form_notes(answer)
    texts += [
        f"{sentence_case(words.level_name(offer))} keeps within the limits, but no"
        f" level of its mechanism does with {adding_phrase(offer.lacks_rule)}: --adding"
        " leaves that rule out."
        for offer in [offer for offer in advice.refused if offer.lacks_rule][:1]
    ]
    return texts


def _closed_form_notes(answer: Answer) -> list[str]:
    """Return which noise the closed forms alone would have named, without a run."""
    question = answer.recommendation.question
    limit = question.limits.get(EXPOSURE, 0.0)
    if not 0.0 < limit < 1.0 or question.as_shared:
        return []
    epsilon_m = words.epsilon_m(answer.manifest)
    dt_s = float(answer.manifest["history"]["interval_s"])
    lines = plan_lines(plr=limit, epsilon_m=epsilon_m, q=steady.Q_M2_PER_S3, dt_s=dt_s)
    both = " ".join(line.strip() for line in lines[:2])
    return [f"Closed forms alone, without a run: {both}"]


def show(
    answer: Answer, *, verbose: bool = False, console: Console | None = None
) -> None:
    """Print the answer and the nearest levels in a few lines, or all that is behind it."""
    console = console or terminal.standard_output()
    parts = _whole(answer) if verbose else _brief(answer, width=console.width)
    _print(parts, console)


def _brief(answer: Answer, *, width: int) -> list[Part]:
    """Return the answer and its levels in at most `_LINES` lines."""
    advice, manifest = answer.recommendation, answer.manifest
    epsilon, dataset = words.epsilon_m(manifest), manifest["dataset"]
    text = words.answer_text(
        advice, simulated=dataset["simulated"], epsilon_m=epsilon, most_failures=1
    )
    said = wrapped(text, width=width, indent="")
    few = [f"Doubt: {few_people(dataset)}"] if few_people(dataset) else []
    untried = words.untried_text(advice)
    last = [*few, f"{untried}All reasons: --verbose."]
    rows = _shown_levels(advice)
    room = _LINES - len(said) - len(last) - _HEADS
    grid = _level_lines(rows[: max(_LEAST_ROWS, room)], advice, epsilon_m=epsilon)
    return [*((line, "bold") for line in said), *grid, *last]


def _shown_levels(advice: Recommendation) -> list[Offer]:
    """Return raw, the levels that are proposed, and the nearest of every other mechanism."""
    named = [*filter(None, [advice.raw]), *advice.proposals, *advice.unsettled]
    return named + [
        offer for offer in _nearest_levels(advice.refused) if offer not in named
    ]


def _level_lines(
    offers: Sequence[Offer], advice: Recommendation, *, epsilon_m: float
) -> list[str]:
    """Return the levels in lines: cost, what an attack knows, and what it re-identifies."""
    wide_m = WIDE_TIMES * epsilon_m
    rows = []
    for offer in offers:
        side = _limited_side(offer, advice)
        linked = offer.linked.share if offer.linked else None
        numbers = [offer.cost, side.value(EXPOSURE), side.value(WIDE), linked]
        name = short_mechanism_name(offer.family, offer.where[1])
        rows.append([shortened(name, room=_NAME_WIDTH), *map(percent_cell, numbers)])
    how = "as sent" if advice.question.as_shared else "attacked"
    groups = [
        Group("misses at raw's", ("false alarms, %",)),
        Group(f"known {how}, %", (f"to {epsilon_m:.4g} m", f"to {wide_m:.4g} m")),
        Group("re-identified", ("% of raw",)),
    ]
    is_marked = any(row[0].endswith(INDEPENDENT_MARK) for row in rows)
    corner = (
        f"shared ({INDEPENDENT_MARK.strip()} independent)"
        if is_marked
        else "what is shared"
    )
    return grid_lines(rows, groups, corner=("± half of a 95 % interval", corner))


def _limited_side(offer: Offer, advice: Recommendation) -> Attacked:
    """Return the positions that limits are about: as sent, or after the strongest attack."""
    if advice.question.as_shared or offer.attacked.source is None:
        return offer.shared
    return offer.attacked


def _whole(answer: Answer) -> list[Part]:
    """Return the answer, the levels with intervals, why the others fail, and notes."""
    advice, manifest = answer.recommendation, answer.manifest
    epsilon, identity = words.epsilon_m(manifest), manifest["identity"]
    conflicts = words.conflicts_text(advice.question.criterion)
    about = (
        f"{manifest['dataset']['name']}: {scenes_text(identity)}, seed"
        f" {identity['seed']}. Robot: {robot_text(advice)}; {conflicts}, at the false"
        " alarms of raw positions. A limit holds if the upper end of the 95 % interval"
        " does."
    )
    text = words.answer_text(
        advice, simulated=manifest["dataset"]["simulated"], epsilon_m=epsilon
    )
    parts: list[Part] = [(text, "bold"), "", about]
    parts += [answer_table(advice), ""]
    shown = advice.proposals or advice.unsettled or advice.refused[:1]
    parts += [
        f"- {words.offer_text(offer, advice, epsilon_m=epsilon)}" for offer in shown
    ]
    refused = [offer for offer in _nearest_levels(advice.refused) if offer not in shown]
    if refused:
        parts += ["", "The other mechanisms, each at its nearest level:"]
    for offer in refused:
        failures = "; ".join(words.failures(offer, advice, epsilon_m=epsilon))
        parts.append(f"- {sentence_case(words.level_name(offer))}: {failures}.")
    if remarks := [f"Note: {note}" for note in notes(answer)]:
        parts += ["", *remarks]
    return parts


def _print(parts: Iterable[Part], console: Console) -> None:
    for part in parts:
        if isinstance(part, Table):
            terminal.show([part], console=console)
            continue
        text, style = (part, "") if isinstance(part, str) else part
        # The further lines of an item stand below its first word.
        below = "  " if text.startswith("- ") else ""
        width = console.width
        lines = [text]
        if len(text) > width:
            lines = wrapped(text, width=width, indent=below)
        terminal.show([(line, style) for line in lines or [""]], console=console)


def robot_text(advice: Recommendation) -> str:
    """Return whose misses count, and how the robot was chosen."""
    robot = words.chosen_robot(advice)
    if advice.question.robot or not robot:
        return robot or "none"
    return f"{robot}, chosen on one half of the people and judged on the other"


def answer_table(advice: Recommendation) -> Table:
    """Return raw, the levels that are proposed, and the nearest of every other mechanism."""
    columns = [
        make.said(
            "what is shared", lambda offer: mechanism_name(offer.family, offer.where[1])
        ),
        Column(
            "missed",
            lambda offer: make.estimated(MISSED_RATE, offer.cost),
            "%",
            above="at raw's alarms",
        ),
        Column(
            "known", partial(_left, EXPOSURE), METRICS[EXPOSURE].unit, above="attacked"
        ),
        Column("at 4/3", partial(_left, WIDE), METRICS[WIDE].unit),
        Column("error", partial(_left, MEDIAN), METRICS[MEDIAN].unit, above="median"),
        Column("of raw", partial(_link, "share"), "%", above="re-identified"),
    ]
    return make.built("levels", "Proposed, or nearest", _shown_levels(advice), columns)


def _left(metric: str, offer: Offer) -> Cell:
    side = offer.attacked if offer.attacked.source else offer.shared
    return make.estimated(metric, side.value(metric))


def _link(name: str, offer: Offer) -> Cell:
    if offer.linked is None:
        return Cell()
    return make.estimated(SUCCESS, getattr(offer.linked, name))
