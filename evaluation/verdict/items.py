"""What an item of the verdict is made of, and how it is put into words and JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.analysis.metrics import DESCRIPTORS, METRICS
from evaluation.verdict.rules import SIGN, UNDECIDED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evaluation.verdict.rules import Option
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
    options: tuple[Option, ...]
    """In the order of precedence."""
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
        parts = (self.section, self.adding, self.criterion, *what)
        return "/".join(part for part in parts if part)


def to_json(draft: Draft, *, decision: str, p_value: float, p_adjusted: float) -> dict[str, Any]:
    """Return an item of `verdict.json`; numbers that are unknown are None."""
    one = draft.effect
    return {
        "id": draft.name,
        "section": draft.section,
        "adding": draft.adding,
        "descriptor": draft.descriptor,
        "task": draft.task,
        "subject": draft.subject,
        "criterion": draft.criterion,
        "decision": decision,
        "sign": SIGN[decision],
        "effect": known(one.value),
        "ci_low": known(one.ci_low),
        "ci_high": known(one.ci_high),
        "unit": draft.unit,
        "n": one.n,
        "p_value": p_value,
        "p_adjusted": p_adjusted,
        "sentence": draft.sentences.get(decision, draft.sentences[UNDECIDED]),
        "why_undecided": draft.why_undecided if decision == UNDECIDED else "",
        **draft.details,
    }


def known(value: float) -> float | None:
    """Return a number, or None for NaN, which JSON has not."""
    return float(value) if np.isfinite(value) else None


def with_interval(one: Estimate, unit: str, *, signed: bool = False, absolute: bool = False) -> str:
    """Return an effect with its interval as people write it: +3.1 points [+1.0, +5.2].

    Parameters
    ----------
    one : Effect
    unit : str
        `fraction` in points of a hundred, `share` the same as a bare number, `s`, `ratio` or
        `correlation`.
    signed : bool
        With a plus.
    absolute : bool
        Turned so that the effect is positive.
    """
    scale, digits = (100.0, 1) if unit in {"fraction", "share"} else (1.0, 2)
    numbers = [scale * number for number in (one.value, one.ci_low, one.ci_high)]
    if absolute and one.value < 0:
        numbers = [-numbers[0], -numbers[2], -numbers[1]]
    if not np.isfinite(numbers[0]):
        return "unknown"
    value, low, high = (f"{number:{'+' if signed else ''}.{digits}f}" for number in numbers)
    word = {"fraction": " points", "s": " s", "ratio": " times"}.get(unit, "")
    return f"{value}{word} [{low}, {high}]"
