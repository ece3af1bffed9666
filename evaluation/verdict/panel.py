"""Mechanisms compared with fixed noise at equal descriptor value: the contrasts.

The preset fixes the panel: FID at three places, and every level of its other mechanisms
under an adding rule. Mechanisms that a user adds are listed beside it. `contrasts`
prepares the numbers on which `spread` decides.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from attacks.tasks.task_list import TASKS
from evaluation.estimates.families import FID, FIXED, RAW, Family
from evaluation.estimates.interpolation import MIN_DEFINED, CurvePositions
from evaluation.estimates.keys import where_text
from evaluation.estimates.linked_people import TaskSums
from evaluation.estimates.recordings import task_recording
from evaluation.estimates.sweeps import FEWEST_LEVELS
from evaluation.plan.presets import PRESETS
from evaluation.verdict import rules, spread
from evaluation.verdict.spread import NEITHER, Contrasts
from isac_track import plugins
from isac_track.intervals import (
    FEWEST_EFFECTIVE,
    LEAST_CLUSTERS,
    cluster_weights,
    effective_clusters,
)
from isac_track.types import Floats, Ints

N_REPLICATES: Final = 1000
# It moves a whole walk: an adversary that links in a hidden frame cannot notice.
OFFSET: Final = "offset"


class Rates(NamedTuple):
    """Rates of L levels under R draws of people."""

    success: Floats  # (R, L)
    descriptor: Floats  # (R, L)


class Sizes(NamedTuple):
    """Clusters behind each of L levels."""

    effective: Floats  # (L,)
    people: Ints  # (L,)


class _Compared(NamedTuple):
    """What is compared with fixed noise: K contrasts under R draws of people."""

    descriptor: Floats  # (R, K)
    success: Floats  # (R, K)
    level_shares: Floats  # (K, L) of the levels that each contrast is read from


class _WholeRange(NamedTuple):
    """Fixed noise from raw to the strongest error."""

    fall: Floats  # (1 + B,) of linkage
    span: Floats  # (1 + B,) logarithm of the ratio of the descriptor
    fall_error: float
    span_error: float


@dataclass(frozen=True, eq=False, slots=True)
class Sums:
    """Success and a descriptor at a task's levels, summed by cluster, (L, C) each."""

    success: Floats
    probes: Floats
    values: Floats
    windows: Floats

    def drawn(self, weights: Floats) -> Rates:
        """Return success and descriptor under weights, (R, C)."""
        return Rates(
            success=spread.ratios(self.success, self.probes, weights),
            descriptor=spread.ratios(self.values, self.windows, weights),
        )

    @property
    def sizes(self) -> Sizes:
        """Clusters of each level."""
        counts = np.stack([self.probes, self.windows])
        effective = np.apply_along_axis(effective_clusters, 2, counts)
        return Sizes(effective.min(axis=0), (counts > 0).sum(axis=2).min(axis=0))


@dataclass(frozen=True, eq=False, slots=True)
class Panel:
    """The levels of a task under an adding rule, as places in `task.levels`."""

    task: TaskSums
    adding: str
    families: tuple[str, ...]  # (L,) of all levels
    fixed: list[int]  # From the noisiest to raw, which is the last.
    fid: list[int]  # In the same order; empty without a sweep.
    others: list[int]  # Of the preset.
    beside: list[int]  # Of the user, or a protection.
    # Text on missing parts; empty if the panel is whole, with a dissociation control.
    missing: str

    def is_hidden(self, place: int) -> bool:
        """Return whether a level changes only the part that the task hides.

        It then differs by construction.
        """
        task = TASKS.get(self.task.task)
        is_offset = self.families[place] == OFFSET
        return is_offset and task is not None and not task.shows_scene

    @property
    def compared(self) -> list[int]:
        """The level of each contrast; of FID the noisiest."""
        return self.fid[:1] * len(spread.QUARTILES) + self.others


def build_panel(
    task: TaskSums, known: Mapping[str, Family], *, adding: str, preset: str
) -> Panel | None:
    """Return the panel of a task; None without raw or a sweep of fixed noise."""
    families = [known[level.mechanism] for level in task.levels]
    levels = [(level.mechanism, level.level) for level in task.levels]
    raw = [place for place, family in enumerate(families) if family.family == RAW]
    fixed, fid = (
        _sweep(task, families, raw, name=name, adding=adding) for name in (FIXED, FID)
    )
    if not raw or not fixed:
        return None
    swept = {*fixed, *fid}
    judged = [
        place
        for place, family in enumerate(families)
        if family.is_added and adding in family.rules and place not in swept
    ]
    wanted = {
        (plugin.name, plugin.level): Family(plugin.name, plugin.family, plugin.adding)
        for plugin in plugins.parse_all("mechanisms", PRESETS[preset].mechanisms)
    }
    others = [place for place in judged if levels[place] in wanted]
    lacks = [] if fid else ["a sweep of fid"]
    lacks += [
        where_text(*where)
        for where, family in wanted.items()
        if family.is_added
        and adding in family.rules
        and family.family not in (FID, FIXED)
        and where not in levels
    ]
    missing = ""
    if lacks:
        missing = f"the run lacks {', '.join(lacks)} of the panel"
    elif not others:
        missing = "the panel has no dissociation control"
    return Panel(
        task=task,
        adding=adding,
        families=tuple(family.family for family in families),
        fixed=fixed,
        fid=fid,
        others=others,
        beside=[place for place in judged if place not in others],
        missing=missing,
    )


def _sweep(
    task: TaskSums,
    families: Sequence[Family],
    raw: list[int],
    *,
    name: str,
    adding: str,
) -> list[int]:
    """Return the places of a family's levels, noisiest first, then raw; or none."""
    places = [
        place
        for place, family in enumerate(families)
        if (family.family, family.adding, family.parameters) == (name, adding, "")
    ]
    places.sort(
        key=lambda place: task.levels[place].level or 0.0, reverse=name == FIXED
    )
    return places + raw if len(places) >= FEWEST_LEVELS else []


def drawn_weights(
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


def contrasts(
    sums: Sums,
    rates: Rates,
    panel: Panel,
    *,
    others: Sequence[int],
    fid: Sequence[int] = (),
) -> Contrasts:
    """Return the contrasts of FID at quartiles and of others with fixed noise.

    `rates` are `Sums.drawn` of all levels.
    """
    fixed = panel.fixed
    compared = _compared_levels(rates, fixed, others=list(others), fid=list(fid))
    beside_fixed = spread.beside_fixed(
        compared.descriptor,
        compared.success,
        (rates.descriptor[:, fixed], rates.success[:, fixed]),
    )
    gaps, side = beside_fixed.gaps, beside_fixed.side
    n_drawn = 1 + N_REPLICATES
    # Too few replicates show nothing, such as when no person with a value was drawn.
    has_gap = np.isfinite(gaps[0]) & (
        np.isfinite(gaps[:n_drawn]).mean(axis=0) >= MIN_DEFINED
    )
    gaps = _filled(gaps)
    errors = spread.standard_error(gaps[1:n_drawn], gaps[n_drawn:])
    effective, people = sums.sizes
    shares = compared.level_shares
    rests_on = shares > 0
    rests_on[:, fixed] = True
    degrees = np.where(rests_on, effective, np.inf).min(axis=1) - 1.0
    beside = _level_shares(fixed, beside_fixed.places, shares.shape[1])
    discordant = _discordant(sums, shares - beside, raw=fixed[-1])
    # If all people fare the same, replicates have no spread and say nothing of others.
    has_no_spread = errors < rules.NO_SPREAD
    has_no_spread &= discordant[2] >= rules.FEWEST_DISCORDANT
    is_shown = has_gap & (degrees + 1.0 >= LEAST_CLUSTERS) & ~has_no_spread
    is_tested = is_shown & (degrees + 1.0 >= FEWEST_EFFECTIVE)
    whole_range = _whole_range(rates, fixed)
    decides_fid = [True] * (len(side) - len(others))
    decides_others = [not panel.is_hidden(place) for place in others]
    return Contrasts(
        gaps=gaps[:n_drawn],
        errors=np.where(is_shown, errors, np.nan),
        side=np.where(is_tested, side, NEITHER),
        degrees=degrees,
        people=np.where(rests_on, people, people.max()).min(axis=1),
        discordant=discordant,
        decides=np.array(decides_fid + decides_others, dtype=np.bool_),
        fall=whole_range.fall,
        span=whole_range.span,
        fall_error=whole_range.fall_error,
        span_error=whole_range.span_error,
        fall_degrees=float(effective[fixed].min()) - 1.0,
        is_whole=not panel.missing,
    )


def _compared_levels(
    rates: Rates, fixed: Sequence[int], *, others: list[int], fid: list[int]
) -> _Compared:
    """Return FID at the quartiles, if it has a sweep, and then each other level."""
    success, descriptor = rates
    n_levels = descriptor.shape[1]
    compared = _Compared(
        descriptor[:, others], success[:, others], np.eye(n_levels)[others]
    )
    if not fid:
        return compared
    at_fid = spread.at_quartiles(
        descriptor[:, fid], success[:, fid], descriptor[:, fixed]
    )
    fid_shares = _level_shares(fid, at_fid.places, n_levels)
    return _Compared(
        descriptor=np.hstack([at_fid.descriptor, compared.descriptor]),
        success=np.hstack([at_fid.success, compared.success]),
        level_shares=np.vstack([fid_shares, compared.level_shares]),
    )


def _discordant(sums: Sums, shares: Floats, *, raw: int) -> Floats:
    """Return the people linked more and less often than under fixed noise, (3, K).

    The first two rows are shares of people, the third is the number of people in all.
    `shares`, (K, L), are those of the levels of a contrast, less those of fixed noise.
    """
    mass = sums.probes[raw] / sums.probes[raw].sum()
    linked = sums.success / np.maximum(sums.probes, 1.0)
    apart = shares @ linked
    more, fewer = np.maximum(apart, 0.0) @ mass, np.maximum(-apart, 0.0) @ mass
    return np.array([more, fewer, np.abs(apart).sum(axis=1)])


def _whole_range(rates: Rates, fixed: Sequence[int]) -> _WholeRange:
    """Return fall and span of fixed noise, whose rates have a row for each draw."""
    (success, descriptor), least, raw = rates, fixed[0], fixed[-1]
    floor = np.maximum(
        spread.LEAST_SHARE * np.nan_to_num(descriptor[0, raw]), rules.NO_SPREAD
    )
    span = np.log(
        np.maximum(descriptor[:, raw], floor) / np.maximum(descriptor[:, least], floor)
    )
    fall = success[:, raw] - success[:, least]
    drawn, n_drawn = _filled(np.column_stack([fall, span])), 1 + N_REPLICATES
    errors = spread.standard_error(drawn[1:n_drawn], drawn[n_drawn:])
    return _WholeRange(
        fall=drawn[:n_drawn, 0],
        span=drawn[:n_drawn, 1],
        fall_error=float(errors[0]),
        span_error=float(errors[1]),
    )


def _filled(values: Floats) -> Floats:
    """Return values, (R, K), with the estimate, or 0, in place of unknown values."""
    return np.where(np.isfinite(values), values, np.nan_to_num(values[0]))


def _level_shares(
    levels: Sequence[int], position: CurvePositions, n_levels: int
) -> Floats:
    """Return the shares of all levels of a task that a sweep is read from, (K, L)."""
    shares = spread.mixture(position, len(levels))
    all_shares = np.zeros((len(shares), n_levels))
    all_shares[:, levels] = shares
    return all_shares
