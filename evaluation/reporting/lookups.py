"""The estimates of a summary by key, and the family of a mechanism."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import pandas as pd

from evaluation.estimates.families import Family
from evaluation.estimates.keys import row_addresses
from evaluation.plan.address import MechanismLevel

if TYPE_CHECKING:
    from evaluation.plan.address import Address
    from isac_track.intervals import Estimate

MAIN_LEVELS: Final = (
    MechanismLevel("raw"),
    MechanismLevel("fid", 1.0),
    MechanismLevel("fid", 1000.0),
    MechanismLevel("fixed", 0.7),
    MechanismLevel("fixed", 1.0),
)
"""The few main levels: mechanism without its adding rule, and level."""
ENDS: Final = ["value", "ci_low", "ci_high"]  # Columns of an estimate.


def find_family(known: Mapping[str, Family], mechanism: str) -> Family:
    """Return the family of a mechanism; of an unknown mechanism, a family so named."""
    return known.get(mechanism, Family(mechanism, mechanism, ""))


def estimates(rows: pd.DataFrame) -> "dict[Address, Estimate]":
    """Return the estimates of a summary by key."""
    from isac_track.intervals import Estimate  # noqa: PLC0415 - see `load`

    columns = (rows[name] for name in (*ENDS, "n"))
    return dict(zip(row_addresses(rows), map(Estimate, *columns), strict=True))
