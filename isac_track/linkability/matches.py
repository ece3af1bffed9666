"""Who is whose mate if all are matched at once, and some have none: an open gallery.

References
----------
Matching with slack: Gold, Rangarajan, "A graduated assignment algorithm for graph
matching", IEEE TPAMI 18(4), 1996 (softassign). Scaling: Sinkhorn, Annals of
Mathematical Statistics 35, 1964. Conditional logit: McFadden, in *Frontiers in
Econometrics*, 1974.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from isac_track.linkability.ranks import log_sum_exp
from isac_track.types import Bools, Floats, Ints

_SCALINGS: Final = 300
_SCALED: Final = 1e-5
_FARTHEST: Final = 200.0  # Nats: what is less likely is as good as impossible.
# Probes, and candidates, that may be alone even if all have a mate.
_LEAST_SLACK: Final = 1e-3
# Logarithm of the greatest scale, and of the least, per spread of scores.
_STEEPEST: Final = 8.0
# Of the squared scale per spread: keeps it finite without errors.
_SCALE_PENALTY: Final = 1e-3


def open_matches(log_ratios: Floats, *, n_links: float) -> Floats:
    """Return how probable each pair is, (P, G), where a probe may be alone, and a candidate, too.

    A matching is as likely as the product of its pairs' ratios; `n_links` pairs are
    expected in it. Rows and columns of exp(log_ratios), with a further row and column
    for those who are alone, are scaled in turn until each probe's and each candidate's
    sum is 1 and all pairs' is `n_links`. Exact probabilities take permanents; these put
    the candidates in much the same order. A ratio may lack a factor that is common to
    all pairs. ValueError for no pair, or a score that is not finite.
    """
    if log_ratios.ndim != 2 or 0 in log_ratios.shape:  # noqa: PLR2004 - a matrix
        raise ValueError(
            f"log ratios must have shape (P, G), neither 0, got {log_ratios.shape}"
        )
    if not np.isfinite(log_ratios).all():
        raise ValueError("log ratios must be finite")
    n_probes, n_gallery = log_ratios.shape
    links = min(max(n_links, _LEAST_SLACK), min(n_probes, n_gallery) - _LEAST_SLACK)
    centred = log_ratios - np.median(log_ratios.max(axis=1))
    weight = np.ones((n_probes + 1, n_gallery + 1))
    weight[:-1, :-1] = np.exp(np.clip(centred, -_FARTHEST, _FARTHEST))
    weight[-1, -1] = 0.0
    of_rows, of_columns = np.ones(n_probes + 1), np.ones(n_gallery + 1)
    of_rows[-1], of_columns[-1] = n_gallery - links, n_probes - links
    columns = np.ones(n_gallery + 1)
    for _ in range(_SCALINGS):
        rows = of_rows / (weight @ columns)
        scaled = of_columns / (rows @ weight)
        is_done = np.abs(scaled / columns - 1.0).max() < _SCALED
        columns = scaled
        if is_done:
            break
    return np.asarray(rows[:-1, None] * weight[:-1, :-1] * columns[:-1])


def most_probable(order: Ints, probability: Floats) -> tuple[Ints, Bools]:
    """Return the most probable candidate of each probe, (P,), and who is rather alone, (P,).

    Of equals it is the first in this order of the columns, (G,). A probe is rather
    alone if that is more probable than any one candidate.
    """
    best = order[probability[:, order].argmax(axis=1)]
    alone = 1.0 - probability.sum(axis=1)
    return best, alone > probability.max(axis=1)


def fit_scale(scores: Sequence[Floats], mates: Sequence[Ints]) -> float:
    """Return by what scores are to be multiplied to be log-likelihood ratios within a row.

    It makes the mates of other people most probable among their candidates (conditional
    logit). `scores` are of several galleries, (P, G) each, `mates` (P,) the column of
    each probe's mate, or -1. 1 where no probe has a mate, or scores are constant.
    """
    rows = [
        (score[mate >= 0], mate[mate >= 0])
        for score, mate in zip(scores, mates, strict=True)
        if (mate >= 0).any()
    ]
    spread = (
        float(np.concatenate([score.ravel() for score, _ in rows]).std())
        if rows
        else 0.0
    )
    if not spread > 0.0:
        return 1.0

    def loss(log_scale: float) -> float:
        steepness = float(np.exp(log_scale))
        lost = _SCALE_PENALTY * steepness**2
        for score, mate in rows:
            scaled = steepness / spread * score
            own = scaled[np.arange(mate.size), mate]
            lost += float((log_sum_exp(scaled, axis=1)[:, 0] - own).sum())
        return lost

    best = minimize_scalar(loss, bounds=(-_STEEPEST, _STEEPEST), method="bounded")
    return float(np.exp(best.x)) / spread
