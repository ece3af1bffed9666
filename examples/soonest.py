"""A disclosure policy with a budget: one state each of the people who come nearest.

    cd examples
    python -m attacks check soonest:Soonest
    python -m evaluation.matrix --dataset students03 --policy +soonest:Soonest:1..2/2

Unlike the built-in policies it ranks people, so that an answer never holds more than
its budget. It sends filtered states, and decides by the network's forecast.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.policies.query import Form


@dataclass(frozen=True)
class Soonest:
    """Send a state of the few people whose forecast comes nearest to the route."""

    people: int = 2
    metres: float = 2.0  # Nobody who stays farther away is sent.

    form: ClassVar[Form] = "state"
    forecasts: ClassVar[bool] = True
    protects: ClassVar[bool] = True

    def __post_init__(self):
        if not (self.people > 0 and self.metres > 0):
            wrong = "metres" if self.people > 0 else "people"
            raise ValueError(f"{wrong} must be positive, got {getattr(self, wrong)}")

    def select(self, query):
        """Return the last sample of each person who is sent, (M,) of bool."""
        gap = query.raw.forecast.mean - query.robot_xy
        nearest = np.hypot(gap[..., 0], gap[..., 1]).min(axis=1)
        chosen = np.zeros(nearest.size, dtype=bool)
        chosen[np.argsort(nearest, kind="stable")[: self.people]] = True
        return query.recent_samples(chosen & (nearest < self.metres), window_s=0.0)
