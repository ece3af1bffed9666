"""Slow solutions that share nothing with the kernels: dense matrices, no recursion, no closed form.

A track is (t, xy, variance) of one person; states are per axis, or (x, vx, y, vy) for the IMM.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise, product

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from scipy.linalg import block_diag, expm
from scipy.stats import multivariate_normal

POSITIONS = np.kron(np.eye(2), [[1.0, 0.0]])


@cache
def transition(step_s, d):
    """exp(A dt) of a chain of d integrators."""
    return expm(np.eye(d, k=1) * step_s)


@cache
def process_noise(step_s, q, d):
    """Van Loan: the integral of exp(A s) g q g' exp(A s)' over the step, from one exponential."""
    driven = np.zeros((d, d))
    driven[-1, -1] = q
    a = np.eye(d, k=1)
    block = expm(np.block([[-a, driven], [np.zeros((d, d)), a.T]]) * step_s)
    return block[d:, d:].T @ block[:d, d:]


def joint_prior(*, t, q, mean, cov):
    """Mean (2, n d) and covariance (n d, n d) of all states of one axis at once."""
    d = len(cov)
    n = len(t)
    lift = np.eye(n * d)
    for k, (before, now) in enumerate(pairwise(t), start=1):
        f = transition(now - before, d)
        lift[k * d : (k + 1) * d, : k * d] = f @ lift[(k - 1) * d : k * d, : k * d]
    noise = block_diag(cov, *(process_noise(now - before, q, d) for before, now in pairwise(t)))
    start = np.zeros((2, n * d))
    start[:, :d] = mean
    return start @ lift.T, lift @ noise @ lift.T


def joint_posterior(*, t, xy, variance, q, mean, cov, used=None):
    """Condition all states on all (used) samples: means (n, 2, d), covariances (n, d, d), density.

    The last is the log density of the samples used.
    """
    d = len(cov)
    n = len(t)
    used = np.ones(n, dtype=bool) if used is None else used
    prior_mean, prior = joint_prior(t=t, q=q, mean=mean, cov=cov)
    h = np.eye(n * d)[::d][used]
    innovation_cov = h @ prior @ h.T + np.diag(variance[used])
    gain = np.linalg.solve(innovation_cov, h @ prior).T
    posterior = prior - gain @ innovation_cov @ gain.T
    means = np.empty((n, 2, d))
    density = 0.0
    for axis in range(2):
        expected = h @ prior_mean[axis]
        means[:, axis] = (prior_mean[axis] + gain @ (xy[used, axis] - expected)).reshape(n, d)
        density += multivariate_normal(expected, innovation_cov).logpdf(xy[used, axis])
    covs = np.array([posterior[k : k + d, k : k + d] for k in range(0, n * d, d)])
    return means, covs, density


def filterpy_track(*, t, xy, variance, q, mean, cov, gate=np.inf, patience=3):
    """filterpy's loop over one track: means (n, 2 d), covariances (n, 2 d, 2 d) and the rest."""
    d = len(cov)
    kf = KalmanFilter(dim_x=2 * d, dim_z=2)
    kf.H = np.kron(np.eye(2), np.eye(1, d))
    kf.x = np.ravel(mean).copy()
    kf.P = np.kron(np.eye(2), cov)
    means, covs, fs, qs, taken = [], [], [], [], []
    misses = 0
    density = 0.0
    for k in range(len(t)):
        step = t[k] - t[k - 1] if k > 0 else 0.0
        fs.append(np.kron(np.eye(2), transition(step, d)))
        noise = Q_continuous_white_noise(d, dt=step, spectral_density=q)
        qs.append(np.kron(np.eye(2), noise))
        kf.predict(F=fs[-1], Q=qs[-1])
        kf.R = np.eye(2) * variance[k]
        innovation = xy[k] - kf.H @ kf.x
        innovation_cov = kf.H @ kf.P @ kf.H.T + kf.R
        nis = innovation @ np.linalg.solve(innovation_cov, innovation)
        taken.append(nis <= gate or misses >= patience)
        if taken[-1]:
            misses = 0
            kf.update(xy[k])
            density += multivariate_normal(np.zeros(2), innovation_cov).logpdf(innovation)
        else:
            misses += 1
        means.append(kf.x.copy())
        covs.append(kf.P.copy())
    return {
        "kf": kf,
        "mean": np.array(means),
        "cov": np.array(covs),
        "fs": fs,
        "qs": qs,
        "accepted": np.array(taken),
        "log_likelihood": density,
    }


def filterpy_smooth(**track):
    """filterpy's smoother of constant velocity: means (n, 2, 2) and covariances (n, 4, 4)."""
    theirs = filterpy_track(**track)
    mean, cov, _, _ = theirs["kf"].rts_smoother(*(theirs[n] for n in ("mean", "cov", "fs", "qs")))
    return mean.reshape(-1, 2, 2), cov


def chances(step_s, rates):
    """Transition matrix of the modes over one step."""
    generator = np.array(rates, dtype=float)
    np.fill_diagonal(generator, 0.0)
    np.fill_diagonal(generator, -generator.sum(axis=1))
    return expm(generator * step_s)


def collapse(weight, mean, cov):
    """Mean and covariance of a Gaussian mixture."""
    centre = weight @ mean
    apart = mean - centre
    return centre, np.einsum("n,nij->ij", weight, cov + apart[:, :, None] * apart[:, None, :])


def motion(step_s, q):
    """F and Q of (x, vx, y, vy)."""
    return (
        np.kron(np.eye(2), transition(step_s, 2)),
        np.kron(np.eye(2), process_noise(step_s, q, 2)),
    )


def imm_track(*, t, xy, variance, q, rates, mean, cov, probability, gate=np.inf, patience=3):
    """Textbook IMM filter of one track: mean (n, J, 4), cov (n, J, 4, 4), probability (n, J)."""
    modes = range(len(q))
    x = np.tile(np.ravel(mean), (len(q), 1))
    p = np.tile(np.kron(np.eye(2), cov), (len(q), 1, 1))
    mu = np.array(probability)
    rows = []
    misses = 0
    density = 0.0
    for k in range(len(t)):
        if k > 0:
            joint = mu[:, None] * chances(t[k] - t[k - 1], rates)  # (from, to)
            mu = joint.sum(axis=0)
            mixed = [collapse(joint[:, j] / mu[j], x, p) for j in modes]
            x, p = x.copy(), p.copy()
            for j in modes:
                f, noise = motion(t[k] - t[k - 1], q[j])
                x[j], p[j] = f @ mixed[j][0], f @ mixed[j][1] @ f.T + noise
        innovation = xy[k] - x @ POSITIONS.T
        s = POSITIONS @ p @ POSITIONS.T + variance[k] * np.eye(2)
        nis = [innovation[j] @ np.linalg.solve(s[j], innovation[j]) for j in modes]
        taken = min(nis) <= gate or misses >= patience
        misses = 0 if taken else misses + 1
        if taken:
            logs = np.array([-(nis[j] + np.linalg.slogdet(2 * np.pi * s[j])[1]) / 2 for j in modes])
            top = logs.max()
            weight = mu * np.exp(logs - top)
            density += top + np.log(weight.sum())
            mu = weight / weight.sum()
            for j in modes:
                gain = p[j] @ POSITIONS.T @ np.linalg.inv(s[j])
                x[j] = x[j] + gain @ innovation[j]
                p[j] = p[j] - gain @ s[j] @ gain.T
        rows.append((x.copy(), p.copy(), mu.copy(), taken))
    x, p, mu, taken = (np.array(column) for column in zip(*rows, strict=True))
    return {
        "mean": x,
        "cov": p,
        "probability": mu,
        "accepted": taken,
        "log_likelihood": density,
    }


def imm_smooth(*, t, q, rates, mean, cov, probability):
    """Expectation correction (Barber 2006), one Gaussian per mode, from `imm_track`'s results."""
    modes = range(len(q))
    x, p, mu = mean.copy(), cov.copy(), probability.copy()
    for k in reversed(range(len(t) - 1)):
        step = t[k + 1] - t[k]
        jump = chances(step, rates)
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
            pair_x, pair_p = (np.array([states[j, i][n] for i in modes]) for n in range(2))
            x[k, j], p[k, j] = collapse(joint[j] / mu[k, j], pair_x, pair_p)
    return {"mean": x, "cov": p, "probability": mu}


def imm_exact(*, t, xy, variance, q, rates, mean, cov, probability):
    """Every sequence of modes, smoothed alone and weighted: mean positions, (n, 2)."""
    n = len(t)
    log_weights, means = [], []
    jumps = [chances(now - before, rates) for before, now in pairwise(t)]
    lift = np.eye(2 * n)
    for k, (before, now) in enumerate(pairwise(t), start=1):
        f = transition(now - before, 2)
        lift[2 * k : 2 * k + 2, : 2 * k] = f @ lift[2 * k - 2 : 2 * k, : 2 * k]
    centre = lift[:, :2] @ mean.T
    for sequence in product(range(len(q)), repeat=n):
        # Given the modes the axes are independent.
        steps = zip(np.diff(t), sequence[1:], strict=True)
        noises = [cov, *(process_noise(step, q[mode], 2) for step, mode in steps)]
        prior = lift @ block_diag(*noises) @ lift.T
        s = prior[::2, ::2] + np.diag(variance)
        innovation = xy - centre[::2]
        solved = np.linalg.solve(s, innovation)
        log_weight = np.log(probability[sequence[0]])
        log_weight += sum(
            np.log(jump[i, j]) for jump, (i, j) in zip(jumps, pairwise(sequence), strict=True)
        )
        log_weight -= np.linalg.slogdet(2 * np.pi * s)[1] + (innovation * solved).sum() / 2
        log_weights.append(log_weight)
        means.append((centre + prior[:, ::2] @ solved)[::2])
    weight = np.exp(np.array(log_weights) - max(log_weights))
    return np.average(means, axis=0, weights=weight)
