"""The answer of `evaluation.design` in words, as a table and as JSON."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from evaluation.estimates.families import entry_families
from evaluation.estimates.levels import COLUMNS
from evaluation.estimates.metrics import (
    MEDIAN_ERROR,
    METRICS,
    MISSED_RATE,
    PLR,
    PLR_WIDE,
    RANK1,
)
from evaluation.reporting import recommendation as words
from evaluation.reporting import table as make
from evaluation.reporting import terminal
from evaluation.reporting.amounts import percent_cell, sentence_case
from evaluation.reporting.announcements import scenes_text, wrap_lines
from evaluation.reporting.grid import Group, grid_lines
from evaluation.reporting.names import (
    INDEPENDENT_MARK,
    adding_phrase,
    mechanism_name,
    short_mechanism_name,
)
from evaluation.reporting.noise_plan import short_lines
from evaluation.reporting.notices import few_people
from evaluation.reporting.patrol_advice import (
    PatrolAnswer,
    answer_on_patrol,
    patrol_table,
)
from evaluation.reporting.table import Cell, Column, Table, shorten_name
from evaluation.reporting.terminal import Part
from evaluation.store.csv_files import read_report_file
from evaluation.store.manifest import read_manifest
from evaluation.verdict.level_checks import scene_counts
from evaluation.verdict.offers import AttackNumbers, Check, Offer, TaskLinkage
from evaluation.verdict.patrol_records import USUAL_LIMITS, PatrolLimits
from evaluation.verdict.question import LIMITS, MISSED, Question
from evaluation.verdict.what_to_share import Recommendation, recommend
from isac_track.errors import SettingsError
from isac_track.intervals import Estimate
from isac_track.kalman import steady
from isac_track.privacy import WIDE_TIMES

_NUMBERS: Final = (PLR, PLR_WIDE, MEDIAN_ERROR, "ael", "mel")
_LINES: Final = 12  # Lines of the short answer, at most.
_HEADS: Final = 2  # Lines above the rows of its table.
_LEAST_ROWS: Final = 2  # Rows of its table, at least.
_NAME_WIDTH: Final = 28  # Characters of the name of a level in it.
_ENDS: Final = ("value", "ci_low", "ci_high")


@dataclass(frozen=True, slots=True)
class DesignAnswer:
    """The answer of `design` about a run."""

    out: Path
    manifest: Mapping[str, Any]
    recommendation: Recommendation
    on_patrol: PatrolAnswer

    @property
    def met(self) -> bool:
        """Whether some level keeps within all limits, and some policy where asked."""
        is_patrol_met = self.on_patrol.met or not self.on_patrol.is_asked
        return self.recommendation.met and is_patrol_met


def answer_question(
    out: Path, question: Question, *, limits: PatrolLimits = USUAL_LIMITS
) -> DesignAnswer:
    """Return the answer of a run to a question; `limits` are those on patrols.

    Raises DataError if there is no run, or a file of it is missing or broken. Raises
    SettingsError if the run lacks a mechanism, a robot or a family of the question.
    """
    manifest = read_manifest(out)
    table = read_report_file(out, "levels.csv", columns=COLUMNS)
    dataset = manifest["dataset"]["name"]
    advice = recommend(table, question, dataset=dataset, scenes=scene_counts(manifest))
    on_patrol = answer_on_patrol(
        read_report_file(out, "verdict.json").get("patrols", {}),
        limits,
        robot=question.robot,
        horizon_s=question.criterion.horizon_s,
        families=entry_families(manifest["cells"]),
    )
    if not (advice.proposals or advice.refused or on_patrol.proposal):
        raise SettingsError(
            f"{out} has no level that claims to protect and adds noise by the rule "
            f"{' or '.join(question.adding)}; run it again with --mechanism "
            f"fid:1..1000/10,adding={question.adding[0]}"
        )
    return DesignAnswer(out, manifest, advice, on_patrol)


def to_json(answer: DesignAnswer) -> dict[str, Any]:
    """Return the answer as plain values; an unknown value is None."""
    advice, manifest = answer.recommendation, answer.manifest
    identity, dataset = manifest["identity"], manifest["dataset"]
    question = advice.question
    limits = {name: question.limits.get(name) for name in LIMITS}
    text = words.answer_text(
        advice, simulated=dataset["simulated"], epsilon_m=words.epsilon_m(manifest)
    )
    return {
        "met": answer.met,
        "answer": text,
        "out": str(answer.out),
        "dataset": dataset["name"],
        "simulated": bool(dataset["simulated"]),
        "scenes": identity["scenes"],
        "seed": identity["seed"],
        "predictor": advice.robot or None,
        "predictor_by_half": None if question.robot else list(advice.robots),
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
        "patrols": answer.on_patrol.to_json(),
    }


def _offer(offer: Offer, answer: DesignAnswer) -> dict[str, Any]:
    """Return a level as plain values."""
    advice = answer.recommendation
    mechanism, level = offer.mechanism_level
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
            _side(side, limit=advice.question.limits.get(PLR)) for side in offer.beyond
        ],
        "linked": _linked(offer.linked) if offer.linked else None,
        "tasks": [_linked(task) for task in offer.tasks],
        "checks": [_check(check, answer) for check in offer.checks],
    }


def _side(side: AttackNumbers, limit: float | None = None) -> dict[str, Any]:
    """Return the positions that an adversary knows as plain values."""
    values: dict[str, Any] = {
        "adversary": side.adversary or None,
        "attack": side.reader.consumer if side.reader else None,
        "knowledge": side.reader.adversary if side.reader else None,
    }
    if limit is not None:
        values["breaks"] = side.breaks(limit)
    return values | {name: _number(side.value(name)) for name in _NUMBERS}


def _linked(linked: TaskLinkage) -> dict[str, Any]:
    """Return the linkage of a task as plain values."""
    return {
        "task": linked.task,
        "attack": linked.reader.attack_spec if linked.reader else None,
        "knowledge": linked.reader.adversary if linked.reader else None,
        "metric": linked.metric,
        "rank1": _number(linked.rank1),
        "chance": _finite(linked.chance),
        "share_of_raw": _number(linked.share),
    }


def _check(check: Check, answer: DesignAnswer) -> dict[str, Any]:
    """Return the check of a limit as plain values."""
    epsilon = words.epsilon_m(answer.manifest)
    return {
        "name": check.name,
        "adversary": check.adversary or None,
        "limit": _finite(check.limit),
        "measured": _number(check.measured),
        "status": check.status,
        "reason": words.reason(check, answer.recommendation, epsilon_m=epsilon),
    }


def _number(estimate: Estimate) -> dict[str, float | None]:
    """Return an estimate as plain values."""
    return {name: _finite(getattr(estimate, name)) for name in _ENDS}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _nearest_levels(offers: Iterable[Offer]) -> list[Offer]:
    """Return the nearest level of every mechanism."""
    nearest: dict[str, Offer] = {}
    for offer in offers:
        nearest.setdefault(offer.mechanism_level.mechanism, offer)
    return list(nearest.values())


def notes(answer: DesignAnswer) -> list[str]:
    """Return further texts that a reader must know about the run and the question."""
    advice, dataset = answer.recommendation, answer.manifest["dataset"]
    epsilon = words.epsilon_m(answer.manifest)
    texts: list[str] = []
    if dataset["simulated"]:
        texts.append(dataset["notice"] or "The people are simulated.")
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
    if split := [offer for offer in advice.refused if offer.lacks_rule]:
        offer = split[0]
        texts.append(
            f"{sentence_case(words.offer_name(offer))} keeps within the limits, but no"
            f" level of its mechanism does with {adding_phrase(offer.lacks_rule)}:"
            " --adding leaves that rule out."
        )
    return texts


def _closed_form_notes(answer: DesignAnswer) -> list[str]:
    """Return the noise that the closed forms name, which need no run."""
    question = answer.recommendation.question
    limit = question.limits.get(PLR, 0.0)
    if not 0.0 < limit < 1.0 or question.as_shared:
        return []
    epsilon_m = words.epsilon_m(answer.manifest)
    dt_s = float(answer.manifest["history"]["interval_s"])
    lines = short_lines(plr=limit, epsilon_m=epsilon_m, q=steady.Q_M2_PER_S3, dt_s=dt_s)
    text = " ".join(line.strip() for line in lines)
    return [f"Closed forms alone, without a run: {text}"]


def show(
    answer: DesignAnswer, *, verbose: bool = False, console: Console | None = None
) -> None:
    """Print the answer and the nearest levels in a few lines, or with all details."""
    console = console or terminal.standard_output()
    width = console.width
    parts = _full_parts(answer) if verbose else _short_parts(answer, width=width)
    _print(parts, console)


def _short_parts(answer: DesignAnswer, *, width: int) -> list[Part]:
    """Return the answer and its levels in at most `_LINES` lines."""
    advice, manifest = answer.recommendation, answer.manifest
    epsilon, dataset = words.epsilon_m(manifest), manifest["dataset"]
    text = words.answer_text(
        advice, simulated=dataset["simulated"], epsilon_m=epsilon, most_failures=1
    )
    first = wrap_lines(text, width=width, indent="")
    doubt = few_people(dataset)
    last = wrap_lines(answer.on_patrol.text, width=width)
    last += [f"Doubt: {doubt}"] if doubt else []
    last.append(f"{words.untried_text(advice)}All reasons: --verbose.")
    n_rows = max(_LEAST_ROWS, _LINES - len(first) - len(last) - _HEADS)
    grid = _level_lines(_shown_levels(advice)[:n_rows], advice, epsilon_m=epsilon)
    return [*((line, "bold") for line in first), *grid, *last]


def _shown_levels(advice: Recommendation) -> list[Offer]:
    """Return raw, the proposed levels, and the nearest of every other mechanism."""
    raw = [advice.raw] if advice.raw else []
    named = [*raw, *advice.proposals, *advice.unsettled]
    nearest = _nearest_levels(advice.refused)
    return named + [offer for offer in nearest if offer not in named]


def _level_lines(
    offers: Sequence[Offer], advice: Recommendation, *, epsilon_m: float
) -> list[str]:
    """Return the levels in lines: cost, known positions, and re-identified people."""
    wide_m = WIDE_TIMES * epsilon_m
    rows = []
    for offer in offers:
        side = _limited_side(offer, advice)
        linked = offer.linked.share if offer.linked else None
        numbers = [offer.cost, side.value(PLR), side.value(PLR_WIDE), linked]
        name = short_mechanism_name(offer.family, offer.mechanism_level.level)
        rows.append([shorten_name(name, room=_NAME_WIDTH), *map(percent_cell, numbers)])
    how = "as sent" if advice.question.as_shared else "attacked"
    groups = [
        Group("misses at raw's", ("false alarms, %",)),
        Group(f"known {how}, %", (f"to {epsilon_m:.4g} m", f"to {wide_m:.4g} m")),
        Group("re-identified", ("% of raw",)),
    ]
    corner = "what is shared"
    if any(row[0].endswith(INDEPENDENT_MARK) for row in rows):
        corner = f"shared ({INDEPENDENT_MARK.strip()} independent)"
    return grid_lines(rows, groups, corner=("± half of a 95 % interval", corner))


def _limited_side(offer: Offer, advice: Recommendation) -> AttackNumbers:
    """Return the positions under limits: as sent, or after the strongest attack."""
    if advice.question.as_shared or offer.attacked.reader is None:
        return offer.shared
    return offer.attacked


def _full_parts(answer: DesignAnswer) -> list[Part]:
    """Return the answer, the levels with intervals, the failures, and notes."""
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
        parts.append(f"- {sentence_case(words.offer_name(offer))}: {failures}.")
    parts += ["", answer.on_patrol.text]
    if options := answer.on_patrol.options:
        parts += [patrol_table(options, entry_families(manifest["cells"]))]
    if remarks := [f"Note: {note}" for note in notes(answer)]:
        parts += ["", *remarks]
    return parts


def _print(parts: Iterable[Part], console: Console) -> None:
    """Print parts, wrapped to the width of the console."""
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
            lines = wrap_lines(text, width=width, indent=below)
        terminal.show([(line, style) for line in lines or [""]], console=console)


def robot_text(advice: Recommendation) -> str:
    """Return the robot whose misses count, and how it was chosen."""
    robot = words.chosen_robot(advice)
    if advice.question.robot or not robot:
        return robot or "none"
    return f"{robot}, chosen on one half of the people and judged on the other"


def answer_table(advice: Recommendation) -> Table:
    """Return the table of raw, the proposed levels, and the nearest of the others."""
    columns = [
        make.text_column(
            "what is shared",
            lambda offer: mechanism_name(offer.family, offer.mechanism_level.level),
        ),
        Column(
            "missed",
            lambda offer: make.estimate_cell(MISSED_RATE, offer.cost),
            "%",
            above="at raw's alarms",
        ),
        Column(
            "known",
            partial(_position_cell, PLR),
            METRICS[PLR].unit,
            above="attacked",
        ),
        Column("at 4/3", partial(_position_cell, PLR_WIDE), METRICS[PLR_WIDE].unit),
        Column(
            "error",
            partial(_position_cell, MEDIAN_ERROR),
            METRICS[MEDIAN_ERROR].unit,
            above="median",
        ),
        Column("of raw", partial(_linkage_cell, "share"), "%", above="re-identified"),
    ]
    return make.build_table(
        "levels", "Proposed, or nearest", _shown_levels(advice), columns
    )


def _position_cell(metric: str, offer: Offer) -> Cell:
    """Return a number of the positions after the attack, or as sent without any."""
    side = offer.attacked if offer.attacked.reader else offer.shared
    return make.estimate_cell(metric, side.value(metric))


def _linkage_cell(name: str, offer: Offer) -> Cell:
    """Return a number of the linkage of a level; an empty cell without any."""
    if offer.linked is None:
        return Cell()
    return make.estimate_cell(RANK1, getattr(offer.linked, name))
