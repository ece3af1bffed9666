"""A made-up recording in which everybody crosses one place: for tasks of linkage."""

from functools import cache

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
        step = (
            0.4 * rng.uniform(0.5, 1.8) * np.column_stack([np.cos(turn), np.sin(turn)])
        )
        t_parts.append(np.round(t, 2))
        xy_parts.append(rng.uniform(-5, 5, 2) + np.cumsum(step, axis=0))
    return Tracks(
        t=np.concatenate(t_parts),
        xy=np.concatenate(xy_parts),
        offsets=np.concatenate([[0], np.cumsum([part.size for part in t_parts])]),
        source=tuple(f"w{row}" for row in range(n)),
        group=tuple(
            f"g{row // 2}" if row < 2 * n_groups else f"w{row}" for row in range(n)
        ),
    )


def write_walkers(path):
    """Write the same people as a recording of one's own."""
    write_csv(path, walkers())


@cache
def runs(n=10):
    """People in two sessions, each round a circle at an own speed; others in one."""
    t, walks, people = np.arange(0.0, 40.0, 0.4), [], []
    for day in range(2):
        for row in range(2 * n):
            result = row if row < n else (day + 1) * n + row
            rng = stream(0, "test", "runs", day, result)
            turning = (0.5 + 0.1 * result) * t / 4.0 + rng.uniform(0, 6)
            xy = 4.0 * np.column_stack([np.cos(turning), np.sin(turning)])
            walks.append(xy + 0.005 * rng.standard_normal((t.size, 2)))
            people.append(f"p{result:02d}")
    session = tuple(np.repeat(["first", "second"], 2 * n).tolist())
    return Tracks(
        t=np.concatenate([t + 500.0 * (day == "second") for day in session]),
        xy=np.concatenate(walks),
        offsets=np.arange(4 * n + 1) * t.size,
        source=tuple(
            f"{day}:{result}" for day, result in zip(session, people, strict=True)
        ),
        group=tuple(people),
        person=tuple(people),
        session=session,
    )
