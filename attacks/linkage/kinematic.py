"""Who walks on where somebody left off? Kalman states on both sides of a silent gap."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from attacks.linkage.learning import learn, linker, mated, teaches
from attacks.linkage.noise_levels import ASSUMED, NoiseModel, fitted_model, log_ratios
from attacks.linkage.signals import loops
from attacks.parameters import positive, tried
from attacks.remembered import by_track, noise_m2
from isac_track.kalman import Batch, kalman_last
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Floats, Knowledge, Release, derived

_PRIOR_STD = (100.0, 1.4)  # m around the first sample and m/s around rest: nobody runs.
# Degrees of freedom: people do turn and stop in a gap, more than white noise would.
_TAIL = 5.0
_SLACK_S = 0.5
# A longer gap counts as one of this length: nobody's state outlives it.
_LONGEST_S = 60.0


@dataclass(frozen=True, slots=True)
class Kinematic:
    """Likelihood that a gallery walk starts in the state that a probe's has got to by then.

    A constant-velocity filter runs along every probe and, back in time, along every
    gallery walk. The score is the log density of the difference of the probe's last
    state, predicted across the gap, from the gallery's first, under both covariances
    and the process noise of the gap: Student's t with five degrees of freedom, whose
    tail is a gate that never closes. To it is added the log likelihood ratio of the
    noise levels on both sides (`noise_levels.log_ratios`).

    References
    ----------
    Gruteser, Hoh, "On the anonymity of periodic location samples", SPC 2005
    (multi-target tracking as an attack on pseudonyms); Wiedersheim, Ma, Kargl,
    Papadimitratos, "Privacy in inter-vehicular networks: why simple pseudonym change is
    not enough", WONS 2010. Bar-Shalom, Li, Kirubarajan, *Estimation with Applications
    to Tracking and Navigation*, 2001, ch. 6.2.
    """

    # m^2/s^3; None: learnt from the training set, or `DEFAULT_Q`.
    q: float | None = None
    floor_m2: float | None = None
    """Least error variance per axis: a smoother's errors are correlated and do not show in the
    innovations. None: learnt, or `DEFAULT_FLOOR_M2`."""

    noise_correlation: float | None = None
    """Between the log noise levels of a person on both sides, from 0 (levels are left out) to below
    1. None: learnt, or that of `noise_levels.ASSUMED`."""

    kind: ClassVar[str] = "linkage"
    across_gap: ClassVar[bool] = True
    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SCENE})
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_Q: ClassVar[float] = 0.05
    DEFAULT_FLOOR_M2: ClassVar[float] = 0.01

    def __post_init__(self) -> None:
        positive(q=self.q, floor_m2=self.floor_m2)
        if not (self.noise_correlation is None or 0.0 <= self.noise_correlation < 1.0):
            raise ValueError(
                "noise_correlation must be from 0 to below 1, got"
                f" {self.noise_correlation}"
            )

    def fit(self, context: AttackContext) -> Linker:
        """Return what scores walks like those in the training set."""
        model = fitted_model(context.train) if teaches(context) else ASSUMED
        if self.noise_correlation is not None:
            model = replace(model, correlation=self.noise_correlation)
        densities = tried(self.q, (self.DEFAULT_Q, 0.0125, 0.2))
        floors_m2 = tried(self.floor_m2, (self.DEFAULT_FLOOR_M2, 0.001, 0.1))
        scores = partial(_scores, model=model)
        return linker(
            evidence, *learn(context, (densities, floors_m2), scores=scores), model
        )


def _scores(
    train: LinkageTrainingSet, *, model: NoiseModel
) -> Callable[[float, float], Floats]:
    """Return what turns q and floor into the scores of a training set, (P, G)."""
    # As releases of their own: several filters of everybody would cost more than they
    # save.
    sides, gap_s = (derived(train.probe), derived(train.gallery)), rivals(train)
    noise = level_ratios(train.probe, train.gallery, model)
    return lambda q, floor_m2: continuations(*sides, q, floor_m2, gap_s=gap_s) + noise


def rivals(train: LinkageTrainingSet) -> tuple[float, float]:
    """Return the least and the longest gap, s, of pairs of a training set that may be mates."""
    # Where pseudonyms rotated more than once only those compete whose gap is that of
    # one rotation.
    rows = mated(train)
    begun_s = train.gallery.t[train.gallery.offsets[train.mate[rows]]]
    known_s = begun_s - train.probe.t[train.probe.offsets[rows + 1] - 1]
    return float(known_s.min()) - _SLACK_S, float(known_s.max()) + _SLACK_S


def evidence(
    probe: Release, gallery: Release, q: float, floor_m2: float, model: NoiseModel
) -> Floats:
    """Return `continuations` and the log likelihood ratio of the noise levels, summed, (P, G)."""
    motion = continuations(probe, gallery, q, floor_m2)
    return motion + level_ratios(probe, gallery, model)


def level_ratios(probe: Release, gallery: Release, model: NoiseModel) -> Floats | float:
    """Return the log likelihood ratio of the noise levels, (P, G), or 0 if they tell nothing."""
    return log_ratios(probe, gallery, model) if model.correlation > 0.0 else 0.0


def continuations(
    probe: Release,
    gallery: Release,
    q: float,
    floor_m2: float,
    gap_s: tuple[float, float] = (-np.inf, np.inf),
) -> Floats:
    """Return the log density of each gallery walk as the continuation of each probe, (P, G).

    Up to a constant; `q` in m^2/s^3, `floor_m2` the least error variance per axis.
    There is no density where the gap is not within `gap_s`.
    """
    ends = _ends(probe, q, floor_m2, 1), _ends(gallery, q, floor_m2, -1)
    until_s, mean, cov = (np.concatenate(each) for each in zip(*ends, strict=True))
    density = np.empty((len(probe), len(gallery)))
    loops().continued(until_s, mean, cov, q, (*gap_s, _LONGEST_S), _TAIL, density)
    return density


@by_track(lambda ends, rows: tuple(one[rows] for one in ends))
def _ends(
    release: Release, q: float, floor_m2: float, at: int
) -> tuple[Floats, Floats, Floats]:
    """Return times and states, mean and covariance, at the ends of walks, or (-1) their starts."""
    t, xy, sizes = release.t, release.xy, np.diff(release.offsets)
    if at < 0:  # back in time, from its last sample to its first
        ends = release.offsets[:-1] + release.offsets[1:] - 1
        turned = np.repeat(ends, sizes) - np.arange(t.size)
        t, xy = -t[turned], xy[turned]
    variance_m2 = np.repeat(np.maximum(noise_m2(release), floor_m2), sizes)
    state = kalman_last(Batch(t, xy, variance_m2, release.offsets, _PRIOR_STD), q=q)
    return t[release.offsets[1:] - 1], state.mean, state.cov
