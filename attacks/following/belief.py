"""The belief of an adversary who probes: particles of a target, with equal weights.

Particles keep their velocity, with white accelerations, and now and then take a
velocity of other people. A particle may also stand for a person whom the adversary has
been sent: answers that repeat samples join themselves, so that this person is followed
without doubt.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.random import Generator
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from isac_track.types import Bools, Floats, Ints, squared_lengths

NOBODY: Final = -1  # Person of a particle that stands for nobody who was sent.
_CELL_M: Final = 0.5  # Resolution of the tables of other people.
_BORDER_M: Final = 1.0  # Around other people's places.
_FASTEST_MPS: Final = 1.5  # Velocities of other people fill a disc of this radius.
_BLUR: Final = (0.3, 0.3)  # m and m/s, of a particle when an answer is attributed.
_TRIED: Final = 40  # Particles that are tried as the best place.


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
    person: Ints  # (K,) number of a person who was sent, or `NOBODY`.

    def moved(
        self, t: float, velocities: Floats, motion: Motion, rng: Generator
    ) -> "Belief":
        """Return the belief at a later time; `velocities`, (V, 2), are of others."""
        step_s = max(t - self.t, 0.0)
        kick = rng.standard_normal(self.xy.shape) * np.sqrt(motion.q * step_s)
        velocity = self.velocity_mps + kick
        xy = self.xy + step_s * (self.velocity_mps + 0.5 * kick)
        is_turn = rng.random(len(xy)) < 1.0 - np.exp(-motion.turns_per_s * step_s)
        velocity[is_turn] = velocities[rng.integers(len(velocities), size=len(xy))][
            is_turn
        ]
        return Belief(t, xy, velocity, self.person)

    def resampled(self, weight: Floats, rng: Generator) -> "Belief":
        """Return particles drawn by weights, (K,), systematically, in random order."""
        total = float(weight.sum())
        if total <= 0.0:
            return self
        n = weight.size
        place = (rng.random() + np.arange(n)) / n
        row = np.minimum(np.searchsorted(np.cumsum(weight) / total, place), n - 1)
        row = rng.permutation(row)
        return Belief(self.t, self.xy[row], self.velocity_mps[row], self.person[row])

    def best_place(self, epsilon_m: float) -> tuple[Floats, float]:
        """Return the particle with most particles around it, (2,) m, and their share."""
        tried = self.xy[:_TRIED]
        near = squared_lengths(tried[:, None] - self.xy) < epsilon_m**2
        share = near.mean(axis=1)
        best = int(share.argmax())
        return tried[best], float(share[best])


@dataclass(frozen=True, eq=False, slots=True)
class SentStates:
    """Kalman states of J people, from all samples of them that were sent in a row."""

    person: Ints  # (J,)
    is_new: Bools  # (J,) whether the adversary meets the person for the first time.
    mean: Floats  # (J, 2, 2) m and m/s: per axis position and velocity.
    cov: Floats  # (J, 2, 2) m^2, m^2/s, m^2/s^2, of an axis; the mean of both axes.
    # (J, 2, 2, 2, 2), of both axes, behind errors with a shape.
    planar: Floats | None = None

    def draw(self, row: int, n: int, rng: Generator) -> tuple[Floats, Floats]:
        """Draw places and velocities of a person, (n, 2) each."""
        if self.planar is not None:
            cov = self.planar[row].reshape(4, 4) + 1e-12 * np.eye(4)
            draws = rng.standard_normal((n, 4)) @ np.linalg.cholesky(cov).T
            both = draws.reshape(n, 2, 2) + self.mean[row]
            return both[..., 0], both[..., 1]
        root = np.linalg.cholesky(self.cov[row] + 1e-12 * np.eye(2))
        draws = rng.standard_normal((n, 2, 2)) @ root.T + self.mean[row]
        return draws[..., 0], draws[..., 1]


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
    corners = np.moveaxis(np.indices(tuple(shape)), 0, -1).reshape(-1, 2)
    centres = low + _CELL_M * (corners + 0.5)
    near = np.zeros(len(centres))
    for row, centre in enumerate(centres):
        gap_m = standing_gaps(centre[None], xy, velocity_mps, horizon_s)[0]
        near[row] = ndtr((margin_m - gap_m) / soft_m).mean()
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
    away_x = places[:, :1] - xy[:, 0]
    away_y = places[:, 1:] - xy[:, 1]
    vx, vy = velocity_mps[:, 0], velocity_mps[:, 1]
    when_s = (away_x * vx + away_y * vy) / np.maximum(vx**2 + vy**2, 1e-12)
    when_s = np.minimum(np.maximum(when_s, 0.0), horizon_s)
    return np.sqrt((away_x - when_s * vx) ** 2 + (away_y - when_s * vy) ** 2)


def route_gaps(
    route: Floats, ahead_s: Floats, xy: Floats, velocity_mps: Floats
) -> Floats:
    """Return how close people come to a robot on a route, (K,) m.

    `route`, (H, 2) m, are the robot's places after `ahead_s`, (H,).
    """
    away_x = xy[:, :1] + velocity_mps[:, :1] * ahead_s - route[:, 0]
    away_y = xy[:, 1:] + velocity_mps[:, 1:] * ahead_s - route[:, 1]
    return np.asarray(np.sqrt((away_x**2 + away_y**2).min(axis=1)))


def updated_by_flag(
    belief: Belief,
    inside: Floats,
    *,
    others: float,
    is_yes: bool,
    power: float,
    rng: Generator,
) -> Belief:
    """Return the belief after a flag.

    `inside`, (K,), is the probability that a particle raises it, `others` the mean
    number of other people who would. The likelihood is raised to `power`, below 1 for
    answers that come so fast that they repeat each other.
    """
    by_others = 1.0 - np.exp(-others)
    no = (1.0 - inside) * (1.0 - by_others)
    return belief.resampled((1.0 - no if is_yes else no) ** power, rng)


def updated_by_states(
    belief: Belief,
    inside: Floats,
    *,
    sent: SentStates,
    crowd: Crowd,
    power: float,
    rng: Generator,
) -> Belief:
    """Return the belief after an answer with the states of J people.

    A particle that stands for a person of the answer takes her state. Any other was not
    sent, or is one of the new people, where all others are clutter (probabilistic data
    association, Bar-Shalom and Tse, Automatica 11, 1975). `inside`, (K,), is the
    probability that a particle would be sent. The likelihood of not being sent is
    raised to `power`, as in `updated_by_flag`.
    """
    unsent = (1.0 - inside) ** power
    stays = np.where(np.isin(belief.person, sent.person), 1.0, unsent)
    new = np.flatnonzero(sent.is_new)
    becomes = (
        inside * (belief.person == NOBODY) * _association(belief, sent, new, crowd)
    )
    weight = np.append(becomes.mean(axis=1), stays.mean())
    if weight.sum() <= 0.0:
        return belief
    number = rng.multinomial(belief.person.size, weight / weight.sum())
    rest = belief.resampled(stays, rng)
    xy, velocity, person = rest.xy.copy(), rest.velocity_mps.copy(), rest.person.copy()
    person[number[-1] :] = np.repeat(sent.person[new], number[:-1])
    for row, label in enumerate(sent.person.tolist()):
        own = np.flatnonzero(person == label)
        if own.size:
            xy[own], velocity[own] = sent.draw(row, own.size, rng)
    order = rng.permutation(person.size)
    return Belief(belief.t, xy[order], velocity[order], person[order])


def _association(belief: Belief, sent: SentStates, new: Ints, crowd: Crowd) -> Floats:
    """Return how much likelier each new person is the particle than clutter, (J, K)."""
    place, speed = sent.mean[new, :, 0], sent.mean[new, :, 1]
    variance = sent.cov[new, 0, 0] + _BLUR[0] ** 2
    speed_variance = sent.cov[new, 1, 1] + _BLUR[1] ** 2
    gaps = place[:, None] - belief.xy, speed[:, None] - belief.velocity_mps
    if sent.planar is None:
        square = squared_lengths(gaps[0]) / variance[:, None]
        square += squared_lengths(gaps[1]) / speed_variance[:, None]
        scale = 4.0 * np.pi**2 * variance * speed_variance
    else:
        square, scale = np.zeros(gaps[0].shape[:2]), np.full(new.size, 4.0 * np.pi**2)
        for number, gap in enumerate(gaps):
            cov = sent.planar[new][:, :, number, :, number]
            cov = cov + _BLUR[number] ** 2 * np.eye(2)
            square += np.einsum("jka,jab,jkb->jk", gap, np.linalg.inv(cov), gap)
            scale *= np.sqrt(np.linalg.det(cov))
    clutter = crowd.at(crowd.density, place) / (np.pi * _FASTEST_MPS**2)
    return np.asarray(np.exp(-0.5 * square) / (scale * clutter)[:, None])
