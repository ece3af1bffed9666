"""Numbers and intervals as in JSON, which has no NaN."""

import math
from collections.abc import Mapping

from isac_track.intervals import Estimate


def json_number(value: float | None) -> float | None:
    """Return a number as a plain float, or None if there is none or it is not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def read_number(value: float | None) -> float:
    """Return a number that `json_number` has written; NaN for None."""
    return math.nan if value is None else value


def json_interval(
    name: str, estimate: Estimate | None, *, ends: str = ""
) -> dict[str, float | None]:
    """Return a number and its interval by key: `name`, `ENDS_low` and `ENDS_high`.

    `ends` is by default the name. All are None for an estimate that is None.
    """
    if estimate is None:
        estimate = Estimate(math.nan)
    ends = ends or name
    return {
        name: json_number(estimate.value),
        f"{ends}_low": json_number(estimate.ci_low),
        f"{ends}_high": json_number(estimate.ci_high),
    }


def read_interval(content: Mapping[str, float | None], name: str) -> Estimate:
    """Return a number and its interval, as `json_interval` writes them by a name."""
    value, low, high = (
        read_number(content[key]) for key in (name, f"{name}_low", f"{name}_high")
    )
    return Estimate(value, low, high)
