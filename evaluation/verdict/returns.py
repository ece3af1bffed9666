"""Are people who come back re-identified? The rule's answer as data.

The rule is `isac_track.linkability.return_rule`; it reads the level without error alone.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

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
from evaluation.estimates.json_numbers import json_interval, json_number
from evaluation.estimates.returns import ReturnNumbers
from evaluation.plan.address import Address
from evaluation.plan.consumer import FUSION
from isac_track.intervals import Estimate
from isac_track.linkability.return_rule import (
    PRIMARY,
    ReturnEvidence,
    decide_return,
)

_UNKNOWN: Final = Estimate(math.nan)


def return_verdict(
    numbers: ReturnNumbers, *, confirming: str | None = None
) -> dict[str, Any]:
    """Return the decision with its evidence; empty without the level that decides.

    Ends of an interval that is not there are None. `confirming` names the session that
    was left aside.
    """
    cell = {
        (key.plugin, key.metric): estimate
        for key, estimate in numbers.estimates.items()
        if key.mechanism == CLEAN
    }
    if (FUSION, GAIN) not in cell:
        return {}
    evidence = ReturnEvidence(cell[FUSION, GAIN], cell[FUSION, NESTED_P].value)
    second = None
    if (FUSION, CONFIRMING_GAIN) in cell:
        p_value = cell[FUSION, CONFIRMING_P].value
        second = ReturnEvidence(cell[FUSION, CONFIRMING_GAIN], p_value)
    answer = decide_return(evidence, confirming=second)
    return {
        "decision": answer.decision,
        "why": answer.why,
        "power": json_number(answer.power),
        "n": answer.n,
        "n_needed": answer.n_needed,
        "primary": f"{PRIMARY}, no error",
        "nested_p": evidence.p_value,
        **json_interval("rank1", cell[FUSION, RANK1]),
        "chance": cell[FUSION, CHANCE].value,
        **json_interval("control", cell[STRONGEST, RANK1]),
        "controls": _chosen_controls(numbers.chosen),
        **json_interval("gain", evidence.gain),
        "confirming": confirming,
        **json_interval("confirming_gain", second.gain if second else _UNKNOWN),
        "confirming_p": second.p_value if second else None,
    }


def _chosen_controls(chosen: Mapping[Address, int]) -> dict[str, int]:
    """Return how many people each control was chosen for, the most frequent first."""
    counts = {
        key.control: n for key, n in chosen.items() if key.mechanism == CLEAN and n
    }
    return dict(sorted(counts.items(), key=lambda item: -item[1]))
