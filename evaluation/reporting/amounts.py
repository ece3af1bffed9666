"""Numbers, shares and lists as sentences have them: used by every text of a run.

A share is a fraction in code and a percentage in text. The formatters differ in what
they take, in decimals, and in how they write the 95 % interval. A share of 0.3416 with
the interval 0.305 to 0.385, and small shares of 0.004:

| formatter | takes | writes | small share |
|---|---|---|---|
| `percent` | an estimate | `34 % ±4` | `<1 % ±<1` |
| `percent_cell` | an estimate | `34 ±4` | `<1 ±<1` |
| `bare_percent` | an estimate | `34 %` | `<1 %` |
| `precise_percent` | an estimate | `34.2 % [30.5, 38.5]` | `0.4 % [0.1, 0.8]` |
| `share_interval` | value and ends | `34.2 % [30.5, 38.5]` | `0.4 % [0.1, 0.8]` |
| `fine_interval` | value and ends | `34 % [30, 38]` | `0.4 % [0.1, 0.8]` |
| `fine_share` | a fraction | `34` | `0.4` |
| `whole_percent` | a fraction | `34 %` | `0 %` |
| `tenth_percent` | a fraction | `34.2 %` | `0.4 %` |
| `round_percent` | a percentage | `34` | `<1` |

No formatter writes an unknown share, NaN, as a number.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.intervals import Estimate

PERCENT: Final = 100.0
_FINE_BELOW: Final = 1.0  # %; below, a fine share has a decimal.
_FINE_FROM: Final = 0.05  # %; below, it is 0.
_AT_LEAST_TWO: Final = 2
_UNKNOWN_SHARE: Final = "unknown"
_UNKNOWN_NUMBER: Final = "?"  # Before a unit.


def round_percent(percent: float) -> str:
    """Return a percentage without decimals; a small positive value is `<1`.

    An unknown percentage is `?`.
    """
    if math.isnan(percent):
        return _UNKNOWN_NUMBER
    rounded = f"{percent:.0f}"
    if rounded in ("0", "-0") and percent > 0.0:
        return "<1"
    return rounded.replace("-0", "0")


def half_width(estimate: Estimate) -> float:
    """Return half of the 95 % interval, in the estimate's unit; NaN without any.

    A text with ± has room for this number alone. It says how wide the interval is, not
    where it lies: that of a bootstrap need not have the value in its middle. An
    interval of 0 to 6 % around 1 % reads `1 % ±3`. Tables and files have both ends.
    """
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
    return f"{round_percent(PERCENT * estimate.value)} %" if known else _UNKNOWN_SHARE


def whole_percent(share: float) -> str:
    """Return a share without decimals: `34 %`, `0 %`."""
    return _UNKNOWN_SHARE if math.isnan(share) else f"{PERCENT * share:.0f} %"


def tenth_percent(share: float) -> str:
    """Return a share with a decimal: `34.1 %`."""
    return _UNKNOWN_SHARE if math.isnan(share) else f"{PERCENT * share:.1f} %"


def share_interval(
    value: float | None, low: float | None, high: float | None, *, unit: str = " %"
) -> str:
    """Return a share with its interval, if known: `12.3 % [10.1, 14.5]`.

    An unknown share is `-`. The unit stands behind the value.
    """
    if value is None or math.isnan(value):
        return "-"
    text = f"{PERCENT * value:.1f}{unit}"
    if low is None or high is None or not math.isfinite(low):
        return text
    return f"{text} [{PERCENT * low:.1f}, {PERCENT * high:.1f}]"


def precise_percent(estimate: Estimate) -> str:
    """Return an estimated share with its interval, if known: `12.3 % [10.1, 14.5]`."""
    return share_interval(estimate.value, estimate.ci_low, estimate.ci_high)


def fine_share(share: float | None) -> str:
    """Return a share in percent without unit: `34`, `0.5`; `?` if it is unknown."""
    if share is None or not math.isfinite(share):
        return _UNKNOWN_NUMBER
    percentage = PERCENT * share
    is_small = _FINE_FROM <= percentage < _FINE_BELOW
    return f"{percentage:.1f}" if is_small else f"{percentage:.0f}".replace("-0", "0")


def fine_interval(
    value: float | None, low: float | None, high: float | None, *, unit: str = " %"
) -> str:
    """Return a share with its interval: `2 % [0.5, 8]`; unit behind the value."""
    text = f"{fine_share(value)}{unit}"
    if low is None or high is None or not math.isfinite(low + high):
        return text
    return f"{text} [{fine_share(low)}, {fine_share(high)}]"


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
