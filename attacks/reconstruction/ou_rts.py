"""Smooth a walk and its slow error together: the error is an extra Kalman state.

An adversary who knows the mechanism knows how large and how slow the error is; others
fit it to the release. Without a slow error the attack is `radial_rts`. Repeats are
averaged before they are smoothed. A known position is a sample without an error.
Companions are moved onto the walk and averaged with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from typing import ClassVar, NamedTuple

import numpy as np

from attacks.parameters import candidate_values, require_positive
from attacks.reconstruction.kalman_rts import RadialRTS, looks_radial
from attacks.reconstruction.learning import (
    COMMON_KNOWLEDGE,
    RADIAL_PER_AXIS,
    candidates_around,
    choose,
)
from attacks.reconstruction.own_motion import (
    PRIOR_STD,
    probabilities,
    smooth_own_motion,
)
from attacks.remembered import memoised, noise_m2
from isac_track.kalman import Batch
from isac_track.kalman.slow_errors import (
    LEAST_REST,
    SlowError,
    added_error,
    filter_tracks,
    smooth_tracks,
)
from isac_track.measurement import (
    covariance_without,
    error_ellipses,
    mean_variance,
)
from isac_track.noise import MIN_VARIANCE_M2
from isac_track.protocols import WALK_KNOWLEDGE, AttackContext, Reconstructor
from isac_track.types import Floats, Knowledge, Reconstruction, Release, derived

_STD_M = (0.2, 0.4, 0.8, 1.6)
_TAU_S = (1.0, 3.0, 9.0, 27.0)
# Factors of the search about the best of the grid, one after the other.
_STEPS = (1.5, 1.2, 1.08)
_MOST_STEPS = 8
_N_FITTED = 40  # The error is fitted to at most so many tracks.
# Gain in log likelihood a track. Below it, the error may be the sway of people.
_LEAST_GAIN = 2.0
_LEAST_TOGETHER = 20  # Samples that a companion shares with a walk.
_KNOWN_M2 = 1e-4  # Error variance per axis of a known position.


class _Choice(NamedTuple):
    """The error and the motion that an adversary assumes."""

    std_m: Floats | float
    tau_s: float
    q: float | None  # m^2/s^3; None: each track has a motion of its own.
    passes: int


@dataclass(frozen=True, slots=True)
class OuRTS:
    """Each track's own motion behind an Ornstein-Uhlenbeck error and a white one.

    The white error may be radial. However slow the other error is, a person who stands
    is at the mean of her samples, and the release shows that she stands
    (`smooth_own_motion`).
    """

    q: float | None = None
    """m^2/s^3, of all tracks; None: each has a motion of its own (see `RadialRTS`)."""
    std_m: float | None = None
    """Per axis, of the slow error; None, with `tau_s`: of the mechanism, or fitted."""
    tau_s: float | None = None
    own_motion: bool = True  # Else q is learnt from the training set, or `DEFAULT_Q`.

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = (
        COMMON_KNOWLEDGE | WALK_KNOWLEDGE | {Knowledge.SCENE}
    )
    DEFAULT_Q: ClassVar[float] = RadialRTS.DEFAULT_Q

    def __post_init__(self) -> None:
        require_positive(q=self.q, std_m=self.std_m, tau_s=self.tau_s)
        if (self.std_m is None) != (self.tau_s is None):
            raise ValueError("give both std_m and tau_s, or neither to have them found")

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother, with the error known, learnt, or fitted to a release."""
        known_error, granted = self._known_error(context), context.granted
        # Repeats in frames of their own cannot be averaged.
        repeats = (
            context.repeats if {Knowledge.REPEATS, Knowledge.SCENE} <= granted else ()
        )
        companions = context.companions if Knowledge.COMPANIONS in granted else ()
        anchor = context.anchor if Knowledge.ANCHOR in granted else None
        # Companions do not help against white errors.
        if known_error == (0.0, 0.0) and not (repeats or anchor):
            return self._white.fit(context)
        if not (repeats or companions or anchor is not None):
            return self._fit_alone(context, known_error)
        mechanism = context.mechanism if Knowledge.MECHANISM in granted else None
        has_session_error = getattr(mechanism, "reuse", "release") == "session"
        motion = self._motion
        # Averages and anchors take only the density of the motion from what is learnt:
        # error and passes are those of the release. A given q, or a motion of each
        # track, leaves no density to learn.
        learns_density = self.q is None and not self.own_motion
        if learns_density and self._learns(context, known_error):
            motion = self._learnt_choice(context, known_error).q

        def reconstruct(release: Release) -> Reconstruction:
            std_m, tau_s = known_error or fit_slow_error(release, self._assumed_q)
            averaged, n = _averaged(release, repeats, companions, std_m)
            if has_session_error:  # every release of a session has the same error
                n = np.ones_like(n)
            choice = _Choice(std_m / np.sqrt(n), tau_s, motion, _usual_passes(averaged))
            return smooth(averaged, choice, anchor)

        return reconstruct

    def _fit_alone(
        self, context: AttackContext, known_error: tuple[float, float] | None
    ) -> Reconstructor:
        """Return the smoother of a release without repeats, companions or an anchor."""
        white_smoother = self._white.fit(context)
        if self._learns(context, known_error):
            best = self._learnt_choice(context, known_error)
            if best.std_m == 0.0:
                return white_smoother
            return lambda release: smooth(release, best)

        def reconstruct(release: Release) -> Reconstruction:
            std_m, tau_s = known_error or fit_slow_error(release, self._assumed_q)
            if std_m == 0.0:
                return white_smoother(release)
            passes = _usual_passes(release)
            return smooth(release, _Choice(std_m, tau_s, self._motion, passes))

        return reconstruct

    @property
    def _white(self) -> RadialRTS:
        """The attack without a slow error."""
        return RadialRTS(self.q, own_motion=self.own_motion)

    @property
    def _assumed_q(self) -> float:
        """Density of the motion where none is learnt, m^2/s^3."""
        return self.DEFAULT_Q if self.q is None else self.q

    @property
    def _motion(self) -> float | None:
        """Density of the motion of a choice, m^2/s^3; None: of each track its own."""
        return None if self._has_own_motion else self._assumed_q

    def _learns(
        self, context: AttackContext, known_error: tuple[float, float] | None
    ) -> bool:
        """Return whether there is a training set, and a slow error to learn."""
        return Knowledge.TRAIN in context.granted and known_error != (0.0, 0.0)

    @property
    def _has_own_motion(self) -> bool:
        return self.own_motion and self.q is None

    def _known_error(self, context: AttackContext) -> tuple[float, float] | None:
        """Return std, m, and tau, s, of the slow error; None if they are unknown.

        Both are 0 if the adversary knows that there is no slow error.
        """
        if self.std_m is not None and self.tau_s is not None:
            return self.std_m, self.tau_s
        if Knowledge.MECHANISM not in context.granted:
            return None
        mechanism = context.mechanism
        std_m, tau_s = added_error(mechanism)
        if std_m > 0.0 and tau_s > 0.0:
            return std_m, tau_s
        if std_m > 0.0 or not getattr(mechanism, "adds_error", True):
            return 0.0, 0.0
        return None

    def _learnt_choice(
        self, context: AttackContext, known_error: tuple[float, float] | None
    ) -> _Choice:
        """Return the choice that reconstructs the training set best.

        Candidates are the known error and the error fitted to the training set, with
        several passes or one; then several densities of a motion of all tracks.
        """
        errors = [] if known_error is None else [known_error]
        if self.std_m is None:
            fitted_error = fit_slow_error(context.train.release, self._assumed_q)
            if fitted_error not in errors:
                errors.append(fitted_error)
        choices = [
            _Choice(std_m, tau_s, self._motion, passes)
            for std_m, tau_s in errors
            for passes in (RadialRTS.USUAL_PASSES, 1)
        ]
        choose_best = partial(
            choose,
            context,
            default=choices[0],
            reconstruct=lambda choice, release: smooth(release, choice).xy,
        )
        best = choose_best(candidates=choices)
        if self._has_own_motion:
            return best
        around = candidates_around(self._assumed_q, factor=4.0)
        densities = candidate_values(self.q, around)
        return choose_best(
            candidates=[best._replace(q=density) for density in densities]
        )


def _usual_passes(release: Release) -> int:
    """Return the number of smoothers of a release when it is not learnt."""
    return RadialRTS.USUAL_PASSES if looks_radial(release) else 1


def _averaged(
    release: Release,
    repeats: Sequence[Release],
    companions: Sequence[Release],
    std_m: float,
) -> tuple[Release, Floats]:
    """Return the mean of all releases of each walk, and the reports per sample, (M,).

    A companion counts where both walks have samples, moved by the mean gap between
    them. Its weight is the share of the slow error, of `std_m`, in the variance of that
    gap. The declared std is not that of a mean: the result has none.
    """
    xy = np.mean([item.xy for item in (release, *repeats)], axis=0)
    n = np.full(release.t.size, 1.0 + len(repeats))
    total, level_m2 = xy * n[:, None], noise_m2(release)
    for others in companions if std_m else ():
        for i in range(len(release)):
            own = slice(release.offsets[i], release.offsets[i + 1])
            along = slice(others.offsets[i], others.offsets[i + 1])
            t, known_s = release.t[own], others.t[along]
            during = np.flatnonzero((t >= known_s[0]) & (t <= known_s[-1])) + own.start
            if known_s.size < _LEAST_TOGETHER or during.size < _LEAST_TOGETHER:
                continue
            x, y = others.xy[along].T
            instants_s = release.t[during]
            companion_xy = np.column_stack(
                [np.interp(instants_s, known_s, x), np.interp(instants_s, known_s, y)]
            )
            gap = companion_xy - xy[during]
            apart_m2 = gap.var(axis=0).mean() - 2.0 * (std_m**2 + level_m2[i])
            weight = std_m**2 / (std_m**2 + max(apart_m2, 0.0))
            total[during] += weight * (companion_xy - gap.mean(axis=0))
            n[during] += weight
    return derived(release, xy=total / n[:, None], sigma=None, cov=None), n


def smooth(
    release: Release, choice: _Choice, anchor: Release | None = None
) -> Reconstruction:
    """Return smoothed positions; the white error is as declared, or from innovations.

    Of declared covariances the slow error is round, and the white one has the rest.

    `anchor` has a true position of each track. ValueError if a position lies outside
    its track.
    """
    error = SlowError(choice.std_m, choice.tau_s)
    t, xy, offsets = release.t, release.xy, release.offsets
    rest_m2, ellipse = _white_rest(release, error)
    std_m = np.broadcast_to(error.std_m, t.shape)
    known = np.zeros(0, dtype=np.int64)
    if anchor is not None:
        first, last = t[offsets[:-1]], t[offsets[1:] - 1]
        outside = np.flatnonzero((anchor.t < first) | (anchor.t > last))
        if outside.size:
            number = outside[0]
            raise ValueError(
                f"the anchor of track {number} is at {anchor.t[number]:.12g} s,"
                f" outside its {first[number]:.12g} to {last[number]:.12g} s"
            )
        until = t <= np.repeat(anchor.t, np.diff(offsets))
        known = offsets[:-1] + np.add.reduceat(until, offsets[:-1], dtype=np.int64)
        t, xy = np.insert(t, known, anchor.t), np.insert(xy, known, anchor.xy, axis=0)
        rest_m2 = np.insert(rest_m2, known, _KNOWN_M2)
        std_m = np.insert(std_m, known, 0.0)
        if ellipse is not None:
            ellipse = np.insert(ellipse, known, np.eye(2), axis=0)
        offsets = offsets + np.arange(offsets.size)
    batch = Batch(t, xy, rest_m2, offsets, PRIOR_STD, ellipse)
    error = SlowError(std_m, choice.tau_s)
    passes, anneal = choice.passes, RadialRTS().anneal
    if choice.q is None:
        weight = probabilities(batch, error)
        position, spread = smooth_own_motion(
            batch, error, weight, passes=passes, anneal=anneal
        )
    else:
        position, spread = smooth_tracks(
            batch, error, q=choice.q, passes=passes, anneal=anneal
        )
    inserted = known + np.arange(known.size)
    position = np.delete(position, inserted, axis=0)
    variance = np.delete(spread, inserted)
    return Reconstruction(position, np.sqrt(np.maximum(variance, 0.0)))


def _white_rest(release: Release, error: SlowError) -> tuple[Floats, Floats | None]:
    """Return mean variance, (M,) m^2, and ellipses of the white error, if declared."""
    if release.cov is None:
        return _rest_m2(release, error), None
    rest = covariance_without(release.cov, std_m=error.std_m, least_m2=MIN_VARIANCE_M2)
    return mean_variance(rest), error_ellipses(rest)


def _rest_m2(release: Release, error: SlowError) -> Floats:
    """Return the variance per axis of the white error, (M,) m^2."""
    slow_m2 = np.square(error.std_m)
    if release.sigma is not None:
        # With an isotropic added error of std s per axis, releases declare sqrt(raw^2 +
        # s^2): the law is that of the raw error alone.
        return np.maximum(
            RADIAL_PER_AXIS * (release.sigma**2 - slow_m2), MIN_VARIANCE_M2
        )
    level_m2 = noise_m2(release)
    if np.ndim(slow_m2):  # the mean over a track stands for all of its samples
        slow_m2 = np.add.reduceat(slow_m2, release.offsets[:-1]) / np.diff(
            release.offsets
        )
    rest_m2 = level_m2 - slow_m2 * error.innovation_share(
        t=release.t, offsets=release.offsets
    )
    return np.repeat(
        np.maximum(rest_m2, LEAST_REST * level_m2), np.diff(release.offsets)
    )


@memoised
def fit_slow_error(release: Release, q: float) -> tuple[float, float]:
    """Return std, m, and tau, s, of the slow error that makes a release likeliest.

    Both are 0 if that gains less than `_LEAST_GAIN` a track over no slow error.
    """
    rows = np.unique(
        np.linspace(0, len(release) - 1, min(_N_FITTED, len(release))).astype(int)
    )
    sample = release.tracks(rows).without_sigma()

    # A grid is searched twice where its parts meet; it ends with this call.
    @cache
    def likelihood(std_and_tau: tuple[float, float]) -> float:
        error = SlowError(*std_and_tau)
        batch = Batch(
            sample.t, sample.xy, _rest_m2(sample, error), sample.offsets, PRIOR_STD
        )
        return float(filter_tracks(batch, error, q=q).last.log_likelihood.sum())

    best = max(product(_STD_M, _TAU_S), key=likelihood)
    for factor in _STEPS:
        for _ in range(_MOST_STEPS):
            std, tau = best
            # Along the ridge of constant s^2 / tau, which short times show, and across.
            neighbours = []
            for step in (factor, 1.0 / factor):
                neighbours += [(std * step, tau * (step * step)), (std * step, tau)]
            best = max(best, *neighbours, key=likelihood)
            if best == (std, tau):
                break
    gain = likelihood(best) - likelihood((0.0, 0.0))
    return best if gain > _LEAST_GAIN * len(sample) else (0.0, 0.0)
