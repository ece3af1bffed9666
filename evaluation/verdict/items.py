"""What an item of the verdict is made of, and how its numbers are put into words and JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.analysis.metrics import DESCRIPTORS, METRICS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isac_track.intervals import Estimate

NAME: Final = {name: METRICS[name].head for name in DESCRIPTORS}


@dataclass(frozen=True, slots=True)
class Draft:
    """An item before the section it belongs to is adjusted and decided."""

    section: str
    adding: str
    subject: str
    """The attack that it is about, if it is about one."""
    effect: Estimate
    unit: str
    options: Mapping[str, float]
    """Decisions that it may come to, in the order of precedence: the p-value of each."""
    sentences: Mapping[str, str]
    """By decision; what an undecided item says is its number."""
    why_undecided: str
    descriptor: str = ""
    task: str = ""
    criterion: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Identifier of the item, the same in every run."""
        of, mechanism = (str(self.details.get(name, "")) for name in ("of", "mechanism"))
        what = (of, self.descriptor, self.task, mechanism)
        return "/".join(filter(None, (self.section, self.adding, self.criterion, *what)))


def numbers(one: Estimate) -> dict[str, Any]:
    """Return an effect as in `verdict.json`."""
    ends = {name: known(getattr(one, name)) for name in ("ci_low", "ci_high")}
    return {"effect": known(one.value), **ends}


def known(value: float) -> float | None:
    """Return a number, or None for NaN, which JSON has not."""
    return float(value) if np.isfinite(value) else None


def with_interval(one: Estimate, unit: str, *, signed: bool = False, absolute: bool = False) -> str:
    """Return an effect with its interval as people write it: +3.1 points [+1.0, +5.2].

    `unit` is `fraction` in points of a hundred, `share` the same as a bare number, `s`, `ratio` or
    `correlation`; `absolute` turns it so that the effect is positive.
    """
    scale, digits = (100.0, 1) if unit in {"fraction", "share"} else (1.0, 2)
    found = [scale * number for number in (one.value, one.ci_low, one.ci_high)]
    if absolute and one.value < 0:
        found = [-found[0], -found[2], -found[1]]
    if not np.isfinite(found[0]):
        return "unknown"
    value, low, high = (f"{number:{'+' if signed else ''}.{digits}f}" for number in found)
    word = {"fraction": " points", "s": " s", "ratio": " times"}.get(unit, "")
    return f"{value}{word} [{low}, {high}]"
