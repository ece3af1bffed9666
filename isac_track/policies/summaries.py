"""Policies that send less than a sample: a filtered state, or yes and no."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.policies.query import Form, Query, SelectOn
from isac_track.policies.samples import HORIZON_S
from isac_track.types import Bools, positive


@dataclass(frozen=True, slots=True)
class State:
    """Send a filtered position, velocity and covariance of each person.

    The network filters the shared samples up to now; the robot extrapolates the state
    at constant velocity. The policy selects the sample at the time of the state.
    """

    metres: float | None = None
    """Margin around the robot's route as in `ahead`, m; None: everybody present."""
    horizon_s: float = HORIZON_S
    select_on: SelectOn = "raw"

    form: ClassVar[Form] = "state"
    forecasts: ClassVar[bool] = True
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.metres is not None:
            positive("metres", self.metres)
        positive("horizon_s", self.horizon_s)

    def select(self, query: Query) -> Bools:
        """Return the samples at the times of the states that are sent, (M,)."""
        people = np.ones(query.n_people, dtype=bool)
        if self.metres is not None:
            people = query.forecast_near_route(
                margin_m=self.metres, horizon_s=self.horizon_s, select_on=self.select_on
            )
        return query.recent_samples(people, window_s=0.0)


@dataclass(frozen=True, slots=True)
class Flag:
    """Send yes or no: the network applies the conflict rule and sends no position."""

    select_on: SelectOn = "raw"

    form: ClassVar[Form] = "flag"
    forecasts: ClassVar[bool] = True
    protects: ClassVar[bool] = True

    def select(self, query: Query) -> Bools:
        """Return no sample, (M,)."""
        return np.zeros(query.t.size, dtype=bool)
