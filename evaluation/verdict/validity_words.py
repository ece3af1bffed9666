"""Sentences of validity: the answer of an item, and the reasons for none."""

from typing import Final

import numpy as np

from evaluation.estimates.keys import where_text
from evaluation.verdict import rules
from evaluation.verdict.curves import (
    BOTH,
    NEITHER,
    ONLY_FEWER,
    ONLY_MORE,
    QUARTER_POINTS,
)
from evaluation.verdict.items import Contrast, SpreadAnswer, ValidityItem
from evaluation.verdict.number_text import people_amount, points_text, with_interval
from evaluation.verdict.rules import NAME
from evaluation.verdict.spread import IntervalWidths
from evaluation.verdict.validity_drafts import ValidityDraft
from isac_track.intervals import FEWEST_EFFECTIVE

_WHY_ONE_SIDED: Final = {
    ONLY_MORE: "has a lower {} than any fixed noise, so that only more could be seen",
    ONLY_FEWER: "has a higher {} than raw, so that only fewer could be seen",
    NEITHER: "has a {} of too few people",
}
_POINT_NAMES: Final = dict(zip(QUARTER_POINTS, ("low", "middle", "high"), strict=True))


def why_undecided(
    draft: ValidityDraft, widths: IntervalWidths, answer: SpreadAnswer
) -> str:
    """Return why nothing is decided; empty for a decision."""
    if answer.decision == rules.NOT_TESTABLE:
        return _why_not_testable(draft, widths)
    if answer.decision == rules.BETWEEN:
        low, high = points_text(answer.low), points_text(answer.high)
        return f"between {low} and {high} of 100 people"
    return ""


def _why_not_testable(draft: ValidityDraft, widths: IntervalWidths) -> str:
    """Return why it cannot be tested whether a descriptor tracks."""
    panel, fixed = draft.panel, draft.contrasts.fixed
    effective = fixed.degrees + 1
    if effective < FEWEST_EFFECTIVE:
        return (
            f"it rests on {draft.n} people or groups, who count as {effective:.0f}: "
            f"{FEWEST_EFFECTIVE} are needed"
        )
    if fixed.fall_error < rules.NO_SPREAD:
        return "all people fare the same: that says nothing of others"
    raw = panel.task.levels[panel.fixed[-1]]
    links, guess = (
        float(sums.sum() / raw.probes.sum()) for sums in (raw.success, raw.chance)
    )
    if links - guess < rules.SUCCESS_MARGIN:
        return (
            f"the strongest attack links {points_text(links)} of 100 people even at "
            f"raw, a guess {points_text(guess)}: nothing could be seen"
        )
    fall = float(fixed.fall[0])
    if fall - widths.fall < rules.LEAST_FALL:
        low, high = points_text(fall - widths.fall), points_text(fall + widths.fall)
        least = points_text(rules.LEAST_FALL, 0)
        return (
            f"linkage falls by {points_text(fall)} [{low}, {high}] of 100 people from "
            f"raw to the strongest fixed error, not surely by {least}: anything would "
            "track"
        )
    return panel.missing or "; ".join(_untestable_sides(draft))


def _untestable_sides(draft: ValidityDraft) -> list[str]:
    """Return the mechanisms with an untestable side, each with the reason."""
    name, levels = NAME[draft.descriptor], draft.panel.task.levels
    reasons: dict[str, None] = {}
    sides = draft.contrasts.side.tolist()
    for place, side in zip(draft.panel.compared, sides, strict=True):
        if side != BOTH:
            level = levels[place]
            reason = _WHY_ONE_SIDED[side].format(name)
            reasons[f"{where_text(level.mechanism, level.level)} {reason}"] = None
    return list(reasons)


def item_sentence(draft: ValidityDraft, item: ValidityItem) -> str:
    """Return the sentence of an item, which needs no sentence yet."""
    name, answer, task = NAME[draft.descriptor], item.answer, draft.panel.task
    plain = "" if task.gallery else " (plain rank 1, galleries of its own)"
    where = f"In {task.task}{plain}"
    equal = f"{where}, at equal {name}"
    either = "more or fewer be linked than fixed noise"
    fails = f"{name} does not track."
    if answer.decision == rules.NOT_TESTABLE:
        return f"In {task.task}, whether {name} tracks cannot be tested: {item.why}."
    if answer.decision == rules.TRACKS:
        high = points_text(answer.high)
        return (
            f"{equal}, no mechanism lets {high} of 100 people {either}: {name} tracks."
        )
    if answer.decision == rules.BETWEEN:
        would = _people_needed(item.n_needed)
        return f"{equal}, mechanisms let {item.why} {either}{would}."
    if rules.is_flat_miss(answer.decision, answer.low):
        fixed = draft.contrasts.fixed
        fall, span = points_text(fixed.fall[0]), np.exp(fixed.span[0])
        return (
            f"{where}, from raw to the strongest fixed error {fall} fewer of 100 people"
            f" are linked while {name} hardly changes ({span:.2f} times): {fails}"
        )
    worst = _worst_contrast(item)
    more, limit = "more", ""
    if not worst.gap.value > 0:
        more, limit = "fewer", ", as far as these attacks go"
    return (
        f"{equal}, {_mechanism_name(worst)} lets"
        f" {with_interval(worst.gap, 'share', absolute=True)} {more} of 100 people be"
        f" linked than fixed noise{limit}: {fails}"
    )


def _worst_contrast(item: ValidityItem) -> Contrast:
    """Return the largest sure difference in the panel; by construction comes last."""
    sure = [
        contrast
        for contrast in item.contrasts
        if contrast.reading == rules.DIFFERS and contrast.in_panel
    ]
    return max(
        sure,
        key=lambda contrast: (
            contrast.evidence != rules.CONSTRUCTION,
            abs(contrast.gap.value),
        ),
    )


def _mechanism_name(contrast: Contrast) -> str:
    """Return the mechanism of a contrast as people write it."""
    if contrast.quartile is not None:
        return f"{contrast.mechanism} ({_POINT_NAMES[contrast.quartile]})"
    return where_text(contrast.mechanism, contrast.level)


def _people_needed(n: float | None) -> str:
    """Return the number of people that would show equal linkage; empty if unknown."""
    if not n:
        return ""
    return f"; if truly equal, {people_amount(n)} people would show it"
