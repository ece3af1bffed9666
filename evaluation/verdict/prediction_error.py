"""How well a descriptor foretells who is linked under a kind of noise that it was not fitted to.

It decides nothing. One kind of mechanism is left out at a time; the others give the
curve from descriptor to linkage (isotonic, interpolated), which is read at the levels
left out. PE^2 is the mean of e^2 - s^2, e the error and s its standard error: what
sampling alone would give is taken off. Kinds weigh alike, and so do the levels of one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.estimates.families import FID, FIXED, RAW
from evaluation.estimates.matching import interpolated, nearest_places, rising
from isac_track.intervals import percentile_interval
from isac_track.types import Floats

WHITE: Final = (RAW, FIXED, FID, "laplace")  # Families that are one kind.


@dataclass(frozen=True, eq=False, slots=True)
class Squared:
    """A squared error; those of one task may be subtracted, since people are drawn alike."""

    # (1 + B,) estimate and replicates; below 0 where sampling alone explains more
    drawn: Floats
    centre: float  # What the replicates are of: nothing is taken off.

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

    def less(self, other: "Squared") -> "Squared":
        """Return how much smaller the other is."""
        return Squared(self.drawn - other.drawn, self.centre - other.centre)


def prediction_errors(
    descriptor: Floats, success: Floats, kinds: Sequence[str]
) -> tuple[Squared, Squared] | None:
    """Return the squared error of a descriptor, and that of the mean of the other kinds.

    None if fewer than two of the `kinds`, (L,), have a descriptor. `descriptor` and
    `success`, (1 + B, L), are at all levels, raw among them; it rises with what is left
    of a track.
    """
    has_value = np.isfinite(descriptor).all(axis=0) & np.isfinite(success).all(axis=0)
    told = np.array(kinds)[has_value]
    names = sorted(set(told.tolist()))
    if len(names) < 2:  # noqa: PLR2004 - one is left out
        return None
    scale, reached = descriptor[:, has_value], success[:, has_value]
    means = np.stack([reached[:, told == name].mean(axis=1) for name in names])
    rows: list[list[Floats]] = []
    for place, name in enumerate(names):
        out = told == name
        # A curve through the levels of all others; flat beyond its ends.
        order = np.argsort(scale[:, ~out], axis=1, kind="stable")
        x, y = (
            np.take_along_axis(one[:, ~out], order, axis=1) for one in (scale, reached)
        )
        foretold = interpolated(nearest_places(scale[:, out], x), rising(y), log=False)
        null = np.delete(means, place, axis=0).mean(axis=0)[:, None]
        rows.append([_squares(reached[:, out] - one) for one in (foretold, null)])
    ours, none = np.mean(rows, axis=0)
    return Squared(ours[1:], float(ours[0])), Squared(none[1:], float(none[0]))


def _squares(errors: Floats) -> Floats:
    """Return the mean of e^2 of the estimate, and that of e^2 - s^2 of each row, (2 + B,)."""
    taken_off = (errors**2 - errors[1:].var(axis=0, ddof=1)).mean(axis=1)
    return np.append((errors[0] ** 2).mean(), taken_off)
