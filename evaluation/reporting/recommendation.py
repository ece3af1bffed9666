"""What may be shared, in words, for first screen, page, notebook and `design`."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from evaluation.estimates.metrics import (
    MEDIAN_ERROR,
    METRICS,
    PAPER_DESCRIPTORS,
    PLR,
    PLR_WIDE,
    RANK1,
)
from evaluation.estimates.strongest import BEYOND
from evaluation.plan.address import MechanismLevel
from evaluation.reporting.amounts import (
    PERCENT,
    bare_percent,
    counted,
    half_width,
    listed,
    percent,
    round_percent,
    sentence_case,
)
from evaluation.reporting.names import (
    adding_phrase,
    adversary_name,
    descriptor_name,
    mechanism_phrase,
    robot_subject,
    task_phrase,
)
from evaluation.reporting.notices import few_people
from evaluation.reporting.rows import Results
from evaluation.verdict.number_text import MOST_PEOPLE
from evaluation.verdict.offers import AttackNumbers, Check, Offer, Unknown
from evaluation.verdict.question import LIMITS, LINKED, MISSED, Criterion
from evaluation.verdict.what_to_share import Recommendation
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate
from isac_track.privacy import WIDE_TIMES

_MOST_NAMED: Final = 2  # Levels that a sentence names.
# Factors from here on have no decimals.
_MANY_TIMES: Final = 9.5
_FEW_TIMES: Final = 1.1
_FALSE_ALARMS: Final = "false_alarm"
_WHY: Final[Mapping[Unknown, str]] = {
    "no horizon": (
        "conflicts within {horizon} were not judged: add "
        "--set conflict.horizons_s={seconds:g}"
    ),
    "no robot": "no robot predicts conflicts: add --predictor kalman_cv",
    "no attack": "no attack ran at this level: add --attack ou_rts",
    "no handover": (
        "linkage after a silence was not tried: add --task handover-1s "
        "--attack kinematic --attack kinematic@radial_rts"
    ),
    "no task": "linkage was not tried: add --task rerelease --attack shape@radial_rts",
    "adversary not tried": "{adversary} was not tried: add --adversary {option}",
    "shortcut": "a shortcut gives people away, so the attack itself is not measured",
    "attack too weak": "the attack fails even without noise, so it is no measure",
    "no value": "the value is unknown",
    "too few people": f"there are too few people: a decision takes {FEWEST_EFFECTIVE}",
}
"""Why something cannot be said, and which option adds it."""
_RUN_LACKS: Final = ("no horizon", "no robot", "no handover", "adversary not tried")
"""Reasons that name their subject themselves."""


def named_levels(run: Results) -> list[MechanismLevel]:
    """Return the levels that the first screen names."""
    answer = run.recommendation()
    return [
        offer.mechanism_level for offer in answer.proposals[:1] or answer.refused[:1]
    ]


def epsilon_m(manifest: Mapping[str, Any]) -> float:
    """Return the distance below which a position is known, m."""
    return float(manifest["settings"]["stages"]["privacy.epsilon_m"])


def offer_name(offer: Offer) -> str:
    """Return a level in the middle of a sentence."""
    return mechanism_phrase(offer.family, offer.mechanism_level.level)


def levels_text(offers: Sequence[Offer]) -> str:
    """Return the first levels by name, and how many more there are."""
    names = [offer_name(offer) for offer in offers]
    n_more = len(names) - _MOST_NAMED
    if n_more <= 0:
        return listed(names)
    return listed([*names[:_MOST_NAMED], counted(n_more, "further level")])


def share_answer(run: Results) -> str:
    """Return the level to share, its cost and its weakness, for the first screen."""
    dataset = run.manifest["dataset"]
    if not few_people(dataset):
        return _share_text(run)
    tracks = counted(dataset["tracks_used"], "usable track")
    return f"With {tracks} nothing is decided. {_share_text(run)}"


def _share_text(run: Results) -> str:
    """Return the answer on a run, whatever its number of people."""
    answer, epsilon = run.recommendation(), epsilon_m(run.manifest)
    if answer.proposals:
        offer = answer.proposals[0]
        limits = " and ".join(_short_limits(answer))
        sentences = [
            f"{sentence_case(offer_name(offer))} is the cheapest level with {limits}.",
            _brief_cost(answer, offer),
        ]
        return " ".join([*sentences, *_screen_standing(offer, answer)])
    if answer.unsettled:
        missing = "; ".join(missing_texts(answer))
        names = levels_text(answer.unsettled)
        return f"The run cannot say: {missing}. All other limits hold with {names}."
    if not answer.refused:
        return "Not answerable: the run has no level that claims to protect."
    nearest = answer.refused[0]
    known = [check for check in nearest.failing if not check.unknown]
    failing = [reason(check, answer, epsilon_m=epsilon) for check in known]
    failing = failing or failures(nearest, answer, epsilon_m=epsilon)
    limits = " and ".join(_short_limits(answer))
    sentences = [
        f"No level has {limits}; the nearest is {offer_name(nearest)}.",
        f"{sentence_case(failing[0])}.",
    ]
    if answer.robot:
        sentences.append(_brief_cost(answer, nearest))
    return " ".join(sentences)


def _short_limits(answer: Recommendation) -> list[str]:
    """Return the limits of the first screen: the defaults."""
    limits = answer.question.limits
    known, linked = limits.get(PLR, 1.0), limits.get(LINKED, 1.0)
    return [
        f"at most {PERCENT * known:.4g} % of positions known",
        f"{PERCENT * linked:.4g} % of the raw re-identification",
    ]


def _brief_cost(answer: Recommendation, offer: Offer) -> str:
    """Return the cost of a level without its conflicts: the table above names them."""
    if not answer.robot:
        return cost_sentence(answer, offer)
    raw = f" (raw: {bare_percent(answer.raw.cost)})" if answer.raw else ""
    return (
        f"Held to the false alarms of raw positions, {chosen_robot(answer)} misses "
        f"{percent(offer.cost)}{raw}."
    )


def chosen_robot(answer: Recommendation) -> str:
    """Return the robot whose misses count, or both that the people's halves chose."""
    return " or ".join(dict.fromkeys(map(robot_subject, answer.robots)))


def _screen_standing(offer: Offer, answer: Recommendation) -> list[str]:
    """Return the standing of a proposal; none if no adversary was tried."""
    was_tried = any(side.reader is not None for side in offer.beyond)
    return standing_sentences(offer, answer)[:1] if was_tried else []


def share_details(run: Results) -> tuple[str, ...]:
    """Return the limits, the other proposals, and which adversaries were not tried."""
    answer, epsilon = run.recommendation(), epsilon_m(run.manifest)
    shown = answer.proposals or answer.unsettled or answer.refused[:1]
    limits = "; ".join(limit_texts(answer, epsilon_m=epsilon))
    sentences = [f"Limits: {limits}."] if shown else []
    sentences += [offer_text(offer, answer, epsilon_m=epsilon) for offer in shown[:1]]
    if others := [offer_name(offer) for offer in shown[1:]]:
        sentences.append(f"Further levels: {listed(others)}.")
    return tuple(sentences)


def answer_text(
    answer: Recommendation,
    *,
    simulated: bool,
    epsilon_m: float,
    most_failures: int | None = None,
) -> str:
    """Return the answer of `design`: yes, no or unknown, with adversaries and limits.

    It lists at most `most_failures` of the limits that the nearest level exceeds.
    """
    people = " (simulated people)" if simulated else ""
    limits = f"Limits: {'; '.join(limit_texts(answer, epsilon_m=epsilon_m)) or 'none'}."
    if answer.proposals:
        names = levels_text(answer.proposals)
        verb = "keeps" if len(answer.proposals) == 1 else "keep"
        yes = f"Yes{people}, {_against(answer)}: {names} {verb} within the limits."
        return " ".join([yes, limits, *_break_sentences(answer)])
    if answer.unsettled:
        names = levels_text(answer.unsettled)
        missing = "; ".join(missing_texts(answer))
        others = f"All other limits hold with {names}."
        return f"The run cannot say{people}: {missing}. {others} {limits}"
    if answer.nearest is None:
        return f"No{people}: the run has no level that claims to protect."
    texts = failures(answer.nearest, answer, epsilon_m=epsilon_m)
    shown = texts[:most_failures]
    if n_more := len(texts) - len(shown):
        shown.append(counted(n_more, "further limit fails", "further limits fail"))
    failing = "; ".join(shown)
    nearest = f"The nearest is {offer_name(answer.nearest)}: {failing}."
    return f"No{people}: no level keeps within the limits. {limits} {nearest}"


def _against(answer: Recommendation) -> str:
    """Return the adversaries that the answer withstands, and those that break it."""
    asked = [adversary_name(name) for name in answer.question.against]
    text = "against one release"
    if asked:
        text += f" and {listed(asked)}"
    limit = _plr_limit(answer)
    broken = set.intersection(
        *(
            {side.adversary for side in offer.beyond if side.breaks(limit)}
            for offer in answer.proposals
        )
    )
    if not broken:
        return text
    names = [adversary_name(name) for name in sorted(broken)]
    return f"{text}, but not {listed(names, 'or')}"


def _break_sentences(answer: Recommendation) -> list[str]:
    """Return the adversaries that break a proposal, and the option to count them."""
    sentences = []
    for offer in answer.proposals:
        for side in offer.beyond:
            if side.breaks(_plr_limit(answer)):
                known = percent(_worse(side, _plr_limit(answer)))
                sentences.append(
                    f"With {offer_name(offer)}, {adversary_name(side.adversary)} knows"
                    f" {known} of positions; to make it count: --against"
                    f" {side.adversary}."
                )
    return sentences


def cost_sentence(answer: Recommendation, offer: Offer) -> str:
    """Return missed conflicts at a level, beside raw positions."""
    if not answer.robot:
        return "The run does not say what a robot misses."
    raw = f" (raw positions: {bare_percent(answer.raw.cost)})" if answer.raw else ""
    subject = chosen_robot(answer)
    is_future = answer.question.criterion.conflicts == "missed_future"
    conflicts = "future conflicts" if is_future else "all conflicts"
    return (
        f"At the false alarms of raw positions, {subject} misses {percent(offer.cost)}"
        f" of {conflicts}{raw}."
    )


def conflicts_text(criterion: Criterion) -> str:
    """Return the conflicts by which levels are chosen."""
    is_future = criterion.conflicts == "missed_future"
    conflicts = "future conflicts" if is_future else "all conflicts"
    seconds = criterion.horizon_s
    return conflicts if seconds is None else f"{conflicts} within {seconds:g} s"


def standing_sentences(offer: Offer, answer: Recommendation) -> list[str]:
    """Return the adversaries that break a level, that do not, and all others."""
    limit = _plr_limit(answer)
    tried = [side for side in offer.beyond if side.reader is not None]
    broken = [
        f"{adversary_name(side.adversary)} (knows {bare_percent(_worse(side, limit))})"
        for side in tried
        if side.breaks(limit)
    ]
    withstood = [
        adversary_name(side.adversary) for side in tried if side.breaks(limit) is False
    ]
    unknown = [
        adversary_name(side.adversary) for side in tried if side.breaks(limit) is None
    ]
    untried = [side.adversary for side in offer.beyond if side.reader is None]
    sentences = []
    if broken:
        verb = "breaks" if len(broken) == 1 else "break"
        sentences.append(f"{sentence_case(listed(broken))} {verb} it.")
    if withstood:
        sentences.append(f"It holds against {listed(withstood)}.")
    if unknown:
        names = listed(unknown, "or")
        sentences.append(f"The run cannot say whether it holds against {names}.")
    if untried:
        sentences.append(f"Not tried: --adversary {listed(untried, 'or')}.")
    return sentences


def untried_text(answer: Recommendation) -> str:
    """Return the adversaries that were not tried on the shown levels; empty if none."""
    shown = answer.proposals or answer.unsettled or answer.refused[:1]
    untried = dict.fromkeys(
        side.adversary
        for offer in shown
        for side in offer.beyond
        if side.reader is None
    )
    return f"Not tried: --adversary {listed(list(untried), 'or')}. " if untried else ""


def _plr_limit(answer: Recommendation) -> float:
    return answer.question.limits.get(PLR, 1.0)


def _worse(side: AttackNumbers, limit: float) -> Estimate:
    """Return the share of positions that an adversary knows.

    It is the share at 4/3 epsilon if only that exceeds the limit.
    """
    near, wide = side.value(PLR), side.value(PLR_WIDE)
    is_near = near.ci_high > limit
    return wide if wide.ci_high > limit and not is_near else near


def offer_text(offer: Offer, answer: Recommendation, *, epsilon_m: float) -> str:
    """Return the cost and the privacy of a level, and the adversaries that break it."""
    side = offer.attacked if offer.attacked.reader else offer.shared
    is_attacked = side.reader is not None and side.reader.adversary
    subject = "an attack" if is_attacked else "without an attack, an adversary"
    wide_m = WIDE_TIMES * epsilon_m
    near, wide = percent(side.value(PLR)), percent(side.value(PLR_WIDE))
    reach = f"{near} of positions to {epsilon_m:.4g} m and {wide} to {wide_m:.4g} m"
    sentences = [f"{sentence_case(offer_name(offer))}: {subject} knows {reach}."]
    if answer.robot:
        sentences.append(cost_sentence(answer, offer))
    if math.isfinite(side.value(MEDIAN_ERROR).value):
        sentences.append(
            f"The median error is {length_text(side.value(MEDIAN_ERROR))}."
        )
    if offer.linked and math.isfinite(offer.linked.share.value):
        phrase = sentence_case(task_phrase(offer.linked.task))
        rank1, share = percent(offer.linked.rank1), percent(offer.linked.share)
        sentences.append(
            f"{phrase} it re-identifies {rank1}: {share} of the raw share."
        )
    return " ".join([*sentences, *standing_sentences(offer, answer)])


def length_text(length: Estimate) -> str:
    """Return a length with its half-width, m."""
    half = half_width(length)
    value = f"{length.value:.2f} m"
    return f"{value} ±{half:.2f}" if math.isfinite(half) else value


def limit_texts(answer: Recommendation, *, epsilon_m: float) -> list[str]:
    """Return the limits that were asked, in words."""
    question, texts = answer.question, list[str]()
    for name, limit in question.limits.items():
        amount = _amount(name, limit)
        if name == PLR:
            wide_m = WIDE_TIMES * epsilon_m
            side = "as sent" if question.as_shared else "after an attack"
            reach = f"to {epsilon_m:.4g} m and {wide_m:.4g} m"
            texts.append(f"{amount} of positions known {reach} {side}")
        elif name == LINKED and question.asks_linkage:
            task = task_phrase(answer.task) if answer.task else "after a silence"
            texts.append(f"{amount} of the raw re-identification {task}")
        elif name == MISSED:
            texts.append(f"{amount} of {conflicts_text(question.criterion)} missed")
        elif name == _FALSE_ALARMS:
            texts.append(f"{amount} false alarms")
        elif name == RANK1:
            texts.append(f"{amount} of people re-identified in every task")
        elif name != LINKED:
            side = "as sent" if question.as_shared else "after an attack"
            texts.append(f"{amount} of {descriptor_name(name)} {side}")
    return texts


def _amount(name: str, limit: float) -> str:
    metric = METRICS[LIMITS.get(name, name)]
    if metric.is_share:
        return f"{PERCENT * limit:.4g} %"
    return f"{limit:.4g} {metric.unit}".strip()


def failures(offer: Offer, answer: Recommendation, *, epsilon_m: float) -> list[str]:
    """Return which limits a level exceeds, and by how much."""
    texts = [reason(check, answer, epsilon_m=epsilon_m) for check in offer.failing]
    if offer.lacks_rule:
        texts.append(
            f"no level of its mechanism holds with {adding_phrase(offer.lacks_rule)}"
        )
    return texts


def reason(check: Check, answer: Recommendation, *, epsilon_m: float) -> str:
    """Return why a limit is not met; empty if it is."""
    if check.status == "met":
        return ""
    if check.unknown:
        return _why(check, answer)
    name = PLR if check.name == PLR_WIDE else check.name.partition("/")[0]
    limit = _amount(name, check.limit)
    text = f"{_excess(check, answer, epsilon_m)} (limit {limit})"
    more_data = _more_data(check)
    return f"{text}; {more_data}" if more_data else text


def _excess(check: Check, answer: Recommendation, epsilon_m: float) -> str:
    """Return the excess over a limit, up to the upper end of its interval."""
    name, _, task = check.name.partition("/")
    upper = check.measured.ci_high
    rounded = round_percent(PERCENT * upper)
    is_close = rounded == round_percent(PERCENT * check.limit)
    share = f"just over {rounded} %" if is_close else f"up to {rounded} %"
    if name == LINKED:
        return (
            f"an attack may keep {share} of the raw re-identification"
            f" {task_phrase(answer.task)}"
        )
    if name == RANK1:
        return f"an attack re-identifies {share} of people {task_phrase(task)}"
    if name == MISSED:
        conflicts = conflicts_text(answer.question.criterion)
        return f"{chosen_robot(answer)} misses {share} of {conflicts}"
    if name == _FALSE_ALARMS:
        return f"{chosen_robot(answer)} raises {share} false alarms"
    if name in (PLR, PLR_WIDE):
        reach_m = WIDE_TIMES * epsilon_m if name == PLR_WIDE else epsilon_m
        return f"{_adversary(check)} knows {share} of positions to {reach_m:.4g} m"
    metric = METRICS[name]
    amount = share if metric.is_share else f"up to {upper:.2f} {metric.unit}".strip()
    return _descriptor_excess(name, _adversary(check), amount)


def _descriptor_excess(name: str, adversary: str, amount: str) -> str:
    """Return that a descriptor reaches an amount against an adversary."""
    descriptor = descriptor_name(name)
    if name in PAPER_DESCRIPTORS:
        article = "an" if descriptor.startswith("average") else "a"
        return f"{adversary} leaves {article} {descriptor} of {amount}"
    # The name of a further descriptor may be a plural, which takes no "a".
    return f"{descriptor} against {adversary}: {amount}"


def _adversary(check: Check) -> str:
    """Return the adversary of a check."""
    if check.reader is None or not check.reader.adversary:
        return "an adversary without an attack"
    return adversary_name(check.adversary) if check.adversary in BEYOND else "an attack"


def _more_data(check: Check) -> str:
    """Return how much more data would decide; empty where no more would."""
    times = check.times_more
    if math.isnan(times):
        return ""
    if math.isinf(times):
        return "the value is at its limit, and no more data would decide it"
    if check.asks == "scenes":
        n_scenes = max(float(f"{check.scenes * times:.2g}"), check.scenes + 1)
        return f"about {n_scenes:,.0f} scenes would decide it"
    if not times < MOST_PEOPLE:
        return "no realistic number of people would decide it"
    if times < _FEW_TIMES:
        return "a few more people would decide it"
    amount = f"{times:,.0f}" if times >= _MANY_TIMES else f"{times:.2g}"
    return f"about {amount} times as many people would decide it"


def cause(check: Check, answer: Recommendation) -> str:
    """Return why a check is unknown, and the option that adds it; empty if known."""
    if check.unknown is None:
        return ""
    seconds = answer.question.criterion.horizon_s
    return _WHY[check.unknown].format(
        adversary=adversary_name(check.adversary),
        option=check.adversary,
        horizon="this horizon" if seconds is None else f"{seconds:g} s",
        seconds=seconds,
    )


def _why(check: Check, answer: Recommendation) -> str:
    """Return why a check is unknown, after its subject if the reason names none."""
    if check.unknown in _RUN_LACKS:
        return cause(check, answer)
    return f"{_subject(check, answer)}: {cause(check, answer)}"


def _subject(check: Check, answer: Recommendation) -> str:
    """Return the number that a check is about."""
    name, _, task = check.name.partition("/")
    subjects = {
        LINKED: f"re-identification {task_phrase(answer.task)}",
        RANK1: f"re-identification {task_phrase(task)}",
        MISSED: "missed conflicts",
        _FALSE_ALARMS: "false alarms",
        PLR: "known positions",
        PLR_WIDE: "known positions",
    }
    return subjects[name] if name in subjects else descriptor_name(name)


def missing_texts(answer: Recommendation) -> list[str]:
    """Return what the run cannot say of any level, with the options that add it."""
    checks = (check for offer in answer.refused for check in offer.failing)
    by_code = {
        (check.unknown, check.adversary): check for check in checks if check.unknown
    }
    texts = [
        cause(check, answer)
        for (code, _), check in by_code.items()
        if code in answer.missing
    ]
    return list(dict.fromkeys(texts))
