"""Numbers of the verdict as people write them: with unit, sign and interval."""

from typing import Final

import numpy as np

from isac_track.intervals import Estimate

MOST_PEOPLE: Final = 100_000  # More people than any recording has.
_UNREALISTIC: Final = "no realistic number of"
# Words behind a number by its unit; any other unit is written as it is.
_UNIT_WORDS: Final = {
    "fraction": " points",
    "share": "",
    "ratio": " times",
    "correlation": "",
}


def is_realistic(n: float) -> bool:
    """Return whether a recording can have so many people."""
    return n < MOST_PEOPLE


def people_amount(n: float) -> str:
    """Return a number of people in words, to two digits, for "... people"."""
    return f"about {float(f'{n:.2g}'):,.0f}" if is_realistic(n) else _UNREALISTIC


def points_text(share: float, digits: int = 1) -> str:
    """Return a share of people as a bare number of 100 people: 12.5."""
    return f"{100.0 * share:.{digits}f}"


def with_interval(
    effect: Estimate, unit: str, *, signed: bool = False, absolute: bool = False
) -> str:
    """Return an effect with its interval as people write it: +3.1 points [+1.0, +5.2].

    `unit` is `fraction` (in points of a hundred), `share` (the same as a bare number),
    `ratio` or `correlation`; any other, such as `s` or `1/min`, is written as it is.
    `absolute` turns the sign so that the effect is positive.
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
    word = _UNIT_WORDS.get(unit, f" {unit}")
    if not np.isfinite(interval[1:]).all():
        return f"{value}{word}"
    return f"{value}{word} [{low}, {high}]"


def without_interval(value: float, unit: str) -> str:
    """Return a number as people write it, with one of the units of `with_interval`."""
    return with_interval(Estimate(value), unit, signed=unit != "ratio")
