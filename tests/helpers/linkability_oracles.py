"""The linkage metrics in plain form: loops, enumeration, literal duplication."""

from __future__ import annotations

from itertools import combinations, pairwise, permutations, product

import numpy as np
from sklearn.isotonic import IsotonicRegression

METRICS = ("auc", "eer", "cllr_min", "d_sys", "d_sys_published", "cllr")
METRICS += (
    "tpr_at_fpr_1pct",
    "realised_fpr_1pct",
    "tpr_at_fpr_01pct",
    "realised_fpr_01pct",
)


def ranks(row, column):
    """The possible ranks of a column, all equally likely, when ties fall at random."""
    above = sum(score > row[column] for score in row)
    tied = sum(score == row[column] for score in row)
    return range(above + 1, above + tied + 1)


def over_mates(scores, mate, value):
    """Mean of value(rank) over a mate's ranks, NaN without a mate."""
    return np.array(
        [
            (
                np.mean([value(rank) for rank in ranks(row, column)])
                if column >= 0
                else np.nan
            )
            for row, column in zip(scores, mate, strict=True)
        ]
    )


def best_assignment(scores, no_match_score=None):
    """The best sum of all assignments, and the columns; -1 for a no-match column."""
    n_probes, n_gallery = scores.shape
    if no_match_score is not None:
        scores = np.hstack([scores, np.full((n_probes, n_probes), no_match_score)])
    elif n_probes > n_gallery:
        value, rows = best_assignment(scores.T)
        columns = np.full(n_probes, -1)
        columns[rows] = np.arange(n_gallery)
        return value, columns
    value, columns = max(
        (sum(scores[i, j] for i, j in enumerate(columns)), columns)
        for columns in permutations(range(scores.shape[1]), n_probes)
    )
    return value, np.array([j if j < n_gallery else -1 for j in columns])


def auc(mated, non_mated):
    return np.mean([(m > non_mated) + (m == non_mated) / 2 for m in mated])


def roc(mated, non_mated):
    """(FPR, TPR) of every threshold, none accepted to all accepted."""
    thresholds = np.append(np.unique(np.append(mated, non_mated)), np.inf)[::-1]
    return [(np.mean(non_mated >= t), np.mean(mated >= t)) for t in thresholds]


def eer(mated, non_mated):
    """The lowest crossing of FPR = 1 - TPR by a chord between two points of the ROC."""
    best = 0.5
    for (f0, t0), (f1, t1) in combinations(roc(mated, non_mated), 2):
        gap0, gap1 = f0 + t0 - 1, f1 + t1 - 1
        if gap0 <= 0 <= gap1 and gap1 > gap0:
            best = min(best, f0 + (f1 - f0) * -gap0 / (gap1 - gap0))
    return best


def cllr(llr_mated, llr_non_mated):
    with np.errstate(over="ignore"):
        cost = (
            np.log2(1 + np.exp(-llr_mated)).mean()
            + np.log2(1 + np.exp(llr_non_mated)).mean()
        )
    return cost / 2


def cllr_min(mated, non_mated):
    """Cllr of the posterior of isotonic regression, both classes weighing the same."""
    # Ranks, since scikit-learn takes scores that differ by rounding for ties.
    scores = np.unique(np.append(mated, non_mated), return_inverse=True)[1]
    label = np.repeat([1.0, 0.0], [len(mated), len(non_mated)])
    mass = np.repeat([1 / len(mated), 1 / len(non_mated)], [len(mated), len(non_mated)])
    posterior = (
        IsotonicRegression().fit(scores, label, sample_weight=mass).predict(scores)
    )
    posterior = np.clip(posterior, 0, 1)
    with np.errstate(divide="ignore"):
        llr = np.log(posterior) - np.log1p(-posterior)
    return cllr(llr[: len(mated)], llr[len(mated) :])


def tpr(mated, non_mated, alpha):
    allowed = [(t, f) for f, t in roc(mated, non_mated) if f <= alpha + 1e-12]
    best = max(t for t, _ in allowed)
    return best, min(f for t, f in allowed if t == best)


def histogram_edges(mated, non_mated):
    """The edges of the D_sys bins."""
    scores = np.append(mated, non_mated)
    return np.linspace(
        scores.min(), scores.max(), max(1, min(len(mated) // 10, 100)) + 1
    )


def d_sys(mated, non_mated, edges):
    """As the authors write it, with the sum over bins for their integral."""
    total = 0.0
    for k, (low, high) in enumerate(pairwise(edges)):
        is_last = k == len(edges) - 2
        p, q = (
            np.mean((x >= low) & ((x <= high) if is_last else (x < high)))
            for x in (mated, non_mated)
        )
        if p > 0 and q == 0:
            total += p
        elif q > 0 and p / q > 1:
            ratio = p / q
            total += p * (2 * ratio / (1 + ratio) - 1)
    return total


def d_sys_published(mated, non_mated, edges):
    """As in the authors' program: densities, their ratio, trapezia between centres."""
    centres = (edges[1:] + edges[:-1]) / 2
    with np.errstate(divide="ignore", invalid="ignore"):  # of scores that are all equal
        own, other = (
            np.histogram(x, bins=edges, density=True)[0] for x in (mated, non_mated)
        )
    ratio = np.divide(own, other, out=np.ones_like(own), where=other != 0)
    d = 2 * ratio / (1 + ratio) - 1
    d[ratio <= 1] = 0
    d[other == 0] = 1
    y = d * own
    return sum((y[1:] + y[:-1]) / 2 * np.diff(centres))


def possible_mates(search):
    """All mates that the null allows: permutations that keep clusters together."""
    probes = np.flatnonzero(search.mate >= 0)
    cluster = search.probe_cluster[probes]
    together = cluster[:, None] == cluster
    mates = []
    for order in map(list, permutations(range(probes.size))):
        if (together[order][:, order] == together).all():
            row = np.full(search.mate.size, -1)
            row[probes] = search.mate[probes[order]]
            mates.append(row)
    return np.array(mates)


def poisson_binomial_tail(chances, hits):
    total = 0.0
    for outcome in product([0, 1], repeat=len(chances)):
        if sum(outcome) >= hits:
            total += np.prod(
                [p if hit else 1 - p for hit, p in zip(outcome, chances, strict=True)]
            )
    return total


def pooled(searches, weight):
    """Mated and non-mated scores, each as often as the replicate draws it."""
    mated, non_mated = [], []
    for search in searches:
        for i, row in enumerate(search.scores):
            a = search.probe_cluster[i]
            for j, score in enumerate(row):
                b = search.gallery_cluster[j]
                if j == search.mate[i]:
                    mated += [score] * int(weight[a])
                else:
                    times = weight[a] if a == b else weight[a] * weight[b]
                    non_mated += [score] * int(times)
    return np.array(mated), np.array(non_mated)


def score_metrics(searches, weight, calibration):
    """Every score metric of one replicate: per scale from duplicates, averaged."""
    everyone = np.ones_like(weight)
    n_non_mated = np.mean([s.scores.size - (s.mate >= 0).sum() for s in searches])
    values, masses = [], []
    for scale in sorted({search.scale for search in searches}):
        group = [search for search in searches if search.scale == scale]
        edges = histogram_edges(*pooled(group, everyone))
        mated, non_mated = pooled(group, weight)
        if not len(mated) or not len(non_mated):
            continue
        slope, intercept = calibration[scale].slope, calibration[scale].intercept
        values.append(
            [
                auc(mated, non_mated),
                eer(mated, non_mated),
                cllr_min(mated, non_mated),
                d_sys(mated, non_mated, edges),
                d_sys_published(mated, non_mated, edges),
                cllr(slope * mated + intercept, slope * non_mated + intercept),
                *(
                    tpr(mated, non_mated, 0.01)
                    if n_non_mated >= 3_000
                    else [np.nan] * 2
                ),
                *(
                    tpr(mated, non_mated, 0.001)
                    if n_non_mated >= 30_000
                    else [np.nan] * 2
                ),
            ]
        )
        masses.append(len(mated))
    if not masses:
        return dict.fromkeys(METRICS, np.nan)
    return dict(zip(METRICS, np.average(values, axis=0, weights=masses), strict=True))
