"""Slow solutions that share nothing with the kernels: dense matrices, no recursion.

A track is (t, xy, variance) of one person; states are per axis, or (x, vx, y, vy) for
the IMM.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import factorial

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.stats import multivariate_normal

POSITIONS = np.kron(np.eye(2), [[1.0, 0.0]])


@cache
def transition(step_s, d):
    """exp(A dt) of a chain of d integrators."""
    return expm(np.eye(d, k=1) * step_s)


@cache
def process_noise(step_s, q, d):
    """Van Loan: the integral of exp(A s) g q g' exp(A s)' over the step."""
    driven = np.zeros((d, d))
    driven[-1, -1] = q
    a = np.eye(d, k=1)
    block = expm(np.block([[-a, driven], [np.zeros((d, d)), a.T]]) * step_s)
    return block[d:, d:].T @ block[:d, d:]


def joint_posterior(*, t, xy, variance, q, mean, cov, used=None):
    """Condition states on samples: means (n, 2, d), covariances (n, d, d), density.

    The last is the log density of the samples used; `q` is of all steps or of each.
    """
    n, d = len(t), len(cov)
    used = np.ones(n, dtype=bool) if used is None else used
    lift = np.eye(
        n * d
    )  # what the states are of the first one and of what is added since
    noises = [cov]
    for k, (step, driven) in enumerate(np.broadcast(np.diff(t), q), start=1):
        now, before = slice(k * d, (k + 1) * d), slice((k - 1) * d, k * d)
        lift[now, : k * d] = transition(step, d) @ lift[before, : k * d]
        noises.append(process_noise(step, driven, d))
    prior_mean, prior = mean @ lift[:, :d].T, lift @ block_diag(*noises) @ lift.T
    h = np.eye(n * d)[::d][used]
    innovation_cov = h @ prior @ h.T + np.diag(variance[used])
    gain = np.linalg.solve(innovation_cov, h @ prior).T
    posterior = prior - gain @ innovation_cov @ gain.T
    innovation = xy[used].T - prior_mean @ h.T
    means = (prior_mean + innovation @ gain.T).reshape(2, n, d).swapaxes(0, 1)
    density = multivariate_normal(cov=innovation_cov).logpdf(innovation).sum()
    covs = np.array([posterior[k : k + d, k : k + d] for k in range(0, n * d, d)])
    return means, covs, density


def precise_filter(*, t, xy, variance, q, mean, cov, used=None, number=np.longdouble):
    """Joseph's form with more digits, where double precision would fail.

    Of every sample the motion, state and covariance before it, state and covariance
    after it; and the log density of the samples used.
    """
    wide = np.vectorize(number, otypes=[object])
    x, p, d = wide(mean), wide(cov), len(cov)
    rows, density = [], 0.0
    for k in range(len(t)):
        step = number(t[k]) - number(t[max(k - 1, 0)])
        terms = [step**i / factorial(i) for i in range(d)]
        f = np.array(
            [[terms[j - i] if j >= i else 0 * step for j in range(d)] for i in range(d)]
        )
        driven = terms[::-1]  # by what each derivative answers to the noise
        both = np.add.outer(np.arange(d)[::-1], np.arange(d)[::-1]) + 1
        ahead, ahead_p = (
            x @ f.T,
            f @ p @ f.T + number(q) * step * np.outer(driven, driven) / both,
        )
        x, p = ahead, ahead_p
        if used is None or used[k]:
            z, r = wide(xy[k]), number(variance[k])
            s, error = ahead_p[0, 0] + r, z - ahead[:, 0]
            gain = ahead_p[:, 0] / s
            keep = wide(np.eye(d)) - np.outer(gain, wide(np.eye(d)[0]))
            x, p = (
                ahead + np.outer(error, gain),
                keep @ p @ keep.T + np.outer(gain, gain) * r,
            )
            density -= float(error @ error / s) / 2 + np.log(2 * np.pi * float(s))
        rows.append((f, ahead, ahead_p, x, p))
    return rows, density


def precise_states(**track):
    """Mean and covariance after every sample, and the log density."""
    rows, density = precise_filter(**track)
    mean, cov = (np.array([row[n] for row in rows], dtype=float) for n in (3, 4))
    return mean, cov, density


def exact_smoother(**track):
    """Rauch, Tung and Striebel's for constant velocity, in fractions."""
    rows, _ = precise_filter(**track, number=Fraction)
    x, p = rows[-1][3:]
    result = [(x, p)]
    for (*_, now, now_p), (f, ahead, ahead_p, *_) in zip(
        rows[-2::-1], rows[:0:-1], strict=True
    ):
        (a, b), (_, c) = ahead_p
        gain = now_p @ f.T @ np.array([[c, -b], [-b, a]]) / (a * c - b * b)
        x, p = now + (x - ahead) @ gain.T, now_p + gain @ (p - ahead_p) @ gain.T
        result.append((x, p))
    return tuple(
        np.array(each, dtype=float) for each in zip(*result[::-1], strict=True)
    )


def collapse(weight, mean, cov):
    """Mean and covariance of a Gaussian mixture."""
    centre = weight @ mean
    apart = mean - centre
    return centre, np.einsum(
        "n,nij->ij", weight, cov + apart[:, :, None] * apart[:, None, :]
    )


def motion(step_s, q):
    """F and Q of (x, vx, y, vy)."""
    return (
        np.kron(np.eye(2), transition(step_s, 2)),
        np.kron(np.eye(2), process_noise(step_s, q, 2)),
    )


def imm_track(
    *, t, xy, variance, q, rates, mean, cov, probability, gate=np.inf, patience=3
):
    """Textbook IMM filter: mean (n, J, 4), cov (n, J, 4, 4), probability (n, J)."""
    modes = range(len(q))
    x = np.tile(np.ravel(mean), (len(q), 1))
    p = np.tile(np.kron(np.eye(2), cov), (len(q), 1, 1))
    mu = np.array(probability)
    rows = []
    misses = 0
    density = 0.0
    for k in range(len(t)):
        if k > 0:
            joint = mu[:, None] * expm(rates * (t[k] - t[k - 1]))  # (from, to)
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
            logs = np.array(
                [-(nis[j] + np.linalg.slogdet(2 * np.pi * s[j])[1]) / 2 for j in modes]
            )
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
