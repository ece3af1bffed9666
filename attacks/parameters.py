"""What every attack checks of its parameters."""

from math import isfinite


def positive(**values: float | None) -> None:
    """Raise ValueError for a parameter that is neither None nor a positive number."""
    for name, value in values.items():
        if value is not None and not (isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value}")
