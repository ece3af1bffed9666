"""Made-up walks, releases of them, and what an attack is granted."""

from dataclasses import replace

import numpy as np

from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.types import Knowledge, Release

STEP_S = 0.02
"""Of the fine clock on which a walk is made up before it is sampled."""


def walk_release(walks, *, sigma=None):
    """A release of (t, xy) pairs."""
    sizes = [len(t) for t, _ in walks]
    return Release(
        t=np.concatenate([np.zeros(0), *(t for t, _ in walks)]),
        xy=np.concatenate([np.zeros((0, 2)), *(xy for _, xy in walks)]),
        sigma=sigma,
        offsets=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        pseudonym=tuple(f"p{row}" for row in range(len(sizes))),
    )


def flat_release(t, xy, offsets, *, sigma=None):
    """A release of flat arrays."""
    names = tuple(f"p{row}" for row in range(len(offsets) - 1))
    return Release(t=t, xy=xy, sigma=sigma, offsets=offsets, pseudonym=names)


def context(train=None, *, granted=None, epsilon_m=0.3, **held):
    """An attack's context; granted is TRAIN if there is a training set, or as given."""
    if granted is None:
        granted = () if train is None else (Knowledge.TRAIN,)
    return AttackContext(
        rng=stream(0, "test", "attack"),
        epsilon_m=epsilon_m,
        granted=frozenset(granted),
        train=train,
        **held,
    )


def smooth_walks(*sizes, noise_m=0.4, turn=0.4, seed=0):
    """A release of walks that swing to and fro at irregular steps, and the truth."""
    rng = stream(seed, "test", "smooth", *sizes)
    walks = []
    for size in sizes:
        t = rng.uniform(0, 1e3) + np.cumsum(rng.uniform(0.06, 0.13, size))
        along = t - t[0]
        swing = np.stack([1.2 * along, np.sin(turn * along) / turn], axis=1)
        walks.append((t, rng.normal(0, 5, 2) + swing))
    truth = walk_release(walks)
    xy = truth.xy + noise_m * rng.standard_normal(truth.xy.shape)
    return replace(truth, xy=xy), truth.xy


class Person:
    """A walking person: speed and turning rate vary smoothly, by a habit."""

    def __init__(
        self, rng, *, duration_s=24.0, speed_m_s=None, turn_rad_s=0.3, sway=0.25
    ):
        t = np.arange(0.0, duration_s, STEP_S)
        speed_m_s = rng.uniform(0.7, 1.5) if speed_m_s is None else speed_m_s
        speed = speed_m_s * (1.0 + sway * self._smooth(rng, t))
        heading = (
            rng.uniform(0, 2 * np.pi)
            + np.cumsum(turn_rad_s * self._smooth(rng, t)) * STEP_S
        )
        self.t = t
        self.xy = np.cumsum(
            STEP_S
            * speed[:, None]
            * np.stack([np.cos(heading), np.sin(heading)], axis=1),
            axis=0,
        )

    @staticmethod
    def _smooth(rng, t):
        hz = rng.uniform(0.03, 0.2, 4)
        phase = rng.uniform(0, 2 * np.pi, 4)
        return np.sin(2 * np.pi * hz * t[:, None] + phase).mean(axis=1) * 2.0

    def seen(self, rng, *, start_s, length_s, noise_m=0.0):
        """(t, xy) at 8 to 16 irregular samples a second."""
        step = rng.uniform(1 / 16, 1 / 8, 400)
        t = start_s + np.cumsum(step) - step[0]
        t = t[t <= start_s + length_s]
        xy = np.stack([np.interp(t, self.t, axis) for axis in self.xy.T], axis=1)
        return t, xy + noise_m * rng.standard_normal(xy.shape)


def two_releases(n=12, *, seed=0, length_s=10.0, shift_s=2.0, noise_m=0.0, **habits):
    """Probe and gallery of the same people in another order, and the mates."""
    rng = stream(seed, "test", "linkage", n)
    people = [Person(rng, **habits) for _ in range(n)]
    shifts = rng.uniform(0.0, shift_s, (2, n))
    order = rng.permutation(n)
    probe = [
        person.seen(rng, start_s=shift, length_s=length_s, noise_m=noise_m)
        for person, shift in zip(people, shifts[0], strict=True)
    ]
    gallery = [
        people[k].seen(rng, start_s=shifts[1, k], length_s=length_s, noise_m=noise_m)
        for k in order
    ]
    return walk_release(probe), walk_release(gallery), np.argsort(order)


def odd_release(seed=0, *, n=14):
    """Tracks of 1, 2, 3 and more samples, steps from 1 ms to 30 s, some standing."""
    rng = stream(seed, "test", "odd")
    sizes = [1, 2, 3, *rng.integers(1, 60, n - 3)]
    walks = []
    for row, size in enumerate(sizes):
        steps = np.exp(
            rng.uniform(np.log(1e-3), np.log(30.0 if row % 3 else 0.2), size)
        )
        xy = np.cumsum(rng.normal(0, 0.3, (size, 2)), axis=0)
        walks.append((rng.uniform(0, 1e5) + np.cumsum(steps), xy * (row % 5 > 0)))
    return walk_release(walks)


def hits(scores, mate):
    """Share of probes whose mate comes first."""
    return float((scores.argmax(axis=1) == mate).mean())
