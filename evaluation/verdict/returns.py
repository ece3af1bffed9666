"""Are people who come back re-identified? The rule's answer as a record.

The rule is `isac_track.linkability.return_rule`; it reads only the level without sensing
error (`clean`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from evaluation.compute.return_columns import (
    CHANCE,
    CONFIRMING_GAIN,
    CONFIRMING_P,
    GAIN,
    NESTED_P,
    RANK1,
    STRONGEST,
)
from evaluation.estimates.families import CLEAN
from evaluation.estimates.json_numbers import (
    json_interval,
    json_number,
    read_interval,
    read_number,
)
from evaluation.estimates.returns import ReturnNumbers
from evaluation.plan.address import Address
from evaluation.plan.consumer import FUSION
from isac_track.intervals import Estimate
from isac_track.linkability.return_rule import (
    PRIMARY,
    ReturnEvidence,
    decide_return,
)


@dataclass(frozen=True, slots=True)
class ReturnAnswer:
    """Whether people who come back are re-identified, with the evidence.

    Shares are fractions of people; an unknown number is NaN.
    """

    decision: str  # `yes`, `no` or `not decided`.
    why: str
    power: float  # Probability of a yes, if the true gain is `return_rule.TRUE_GAIN`.
    n: int  # People.
    n_needed: int | None  # People for whom the power suffices.
    nested_p: float  # P-value of being the same person beyond all controls.
    rank1: Estimate  # Rank 1 of the fusion of all linkers.
    chance: float  # Rank 1 by guessing.
    control: Estimate  # Rank 1 of the strongest control.
    controls: Mapping[str, int]  # By control, for how many people it is the strongest.
    gain: Estimate  # Rank 1 of the fusion less that of the control.
    confirming: str | None  # Session that was left aside, if any.
    confirming_gain: Estimate
    confirming_p: float | None  # As `nested_p`; None without such a session.


def return_answer(
    numbers: ReturnNumbers, *, confirming: str | None = None
) -> ReturnAnswer | None:
    """Return the decision with its evidence; None without the level that decides.

    `confirming` names the session that was left aside.
    """
    cell = {
        (key.plugin, key.metric): estimate
        for key, estimate in numbers.estimates.items()
        if key.mechanism == CLEAN
    }
    if (FUSION, GAIN) not in cell:
        return None
    evidence = ReturnEvidence(cell[FUSION, GAIN], cell[FUSION, NESTED_P].value)
    second = None
    if (FUSION, CONFIRMING_GAIN) in cell:
        p_value = cell[FUSION, CONFIRMING_P].value
        second = ReturnEvidence(cell[FUSION, CONFIRMING_GAIN], p_value)
    answer = decide_return(evidence, confirming=second)
    return ReturnAnswer(
        decision=answer.decision,
        why=answer.why,
        power=answer.power,
        n=answer.n,
        n_needed=answer.n_needed,
        nested_p=evidence.p_value,
        rank1=cell[FUSION, RANK1],
        chance=cell[FUSION, CHANCE].value,
        control=cell[STRONGEST, RANK1],
        controls=_chosen_controls(numbers.chosen),
        gain=evidence.gain,
        confirming=confirming,
        confirming_gain=second.gain if second else Estimate(math.nan),
        confirming_p=second.p_value if second else None,
    )


def return_json(answer: ReturnAnswer) -> dict[str, Any]:
    """Return an answer as in `verdict.json`, where an unknown number is null."""
    return {
        "decision": answer.decision,
        "why": answer.why,
        "power": json_number(answer.power),
        "n": answer.n,
        "n_needed": answer.n_needed,
        "primary": f"{PRIMARY}, no error",
        "nested_p": json_number(answer.nested_p),
        **json_interval("rank1", answer.rank1),
        "chance": json_number(answer.chance),
        **json_interval("control", answer.control),
        "controls": dict(answer.controls),
        **json_interval("gain", answer.gain),
        "confirming": answer.confirming,
        **json_interval("confirming_gain", answer.confirming_gain),
        "confirming_p": json_number(answer.confirming_p),
    }


def read_return(verdict: Mapping[str, Any]) -> ReturnAnswer | None:
    """Return the answer in a verdict; None without people who come back."""
    content = verdict.get("returns")
    if not content:
        return None
    return ReturnAnswer(
        decision=content["decision"],
        why=content["why"],
        power=read_number(content["power"]),
        n=content["n"],
        n_needed=content["n_needed"],
        nested_p=read_number(content["nested_p"]),
        rank1=read_interval(content, "rank1"),
        chance=read_number(content["chance"]),
        control=read_interval(content, "control"),
        controls=content["controls"],
        gain=read_interval(content, "gain"),
        confirming=content["confirming"],
        confirming_gain=read_interval(content, "confirming_gain"),
        confirming_p=content["confirming_p"],
    )


def _chosen_controls(chosen: Mapping[Address, int]) -> dict[str, int]:
    """Return how many people each control was chosen for, the most frequent first."""
    counts = {
        key.control: n for key, n in chosen.items() if key.mechanism == CLEAN and n
    }
    return dict(sorted(counts.items(), key=lambda item: -item[1]))
