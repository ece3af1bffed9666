"""The query of a robot, as a disclosure policy sees it."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.random import Generator

from isac_track.types import (
    TIME_TOLERANCE_S,
    Bools,
    Floats,
    Ints,
    Prediction,
    squared_lengths,
)

Form: TypeAlias = Literal["samples", "state", "flag"]
"""Form of an answer: samples, a filtered state of each person, or yes and no."""
SelectOn: TypeAlias = Literal["raw", "shared"]
"""Positions on which a selection rests: as sensed, or as the mechanism shares them."""
_SCAN_TOLERANCE = 2  # By which clocks may shorten a forecast.


def check_reach(horizon_s: float, *, ahead_s: Floats) -> None:
    """Raise ValueError if forecasts at instants (H,) s end before a horizon."""
    if horizon_s > ahead_s[-1] + _SCAN_TOLERANCE * (ahead_s[1] - ahead_s[0]):
        raise ValueError(
            f"horizon_s={horizon_s:g} is beyond the {ahead_s[-1]:.3g} s that the network"
            " forecasts: name a shorter horizon_s, or a longer horizon of conflicts by"
            f" --set conflict.horizons_s=3,{horizon_s:g}"
        )


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """Positions of the people of a query, and the network's forecast from them."""

    xy: Floats  # (M, 2) m
    forecast: Prediction  # Of P people at the H instants ``query.ahead_s`` after now.


@dataclass(frozen=True, eq=False, slots=True)
class Query:
    """The network's view when a robot asks: P people present now, M samples in all.

    Person p owns the samples ``offsets[p]:offsets[p + 1]``; the last of them is of now.
    It holds nothing of the truth and no identity.
    """

    t: Floats  # (M,) s, times of the samples.
    offsets: Ints  # (P + 1,)
    raw: View  # As sensed.
    shared: View  # As the mechanism shares it.
    robot_xy: Floats  # (H, 2) m, the robot's route at `ahead_s`, from its place now.
    ahead_s: Floats  # (H,) s after now; the first is 0.
    rng: Generator  # A stream of this robot and query alone.

    def view(self, select_on: SelectOn) -> View:
        """Return the positions that a selection rests on."""
        return self.raw if select_on == "raw" else self.shared

    @property
    def n_people(self) -> int:
        """Number of people present."""
        return self.offsets.size - 1

    @property
    def age_s(self) -> Floats:
        """Time from each sample to the last of the same person, (M,) s.

        That is the time since the sample, unless the network missed the person lately.
        """
        last_s = self.t[self.offsets[1:] - 1]
        return np.asarray(np.repeat(last_s, np.diff(self.offsets)) - self.t)

    def recent_samples(self, people: Bools, *, window_s: float | None = None) -> Bools:
        """Return which samples of some people are recent, (P,) -> (M,).

        These are the samples of the last `window_s` seconds; without a window, all.
        """
        chosen: Bools = np.repeat(people, np.diff(self.offsets))
        if window_s is None:
            return chosen
        return chosen & (self.age_s <= window_s + TIME_TOLERANCE_S)

    def near_robot(self, *, radius_m: float, select_on: SelectOn) -> Bools:
        """Return which people stand less than `radius_m` from the robot now, (P,)."""
        last = self.view(select_on).xy[self.offsets[1:] - 1]
        return np.asarray(squared_lengths(last - self.robot_xy[0]) < radius_m**2)

    def forecast_near_route(
        self,
        *,
        margin_m: float,
        horizon_s: float,
        stds: float = 0.0,
        select_on: SelectOn,
    ) -> Bools:
        """Return which people are forecast within a margin of the robot's route, (P,).

        Distances are time-aligned, up to `horizon_s`. The margin grows by `stds`
        standard deviations of the forecast, per axis; ValueError if the forecast then
        has no covariance, or ends before the horizon.
        """
        forecast = self.view(select_on).forecast
        check_reach(horizon_s, ahead_s=self.ahead_s)
        n_steps = int((self.ahead_s <= horizon_s + TIME_TOLERANCE_S).sum())
        gap = forecast.mean[:, :n_steps] - self.robot_xy[:n_steps]
        reach_m: Floats = np.full(gap.shape[:2], margin_m)
        if stds > 0.0:
            if forecast.cov is None:
                raise ValueError("stds needs a network forecast with a covariance")
            variance = np.trace(forecast.cov[:, :n_steps], axis1=-2, axis2=-1) / 2.0
            reach_m += stds * np.sqrt(variance)
        return np.asarray((squared_lengths(gap) < reach_m**2).any(axis=1))
