"""Link passages by gait: sway and steps in a learnt metric."""

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar, Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from attacks.linkage.learning import can_learn, mated_rows
from attacks.parameters import require_positive
from attacks.remembered import memoised_by_track, noise_m2
from isac_track.kalman import Batch, smooth_positions
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Complexes, Floats, Knowledge, Release, read_only

STEP_S: Final = 0.05
"""Step of the grid: 20 Hz holds every motion of a walk below 3 Hz."""
LEAST_S: Final = 2.0
"""A shorter passage holds no stride; its features are those of a mean walk: zeros."""
LONGEST_S: Final = 60.0
SEGMENT_CELLS: Final = 100
"""5 s: spectra of longer passages are averaged over segments of this length."""
BANDS_HZ: Final = read_only(np.linspace(0.5, 3.0, 9))
"""Middles of the bands of the spectrum."""
_STRIDES_HZ: Final = read_only(np.linspace(0.35, 1.25, 61))
"""Stride frequencies that are tried; a stride has two steps."""
_HEADING_S = 0.6  # Width of the smoothing that leaves the way without its sway.
_Q = 1.0  # m^2/s^3: passes sway of 3 cm at 1 Hz, and steps.
_PRIOR_STD = (1.0, 2.0)  # m and m/s of the smoother's first state.
_FLOOR_M2 = 1e-6  # (1 mm)^2: less motion than this is rounding.
_SLOWEST_M_S = 0.05
_LEAST_SCALE = 0.02  # Of a feature, all of which are logarithms or shares.

NAMES: Final = (
    "speed",
    "cadence",
    "step length",
    "sway",
    "surge",
    "left-right asymmetry",
    "second harmonic of sway",
    "third harmonic of sway",
    "phase of surge, cosine",
    "phase of surge, sine",
    *(f"lateral {hz:.2g} Hz" for hz in BANDS_HZ),
    *(f"longitudinal {hz:.2g} Hz" for hz in BANDS_HZ),
)
"""The features of a passage, in order."""
_BLIND_SCALES: Final = read_only(
    np.array([0.3, 0.15, 0.3, 0.4, 0.4, 0.8, 0.8, 0.8, 0.7, 0.7] + [1.0] * 18)
)
# Slope of each feature against the logarithm of speed, for an adversary who has not
# learnt it: cadence grows as the root of speed (Grieve and Gear, Ergonomics 9, 1966).
_BLIND_SLOPES: Final = read_only(np.array([0.0, 0.5, 0.5] + [0.0] * 25))


@dataclass(frozen=True, slots=True)
class Gait:
    """Distance of the gait of two passages, in a metric that separates people.

    A smoother takes out errors as far as they are white. The passage then lies on a
    grid of 20 Hz. Its way is the path without sway; accelerations along and across the
    way are the longitudinal and the lateral signal. Features are their spectra between
    0.5 and 3 Hz, cadence, step length, amplitudes, and the phases and harmonics of a
    stride, which show asymmetry. None depends on frame or clock. Features are compared
    beyond speed: each less its line over the logarithm of speed.

    An informed adversary learns line and metric on other people. The score is minus
    ``x' (W^-1 - T^-1) x`` of the difference x, with W its covariance over mated pairs
    and T over strangers, as in `Behaviour`; a blind adversary divides by fixed scales.

    Only times and positions are read: no height, no sex, no declared error.

    References
    ----------
    Sway and speed in single file: Jelic, Appert-Rolland, Lemercier, Pettre, Phys. Rev.
    E 86, 046111, 2012. Metric: Koestinger et al., CVPR 2012.
    """

    shrinkage: float = 0.5
    q: float = _Q

    kind: ClassVar[str] = "linkage"
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})

    def __post_init__(self) -> None:
        require_positive(q=self.q)
        if not 0 <= self.shrinkage <= 1:
            raise ValueError(f"shrinkage must lie in [0, 1], got {self.shrinkage}")

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker; it learns its metric from the training set, if any."""
        metric = GaitMetric(_BLIND_SLOPES, np.diag(1.0 / _BLIND_SCALES**2))
        if can_learn(context):
            metric = learn_metric(context.train, shrinkage=self.shrinkage, q=self.q)
        return partial(_score, metric=metric, q=self.q)


@dataclass(frozen=True, eq=False, slots=True)
class GaitMetric:
    """How features are compared: their slopes over log speed, (F,), and (F, F)."""

    slopes: Floats
    matrix: Floats

    def residual(self, values: Floats) -> Floats:
        """Return features beyond speed, (N, F); speed itself stays."""
        return np.asarray(values - values[:, :1] * self.slopes)


def _score(probe: Release, gallery: Release, *, metric: GaitMetric, q: float) -> Floats:
    a = metric.residual(features(probe, q))
    b = metric.residual(features(gallery, q))
    own_a = ((a @ metric.matrix) * a).sum(axis=1)
    own_b = ((b @ metric.matrix) * b).sum(axis=1)
    return np.asarray(2.0 * (a @ metric.matrix @ b.T) - own_a[:, None] - own_b)


def learn_metric(
    train: LinkageTrainingSet, *, shrinkage: float, q: float
) -> GaitMetric:
    """Learn slopes over speed and the positive part of W^-1 - T^-1; see `Gait`."""
    rows = mated_rows(train)
    first = features(train.probe, q)[rows]
    second = features(train.gallery, q)[train.mate[rows]]
    everybody = np.concatenate([first, second])
    centred = everybody - everybody.mean(axis=0)
    variance = max(float(centred[:, 0] @ centred[:, 0]), 1e-9)
    slopes = centred[:, 0] @ centred / variance
    slopes[0] = 0.0
    beyond = GaitMetric(slopes, np.eye(slopes.size))
    apart = beyond.residual(first) - beyond.residual(second)
    centred = beyond.residual(centred)
    within_scale = np.maximum(np.sqrt((apart**2).mean(axis=0)), _LEAST_SCALE)
    spread = np.maximum(centred.std(axis=0), _LEAST_SCALE)
    within = _correlation(apart / within_scale, shrinkage)
    total = _correlation(centred / spread, shrinkage)
    strangers = 2.0 * total * np.outer(spread / within_scale, spread / within_scale)
    value, vector = np.linalg.eigh(np.linalg.inv(within) - np.linalg.inv(strangers))
    positive = (vector * np.maximum(value, 0.0)) @ vector.T
    return GaitMetric(slopes, positive / np.outer(within_scale, within_scale))


def _correlation(scaled: Floats, shrinkage: float) -> Floats:
    """Return moments of scaled features, shrunk towards the unit matrix, (F, F)."""
    moments = (1.0 - shrinkage) * (scaled.T @ scaled / len(scaled))
    np.fill_diagonal(moments, 1.0)
    return np.asarray(moments)


@memoised_by_track()
def features(release: Release, q: float = _Q) -> Floats:
    """Return the features of each passage, (N, F) in the order of `NAMES`.

    The cadence of slow strides, 0.6 Hz, comes out up to 12 % too slow: their spectral
    line is wide, and slow motion has more weight. It does so for everybody.
    """
    variance_m2 = noise_m2(release)
    batch = Batch(
        t=release.t,
        xy=release.xy,
        variance=np.repeat(variance_m2, np.diff(release.offsets)),
        offsets=release.offsets,
        prior_std=_PRIOR_STD,
    )
    smooth_m, error_m2 = smooth_positions(batch, q=q)
    values = np.zeros((len(release), len(NAMES)))
    for row in range(len(release)):
        samples = slice(release.offsets[row], release.offsets[row + 1])
        t_s = release.t[samples]
        if t_s.size >= 8 and t_s[-1] - t_s[0] >= LEAST_S:  # noqa: PLR2004 - for a spline
            floor_m2 = _FLOOR_M2 + float(error_m2[samples].mean())
            values[row] = _passage_features(t_s, smooth_m[samples], floor_m2)
    return values


def _passage_features(t_s: Floats, xy: Floats, floor_m2: float) -> Floats:
    """Return the features of a smoothed passage, (F,)."""
    t_s = t_s - t_s[0]
    grid_s = np.arange(0.0, min(float(t_s[-1]), LONGEST_S) + 1e-9, STEP_S)
    x, y = CubicSpline(t_s, xy)(grid_s).T
    body = _body_motion(x + 1j * y)
    surge, sway, speed = body.surge, body.sway, body.speed
    cells = min(grid_s.size, SEGMENT_CELLS)
    sides, steps = (_amplitudes(x, _harmonics(cells)) for x in (sway, surge))
    side_m2, step_m2 = (np.mean(np.abs(x) ** 2, axis=2) for x in (sides, steps))
    # Weighed by frequency: between slow drift and a strong third harmonic.
    stride = int(((side_m2[:, 0] + step_m2[:, 1]) * _STRIDES_HZ).argmax())
    cadence_hz = 2.0 * _STRIDES_HZ[stride]
    phase = np.mean(sides[stride, 0] ** 2 * np.conj(steps[stride, 1]))
    turn = phase / (side_m2[stride, 0] * np.sqrt(step_m2[stride, 1]) + floor_m2**1.5)
    side_m2, step_m2 = side_m2[stride] + floor_m2, step_m2[stride] + floor_m2
    bands = [
        np.mean(np.abs(_amplitudes(x, _bands(cells))[:, 0]) ** 2, axis=1) + floor_m2
        for x in (sway, surge)
    ]
    return np.concatenate(
        [
            np.log([speed, cadence_hz, speed / cadence_hz]),
            0.5 * np.log([side_m2[0], step_m2[1], step_m2[0] / step_m2[1]]),
            0.5 * np.log(side_m2[1:] / side_m2[0]),
            [turn.real, turn.imag],
            0.5 * np.log(np.concatenate(bands)),
        ]
    )


@dataclass(frozen=True, eq=False, slots=True)
class _BodyMotion:
    """How a body moves about its way."""

    surge: Floats  # (K,) m/s^2, acceleration along the way
    sway: Floats  # (K,) m/s^2, across it
    speed: float  # m/s, mean


def _body_motion(z: Complexes) -> _BodyMotion:
    """Return the motion of positions x + iy, (K,) m, about their smoothed way."""
    way = gaussian_filter1d(z, _HEADING_S / STEP_S, mode="nearest")
    going = np.gradient(way, STEP_S)
    heading = going / np.maximum(np.abs(going), _SLOWEST_M_S)
    bend = np.gradient(np.gradient(z - way, STEP_S), STEP_S) * np.conj(heading)
    speed = max(float(np.abs(z[-1] - z[0])) / ((z.size - 1) * STEP_S), _SLOWEST_M_S)
    return _BodyMotion(bend.real, bend.imag, speed)


def _amplitudes(signal: Floats, waves: Complexes) -> Complexes:
    """Return amplitudes of the motion behind an acceleration, (B, H, S) m.

    There are S segments of the waves' length, which overlap by half (Welch, IEEE Trans.
    Audio Electroacoustics 15, 1967); a stride drifts too much for longer segments.
    """
    cells = waves.shape[-1]
    starts = np.arange(0, signal.size - cells + 1, max(cells // 2, 1))
    segments = signal[starts[:, None] + np.arange(cells)]
    return np.asarray(waves @ (segments - segments.mean(axis=1, keepdims=True)).T)


# For all windows of a length; the 17th length makes the oldest go.
@lru_cache(maxsize=16)
def _harmonics(cells: int) -> Complexes:
    """Return windowed waves of each stride frequency and its harmonics, (S, 3, K)."""
    first = _waves(_STRIDES_HZ, cells)
    numbers = np.arange(1.0, 4.0)[:, None]
    waves = np.stack([first, first**2, first**3], axis=1)
    return _weigh(waves, numbers * _STRIDES_HZ[:, None, None])


# As above.
@lru_cache(maxsize=16)
def _bands(cells: int) -> Complexes:
    """Return windowed waves of the bands, (B, 1, K)."""
    return _weigh(_waves(BANDS_HZ, cells)[:, None], BANDS_HZ[:, None, None])


def _waves(hz: Floats, cells: int) -> Complexes:
    return np.asarray(np.exp(-2j * np.pi * np.outer(hz, np.arange(cells) * STEP_S)))


def _weigh(waves: Complexes, hz: Floats) -> Complexes:
    """Window waves so that a product with an acceleration is an amplitude in m."""
    window = np.hanning(waves.shape[-1] + 2)[1:-1]
    weighed = waves * window * (2.0 / window.sum() / (2.0 * np.pi * hz) ** 2)
    weighed.setflags(write=False)
    return np.asarray(weighed)
