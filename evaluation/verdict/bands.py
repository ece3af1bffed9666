"""Items of a section, decided together by simultaneous bands.

Each item has an effect theta with its standard error s and replicates that share their
draws of people with all other items. The bands theta +- q s of a section hold the truth
of all its items at once in `rules.BAND_COVERAGE` of studies. Here q is that quantile
over replicates of max |theta* - theta| / s (max-t); where tails are heavy s is larger
(`deviation_unit`). An item is decided if its band lies on one side of the value that
parts its two answers.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from evaluation.estimates.interpolation import MIN_DEFINED
from evaluation.verdict import rules
from evaluation.verdict.items import BandItem, Details, Topic
from evaluation.verdict.number_text import with_interval, without_interval
from evaluation.verdict.rules import BETWEEN, NOT_TESTABLE
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE, LEAST_CLUSTERS, Estimate

_FAR: Final = 0.99  # Quantile of a deviation that shows how heavy its tails are.
_NORMAL: Final = float(ndtri(0.5 + CONFIDENCE / 2))


@dataclass(frozen=True, slots=True)
class Draft:
    """An item before its section is decided: an effect, and what its sides mean."""

    topic: Topic
    effect: Estimate  # As it is tested: the logarithm of a ratio.
    parted_at: float  # Value of the effect that parts the two answers.
    above: str  # Answer to an effect that is surely larger.
    below: str  # Answer to an effect that is surely smaller.
    unit: str  # As in `BandItem`.
    sentences: Mapping[str, str]  # By decision, "" all others; ``{}`` is the effect.
    # Reason that nothing can be decided, other than too few people.
    untestable: str = ""
    details: Details = None

    @property
    def is_ratio(self) -> bool:
        """Whether the effect is the logarithm of a ratio."""
        return self.unit == "ratio"

    @property
    def is_signed(self) -> bool:
        """Whether the effect is a difference."""
        return not self.is_ratio and not self.parted_at

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


def decide_section(drafts: Iterable[Draft]) -> list[BandItem]:
    """Return the items of all drafts of a section, which share a band quantile."""
    drafts = list(drafts)
    q = band_quantile([draft.effect for draft in drafts if not draft.why_not])
    return [_decide(draft, q) for draft in drafts]


def band_quantile(
    effects: Sequence[Estimate], coverage: float = rules.BAND_COVERAGE
) -> float:
    """Return the quantile of the largest deviation over its unit; 0 without effects.

    Replicates of all effects share their draws, row by row; missing replicates of an
    effect are not counted.
    """
    n_rows = min((effect.replicates.size for effect in effects), default=0)
    largest = np.zeros(max(n_rows, 1))
    for effect in effects:
        deviation = np.abs(effect.replicates[:n_rows] - effect.value)
        largest = np.fmax(largest, deviation / deviation_unit(effect))
    return float(np.quantile(largest, coverage))


def deviation_unit(effect: Estimate) -> float:
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


def interval_around(effect: Estimate, error: float, q: float) -> tuple[float, float]:
    """Return effect +- q standard errors; q goes from the normal law to Student's t.

    The standard errors of few clusters vary.
    """
    t = float(stdtrit(max(effect.n_effective - 1.0, 1.0), float(ndtr(q))))
    return effect.value - t * error, effect.value + t * error


def _decide(draft: Draft, q: float) -> BandItem:
    """Return the item of a draft; `q` is the band quantile of its section."""
    effect, why = draft.effect, draft.why_not
    low, high = np.nan, np.nan
    if effect.n_effective >= LEAST_CLUSTERS:
        low, high = interval_around(effect, effect.standard_error, _NORMAL)
    band_low, band_high = np.nan, np.nan
    if not why:
        band_low, band_high = interval_around(effect, deviation_unit(effect), q)
    decision = NOT_TESTABLE if why else BETWEEN
    if band_low > draft.parted_at:
        decision = draft.above
    if band_high < draft.parted_at:
        decision = draft.below
    numbers = np.array([effect.value, low, high, band_low, band_high])
    if draft.is_ratio:
        numbers = np.exp(numbers)
    value, low, high, band_low, band_high = numbers.tolist()
    if decision == BETWEEN:
        ends = (without_interval(end, draft.unit) for end in (band_low, band_high))
        why = f"the band, over all items of the section, is from {' to '.join(ends)}"
    written_effect = Estimate(value, low, high, effect.n)
    sentence = draft.sentences.get(decision, draft.sentences[""])
    shown = with_interval(written_effect, draft.unit, signed=draft.is_signed)
    return BandItem(
        topic=draft.topic,
        decision=decision,
        effect=written_effect,
        band_low=band_low,
        band_high=band_high,
        unit=draft.unit,
        sentence=sentence.replace("{}", shown),
        why=why,
        details=draft.details,
    )
