"""Error of a descriptor that predicts linkage under a kind of noise new to it.

It decides nothing. One kind of mechanism is left out at a time; the others give the
curve from descriptor to linkage (isotonic, interpolated), which is read at the levels
left out. PE^2 is the mean of e^2 - s^2, where e is the error and s its standard error:
the part that sampling alone would give is subtracted. All kinds have the same weight,
and so have the levels of a kind.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.estimates.families import FID, FIXED, RAW
from evaluation.estimates.interpolation import (
    interpolated,
    isotonic_rows,
    nearest_positions,
)
from evaluation.verdict.items import PredictionError
from isac_track.intervals import percentile_interval
from isac_track.types import Floats

WHITE_FAMILIES: Final = (RAW, FIXED, FID, "laplace")  # Families that are one kind.


@dataclass(frozen=True, eq=False, slots=True)
class SquaredError:
    """A squared error; errors of the same task share their draws of people."""

    # (1 + B,) estimate and replicates; below 0 where sampling alone explains more
    drawn: Floats
    centre: float  # Centre of the replicates: the mean of e^2 alone.

    @property
    def ends(self) -> tuple[float, float]:
        """Return the basic bootstrap interval, given the panel."""
        low, high = percentile_interval(self.drawn[1:] - self.centre)
        return float(self.drawn[0]) - high, float(self.drawn[0]) - low

    @property
    def roots(self) -> tuple[float, float, float]:
        """Return the error and its interval as fractions of people, at least 0."""
        value, low, high = np.sqrt(
            np.maximum([self.drawn[0], *self.ends], 0.0)
        ).tolist()
        return value, low, high

    def less(self, other: "SquaredError") -> "SquaredError":
        """Return this error less another."""
        return SquaredError(self.drawn - other.drawn, self.centre - other.centre)


@dataclass(frozen=True, eq=False, slots=True)
class DescriptorErrors:
    """Squared errors of the same predictions with a descriptor, and without."""

    own: SquaredError
    null: SquaredError  # Of the mean of the other kinds.

    @property
    def numbers(self) -> PredictionError:
        """The errors as shares of people."""
        return PredictionError(*self.own.roots, null=self.null.roots[0])


def prediction_errors(
    descriptor: Floats, success: Floats, kinds: Sequence[str]
) -> DescriptorErrors | None:
    """Return the squared error of a descriptor, and that of the mean of other kinds.

    None if fewer than two of the `kinds`, (L,), have a descriptor. `descriptor` and
    `success`, (1 + B, L), are at all levels, raw included. The descriptor must rise
    with the part of a track that is left.
    """
    has_value = np.isfinite(descriptor).all(axis=0) & np.isfinite(success).all(axis=0)
    level_kinds = np.array(kinds)[has_value]
    names = sorted(set(level_kinds.tolist()))
    if len(names) < 2:  # noqa: PLR2004 - a kind is left out
        return None
    scale, reached = descriptor[:, has_value], success[:, has_value]
    means = np.stack([reached[:, level_kinds == name].mean(axis=1) for name in names])
    rows: list[list[Floats]] = []
    for place, name in enumerate(names):
        is_out = level_kinds == name
        # A curve through the levels of all other kinds; flat beyond its ends.
        order = np.argsort(scale[:, ~is_out], axis=1, kind="stable")
        x = np.take_along_axis(scale[:, ~is_out], order, axis=1)
        y = np.take_along_axis(reached[:, ~is_out], order, axis=1)
        position = nearest_positions(scale[:, is_out], x)
        predicted = interpolated(position, isotonic_rows(y), log=False)
        null = np.delete(means, place, axis=0).mean(axis=0)[:, None]
        truth = reached[:, is_out]
        rows.append([_squares(truth - predicted), _squares(truth - null)])
    ours, null_error = np.mean(rows, axis=0)
    return DescriptorErrors(
        own=SquaredError(ours[1:], float(ours[0])),
        null=SquaredError(null_error[1:], float(null_error[0])),
    )


def _squares(errors: Floats) -> Floats:
    """Return the estimate's mean of e^2, and each row's mean of e^2 - s^2, (2 + B,)."""
    corrected = (errors**2 - errors[1:].var(axis=0, ddof=1)).mean(axis=1)
    return np.append((errors[0] ** 2).mean(), corrected)
