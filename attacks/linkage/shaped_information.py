"""What a release says of its walks' coefficients behind errors with a shape.

Both axes hang together: K coefficients on either axis are 2 K numbers, those of a
degree side by side, with a full information matrix.
"""

from typing import NamedTuple

import numpy as np

from isac_track.types import Floats, Release


class ShapedSide(NamedTuple):
    """N walks at L lags, as `_shaped_ratio_loop.shaped_ratios` takes them."""

    information: Floats  # (L, N, 2 K, 2 K) 1/m^2
    pull: Floats  # (L, N, 2 K) 1/m: information times coefficients.
    # (L, N): ln |A + S^-1| / 2 - h' (A + S^-1)^-1 h / 2, A and h the above, S the prior.
    log_evidence: Floats


def shaped_side(
    release: Release,
    *,
    precision: Floats,
    segments_s: Floats,
    added_m2: Floats,
    prior: Floats,
) -> ShapedSide:
    """Return the information of the walks of a release on their coefficients.

    `precision`, (M, 2, 2) 1/m^2, is that of each sample, and `segments_s`, (L, 2), the
    stretch of a lag from a walk's first sample on. The covariance of the coefficients
    grows by `added_m2`, (L, K, K), per axis. `prior`, (L, K), is the information of
    their prior. A shift of a walk changes nothing.
    """
    n_lags, rank = prior.shape
    information = np.zeros((n_lags, len(release), 2 * rank, 2 * rank))
    pull = np.zeros((n_lags, len(release), 2 * rank))
    bounds = zip(
        release.offsets[:-1].tolist(), release.offsets[1:].tolist(), strict=True
    )
    for row, (first, end) in enumerate(bounds):
        t = release.t[first:end] - release.t[first]
        xy = release.xy[first:end] - release.xy[first]
        for lag, (start_s, end_s) in enumerate(segments_s):
            u = (2.0 * t - start_s - end_s) / (end_s - start_s)
            inside = np.abs(u) <= 1.0
            if inside.any():
                information[lag, row], pull[lag, row] = _without_shift(
                    np.polynomial.legendre.legvander(u[inside], rank),
                    xy[inside],
                    precision[first:end][inside],
                )
    errors = np.kron(added_m2, np.eye(2))[:, None]
    both = np.concatenate([information, pull[..., None]], axis=-1)
    both = np.linalg.solve(np.eye(2 * rank) + information @ errors, both)
    information, pull = np.ascontiguousarray(both[..., :-1]), both[..., -1].copy()
    own = information + np.repeat(prior, 2, axis=1)[:, None, :, None] * np.eye(2 * rank)
    fit = np.linalg.solve(own, pull[..., None])[..., 0]
    evidence = np.linalg.slogdet(own).logabsdet - np.sum(pull * fit, axis=-1)
    return ShapedSide(information, pull, np.ascontiguousarray(evidence / 2.0))


def _without_shift(
    basis: Floats, xy: Floats, precision: Floats
) -> tuple[Floats, Floats]:
    """Return information and pull of the coefficients of degree 1 and above.

    `basis`, (n, K + 1), are the polynomials at n samples. The mean is left open: its
    two numbers are eliminated.
    """
    size = 2 * basis.shape[1]
    weighted = basis[:, :, None, None] * precision[:, None]
    information = np.einsum("kaij,kb->aibj", weighted, basis).reshape(size, size)
    pull = np.einsum("kaij,kj->ai", weighted, xy).reshape(size)
    shift = np.linalg.solve(
        information[:2, :2], np.column_stack([information[:2, 2:], pull[:2]])
    )
    cross = information[2:, :2]
    return information[2:, 2:] - cross @ shift[:, :-1], pull[2:] - cross @ shift[:, -1]
