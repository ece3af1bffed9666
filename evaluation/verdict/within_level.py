"""The section *within*: whether a track's own PLR, AEL or MEL predicts its linkage.

The comparison is within a mechanism level, and beyond the covariates that anybody sees
without a descriptor: length, speed and noise of the track in both releases.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from evaluation.estimates.families import ADDING_RULES, RAW
from evaluation.estimates.linked_people import LinkedProbes
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.estimates.summary import N_REPLICATES
from evaluation.estimates.sweeps import Sweeps
from evaluation.plan.address import Address
from evaluation.verdict import rules
from evaluation.verdict.bands import Draft
from evaluation.verdict.items import Topic, WithinDetails
from evaluation.verdict.rules import NAME
from isac_track.intervals import CONFIDENCE, Estimate, effective_clusters
from isac_track.rng import stream
from isac_track.types import Floats, Ints

_FEWEST_TRACKS: Final = 3  # Of a level, beyond the terms of its covariates.
_LEAST_RANGE: Final = 1e-9  # Of a covariate's term; one below it is constant.
_LEAST_SCALE: Final = 1e-12  # Of residuals, by which ranks are divided.


def draft_within(
    levels: Mapping[str, Sequence[LinkedProbes]],
    sweeps: Sweeps,
    *,
    success: Mapping[str, Address],
    seed: int,
) -> Iterator[Draft]:
    """Yield a draft for every adding rule, descriptor and task.

    `levels` are by task; the levels of a task share cluster numbers. `sweeps` tell
    under which rule a mechanism is judged; `success` is the linker of each task.
    """
    clusters = {task: probes[0].clusters for task, probes in levels.items() if probes}
    # Drawn by name: a person in several tasks is drawn once.
    names = {name for task_clusters in clusters.values() for name in task_clusters}
    drawn_by_name = {
        name: stream(seed, "within", name).standard_normal(N_REPLICATES)
        for name in names
    }
    drawn_by_task = {
        task: np.column_stack([drawn_by_name[name] for name in task_clusters])
        for task, task_clusters in clusters.items()
    }
    for adding, descriptor, task in product(ADDING_RULES, DESCRIPTORS, success):
        judged = _distinct_levels(levels.get(task, ()), {RAW, *sweeps.swept(adding)})
        if any(linked.mechanism != RAW for linked in judged):
            yield _draft(
                judged,
                adding,
                descriptor,
                success[task],
                drawn_by_task[task],
            )


def _distinct_levels(
    levels: Sequence[LinkedProbes], mechanisms: Collection[str]
) -> list[LinkedProbes]:
    """Return the levels of mechanisms, each release once: several eta may share it."""
    distinct: dict[bytes, LinkedProbes] = {}
    for linked in levels:
        if linked.mechanism in mechanisms:
            release = np.column_stack([linked.hit, *linked.descriptors.values()])
            distinct.setdefault(release.tobytes(), linked)
    return list(distinct.values())


def _draft(
    levels: Sequence[LinkedProbes],
    adding: str,
    descriptor: str,
    linker: Address,
    drawn: Floats,
) -> Draft:
    excess = clustered_mean(
        np.concatenate([linked.hit - linked.chance for linked in levels]),
        np.concatenate([linked.cluster for linked in levels]),
    )
    correlation = partial_correlation(
        [
            LinkedTracks(
                linked.descriptors[descriptor],
                linked.hit,
                linked.covariates,
                linked.cluster,
            )
            for linked in levels
        ],
        drawn=drawn,
    )
    name = NAME[descriptor]
    sentence = (
        f"In {linker.task}, among tracks of like length, speed and noise, a track's own"
        f" {name} and whether it is linked go together by {{}} (rank correlation)"
    )
    untestable = ""
    if not excess.ci_low > rules.SUCCESS_MARGIN:
        untestable = "the strongest attack hardly links anybody: nothing could be seen"
    elif not np.isfinite(correlation.value):
        untestable = f"{name} hardly varies beyond length, speed and noise"
    return Draft(
        topic=Topic(
            rules.WITHIN,
            adding,
            descriptor=descriptor,
            task=linker.task,
            attack=linker.without_task.label,
        ),
        effect=correlation,
        parted_at=rules.LEAST_CORRELATION,
        above=rules.TRACKS,
        below=rules.DOES_NOT,
        unit="correlation",
        sentences={
            rules.DOES_NOT: (
                f"{sentence}: less than {rules.LEAST_CORRELATION:g}, it does not tell."
            ),
            rules.TRACKS: f"{sentence}: it tells.",
            "": f"{sentence}.",
        },
        untestable=untestable,
        details=WithinDetails(n_levels=len(levels), linked=excess.value),
    )


def clustered_mean(values: Floats, cluster: Ints) -> Estimate:
    """Return the mean with its clustered standard error (Liang and Zeger 1986)."""
    mean = float(values.mean())
    return _estimated(mean, (values - mean) / values.size, cluster)


@dataclass(frozen=True, eq=False, slots=True)
class LinkedTracks:
    """Descriptors, outcomes and covariates of N tracks at a level."""

    descriptor: Floats  # (N, 2), of the track in either release
    hit: Floats  # (N,), whether it was linked
    covariates: Floats  # (N, K)
    cluster: Ints  # (N,)


def partial_correlation(
    levels: Sequence[LinkedTracks],
    *,
    drawn: Floats | None = None,
) -> Estimate:
    """Return the partial rank correlation of descriptor and hit within levels.

    At each level all are put in ranks. The mean rank of the descriptor in both
    releases, and the rank of the hit, are regressed on the ranks of the covariates and
    their squares; the residuals are correlated, over all levels together. The standard
    error is the clustered sandwich of its influence function, so that a person at every
    level counts once.

    Tracks without a descriptor or a covariate are dropped. `drawn`, (B, C), are
    standard normal numbers of each cluster. They make the replicates (Gaussian
    multipliers of each cluster's influence: Chernozhukov, Chetverikov and Kato, Ann.
    Stat. 41, 2013).
    """
    known = [own for level in levels if (own := _rank_residuals(level)) is not None]
    if not known:
        return Estimate(np.nan)
    # Contiguous: otherwise the sums below would be rounded in another order.
    x, y = np.ascontiguousarray(np.concatenate([own.ranks for own in known]).T)
    cluster = np.concatenate([own.cluster for own in known])
    scale = np.sqrt((x @ x) * (y @ y)) / x.size
    if scale < _LEAST_SCALE:
        return Estimate(np.nan, n=int(np.unique(cluster).size))
    value = float(x @ y / x.size / scale)
    influence = (
        x * y / scale - value / 2.0 * (x * x / (x @ x) + y * y / (y @ y)) * x.size
    )
    return _estimated(value, influence / x.size, cluster, drawn)


@dataclass(frozen=True, eq=False, slots=True)
class _RankResiduals:
    """Ranks of N tracks beyond what their covariates explain."""

    ranks: Floats  # (N, 2) of the descriptor, and of the hit
    cluster: Ints  # (N,)


def _rank_residuals(level: LinkedTracks) -> _RankResiduals | None:
    """Return the residuals of a level; None if it has too few complete tracks."""
    needed = np.column_stack([level.descriptor, level.covariates])
    is_complete = np.isfinite(needed).all(axis=1)
    if is_complete.sum() < _FEWEST_TRACKS:
        return None
    values = np.column_stack([level.descriptor, level.hit, level.covariates])
    ranks = _ranks(values[is_complete])
    # The first two columns are the descriptor in either release, the third is the hit.
    descriptor_rank = _ranks(ranks[:, :2].mean(axis=1, keepdims=True))
    terms = np.column_stack([ranks[:, 3:], ranks[:, 3:] ** 2])
    varies = np.ptp(terms, axis=0) > _LEAST_RANGE
    design = np.column_stack([np.ones(len(ranks)), terms[:, varies]])
    if is_complete.sum() <= design.shape[1] + _FEWEST_TRACKS:
        return None
    ranked = np.column_stack([descriptor_rank, ranks[:, 2]])
    explained = design @ np.linalg.lstsq(design, ranked, rcond=None)[0]
    return _RankResiduals(ranked - explained, level.cluster[is_complete])


def _ranks(values: Floats) -> Floats:
    """Return ranks of each column, ties at their mean, within -1..1."""
    n = values.shape[0]
    scaled: Floats = (2.0 * pd.DataFrame(values).rank().to_numpy() - (n + 1.0)) / max(
        n - 1.0, 1.0
    )
    return scaled


def _estimated(
    value: float, parts: Floats, cluster: Ints, drawn: Floats | None = None
) -> Estimate:
    """Return an effect with the standard error of its influence, (N,), by cluster."""
    names, column = np.unique(cluster, return_inverse=True)
    n = names.size
    if n < 2:  # noqa: PLR2004 - one person has no rank
        return Estimate(value, n=n)
    effective = effective_clusters(np.bincount(column).astype(np.float64))
    sums = np.sqrt(n / (n - 1.0)) * np.bincount(column, weights=parts, minlength=n)
    error = float(np.sqrt(sums @ sums))
    # As many degrees of freedom as in the items of the verdict.
    freedom = max(effective - 1.0, 1.0)
    half = float(stdtrit(freedom, 0.5 + CONFIDENCE / 2)) * error
    replicates = np.zeros(0) if drawn is None else value + drawn[:, names] @ sums
    ends = value - half, value + half
    return Estimate(
        value, *ends, n, replicates, closed_error=error, effective=effective
    )
