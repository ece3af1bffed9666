"""Slow solutions that share nothing with the loop: dense matrices, every path of modes.

A track is (t, xy, variance) of one person; states are (x, vx, y, vy).
"""

from itertools import pairwise, product

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.stats import multivariate_normal


def transition(step_s):
    """F of position and velocity."""
    return np.array([[1.0, step_s], [0.0, 1.0]])


def process_noise(step_s, q):
    """Q of position and velocity, driven by white acceleration."""
    cross = step_s**2 / 2
    return q * np.array([[step_s**3 / 3, cross], [cross, step_s]])


def motion(step_s, q):
    """F and Q of (x, vx, y, vy)."""
    blocks = transition(step_s), process_noise(step_s, q)
    return tuple(np.kron(np.eye(2), block) for block in blocks)


def joint_posterior(*, t, xy, variance, q, mean, cov):
    """Condition states on samples: means (n, 2, d), covariances (n, d, d), density.

    The last is the log density of the samples; `q` is of all steps or of each.
    """
    n, d = len(t), len(cov)
    lift = np.eye(
        n * d
    )  # what the states are of the first one and of what is added since
    noises = [cov]
    for k, (step, driven) in enumerate(np.broadcast(np.diff(t), q), start=1):
        now, before = slice(k * d, (k + 1) * d), slice((k - 1) * d, k * d)
        lift[now, : k * d] = transition(step) @ lift[before, : k * d]
        noises.append(process_noise(step, driven))
    prior_mean, prior = mean @ lift[:, :d].T, lift @ block_diag(*noises) @ lift.T
    h = np.eye(n * d)[::d]
    innovation_cov = h @ prior @ h.T + np.diag(variance)
    gain = np.linalg.solve(innovation_cov, h @ prior).T
    posterior = prior - gain @ innovation_cov @ gain.T
    innovation = xy.T - prior_mean @ h.T
    means = (prior_mean + innovation @ gain.T).reshape(2, n, d).swapaxes(0, 1)
    density = multivariate_normal(cov=innovation_cov).logpdf(innovation).sum()
    covs = np.array([posterior[k : k + d, k : k + d] for k in range(0, n * d, d)])
    return means, covs, density


def collapse(weight, mean, cov):
    """Mean and covariance of a Gaussian mixture."""
    centre = weight @ mean
    apart = mean - centre
    return centre, np.einsum(
        "n,nij->ij", weight, cov + apart[:, :, None] * apart[:, None, :]
    )


def imm_smooth(*, t, q, rates, mean, cov, probability):
    """Expectation correction (Barber 2006), one Gaussian per mode, of a filter's states."""
    modes = range(len(q))
    x, p, mu = mean.copy(), cov.copy(), probability.copy()
    for k in reversed(range(len(t) - 1)):
        step = t[k + 1] - t[k]
        jump = expm(rates * step)
        log_weight = np.empty((len(q), len(q)))
        states = {}
        for j, i in product(modes, modes):  # now, next
            f, noise = motion(step, q[i])
            ahead = f @ cov[k, j] @ f.T + noise
            gain = np.linalg.solve(ahead, f @ cov[k, j]).T
            gap = x[k + 1, i] - f @ mean[k, j]
            states[j, i] = (
                mean[k, j] + gain @ gap,
                cov[k, j] + gain @ (p[k + 1, i] - ahead) @ gain.T,
            )
            log_weight[j, i] = np.log(probability[k, j] * jump[j, i])
            log_weight[j, i] += multivariate_normal(np.zeros(4), ahead).logpdf(gap)
        weight = np.exp(log_weight - log_weight.max(axis=0))
        joint = weight / weight.sum(axis=0) * mu[k + 1]
        mu[k] = joint.sum(axis=1)
        for j in modes:
            pair_x, pair_p = (
                np.array([states[j, i][n] for i in modes]) for n in range(2)
            )
            x[k, j], p[k, j] = collapse(joint[j] / mu[k, j], pair_x, pair_p)
    return {"mean": x, "cov": p, "probability": mu}


def imm_exact(*, t, q, rates, probability, **track):
    """Every sequence of modes, smoothed alone and weighted: mean positions, (n, 2)."""
    log_weights, means = [], []
    jumps = [expm(rates * step) for step in np.diff(t)]
    for sequence in product(range(len(q)), repeat=len(t)):
        # Given the modes the axes are independent.
        mean, _, density = joint_posterior(
            t=t, q=[q[mode] for mode in sequence[1:]], **track
        )
        chances = [
            jump[pair] for jump, pair in zip(jumps, pairwise(sequence), strict=True)
        ]
        log_weights.append(density + np.log([probability[sequence[0]], *chances]).sum())
        means.append(mean[:, :, 0])
    weight = np.exp(np.array(log_weights) - max(log_weights))
    return np.average(means, axis=0, weights=weight)
