"""Which mechanisms are compared with fixed noise at equal descriptor value, and how they differ.

The panel is fixed by the preset: FID at three places, and every level of its other
mechanisms under an adding rule. What a user adds is listed beside it. `contrasts` makes
what `spread` decides on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from attacks.tasks.task_list import TASKS
from evaluation.estimates.families import FID, FIXED, RAW, Family
from evaluation.estimates.keys import where_text
from evaluation.estimates.linkability import dataset_of
from evaluation.estimates.linked_people import LinkedTask
from evaluation.estimates.matching import FEWEST_LEVELS, MIN_DEFINED
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
# Moves a whole walk: who links where the frame is hidden cannot notice.
OFFSET: Final = "offset"


@dataclass(frozen=True, eq=False, slots=True)
class Sums:
    """Success and one descriptor at every level of a task, summed by cluster, (L, C) each."""

    success: Floats
    probes: Floats
    values: Floats
    windows: Floats

    def drawn(self, weights: Floats) -> tuple[Floats, Floats]:
        """Return success and descriptor under weights, (R, L) each."""
        success = spread.ratios(self.success, self.probes, weights)
        return success, spread.ratios(self.values, self.windows, weights)

    @property
    def sizes(self) -> tuple[Floats, Ints]:
        """Return the effective clusters of each level and how many they are, (L,) each."""
        both = np.stack([self.probes, self.windows])
        effective = np.apply_along_axis(effective_clusters, 2, both)
        return effective.min(axis=0), (both > 0).sum(axis=2).min(axis=0)


@dataclass(frozen=True, eq=False, slots=True)
class Panel:
    """The levels of a task under an adding rule, as places in `task.levels`."""

    task: LinkedTask
    adding: str
    families: tuple[str, ...]  # (L,) of all levels
    fixed: list[int]  # From the noisiest to raw, which is the last.
    fid: list[int]  # Alike; empty without a sweep.
    others: list[int]  # Of the preset.
    beside: list[int]  # Of the user, or a protection.
    # What the panel lacks; empty if it is whole, with a dissociation control.
    missing: str

    def is_hidden(self, place: int) -> bool:
        """Return whether a level changes only what the task hides: a difference by construction."""
        task = TASKS.get(self.task.task)
        return (
            self.families[place] == OFFSET and task is not None and not task.shows_scene
        )

    @property
    def compared(self) -> list[int]:
        """The level of each contrast; of FID the noisiest."""
        return self.fid[:1] * len(spread.QUARTILES) + self.others


def panel(
    task: LinkedTask, known: Mapping[str, Family], *, adding: str, preset: str
) -> Panel | None:
    """Return the panel of a task; None without raw or a sweep of fixed noise."""
    of = [known[level.mechanism] for level in task.levels]
    wanted = {
        (one.name, one.level): Family(one.name, one.family, one.adding)
        for one in plugins.parse_all("mechanisms", PRESETS[preset].mechanisms)
    }
    raw = [place for place, one in enumerate(of) if one.family == RAW]
    plain: dict[str, list[int]] = {}
    for family in (FIXED, FID):
        alike = family, adding, ""
        same = [
            n
            for n, one in enumerate(of)
            if (one.family, one.adding, one.parameters) == alike
        ]
        same.sort(
            key=lambda place: task.levels[place].level or 0.0, reverse=family == FIXED
        )
        plain[family] = same + raw if len(same) >= FEWEST_LEVELS else []
    if not raw or not plain[FIXED]:
        return None
    swept = {*plain[FIXED], *plain[FID]}
    added = [
        place for place, one in enumerate(of) if one.is_added and adding in one.rules
    ]
    judged = [place for place in added if place not in swept]
    where = [(level.mechanism, level.level) for level in task.levels]
    others = [place for place in judged if where[place] in wanted]
    controls = [
        where_text(name, level)
        for (name, level), one in wanted.items()
        if one.is_added
        and adding in one.rules
        and one.family not in (FID, FIXED)
        and (name, level) not in where
    ]
    lacks = [*(["a sweep of fid"] * (not plain[FID])), *controls]
    missing = f"the run lacks {', '.join(lacks)} of the panel" if lacks else ""
    return Panel(
        task=task,
        adding=adding,
        families=tuple(one.family for one in of),
        fixed=plain[FIXED],
        fid=plain[FID],
        others=others,
        beside=[place for place in judged if place not in others],
        missing=(
            missing if others or missing else "the panel has no dissociation control"
        ),
    )


def drawn_weights(
    task: LinkedTask, every: Sequence[LinkedTask], dataset: str, seed: int
) -> Floats:
    """Return the weights of a task's clusters: all, bootstrap draws, and each left out in turn.

    (1 + B + C, C). People of one recording are drawn alike in all of its tasks.
    """
    own = dataset_of(task.task, dataset=dataset)
    alike = [one for one in every if dataset_of(one.task, dataset=dataset) == own]
    people = sorted({name for one in alike for name in one.clusters})
    place = {name: column for column, name in enumerate(people)}
    counts = cluster_weights(
        n_clusters=len(people), n_replicates=N_REPLICATES, seed=seed, of=("linked", own)
    )
    n = len(task.clusters)
    mine = counts[:, [place[name] for name in task.clusters]]
    return np.concatenate([np.ones((1, n)), mine, 1.0 - np.eye(n)])


def contrasts(
    sums: Sums,
    rates: tuple[Floats, Floats],
    of: Panel,
    *,
    others: Sequence[int],
    fid: Sequence[int] = (),
) -> Contrasts:
    """Return the contrasts of FID at quartiles and of others; `rates` are `Sums.drawn` of all."""
    (success, shows), fixed = rates, of.fixed
    others = list(others)
    at, reached, own = (
        shows[:, others],
        success[:, others],
        np.eye(len(sums.probes))[others],
    )
    if fid:
        swept = list(fid)
        *both, where = spread.at_quartiles(
            shows[:, swept], success[:, swept], shows[:, fixed]
        )
        at, reached = np.hstack([both[0], at]), np.hstack([both[1], reached])
        own = np.vstack([_over(swept, where, own.shape[1]), own])
    gaps, side, where = spread.beside_fixed(
        at, reached, (shows[:, fixed], success[:, fixed])
    )
    n_drawn = 1 + N_REPLICATES
    # Of few replicates nothing is known, say where nobody with a value was drawn.
    is_known = np.isfinite(gaps[0]) & (
        np.isfinite(gaps[:n_drawn]).mean(axis=0) >= MIN_DEFINED
    )
    gaps = _filled(gaps)
    errors = spread.standard_error(gaps[1:n_drawn], gaps[n_drawn:])
    effective, people = sums.sizes
    rests_on = own > 0
    rests_on[:, fixed] = True
    degrees = np.where(rests_on, effective, np.inf).min(axis=1) - 1.0
    mass = sums.probes[fixed[-1]] / sums.probes[fixed[-1]].sum()
    linked = sums.success / np.maximum(sums.probes, 1.0)
    apart = (own - _over(fixed, where, own.shape[1])) @ linked
    more, fewer = np.maximum(apart, 0.0) @ mass, np.maximum(-apart, 0.0) @ mass
    discordant = np.array([more, fewer, np.abs(apart).sum(axis=1)])
    # All people alike: replicates have no spread, and say nothing of others.
    is_still = (errors < rules.NO_SPREAD) & (discordant[2] >= rules.FEWEST_DISCORDANT)
    is_shown = is_known & (degrees + 1.0 >= LEAST_CLUSTERS) & ~is_still
    is_known = is_shown & (degrees + 1.0 >= FEWEST_EFFECTIVE)
    least, raw = fixed[0], fixed[-1]
    floor = np.maximum(
        spread.LEAST_SHARE * np.nan_to_num(shows[0, raw]), rules.NO_SPREAD
    )
    ratio = np.log(
        np.maximum(shows[:, raw], floor) / np.maximum(shows[:, least], floor)
    )
    whole_range = _filled(np.column_stack([success[:, raw] - success[:, least], ratio]))
    fall_error, span_error = spread.standard_error(
        whole_range[1:n_drawn], whole_range[n_drawn:]
    )
    return Contrasts(
        gaps=gaps[:n_drawn],
        errors=np.where(is_shown, errors, np.nan),
        side=np.where(is_known, side, NEITHER),
        degrees=degrees,
        people=np.where(rests_on, people, people.max()).min(axis=1),
        discordant=discordant,
        decides=np.array(
            [True] * (len(side) - len(others))
            + [not of.is_hidden(place) for place in others],
            dtype=np.bool_,
        ),
        fall=whole_range[:n_drawn, 0],
        span=whole_range[:n_drawn, 1],
        fall_error=float(fall_error),
        span_error=float(span_error),
        fall_degrees=float(effective[fixed].min()) - 1.0,
        is_whole=not of.missing,
    )


def _filled(values: Floats) -> Floats:
    """Return values, (R, K), those that are not known being that of the estimate, or 0."""
    return np.where(np.isfinite(values), values, np.nan_to_num(values[0]))


def _over(levels: Sequence[int], where: tuple[Ints, Floats], n_levels: int) -> Floats:
    """Return the shares of all levels of a task that a sweep is read from, (K, L)."""
    shares = spread.mixture(where, len(levels))
    found = np.zeros((len(shares), n_levels))
    found[:, levels] = shares
    return found
