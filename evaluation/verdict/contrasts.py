"""The numbers of a panel: each level's linkage beside fixed noise at equal descriptor.

`panel` says which levels are compared, `curves` reads them, `spread` decides on the
result of `build_contrasts`. Standard errors are over clusters: people, or groups who
walk together.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.estimates.interpolation import MIN_DEFINED, CurvePositions
from evaluation.estimates.linked_people import TaskSums
from evaluation.estimates.recordings import task_recording
from evaluation.verdict import curves, rules
from evaluation.verdict.curves import NEITHER, FixedNoise
from evaluation.verdict.panel import Panel
from isac_track.intervals import (
    FEWEST_EFFECTIVE,
    LEAST_CLUSTERS,
    cluster_weights,
    effective_clusters,
)
from isac_track.types import Bools, Floats, Ints

N_REPLICATES: Final = 1000


@dataclass(frozen=True, eq=False, slots=True)
class Discordant:
    """People linked under only one of two mechanisms, of K contrasts, (K,) each."""

    more: Floats  # Share of people linked more often than under fixed noise.
    fewer: Floats  # Share of people linked less often.
    n_people: Floats  # Number of people of either kind.


@dataclass(frozen=True, eq=False, slots=True)
class FixedRange:
    """Fixed noise from raw to its strongest error: the whole range of linkage."""

    fall: Floats  # (1 + B,) of linkage, a share of people
    span: Floats  # (1 + B,) logarithm of the descriptor, raw over strongest error
    fall_error: float  # Standard error of the fall.
    span_error: float
    degrees: float  # Effective clusters less one, the least over its levels.


@dataclass(frozen=True, eq=False, slots=True)
class Contrasts:
    """Linkage gaps to fixed noise at equal descriptor, by mechanism; shares of people.

    There are K contrasts and B bootstrap replicates.
    """

    gaps: Floats  # (1 + B, K) D_k and its bootstrap replicates
    errors: Floats  # (K,) standard error of D_k; NaN where nothing is known
    side: Ints  # (K,) the direction that can be shown: `BOTH` and so on in `curves`
    # (K,) effective clusters less one, the least over the levels behind a contrast
    degrees: Floats
    people: Ints  # (K,) clusters, the least over the levels behind a contrast
    discordant: Discordant
    decides: Bools  # (K,) false for a difference by construction
    fixed: FixedRange
    is_whole: bool  # The panel is complete, a dissociation control among its contrasts.

    @property
    def is_exact(self) -> Bools:
        """(K,) whether so few people differ that the interval is that of counts."""
        return np.asarray(self.discordant.n_people < rules.FEWEST_DISCORDANT)

    @property
    def largest_deviation(self) -> Floats:
        """(B,) largest deviation of a replicate, in standard errors; 0 if empty."""
        used = (self.side != NEITHER) & ~self.is_exact
        deviation = np.abs(self.gaps[1:, used] - self.gaps[0, used])
        return np.asarray((deviation / self.errors[used]).max(axis=1, initial=0.0))


@dataclass(frozen=True, eq=False, slots=True)
class Rates:
    """Rates of L levels under R draws of people."""

    success: Floats  # (R, L) share of people linked
    descriptor: Floats  # (R, L)


@dataclass(frozen=True, eq=False, slots=True)
class ClusterCounts:
    """Clusters behind each of L levels, (L,) each."""

    effective: Floats
    people: Ints


@dataclass(frozen=True, eq=False, slots=True)
class Sums:
    """Success and a descriptor at a task's levels, summed by cluster, (L, C) each."""

    success: Floats
    probes: Floats  # Number of tracks that were to be linked.
    values: Floats  # Of the descriptor.
    windows: Floats  # Number of windows that have a value.

    def rates(self, weights: Floats) -> Rates:
        """Return success and descriptor under the weights of each draw, (R, C)."""
        return Rates(
            success=curves.rates_by_draw(self.success, self.probes, weights),
            descriptor=curves.rates_by_draw(self.values, self.windows, weights),
        )

    @property
    def cluster_counts(self) -> ClusterCounts:
        """Clusters of each level: the fewer of those with probes and with windows."""
        counts = np.stack([self.probes, self.windows])
        effective = np.apply_along_axis(effective_clusters, 2, counts)
        people = (counts > 0).sum(axis=2)
        return ClusterCounts(effective.min(axis=0), people.min(axis=0))


@dataclass(frozen=True, eq=False, slots=True)
class _Compared:
    """Descriptor and success of K contrasts, to be compared with fixed noise."""

    descriptor: Floats  # (R, K)
    success: Floats  # (R, K)
    level_shares: Floats  # (K, L) of the levels that each contrast is read from


@dataclass(frozen=True, eq=False, slots=True)
class _Support:
    """The clusters behind K contrasts, (K,) each: the least over their levels."""

    degrees: Floats  # Effective clusters less one.
    people: Ints


def draw_weights(
    task: TaskSums, tasks: Sequence[TaskSums], dataset: str, seed: int
) -> Floats:
    """Return weights of a task's clusters, (1 + B + C, C).

    The rows are: all clusters, bootstrap draws, and each cluster left out in turn. All
    tasks of a recording draw the same people.
    """
    own = task_recording(task.task, dataset=dataset)
    siblings = [
        other for other in tasks if task_recording(other.task, dataset=dataset) == own
    ]
    people = sorted({name for other in siblings for name in other.clusters})
    place = {name: column for column, name in enumerate(people)}
    counts = cluster_weights(
        n_clusters=len(people),
        n_replicates=N_REPLICATES,
        seed=seed,
        stream_names=("linked", own),
    )
    n = len(task.clusters)
    drawn = counts[:, [place[name] for name in task.clusters]]
    return np.concatenate([np.ones((1, n)), drawn, 1.0 - np.eye(n)])


def build_contrasts(
    sums: Sums,
    rates: Rates,
    panel: Panel,
    *,
    others: Sequence[int],
    fid: Sequence[int] = (),
) -> Contrasts:
    """Return the contrasts with fixed noise: of FID at quarter points, then of other levels.

    `rates` are `Sums.rates` under `draw_weights`. `others` and `fid` are places of
    levels, as in `Panel`.
    """
    compared = _compared_levels(rates, panel.fixed, others=list(others), fid=list(fid))
    yardstick = FixedNoise(
        rates.descriptor[:, panel.fixed], rates.success[:, panel.fixed]
    )
    comparison = curves.compare_with_fixed(
        compared.descriptor, compared.success, yardstick
    )
    shares = compared.level_shares
    support = _support(sums, shares, panel.fixed)
    fixed_shares = _task_level_shares(panel.fixed, comparison.places, shares.shape[1])
    discordant = _discordant(sums, shares - fixed_shares, raw=panel.fixed[-1])
    n_drawn = 1 + N_REPLICATES
    # Too few replicates show nothing, such as when no person with a value was drawn.
    has_gap = np.isfinite(comparison.gaps[0]) & (
        np.isfinite(comparison.gaps[:n_drawn]).mean(axis=0) >= MIN_DEFINED
    )
    gaps = _filled(comparison.gaps)
    errors = standard_error(gaps[1:n_drawn], gaps[n_drawn:])
    # If all people fare the same, replicates have no spread and say nothing of others.
    has_no_spread = errors < rules.NO_SPREAD
    has_no_spread &= discordant.n_people >= rules.FEWEST_DISCORDANT
    n_effective = support.degrees + 1.0
    is_shown = has_gap & (n_effective >= LEAST_CLUSTERS) & ~has_no_spread
    is_tested = is_shown & (n_effective >= FEWEST_EFFECTIVE)
    decides_fid = [True] * (len(comparison.side) - len(others))
    decides_others = [not panel.is_hidden(place) for place in others]
    return Contrasts(
        gaps=gaps[:n_drawn],
        errors=np.where(is_shown, errors, np.nan),
        side=np.where(is_tested, comparison.side, NEITHER),
        degrees=support.degrees,
        people=support.people,
        discordant=discordant,
        decides=np.array(decides_fid + decides_others, dtype=np.bool_),
        fixed=_fixed_range(sums, rates, panel.fixed),
        is_whole=not panel.missing,
    )


def _compared_levels(
    rates: Rates, fixed: Sequence[int], *, others: list[int], fid: list[int]
) -> _Compared:
    """Return FID at the quarter points, if it has a sweep, and then each other level."""
    success, descriptor = rates.success, rates.descriptor
    n_levels = descriptor.shape[1]
    other_shares = np.eye(n_levels)[others]
    if not fid:
        return _Compared(descriptor[:, others], success[:, others], other_shares)
    readings = curves.read_at_quarter_points(
        descriptor[:, fid], success[:, fid], descriptor[:, fixed]
    )
    fid_shares = _task_level_shares(fid, readings.places, n_levels)
    return _Compared(
        descriptor=np.hstack([readings.descriptor, descriptor[:, others]]),
        success=np.hstack([readings.success, success[:, others]]),
        level_shares=np.vstack([fid_shares, other_shares]),
    )


def _support(sums: Sums, shares: Floats, fixed: Sequence[int]) -> _Support:
    """Return the clusters behind contrasts; `shares`, (K, L), are those of levels."""
    counts = sums.cluster_counts
    rests_on = shares > 0
    # Every contrast is also read from the whole curve of fixed noise.
    rests_on[:, fixed] = True
    return _Support(
        degrees=np.where(rests_on, counts.effective, np.inf).min(axis=1) - 1.0,
        people=np.where(rests_on, counts.people, counts.people.max()).min(axis=1),
    )


def _discordant(sums: Sums, shares: Floats, *, raw: int) -> Discordant:
    """Return the people linked more and less often than under fixed noise.

    `shares`, (K, L), are those of the levels of a contrast, less those of fixed noise.
    """
    mass = sums.probes[raw] / sums.probes[raw].sum()
    linked = sums.success / np.maximum(sums.probes, 1.0)
    apart = shares @ linked
    return Discordant(
        more=np.maximum(apart, 0.0) @ mass,
        fewer=np.maximum(-apart, 0.0) @ mass,
        n_people=np.abs(apart).sum(axis=1),
    )


def _fixed_range(sums: Sums, rates: Rates, fixed: Sequence[int]) -> FixedRange:
    """Return fall and span of fixed noise, whose rates have a row for each draw."""
    success, descriptor = rates.success, rates.descriptor
    noisiest, raw = fixed[0], fixed[-1]
    floor = np.maximum(
        curves.LEAST_SHARE * np.nan_to_num(descriptor[0, raw]), rules.NO_SPREAD
    )
    span = np.log(
        np.maximum(descriptor[:, raw], floor)
        / np.maximum(descriptor[:, noisiest], floor)
    )
    fall = success[:, raw] - success[:, noisiest]
    drawn, n_drawn = _filled(np.column_stack([fall, span])), 1 + N_REPLICATES
    errors = standard_error(drawn[1:n_drawn], drawn[n_drawn:])
    return FixedRange(
        fall=drawn[:n_drawn, 0],
        span=drawn[:n_drawn, 1],
        fall_error=float(errors[0]),
        span_error=float(errors[1]),
        degrees=float(sums.cluster_counts.effective[fixed].min()) - 1.0,
    )


def _filled(values: Floats) -> Floats:
    """Return values, (R, K), with the estimate, or 0, in place of unknown values."""
    return np.where(np.isfinite(values), values, np.nan_to_num(values[0]))


def _task_level_shares(
    places: Sequence[int], position: CurvePositions, n_levels: int
) -> Floats:
    """Return the shares of all levels of a task that a sweep is read from, (K, L).

    `places` are those of the sweep's levels in the task.
    """
    shares = curves.level_shares(position, len(places))
    all_shares = np.zeros((len(shares), n_levels))
    all_shares[:, places] = shares
    return all_shares


def standard_error(drawn: Floats, left_out: Floats) -> Floats:
    """Return the standard error of each column: the larger of jackknife and bootstrap.

    The jackknife holds with few clusters; where a curve is flat it can miss a variation
    that the replicates, `drawn`, (B, K), show. `left_out`, (C, K), is the estimate with
    one cluster left out.
    """
    n = len(left_out)
    jackknife = np.sqrt(
        (n - 1.0) / n * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)
    )
    return np.asarray(np.maximum(jackknife, drawn.std(axis=0, ddof=1)))
