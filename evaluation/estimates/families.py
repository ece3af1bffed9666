"""THE table of mechanism families: of which family a mechanism is, and under which rule it adds.

A mechanism of the results is a family with the parameters that are not the default, and
has a value for each of its levels. Nobody else takes names apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args

import pandas as pd

from isac_track.types import Adding

RAW, CLEAN, FIXED, FID = "raw", "clean", "fixed", "fid"
"""Families: nothing added, no error at all, the baseline, and the paper's."""
ADDING_RULES: Final[tuple[str, ...]] = get_args(Adding)
SWEPT: Final = (RAW, FIXED, FID)  # Families that the paper compares.
LEVEL_UNITS: Final = {
    FID: "eta in 1/(m^2 s)",
    FIXED: "d_sigma in m",
}  # What a level is.


@dataclass(frozen=True, slots=True)
class Family:
    """A mechanism of a run, whatever its level."""

    mechanism: str  # As in the results: `fid:adding=independent`.
    family: str  # The plug-in's name without parameters: `fid`.
    # The rule that it declares: `linear`, `independent`, or empty without one.
    adding: str
    # Whether it claims to protect: controls, raw and clean do not.
    protects: bool = True

    @property
    def rules(self) -> tuple[str, ...]:
        """Adding rules under which it is judged: its own, or both if it declares none."""
        return (self.adding,) if self.adding else ADDING_RULES

    @property
    def has_one_rule(self) -> bool:
        """Whether no parameter sets its rule, so that there is no other to ask for."""
        return (
            self.adding == "independent"
            and f"adding={self.adding}" not in self.mechanism
        )

    @property
    def is_added(self) -> bool:
        """Whether it does something to what was sensed: neither raw nor clean."""
        return self.family not in (RAW, CLEAN)

    @property
    def parameters(self) -> str:
        """Its parameters that are not the default, without the adding rule."""
        given = self.mechanism.removeprefix(self.family).removeprefix(":").split(",")
        return ",".join(one for one in given if one and not one.startswith("adding="))

    @property
    def name(self) -> str:
        """Family and parameters: what it is called where the adding rule stands apart."""
        return f"{self.family}:{self.parameters}" if self.parameters else self.family


def families_in(rows: pd.DataFrame | Sequence[Mapping[str, Any]]) -> dict[str, Family]:
    """Return the mechanisms of a run by name, in its order.

    `rows` have `mechanism`, `family` and `adding`: a summary, or `manifest["cells"]`,
    which also say whether each claims to protect.
    """
    texts = ["mechanism", "family", "adding"]
    frame = pd.DataFrame(rows, columns=[*texts, "protects"]).drop_duplicates(texts)
    # Of a file that was read without care an empty text is missing; a summary does not
    # say.
    known = frame[texts].astype(object).fillna("").itertuples(index=False, name=None)
    claims = frame["protects"].astype(object).fillna(value=True).astype(bool)
    return {
        mechanism: Family(mechanism, family, adding, protects=protects)
        for (mechanism, family, adding), protects in zip(known, claims, strict=True)
    }


def with_unit(mechanism: str) -> str:
    """Return the name of a mechanism with what its level is."""
    unit = LEVEL_UNITS.get(mechanism.partition(":")[0], "")
    return f"{mechanism}, {unit}" if unit else mechanism
