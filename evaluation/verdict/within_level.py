"""Section b of the verdict: whether a track's own PLR, AEL or MEL tells that it is linked.

Within one mechanism level some tracks are linked and some are not. A designer who reads a
descriptor track by track wants to know whether it tells which, beyond what anybody sees without
it: how long the track is, how fast, and how noisy in both releases.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from scipy.special import stdtrit

from evaluation.analysis.families import ADDING_RULES, RAW
from evaluation.analysis.metrics import DESCRIPTORS, METRICS
from evaluation.cells.link_setup import SIDES
from evaluation.experiment.constants import WINDOWS
from evaluation.runs.cell_files import read_rows
from evaluation.verdict import rules
from evaluation.verdict.rules import NAME, Draft, known, with_interval
from isac_track.intervals import CONFIDENCE, Estimate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from evaluation.analysis.keys import Source
    from evaluation.analysis.matching import Sweeps
    from isac_track.types import Floats, Ints

COVARIATES: Final = ("n_samples", "duration_s", "speed_mps", "sigma_m")
"""Of either release: length, speed and mean noise."""
_WHOSE: Final = ("search", "source")
_FEW, _NOTHING, _NO_SPREAD = 3, 1e-9, 1e-12


@dataclass(frozen=True, eq=False, slots=True)
class LevelTracks:
    """Who is linked at one mechanism level, and what their own tracks say."""

    mechanism: str
    hit: Floats
    """(N,) expected share of cases in which the mate comes first"""
    chance: Floats
    """(N,)"""
    cluster: Ints
    """(N,)"""
    descriptors: Mapping[str, Floats]
    """By descriptor, (N, 2): in the probe and in the gallery release"""
    covariates: Floats
    """(N, K)"""


def read_levels(
    out: Path, manifest: Mapping[str, Any], sweeps: Sweeps, *, strongest: Mapping[str, Source]
) -> dict[str, list[LevelTracks]]:
    """Return the tracks of raw and of every level of a sweep, by task.

    `strongest` is by task its strongest linker.

    Raises DataError if a cell cannot be read.
    """
    wanted = {RAW}.union(*(sweeps.swept(adding) for adding in ADDING_RULES))
    cells = [entry for entry in manifest["cells"] if entry["mechanism"] in wanted]
    windows = {(entry["spec"], entry["consumer"]): entry for entry in cells}
    return {
        task: [
            _level(out, entry, windows[entry["spec"], f"{task}/{WINDOWS}"])
            for entry in cells
            if (entry["consumer"], entry["knowledge"]) == linker
            and (entry["spec"], f"{task}/{WINDOWS}") in windows
        ]
        for task, linker in strongest.items()
    }


def _level(out: Path, linked: Mapping[str, Any], windows: Mapping[str, Any]) -> LevelTracks:
    descriptors = {name: METRICS[name].column for name in DESCRIPTORS}
    of_tracks = ["side", *_WHOSE, *COVARIATES, *descriptors.values()]
    of_probes = [*_WHOSE, "group", "above", "tied", "chance"]
    probes = read_rows(out, linked, columns=of_probes, beside=of_tracks)
    probes = probes.filter(pc.greater_equal(probes["above"], 0))
    tracks = read_rows(out, windows, columns=of_tracks, beside=of_probes)
    names, sides = _names(tracks), []
    for side in SIDES:
        mine = np.flatnonzero(pc.equal(tracks["side"], side).to_numpy())
        sides.append(mine[pc.index_in(_names(probes), value_set=names.take(mine)).to_numpy()])

    def both(column: str) -> Floats:
        values = tracks[column].to_numpy().astype(np.float64)
        return np.column_stack([values[side] for side in sides])

    above, tied = (probes[name].to_numpy() for name in ("above", "tied"))
    return LevelTracks(
        mechanism=windows["mechanism"],
        hit=np.where(above == 0, 1.0 / tied, 0.0),
        chance=probes["chance"].to_numpy(),
        cluster=np.unique(probes["group"].to_numpy().astype(str), return_inverse=True)[1],
        descriptors={name: both(column) for name, column in descriptors.items()},
        covariates=np.column_stack([both(column) for column in COVARIATES]),
    )


def _names(rows: pa.Table) -> pa.ChunkedArray:
    """Return what a track is called in its search and among all."""
    search, source = (rows[name].cast(pa.string()) for name in _WHOSE)
    return pc.binary_join_element_wise(search, source, "\n")


def within(
    levels: Mapping[str, Sequence[LevelTracks]], sweeps: Sweeps, *, success: Mapping[str, Source]
) -> Iterator[Draft]:
    """Yield an item for every adding rule, descriptor and task.

    `levels` are by task; clusters are numbered alike at all levels of a task. `sweeps` are of the
    run and say under which rule a mechanism is judged; `success` is the linker of each task.
    """
    for adding in ADDING_RULES:
        wanted = (RAW, *sweeps.swept(adding))
        for descriptor in DESCRIPTORS:
            for task, linker in success.items():
                # Each release once: several eta may share the same.
                mine: dict[bytes, LevelTracks] = {}
                for one in levels.get(task, ()):
                    if one.mechanism in wanted:
                        release = np.column_stack([one.hit, *one.descriptors.values()])
                        mine.setdefault(release.tobytes(), one)
                if any(one.mechanism != RAW for one in mine.values()):
                    yield _item([*mine.values()], adding, descriptor, linker)


def _item(levels: Sequence[LevelTracks], adding: str, descriptor: str, linker: Source) -> Draft:
    works = clustered_mean(
        np.concatenate([one.hit - one.chance for one in levels]),
        np.concatenate([one.cluster for one in levels]),
    )
    found = partial_correlation(
        [(one.descriptors[descriptor], one.hit, one.covariates, one.cluster) for one in levels]
    )
    condition = rules.p_above(works, rules.SUCCESS_MARGIN)
    name = NAME[descriptor]
    said = (
        f"In {linker.task}, among tracks of like length, speed and noise, a track's own {name} "
        f"and whether it is linked go together by "
        f"{with_interval(found, 'correlation')} (rank correlation)"
    )
    why = "the interval reaches on both sides of the bound"
    if condition > rules.ALPHA:
        why = "the strongest attack hardly links anybody: nothing could be seen"
    elif not rules.is_known(found):
        why = f"{name} hardly varies beyond length, speed and noise, or there are too few people"
    return Draft(
        adding=adding,
        descriptor=descriptor,
        task=linker.task,
        subject=linker.attack.label,
        effect=found,
        unit="correlation",
        options={
            rules.DOES_NOT: max(condition, rules.p_below(found, rules.LEAST_CORRELATION)),
            rules.TRACKS: max(condition, rules.p_above(found, rules.LEAST_CORRELATION)),
            rules.WEAKLY: max(condition, rules.p_above(found, 0.0)),
        },
        sentences={
            rules.DOES_NOT: f"{said}: less than {rules.LEAST_CORRELATION:g}, it does not tell.",
            rules.TRACKS: f"{said}: it tells.",
            rules.WEAKLY: f"{said}: it tells a little.",
            rules.UNDECIDED: f"{said}.",
        },
        why_undecided=why,
        details={"levels": len(levels), "linked": known(works.value)},
    )


def clustered_mean(values: Floats, cluster: Ints) -> Estimate:
    """Return the mean of values with its clustered standard error (Liang and Zeger 1986)."""
    mean = float(values.mean())
    return _with_error(mean, (values - mean) / values.size, cluster)


def partial_correlation(levels: Sequence[tuple[Floats, Floats, Floats, Ints]]) -> Estimate:
    """Return the rank correlation of descriptor and hit within levels, beyond the covariates.

    At each level all are put in ranks; the mean rank of the descriptor in both releases, and the
    rank of the hit, are regressed on the ranks of the covariates and their squares; what is left
    of either is correlated, over all levels together. The standard error is the clustered sandwich
    of the correlation (its influence function), so that a person who occurs at every level counts
    once.

    `levels` are (descriptor (N, 2), hit (N,), covariates (N, K), cluster (N,)) of each; rows in
    which anything is unknown are left out.
    """
    rests: list[Floats] = []
    clusters: list[Ints] = []
    for descriptor, hit, covariates, cluster in levels:
        whole = np.isfinite(descriptor).all(axis=1) & np.isfinite(covariates).all(axis=1)
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
    influence = x * y / scale - value / 2.0 * (x * x / (x @ x) + y * y / (y @ y)) * x.size
    return _with_error(value, influence / x.size, cluster)


def _ranks(values: Floats) -> Floats:
    """Return ranks of each column, ties at their mean, within -1..1."""
    n = values.shape[0]
    scaled: Floats = (2.0 * pd.DataFrame(values).rank().to_numpy() - (n + 1.0)) / max(n - 1.0, 1.0)
    return scaled


def _with_error(value: float, parts: Floats, cluster: Ints) -> Estimate:
    """Return an effect whose influence, (N,), sums up within clusters."""
    names, column = np.unique(cluster, return_inverse=True)
    n = names.size
    if n < 2:  # noqa: PLR2004 - one person has no rank
        return Estimate(value, n=n)
    sums = np.bincount(column, weights=parts, minlength=n)
    error = float(np.sqrt(n / (n - 1.0) * (sums @ sums)))
    half = float(stdtrit(n - 1, 0.5 + CONFIDENCE / 2)) * error
    return Estimate(value, value - half, value + half, n, closed_error=error)
