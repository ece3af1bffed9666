"""Compare with other packages: ``python -m benchmarks.beside --json FILE``.

Filters and smoothers, warping, pairwise distances, the scorecard of a linkage attack,
and a whole cell (release, attack, scorecard) against a plain script of the same
content. Both sides get the same arrays in one process with one thread; results are
compared before times are told, and a difference that is no rounding ends it with exit
code 1. What is not installed is left out.
"""

# Peers are imported where they are used: any of them may be missing.
# ruff: noqa: PLC0415 - as said
from __future__ import annotations

import argparse
import json
import os
import sys

# Before numpy: the figures are those of one core.
for _library in ("OPENBLAS", "MKL", "OMP"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"

# ruff: noqa: E402 - as said above
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from attacks.linkage.alignment import Shape
from attacks.linkage.behaviour import FEATURES, Behaviour, features
from attacks.linkage.dtw import DTW, warped_costs
from attacks.linkage.histogram import same_source_ratio
from attacks.linkage.signals import STEP_S, release_motion
from benchmarks import smoothers
from benchmarks.default_run import calibration_s
from benchmarks.linkage import windows
from evaluation.reporting.terminal import aligned
from isac_track import kalman, linkability
from isac_track.intervals import cluster_weights
from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.sharing import Fixed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from isac_track.types import Floats, Ints, Release, Sensed

    Row = tuple[str, str, Callable[[], Any], Callable[[], Any]]
    """Work, package, our and their function: both results must be equal."""

N_PEOPLE = 140
LEVEL_M = 0.5
LONGEST_LAG = 24
ALPHA = 0.01
TOLERANCE = 1e-8
METRICS = (
    "rank1",
    "mrr",
    "rank1_assigned",
    "auc",
    "eer",
    "cllr_min",
    "tpr_at_fpr_1pct",
    "d_sys",
)
COLUMNS = ("what", "theirs", "ours_ms", "theirs_ms", "ratio", "largest_difference")


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare, time and show; return 1 if two results differ."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.beside", description=__doc__
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write the figures there, too"
    )
    options = parser.parse_args(arguments)
    kalman.prepare()
    before_s, load = calibration_s(), os.getloadavg()[0]
    rows: list[dict[str, Any]] = []
    for work, package, ours, theirs in (*smoothers.rows(), *linkage_rows()):
        try:
            name = f"{package} {version(package)}"
        except PackageNotFoundError:
            print(
                f"{work}: {package} is missing; `pip install {package}`",
                file=sys.stderr,
            )
            continue
        worst = difference(ours(), theirs())
        ours_s, theirs_s = best(ours, repeats=20), best(theirs, repeats=3)
        rows.append(
            {
                "what": work,
                "theirs": name,
                "ours_ms": 1e3 * ours_s,
                "theirs_ms": 1e3 * theirs_s,
                "ratio": theirs_s / ours_s,
                "largest_difference": worst,
            }
        )
    shown = [
        [*(row[key] for key in COLUMNS[:2]), *(_shown(row[key]) for key in COLUMNS[2:])]
        for row in rows
    ]
    print("\n".join(aligned([COLUMNS, *shown], left={0, 1})))
    conditions = {
        "python": python_version(),
        "calibration_s": (before_s + calibration_s()) / 2,
        "load": [load, os.getloadavg()[0]],
    }
    print(", ".join(f"{name} {value}" for name, value in conditions.items()))
    if options.json is not None:
        text = json.dumps(conditions | {"rows": rows}, indent=1) + "\n"
        options.json.write_text(text, encoding="utf-8")
    differ = [row["what"] for row in rows if not row["largest_difference"] <= TOLERANCE]
    if differ:
        print(f"error: results differ: {', '.join(differ)}", file=sys.stderr)
    return 1 if differ else 0


def _shown(value: float) -> str:
    return f"{value:,.1f}" if value >= 10 else f"{value:.2g}"


def difference(ours: Sequence[Floats], theirs: Sequence[Floats]) -> float:
    """Return the largest difference of two results, relative to the largest number."""
    return max(
        float(np.abs(np.subtract(a, b)).max()) / max(1.0, float(np.abs(a).max()))
        for a, b in zip(ours, theirs, strict=True)
    )


def best(run: Callable[[], object], *, repeats: int) -> float:
    """Return the shortest of several wall times, s; long work is repeated less."""
    times: list[float] = []
    while len(times) < repeats and sum(times) < 10.0:
        start = perf_counter()
        run()
        times.append(perf_counter() - start)
    return min(times)


def linkage_rows() -> Iterator[Row]:
    """Yield the rows of linkage attacks and of scorecards."""
    sensed = windows(n=N_PEOPLE)
    probe, gallery = (share(side).without_sigma() for side in sensed)
    context = AttackContext(
        rng=stream(0, "benchmark"), epsilon_m=0.3, granted=frozenset()
    )
    shape, behaviour = Shape().fit(context), Behaviour().fit(context)
    size = f"{N_PEOPLE} x {N_PEOPLE} walks of 12 s"
    p, g = (release_motion(release, 1.0) for release in (probe, gallery))
    law = {"band": DTW().band, "penalty": 0.1, "floor": DTW().floor}
    yield (
        f"warping of speed and turning, {size}",
        "dtaidistance",
        lambda: [warped_costs(p, g, **law)],
        lambda: [warped(p, g, **law)],
    )
    metric = np.diag(1.0 / np.array(list(FEATURES.values())) ** 2)
    a, b = features(probe), features(gallery)
    yield (
        f"distances of features, {size}",
        "scipy",
        lambda: [behaviour(probe, gallery)],
        lambda: [squared_distances(a, b, metric)],
    )
    counts = [
        stream(0, "benchmark", side).multinomial(96, np.full(60, 1 / 60), 700)
        for side in "pg"
    ]
    c, d = (histograms.astype(np.float64) for histograms in counts)
    yield (
        "distances of histograms, 700 x 700",
        "scipy",
        lambda: [same_source_ratio(c, d)],
        lambda: [divergences(c, d)],
    )
    weights = cluster_weights(n_clusters=N_PEOPLE, n_replicates=1000, seed=0)
    scores = shape(probe, gallery)
    yield (
        f"scorecard, {N_PEOPLE} x {N_PEOPLE} scores",
        "scikit-learn",
        lambda: scored(scores, weights),
        lambda: plainly_scored(scores, weights),
    )

    def cell() -> list[Floats]:
        own = shape(*(share(side).without_sigma() for side in sensed))
        return [own, *scored(own, weights)]

    def script() -> list[Floats]:
        own = plain_shape(*(plain_walks(side) for side in sensed))
        return [own, *plainly_scored(own, weights)]

    yield f"release, `shape` and scorecard, {size}", "numpy", cell, script


def share(sensed: Sensed) -> Release:
    """Return a release as in a cell."""
    return Fixed(LEVEL_M).share(sensed, stream(0, "benchmark", "share"))


def scored(scores: Floats, weights: Floats) -> list[Floats]:
    """Return value and replicates of each of `METRICS` from the scorecard."""
    everybody = np.arange(len(scores))
    search = linkability.Search(scores, everybody, everybody, everybody)
    card = linkability.scorecard(
        [search],
        weights=weights,
        calibration=None,
        no_match_score=None,
        rng=stream(0, "card"),
    )
    estimates = (card.estimates[name] for name in METRICS)
    return [np.array([estimate.value, *estimate.replicates]) for estimate in estimates]


def warped(
    probe: Any,  # noqa: ANN401 - Signals
    gallery: Any,  # noqa: ANN401 - Signals
    *,
    band: float,
    penalty: float,
    floor: float,
) -> Floats:
    """Return `warped_costs` by dtaidistance's compiled loops."""
    from dtaidistance import dtw_ndim

    walks = [
        np.ascontiguousarray(signals.values[:, row, :n:2].T)
        for signals in (probe, gallery)
        for row, n in enumerate(signals.sizes)
    ]
    length, n_probe = np.array([len(samples) for samples in walks]), probe.sizes.size
    # The band must be the same for all walks.
    (reach,) = {round(band * n) for n in length}
    block = ((0, n_probe), (n_probe, len(walks)))
    law = {"window": reach + 1, "psi": reach, "penalty": penalty}
    distances = dtw_ndim.distance_matrix(
        walks, 2, block=block, use_c=True, parallel=False, **law
    )
    shorter = np.minimum.outer(length[:n_probe], length[n_probe:])
    costs: Floats = (distances[:n_probe, n_probe:] ** 2 / shorter + floor) * (
        24 / shorter
    ) ** 3
    return costs


def squared_distances(a: Floats, b: Floats, metric: Floats) -> Floats:
    """Return minus the squared Mahalanobis distances by scipy."""
    from scipy.spatial.distance import cdist

    return -(cdist(a, b, "mahalanobis", VI=metric) ** 2)


def divergences(a: Floats, b: Floats) -> Floats:
    """Return log likelihood ratios of a common source by scipy.

    All histograms have the same number of counts.
    """
    from scipy.spatial.distance import cdist

    squares: Floats = cdist(a, b, "jensenshannon") ** 2
    return np.asarray(-(a.sum(axis=1)[:, None] + b.sum(axis=1)) * squares)


def plainly_scored(scores: Floats, weights: Floats) -> list[Floats]:
    """Return `scored` by scikit-learn's curves and a loop over draws, with shuffles."""
    from scipy.optimize import linear_sum_assignment

    n = len(scores)
    rank = 1 + (scores > np.diag(scores)[:, None]).sum(axis=1)
    assigned = linear_sum_assignment(scores, maximize=True)[1] == np.arange(n)
    rank_metrics = [
        np.array([np.average(values, weights=draw) for draw in (np.ones(n), *weights)])
        for values in (rank == 1, 1.0 / rank, assigned)
    ]
    value = np.unique(scores, return_inverse=True)[1].ravel()
    edges = np.linspace(scores.min(), scores.max(), n // 10 + 1)
    draws = (np.ones(n), *weights[: linkability.SCORE_REPLICATES])
    score_metrics = [_score_metrics(scores, value, edges, draw) for draw in draws]
    # The p-value of the shuffles is not compared: it depends on the draws.
    log_rank = np.log(scores.argsort(axis=1)[:, ::-1].argsort(axis=1) + 1.0)
    rng = stream(0, "plain")
    for _ in range(999):
        log_rank[np.arange(n), rng.permutation(n)].mean()
    return [*rank_metrics, *np.array(score_metrics).T]


def _score_metrics(
    scores: Floats, value: Ints, edges: Floats, draw: Floats
) -> list[float]:
    """Return the last five of `METRICS` for the weights of people in a draw, (N,).

    `value` are the scores, (N, N), by rank in a line; `edges` those of the bins.
    """
    from sklearn.isotonic import IsotonicRegression
    from sklearn.metrics import auc, roc_curve

    n = len(scores)
    is_mate = np.eye(n, dtype=bool)
    label = is_mate.ravel()
    mass = np.where(is_mate, draw[:, None], np.outer(draw, draw)).ravel()
    fpr, tpr, _ = roc_curve(label, value, sample_weight=mass, drop_intermediate=False)
    own, other = np.where(label, mass, 0.0), np.where(~label, mass, 0.0)
    own, other = own / own.sum(), other / other.sum()
    is_drawn = mass > 0
    fitted = IsotonicRegression(y_min=0, y_max=1)
    p = fitted.fit_transform(
        value[is_drawn], label[is_drawn], sample_weight=(own + other)[is_drawn]
    )
    hull = roc_curve(
        label[is_drawn], p, sample_weight=mass[is_drawn], drop_intermediate=False
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        nats = np.where(
            label[is_drawn], own[is_drawn] * -np.log(p), other[is_drawn] * -np.log1p(-p)
        )
        mates, others = (
            np.histogram(scores, edges, weights=part.reshape(n, n))[0]
            for part in (own, other)
        )
        share = np.where(mates > others, (mates - others) / (mates + others), 0.0)
    return [
        auc(fpr, tpr),
        _crossing(hull[0], hull[1]),
        np.nansum(nats) / (2 * np.log(2)),
        tpr[fpr <= ALPHA * (1 + 1e-12)].max(),
        (mates * share).sum(),
    ]


def _crossing(fpr: Floats, tpr: Floats) -> float:
    """Return where 1 - TPR = FPR on the chords of a ROC."""
    return float(np.interp(0.0, fpr + tpr - 1.0, fpr))


def plain_walks(sensed: Sensed) -> list[Floats]:
    """Return the resampled steps of each walk as complex numbers, with added noise.

    The noise is that of `LEVEL_M`.
    """
    xy = sensed.xy + LEVEL_M * sensed.unit_error
    walks = []
    for low, high in zip(sensed.offsets[:-1], sensed.offsets[1:], strict=True):
        t = sensed.t[low:high] - sensed.t[low]
        z = (xy[low:high] - xy[low]) @ [1.0, 1.0j]
        count = int(t[-1] / STEP_S + 1e-6)
        edges = np.minimum(
            (t[-1] - count * STEP_S) / 2 + STEP_S * np.arange(count + 1), t[-1]
        )
        knots = np.union1d(edges, t)
        line = np.interp(knots, t, z.real) + 1j * np.interp(knots, t, z.imag)
        areas = np.append(0.0, np.cumsum(np.diff(knots) * (line[1:] + line[:-1]) / 2))
        walks.append(np.diff(areas[np.searchsorted(knots, edges)]) / STEP_S)
    return walks


def plain_shape(probe: list[Floats], gallery: list[Floats]) -> Floats:
    """Return the blind scores of the linker `shape`, walk by walk and lag by lag."""
    least = np.full((len(probe), len(gallery)), np.inf)
    lengths = np.array([walk.size for walk in gallery])
    for i, own in enumerate(probe):
        for size in np.unique(lengths):
            rows = np.flatnonzero(lengths == size)
            others = np.array([gallery[row] for row in rows])
            back, ahead = max(size - own.size, 0), max(own.size - size, 0)
            for lag in range(-LONGEST_LAG - back, LONGEST_LAG + ahead + 1):
                m = min(own.size - max(lag, 0), size - max(-lag, 0))
                if m < 8:
                    continue
                powers = np.polynomial.legendre.legvander(np.linspace(-1, 1, m), 5)
                basis = np.linalg.qr(powers)[0][:, 1:]
                a = own[max(lag, 0) :][:m] @ basis
                b = others[:, max(-lag, 0) :][:, :m] @ basis
                gap = (
                    np.vdot(a, a).real
                    + (np.abs(b) ** 2).sum(axis=1)
                    - 2 * np.abs(b @ a.conj())
                )
                cost = (np.maximum(gap, 0.0) / m + Shape.DEFAULT_FLOOR_M2) * (
                    48 / m
                ) ** 3
                least[i, rows] = np.minimum(least[i, rows], cost)
    return np.asarray(-np.log(least))


if __name__ == "__main__":
    raise SystemExit(main())
