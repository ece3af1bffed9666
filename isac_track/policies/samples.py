"""Policies that send samples: of everybody, of people nearby, of people ahead."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.policies.query import Form, Query, SelectOn
from isac_track.types import Bools, check_at_least, positive

WINDOW_S = 1.3
"""Duration of the 16 samples that the paper's robot reads, at the usual interval."""
HORIZON_S = 3.0  # Usual horizon of a policy's forecast.


def check_window(window_s: float | None) -> None:
    """Raise ValueError for a window that is not positive; None means all history."""
    if window_s is not None:
        positive("window_s", window_s)


@dataclass(frozen=True, slots=True)
class Everything:
    """Send all samples of everybody present: the paper's sharing."""

    form: ClassVar[Form] = "samples"
    forecasts: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def select(self, query: Query) -> Bools:
        """Return all samples, (M,)."""
        return np.ones(query.t.size, dtype=bool)


@dataclass(frozen=True, slots=True)
class Window:
    """Send the last seconds of everybody present."""

    seconds: float

    form: ClassVar[Form] = "samples"
    forecasts: ClassVar[bool] = False
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive("seconds", self.seconds)

    def select(self, query: Query) -> Bools:
        """Return the samples of the last seconds, (M,)."""
        everybody = np.ones(query.n_people, dtype=bool)
        return query.recent_samples(everybody, window_s=self.seconds)


@dataclass(frozen=True, slots=True)
class Near:
    """Send the last seconds of people who are near the robot now."""

    metres: float  # m from the robot.
    window_s: float | None = WINDOW_S  # None: all history.
    select_on: SelectOn = "raw"

    form: ClassVar[Form] = "samples"
    forecasts: ClassVar[bool] = False
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive("metres", self.metres)
        check_window(self.window_s)

    def select(self, query: Query) -> Bools:
        """Return the samples of people near the robot, (M,)."""
        near = query.near_robot(radius_m=self.metres, select_on=self.select_on)
        return query.recent_samples(near, window_s=self.window_s)


@dataclass(frozen=True, slots=True)
class Ahead:
    """Send the last seconds of people who are forecast near the robot's route."""

    metres: float  # m, margin around the route.
    window_s: float | None = WINDOW_S  # None: all history.
    # Horizon within which forecast and route are compared.
    horizon_s: float = HORIZON_S
    stds: float = 0.0  # Standard deviations of the forecast that widen the margin.
    select_on: SelectOn = "raw"

    form: ClassVar[Form] = "samples"
    forecasts: ClassVar[bool] = True
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive("metres", self.metres)
        check_window(self.window_s)
        positive("horizon_s", self.horizon_s)
        check_at_least("stds", self.stds, 0)

    def select(self, query: Query) -> Bools:
        """Return the samples of people ahead, (M,)."""
        ahead = query.forecast_near_route(
            margin_m=self.metres,
            horizon_s=self.horizon_s,
            stds=self.stds,
            select_on=self.select_on,
        )
        return query.recent_samples(ahead, window_s=self.window_s)


@dataclass(frozen=True, slots=True)
class RandomPeople:
    """Send the last seconds of a random share of people: a control."""

    share: float  # Probability of each person, drawn anew at every query.
    window_s: float | None = WINDOW_S  # None: all history.

    form: ClassVar[Form] = "samples"
    forecasts: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise ValueError(f"share must lie within 0 to 1, got {self.share}")
        check_window(self.window_s)

    def select(self, query: Query) -> Bools:
        """Return the samples of the drawn people, (M,)."""
        drawn = query.rng.random(query.n_people) < self.share
        return query.recent_samples(drawn, window_s=self.window_s)
