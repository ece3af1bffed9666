"""Mechanisms as curves over their levels, from the noisiest to raw, with all their replicates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.analysis.families import FID, FIXED, RAW, Family
from evaluation.analysis.keys import AS_SHARED, Key, Measure
from evaluation.analysis.metrics import EQUAL_ALARMS, EXPOSURE, MISSED_RATE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isac_track.intervals import Estimate
    from isac_track.types import Floats, Ints

FEWEST_LEVELS: Final = 2
"""Of a curve, beside raw."""
_SHOWN: Final = AS_SHARED.measure(EXPOSURE)
_SMALLEST = 1e-12
_ROUNDING = 1e-9


class Sweeps:
    """Every estimate of a run, and its mechanisms; curves are made monotone once each."""

    def __init__(self, found: Mapping[Key, Estimate], known: Mapping[str, Family]) -> None:
        self.found = found
        self.known = known
        self._levels: dict[str, list[float | None]] = {}
        for key in found:
            if key.measure == _SHOWN and known[key.mechanism].is_added:
                self._levels.setdefault(key.mechanism, []).append(key.level)
        self._monotone: dict[tuple[str, Measure], Floats | None] = {}

    def levels(self, mechanism: str) -> list[float | None]:
        """Return the levels of a mechanism, noisiest first: eta grows, a fixed error falls.

        Of any other mechanism the ends tell: the noisier one shows less.
        """
        levels = sorted(self._levels.get(mechanism, ()), key=lambda level: (level is None, level))
        if len(levels) < FEWEST_LEVELS:
            return levels
        family = self.known[mechanism].family
        ends = [self.found[_SHOWN.at(mechanism, levels[place])].value for place in (0, -1)]
        grows = family == FID or (family != FIXED and ends[0] < ends[1])
        return levels if grows else levels[::-1]

    def named(self, family: str, *, adding: str) -> str:
        """Return a family's mechanism under an adding rule, nothing else of it changed, or ""."""
        wanted = family, adding, ""
        found = {(one.family, one.adding, one.parameters): name for name, one in self.known.items()}
        return found.get(wanted, "")

    def others(self, adding: str) -> list[str]:
        """Return the mechanisms beside FID and fixed noise that are judged under an adding rule."""
        plain = {self.named(family, adding=adding) for family in (FID, FIXED)}
        rules = {name: self.known[name].rules for name in self._levels}
        return [name for name in rules if name not in plain and adding in rules[name]]

    def swept(self, adding: str) -> list[str]:
        """Return what is a curve under an adding rule: FID, fixed noise, and others with levels."""
        plain = [self.named(family, adding=adding) for family in (FID, FIXED)]
        more = [name for name in self.others(adding) if len(self.levels(name)) >= FEWEST_LEVELS]
        return [name for name in plain if name] + more

    def drawn(self, key: Key) -> Floats:
        """Return estimate and replicates of a number of the run, (1 + B,)."""
        return np.concatenate([[self.found[key].value], self.found[key].replicates])

    def point(self, mechanism: str, level: float | None, measure: Measure) -> Floats | None:
        """Return estimate and replicates of one level, (1 + B,); None if it was not run."""
        key = measure.at(mechanism, level)
        return self.drawn(key) if key in self.found else None

    def curve(self, mechanism: str, measure: Measure) -> Floats | None:
        """Return the measure from the noisiest level to raw, made monotone, (1 + B, L).

        None if there are fewer than two levels, or one of them or raw was not run.
        """
        asked = mechanism, measure
        if asked not in self._monotone:
            levels = self.levels(mechanism)
            keys = [measure.at(mechanism, level) for level in levels] + [measure.at(RAW, None)]
            self._monotone[asked] = None
            if len(levels) >= FEWEST_LEVELS and all(key in self.found for key in keys):
                # What noise costs falls towards raw, what it hides rises.
                rises = measure.metric not in (MISSED_RATE, EQUAL_ALARMS)
                values = np.stack([self.drawn(key) for key in keys], axis=1)
                self._monotone[asked] = monotone(values, increasing=rises)
        return self._monotone[asked]

    def n(self, mechanism: str, measure: Measure) -> int:
        """Return how many clusters the least of a mechanism's levels has; 0 if none was run."""
        keys = (measure.at(mechanism, level) for level in self.levels(mechanism))
        return min((self.found[key].n for key in keys if key in self.found), default=0)


def monotone(values: Floats, *, increasing: bool) -> Floats:
    """Return each row made monotone from left to right by isotonic regression, (R, L).

    By the min-max formula (Barlow et al. 1972): the largest over all beginnings of the smallest
    over all ends of the mean between them. It does all replicates at once, where
    `scipy.optimize.isotonic_regression` takes them row by row.
    """
    if not increasing:
        return -monotone(-values, increasing=True)
    sums = np.concatenate([np.zeros((values.shape[0], 1)), np.cumsum(values, axis=1)], axis=1)
    best: Floats = np.full(values.shape, -np.inf)
    for first in range(values.shape[1]):
        counts = np.arange(1, values.shape[1] - first + 1)
        means = (sums[:, first + 1 :] - sums[:, first : first + 1]) / counts
        smallest = np.minimum.accumulate(means[:, ::-1], axis=1)[:, ::-1]
        best[:, first:] = np.maximum(best[:, first:], smallest)
    return best


def places(at: Floats, change: Floats) -> tuple[Ints, Floats]:
    """Return where each row has changed by `at` from raw, (R, P) each.

    The level to the right (left of it is raw), and how far it is from the level to the left, 0..1;
    NaN out of reach. `at` is (P,) for all rows, or (R, P); `change`, (R, L), falls from left to
    right, to 0 at raw.
    """
    x = change[:, ::-1]
    # Rounding must not put the end of a curve out of its own reach.
    wanted = np.maximum(np.broadcast_to(at, (x.shape[0], at.shape[-1])) - _ROUNDING, 0.0)
    right = np.zeros(wanted.shape, dtype=np.int64)
    for level in x.T:
        right += level[:, None] < wanted
    in_reach = right < x.shape[1]
    right = np.clip(right, 1, x.shape[1] - 1)
    low, high = (np.take_along_axis(x, place, axis=1) for place in (right - 1, right))
    share = np.zeros_like(low)
    np.divide(wanted - low, high - low, out=share, where=high > low)
    return right, np.where(in_reach, np.clip(share, 0.0, 1.0), np.nan)


def interpolated(where: tuple[Ints, Floats], values: Floats, *, log: bool) -> Floats:
    """Return the values, (R, L), of each row at its places, (R, P); NaN out of reach.

    Of unequal numbers of rows the first are read. With `log` the logarithm is interpolated: a
    descriptor falls about exponentially with the rate, so that a chord over a wide step lies close
    to the curve.
    """
    n_rows = min(len(where[0]), len(values))
    right, share = where[0][:n_rows], where[1][:n_rows]
    y = values[:n_rows, ::-1]
    y = np.log(np.maximum(y, _SMALLEST)) if log else y
    low, high = (np.take_along_axis(y, place, axis=1) for place in (right - 1, right))
    between: Floats = low + share * (high - low)
    return np.exp(between) if log else between
