"""Experts that state a density of a person's position at any instant.

Kalman smoothers at constant velocity are exact between close entries of a log. A chain
of walks (`walk_chain`) knows the map and how people turn, and takes evidence from
answers that did not come.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.special import chndtr, ndtr

from attacks.following.chain_smoother import smooth_chain
from attacks.following.walk_chain import Chain, ChainOptions
from isac_track.measurement import mass_within, scalar_covariance
from isac_track.patrols.estimators import (
    APART_S,
    RADIAL_ANNEAL,
    RADIAL_PASSES,
    UNINFORMATIVE_M2,
)
from isac_track.patrols.reports import Reports, smooth_reports
from isac_track.types import Bools, Floats, Ints, squared_lengths

_PRIOR_STD: Final = (100.0, 1.4)  # m and m/s
_SLACK_M: Final = 0.05  # Walks curve within a step.
_PARTS: Final = (
    4  # Of a cell, in each of which a conditional law stands for its middle.
)
_LEAST_FOR_VELOCITY: Final = 3  # Entries within a step.
_LEAST_LIKELIHOOD: Final = 1e-9  # No state is impossible.
# Times to the nearest entry at which the bins of experts' weights change.
_GAP_EDGES_S: Final = (0.06, 0.3, 0.7, 1.5, 3.0, 6.0)
N_GAPS: Final = 2 * (len(_GAP_EDGES_S) + 1) + 1
"""Bins of gaps: between entries, before or after all entries, and without an entry."""


@dataclass(frozen=True, slots=True)
class PosteriorOptions:
    """Parameters of the posterior adversary."""

    chain: ChainOptions = field(default_factory=ChainOptions)
    # m^2/s^3, acceleration in each Kalman smoother.
    q: tuple[float, ...] = (0.001, 0.03, 0.5)
    # Factors of the variance of the smoothers for errors of the radial law, whose
    # smoothed entries are not independent. They have the middle q.
    radial_factors: tuple[float, ...] = (1.0, 4.0, 16.0)

    @property
    def n_gaussians(self) -> int:
        """Number of Kalman smoothers."""
        return len(self.q) + len(self.radial_factors)


@dataclass(frozen=True, eq=False, slots=True)
class Entries:
    """L entries of a log about a person, rising in time."""

    t: Floats  # (L,) s
    xy: Floats  # (L, 2) m
    variance: Floats  # (L,) m^2 per axis.
    # (L, 2, 2) m^2, of declared errors with a shape; `variance` is their mean then.
    cov: Floats | None = None

    def __getitem__(self, rows: slice) -> "Entries":
        """Return some of the entries."""
        cov = None if self.cov is None else self.cov[rows]
        return Entries(self.t[rows], self.xy[rows], self.variance[rows], cov)

    @property
    def reports(self) -> Reports:
        """The entries without their times."""
        return Reports(self.xy, self.variance, self.cov)


@dataclass(frozen=True, eq=False, slots=True)
class Opinions:
    """What X experts say about K instants of a person, given the log of a fleet."""

    log_density: Floats  # (K, X) of the truth, 1/m^2.
    log_map: Floats  # (K,) the same of the map.
    mass: Floats  # (K, J, X) probability within epsilon of J candidate places.
    is_hit: Bools  # (K, J) whether the truth lies within epsilon of the candidate.
    gap: Ints  # (K,) bin of the time to the nearest entry.


@dataclass(frozen=True, eq=False, slots=True)
class Gaussians:
    """Gaussians of several smoothers at K instants; round without a shape."""

    mean: Floats  # (X, K, 2) m
    variance: Floats  # (X, K) m^2, the mean of both axes.
    cov: Floats | None = None  # (X, K, 2, 2) m^2


def smooth_gaussians(
    entries: Entries, t: Floats, *, options: PosteriorOptions
) -> Gaussians:
    """Return the posterior of each Kalman smoother at instants, (K,) s.

    At least an entry is needed. The radial smoothers first smooth the entries for the
    radial law of errors, then as the others.
    """
    plain = [_smooth_instants(entries, t, q=q) for q in options.q]
    middle = options.q[len(options.q) // 2]
    offsets = np.array([0, entries.t.size])
    batch = entries.reports.batch(entries.t, offsets, prior_std=_PRIOR_STD)
    closer = smooth_reports(batch, q=middle, passes=RADIAL_PASSES, anneal=RADIAL_ANNEAL)
    near = _smooth_instants(
        Entries(entries.t, closer.xy, closer.variance, closer.cov), t, q=middle
    )
    parts = [*plain, *(near.inflated(factor) for factor in options.radial_factors)]
    covs = [part.cov for part in parts if part.cov is not None]
    return Gaussians(
        np.stack([part.xy for part in parts]),
        np.stack([part.variance for part in parts]),
        np.stack(covs) if covs else None,
    )


def _smooth_instants(entries: Entries, t: Floats, *, q: float) -> Reports:
    """Return positions at instants, (K,) s, with their posterior variances.

    The instants are added as measurements that carry no information.
    """
    times = np.concatenate([entries.t, t + APART_S])
    order = np.argsort(times, kind="stable")
    xy = np.concatenate([entries.xy, np.repeat(entries.xy[:1], t.size, axis=0)])
    nothing = np.full(t.size, UNINFORMATIVE_M2)
    cov = entries.cov
    if cov is not None:
        cov = np.concatenate([cov, scalar_covariance(nothing)])[order]
    variance = np.concatenate([entries.variance, nothing])
    batch = Reports(xy[order], variance[order], cov).batch(
        times[order], np.array([0, times.size]), prior_std=_PRIOR_STD
    )
    rows = np.flatnonzero(order >= entries.t.size)  # Instants rise, too.
    return smooth_reports(batch, q=q)[rows]


def entry_likelihood(chain: Chain, entries: Entries, *, step_s: float) -> Floats:
    """Return the likelihood of entries near the time of a step, (S,), up to a factor.

    A person is uniform within a cell and walks with the mean velocity of the class. The
    entries are summarised by their mean and, if there are several, by their slope.
    """
    weight = 1.0 / entries.variance
    total = float(weight.sum())
    late_s = entries.t - step_s
    mean_late_s = float(weight @ late_s) / total
    mean_xy = weight @ entries.xy / total
    target = mean_xy - mean_late_s * chain.velocity_mps
    variance = 1.0 / total + (chain.spread_mps * mean_late_s) ** 2 + _SLACK_M**2
    spread = None
    if entries.cov is not None:
        spread = np.einsum("l,lab->ab", (weight / total) ** 2, entries.cov)
        spread = spread + scalar_covariance(variance - 1.0 / total)
    likelihood = _cell_shares(chain, target, variance, spread)
    spread_s2 = float(weight @ (late_s - mean_late_s) ** 2)
    if late_s.size >= _LEAST_FOR_VELOCITY and spread_s2 > 0.0:
        apart = weight * (late_s - mean_late_s)
        slope = apart @ entries.xy / spread_s2
        slope_variance = 1.0 / spread_s2 + chain.spread_mps**2
        scale, gap = slope_variance, chain.velocity_mps - slope
        square = squared_lengths(gap) / slope_variance
        if entries.cov is not None:
            tilt = np.einsum("l,lab->ab", (apart / spread_s2) ** 2, entries.cov)
            cov = tilt + scalar_covariance(chain.spread_mps**2)
            square = (gap * np.linalg.solve(cov, gap[:, :, None])[:, :, 0]).sum(axis=1)
            scale = np.sqrt(np.linalg.det(cov))
        fit = np.exp(-0.5 * (square - square.min())) / scale
        likelihood = likelihood * (fit / fit.max())[:, None, None]
    flat = likelihood.ravel()
    return np.asarray(np.maximum(flat / max(flat.max(), 1e-300), _LEAST_LIKELIHOOD))


def _cell_shares(
    chain: Chain, target: Floats, variance: Floats, cov: Floats | None
) -> Floats:
    """Return the probability of each cell by class, (C, X, Y), of Gaussians.

    They lie about `target`, (C, 2) m, with a `variance`, (C,) m^2, or with covariances,
    (C, 2, 2) m^2. Of these the second coordinate is conditional on the first, which
    stands for the middle of a quarter of a cell.
    """
    if cov is None:
        std = np.sqrt(variance)[:, None]
        sides = []
        for axis in range(2):
            below = ndtr((_edges(chain, axis) - target[:, axis, None]) / std)
            sides.append(np.diff(below, axis=1))
        return np.asarray(sides[0][:, :, None] * sides[1][:, None, :])
    fine = _edges(chain, 0, parts=_PARTS)
    middle = (fine[1:] + fine[:-1]) / 2.0 - target[:, :1]
    std = np.sqrt(cov[:, 0, 0])[:, None]
    share = np.diff(ndtr((fine - target[:, :1]) / std), axis=1)
    slope = (cov[:, 0, 1] / cov[:, 0, 0])[:, None]
    rest = np.sqrt(cov[:, 1, 1, None] - slope * cov[:, 0, 1, None])
    away = _edges(chain, 1) - (target[:, 1:] + slope * middle)[:, :, None]
    along = np.diff(ndtr(away / rest[:, :, None]), axis=2)
    parts = (share[:, :, None] * along).reshape(len(target), chain.shape[0], _PARTS, -1)
    return np.asarray(parts.sum(axis=2))


def _edges(chain: Chain, axis: int, *, parts: int = 1) -> Floats:
    """Return the edges of cells, or of equal parts of them, along an axis, m."""
    number = np.arange(chain.shape[axis] * parts + 1.0)
    return np.asarray(chain.low_m[axis] + chain.cell_m / parts * number)


def gap_bins(t: Floats, entry_s: Floats) -> Ints:
    """Return the bin of the time from each instant to the nearest entry, (K,)."""
    if not entry_s.size:
        return np.full(t.size, N_GAPS - 1)
    after = np.searchsorted(entry_s, t)
    is_between = (after > 0) & (after < entry_s.size)
    before_s = np.abs(t - entry_s[np.maximum(after - 1, 0)])
    after_s = np.abs(t - entry_s[np.minimum(after, entry_s.size - 1)])
    bins = np.searchsorted(_GAP_EDGES_S, np.minimum(before_s, after_s), side="right")
    return np.where(is_between, bins, bins + len(_GAP_EDGES_S) + 1)


@dataclass(frozen=True, eq=False, slots=True)
class Clock:
    """Steps of the chain that enclose K instants of a person."""

    first: int  # Number of the first step on the clock of all people.
    step_s: Floats  # (T,) s, times of the steps.
    before: Ints  # (K,) step before each instant, from 0.
    share: Floats  # (K,) of the way from there to the next step.


def make_clock(t: Floats, *, start_s: float, step_s: float) -> Clock:
    """Return the steps around rising instants, (K,) s; a step is at `start_s`."""
    place = (t - start_s) / step_s
    first = int(np.floor(place[0] + 1e-9))
    last = max(int(np.ceil(place[-1] - 1e-9)), first + 1)
    before = np.clip(np.floor(place).astype(np.int64), first, last - 1)
    return Clock(
        first=first,
        step_s=start_s + step_s * np.arange(first, last + 1.0),
        before=before - first,
        share=np.clip(place - before, 0.0, 1.0),
    )


def chain_densities(
    chain: Chain,
    entries: Entries,
    clock: Clock,
    *,
    further: Callable[[int], Floats | float],
) -> Floats:
    """Return the density over the cells at each step, (T, n_cells) 1/m^2.

    `further(step)` is the likelihood of other evidence at a step, (S,).
    """
    half_s = chain.step_s / 2.0
    bounds = np.append(clock.step_s - half_s, clock.step_s[-1] + half_s)
    rows = np.searchsorted(entries.t, bounds)
    likelihoods: list[Floats | float] = []
    for number, step_s in enumerate(clock.step_s.tolist()):
        part = slice(rows[number], rows[number + 1])
        own = entries[part]
        likelihoods.append(
            entry_likelihood(chain, own, step_s=step_s) if own.t.size else 1.0
        )

    def likelihood(step: int) -> Floats:
        return np.asarray(likelihoods[step] * further(step))

    smoothed = smooth_chain(chain, likelihood, n_steps=clock.step_s.size)
    return smoothed.cells / chain.cell_m**2


def state_opinions(
    chain: Chain,
    entries: Entries,
    *,
    clock: Clock,
    t: Floats,
    true_xy: Floats,
    further: Callable[[int], Floats | float] | None,
    epsilon_m: float,
    options: PosteriorOptions,
) -> Opinions:
    """Return what the experts say about a person at K instants, (K,) s and (K, 2) m.

    The last two experts are the chain without and with `further` evidence. Candidate
    places are the means of two smoothers, and the cells that the chains prefer.
    """
    grids = [chain_densities(chain, entries, clock, further=lambda _: 1.0)]
    grids.append(
        grids[0]
        if further is None
        else chain_densities(chain, entries, clock, further=further)
    )
    densities = [
        (1.0 - clock.share[:, None]) * grid[clock.before]
        + clock.share[:, None] * grid[clock.before + 1]
        for grid in grids
    ]
    places = [chain.centres()[density.argmax(axis=1)] for density in densities]
    gaussians = None
    if entries.t.size:
        gaussians = smooth_gaussians(entries, t, options=options)
        places += [gaussians.mean[len(options.q) // 2], gaussians.mean[-1]]
    else:
        places += places[:2]
    candidates = np.stack(places, axis=1)  # (K, J, 2)
    rows, true_cell = np.arange(t.size), chain.cells_at(true_xy)
    n_experts = options.n_gaussians + len(densities)
    log_density = np.full((t.size, n_experts), -np.inf)
    mass = np.zeros((*candidates.shape[:2], n_experts))
    cells = chain.cells_at(candidates)
    for number, density in enumerate(densities, start=options.n_gaussians):
        log_density[:, number] = np.log(np.maximum(density[rows, true_cell], 1e-300))
        around = density[rows[:, None], cells] * np.pi * epsilon_m**2
        mass[:, :, number] = np.minimum(around, 1.0)
    if gaussians is not None:
        _add_gaussians(log_density, mass, gaussians, candidates, true_xy, epsilon_m)
    return Opinions(
        log_density=log_density,
        log_map=np.log(chain.map[true_cell] / chain.cell_m**2),
        mass=mass,
        is_hit=squared_lengths(candidates - true_xy[:, None]) < epsilon_m**2,
        gap=gap_bins(t, entries.t),
    )


def _add_gaussians(
    log_density: Floats,
    mass: Floats,
    gaussians: Gaussians,
    candidates: Floats,
    true_xy: Floats,
    epsilon_m: float,
) -> None:
    """Write the log density of the truth, and the mass near candidates, in place."""
    for number, (mean, variance) in enumerate(
        zip(gaussians.mean, gaussians.variance, strict=True)
    ):
        if gaussians.cov is not None:
            cov, gap = gaussians.cov[number], true_xy - mean
            square = (gap * np.linalg.solve(cov, gap[:, :, None])[:, :, 0]).sum(axis=1)
            log_density[:, number] = -0.5 * (
                square + np.log(np.linalg.det(cov))
            ) - np.log(2.0 * np.pi)
            mass[:, :, number] = mass_within(
                candidates - mean[:, None], cov[:, None], radius_m=epsilon_m
            )
            continue
        square = squared_lengths(true_xy - mean)
        log_density[:, number] = -0.5 * square / variance - np.log(
            2.0 * np.pi * variance
        )
        away = squared_lengths(candidates - mean[:, None]) / variance[:, None]
        reach = epsilon_m**2 / variance[:, None]
        # Far away the mass is 0, and the series of chndtr is long.
        near = away < reach + 40.0 * np.sqrt(reach) + 100.0
        mass[:, :, number] = np.where(
            near, chndtr(reach, 2.0, np.where(near, away, 0.0)), 0.0
        )
