"""What counts as decided: margins, the least of people, and the names of decisions.

All was set before looking. How an item of the verdict is told, in words and in JSON, is
here, too; what decides it is in `spread` (validity) and `items` (all else), in words in
docs/verdict.md.
"""

from typing import Any, Final

import numpy as np

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
# Difference in rank 1 that counts as none: five people in a hundred.
SUCCESS_MARGIN: Final = 0.05
# Of a descriptor, raw over the strongest fixed error: less says nothing.
LEAST_SPAN: Final = 1.25
LEAST_CORRELATION: Final = 0.10  # Partial, of ranks: less tells nothing of a track.
# Of linkage, raw to the strongest fixed error: else anything would track.
LEAST_FALL: Final = 0.20
# People linked under one of two only; fewer: interval of counts.
FEWEST_DISCORDANT: Final = 10
NO_SPREAD: Final = 1e-9  # Standard error below which replicates say nothing.
MOST_PEOPLE: Final = 100_000  # Or times as many: nobody records more.
# Share of its span by which a point may lie beyond the fixed sweep.
REACH: Final = 0.02


def numbers(one: Estimate) -> dict[str, Any]:
    """Return an effect as in `verdict.json`."""
    ends = {name: known(getattr(one, name)) for name in ("ci_low", "ci_high")}
    return {"effect": known(one.value), **ends}


def known(value: float) -> float | None:
    """Return a number, or None for NaN, which JSON has not."""
    return float(value) if np.isfinite(value) else None


def with_interval(
    one: Estimate, unit: str, *, signed: bool = False, absolute: bool = False
) -> str:
    """Return an effect with its interval as people write it: +3.1 points [+1.0, +5.2].

    `unit` is `fraction` in points of a hundred, `share` the same as a bare number, `s`,
    `ratio` or `correlation`; `absolute` turns it so that the effect is positive.
    """
    scale, digits = (100.0, 1) if unit in {"fraction", "share"} else (1.0, 2)
    found = [scale * number for number in (one.value, one.ci_low, one.ci_high)]
    if absolute and one.value < 0:
        found = [-found[0], -found[2], -found[1]]
    if not np.isfinite(found[0]):
        return "unknown"
    value, low, high = (
        f"{number:{'+' if signed else ''}.{digits}f}" for number in found
    )
    word = {"fraction": " points", "s": " s", "ratio": " times"}.get(unit, "")
    return (
        f"{value}{word} [{low}, {high}]"
        if np.isfinite(found[1:]).all()
        else f"{value}{word}"
    )


def written(value: float, unit: str) -> str:
    """Return a number as people write it, with its unit; units are those of `with_interval`."""
    return with_interval(Estimate(value), unit, signed=unit != "ratio")
