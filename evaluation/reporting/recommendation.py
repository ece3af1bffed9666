"""What may be shared, in words: the one answer that screen, page and `design` give."""

from collections.abc import Mapping
from functools import partial
from typing import Any, Final

from evaluation.analysis.keys import Where
from evaluation.analysis.metrics import EXPOSURE, METRICS, MISSED_RATE, SUCCESS, WIDE
from evaluation.reporting import table as make
from evaluation.reporting.headline import robot_name
from evaluation.reporting.markup import paragraphs
from evaluation.reporting.rows import Results, short_name
from evaluation.verdict.what_to_share import (
    LIMITS,
    LINKED,
    MISSED,
    MOST_PLR,
    Attacked,
    Check,
    Criterion,
    Offer,
    Recommendation,
    Unknown,
)
from isac_track.intervals import LEAST_CLUSTERS, Estimate
from isac_track.privacy import WIDE_TIMES

_NOT_RUN: Final = ("no horizon", "no robot", "no handover", "adversary not tried")
"""What a run does not have at any level: it is said without the limit that asks for it."""
_SHOWN: Final = {MISSED: MISSED_RATE, LINKED: EXPOSURE, "false_alarm": "false_alarm_rate"}
"""Metrics that numbers with other names are shown like."""
_BRIEF: Final = {EXPOSURE: "PLR", WIDE: "at 4/3 of epsilon", LINKED: "linkage", MISSED: "missed"}
"""What limits are called where there is little room."""
_WHY: Final[dict[Unknown, str]] = {
    "no horizon": "conflicts within {horizon} were not judged: add "
    "--set conflict.horizons_s={at:g}",
    "no robot": "nobody foresees conflicts: add --predictor kalman_cv",
    "no attack": "no attack was run at this level: add --attack ou_rts",
    "no handover": "linkage after a silence was not run: add --task handover-1s "
    "--attack kinematic --attack kinematic@radial_rts",
    "no task": "nobody is linked: add --task rerelease --attack shape@radial_rts",
    "adversary not tried": "{adversary} was not tried: add --adversary {adversary}",
    "shortcut": "a shortcut gives people away: no measure of the attack",
    "attack too weak": "every attack is too weak: it fails without any error, too",
    "no value": "the value is unknown",
    "too few people": f"so few people have no interval; {LEAST_CLUSTERS:g} groups have",
}


def recommended_levels(run: Results) -> list[Where]:
    """Return the levels that the first screen names."""
    answer = run.recommendation()
    return [offer.where for offer in answer.proposals or answer.refused[:1]]


def epsilon_m(manifest: Mapping[str, Any]) -> float:
    """Return the distance below which a position is known, m."""
    return float(manifest["settings"]["stages"]["privacy.epsilon_m"])


def said(part: str, **about: Any) -> list[str]:  # noqa: ANN401 - what a macro takes
    """Return the paragraphs of a macro of the template of recommendations."""
    return paragraphs(f"recommendation.{part}", _WORDS, **about)


def screen_sentence(run: Results) -> str:
    """Return the answer of the first screen."""
    answer = run.recommendation()
    return said("screen", answer=answer, limit=MOST_PLR)[0]


def sentence(answer: Recommendation, *, simulated: bool) -> str:
    """Return the plain answer."""
    return said("sentence", answer=answer, simulated=simulated)[0]


def reason(check: Check, answer: Recommendation) -> str:
    """Return why a limit is not met; empty if it is."""
    return "" if check.status == "met" else said("reason", check=check, answer=answer)[0]


def offer_text(offer: Offer, answer: Recommendation, epsilon: float) -> str:
    """Return what a level costs and leaves, and who breaks it."""
    limit = answer.question.limits.get(EXPOSURE, 1.0)
    about = {"level": offer, "raw": answer.raw, "wide": WIDE_TIMES * epsilon, "limit": limit}
    return said("offer", **about)[0]


def level_name(offer: Offer) -> str:
    """Return a level as it is asked for."""
    return short_name({offer.where[0]: offer.family}, offer.where)


def numbers_text(name: str, number: Estimate) -> str:
    """Return a number with unit and interval."""
    metric = _SHOWN.get(name, name)
    cell = make.estimated(metric, number)
    return f"{cell.text or '-'} {METRICS[metric].unit} {cell.interval}".strip()


def _amount(name: str, limit: float) -> str:
    shown = METRICS[_SHOWN.get(name, LIMITS.get(name, name))]
    return f"{limit * shown.scale:.4g} {shown.unit}".strip()


def _metres(distance_m: float) -> str:
    return f"{distance_m:.4g} m"


def _silence(task: str) -> str:
    gap = task.partition("-")[2].removesuffix("s")
    return f"after {gap} s" if gap else "after a silence"


def _costs(criterion: Criterion) -> str:
    conflicts = "conflicts to come" if criterion.conflicts == "missed_future" else "all conflicts"
    at = criterion.horizon_s
    return f"{conflicts} within {at:g} s" if at is not None else conflicts


def _robots(answer: Recommendation) -> str:
    """Return the robot whose misses count, or both that the halves of the people chose."""
    return " or ".join(dict.fromkeys(map(robot_name, answer.robots)))


def _subject(check: Check, task: str) -> str:
    """Return what a check is about."""
    label = check.source.label if check.source else ""
    name, _, its_task = check.name.partition("/")
    if name == LINKED:
        return f"linkage {_silence(task)}"
    if name == SUCCESS:
        linker = check.source.attack.label if check.source else "nobody"
        return f"rank 1 in {its_task} by {linker}"
    if name in (MISSED, "false_alarm"):
        return "missed conflicts" if name == MISSED else "false alarms"
    head = METRICS[WIDE].head if name == WIDE else METRICS[name].head
    if check.source is None:
        return head
    return f"{head} after {label}" if check.source.knowledge else f"{head} as shared"


def _told_check(check: Check) -> str:
    name = check.name.partition("/")[0]
    text = numbers_text(name, check.measured)
    return f"{text} of raw's" if name == LINKED else text


def _cause(check: Check, answer: Recommendation) -> str:
    """Return why something cannot be said, and which option would add it."""
    code, at = check.unknown, answer.question.criterion.horizon_s
    if code is None:
        return ""
    shown = "this horizon" if at is None else f"{at:g} s"
    return _WHY[code].format(adversary=check.adversary, horizon=shown, at=at)


def _why(check: Check, answer: Recommendation) -> str:
    """Return the same with what it is about, but of what the run does not have at all."""
    cause = _cause(check, answer)
    if check.unknown in _NOT_RUN:
        return cause
    return f"{_subject(check, answer.task)}: cannot say, {cause}"


def _stands(
    offer: Offer, limit: float, *, is_brief: bool = False
) -> tuple[list[str], list[str], list[str]]:
    """Return who breaks a level, who does not, with what each knows, and who was not tried."""
    broken, held, untried = list[str](), list[str](), list[str]()
    for side in offer.beyond:
        breaks = side.breaks(limit)
        if breaks is None:
            untried.append(side.adversary)
            continue
        text = _briefly_left_by(side, limit) if is_brief else _left_by(side)
        (broken if breaks else held).append(text)
    return broken, held, untried


def _brief_failures(offer: Offer, answer: Recommendation) -> list[str]:
    """Return which limits a level does not hold, with the numbers alone."""
    texts = [
        _why(check, answer)
        if check.unknown
        else f"{_BRIEF.get(check.name, check.name)} {_told_check(check)}"
        for check in offer.failing
    ]
    if offer.lacks_rule:
        texts.append(f"no level under {offer.lacks_rule} adding that holds")
    return texts


def _left_by(side: Attacked) -> str:
    known = numbers_text(EXPOSURE, side.value(EXPOSURE))
    return f"{side.adversary} ({known}, {numbers_text(WIDE, side.value(WIDE))} at 4/3)"


def _briefly_left_by(side: Attacked, limit: float) -> str:
    """Return what an adversary knows: at epsilon, or farther off if only that is too much."""
    plr, wide = side.value(EXPOSURE), side.value(WIDE)
    if plr.ci_high <= limit < wide.ci_high:
        return f"{side.adversary} {numbers_text(WIDE, wide)} at 4/3 of epsilon"
    return f"{side.adversary} {numbers_text(EXPOSURE, plr)}"


def _broken_by(answer: Recommendation) -> list[str]:
    limit = answer.question.limits.get(EXPOSURE, 1.0)
    texts = []
    for offer in answer.proposals:
        for side in offer.beyond:
            if side.breaks(limit):
                known = _briefly_left_by(side, limit).removeprefix(f"{side.adversary} ")
                texts.append(f"{side.adversary} breaks {level_name(offer)}: {known}")
    return texts


def _limits(answer: Recommendation) -> list[str]:
    """Return the limits that were asked, in words."""
    question, texts = answer.question, list[str]()
    for name, limit in question.limits.items():
        if name == LINKED:
            if question.asks_linkage:
                most = f"{_amount(LINKED, limit)} of raw's"
                texts.append(f"linkage {_silence(answer.task)} <= {most}")
            continue
        side = "as shared" if question.as_shared else "after attack"
        heads = {
            MISSED: f"missed {_costs(question.criterion)}",
            "false_alarm": "false alarms",
            SUCCESS: "rank 1 in every task",
            EXPOSURE: f"PLR {side} (at epsilon and at 4/3 of it)",
        }
        head = heads.get(name, f"{METRICS[LIMITS[name]].head} {side}")
        texts.append(f"{head} <= {_amount(name, limit)}")
    return texts


def _missing(answer: Recommendation) -> list[str]:
    """Return what the run cannot say, each with the option that adds it."""
    checks = (check for offer in answer.refused for check in offer.failing)
    by_code = {(check.unknown, check.adversary): check for check in checks if check.unknown}
    texts = [
        _cause(check, answer) for (code, _), check in by_code.items() if code in answer.missing
    ]
    return list(dict.fromkeys(texts))


def failures(offer: Offer, answer: Recommendation) -> list[str]:
    """Return which limits a level does not hold, and why."""
    texts = [reason(check, answer) for check in offer.failing]
    if offer.lacks_rule:
        texts.append(f"no level of its mechanism holds under {offer.lacks_rule} adding")
    return texts


_WORDS: dict[str, Any] = {  # What the template calls.
    "name": level_name,
    "names": lambda offers: [level_name(offer) for offer in offers],
    "told": numbers_text,
    "told_check": _told_check,
    "amount": _amount,
    "metres": _metres,
    "silence": _silence,
    "costs": _costs,
    "subject": _subject,
    "why": _why,
    "stands": _stands,
    "brief_stands": partial(_stands, is_brief=True),
    "brief_failures": _brief_failures,
    "robots": _robots,
    "limits": _limits,
    "limit_text": lambda check: _amount(check.name.partition("/")[0], check.limit),
    "missing": _missing,
    "failures": failures,
    "broken_by": _broken_by,
    "head": lambda name: METRICS[name].head,
}
