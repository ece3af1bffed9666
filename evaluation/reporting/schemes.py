"""The mechanisms of a run that are swept over a level: FID, fixed noise, and strangers' alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.analysis.families import ADDING_RULES, FID, FIXED, families_in
from evaluation.analysis.keys import level_text
from evaluation.analysis.metrics import METRICS, MISSED_RATE
from evaluation.reporting.rows import is_control

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from evaluation.analysis.keys import Where

_LOG_SPAN = 30.0
"""An axis is logarithmic where the levels of a mechanism that we do not know span more."""


@dataclass(frozen=True, eq=False, slots=True)
class Scheme:
    """A way of adding error, and the axis of its level."""

    name: str
    """Family and parameters, without the adding rule."""
    title: str
    label: str
    """Of the axis."""
    log: bool
    mechanisms: Mapping[str, str]
    """By adding rule; the same under both where none is declared."""
    place: int
    """Among all schemes: what it looks like."""

    @property
    def has_rule(self) -> bool:
        """Whether it declares an adding rule; without one it is shown wherever a rule is."""
        return len(set(self.mechanisms.values())) == len(self.mechanisms)

    @property
    def rules(self) -> list[str]:
        """Adding rules under which it was run; one of them where it declares none."""
        return list(self.mechanisms)[: None if self.has_rule else 1]

    def rule_text(self, rule: str) -> str:
        """Return an adding rule of it in words."""
        return f"{rule} adding" if self.has_rule else "any adding"

    def at(self, level: float) -> str:
        """Return a level with what it is."""
        symbol, unit = _SYMBOLS.get(self.name, ("", ""))
        return f"{symbol}{level_text(level)}{unit}"

    def of(self, frame: pd.DataFrame, rule: str) -> pd.DataFrame:
        """Return the rows of its levels under a rule that its axis can show, levels rising."""
        rows = frame[frame["mechanism"] == self.mechanisms.get(rule)]
        rows = rows[rows["level"] > 0 if self.log else rows["level"].notna()]
        return rows.sort_values("level")

    def ends(self, rows: pd.DataFrame, rule: str, metric: str) -> str:
        """Return both ends of its line in words: `18.7 % at η = 1 to 51.9 % at η = 1000`."""
        of = self.of(rows[np.isfinite(rows["value"])], rule)
        shown = METRICS[metric]
        return " to ".join(
            f"{shown.scale * row['value']:.{shown.digits}f} {shown.unit} at {self.at(row['level'])}"
            for row in of.iloc[[0, -1] if len(of) > 1 else slice(None)].to_dict("records")
        )


_SYMBOLS: Final = {FID: ("η = ", ""), FIXED: ("", " m")}
_KNOWN: Final = {
    FID: ("FID-controlled sharing", "FID threshold η (1/(m² s))", True),
    FIXED: ("fixed added error", "Added error Δσ (m)", False),
}


def schemes(summary: pd.DataFrame) -> list[Scheme]:
    """Return what is swept in a run: every mechanism with levels but the controls.

    FID and fixed noise come first, the others in the order of the run; adding rules of one are
    one scheme.
    """
    found: dict[str, dict[str, str]] = {name: {} for name in _KNOWN}
    levels = summary[["mechanism", "level"]].drop_duplicates().dropna()
    for mechanism, one in families_in(summary).items():
        if one.is_added and not is_control(one) and (levels["mechanism"] == mechanism).any():
            rules = found.setdefault(one.name, {})
            rules.update(dict.fromkeys(one.rules, mechanism))
    result = []
    for place, (name, rules) in enumerate(found.items()):
        if not rules:
            continue
        own = levels.loc[levels["mechanism"].isin(list(rules.values())), "level"]
        spans = bool((own > 0).all() and own.max() >= _LOG_SPAN * own.min())
        title, label, log = _KNOWN.get(name, (name, f"level of {name}", spans))
        ordered = {rule: rules[rule] for rule in ADDING_RULES if rule in rules}
        result.append(Scheme(name, title, label, log, ordered, place))
    return result


def rules_of(of: list[Scheme]) -> list[str]:
    """Return the adding rules of some schemes."""
    return [rule for rule in ADDING_RULES if any(rule in one.mechanisms for one in of)]


def headline_rule(of: list[Scheme]) -> str:
    """Return the adding rule of the headline: the paper's, if it was run."""
    return rules_of(of)[0]


def compared_levels(summary: pd.DataFrame) -> list[Where]:
    """Return raw, the strictest FID level and of all else the level that costs as much.

    Under each adding rule; without FID the level that costs most.
    """
    rates = summary[(summary["metric"] == MISSED_RATE) & summary["value"].notna()]
    if rates.empty:
        return []
    rates = rates[rates["consumer"] == rates["consumer"].iloc[0]]
    wheres: list[Where] = [("raw", None)] if (rates["mechanism"] == "raw").any() else []
    known = schemes(summary)
    for rule in rules_of(known):
        target = np.inf
        for one in known:
            rows = one.of(rates, rule)
            if rows.empty or any(name == one.mechanisms[rule] for name, _ in wheres):
                continue
            row = rows.iloc[0]
            if one.name == FID:
                target = row["value"]
            else:
                row = rows.loc[(rows["value"] - min(target, rows["value"].max())).abs().idxmin()]
            wheres.append((one.mechanisms[rule], float(row["level"])))
    return wheres
