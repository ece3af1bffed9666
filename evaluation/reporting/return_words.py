"""Whether people who come back are re-identified, in words: for screen, page, tables."""

import math
from collections.abc import Mapping
from typing import Any, Final

from evaluation.estimates.families import RAW
from evaluation.estimates.metrics import RANK1
from evaluation.plan.address import Address
from evaluation.plan.consumer import FUSION
from evaluation.reporting.amounts import PERCENT, counted, fine_interval, fine_share
from evaluation.reporting.lookups import estimates
from evaluation.reporting.rows import Results
from evaluation.verdict.returns import ReturnAnswer, read_return
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate
from isac_track.linkability.return_rule import POWER, TRUE_GAIN

QUESTION: Final = "Does a walk identify a person in another run?"
TOPIC: Final = "Return"
CONTROL_PHRASES: Final = {
    "queue-place": "the place in the queue",
    "density": "the density of the run",
    "speed": "the speed",
    "length": "the duration of the passage",
    "time-of-day": "the time in the run",
    "neighbours": "the neighbours in the queue",
    "all-circumstances": "all circumstances together",
    "strongest": "the strongest control",
    "same-run": "fusion within a run",
}
"""Controls of people who come back, by the name behind `control-`, in a sentence."""


def return_sentence(run: Results) -> str:
    """Return the answer of the rule in a sentence; empty without people who come back.

    It is about passages without any error.
    """
    answer = read_return(run.verdict)
    if answer is None:
        return ""
    people = counted(answer.n, "person", "people")
    named = _interval_text(answer.rank1)
    beside = f"guessing {fine_share(answer.chance)} %, {_control_share(answer)}"
    match answer.decision:
        case "yes":
            return (
                f"A walk identifies a person in another run: of {people}, {named} are"
                f" named first, {beside}."
            )
        case "no":
            return (
                f"A walk does not identify a person in another run: of {people},"
                f" {named} are named first, {beside}."
            )
    return (
        f"With {people} we cannot tell whether a walk identifies a person in another"
        f" run: {named} are named first, {beside}."
    )


def return_details(run: Results) -> tuple[str, ...]:
    """Return the reason of the answer, its power, and what errors change."""
    answer = read_return(run.verdict)
    if answer is None:
        return ()
    gain = _interval_text(answer.gain, unit=" points")
    sentences = [
        f"Decision by the rule: {answer.decision}, since {answer.why}.",
        (
            "These positions have no error, and all passages of other runs are enrolled."
            " Linkers and their fusion learn on other people."
        ),
        f"The gain over the control is {gain}. Nested p is {answer.nested_p:.3f}.",
        *_power_sentence(answer),
        *_confirming_sentence(answer),
    ]
    if raw := _rank1(run, RAW):
        raw_text = _interval_text(raw)
        sentences.append(f"With raw sensing, {raw_text} are named first.")
    return tuple(sentences)


def returning_line(manifest: Mapping[str, Any]) -> str:
    """Return how many people come back; empty without any."""
    known = manifest["dataset"].get("returning")
    if not known:
        return ""
    people = counted(known["people"], "person walks", "people walk")
    return f"{people} in two or more of {known['sessions']} sessions"


def no_scenes_line(manifest: Mapping[str, Any]) -> str:
    """Return that a run has no scenes, and why, in a line; empty if it has some."""
    why = manifest.get("no_scenes")
    return f"Left out: scenes, patrols and other linkage; {why}." if why else ""


def control_text(name: str) -> str:
    """Return a control of people who come back in a sentence."""
    return CONTROL_PHRASES.get(name, name.replace("-", " "))


def _interval_text(share: Estimate, unit: str = " %") -> str:
    return fine_interval(share.value, share.ci_low, share.ci_high, unit=unit)


def _control_share(answer: ReturnAnswer) -> str:
    """Return the control and the share that it names; a short name on the screen."""
    names = list(answer.controls)
    name = control_text(names[0] if len(names) == 1 else "strongest")
    short = name.removeprefix("the ").removesuffix(" in the queue")
    return f"{short} {fine_share(answer.control.value)} %"


def _power_sentence(answer: ReturnAnswer) -> list[str]:
    """Return with which probability so many people say yes; empty if unknown."""
    if math.isnan(answer.power) or answer.n < FEWEST_EFFECTIVE:
        return []
    return [
        (
            f"With {answer.n} people the rule says yes to a gain of"
            f" {PERCENT * TRUE_GAIN:.0f} points with a probability of"
            f" {answer.power:.2f}; {answer.n_needed} people reach {POWER:g}."
        )
    ]


def _confirming_sentence(answer: ReturnAnswer) -> list[str]:
    """Return what the session left aside shows; empty without any."""
    name = answer.confirming
    if not name:
        return []
    if answer.confirming_p is None:
        return [f"Session {name} was left aside; it could not change the answer."]
    gain = fine_share(answer.confirming_gain.value)
    return [
        (
            f"Session {name}, left aside, has a gain of {gain} points, nested p"
            f" {answer.confirming_p:.3f}."
        )
    ]


def _rank1(run: Results, mechanism: str) -> Estimate | None:
    """Return rank 1 of the fusion with a mechanism without levels."""
    known = {key.within(): number for key, number in estimates(run.returns).items()}
    fusion = Address(task="returns", plugin=FUSION, adversary="informed", metric=RANK1)
    return known.get(fusion.at(mechanism, None))
