"""Rules of the verdict: margins, the fewest people, and the names of decisions.

All of them were set before looking at results. The texts and JSON numbers of an item
are here, too. The decision itself is in `spread` (validity) and `items` (all else);
docs/explanation/verdict.md describes it.
"""

from typing import Any, Final

import numpy as np

from evaluation.estimates.json_numbers import json_interval
from evaluation.estimates.metrics import DESCRIPTORS, METRICS
from isac_track.intervals import Estimate

NAME: Final = {name: METRICS[name].head for name in DESCRIPTORS}
TRACKS, DOES_NOT = "tracks", "does not track"
HOLDS, REVERSED = "holds", "reversed"
INFLATED, DEFLATED = "inflated", "deflated"
BETWEEN, NOT_TESTABLE = "between", "not testable"
DIFFERS, EQUAL = "differs", "equal"  # Readings of a contrast by itself.
SIGN: Final = {  # Of a decision.
    **dict.fromkeys((TRACKS, HOLDS, INFLATED), 1),
    **dict.fromkeys((BETWEEN, NOT_TESTABLE), 0),
    **dict.fromkeys((DOES_NOT, REVERSED, DEFLATED), -1),
}

VALIDITY, WITHIN, CLAIM, INFLATION = "validity", "within", "claim", "inflation"
SECTIONS: Final = (VALIDITY, WITHIN, CLAIM, INFLATION)
# Share of studies in which the bands of a section hold all truths.
BAND_COVERAGE: Final = 0.992
# Largest difference in rank 1 that counts as none: five people in a hundred.
SUCCESS_MARGIN: Final = 0.05
# Least ratio of a descriptor, raw over the strongest fixed error, for a decision.
LEAST_SPAN: Final = 1.25
LEAST_CORRELATION: Final = 0.10  # Partial rank correlation that tells something.
# Least fall of linkage from raw to the strongest fixed error: with less, any descriptor
# would track.
LEAST_FALL: Final = 0.20
# Fewest people linked under only one of two mechanisms; fewer: interval of counts.
FEWEST_DISCORDANT: Final = 10
NO_SPREAD: Final = 1e-9  # Standard error below which replicates show nothing.
MOST_PEOPLE: Final = 100_000  # More people than any recording has.
_UNREALISTIC: Final = "no realistic number of"
# Share of its span by which a point may lie beyond the fixed sweep.
REACH: Final = 0.02


def is_flat_miss(decision: str, spread_low: float | None) -> bool:
    """Return whether an item does not track only because its descriptor is flat.

    `spread.decided` has two grounds for `DOES_NOT`: a spread that is surely above the
    margin, or linkage that falls while the descriptor hardly changes. Without the first
    it was the second.
    """
    return decision == DOES_NOT and (spread_low or 0.0) <= SUCCESS_MARGIN


def is_realistic(n: float) -> bool:
    """Return whether a recording can have so many people."""
    return n < MOST_PEOPLE


def people_amount(n: float) -> str:
    """Return a number of people in words, to two digits, for "... people"."""
    return f"about {float(f'{n:.2g}'):,.0f}" if is_realistic(n) else _UNREALISTIC


def numbers(effect: Estimate) -> dict[str, Any]:
    """Return an effect as in `verdict.json`."""
    return json_interval("effect", effect, ends="ci")


def with_interval(
    effect: Estimate, unit: str, *, signed: bool = False, absolute: bool = False
) -> str:
    """Return an effect with its interval as people write it: +3.1 points [+1.0, +5.2].

    `unit` is `fraction` (in points of a hundred), `share` (the same as a bare number),
    `s`, `ratio` or `correlation`; `absolute` turns the sign so that the effect is
    positive.
    """
    scale, digits = (100.0, 1) if unit in {"fraction", "share"} else (1.0, 2)
    interval = [
        scale * number for number in (effect.value, effect.ci_low, effect.ci_high)
    ]
    if absolute and effect.value < 0:
        interval = [-interval[0], -interval[2], -interval[1]]
    if not np.isfinite(interval[0]):
        return "unknown"
    sign = "+" if signed else "-"
    value, low, high = (f"{number:{sign}.{digits}f}" for number in interval)
    word = {"fraction": " points", "s": " s", "ratio": " times"}.get(unit, "")
    if not np.isfinite(interval[1:]).all():
        return f"{value}{word}"
    return f"{value}{word} [{low}, {high}]"


def written(value: float, unit: str) -> str:
    """Return a number as people write it, with one of the units of `with_interval`."""
    return with_interval(Estimate(value), unit, signed=unit != "ratio")
