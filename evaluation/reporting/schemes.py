"""The swept mechanisms of a run, and the axis of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from evaluation.estimates.families import ADDING_RULES, FID, FIXED, families_in
from evaluation.estimates.keys import level_text
from evaluation.plan.address import plugin_name
from evaluation.plan.presets import DISSOCIATION
from evaluation.reporting.names import FAMILY_NAMES

if TYPE_CHECKING:
    import pandas as pd

CONTROL_FAMILIES: Final = frozenset(map(plugin_name, DISSOCIATION))
"""Families of controls: they separate a descriptor from linkability."""
# Ratio of the levels' ends from which an unknown mechanism has a logarithmic axis.
_LOG_SPAN = 30.0
_LEVEL_PATTERNS: Final = {FID: "eta {}", FIXED: "{} m"}
# By mechanism: title, label of the axis, and whether it is logarithmic.
_PAPER_AXES: Final = {
    FID: ("FID noise", "eta (1/(m² s))", True),
    FIXED: ("fixed noise", "added noise (m)", False),
}
_LEAST_LEVELS = 3  # Levels that make a curve.


@dataclass(frozen=True, eq=False, slots=True)
class Scheme:
    """A swept mechanism, and the axis of its level."""

    mechanism: str
    name: str  # Family and parameters, without the adding rule.
    # Adding rules under which it is shown: its own, or all if it declares none.
    rules: Sequence[str]
    title: str
    label: str  # Of the axis.
    log: bool
    place: int  # Of the name among all: it decides the look.

    @property
    def rule_text(self) -> str:
        """Its adding rule in words."""
        return f"{self.rules[0] if len(self.rules) == 1 else 'any'} adding"

    def describe_level(self, level: float) -> str:
        """Return a level with its symbol or unit."""
        return _LEVEL_PATTERNS.get(self.name, "{}").format(level_text(level))

    def select_rows(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of the levels that its axis can show, levels rising."""
        rows = frame[frame["mechanism"] == self.mechanism]
        rows = rows[rows["level"] > 0 if self.log else rows["level"].notna()]
        return rows.sort_values("level")


def schemes(summary: pd.DataFrame, *, as_points: bool = False) -> list[Scheme]:
    """Return the swept mechanisms of a run: every mechanism with levels but controls.

    A mechanism with too few levels for a curve, beside others with enough, is no sweep,
    unless it is FID or fixed noise: `as_points` includes it. FID and fixed noise come
    first, the others in the order of the run; the adding rules of a mechanism stand
    together.
    """
    by_mechanism = summary.dropna(subset="level").groupby("mechanism")
    levels = by_mechanism["level"].agg(["min", "max", "nunique"])
    swept = [
        family
        for family in families_in(summary).values()
        if family.mechanism in levels.index
        and family.is_added
        and family.family not in CONTROL_FAMILIES
    ]
    most = min(_LEAST_LEVELS, levels["nunique"].max()) if swept else 0
    if not as_points:
        enough = set(levels.index[levels["nunique"] >= most])
        swept = [
            family
            for family in swept
            if family.name in _PAPER_AXES or family.mechanism in enough
        ]
    names = list(dict.fromkeys([*_PAPER_AXES, *(family.name for family in swept)]))
    swept.sort(
        key=lambda family: (
            names.index(family.name),
            ADDING_RULES.index(family.rules[0]),
        )
    )
    swept_schemes = []
    for family in swept:
        own = levels.loc[
            [other.mechanism for other in swept if other.name == family.name]
        ]
        low, high = own["min"].min(), own["max"].max()
        title = FAMILY_NAMES.get(family.name, family.name)
        usual_axis = title, f"level of {title}", bool(0 < low <= high / _LOG_SPAN)
        title, label, is_log = _PAPER_AXES.get(family.name, usual_axis)
        swept_schemes.append(
            Scheme(
                mechanism=family.mechanism,
                name=family.name,
                rules=family.rules,
                title=title,
                label=label,
                log=is_log,
                place=names.index(family.name),
            )
        )
    return swept_schemes
