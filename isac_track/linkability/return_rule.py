"""Decide whether people who come back are re-identified by their walk.

The rule was fixed before any result on real people was known. It rests on a single
primary cell (`PRIMARY`); whatever else is computed is exploratory.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from scipy.special import ndtri, stdtr, stdtrit

from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE, Estimate

Decision: TypeAlias = Literal["yes", "no", "not decided"]
"""Answer to: does the walk re-identify a person in another session?"""

PRIMARY: Final = "fusion, all passages enrolled, closed set, another run"
"""The only cell that decides: linker, gallery, set and probe."""
LARGEST_P: Final = 0.01
"""A *yes* needs a nested permutation p-value below this number."""
LARGEST_P_CONFIRMING: Final = 0.05
"""The same for the session that confirms: a single test, on new people and new walks."""
LEAST_GAIN: Final = 0.05
"""Gain in rank 1 over the control that matters: the interval is compared with it."""
TRUE_GAIN: Final = 0.15
"""Gain for which `power` and `n_needed` are stated."""
POWER: Final = 0.80
"""Probability with which `n_needed` people show `TRUE_GAIN`."""


@dataclass(frozen=True, eq=False, slots=True)
class ReturnEvidence:
    """Numbers of the primary cell.

    Attributes
    ----------
    gain : Estimate
        Rank 1 of the fusion less that of the control, paired by person, -1..1; `n`
        counts people. The control of a person is chosen on other people.
    p_value : float
        Nested permutation p-value of being the same person beyond all controls, 0..1.
    """

    gain: Estimate
    p_value: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.p_value <= 1.0:
            raise ValueError(f"a p-value lies in 0..1, got {self.p_value}")


@dataclass(frozen=True, slots=True)
class ReturnDecision:
    """An answer, its reason, and what these people could have shown.

    Attributes
    ----------
    decision : str
        ``yes``, ``no`` or ``not decided``.
    why : str
        The numbers that decide, in words.
    power : float
        Probability that so many people give a *yes* if the true gain is `TRUE_GAIN`
        and a session confirms it; NaN without an interval.
    n : int
        People in the primary cell.
    n_needed : int or None
        People for whom that probability is `POWER`; None without an interval.
    """

    decision: Decision
    why: str
    power: float
    n: int
    n_needed: int | None


def decide_return(
    evidence: ReturnEvidence, *, confirming: ReturnEvidence | None = None
) -> ReturnDecision:
    """Apply the rule to the primary cell; `confirming` is that of a session left aside.

    - *yes*: the p-value is below `LARGEST_P`, the lower end of the gain's interval is
      at least `LEAST_GAIN`, and the confirming session has a positive gain with a p-value
      below `LARGEST_P_CONFIRMING`;
    - *no*: the upper end of the interval is below `LEAST_GAIN`;
    - *not decided* otherwise, without an interval, and below `FEWEST_EFFECTIVE` people.

    Examples
    --------
    >>> from isac_track.intervals import Estimate
    >>> from isac_track.linkability.return_rule import ReturnEvidence, decide_return
    >>> few = ReturnEvidence(Estimate(0.10, -0.05, 0.25, n=25), p_value=0.03)
    >>> answer = decide_return(few)
    >>> answer.decision, answer.n, answer.n_needed > 25
    ('not decided', 25, True)
    """
    gain, n = evidence.gain, evidence.gain.n
    power, n_needed = return_power(gain)
    decision, why = _apply(evidence, confirming)
    if decision == "not decided" and n_needed is not None:
        why += (
            f"; {n_needed} people would show a gain of {100 * TRUE_GAIN:.0f} points"
            f" with a probability of {POWER:g}"
        )
    return ReturnDecision(decision, why, power, n, n_needed)


def _apply(
    evidence: ReturnEvidence, confirming: ReturnEvidence | None
) -> tuple[Decision, str]:
    """Return the decision and its reason, without power."""
    gain = evidence.gain
    if gain.n < FEWEST_EFFECTIVE or not math.isfinite(gain.ci_low + gain.ci_high):
        few = f"{gain.n} people are too few: at least {FEWEST_EFFECTIVE} decide"
        return "not decided", few
    low, high, least = (100.0 * x for x in (gain.ci_low, gain.ci_high, LEAST_GAIN))
    interval = f"the gain over the control is {low:.0f} to {high:.0f} points"
    if gain.ci_high < LEAST_GAIN:
        return "no", f"{interval}, below {least:.0f}"
    if gain.ci_low < LEAST_GAIN:
        return "not decided", f"{interval}, which includes {least:.0f}"
    doubt = _doubt(evidence.p_value, confirming)
    if doubt:
        return "not decided", f"{interval}, but {doubt}"
    confirmed = f"p = {evidence.p_value:.3f}, and a further run confirms it"
    return "yes", f"{interval}, {confirmed}"


def awaits_confirmation(evidence: ReturnEvidence) -> bool:
    """Whether a further session could turn the answer into a *yes*."""
    interval = (evidence.gain.ci_low, evidence.gain.ci_high)
    return (
        evidence.gain.n >= FEWEST_EFFECTIVE
        and all(math.isfinite(end) for end in interval)
        and interval[0] >= LEAST_GAIN
        and evidence.p_value < LARGEST_P
    )


def _doubt(p_value: float, confirming: ReturnEvidence | None) -> str:
    """Return what stands against a *yes* although the interval allows it, or ``""``."""
    if p_value >= LARGEST_P:
        return f"p = {p_value:.3f} beyond all controls"
    if confirming is None:
        return "no further run confirms it"
    if confirming.gain.value <= 0 or confirming.p_value >= LARGEST_P_CONFIRMING:
        gain = 100.0 * confirming.gain.value
        return f"a further run has {gain:.0f} points, p = {confirming.p_value:.3f}"
    return ""


def return_power(gain: Estimate) -> tuple[float, int | None]:
    """Return the power at `TRUE_GAIN`, and the people needed for `POWER`.

    The measured gain has the standard error s / sqrt(n), of which the half width of its
    interval tells s. At a true gain d a person's difference has at least the variance
    d - d^2, that of a trial; s is at least its root. The lower end reaches
    `LEAST_GAIN` with the probability T((d - `LEAST_GAIN`) sqrt(n) / s - t), t the
    quantile of the interval; the permutation test asks for less and is left out. NaN
    and None without an interval.
    """
    half = (gain.ci_high - gain.ci_low) / 2.0
    if not math.isfinite(half) or gain.n < 2:  # noqa: PLR2004 - degrees of freedom
        return math.nan, None
    margin = TRUE_GAIN - LEAST_GAIN
    tail = 0.5 + CONFIDENCE / 2.0
    quantile = float(stdtrit(gain.n - 1.0, tail))
    least_std = math.sqrt(TRUE_GAIN - TRUE_GAIN**2)
    std = max(half / quantile * math.sqrt(gain.n), least_std)
    power = float(stdtr(gain.n - 1.0, margin * math.sqrt(gain.n) / std - quantile))
    n_needed = math.ceil(
        ((float(ndtri(tail)) + float(ndtri(POWER))) * std / margin) ** 2
    )
    return power, max(n_needed, FEWEST_EFFECTIVE)
