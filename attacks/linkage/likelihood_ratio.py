"""Link walks by their likelihood ratio: Gaussian walks behind known errors."""

from dataclasses import dataclass, replace
from importlib import import_module
from types import ModuleType
from typing import ClassVar, TypeAlias

import numpy as np
from scipy.special import logsumexp

from attacks.linkage.learning import MOST_PAIRS, make_linker
from attacks.linkage.shaped_information import ShapedSide, shaped_side
from attacks.parameters import require_positive
from attacks.reconstruction.kalman_rts import RadialRTS, information
from attacks.remembered import find_origin, memoised
from isac_track.kalman.slow_errors import added_error
from isac_track.linkability.ranks import soft_matches
from isac_track.measurement import error_ellipses
from isac_track.protocols import AttackContext, Linker
from isac_track.types import Floats, Knowledge, Release, read_only

_STEP_S = 0.5  # Between two lags.
_SPEED_M_S = 1.4  # Root mean square, of the prior.
_LEAST_OVERLAP_S = 2.0
_Slow: TypeAlias = tuple[float, float]  # As from `added_error`.


@dataclass(frozen=True, slots=True)
class LikelihoodRatio:
    """ln p(y1, y2) - ln p(y1) - ln p(y2), over all rotations, shifts and lags.

    A walk's overlap with another is a sum of Legendre polynomials p of degree 1 to
    `rank` (the mean is a shift, which hidden frames leave open). The prior covariance S
    of their coefficients is that of white acceleration of spectral density `q`. A
    release yields A = sum w p p' and h = sum w p z over its samples z, w the
    information of each. With M = A1 + A2 + S^-1 the ratio at one lag and rotation is
    Gaussian; averaged over rotations it is

        ln I0(|h1* M^-1 h2|) + (h1* M^-1 h1 + h2* M^-1 h2) / 2 - ln |M| + ln |S|
            + sum over both of ln |A + S^-1| - h* (A + S^-1)^-1 h / 2

    The score is the log of its mean over lags, which weighs a lag by exp(-|lag| /
    `lag_s`). The error variance of every coefficient grows by `floor_m2`, and by that
    of a mechanism's slow errors. The score is exact for Gaussian errors and independent
    Gaussian coefficients, at each lag by the overlap alone. (Under white acceleration,
    coefficients two degrees apart are correlated; S leaves that out.) It says nothing
    of a pair that shares no stretch of a walk.

    References
    ----------
    Likelihood ratio of common origin: Bar-Shalom, Li, Kirubarajan, *Estimation with
    Applications to Tracking and Navigation*, 2001, ch. 8.4 (track-to-track
    association). Marginalised rotation: Mardia, Jupp, *Directional Statistics*, 2000,
    ch. 3.5.
    """

    floor_m2: float = 1e-3
    # Mean lag. Other values of it and of the floor gained nothing on 80 mated pairs of
    # other people.
    lag_s: float = 2.5
    q: float = 0.04  # m^2/s^3
    rank: int = 6
    window_s: float = 12.0  # What comes later in a walk is left out.
    reach_s: float = 6.0  # Greatest lag.
    one_to_one: bool = False
    """Whether to assume that everybody has a mate, where there are as many candidates.

    A pair's score is then its probability given all other pairs (`soft_matches`).
    """

    shape: bool = False
    """Whether declared ellipses count, for an adversary who is granted SIGMA.

    Both axes then hang together, and the mean over rotations is numerical: 1 ms a
    pair. With round errors the score is the same.
    """

    kind: ClassVar[str] = "linkage"
    same_stretch: ClassVar[bool] = True
    requires: ClassVar[frozenset[Knowledge]] = frozenset()

    @property
    def uses(self) -> frozenset[Knowledge]:
        """The mechanism, and SIGMA if the `shape` of errors counts."""
        sigma = {Knowledge.SIGMA} if self.shape else set()
        return frozenset({Knowledge.MECHANISM} | sigma)

    def __post_init__(self) -> None:
        require_positive(floor_m2=self.floor_m2, lag_s=self.lag_s, q=self.q)
        require_positive(window_s=self.window_s, reach_s=self.reach_s)
        if not 1 <= self.rank <= 12:  # noqa: PLR2004 - beyond, nothing is left of a walk of 12 s
            raise ValueError(f"rank must be 1 to 12, got {self.rank}")
        if self.reach_s > self.window_s - _LEAST_OVERLAP_S:
            raise ValueError(
                f"reach_s must leave {_LEAST_OVERLAP_S:g} s of the window's"
                f" {self.window_s:g} s, got {self.reach_s:g}"
            )

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, which uses the mechanism's error law if it is granted."""
        knows_mechanism = Knowledge.MECHANISM in context.granted
        std_m, tau_s = added_error(context.mechanism) if knows_mechanism else (0.0, 0.0)
        # A constant error is a shift, a white error shows in the release.
        slow = (std_m, tau_s) if 0.0 < tau_s < np.inf else (0.0, 0.0)
        # Twice as many passes help where errors are added linearly, and harm elsewhere.
        adding = getattr(context.mechanism, "adding", "") if knows_mechanism else ""
        passes = RadialRTS.USUAL_PASSES * (2 if adding == "linear" else 1)
        score = _one_to_one if self.one_to_one else _ratios
        # Without `one_to_one`, so that both settings share one memo.
        return make_linker(score, replace(self, one_to_one=False), slow, passes)


def _one_to_one(
    probe: Release, gallery: Release, attack: LikelihoodRatio, slow: _Slow, passes: int
) -> Floats:
    """Return the probability of every pair given all others, (P, G).

    Where there are more or fewer candidates than probes, it is the score of `_ratios`.
    """
    score = _ratios(probe, gallery, attack, slow, passes)
    return soft_matches(score) if len(probe) == len(gallery) else score


def _ratios(
    probe: Release, gallery: Release, attack: LikelihoodRatio, slow: _Slow, passes: int
) -> Floats:
    """Return the log ratio of every pair, (P, G); with `one_to_one` or without."""
    is_small = len(probe) * len(gallery) <= MOST_PAIRS
    compute = _remembered_ratios if is_small else _compute_ratios
    return compute(probe, gallery, attack, slow, passes)


def _compute_ratios(
    probe: Release, gallery: Release, attack: LikelihoodRatio, slow: _Slow, passes: int
) -> Floats:
    lags_s, spread_m2 = _lags_s(attack), _spread_m2(attack)
    log_lag = -np.abs(lags_s) / attack.lag_s
    log_lag += np.log(spread_m2).sum(axis=1) - logsumexp(log_lag)
    if attack.shape and probe.cov is not None and gallery.cov is not None:
        return _shaped_ratios(probe, gallery, attack, slow, passes, log_lag)
    sides = []
    for release, sign in ((probe, 1), (gallery, -1)):
        origin, rows = find_origin(release)
        side = _side(origin, attack, slow, sign, passes)
        sides.append(tuple(array.take(rows, axis=2) for array in side))
    score = np.empty((len(probe), len(gallery)))
    _loops().ratios(*sides, 1.0 / spread_m2, log_lag, score)
    return read_only(score)


def _shaped_ratios(
    probe: Release,
    gallery: Release,
    attack: LikelihoodRatio,
    slow: _Slow,
    passes: int,
    log_lag: Floats,
) -> Floats:
    """Return the log ratio of every pair behind errors with a shape, (P, G)."""
    sides = []
    for release, sign in ((probe, 1), (gallery, -1)):
        origin, rows = find_origin(release)
        side = _shaped_side(origin, attack, slow, sign, passes)
        sides.append(tuple(array.take(rows, axis=1) for array in side))
    score = np.empty((len(probe), len(gallery)))
    import_module("attacks.linkage._shaped_ratio_loop").shaped_ratios(
        *sides, 1.0 / _spread_m2(attack), log_lag, score
    )
    return read_only(score)


_remembered_ratios = memoised(_compute_ratios)
"""Memoised for as long as the probe is alive: both ways to score take the same ratios."""


def _lags_s(attack: LikelihoodRatio) -> Floats:
    most = int(attack.reach_s / _STEP_S)
    # The likeliest first: the sum may skip lags that are far less likely.
    return np.array(sorted(range(-most, most + 1), key=abs)) * _STEP_S


def _spread_m2(attack: LikelihoodRatio) -> Floats:
    lasts_s = attack.window_s - np.abs(_lags_s(attack))
    return prior_m2(duration_s=lasts_s, q=attack.q, rank=attack.rank)


def _segments_s(attack: LikelihoodRatio, sign: int) -> Floats:
    """Return the stretch of a probe (sign 1) or gallery (-1) at each lag, (L, 2) s."""
    lags_s = _lags_s(attack)
    start_s = np.maximum(sign * lags_s, 0.0)
    return np.column_stack([start_s, start_s + attack.window_s - np.abs(lags_s)])


def _information(
    release: Release, attack: LikelihoodRatio, sign: int, passes: int
) -> Floats:
    """Return the information of a release as probe (sign 1) or gallery (-1).

    The array is (L, N, K, K + 2); see `_ratio_loop.accumulate_information`.
    """
    segments_s, rank = _segments_s(attack, sign), attack.rank
    out = np.empty((len(segments_s), len(release), rank, rank + 2))
    walks = release.t, release.xy, information(release, passes), release.offsets
    _loops().accumulate_information(
        tuple(map(np.ascontiguousarray, walks)), segments_s, out
    )
    return out


def _added_m2(attack: LikelihoodRatio, slow: _Slow) -> Floats:
    """Return the further error variance of the coefficients at each lag, (L, K, K)."""
    lags_s, rank, (std_m, tau_s) = _lags_s(attack), attack.rank, slow
    added_m2 = np.tile(attack.floor_m2 * np.eye(rank), (lags_s.size, 1, 1))
    if std_m > 0.0:
        for lag, lag_s in enumerate(np.abs(lags_s).tolist()):
            added_m2[lag] += std_m**2 * _slow_share(
                attack.window_s - lag_s, tau_s, rank
            )
    return added_m2


@memoised
def _shaped_side(
    release: Release, attack: LikelihoodRatio, slow: _Slow, sign: int, passes: int
) -> ShapedSide:
    """Return the three arrays that `_shaped_ratio_loop.shaped_ratios` takes."""
    assert release.cov is not None
    inverse = np.linalg.inv(error_ellipses(release.cov))
    weight = information(release, passes)
    return shaped_side(
        release,
        precision=weight[:, None, None] * inverse,
        segments_s=_segments_s(attack, sign),
        added_m2=_added_m2(attack, slow),
        prior=1.0 / _spread_m2(attack),
    )


@memoised
def _side(
    release: Release, attack: LikelihoodRatio, slow: _Slow, sign: int, passes: int
) -> tuple[Floats, ...]:
    """Return the three arrays that `_ratio_loop.ratios` takes for a side."""
    lags_s, rank, added_m2 = _lags_s(attack), attack.rank, _added_m2(attack, slow)
    sizes = (rank * (rank + 1) // 2, 2 * rank, 1)
    side = tuple(np.empty((lags_s.size, size, len(release))) for size in sizes)
    walk_information = _information(release, attack, sign, passes)
    _loops().take_sides(walk_information, added_m2, 1.0 / _spread_m2(attack), *side)
    return side


def _slow_share(duration_s: float, tau_s: float, rank: int) -> Floats:
    """Return the covariance of the coefficients of a slow unit error, (K, K).

    Its correlation fades by 1/e in `tau_s`.
    """
    position = np.linspace(-1.0, 1.0, 64)
    fit = np.linalg.pinv(np.polynomial.legendre.legvander(position, rank))[1:]
    gap_s = np.abs(position[:, None] - position) * duration_s / 2.0
    return read_only(fit @ np.exp(-gap_s / tau_s) @ fit.T)


def prior_m2(*, duration_s: Floats, q: float, rank: int) -> Floats:
    """Return the prior variance per axis of Legendre coefficients of walks, (L, K) m^2.

    The coefficients are those of degree 1 to `rank`, the walks last `duration_s`, (L,).
    Degree 1 is the velocity. The others follow from white acceleration of spectral
    density `q`, m^2/s^3, integrated twice by parts.
    """
    k = np.arange(2, rank + 1)
    ends = 2.0 / ((2 * k + 5) * (2 * k + 3) ** 2) + 2.0 / (
        (2 * k - 3) * (2 * k - 1) ** 2
    )
    bend = ends + 2.0 / (2 * k + 1) * (1.0 / (2 * k + 3) + 1.0 / (2 * k - 1)) ** 2
    velocity = (_SPEED_M_S * duration_s / 2.0) ** 2 / 2.0
    return np.column_stack([velocity, q * duration_s[:, None] ** 3 * bend / 32.0])


def _loops() -> ModuleType:
    return import_module("attacks.linkage._ratio_loop")
