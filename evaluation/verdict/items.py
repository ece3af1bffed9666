"""Items of a section that are decided at once, by simultaneous bands: `verdict.json`.

Each item has an effect theta with its standard error s and replicates that share their
draws of people with all others. The bands theta +- q s of a section hold the truth of
all its items at once in `rules.BAND_COVERAGE` of studies, q being that quantile over
replicates of max |theta* - theta| / s (max-t); where tails are heavy s is larger
(`scale`). An item is decided if its band is on one side of what parts its two answers.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from evaluation.estimates.matching import MIN_DEFINED
from evaluation.plan.constants import horizon_world
from evaluation.verdict import rules
from evaluation.verdict.rules import BETWEEN, NOT_TESTABLE, known
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE, LEAST_CLUSTERS, Estimate

_FAR: Final = 0.99  # Quantile of a deviation that tells how heavy its tails are.
_NORMAL: Final = float(ndtri(0.5 + CONFIDENCE / 2))
_ABOUT: Final = ("adding", "descriptor", "task", "subject", "criterion")


@dataclass(frozen=True, slots=True)
class Draft:
    """An item before its section is decided."""

    adding: str
    effect: Estimate  # As it is tested; logarithms of a ratio.
    parted_at: float  # Value of the effect that parts the two answers.
    above: str
    below: str  # Answers to an effect that is surely larger, and surely smaller.
    unit: str
    sentences: Mapping[str, str]  # By decision, "" all others; ``{}`` is the effect.
    subject: str = ""  # The attack that it is about, if it is about one.
    # Why nothing can be decided, where more than people is lacking.
    untestable: str = ""
    descriptor: str = ""
    task: str = ""
    criterion: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_signed(self) -> bool:
        """Whether the effect is a difference."""
        return self.unit != "ratio" and not self.parted_at

    @property
    def names(self) -> list[str]:
        """What identifies the item in its section, the same in every run."""
        of, mechanism = (
            str(self.details.get(name, "")) for name in ("of", "mechanism")
        )
        horizon_s = self.details.get("horizon_s")
        horizon = "" if horizon_s is None else horizon_world(horizon_s)
        every = (
            self.adding,
            self.criterion,
            horizon,
            of,
            self.descriptor,
            self.task,
            mechanism,
        )
        return [name for name in every if name]

    @property
    def why_not(self) -> str:
        """Why nothing can be decided; empty if something can."""
        error, effective = self.effect.standard_error, self.effect.n_effective
        if self.untestable or not np.isfinite(self.effect.value):
            return self.untestable or "there is no number"
        if np.isfinite(self.effect.replicates).mean() < MIN_DEFINED:
            return "too few draws of the people have this number"
        if effective < FEWEST_EFFECTIVE:
            fewest = f"a decision takes {FEWEST_EFFECTIVE}"
            return f"it rests on {effective:.0f} effective clusters of people, {fewest}"
        return (
            ""
            if error > rules.NO_SPREAD
            else "the people of the run do not differ: no spread"
        )


def decided(section: str, drafts: Iterable[Draft]) -> list[dict[str, Any]]:
    """Return the items of a section as in `verdict.json`."""
    drafts = list(drafts)
    q = critical([one.effect for one in drafts if not one.why_not])
    return [_item(section, one, q) for one in drafts]


def critical(
    effects: Sequence[Estimate], coverage: float = rules.BAND_COVERAGE
) -> float:
    """Return the quantile over replicates of the largest deviation over its scale; 0 without any.

    Replicates of all effects share their draws, row by row; what an effect lacks is not
    counted.
    """
    n_rows = min((one.replicates.size for one in effects), default=0)
    largest = np.zeros(max(n_rows, 1))
    for one in effects:
        away = np.abs(one.replicates[:n_rows] - one.value) / scale(one)
        largest = np.fmax(largest, away)
    return float(np.quantile(largest, coverage))


def scale(effect: Estimate) -> float:
    """Return the unit of a deviation: the standard error, or more where tails are heavier.

    Of a normal law both are the same. An effect that is read where a curve is steep has
    a few wild replicates; with its standard error as the unit, these would widen the
    bands of all others.
    """
    away = np.abs(effect.replicates - effect.value)
    far = (
        float(np.quantile(away[np.isfinite(away)], _FAR))
        if np.isfinite(away).any()
        else 0.0
    )
    return max(effect.standard_error, far / float(ndtri(0.5 + _FAR / 2)))


def around(effect: Estimate, half: float, q: float) -> tuple[float, float]:
    """Return effect +- q halves, q taken from the normal law to Student's: errors of few vary."""
    t = float(stdtrit(max(effect.n_effective - 1.0, 1.0), float(ndtr(q))))
    return effect.value - t * half, effect.value + t * half


def _item(section: str, draft: Draft, q: float) -> dict[str, Any]:
    effect, why = draft.effect, draft.why_not
    is_ratio, is_shown = draft.unit == "ratio", effect.n_effective >= LEAST_CLUSTERS
    error, nothing = effect.standard_error, (np.nan, np.nan)
    low, high = around(effect, error, _NORMAL) if is_shown else nothing
    band_low, band_high = nothing if why else around(effect, scale(effect), q)
    decision = NOT_TESTABLE if why else BETWEEN
    decision = draft.above if band_low > draft.parted_at else decision
    decision = draft.below if band_high < draft.parted_at else decision
    told = [effect.value, low, high, band_low, band_high]
    value, low, high, band_low, band_high = map(
        float, np.exp(told) if is_ratio else told
    )
    if decision == BETWEEN:
        ends = (rules.written(one, draft.unit) for one in (band_low, band_high))
        why = f"the band, over all items of the section, is from {' to '.join(ends)}"
    said = draft.sentences.get(decision, draft.sentences[""])
    number = Estimate(value, low, high)
    shown = rules.with_interval(number, draft.unit, signed=draft.is_signed)
    return {
        "id": "/".join([section, *draft.names]),
        "section": section,
        **{name: getattr(draft, name) for name in _ABOUT},
        "decision": decision,
        "sign": rules.SIGN[decision],
        **rules.numbers(number),
        "band_low": known(band_low),
        "band_high": known(band_high),
        "unit": draft.unit,
        "n": effect.n,
        "sentence": said.replace("{}", shown),
        "why": why,
        **draft.details,
    }
