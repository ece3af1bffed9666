"""A Kalman filter of constant velocity for all tracks of a scan at once.

The two axes share a covariance of four states, since an error ellipse couples them. The
equations are those of filterpy's `KalmanFilter` with `Q_continuous_white_noise`, which
the filter is tested against; an object per track would take ten times as long.
"""

from dataclasses import dataclass

import numpy as np

from isac_track.types import Bools, Floats, Ints


@dataclass(frozen=True, eq=False, slots=True)
class States:
    """States of T tracks: position and velocity, and the blocks of their covariance."""

    position: Floats  # (T, 2) m
    velocity: Floats  # (T, 2) m/s
    pp: Floats  # (T, 2, 2) m^2, covariance of the position.
    pv: Floats  # (T, 2, 2) m^2/s, of position (rows) and velocity (columns).
    vv: Floats  # (T, 2, 2) m^2/s^2, of the velocity.

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.position)

    def take(self, rows: Ints | Bools) -> "States":
        """Return the states of some tracks."""
        return States(
            self.position[rows],
            self.velocity[rows],
            self.pp[rows],
            self.pv[rows],
            self.vv[rows],
        )


def first_states(*, xy: Floats, cov: Floats, speed_std_mps: float) -> States:
    """Return the states after a first detection each, at rest on average.

    `xy` is (T, 2) m, `cov` (T, 2, 2) m^2; `speed_std_mps` holds per axis.
    """
    n = len(xy)
    return States(
        position=xy,
        velocity=np.zeros((n, 2)),
        pp=cov,
        pv=np.zeros((n, 2, 2)),
        vv=np.tile(speed_std_mps**2 * np.eye(2), (n, 1, 1)),
    )


def join_states(first: States, second: States) -> States:
    """Return the states of both, in turn."""
    return States(
        np.concatenate([first.position, second.position]),
        np.concatenate([first.velocity, second.velocity]),
        np.concatenate([first.pp, second.pp]),
        np.concatenate([first.pv, second.pv]),
        np.concatenate([first.vv, second.vv]),
    )


def predict(states: States, *, step_s: float, q: float) -> States:
    """Return the states a step later, with white acceleration of density q, m^2/s^3."""
    crossed = states.pv + np.swapaxes(states.pv, 1, 2)
    noise = q * np.eye(2)
    return States(
        position=states.position + step_s * states.velocity,
        velocity=states.velocity,
        pp=states.pp
        + step_s * crossed
        + step_s**2 * states.vv
        + noise * step_s**3 / 3.0,
        pv=states.pv + step_s * states.vv + noise * step_s**2 / 2.0,
        vv=states.vv + noise * step_s,
    )


def update(states: States, *, xy: Floats, cov: Floats) -> States:
    """Return the states after a detection each, (T, 2) m with cov (T, 2, 2) m^2."""
    weight = inverse(states.pp + cov)
    vp = np.swapaxes(states.pv, 1, 2)
    gain_p, gain_v = states.pp @ weight, vp @ weight
    innovation = (xy - states.position)[:, :, None]
    return States(
        position=states.position + (gain_p @ innovation)[:, :, 0],
        velocity=states.velocity + (gain_v @ innovation)[:, :, 0],
        pp=states.pp - gain_p @ states.pp,
        pv=states.pv - gain_p @ states.pv,
        vv=states.vv - gain_v @ states.pv,
    )


def inverse(matrices: Floats) -> Floats:
    """Return the inverses of symmetric positive definite matrices, (..., 2, 2)."""
    a, b, d = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]
    determinant = a * d - b * b
    inverted = np.empty_like(matrices)
    inverted[..., 0, 0], inverted[..., 1, 1] = d / determinant, a / determinant
    inverted[..., 0, 1] = inverted[..., 1, 0] = -b / determinant
    return inverted


def mix_states(states: States, *, track: Ints, n_tracks: int, weight: Floats) -> States:
    """Return one Gaussian for each track with the moments of its mixture.

    `states` are P components, `track`, (P,), the track of each, and `weight`, (P,),
    their probabilities, which sum to 1 for each of `n_tracks` tracks.
    """

    def total(values: Floats) -> Floats:
        sums = np.zeros((n_tracks, *values.shape[1:]))
        np.add.at(sums, track, values)
        return sums

    column, block = weight[:, None], weight[:, None, None]
    position = total(column * states.position)
    velocity = total(column * states.velocity)
    dp = states.position - position[track]
    dv = states.velocity - velocity[track]
    return States(
        position=position,
        velocity=velocity,
        pp=total(block * (states.pp + dp[:, :, None] * dp[:, None, :])),
        pv=total(block * (states.pv + dp[:, :, None] * dv[:, None, :])),
        vv=total(block * (states.vv + dv[:, :, None] * dv[:, None, :])),
    )
