"""Probability that a piece of a log goes on as another piece.

The earlier piece's last state is predicted over the gap at constant velocity. The
evidence of a pair is the log density of the later piece's first state under this
prediction. It is Student's t with five degrees of freedom: people turn and stop more
than under white noise. A conditional logit over all later pieces, and over *she does
not come back*, turns evidence into probabilities. Its few weights are learnt from other
people.

References
----------
Gruteser, Hoh, "On the anonymity of periodic location samples", SPC 2005 (multi-target
tracking as an attack on pseudonyms). McFadden, "Conditional logit analysis of
qualitative choice behavior", 1974.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from attacks.following.pieces import Pieces, Q
from isac_track.types import Bools, Floats, Ints, stretches

LONGEST_GAP_S: Final = 30.0  # A last state predicts nothing after a longer gap.
MOST_CANDIDATES: Final = 50  # Of a piece: the likeliest successors, of thousands.
_TAIL: Final = 5.0  # Degrees of freedom.
# Keeps weights finite where training pieces are separable without error.
_RIDGE: Final = 1e-3
_APART_S: Final = 1e-6
_AT_A_TIME: Final = 500  # Pieces whose candidates are held in memory at once.
_LARGEST: Final = 500.0  # Exponent: a surer link than that is sure.


@dataclass(frozen=True, eq=False, slots=True)
class Links:
    """C candidate links of K pieces: a piece may go on as the other, later piece."""

    before: Ints  # (C,) number of the earlier piece, rising.
    after: Ints  # (C,) number of the later piece.
    # (C, F): log density, 1, log gap, and further evidence about the gap.
    features: Floats
    n_pieces: int

    def __getitem__(self, rows: Bools) -> "Links":
        """Return some of the candidates."""
        return Links(
            self.before[rows], self.after[rows], self.features[rows], self.n_pieces
        )

    def with_feature(self, values: Floats) -> "Links":
        """Return the same candidates with a further feature, (C,)."""
        return replace(self, features=np.column_stack([self.features, values]))


def candidate_links(pieces: Pieces, *, begins: Ints | None = None) -> Links:
    """Return the pairs of pieces with at most `LONGEST_GAP_S` between end and start.

    Each earlier piece keeps the `MOST_CANDIDATES` of largest density.

    `begins`, (K,), is the piece whose first state stands at the start of each piece:
    the piece itself by default, another piece in the shuffled control.
    """
    n_pieces = len(pieces)
    begins = np.arange(n_pieces) if begins is None else begins
    nothing = Links(
        np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), n_pieces
    )
    parts = [nothing]
    for first in range(0, n_pieces, _AT_A_TIME):
        earlier = np.arange(first, min(first + _AT_A_TIME, n_pieces))
        parts.append(_likeliest_links(pieces, earlier, begins))
    return Links(
        before=np.concatenate([part.before for part in parts]),
        after=np.concatenate([part.after for part in parts]),
        features=np.concatenate([part.features for part in parts]),
        n_pieces=n_pieces,
    )


def _likeliest_links(pieces: Pieces, earlier: Ints, begins: Ints) -> Links:
    """Return the likeliest links of some earlier pieces, numbered without a gap."""
    # Pieces are in the order of their starts.
    first = np.searchsorted(pieces.start.t, pieces.end.t[earlier] + _APART_S)
    last_s = pieces.end.t[earlier] + LONGEST_GAP_S
    last = np.searchsorted(pieces.start.t, last_s, side="right")
    after, offsets = stretches(first, np.maximum(last - first, 0))
    sizes = np.diff(offsets)
    before = np.repeat(earlier, sizes)
    density, gap_s = _log_density(pieces, before, after, begins)
    features = np.column_stack([density, np.ones(before.size), np.log1p(gap_s)])
    by_density = np.lexsort((-density, before))
    rank = np.arange(before.size) - np.repeat(offsets[:-1], sizes)
    likeliest = np.sort(by_density[rank < MOST_CANDIDATES])
    return Links(before[likeliest], after[likeliest], features[likeliest], len(pieces))


def _log_density(
    pieces: Pieces, before: Ints, after: Ints, begins: Ints
) -> tuple[Floats, Floats]:
    """Return the log density of each pair up to a constant, and its gap, s, (C,)."""
    gap_s = pieces.start.t[after] - pieces.end.t[before]
    end, start = pieces.end[before], pieces.start[begins[after]]
    moved = end.mean[..., 0] + gap_s[:, None] * end.mean[..., 1]
    difference = start.mean - np.stack([moved, end.mean[..., 1]], axis=-1)
    if end.planar is not None and start.planar is not None:
        square, determinant = _planar_surprise(
            difference, end.planar, start.planar, gap_s
        )
    else:
        square, determinant = _axis_surprise(difference, end.cov, start.cov, gap_s)
    dimensions = 4.0  # Position and velocity on two axes.
    density = -0.5 * (_TAIL + dimensions) * np.log1p(square / _TAIL) - np.log(
        determinant
    )
    return np.asarray(density), np.asarray(gap_s)


def _planar_surprise(
    difference: Floats, cov: Floats, other: Floats, gap_s: Floats
) -> tuple[Floats, Floats]:
    """Return what `_axis_surprise` does for coupled axes, (C, 2, 2, 2, 2)."""
    move = np.zeros((gap_s.size, 4, 4))
    move[:] = np.eye(4)
    move[:, 0, 1] = move[:, 2, 3] = gap_s
    noise = np.zeros((gap_s.size, 4, 4))
    for first in (0, 2):
        noise[:, first, first] = Q * gap_s**3 / 3.0
        noise[:, first, first + 1] = noise[:, first + 1, first] = Q * gap_s**2 / 2.0
        noise[:, first + 1, first + 1] = Q * gap_s
    total = move @ cov.reshape(-1, 4, 4) @ move.swapaxes(1, 2) + noise
    total += other.reshape(-1, 4, 4)
    apart = difference.reshape(-1, 4, 1)
    square = (apart * np.linalg.solve(total, apart)).sum(axis=(1, 2))
    return np.asarray(square), np.asarray(np.sqrt(np.linalg.det(total)))


def _axis_surprise(
    difference: Floats, cov: Floats, other: Floats, gap_s: Floats
) -> tuple[Floats, Floats]:
    """Return the normalised square of differences and a determinant, (C,).

    The determinant is that of either axis, the root of that of both. States after a gap
    are `difference`, (C, 2, 2), from the predicted; `cov` and `other` are the
    covariances before and after the gap.
    """
    # F P F' + Q + P' of constant velocity, of either axis.
    velocity = cov[:, 1, 1] + Q * gap_s + other[:, 1, 1]
    cross = cov[:, 0, 1] + gap_s * cov[:, 1, 1] + Q * gap_s**2 / 2.0 + other[:, 0, 1]
    position = (
        cov[:, 0, 0]
        + 2.0 * gap_s * cov[:, 0, 1]
        + gap_s**2 * cov[:, 1, 1]
        + Q * gap_s**3 / 3.0
        + other[:, 0, 0]
    )
    determinant = position * velocity - cross**2
    square = (
        velocity[:, None] * difference[..., 0] ** 2
        - 2.0 * cross[:, None] * difference[..., 0] * difference[..., 1]
        + position[:, None] * difference[..., 1] ** 2
    ).sum(axis=1) / determinant
    return np.asarray(square), np.asarray(determinant)


def true_links(pieces: Pieces, links: Links) -> Bools:
    """Return which candidates are a person's next piece, (C,)."""
    following = next_pieces(pieces)
    return np.asarray(following[links.before] == links.after)


def next_pieces(pieces: Pieces) -> Ints:
    """Return the next piece of the same person, (K,); -1 for her last."""
    # Within a person in the order of starts.
    order = np.argsort(pieces.person, kind="stable")
    following = np.full(len(pieces), -1)
    same = np.diff(pieces.person[order]) == 0
    following[order[:-1][same]] = order[1:][same]
    return following


def learn_weights(links: Links, is_next: Bools, *, learn_from: Bools) -> Floats:
    """Return the weights of the features, (F,), learnt from some earlier pieces, (K,).

    They maximise the likelihood of the next piece, or of having none. Without a true
    link among `learn_from` every link gets probability 0.
    """
    from scipy.optimize import minimize  # noqa: PLC0415 - heavy to import

    n_features = links.features.shape[1]
    rows = learn_from[links.before]
    if not is_next[rows].any():
        return np.array([0.0, -np.inf, *np.zeros(n_features - 2)])
    features, before = links.features[rows], links.before[rows]
    # On one scale, so that the search is well conditioned; the constant stays.
    middle, scale = features.mean(axis=0), features.std(axis=0)
    middle[1], scale[1] = 0.0, 1.0
    scale[scale == 0.0] = 1.0
    scaled = (features - middle) / scale
    hits, n_trials = scaled[is_next[rows]].sum(axis=0), int(learn_from.sum())

    def loss(weights: Floats) -> tuple[float, Floats]:
        value = scaled @ weights
        total, share = _softmax(value, before, links.n_pieces)
        gradient = share @ scaled - hits + 2.0 * _RIDGE * n_trials * weights
        penalty = _RIDGE * n_trials * float(weights @ weights)
        return float(np.log(total).sum() - hits @ weights + penalty), gradient

    optimum = minimize(loss, np.zeros(n_features), jac=True, method="L-BFGS-B").x
    weights = optimum / scale
    weights[1] = optimum[1] - float(weights @ middle)
    return np.asarray(weights)


def _softmax(value: Floats, before: Ints, n_pieces: int) -> tuple[Floats, Floats]:
    """Return the sums of exp(value), (K,), and each candidate's share of its sum, (C,).

    A sum includes 1 for *none*.
    """
    weight = np.exp(np.minimum(value, _LARGEST))
    total = 1.0 + np.bincount(before, weights=weight, minlength=n_pieces)
    return np.asarray(total), np.asarray(weight / total[before])


def probabilities(links: Links, weights: Floats) -> Floats:
    """Return the probability that each candidate is the next piece of its person, (C,).

    The rest to 1, for an earlier piece, is the probability that she does not come back.
    """
    _, share = _softmax(links.features @ weights, links.before, links.n_pieces)
    return share


def entropy_bits(links: Links, probability: Floats) -> Floats:
    """Return the entropy over a piece's candidates and *none*, (K,) bits."""
    stop_probability = 1.0 - np.bincount(
        links.before, weights=probability, minlength=links.n_pieces
    )
    bits = np.bincount(
        links.before, weights=_surprise(probability), minlength=links.n_pieces
    )
    return np.asarray(bits + _surprise(np.clip(stop_probability, 0.0, 1.0)))


def _surprise(probability: Floats) -> Floats:
    """Return -p log2 p, and 0 at 0."""
    positive = np.where(probability > 0.0, probability, 1.0)
    return np.asarray(-probability * np.log2(positive))
