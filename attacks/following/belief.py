"""The belief of an adversary who probes: particles of a target, with equal weights.

Particles keep their velocity, with white accelerations, and now and then take a
velocity of other people.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.random import Generator
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from isac_track.types import Floats, squared_lengths

_CELL_M: Final = 0.5  # Resolution of the tables of other people.
_BORDER_M: Final = 1.0  # Around other people's places.
_FASTEST_MPS: Final = 1.5  # Velocities of other people fill a disc of this radius.
_BLUR: Final = (0.5, 0.5)  # m and m/s, of a particle when an answer is attributed.
_SEEN: Final = (0.12, 0.15)  # m and m/s, errors of a place and velocity that were sent.
_TRIED: Final = 60  # Particles that are tried as the best place.


@dataclass(frozen=True, slots=True)
class Motion:
    """How the adversary thinks that people move."""

    q: float = 0.05  # m^2/s^3, white acceleration.
    turns_per_s: float = 0.1  # Rate at which a person takes another velocity.


@dataclass(frozen=True, eq=False, slots=True)
class Belief:
    """K particles of a target at a time."""

    t: float  # s
    xy: Floats  # (K, 2) m
    velocity_mps: Floats  # (K, 2)

    def moved(
        self, t: float, velocities: Floats, motion: Motion, rng: Generator
    ) -> "Belief":
        """Return the belief at a later time; `velocities`, (V, 2), are of others."""
        step_s = max(t - self.t, 0.0)
        kick = rng.standard_normal(self.xy.shape) * np.sqrt(motion.q * step_s)
        velocity = self.velocity_mps + kick
        xy = self.xy + step_s * (self.velocity_mps + 0.5 * kick)
        is_turn = rng.random(len(xy)) < 1.0 - np.exp(-motion.turns_per_s * step_s)
        velocity[is_turn] = rng.choice(velocities, int(is_turn.sum()))
        return Belief(t, xy, velocity)

    def resampled(self, weight: Floats, rng: Generator) -> "Belief":
        """Return particles drawn by weights, (K,), systematically."""
        total = float(weight.sum())
        if total <= 0.0:
            return self
        n = weight.size
        place = (rng.random() + np.arange(n)) / n
        row = np.minimum(np.searchsorted(np.cumsum(weight) / total, place), n - 1)
        row = rng.permutation(row)
        return Belief(self.t, self.xy[row], self.velocity_mps[row])

    def best_place(self, epsilon_m: float) -> tuple[Floats, float]:
        """Return the particle with most particles around it, (2,) m, and their share."""
        tried = self.xy[:_TRIED]
        near = squared_lengths(tried[:, None] - self.xy) < epsilon_m**2
        share = near.mean(axis=1)
        best = int(share.argmax())
        return tried[best], float(share[best])


@dataclass(frozen=True, eq=False, slots=True)
class Crowd:
    """Other people, as the adversary knows them before it asks."""

    xy: Floats  # (V, 2) m, places and velocities that stand for the map.
    velocity_mps: Floats  # (V, 2)
    n_present: float  # Mean number of people present.
    low_m: Floats  # (2,) corner of the tables.
    near_standing: Floats
    """(X, Y) mean number of people whom a robot that stands in the cell would meet."""
    density: Floats  # (X, Y) people per m^2.

    def at(self, table: Floats, xy: Floats) -> Floats:
        """Return the values of a table at places, (C, 2) m -> (C,)."""
        cell = np.floor((xy - self.low_m) / _CELL_M).astype(np.int64)
        cell = np.clip(cell, 0, np.array(table.shape) - 1)
        return np.asarray(table[cell[:, 0], cell[:, 1]])


def make_crowd(
    xy: Floats,
    velocity_mps: Floats,
    *,
    n_present: float,
    margin_m: float,
    horizon_s: float,
    soft_m: float,
) -> Crowd:
    """Return the crowd of some states of other people, (V, 2) m and m/s."""
    low = xy.min(axis=0) - _BORDER_M
    shape = np.ceil((xy.max(axis=0) + _BORDER_M - low) / _CELL_M).astype(np.int64)
    count = np.zeros(shape)
    cell = np.floor((xy - low) / _CELL_M).astype(np.int64)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1.0)
    smooth = gaussian_filter(count, 1.5, mode="nearest") + 0.05 * count.mean()
    centres = np.stack(np.indices(tuple(shape)), axis=-1).reshape(-1, 2)
    gap_m = standing_gaps(low + _CELL_M * (centres + 0.5), xy, velocity_mps, horizon_s)
    near = ndtr((margin_m - gap_m) / soft_m).mean(axis=1)
    return Crowd(
        xy=xy,
        velocity_mps=velocity_mps,
        n_present=n_present,
        low_m=low,
        near_standing=n_present * near.reshape(tuple(shape)),
        density=n_present * smooth / smooth.sum() / _CELL_M**2,
    )


def standing_gaps(
    places: Floats, xy: Floats, velocity_mps: Floats, horizon_s: float
) -> Floats:
    """Return how close people come to standing robots within a horizon, (C, K) m.

    `places`, (C, 2) m, are of the robots. People walk straight on.
    """
    away = places[:, None] - xy
    square = np.maximum(squared_lengths(velocity_mps), 1e-12)
    towards = (away * velocity_mps).sum(axis=-1) / square
    when_s = np.clip(towards, 0.0, horizon_s)
    return np.sqrt(squared_lengths(away - when_s[..., None] * velocity_mps))


def route_gaps(
    route: Floats, ahead_s: Floats, xy: Floats, velocity_mps: Floats
) -> Floats:
    """Return how close people come to a robot on a route, (K,) m.

    `route`, (H, 2) m, are the robot's places after `ahead_s`, (H,).
    """
    people = xy[:, None] + ahead_s[:, None] * velocity_mps[:, None]
    return np.sqrt(squared_lengths(people - route).min(axis=1))


def updated_by_flag(
    belief: Belief, inside: Floats, *, others: float, is_yes: bool, rng: Generator
) -> Belief:
    """Return the belief after a flag.

    `inside`, (K,), is the probability that a particle raises it, `others` the mean
    number of other people who would.
    """
    by_others = 1.0 - np.exp(-others)
    no = (1.0 - inside) * (1.0 - by_others)
    return belief.resampled(1.0 - no if is_yes else no, rng)


def updated_by_states(
    belief: Belief,
    inside: Floats,
    *,
    xy: Floats,
    velocity_mps: Floats,
    crowd: Crowd,
    rng: Generator,
) -> Belief:
    """Return the belief after an answer with J people, (J, 2) m and m/s.

    Either the target is not among them, or is one, and all others are clutter
    (probabilistic data association, Bar-Shalom and Tse, Automatica 11, 1975).
    `inside`, (K,), is the probability that a particle would be sent.
    """
    n_particles = len(belief.xy)
    variance = [blur**2 + seen**2 for blur, seen in zip(_BLUR, _SEEN, strict=True)]
    square = (
        squared_lengths(xy[:, None] - belief.xy) / variance[0]
        + squared_lengths(velocity_mps[:, None] - belief.velocity_mps) / variance[1]
    )
    fit = np.exp(-0.5 * square) / (4.0 * np.pi**2 * variance[0] * variance[1])
    clutter = crowd.at(crowd.density, xy) / (np.pi * _FASTEST_MPS**2)
    weight = np.append((fit * inside).mean(axis=1) / clutter, (1.0 - inside).mean())
    if weight.sum() <= 0.0:
        return belief
    number = np.bincount(
        rng.choice(weight.size, n_particles, p=weight / weight.sum()),
        minlength=weight.size,
    )
    unseen = belief.resampled(1.0 - inside, rng)
    places, velocities = [unseen.xy[: number[-1]]], [unseen.velocity_mps[: number[-1]]]
    for row, count in enumerate(number[:-1].tolist()):
        places.append(xy[row] + _SEEN[0] * rng.standard_normal((count, 2)))
        velocities.append(
            velocity_mps[row] + _SEEN[1] * rng.standard_normal((count, 2))
        )
    order = rng.permutation(n_particles)
    return Belief(
        belief.t, np.concatenate(places)[order], np.concatenate(velocities)[order]
    )
