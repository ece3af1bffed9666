"""An adversary who reckons with an error that changes slowly: it is smoothed as a state of its own.

Who knows the mechanism is told how large and how slow the error is; everybody else
finds out from the release. Where nothing slow is added it is `radial_rts`. Repeats are
averaged before they are smoothed; one known position is a sample without an error; who
walks along is laid on the walk and averaged with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from typing import ClassVar, NamedTuple

import numpy as np

from attacks.parameters import positive, tried
from attacks.reconstruction.kalman_rts import RadialRTS, looks_radial
from attacks.reconstruction.learning import RADIAL_PER_AXIS, TOLD, around, choose
from attacks.reconstruction.own_motion import (
    PRIOR_STD,
    probabilities,
    smooth_own_motion,
)
from attacks.remembered import noise_m2, remembered
from isac_track.kalman import Batch
from isac_track.kalman.slow_errors import (
    SlowError,
    added_error,
    filter_tracks,
    smooth_tracks,
)
from isac_track.noise import MIN_VARIANCE_M2
from isac_track.protocols import OF_WALKS, AttackContext, Reconstructor
from isac_track.types import Floats, Knowledge, Reconstruction, Release, derived

_STD_M = (0.2, 0.4, 0.8, 1.6)
_TAU_S = (1.0, 3.0, 9.0, 27.0)
_STEPS = (
    1.5,
    1.2,
    1.08,
)  # Factors of the search about the best of the grid, one after the other.
_MOST_STEPS = 8
_N_FITTED = 40  # Tracks that the error is fitted to, at most.
# Of log likelihood a track: below, it explains no more than how people sway.
_LEAST_GAIN = 2.0
_LEAST_TOGETHER = 20  # Samples: who is there for less is no companion.
_KNOWN_M2 = 1e-4  # A known position is so good, per axis.
# Share of what innovations show that is never put down to a slow error.
_LEAST_REST = 0.05


class _Choice(NamedTuple):
    """What an adversary reckons with."""

    std_m: Floats | float
    tau_s: float
    q: float | None  # m^2/s^3; None: each track has a motion of its own.
    passes: int


@dataclass(frozen=True, slots=True)
class OuRTS:
    """Each track's own motion behind an Ornstein-Uhlenbeck error; the rest is white, radial or not.

    Who stands is where the mean of her samples is, however slow the error: that the
    release tells (`smooth_own_motion`).
    """

    q: float | None = None
    """m^2/s^3, of all tracks; None: each has a motion of its own, but where nothing slow is added
    (`RadialRTS`)."""
    std_m: float | None = None
    """Per axis, of the slow error; None, with `tau_s`: as the mechanism says, or fitted."""
    tau_s: float | None = None
    own_motion: bool = True  # Else q is learnt from the training set, or `DEFAULT_Q`.

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = TOLD | OF_WALKS | {Knowledge.SCENE}
    DEFAULT_Q: ClassVar[float] = RadialRTS.DEFAULT_Q

    def __post_init__(self) -> None:
        positive(q=self.q, std_m=self.std_m, tau_s=self.tau_s)
        if (self.std_m is None) != (self.tau_s is None):
            raise ValueError("give both std_m and tau_s, or neither to have them found")

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        told, granted = self._told(context), context.granted
        # Repeats in frames of their own cannot be laid upon each other.
        repeats = (
            context.repeats if {Knowledge.REPEATS, Knowledge.SCENE} <= granted else ()
        )
        companions = context.companions if Knowledge.COMPANIONS in granted else ()
        anchor = context.anchor if Knowledge.ANCHOR in granted else None
        mechanism = context.mechanism if Knowledge.MECHANISM in granted else None
        q = self.DEFAULT_Q if self.q is None else self.q
        motion = None if self._has_own_motion else q
        # Companions say nothing of a walk whose errors are white.
        if told == (0.0, 0.0) and not (repeats or anchor):
            return RadialRTS(self.q, own_motion=self.own_motion).fit(context)
        sees_more = repeats or companions or anchor is not None
        white = (
            None
            if sees_more
            else RadialRTS(self.q, own_motion=self.own_motion).fit(context)
        )
        if Knowledge.TRAIN in context.granted and told != (0.0, 0.0):
            best = self._learnt(context, told, q)
            if white:
                return (
                    white
                    if best.std_m == 0.0
                    else lambda release: smooth(release, best)
                )
            motion = best.q

        def reconstruct(release: Release) -> Reconstruction:
            std_m, tau_s = told or fitted(release, q)
            if white and std_m == 0.0:
                return white(release)
            shown, n = release, np.ones(())
            if sees_more:
                shown, n = _averaged(release, repeats, companions, std_m)
            if getattr(mechanism, "reuse", "release") == "session":
                n = np.ones_like(n)  # the same error every time
            passes = RadialRTS.USUAL_PASSES if looks_radial(shown) else 1
            return smooth(
                shown, _Choice(std_m / np.sqrt(n), tau_s, motion, passes), anchor
            )

        return reconstruct

    @property
    def _has_own_motion(self) -> bool:
        return self.own_motion and self.q is None

    def _told(self, context: AttackContext) -> tuple[float, float] | None:
        """Return std and tau of the slow error; 0 and 0 if there is none, None if nobody says."""
        if self.std_m is not None and self.tau_s is not None:
            return self.std_m, self.tau_s
        if Knowledge.MECHANISM not in context.granted:
            return None
        mechanism = context.mechanism
        std_m, tau_s = added_error(mechanism)
        if std_m > 0.0 and tau_s > 0.0:
            return std_m, tau_s
        return (
            (0.0, 0.0)
            if std_m > 0.0 or not getattr(mechanism, "adds_error", True)
            else None
        )

    def _learnt(
        self, context: AttackContext, told: tuple[float, float] | None, q: float
    ) -> _Choice:
        """Return what reconstructs the training set best: told, found there, or nothing slow."""
        found = None if self.std_m is not None else fitted(context.train.release, q)
        errors = dict.fromkeys(filter(None, (told, found)))
        numbers = (RadialRTS.USUAL_PASSES, 1)
        motion = None if self._has_own_motion else q
        first = [_Choice(*one, motion, number) for one in errors for number in numbers]
        best_of = partial(
            choose,
            context,
            default=first[0],
            reconstruct=lambda one, shown: smooth(shown, one).xy,
        )
        best = best_of(candidates=first)
        densities = (
            (None,) if self._has_own_motion else tried(self.q, around(q, factor=4.0))
        )
        return best_of(candidates=[best._replace(q=one) for one in densities])


def _averaged(
    release: Release,
    repeats: Sequence[Release],
    companions: Sequence[Release],
    std_m: float,
) -> tuple[Release, Floats]:
    """Return the mean of all that shows a walk, and of how many reports each sample is, (M,).

    Who walks along counts where they are there at the same time, moved to where the two
    are together on average, by the share of the slow error, of `std_m`, in all that
    moves between them. The declared std is not that of a mean: it goes.
    """
    xy = np.mean([one.xy for one in (release, *repeats)], axis=0)
    n = np.full(release.t.size, 1.0 + len(repeats))
    total, level_m2 = xy * n[:, None], noise_m2(release)
    for others in companions if std_m else ():
        for i in range(len(release)):
            own, along = (slice(*one.offsets[i : i + 2]) for one in (release, others))
            t, known_s = release.t[own], others.t[along]
            there = np.flatnonzero((t >= known_s[0]) & (t <= known_s[-1])) + own.start
            if known_s.size < _LEAST_TOGETHER or there.size < _LEAST_TOGETHER:
                continue
            beside = np.column_stack(
                [
                    np.interp(release.t[there], known_s, axis)
                    for axis in others.xy[along].T
                ]
            )
            gap = beside - xy[there]
            apart_m2 = gap.var(axis=0).mean() - 2.0 * (std_m**2 + level_m2[i])
            weight = std_m**2 / (std_m**2 + max(apart_m2, 0.0))
            total[there] += weight * (beside - gap.mean(axis=0))
            n[there] += weight
    return derived(release, xy=total / n[:, None], sigma=None), n


def smooth(
    release: Release, choice: _Choice, anchor: Release | None = None
) -> Reconstruction:
    """Return smoothed positions; the white rest is what is declared, or what innovations show.

    `anchor` has a true position of each track. ValueError if one lies outside its
    track.
    """
    error = SlowError(choice.std_m, choice.tau_s)
    t, xy, rest, offsets = release.t, release.xy, _rest(release, error), release.offsets
    std_m = np.broadcast_to(error.std_m, t.shape)
    known = np.zeros(0, dtype=np.int64)
    if anchor is not None:
        first, last = t[offsets[:-1]], t[offsets[1:] - 1]
        outside = np.flatnonzero((anchor.t < first) | (anchor.t > last))
        if outside.size:
            one = outside[0]
            raise ValueError(
                f"the anchor of track {one} is at {anchor.t[one]:.12g} s, outside its "
                f"{first[one]:.12g} to {last[one]:.12g} s"
            )
        until = t <= np.repeat(anchor.t, np.diff(offsets))
        known = offsets[:-1] + np.add.reduceat(until, offsets[:-1], dtype=np.int64)
        t, xy = np.insert(t, known, anchor.t), np.insert(xy, known, anchor.xy, axis=0)
        rest, std_m = np.insert(rest, known, _KNOWN_M2), np.insert(std_m, known, 0.0)
        offsets = offsets + np.arange(offsets.size)
    batch, error = (
        Batch(t, xy, rest, offsets, PRIOR_STD),
        SlowError(std_m, choice.tau_s),
    )
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
    at = known + np.arange(known.size)
    position, spread = np.delete(position, at, axis=0), np.delete(spread, at)
    return Reconstruction(position, np.sqrt(np.maximum(spread, 0.0)))


def _rest(release: Release, error: SlowError) -> Floats:
    """Return the variance per axis, (M,) m^2, of what is neither walk nor slow error."""
    slow_m2 = np.square(error.std_m)
    if release.sigma is not None:
        return np.maximum(
            RADIAL_PER_AXIS * (release.sigma**2 - slow_m2), MIN_VARIANCE_M2
        )
    level = noise_m2(release)
    if np.ndim(slow_m2):  # one for all samples of a track will do
        slow_m2 = np.add.reduceat(slow_m2, release.offsets[:-1]) / np.diff(
            release.offsets
        )
    rest = level - slow_m2 * error.innovation_share(
        t=release.t, offsets=release.offsets
    )
    return np.repeat(np.maximum(rest, _LEAST_REST * level), np.diff(release.offsets))


@remembered
def fitted(release: Release, q: float) -> tuple[float, float]:
    """Return std, m, and tau, s, of the slow error under which a release is likeliest.

    0 and 0 if it gains less than `_LEAST_GAIN` a track over none.
    """
    rows = np.unique(
        np.linspace(0, len(release) - 1, min(_N_FITTED, len(release))).astype(int)
    )
    some = derived(release.tracks(rows), sigma=None)

    @cache
    def likelihood(std_and_tau: tuple[float, float]) -> float:
        error = SlowError(*std_and_tau)
        batch = Batch(some.t, some.xy, _rest(some, error), some.offsets, PRIOR_STD)
        return float(filter_tracks(batch, error, q=q)[0].log_likelihood.sum())

    best = max(product(_STD_M, _TAU_S), key=likelihood)
    for factor in _STEPS:
        for _ in range(_MOST_STEPS):
            std, tau = best
            # Along the ridge, s^2 / tau, of what a short time shows, and across it.
            ways = product((factor, 1.0 / factor), (True, False))
            beside = [
                (std * by, tau * (by * by if along else 1.0)) for by, along in ways
            ]
            best = max(best, *beside, key=likelihood)
            if best == (std, tau):
                break
    gain = likelihood(best) - likelihood((0.0, 0.0))
    return best if gain > _LEAST_GAIN * len(some) else (0.0, 0.0)
