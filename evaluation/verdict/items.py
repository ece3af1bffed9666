"""Items of a section, decided together by simultaneous bands: `verdict.json`.

Each item has an effect theta with its standard error s and replicates that share their
draws of people with all other items. The bands theta +- q s of a section hold the truth
of all its items at once in `rules.BAND_COVERAGE` of studies. Here q is that quantile
over replicates of max |theta* - theta| / s (max-t); where tails are heavy s is larger
(`scale`). An item is decided if its band lies on one side of the value that parts its
two answers.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from evaluation.estimates.interpolation import MIN_DEFINED
from evaluation.estimates.json_numbers import json_number
from evaluation.plan.world import World
from evaluation.verdict import rules
from evaluation.verdict.rules import BETWEEN, NOT_TESTABLE
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE, LEAST_CLUSTERS, Estimate

_FAR: Final = 0.99  # Quantile of a deviation that shows how heavy its tails are.
_NORMAL: Final = float(ndtri(0.5 + CONFIDENCE / 2))
_ABOUT: Final = ("adding", "descriptor", "task", "subject", "criterion")


@dataclass(frozen=True, slots=True)
class Draft:
    """An item before its section is decided."""

    adding: str
    effect: Estimate  # As it is tested; logarithms of a ratio.
    parted_at: float  # Value of the effect that parts the two answers.
    above: str  # Answer to an effect that is surely larger.
    below: str  # Answer to an effect that is surely smaller.
    unit: str
    sentences: Mapping[str, str]  # By decision, "" all others; ``{}`` is the effect.
    subject: str = ""  # The attack of the item, if it has any.
    # Reason that nothing can be decided, other than too few people.
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
        """Parts of the item's identity in its section, the same in every run."""
        kind, mechanism = (
            str(self.details.get(name, "")) for name in ("of", "mechanism")
        )
        horizon_s = self.details.get("horizon_s")
        horizon = World(horizon_s=horizon_s).text
        parts = (
            self.adding,
            self.criterion,
            horizon,
            kind,
            self.descriptor,
            self.task,
            mechanism,
        )
        return [name for name in parts if name]

    @property
    def why_not(self) -> str:
        """Reason that nothing can be decided; empty if something can."""
        error, effective = self.effect.standard_error, self.effect.n_effective
        if self.untestable or not np.isfinite(self.effect.value):
            return self.untestable or "there is no number"
        if np.isfinite(self.effect.replicates).mean() < MIN_DEFINED:
            return "too few draws of the people have this number"
        if effective < FEWEST_EFFECTIVE:
            fewest = f"a decision takes {FEWEST_EFFECTIVE}"
            return f"it rests on {effective:.0f} effective clusters of people, {fewest}"
        if not error > rules.NO_SPREAD:
            return "the people of the run do not differ: no spread"
        return ""


def decided_items(section: str, drafts: Iterable[Draft]) -> list[dict[str, Any]]:
    """Return the items of a section as in `verdict.json`."""
    drafts = list(drafts)
    q = band_quantile([draft.effect for draft in drafts if not draft.why_not])
    return [_item(section, draft, q) for draft in drafts]


def band_quantile(
    effects: Sequence[Estimate], coverage: float = rules.BAND_COVERAGE
) -> float:
    """Return the quantile of the largest deviation over its scale; 0 without effects.

    Replicates of all effects share their draws, row by row; missing replicates of an
    effect are not counted.
    """
    n_rows = min((effect.replicates.size for effect in effects), default=0)
    largest = np.zeros(max(n_rows, 1))
    for effect in effects:
        away = np.abs(effect.replicates[:n_rows] - effect.value) / scale(effect)
        largest = np.fmax(largest, away)
    return float(np.quantile(largest, coverage))


def scale(effect: Estimate) -> float:
    """Return the unit of a deviation: the standard error, or more with heavy tails.

    For a normal law both are the same. An effect that is read where a curve is steep
    has a few wild replicates; with the standard error as the unit, these would widen
    the bands of all other effects.
    """
    deviation = np.abs(effect.replicates - effect.value)
    known_deviation = deviation[np.isfinite(deviation)]
    if not known_deviation.size:
        return max(effect.standard_error, 0.0)
    far = float(np.quantile(known_deviation, _FAR))
    return max(effect.standard_error, far / float(ndtri(0.5 + _FAR / 2)))


def around(effect: Estimate, error: float, q: float) -> tuple[float, float]:
    """Return effect +- q standard errors; q goes from the normal law to Student's t.

    The standard errors of few clusters vary.
    """
    t = float(stdtrit(max(effect.n_effective - 1.0, 1.0), float(ndtr(q))))
    return effect.value - t * error, effect.value + t * error


def _item(section: str, draft: Draft, q: float) -> dict[str, Any]:
    effect, why = draft.effect, draft.why_not
    low, high = np.nan, np.nan
    if effect.n_effective >= LEAST_CLUSTERS:
        low, high = around(effect, effect.standard_error, _NORMAL)
    band_low, band_high = np.nan, np.nan
    if not why:
        band_low, band_high = around(effect, scale(effect), q)
    decision = NOT_TESTABLE if why else BETWEEN
    if band_low > draft.parted_at:
        decision = draft.above
    if band_high < draft.parted_at:
        decision = draft.below
    numbers = np.array([effect.value, low, high, band_low, band_high])
    if draft.unit == "ratio":
        numbers = np.exp(numbers)
    value, low, high, band_low, band_high = numbers.tolist()
    if decision == BETWEEN:
        ends = (rules.written(end, draft.unit) for end in (band_low, band_high))
        why = f"the band, over all items of the section, is from {' to '.join(ends)}"
    sentence = draft.sentences.get(decision, draft.sentences[""])
    number = Estimate(value, low, high)
    shown = rules.with_interval(number, draft.unit, signed=draft.is_signed)
    return {
        "id": "/".join([section, *draft.names]),
        "section": section,
        **{name: getattr(draft, name) for name in _ABOUT},
        "decision": decision,
        "sign": rules.SIGN[decision],
        **rules.numbers(number),
        "band_low": json_number(band_low),
        "band_high": json_number(band_high),
        "unit": draft.unit,
        "n": effect.n,
        "sentence": sentence.replace("{}", shown),
        "why": why,
        **draft.details,
    }
