"""Numbers, shares and lists as sentences have them: used by every text of a run."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.intervals import Estimate

PERCENT: Final = 100.0
_AT_LEAST_TWO: Final = 2


def round_percent(percent: float) -> str:
    """Return a percentage without decimals; a small positive value is `<1`."""
    rounded = f"{percent:.0f}"
    if rounded in ("0", "-0") and percent > 0.0:
        return "<1"
    return rounded.replace("-0", "0")


def half_width(estimate: Estimate) -> float:
    """Return half of the 95 % interval, in the estimate's unit; NaN without any."""
    return 0.5 * (estimate.ci_high - estimate.ci_low)


def percent_cell(estimate: Estimate | None) -> str:
    """Return a share as a table shows it, without unit: `34 ±4`; `-` if unknown."""
    if estimate is None or not math.isfinite(estimate.value):
        return "-"
    half = half_width(estimate)
    value = round_percent(PERCENT * estimate.value)
    return f"{value} ±{round_percent(PERCENT * half)}" if math.isfinite(half) else value


def percent(estimate: Estimate) -> str:
    """Return a share with its half-width: `34 % ±4`."""
    if not math.isfinite(estimate.value):
        return "an unknown share"
    half = half_width(estimate)
    value = f"{round_percent(PERCENT * estimate.value)} %"
    return f"{value} ±{round_percent(PERCENT * half)}" if math.isfinite(half) else value


def bare_percent(estimate: Estimate) -> str:
    """Return a share without its half-width: `34 %`."""
    known = math.isfinite(estimate.value)
    return f"{round_percent(PERCENT * estimate.value)} %" if known else "unknown"


def counted(n: int, noun: str, plural: str = "") -> str:
    """Return a number of things: `1 cell`, `1,200 cells`."""
    return f"{n:,} {noun if n == 1 else plural or noun + 's'}"


def listed(words: Sequence[str], last: str = "and") -> str:
    """Return words in a row: `a, b and c`."""
    if len(words) < _AT_LEAST_TWO:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def sentence_case(text: str) -> str:
    """Return a text that starts with a capital."""
    return text[:1].upper() + text[1:]
