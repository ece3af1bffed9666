"""Checks of an attack's parameters, and constants that several attacks share."""

from math import isfinite

PRIOR_STD = (100.0, 10.0)
"""m around the first sample and m/s around rest: far more than any walk."""


def require_positive(**values: float | None) -> None:
    """Raise ValueError for a parameter that is neither None nor a positive number."""
    for name, value in values.items():
        if value is not None and not (isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value}")
