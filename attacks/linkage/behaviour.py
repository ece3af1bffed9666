"""Link walks by behaviour: a learnt metric on features of a whole walk."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from attacks.linkage.learning import can_learn, mated_rows
from attacks.linkage.signals import STEP_S, Signals, on_grid, release_motion
from attacks.remembered import memoised_by_track, noise_m2
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Floats, Knowledge, Release

_STOPPED_M_S = 0.3
_BANDS_HZ = ((0.4, 0.7), (0.7, 1.0), (1.0, 1.4), (1.4, 2.0))
_SWAY_M2 = 1e-3
"""Sway of a body, per cell: (3 cm)^2. Where noise hides it, nothing can be compared."""
_LEAST_SWAY_M2 = 1e-5
_LEAST_CELLS = 8  # Fewer have no spectrum to speak of.
_LEAST_SCALE = 0.02  # Of a feature: all are speeds in m/s, shares, or logarithms.

FEATURES = {
    "mean speed": 0.06,
    "spread of speed": 0.25,
    "slowest tenth": 0.08,
    "median speed": 0.07,
    "fastest tenth": 0.10,
    "stops": 0.10,
    "turning": 0.25,
    "sharp turning": 0.30,
    "net turn": 0.40,
    "progress": 0.06,
    "changes of speed": 0.30,
    **{f"sway {low:g}-{high:g} Hz": 0.5 for low, high in _BANDS_HZ},
}
"""Standard deviation of each feature between two releases of one walk.

Measured on the simulated crowd, rounded; the metric of a blind adversary.
"""


@dataclass(frozen=True, slots=True)
class Behaviour:
    """Distance of two walks' features, in a metric that separates people.

    A blind adversary divides each feature by a fixed scale; the score is minus the
    squared distance. If informed, the score is minus ``x' (W^-1 - T^-1) x`` of
    the difference x, with W its covariance over mated pairs and T over strangers. That
    is the log likelihood ratio of two Gaussians, up to a constant. Both covariances are
    shrunk by `shrinkage` towards their diagonals, since some 90 pairs cannot estimate
    them fully. Only the positive part of the metric counts: no distance may raise a
    score.

    References
    ----------
    Koestinger, Hirzer, Wohlhart, Roth, Bischof, "Large scale metric learning from
    equivalence constraints", CVPR 2012; Ledoit, Wolf, "A well-conditioned estimator for
    large-dimensional covariance matrices", J. Multivariate Analysis 88, 2004 (for the
    shrinkage).
    """

    shrinkage: float = 0.7

    kind: ClassVar[str] = "linkage"
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})

    def __post_init__(self) -> None:
        if not 0 <= self.shrinkage <= 1:
            raise ValueError(f"shrinkage must lie in [0, 1], got {self.shrinkage}")

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, its parameters learnt from the training set, if any."""
        if not can_learn(context):
            return partial(
                _score, metric=np.diag(1.0 / np.array(list(FEATURES.values())) ** 2)
            )
        return partial(
            _score, metric=learnt_metric(context.train, shrinkage=self.shrinkage)
        )


def _score(probe: Release, gallery: Release, *, metric: Floats) -> Floats:
    a, b = features(probe), features(gallery)
    own_a = ((a @ metric) * a).sum(axis=1)
    own_b = ((b @ metric) * b).sum(axis=1)
    return np.asarray(2.0 * (a @ metric @ b.T) - own_a[:, None] - own_b)


def learnt_metric(train: LinkageTrainingSet, *, shrinkage: float) -> Floats:
    """Return W^-1 - T^-1 as far as it is positive, (F, F); see `Behaviour`."""
    a, b = features(train.probe), features(train.gallery)
    rows = mated_rows(train)
    between = a[rows] - b[train.mate[rows]]
    scale = np.maximum(np.sqrt((between**2).mean(axis=0)), _LEAST_SCALE)
    everybody = np.concatenate([a, b])
    spread = np.maximum(everybody.std(axis=0), _LEAST_SCALE)
    standardised = (everybody - everybody.mean(axis=0)) / spread
    scaled = between / scale
    within = (1.0 - shrinkage) * (scaled.T @ scaled / len(scaled))
    total = (1.0 - shrinkage) * (standardised.T @ standardised / len(standardised))
    # Shrunk as by `sklearn.covariance`. A feature that hardly varies counts as if it
    # had the least scale.
    for moments in (within, total):
        np.fill_diagonal(moments, 1.0)
    strangers = 2.0 * total * np.outer(spread / scale, spread / scale)
    value, vector = np.linalg.eigh(np.linalg.inv(within) - np.linalg.inv(strangers))
    return np.asarray(
        (vector * np.maximum(value, 0.0)) @ vector.T / np.outer(scale, scale)
    )


@memoised_by_track()
def features(release: Release) -> Floats:
    """Return the features of each walk, (N, F) in the order of `FEATURES`."""
    walks = on_grid(release)
    (speed, turn), count = release_motion(release, 1.0)
    live = np.arange(speed.shape[1]) < count[:, None]

    rows = np.arange(count.size)
    in_order = np.sort(np.where(live, speed, np.inf), axis=1)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.einsum("ij,ij->i", values, live) / count)

    def speed_quantile(share: float) -> Floats:
        places = ((count - 1) * share).astype(np.int64)
        return np.asarray(in_order[rows, places])

    level = mean(speed)
    spread = np.sqrt(np.maximum(mean(speed**2) - level**2, 0.0))
    steps = np.where(live[:, 1:], np.diff(speed, axis=1), 0.0) / STEP_S
    chord_m = walks.values[:, rows, count - 1] - walks.values[:, :, 0]
    return np.column_stack(
        [
            level,
            np.log(spread + 0.03),
            speed_quantile(0.1),
            speed_quantile(0.5),
            speed_quantile(0.9),
            np.sqrt(mean((speed < _STOPPED_M_S).astype(np.float64))),
            np.log(mean(np.abs(turn)) + 0.03),
            np.log(np.sqrt(mean(turn**2)) + 0.03),
            np.log(np.abs(mean(turn)) + 0.02),
            np.abs(chord_m[0] + 1j * chord_m[1]) / (np.maximum(count - 1, 1) * STEP_S),
            np.log(np.sqrt((steps**2).sum(axis=1) / count) + 0.03),
            sway(release, walks),
        ]
    )


def sway(release: Release, walks: Signals) -> Floats:
    """Return the log power of lateral sway per band, relative to `_SWAY_M2`, (N, 4).

    It comes from the periodogram of the positions' second difference across the
    heading, divided by the gain of a second difference. The error variance of a cell's
    mean is subtracted. The logarithm is shrunk to 0 where that variance is above
    `_SWAY_M2`.
    """
    error_m2 = noise_m2(release) / np.maximum(
        np.diff(release.offsets) / walks.sizes, 1.0
    )
    power_m2 = np.zeros((walks.sizes.size, len(_BANDS_HZ)))
    for cells in np.unique(walks.sizes[walks.sizes >= _LEAST_CELLS]):
        rows = np.flatnonzero(walks.sizes == cells)
        x, y = walks.values[:, rows, :cells]
        z = x + 1j * y
        bend = z[:, 2:] - 2.0 * z[:, 1:-1] + z[:, :-2]
        along = z[:, 2:] - z[:, :-2]
        along /= np.maximum(np.abs(along), 2.0 * STEP_S * 0.2)
        lateral = along.real * bend.imag - along.imag * bend.real
        window = np.hanning(cells)[1:-1]
        spectrum = np.fft.rfft(lateral * window, axis=1)
        hz = np.fft.rfftfreq(cells - 2, STEP_S)
        gain = (2.0 - 2.0 * np.cos(2.0 * np.pi * hz * STEP_S)) ** 2
        for band, (low, high) in enumerate(_BANDS_HZ):
            inside = (hz >= low) & (hz < high)
            if inside.any():
                part = spectrum[:, inside]
                square = (part.real**2 + part.imag**2) / gain[inside]
                power_m2[rows, band] = square.mean(axis=1) / (window**2).sum()
    clear = 1.0 / (1.0 + error_m2 / _SWAY_M2)
    left_m2 = np.maximum(power_m2 - error_m2[:, None], 0.0) + _LEAST_SWAY_M2
    return np.asarray(np.log(left_m2 / _SWAY_M2) * clear[:, None])
