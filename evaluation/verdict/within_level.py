"""Section b of the verdict: whether a track's own PLR, AEL or MEL tells that it is linked.

Within one mechanism level, and beyond what anybody sees without a descriptor: how long
the track is, how fast, and how noisy in both releases.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from evaluation.estimates.families import ADDING_RULES, RAW
from evaluation.estimates.keys import Source
from evaluation.estimates.linked_people import LinkedProbes
from evaluation.estimates.matching import Sweeps
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.estimates.summary import N_REPLICATES
from evaluation.verdict import rules
from evaluation.verdict.items import Draft
from evaluation.verdict.rules import NAME, known
from isac_track.intervals import CONFIDENCE, Estimate, effective_clusters
from isac_track.rng import stream
from isac_track.types import Floats, Ints

_FEW, _NOTHING, _NO_SPREAD = 3, 1e-9, 1e-12


def within(
    levels: Mapping[str, Sequence[LinkedProbes]],
    sweeps: Sweeps,
    *,
    success: Mapping[str, Source],
    seed: int,
) -> Iterator[Draft]:
    """Yield an item for every adding rule, descriptor and task.

    `levels` are by task; clusters are numbered alike at all levels of a task. `sweeps`
    are of the run and say under which rule a mechanism is judged; `success` is the
    linker of each task.
    """
    clusters = {task: some[0].clusters for task, some in levels.items() if some}
    # By its name: who is in several tasks is drawn once.
    names = {name for of in clusters.values() for name in of}
    drawn = {
        name: stream(seed, "within", name).standard_normal(N_REPLICATES)
        for name in names
    }
    of_task = {
        task: np.column_stack([drawn[name] for name in of])
        for task, of in clusters.items()
    }
    for adding, descriptor, task in product(ADDING_RULES, DESCRIPTORS, success):
        wanted = (RAW, *sweeps.swept(adding))
        # Each release once: several eta may share the same.
        mine: dict[bytes, LinkedProbes] = {}
        for one in levels.get(task, ()):
            if one.mechanism in wanted:
                release = np.column_stack([one.hit, *one.descriptors.values()])
                mine.setdefault(release.tobytes(), one)
        if any(one.mechanism != RAW for one in mine.values()):
            yield _item(
                [*mine.values()], adding, descriptor, success[task], of_task[task]
            )


def _item(
    levels: Sequence[LinkedProbes],
    adding: str,
    descriptor: str,
    linker: Source,
    drawn: Floats,
) -> Draft:
    works = clustered_mean(
        np.concatenate([one.hit - one.chance for one in levels]),
        np.concatenate([one.cluster for one in levels]),
    )
    found = partial_correlation(
        [
            (one.descriptors[descriptor], one.hit, one.covariates, one.cluster)
            for one in levels
        ],
        drawn=drawn,
    )
    name = NAME[descriptor]
    said = (
        f"In {linker.task}, among tracks of like length, speed and noise, a track's own"
        f" {name} and whether it is linked go together by {{}} (rank correlation)"
    )
    untestable = ""
    if not works.ci_low > rules.SUCCESS_MARGIN:
        untestable = "the strongest attack hardly links anybody: nothing could be seen"
    elif not np.isfinite(found.value):
        untestable = f"{name} hardly varies beyond length, speed and noise"
    return Draft(
        adding=adding,
        descriptor=descriptor,
        task=linker.task,
        subject=linker.attack.label,
        effect=found,
        parted_at=rules.LEAST_CORRELATION,
        above=rules.TRACKS,
        below=rules.DOES_NOT,
        unit="correlation",
        sentences={
            rules.DOES_NOT: (
                f"{said}: less than {rules.LEAST_CORRELATION:g}, it does not tell."
            ),
            rules.TRACKS: f"{said}: it tells.",
            "": f"{said}.",
        },
        untestable=untestable,
        details={"levels": len(levels), "linked": known(works.value)},
    )


def clustered_mean(values: Floats, cluster: Ints) -> Estimate:
    """Return the mean of values with its clustered standard error (Liang and Zeger 1986)."""
    mean = float(values.mean())
    return _estimated(mean, (values - mean) / values.size, cluster)


def partial_correlation(
    levels: Sequence[tuple[Floats, Floats, Floats, Ints]],
    *,
    drawn: Floats | None = None,
) -> Estimate:
    """Return the rank correlation of descriptor and hit within levels, beyond the covariates.

    At each level all are put in ranks; the mean rank of the descriptor in both
    releases, and the rank of the hit, are regressed on the ranks of the covariates and
    their squares; what is left of either is correlated, over all levels together. The
    standard error is the clustered sandwich of its influence function, so that a person
    who occurs at every level counts once.

    `levels` are (descriptor (N, 2), hit (N,), covariates (N, K), cluster (N,)) of each;
    rows without a descriptor or covariate go. `drawn`, (B, C), are standard normal
    numbers of each cluster, from which the replicates come (Gaussian multipliers of the
    influence of each cluster: Chernozhukov, Chetverikov and Kato, Ann. Stat. 41, 2013).
    """
    rests: list[Floats] = []
    clusters: list[Ints] = []
    for descriptor, hit, covariates, cluster in levels:
        whole = np.isfinite(descriptor).all(axis=1) & np.isfinite(covariates).all(
            axis=1
        )
        if whole.sum() < _FEW:
            continue
        ranks = _ranks(np.column_stack([descriptor, hit, covariates])[whole])
        mine = _ranks(ranks[:, :2].mean(axis=1, keepdims=True))
        columns = np.column_stack([ranks[:, 3:], ranks[:, 3:] ** 2])
        varies = np.ptp(columns, axis=0) > _NOTHING
        design = np.column_stack([np.ones(len(ranks)), columns[:, varies]])
        if whole.sum() <= design.shape[1] + _FEW:
            continue
        both = np.column_stack([mine, ranks[:, 2]])
        rests.append(both - design @ np.linalg.lstsq(design, both, rcond=None)[0])
        clusters.append(cluster[whole])
    if not rests:
        return Estimate(np.nan)
    # Each in one piece: the sums below would otherwise be rounded in another order.
    x, y = np.ascontiguousarray(np.concatenate(rests).T)
    cluster = np.concatenate(clusters)
    scale = np.sqrt((x @ x) * (y @ y)) / x.size
    if scale < _NO_SPREAD:
        return Estimate(np.nan, n=int(np.unique(cluster).size))
    value = float(x @ y / x.size / scale)
    influence = (
        x * y / scale - value / 2.0 * (x * x / (x @ x) + y * y / (y @ y)) * x.size
    )
    return _estimated(value, influence / x.size, cluster, drawn)


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
    """Return an effect whose influence, (N,), sums up within clusters."""
    names, column = np.unique(cluster, return_inverse=True)
    n = names.size
    if n < 2:  # noqa: PLR2004 - one person has no rank
        return Estimate(value, n=n)
    effective = effective_clusters(np.bincount(column).astype(np.float64))
    sums = np.sqrt(n / (n - 1.0)) * np.bincount(column, weights=parts, minlength=n)
    error = float(np.sqrt(sums @ sums))
    half = float(stdtrit(n - 1, 0.5 + CONFIDENCE / 2)) * error
    replicates = np.zeros(0) if drawn is None else value + drawn[:, names] @ sums
    ends = value - half, value + half
    return Estimate(
        value, *ends, n, replicates, closed_error=error, effective=effective
    )
