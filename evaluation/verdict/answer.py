"""The verdict in three sentences: whether descriptors track, FID pays, attacks undo."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from evaluation.analysis.families import ADDING_RULES
from evaluation.analysis.matching import MISSED
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.verdict import rules
from evaluation.verdict.claim import AFTER, AS_IS, LINKED
from evaluation.verdict.items import NAME
from evaluation.verdict.rules import DOES_NOT, SUCCESS_MARGIN, TRACKS, UNDECIDED, WEAKLY

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    Items = Sequence[dict[str, Any]]

_ORDER: Final = (DOES_NOT, WEAKLY, TRACKS)
"""What is said of a descriptor that fares differently in different tasks: the worst."""
_PLURAL: Final = {
    DOES_NOT: ("does not track", "do not track"),
    WEAKLY: ("tracks weakly", "track weakly"),
    TRACKS: ("tracks", "track"),
}


def answer(items: Items, *, dataset: str, fid: Collection[str]) -> list[str]:
    """Return three sentences for the first screen.

    `items` are those of `verdict.json`, `fid` the names of the paper's mechanism under either rule.
    """
    return [_tracking(items, dataset=dataset, fid=fid), _claim(items), _inflation(items)]


def _tracking(items: Items, *, dataset: str, fid: Collection[str]) -> str:
    mine = [one for one in items if one["section"] == rules.VALIDITY]
    if not mine:
        return (
            f"Whether PLR, AEL and MEL track linkability in {dataset} was not tested: the run "
            "has no sweep of fixed noise, or nobody links."
        )
    named: dict[str, list[str]] = {decision: [] for decision in (*_ORDER, UNDECIDED)}
    for descriptor in DESCRIPTORS:
        decided = {one["decision"] for one in mine if one["descriptor"] == descriptor}
        worst = next((decision for decision in _ORDER if decision in decided), UNDECIDED)
        named[worst].append(NAME[descriptor])
    open_ones = named.pop(UNDECIDED)
    parts = [
        f"{_listed(names)} {_PLURAL[decision][len(names) > 1]} how linkable people are"
        for decision, names in named.items()
        if names
    ]
    if open_ones and parts:
        parts.append(f"for {_listed(open_ones)} that is undecided")
    elif open_ones:
        parts = [f"whether {_listed(open_ones)} track how linkable people are is undecided"]
    said = f"In {dataset}, " + "; ".join(parts)
    against = [one for one in mine if one["decision"] == DOES_NOT]
    if against:
        said += f": {_evidence(against, fid=fid)}"
    return said + "."


def _evidence(against: Items, *, fid: Collection[str]) -> str:
    """Return what speaks most against a descriptor: the largest differences either way."""
    differing = [
        (abs(gap["effect"]), gap, one)
        for one in against
        for gap in one["contrasts"]
        if gap["reading"] == "differs"
    ]
    if not differing:
        return f"they fall with the noise, success in {against[0]['task']} hardly does"
    surest = max(differing, key=lambda one: one[0])[2]
    effects = {gap["effect"]: gap for _, gap, one in reversed(differing) if one is surest}
    words = []
    for effect, word in ((max(effects), "more"), (min(effects), "fewer")):
        if (effect > 0) == (word == "more"):
            name, level = effects[effect]["mechanism"], effects[effect]["level"]
            where = name if level is None else f"{name} {level:g}"
            words.append(f"{where} lets {100 * abs(effect):.0f} of 100 people {word} be linked")
    alike = any(
        gap["mechanism"] in fid and gap["reading"] == "equal" for gap in surest["contrasts"]
    )
    margin = f"{100 * SUCCESS_MARGIN:.0f} of 100"
    return (
        f"at equal {NAME[surest['descriptor']]}, {_listed(words)} than fixed noise "
        f"({surest['task']}, {surest['adding']} adding"
        + (f"; FID and fixed noise alone are alike to within {margin})" if alike else ")")
    )


def _claim(items: Items) -> str:
    mine = [
        one
        for one in items
        if one["section"] == rules.CLAIM and one["criterion"] == MISSED and "mechanism" not in one
    ]
    if not mine:
        return "The run does not compare FID with fixed noise."
    parts = []
    for adding in ADDING_RULES:
        words = []
        for of, where in (
            (AS_IS, "as shared"),
            (AFTER, "after the strongest smoother"),
            (LINKED, "in linkage"),
        ):
            one_rule = [one for one in mine if one["adding"] == adding and one["of"] == of]
            if one_rule:
                words.append(f"{where} {_fares(one_rule)}")
        if words and all(word.endswith(UNDECIDED) for word in words):
            parts.append(f"under {adding} adding it is undecided throughout")
        elif words:
            parts.append(f"under {adding} adding it is {_listed(words)}")
    return "FID against fixed noise at equal missed-conflict rate: " + "; ".join(parts) + "."


def _fares(items: Items) -> str:
    better = [one for one in items if one["decision"] == rules.HOLDS]
    worse = [one for one in items if one["decision"] == rules.REVERSED]
    if not better and not worse:
        return "undecided"
    parts = []
    for ones, word in ((better, "better"), (worse, "worse")):
        if ones:
            names = [str(NAME.get(one["descriptor"], one["task"])) for one in ones]
            all_of = "" if len(ones) < len(items) or len(ones) == 1 else "all of "
            parts.append(f"{word} in {all_of}{_listed(names)}")
    return " but ".join(parts)


def _inflation(items: Items) -> str:
    every = [one for one in items if one["section"] == rules.INFLATION]
    mine = [one for one in every if one["decision"] == rules.INFLATED]
    if not every:
        return "What an attack makes of the descriptors was not tested: no attack was run."
    if not mine:
        return "That an attack raises the descriptors is undecided."
    subject = mine[0]["subject"]
    parts = []
    for descriptor in DESCRIPTORS:
        ratios = [one["effect"] for one in mine if one["descriptor"] == descriptor]
        if ratios:
            low, high = min(ratios), max(ratios)
            span = f"{low:.1f}" if f"{low:.1f}" == f"{high:.1f}" else f"{low:.1f} to {high:.1f}"
            parts.append(f"{NAME[descriptor]} by {span} times")
    return (
        f"The values as shared understate what is left to an adversary: {subject} raises "
        f"{_listed(parts)}."
    )


def _listed(words: Sequence[str]) -> str:
    if len(words) == 1:
        return words[0]
    return ", ".join(words[:-1]) + " and " + words[-1]
