"""Draw walks from their posterior, if errors are Gaussian with unknown scales."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.random import Generator

from attacks.building_blocks import (
    COMMON_KNOWLEDGE,
    Laplace,
    Motion,
    added_error,
    learn_variance,
    looks_radial,
    make_attack,
    scale_m2,
    simulate_walks,
)
from further_attacks.parameters import PRIOR_STD, require_positive
from isac_track.kalman import Batch, smooth_positions
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Floats, Knowledge, Reconstruction, Release

_Part: TypeAlias = tuple[Floats, str]
_LEAST_M2 = 1e-8
_MOST_ADDED = 0.98  # Greatest share of added variance: sensing adds the rest.
_SHIFTS = 6  # Steps of an estimate towards the point with most draws within epsilon.


@dataclass(frozen=True, slots=True)
class Posterior:
    """Posterior of a walk behind radial or planar Laplace errors, by Gibbs sampling.

    Both laws are Gaussian with a scale of its own for every sample. In turn, the scales
    are drawn given the walk, and the walk given the scales: the smoother of the shared
    positions less a walk and errors from the prior, plus that walk. An adversary who
    knows a mechanism that adds independently also draws the part of each error that it
    added. The estimate is the point with most draws within epsilon. It is exact in the
    long run if walks follow its motion and errors have the assumed size. If the release
    shows neither law, the attack is `radial_rts`. It is slow: a reference for smoothers
    (docs/explanation/attacks.md).

    References
    ----------
    Gibbs sampling of scale mixtures: Carter, Kohn, Biometrika 81(3), 1994, 541-553.
    Simulation smoother: Durbin, Koopman, Biometrika 89(3), 2002, 603-616.
    """

    q: float = 0.057  # m^2/s^3, as fitted on Students03.
    draws: int = 300
    burn_in: int = 100

    slow: ClassVar[bool] = True
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = COMMON_KNOWLEDGE

    def __post_init__(self) -> None:
        require_positive(q=self.q)
        if self.draws < 1 or self.burn_in < 0:
            raise ValueError(
                f"draws must be at least 1 and burn_in at least 0, got {self.draws},"
                f" {self.burn_in}"
            )

    @property
    def seconds_per_sample(self) -> float:
        """Computing time, by the number of draws."""
        return 5e-7 * (self.draws + self.burn_in)

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the function that draws the walks of a release."""
        variance = learn_variance(context)
        smooth: Reconstructor = make_attack("radial_rts").fit(context)
        seed = int(context.rng.integers(2**63))
        mechanism = (
            context.mechanism if Knowledge.MECHANISM in context.granted else None
        )
        is_slow = added_error(mechanism)[1] > 0.0

        def reconstruct(release: Release) -> Reconstruction:
            smoothed = smooth(release)
            if is_slow or not (isinstance(mechanism, Laplace) or looks_radial(release)):
                return smoothed
            rng = np.random.default_rng(seed)
            parts = _parts(variance(release), mechanism)
            draws = self._draw(release, smoothed.xy, parts, rng)
            return _densest_points(draws, context.epsilon_m)

        return reconstruct

    def _draw(
        self, release: Release, xy: Floats, parts: Sequence[_Part], rng: Generator
    ) -> Floats:
        """Return draws of the walks, (K, M, 2) m."""
        t, offsets = release.t, release.offsets
        motion, start = Motion(self.q, PRIOR_STD[1]), np.zeros((len(release), 2))
        walks = np.empty((self.draws, *xy.shape))
        total_m2 = sum(np.square(std_m) for std_m, _ in parts)
        errors = [
            (release.xy - xy) * (std_m**2 / total_m2)[:, None] for std_m, _ in parts
        ]
        for turn in range(-self.burn_in, self.draws):
            scales = []
            for error, (std_m, law) in zip(errors, parts, strict=True):
                square = np.square(error).sum(axis=1) / std_m**2
                drawn_m2 = scale_m2(std_m, square, law=law, rng=rng)
                # A walk that lay exactly on a sample would never leave it.
                scales.append(np.maximum(drawn_m2, _LEAST_M2))
            variance = np.sum(scales, axis=0)
            free = simulate_walks(
                t=t, offsets=offsets, start=start, motion=motion, rng=rng
            )
            noise = np.sqrt(variance)[:, None] * rng.standard_normal(xy.shape)
            batch = Batch(t, release.xy - free - noise, variance, offsets, PRIOR_STD)
            xy = free + smooth_positions(batch, q=self.q)[0]
            errors = [release.xy - xy]
            if len(parts) > 1:  # draw the first of two Gaussians given their sum
                share = (scales[0] / variance)[:, None]
                spread = np.sqrt(scales[0] * scales[1] / variance)[:, None]
                own = share * errors[0] + spread * rng.standard_normal(xy.shape)
                errors = [own, errors[0] - own]
            if turn >= 0:
                walks[turn] = xy
        return walks


def _parts(variance: Floats, mechanism: object) -> Sequence[_Part]:
    """Return standard deviation and law of the one or two independent errors.

    `variance`, (M,) m^2, is that of their sum per axis.
    """
    if getattr(mechanism, "adding", "linear") == "linear":
        return [(np.sqrt(2.0 * variance), "radial")]
    law = getattr(mechanism, "law", None)
    if isinstance(mechanism, Laplace):
        law = "laplace"
    added_m2 = np.minimum(np.square(added_error(mechanism)[0]), _MOST_ADDED * variance)
    raw_m = np.sqrt(2.0 * (variance - added_m2))
    return [
        (raw_m, "radial"),
        (np.sqrt(added_m2 * (1.0 if law else 2.0)), law or "radial"),
    ]


def _densest_points(draws: Floats, epsilon_m: float) -> Reconstruction:
    """Return the point of each sample with most draws within epsilon, and their std.

    Draws are (K, M, 2) m.
    """
    best = draws.mean(axis=0)
    std = np.sqrt(np.square(draws - best).mean(axis=(0, 2)))
    point, most = best, np.full(best.shape[0], -1)
    for _ in range(_SHIFTS):
        near = np.square(draws - point).sum(axis=2) < epsilon_m**2
        count = near.sum(axis=0)
        best = np.where((count > most)[:, None], point, best)
        most = np.maximum(count, most)
        inside = (draws * near[:, :, None]).sum(axis=0)
        point = np.where(
            count[:, None] > 0, inside / np.maximum(count, 1)[:, None], point
        )
    return Reconstruction(best, std)
