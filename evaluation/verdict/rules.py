"""What counts as decided: tests, adjustment and the names of decisions, set before looking.

And what an item of the verdict is made of, and how its numbers are put into words and JSON.

Every effect has a standard error from replicates that draw whole people (clusters), and is tested
against a bound by t with one degree of freedom less than there are clusters. A decision may have
several conditions; its p-value is then the largest of theirs. Items of one section are adjusted by
Holm; each section may err in `SECTION_ALPHA`, so that the whole verdict errs in 5 % of studies in
which there is nothing to find. docs/verdict.md says the same in words.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import stdtr

from evaluation.analysis.metrics import DESCRIPTORS, METRICS
from isac_track.intervals import Estimate
from isac_track.linkability.significance import holm

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

NAME: Final = {name: METRICS[name].head for name in DESCRIPTORS}
TRACKS, WEAKLY, DOES_NOT = "tracks", "tracks weakly", "does not track"
HOLDS, REVERSED = "holds", "reversed"
INFLATED, DEFLATED = "inflated", "deflated"
UNDECIDED = "undecided"
BETWEEN, NOT_TESTABLE = "between", "not testable"
DIFFERS, EQUAL = "differs", "equal"
"""Readings of a contrast by itself."""
SIGN: Final = {
    **dict.fromkeys((TRACKS, WEAKLY, HOLDS, INFLATED), 1),
    **dict.fromkeys((UNDECIDED, BETWEEN, NOT_TESTABLE), 0),
    **dict.fromkeys((DOES_NOT, REVERSED, DEFLATED), -1),
}
"""Of a decision."""

ALPHA: Final = 0.05
"""Of the whole verdict."""
VALIDITY, WITHIN, CLAIM, INFLATION = "validity", "within", "claim", "inflation"
SECTIONS: Final = (VALIDITY, WITHIN, CLAIM, INFLATION)
SECTION_ALPHA: Final = ALPHA / len(SECTIONS)
BAND_COVERAGE: Final = 0.992
"""Share of studies in which the bands of a section (within, claim, inflation) hold all truths."""
SUCCESS_MARGIN: Final = 0.05
"""Difference in rank 1 that counts as none: five people in a hundred."""
WEAK_MARGIN: Final = 0.10
"""Difference in rank 1 up to which a descriptor tracks weakly."""
LEAST_SPAN: Final = 1.25
"""Ratio of a descriptor at raw to that at the strongest fixed error below which it says nothing."""
LEAST_CORRELATION: Final = 0.10
"""Partial rank correlation below which a descriptor tells nothing of a single track."""
LEAST_CLUSTERS: Final = 8
LEAST_FALL: Final = 0.20
"""Of linkage, from raw to the strongest fixed error: where it falls less, anything would track."""
FEWEST_DISCORDANT: Final = 10
"""People linked under one of two mechanisms only: with fewer the interval is that of counts."""
FEWEST_SHOWN, FEWEST_EFFECTIVE = 15, 20
"""Effective clusters, n^2 / sum m^2: for an interval, and for a decision."""
REACH: Final = 0.02
"""Share of a descriptor's span by which a point may lie beyond the end of the fixed sweep."""
_LEAST_SE = 1e-9


def is_known(one: Estimate) -> bool:
    """Return whether there is a number, a spread, and enough people."""
    known = np.isfinite([one.value, one.standard_error]).all()
    return bool(known) and one.n >= LEAST_CLUSTERS


def p_above(one: Estimate, bound: float) -> float:
    """Return the p-value of 'no more than the bound': small if the effect is surely above."""
    return _tail(one, bound - one.value)


def p_below(one: Estimate, bound: float) -> float:
    """Return the p-value of 'no less than the bound'."""
    return _tail(one, one.value - bound)


def p_within(one: Estimate, margin: float) -> float:
    """Return the p-value of two one-sided tests: small if surely within the margin of zero."""
    return max(p_below(one, margin), p_above(one, -margin))


def p_beyond(one: Estimate, margin: float) -> float:
    """Return the p-value of 'within the margin': small if surely beyond it, on either side."""
    return min(1.0, sum(_tail(one, -abs(one.value) - end) for end in (-margin, margin)))


def _tail(one: Estimate, distance: float) -> float:
    """Return how much of t lies below a distance; 1 if nothing is known."""
    if not is_known(one):
        return 1.0
    return float(stdtr(one.n - 1, distance / max(one.standard_error, _LEAST_SE)))


def decide(
    items: Sequence[Mapping[str, float]], *, alpha: float = SECTION_ALPHA
) -> list[tuple[str, float, float]]:
    """Return decision, p-value and adjusted p-value of every item of a section (Holm).

    An item is tested by its likeliest option, its p-value doubled: two of its decisions contradict
    each other, and neither may be come to by chance. Of the options that pass at the item's place
    the first one named is the decision. Without one the item is undecided.

    `items` are of each item the decisions that it may come to, in the order of precedence, each
    with the p-value of all its conditions; `alpha` is the share of studies in which it may err.
    """
    p_values = np.array([min(1.0, 2.0 * min(options.values())) for options in items])
    found = []
    for options, p_value, final in zip(items, p_values, holm(p_values), strict=True):
        decision = UNDECIDED
        if final <= alpha:
            # At its place in Holm's order an option passes if the item would with it alone.
            factor = final / p_value if p_value > 0 else 1.0
            decision = next(name for name, p in options.items() if 2.0 * p * factor <= alpha)
        found.append((decision, float(p_value), float(final)))
    return found


@dataclass(frozen=True, slots=True)
class Draft:
    """An item before the section it belongs to is adjusted and decided."""

    adding: str
    subject: str
    """The attack that it is about, if it is about one."""
    effect: Estimate
    unit: str
    options: Mapping[str, float]
    """Decisions that it may come to, in the order of precedence: the p-value of each."""
    sentences: Mapping[str, str]
    """By decision; what an undecided item says is its number."""
    why_undecided: str
    descriptor: str = ""
    task: str = ""
    criterion: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """What identifies the item in its section, the same in every run."""
        of, mechanism = (str(self.details.get(name, "")) for name in ("of", "mechanism"))
        every = (self.adding, self.criterion, of, self.descriptor, self.task, mechanism)
        return [name for name in every if name]


def numbers(one: Estimate) -> dict[str, Any]:
    """Return an effect as in `verdict.json`."""
    ends = {name: known(getattr(one, name)) for name in ("ci_low", "ci_high")}
    return {"effect": known(one.value), **ends}


def known(value: float) -> float | None:
    """Return a number, or None for NaN, which JSON has not."""
    return float(value) if np.isfinite(value) else None


def with_interval(one: Estimate, unit: str, *, signed: bool = False, absolute: bool = False) -> str:
    """Return an effect with its interval as people write it: +3.1 points [+1.0, +5.2].

    `unit` is `fraction` in points of a hundred, `share` the same as a bare number, `s`, `ratio` or
    `correlation`; `absolute` turns it so that the effect is positive.
    """
    scale, digits = (100.0, 1) if unit in {"fraction", "share"} else (1.0, 2)
    found = [scale * number for number in (one.value, one.ci_low, one.ci_high)]
    if absolute and one.value < 0:
        found = [-found[0], -found[2], -found[1]]
    if not np.isfinite(found[0]):
        return "unknown"
    value, low, high = (f"{number:{'+' if signed else ''}.{digits}f}" for number in found)
    word = {"fraction": " points", "s": " s", "ratio": " times"}.get(unit, "")
    return f"{value}{word} [{low}, {high}]" if np.isfinite(found[1:]).all() else f"{value}{word}"


def written(value: float, unit: str) -> str:
    """Return a number as people write it, with its unit; units are those of `with_interval`."""
    return with_interval(Estimate(value), unit, signed=unit != "ratio")


def listed(words: Sequence[str]) -> str:
    """Return words as people list them: a, b and c."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))
