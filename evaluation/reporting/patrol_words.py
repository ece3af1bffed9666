"""What to disclose to robots on patrol, in words: for first screen, page and `design`."""

import math
from collections.abc import Mapping
from typing import Any, Final

from evaluation.estimates.families import Family
from evaluation.reporting.amounts import PERCENT, listed, whole_percent
from evaluation.reporting.lookups import find_family
from evaluation.reporting.names import mechanism_name, mechanism_phrase, robot_subject
from evaluation.reporting.rows import Results
from evaluation.verdict.patrol_json import read_proposal
from evaluation.verdict.patrol_records import PatrolOption, PatrolProposal
from evaluation.verdict.patrols import Lacking

NO_INTERVALS: Final = "no intervals: few routes or people"


_LACKS: Final[Mapping[Lacking, str]] = {
    "": "nothing to compare; add --policy everything --policy state:2",
    "robots": "no robot patrols; add --predictor kalman_cv",
    "raw everything": (
        "others are compared with raw positions of everybody; add --policy +everything"
        " --mechanism +raw"
    ),
    "conflicts": (
        "no robot meets anybody; add --set patrol.fleets=20 or --set patrol.segment_s=inf"
    ),
}
"""What a run lacks for a proposal, and which option adds it."""


def patrol_sentence(run: Results) -> str:
    """Return the policy and mechanism that a run proposes for patrols.

    Where it proposes none the sentence says why; it is empty without patrols.
    """
    patrols = run.verdict.get("patrols", {})
    if proposal := read_proposal(patrols):
        return proposal_sentence(proposal, families=run.families)
    lacks = patrols.get("lacks", "")
    return f"Nothing is proposed: {_LACKS[lacks]}." if lacks else ""


def lacking_text(patrols: Mapping[str, Any]) -> str:
    """Return what a run without a proposal lacks; `patrols` is of `verdict.json`."""
    return f"{_LACKS[patrols.get('lacks', '')]}."


def proposal_sentence(
    proposal: PatrolProposal, *, families: Mapping[str, Family]
) -> str:
    """Return what a log reveals under a proposal, or why there is none.

    The limits stand in its first sentence, since the first screen drops last sentences
    where it lacks room.
    """
    everything, option = proposal.everything, proposal.option
    limits = listed([*_limit_texts(proposal).values()])
    certainty = "" if proposal.has_interval else f"; {NO_INTERVALS}"
    counted = (
        f"Conflicts{ahead_text(proposal.horizon_s)} are counted, at equal false"
        f" alarms{certainty}."
    )
    if not proposal.is_within:
        failing = listed(_excess_texts(proposal))
        return (
            f"No policy of this run keeps within the limits: {limits}. The nearest is"
            f" {_option_text(option, families)}: {failing}. {counted}"
        )
    all_sent = f"{whole_percent(everything.known.value)} of person-time"
    if option.is_reference:
        return (
            f"A log of all answers knows {all_sent}, and no policy of this run lowers"
            f" that within the limits: {limits}. {counted}"
        )
    return (
        f"Under {_option_text(option, families)} a log knows"
        f" {whole_percent(option.known.value)} instead of {all_sent}, if {limits}."
        f" {counted}"
    )


def shared_name(
    mechanism: str, level: float | None, families: Mapping[str, Family]
) -> str:
    """Return the name of a mechanism at a level."""
    return mechanism_name(find_family(families, mechanism), level)


def ahead_text(horizon_s: float | None) -> str:
    """Return a further horizon behind the word conflicts; empty for the run's own."""
    return f" within {horizon_s:g} s" if horizon_s else ""


def _option_text(option: PatrolOption, families: Mapping[str, Family]) -> str:
    family = find_family(families, option.mechanism)
    return f"policy {option.policy} with {mechanism_phrase(family, option.level)}"


def _limit_texts(proposal: PatrolProposal) -> dict[str, str]:
    """Return the limits of a proposal, each as a clause, by name."""
    robot = f"{robot_subject(proposal.robot)} may miss"
    texts = {
        "lost": f"{robot} {{points:.4g}} points more conflicts",
        "missed": f"{robot} {{points:.4g}} % of conflicts",
        "known": "a log may know {points:.4g} % of person-time",
        "followed": "a log may follow {points:.4g} % of people for 10 s",
    }
    return {
        name: texts[name].format(points=PERCENT * limit)
        for name, limit in proposal.limits.named.items()
    }


def _excess_texts(proposal: PatrolProposal) -> list[str]:
    """Return the limits that its option exceeds, each with its upper end."""
    robot = robot_subject(proposal.robot)
    texts = {
        "lost": f"{robot} misses up to {{}} more",
        "missed": f"{robot} misses up to {{}}",
        "known": "a log knows up to {}",
        "followed": "a log follows up to {}",
    }
    return [
        texts[name].format(
            "an unknown share" if math.isnan(upper) else whole_percent(upper)
        )
        for name, upper in proposal.option.exceeded(proposal.limits).items()
    ]
