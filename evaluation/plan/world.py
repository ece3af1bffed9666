"""Worlds: walks, error law and horizon of numbers, where not the run's own."""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from evaluation.plan.constants import OTHER_LAW

MODEL: Final = "model"
_TEXT: Final = re.compile(
    rf"({MODEL})?(?:(?:^|,)law=(\w+))?(?:(?:^|,)horizon=([\d.]+(?:e[+-]?\d+)?)s)?"
)


@dataclass(frozen=True, slots=True)
class World:
    """The world that a number is of; by default a run's own, which is false."""

    is_model: bool = False  # Walks of the fitted motion in place of the recorded walks.
    law: str = ""  # Law of the raw error; empty: that of the run.
    horizon_s: float | None = None  # Of conflicts and forecasts; None: the run's.

    def __bool__(self) -> bool:
        return self.is_model or bool(self.law) or self.horizon_s is not None

    @property
    def text(self) -> str:
        """As in `dataset` behind the name: `model,law=isotropic`, `horizon=3s`."""
        parts = [MODEL] if self.is_model else []
        if self.law:
            parts.append(f"law={self.law}")
        if self.horizon_s is not None:
            parts.append(f"horizon={self.horizon_s:.12g}s")
        return ",".join(parts)


OWN_WORLD: Final = World()
OTHER_LAW_WORLD: Final = World(law=OTHER_LAW)
WORLDS: Final = (
    OTHER_LAW_WORLD,
    World(is_model=True),
    World(is_model=True, law=OTHER_LAW),
)
"""Worlds beside the run's own where people are attacked; each horizon is a further."""


@lru_cache(maxsize=64)  # The few worlds of a run; for the process.
def parse_world(text: str) -> World | None:
    """Return the world of a text, as `World.text` writes it; None if it is no world."""
    if (match := _TEXT.fullmatch(text)) is None:
        return None
    model, law, horizon = match.groups()
    try:
        world = World(model is not None, law or "", float(horizon) if horizon else None)
    except ValueError:
        return None
    return world if world.text == text else None
