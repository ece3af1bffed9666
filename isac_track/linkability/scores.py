"""How well a threshold, or the score as evidence, tells mated from non-mated pairs.

`mated`, (M,), and `non_mated`, (N,), are the scores of either class; it is a ValueError
if a class is empty or a score is not finite.

References
----------
Likelihood ratios: Bruemmer and du Preez, Computer Speech and Language 20, 2006 (Cllr).
Hull: Fawcett and Niculescu-Mizil, Machine Learning 68, 2007 (the ROC's hull is isotonic
regression). D_sys: Gomez-Barrero, Galbally, Rathgeb, Busch, IEEE TIFS 13(6), 2018, with
prior odds of 1.
"""

import math
from dataclasses import dataclass

import numpy as np

from isac_track.linkability.significance import import_loops
from isac_track.types import Floats

MIN_EXPECTED = 30
"""Least number of non-mated scores expected above the threshold of a TPR.

At the FPR alpha a TPR needs 30 / alpha non-mated scores, since pairs of the same people
depend on each other. A closed gallery of N people has N (N - 1).
"""

SLOPE_PENALTY = 1e-6
"""Penalty of the squared slope per standard deviation of the score; a class weighs 1.

It keeps the slope finite where the classes do not overlap, and otherwise hardly changes
it.
"""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Log-likelihood ratio = slope * score + intercept, in natural units (nats).

    Attributes
    ----------
    slope : float
        Nats per unit of score, not negative: a higher score never speaks against the
        same person.
    intercept : float
        Nats at a score of 0.
    """

    slope: float
    intercept: float


def auc(*, mated: Floats, non_mated: Floats) -> float:
    """Return the share of pairs in which the mated score is higher; ties count half.

    `mated` are (M,), `non_mated` (N,). ValueError if a class is empty or a score is not
    finite.
    """
    return float(_read(mated, non_mated)[2])


def eer(*, mated: Floats, non_mated: Floats) -> float:
    """Return the equal error rate (1 - TPR = FPR) on the ROC's convex hull, 0..0.5.

    The hull is what an adversary attains by tossing a coin between two thresholds.
    Fawcett and Niculescu-Mizil, Machine Learning 68, 2007. `mated` are (M,),
    `non_mated` (N,); raises as `auc`.

    Examples
    --------
    A threshold of 2 accepts three in four mated scores and one in four others:

    >>> import numpy as np
    >>> from isac_track.linkability import auc, eer
    >>> mated = np.array([1.0, 2.0, 3.0, 3.0])
    >>> non_mated = np.array([0.0, 0.0, 1.0, 2.0])
    >>> eer(mated=mated, non_mated=non_mated), auc(mated=mated, non_mated=non_mated)
    (0.25, 0.875)
    """
    return float(_read(mated, non_mated)[3])


def tpr_at_fpr(
    *, mated: Floats, non_mated: Floats, alpha: float
) -> tuple[float, float]:
    """Return the largest TPR of a threshold with FPR <= alpha, and its FPR.

    Of the thresholds with that TPR it is the highest: the lowest mated score that it
    accepts. NaN twice for fewer than 30 / alpha non-mated scores (`MIN_EXPECTED`).
    ValueError also for an alpha that is not in (0, 1). `mated` are (M,), `non_mated`
    (N,); raises as `auc`.
    """
    _check_classes(mated, non_mated)
    if not 0 < alpha < 1:
        raise ValueError(f"alpha must lie in (0, 1), got {alpha}")
    if is_refused(non_mated.size, alpha):
        return float("nan"), float("nan")
    *_, tpr, fpr = _read(mated, non_mated, alpha)
    return float(tpr), float(fpr)


def fit_calibration(*, mated: Floats, non_mated: Floats) -> Calibration:
    """Fit log-likelihood ratios to scores by logistic regression.

    Both classes have the same total weight: prior odds of 1. A score that is constant,
    or higher for different people, gets the slope 0: then every LLR is 0, which is no
    evidence. Classes that do not overlap get a steep, finite slope (`SLOPE_PENALTY`).
    The scores must be of people other than those whom the calibration is to judge.
    `mated` are (M,), `non_mated` (N,); raises as `auc`.
    """
    _check_classes(mated, non_mated)
    scores = np.concatenate([mated, non_mated])
    centre, spread = float(scores.mean()), float(scores.std())
    if not spread > 0:
        return Calibration(0.0, 0.0)
    sign = np.repeat([1.0, -1.0], [mated.size, non_mated.size])
    mass = np.repeat(
        [1.0 / mated.size, 1.0 / non_mated.size], [mated.size, non_mated.size]
    )
    design = sign * np.stack([(scores - centre) / spread, np.ones(scores.size)])

    def gradient_at(parameters: Floats) -> tuple[Floats, Floats]:
        with np.errstate(over="ignore"):
            wrong = 1.0 / (1.0 + np.exp(parameters @ design))
        pull = mass * wrong
        return (
            np.array([SLOPE_PENALTY, 0.0]) * parameters - design @ pull,
            pull - pull * wrong,
        )

    # The intercept has a tiny penalty, too, lest rounding make the curvature singular.
    parameters, least = np.zeros(2), np.diag([SLOPE_PENALTY, 1e-12])
    gradient, bend = gradient_at(parameters)
    for _ in range(100):
        (a, b), (_, c) = (design * bend) @ design.T + least
        step = np.array([[c, -b], [-b, a]]) @ gradient / (a * c - b * b)
        fall = float(gradient @ step)
        if fall < 1e-18:  # noqa: PLR2004 - the fall of the next step is its square
            parameters -= step
            break
        gradient, bend = gradient_at(parameters - step)
        # The loss is convex: where it rises more steeply than it fell, the step was too
        # long.
        while -float(gradient @ step) > fall:
            step, fall = step / 2, fall / 2
            gradient, bend = gradient_at(parameters - step)
        parameters -= step
    if parameters[0] <= 0:
        return Calibration(0.0, 0.0)
    slope = float(parameters[0]) / spread
    return Calibration(slope, float(parameters[1]) - slope * centre)


def cllr(*, llr_mated: Floats, llr_non_mated: Floats) -> float:
    """Return the cost of log-likelihood ratios (nats in) as evidence, in bits.

    0 for a perfect attack, 1 for an attack without evidence (every LLR 0), more for an
    attack that misleads. `llr_mated` are (M,), `llr_non_mated` (N,); raises as `auc`.
    Bruemmer and du Preez, Computer Speech and Language 20, 2006.

    >>> import numpy as np
    >>> from isac_track.linkability import cllr
    >>> cllr(llr_mated=np.zeros(3), llr_non_mated=np.zeros(5))
    1.0
    """
    _check_classes(llr_mated, llr_non_mated)
    cost = softplus(-llr_mated).mean() + softplus(llr_non_mated).mean()
    return float(cost) / (2.0 * math.log(2.0))


def softplus(nats: Floats) -> Floats:
    """Return log(1 + e^x) without overflow, in steps that numpy vectorises."""
    cost = np.abs(nats)
    np.log1p(np.exp(np.negative(cost, out=cost), out=cost), out=cost)
    return np.add(cost, np.maximum(nats, 0.0), out=cost)


def cllr_min(*, mated: Floats, non_mated: Floats) -> float:
    """Return the least `cllr` of a monotone calibration of these scores, 0..1 bits.

    `mated` are (M,), `non_mated` (N,); raises as `auc`.
    """
    return float(_read(mated, non_mated)[4])


def d_sys(*, mated: Floats, non_mated: Floats) -> tuple[float, int]:
    """Return the system's linkability D_sys, 0..1, and the number of bins.

    With the likelihood ratio LR(s) = p(s | mated) / p(s | non-mated) of histograms over
    the joint range, D(s) = 2 LR / (1 + LR) - 1 where LR > 1 and 0 elsewhere; D_sys is
    the mean of D over mated scores. There is a bin for every ten mated scores, but at
    least 1 and at most 100. It ignores direction, and is biased upwards where scores
    are few. `mated` are (M,), `non_mated` (N,); raises as `auc`. Gomez-Barrero,
    Galbally, Rathgeb, Busch, IEEE TIFS 13(6), 2018, with prior odds of 1.
    """
    return float(_read(mated, non_mated)[0]), default_bins(mated.size)


def d_sys_published(*, mated: Floats, non_mated: Floats) -> float:
    """Return D_sys as the program of its authors computes it, 0..1.

    It has the bins of `d_sys`, but takes the integral by trapezia between their
    centres. So it leaves out half of what lies in the first and in the last bin, up to
    0.5 where the mated scores are there, and is 0 with a single bin. Arguments and
    errors are those of `d_sys`.
    """
    return float(_read(mated, non_mated)[1])


def default_bins(n_mated: int) -> int:
    """Return the number of bins of `d_sys`."""
    return max(1, min(n_mated // 10, 100))


def inner_edges(low: float, high: float, n_bins: int) -> Floats:
    """Return the edges between the bins of `d_sys`."""
    # As np.linspace, which takes several times as long for so few edges.
    return np.asarray(np.arange(1, n_bins) * ((high - low) / n_bins) + low)


def is_refused(n_non_mated: float, alpha: float) -> bool:
    """Tell whether non-mated scores are too few for `tpr_at_fpr`."""
    return n_non_mated * alpha < MIN_EXPECTED * (1 - 1e-12)


def _check_classes(mated: Floats, non_mated: Floats) -> None:
    for name, scores in (("mated", mated), ("non-mated", non_mated)):
        if scores.ndim != 1 or not scores.size:
            raise ValueError(
                f"{name} scores must have shape (N,), N > 0, got {scores.shape}"
            )
        if not np.isfinite(scores).all():
            raise ValueError(f"{name} scores must be finite")


def _read(mated: Floats, non_mated: Floats, *levels: float) -> Floats:
    """Return what the compiled loop `read_scores` writes if all scores weigh the same.

    Shape (5 + 2 levels,).
    """
    _check_classes(mated, non_mated)
    distinct, place = np.unique(np.concatenate([non_mated, mated]), return_inverse=True)
    classes = 2 * place + (np.arange(place.size) >= non_mated.size)
    counts = np.bincount(classes, minlength=2 * distinct.size).reshape(-1, 2)
    edges = inner_edges(
        float(distinct[0]), float(distinct[-1]), default_bins(mated.size)
    )
    bins = np.searchsorted(edges, distinct, side="right").astype(np.uint8)
    # A first search without a mate holds all non-mated scores. Each mated score is a
    # search of its own, with a gallery of the mate alone.
    shapes = np.ones((1 + mated.size, 2), dtype=np.int64)
    mate = np.zeros(1 + mated.size, np.int64)
    shapes[0, 1], mate[0] = non_mated.size, -1
    totals = np.array([[mated.size], [non_mated.size]])
    pairs = (
        shapes,
        np.zeros_like(mate),
        np.zeros_like(place),
        mate,
        place.astype(np.int32),
        counts,
    )
    out = np.empty((5 + 2 * len(levels), 1))
    import_loops().read_scores(
        np.ones((2, 1), np.uint8),
        pairs,
        bins,
        totals.astype(float),
        np.array(levels, float),
        out,
    )
    return np.asarray(out[:, 0])
