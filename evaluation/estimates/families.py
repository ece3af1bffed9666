"""THE table of mechanism families: the family and the adding rule of each mechanism.

A mechanism of the results is a family with the parameters that are not the default. It
has a value for each of its levels. No other module takes the names apart.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args

import pandas as pd

from evaluation.plan.address import MechanismLevel, plugin_name
from evaluation.store.entries import Entry
from isac_track.types import Adding

RAW, CLEAN, FIXED, FID = "raw", "clean", "fixed", "fid"
"""Families: nothing added, no error at all, the baseline, and the paper's."""
AT_RAW: Final = MechanismLevel(RAW)
ADDING_RULES: Final[tuple[str, ...]] = get_args(Adding)
PAPER_FAMILIES: Final = (RAW, FIXED, FID)  # Families that the paper compares.
# Meaning and unit of a level.
LEVEL_UNITS: Final = {
    FID: "eta in 1/(m^2 s)",
    FIXED: "d_sigma in m",
}


@dataclass(frozen=True, slots=True)
class Family:
    """A mechanism of a run, whatever its level."""

    mechanism: str  # As in the results: `fid:adding=independent`.
    family: str  # The plug-in's name without parameters: `fid`.
    # Adding rule that it declares: `linear`, `independent`, or empty.
    adding: str
    # Whether it claims to protect: controls, raw and clean do not.
    protects: bool = True

    @property
    def rules(self) -> tuple[str, ...]:
        """Adding rules for judging it: its own, or both if it declares none."""
        return (self.adding,) if self.adding else ADDING_RULES

    @property
    def has_fixed_rule(self) -> bool:
        """Whether its adding rule is fixed: no parameter can set another."""
        # A parameter `adding` is in the name, unless `independent` is its default.
        return (
            self.adding == "independent"
            and f"adding={self.adding}" not in self.mechanism
        )

    @property
    def is_added(self) -> bool:
        """Whether it changes the sensed positions: neither raw nor clean."""
        return self.family not in (RAW, CLEAN)

    @property
    def parameters(self) -> str:
        """Parameters that are not the default, without the adding rule."""
        given = self.mechanism.removeprefix(self.family).removeprefix(":").split(",")
        return ",".join(
            parameter
            for parameter in given
            if parameter and not parameter.startswith("adding=")
        )

    @property
    def name(self) -> str:
        """Family and parameters: its name where the adding rule stands apart."""
        return f"{self.family}:{self.parameters}" if self.parameters else self.family


def families_in(rows: pd.DataFrame | Sequence[Mapping[str, Any]]) -> dict[str, Family]:
    """Return the mechanisms of a run by name, in its order.

    `rows` have `mechanism`, `family` and `adding`, as a summary has, and may say
    whether each claims to protect. A finished run's manifest also knows: `entry_families`.
    """
    # Without pandas' `drop_duplicates`: a report asks this of many small frames.
    names = ("mechanism", "family", "adding", "protects")
    if isinstance(rows, pd.DataFrame):
        missing = [None] * len(rows)
        columns = [rows[name].tolist() if name in rows else missing for name in names]
    else:
        columns = [[row.get(name) for row in rows] for name in names]
    claims: dict[tuple[str, str, str], bool] = {}
    for *texts, claim in dict.fromkeys(zip(*columns, strict=True)):
        # An empty text becomes NaN when a file is read; a summary has no `protects`.
        mechanism, family, adding = ("" if pd.isna(text) else text for text in texts)
        claims.setdefault(
            (mechanism, family, adding), True if pd.isna(claim) else bool(claim)
        )
    return {
        mechanism: Family(mechanism, family, adding, protects=protects)
        for (mechanism, family, adding), protects in claims.items()
    }


def entry_families(entries: Iterable[Entry]) -> dict[str, Family]:
    """Return the mechanisms of a run by name, in the order of its manifest's entries."""
    families: dict[str, Family] = {}
    for entry in entries:
        name = entry.address.mechanism
        if name not in families:
            families[name] = Family(
                name, entry.family, entry.address.adding, protects=entry.protects
            )
    return families


def with_unit(mechanism: str) -> str:
    """Return the name of a mechanism with the meaning and unit of its level."""
    unit = LEVEL_UNITS.get(plugin_name(mechanism), "")
    return f"{mechanism}, {unit}" if unit else mechanism
