"""Matching of all probes and candidates at once, where some have no mate.

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

from isac_track.linkability.ranks import log_sum_exp
from isac_track.types import Bools, Floats, Ints

_MOST_SWEEPS: Final = 300
_TOLERANCE: Final = 1e-5  # Greatest relative change of a factor in the last sweep.
_MOST_NATS: Final = 200.0  # Pairs that are less likely are as good as impossible.
# Expected number of probes, and of candidates, without a mate if all may have a mate.
_LEAST_SLACK: Final = 1e-3
# Greatest logarithm, up or down, of the scale per spread of scores.
_STEEPEST: Final = 8.0
# Penalty of the squared scale per spread: it stays finite where scores never err.
_SCALE_PENALTY: Final = 1e-3


def open_matches(log_ratios: Floats, *, n_links: float) -> Floats:
    """Return the probability of each pair, (P, G), where some people have no mate.

    A matching is as likely as the product of its pairs' ratios; it has `n_links` pairs
    on average. Rows and columns of exp(log_ratios), with a further row and column for
    people without a mate, are scaled in turn. In the end each probe's and each
    candidate's sum is 1, and that of all pairs is `n_links`. Exact probabilities take
    permanents; these put the candidates in much the same order. A ratio may lack a
    factor that is common to all pairs. ValueError for no pair, or a score that is not
    finite.

    `log_ratios`, (P, G), are log-likelihood ratios in nats.
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
    weight[:-1, :-1] = np.exp(np.clip(centred, -_MOST_NATS, _MOST_NATS))
    weight[-1, -1] = 0.0
    row_sums, column_sums = np.ones(n_probes + 1), np.ones(n_gallery + 1)
    row_sums[-1], column_sums[-1] = n_gallery - links, n_probes - links
    columns = np.ones(n_gallery + 1)
    for _ in range(_MOST_SWEEPS):
        rows = row_sums / (weight @ columns)
        scaled = column_sums / (rows @ weight)
        is_done = np.abs(scaled / columns - 1.0).max() < _TOLERANCE
        columns = scaled
        if is_done:
            break
    return np.asarray(rows[:-1, None] * weight[:-1, :-1] * columns[:-1])


def most_probable(order: Ints, probability: Floats) -> tuple[Ints, Bools]:
    """Return each probe's likeliest candidate, and whether no mate at all is likelier.

    (P,) each. Of equal candidates it is the first in this order of the columns, (G,).
    """
    best = order[probability[:, order].argmax(axis=1)]
    alone = 1.0 - probability.sum(axis=1)
    return best, alone > probability.max(axis=1)


def fit_scale(scores: Sequence[Floats], mates: Sequence[Ints]) -> float:
    """Return the factor that turns scores into log-likelihood ratios within a row.

    It makes the mates of other people most probable among their candidates (conditional
    logit). `scores`, (P, G), and `mates`, (P,), the column of each probe's mate or -1,
    are given for several galleries. 1 where no probe has a mate, or scores are
    constant.
    """
    from scipy.optimize import minimize_scalar  # noqa: PLC0415 - heavy to import

    rows = [
        (score[mate >= 0], mate[mate >= 0])
        for score, mate in zip(scores, mates, strict=True)
        if (mate >= 0).any()
    ]
    if not rows:
        return 1.0
    spread = float(np.concatenate([score.ravel() for score, _ in rows]).std())
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
