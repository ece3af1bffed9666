"""Plug-ins that fail, or write where they should not, each in one way."""

import contextlib
import os
import threading
from dataclasses import dataclass, field, replace

import numpy as np

from isac_track.sharing import Fixed
from isac_track.tracking import GNN
from isac_track.types import Knowledge
from predictors.least_squares import LeastSquares


@dataclass(frozen=True)
class Raises:
    def share(self, *_):
        raise RuntimeError("no luck")


@dataclass(frozen=True)
class RaisesThen(Fixed):
    """Not with a dozen people, as before a run."""

    d_sigma: float = 0.5

    def share(self, sensed, rng):
        if len(sensed) > 12:
            raise RuntimeError("no luck")
        return super().share(sensed, rng)


@dataclass(frozen=True)
class NotAt3(Fixed):
    def share(self, sensed, rng):
        if self.d_sigma == 0.3 and len(sensed) > 12 and "MENDED" not in os.environ:
            raise RuntimeError("not at 0.3")
        return super().share(sensed, rng)


def spoilt(array):
    """Unlock an array, and all that it is a view of, and write into it."""
    while array is not None:
        with contextlib.suppress(ValueError):
            array.setflags(write=True)
            array += 1000.0
        array = array.base


class Spoils(Fixed):
    def share(self, sensed, rng):
        spoilt(sensed.xy)
        return super().share(sensed, rng)


class Moves(LeastSquares):
    def predict(self, release, t_future):
        spoilt(release.xy)
        spoilt(t_future)
        return super().predict(release, t_future)


@dataclass(frozen=True)
class NeedsMany(Fixed):
    def share(self, sensed, rng):
        if len(sensed) < 10:
            raise RuntimeError("too few to hide among")
        return super().share(sensed, rng)


@dataclass(frozen=True)
class HasALock(LeastSquares):
    lock: object = field(default_factory=threading.Lock, init=False, compare=False)


@dataclass(frozen=True)
class Greedy:
    requires = frozenset({Knowledge.TRAIN})

    def predict(self, *_):
        raise RuntimeError("nobody asks")


@dataclass(frozen=True)
class Overrun:
    """A policy that fails late: before a run people walk for less than 25 s."""

    metres: float = 3.0
    form = "samples"

    def select(self, query):
        if query.t.max() > 25.0:
            raise RuntimeError("too late")
        return query.recent_samples(np.ones(query.n_people, dtype=bool), window_s=1.0)


@dataclass(frozen=True)
class Shifted:
    """A tracker whose states are a scan late, beyond the 25 s of a call before a run."""

    def track(self, detections, likelihood):
        tracked = GNN().track(detections, likelihood)
        if detections.scan_s[-1] < 25.0:
            return tracked
        return replace(tracked, scan=tracked.scan - 1, confirmed=tracked.confirmed - 1)
