"""Checks of an attack's parameters, and the values to try where none is given."""

from collections.abc import Sequence
from math import isfinite
from typing import TypeVar

_Value = TypeVar("_Value")


def require_positive(**values: float | None) -> None:
    """Raise ValueError for a parameter that is neither None nor a positive number."""
    for name, value in values.items():
        if value is not None and not (isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value}")


def candidate_values(
    given: _Value | None, candidates: Sequence[_Value]
) -> Sequence[_Value]:
    """Return the given value of a parameter, or else its candidates."""
    return candidates if given is None else (given,)
