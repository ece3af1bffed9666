"""A made-up recording in which everybody crosses one place: for tasks of linkage."""

import numpy as np
from helpers.recordings import write_csv

from isac_track.rng import stream
from isac_track.types import Tracks


def walkers(n=40, *, n_groups=4):
    """People who cross a place within 60 s of each other, at speeds of their own."""
    t_parts, xy_parts = [], []
    for row in range(n):
        rng = stream(0, "test", "walkers", row)
        t = rng.uniform(0, 30) + np.arange(0.0, rng.uniform(16, 30), 0.4)
        turn = np.cumsum(rng.normal(0, 0.15, t.size)) + rng.uniform(0, 2 * np.pi)
        step = 0.4 * rng.uniform(0.5, 1.8) * np.column_stack([np.cos(turn), np.sin(turn)])
        t_parts.append(np.round(t, 2))
        xy_parts.append(rng.uniform(-5, 5, 2) + np.cumsum(step, axis=0))
    return Tracks(
        t=np.concatenate(t_parts),
        xy=np.concatenate(xy_parts),
        offsets=np.concatenate([[0], np.cumsum([part.size for part in t_parts])]),
        source=tuple(f"w{row}" for row in range(n)),
        group=tuple(f"g{row // 2}" if row < 2 * n_groups else f"w{row}" for row in range(n)),
    )


def write_walkers(path):
    """Write the same people as a recording of one's own."""
    write_csv(path, walkers())
