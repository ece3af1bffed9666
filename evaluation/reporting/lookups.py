"""The rows of a summary by what they are about, and what is known of a mechanism."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import pandas as pd

from evaluation.estimates.families import Family
from evaluation.estimates.keys import Key, keys_of

if TYPE_CHECKING:
    from isac_track.intervals import Estimate

HEADLINE: Final = (
    ("raw", None),
    ("fid", 1.0),
    ("fid", 1000.0),
    ("fixed", 0.7),
    ("fixed", 1.0),
)
"""The few levels that tell the story: mechanism without its adding rule, and level."""
ENDS: Final = ["value", "ci_low", "ci_high"]  # Columns of an estimate.


def family_of(known: Mapping[str, Family], mechanism: str) -> Family:
    """Return what is known of a mechanism; of one that is not, its name."""
    return known.get(mechanism, Family(mechanism, mechanism, ""))


def estimates(rows: pd.DataFrame) -> "dict[Key, Estimate]":
    """Return the rows of a summary by what they are about."""
    from isac_track.intervals import Estimate  # noqa: PLC0415 - see `load`

    return dict(
        zip(
            keys_of(rows),
            map(Estimate, *(rows[one] for one in (*ENDS, "n"))),
            strict=True,
        )
    )
