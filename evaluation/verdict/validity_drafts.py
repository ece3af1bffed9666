"""Drafts of validity: the numbers of every descriptor and task, before any decision.

A draft holds the contrasts of a descriptor in a task. Beside each draft stands a
positive control: its descriptor is the linkage of the other half of the people.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.estimates.families import ADDING_RULES, Family
from evaluation.estimates.linked_people import TaskSums
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.verdict.contrasts import (
    Contrasts,
    Rates,
    Sums,
    build_contrasts,
    draw_weights,
)
from evaluation.verdict.panel import Panel, build_panel
from evaluation.verdict.prediction_error import (
    WHITE_FAMILIES,
    DescriptorErrors,
    prediction_errors,
)
from isac_track.rng import stream

# Descriptors that rise with noise, as PLR, AEL and MEL fall.
RISING_WITH_NOISE: Final = ("alignment_error", "posterior_std")
_N_FOR_ERRORS: Final = 200  # Replicates of a prediction error.


@dataclass(frozen=True, eq=False, slots=True)
class ValidityDraft:
    """A descriptor in a task under an adding rule, before its section is decided."""

    panel: Panel
    descriptor: str
    contrasts: Contrasts
    beside: Contrasts | None  # Of mechanisms outside the panel, if any.
    errors: DescriptorErrors | None

    @property
    def n(self) -> int:
        """Clusters, the least over all contrasts."""
        return fewest_clusters(self.contrasts)


@dataclass(frozen=True, eq=False, slots=True)
class PanelDrafts:
    """All drafts of a task under an adding rule."""

    panel: Panel
    drafts: tuple[ValidityDraft, ...]  # Of PLR, AEL and MEL.
    control: Contrasts  # Linkage of the other half of the people as the descriptor.
    # Of all descriptors of the linked windows, by name.
    errors: Mapping[str, DescriptorErrors | None]


def fewest_clusters(contrasts: Contrasts) -> int:
    """Return the least number of clusters behind any of the contrasts."""
    return int(min(contrasts.people, default=0))


def draft_validity(
    tasks: Sequence[TaskSums],
    *,
    families: Mapping[str, Family],
    preset: str,
    dataset: str,
    seed: int,
) -> Iterator[PanelDrafts]:
    """Yield the drafts of every task and adding rule that has a panel.

    `families` are by mechanism.
    """
    for task in tasks:
        weights = draw_weights(task, tasks, dataset, seed)
        sums = {name: _sums(task, name) for name in task.levels[0].descriptors}
        rates = {name: own.rates(weights) for name, own in sums.items()}
        half = _other_half(task, next(iter(sums.values())), seed)
        for adding in ADDING_RULES:
            panel = build_panel(task, families, adding=adding, preset=preset)
            if panel is None:
                continue
            errors = {name: _errors(panel, name, rates[name]) for name in rates}
            drafts = [
                _draft(panel, name, sums[name], rates[name], errors=errors[name])
                for name in DESCRIPTORS
                if name in sums
            ]
            control = build_contrasts(
                half, half.rates(weights), panel, others=panel.others, fid=panel.fid
            )
            yield PanelDrafts(panel, tuple(drafts), control, errors)


def _draft(
    panel: Panel,
    name: str,
    sums: Sums,
    rates: Rates,
    *,
    errors: DescriptorErrors | None,
) -> ValidityDraft:
    """Return a descriptor with its contrasts, those beside the panel included."""
    own = build_contrasts(sums, rates, panel, others=panel.others, fid=panel.fid)
    beside = None
    if panel.beside:
        beside = build_contrasts(sums, rates, panel, others=panel.beside)
    return ValidityDraft(panel, name, own, beside, errors)


def _sums(task: TaskSums, name: str) -> Sums:
    """Return linkage and a descriptor of a task, by cluster."""
    values, windows = (
        np.array([level.descriptors[name][part] for level in task.levels])
        for part in (0, 1)
    )
    return Sums(
        success=np.array([level.success for level in task.levels]),
        probes=np.array([level.probes for level in task.levels]),
        values=values,
        windows=windows,
    )


def _other_half(task: TaskSums, sums: Sums, seed: int) -> Sums:
    """Return a half of the people, with the other half's linkage as its descriptor."""
    order = stream(seed, "halves", task.task).permutation(len(task.clusters))
    is_first = order < len(task.clusters) / 2
    return Sums(
        success=sums.success * is_first,
        probes=sums.probes * is_first,
        values=sums.success * ~is_first,
        windows=sums.probes * ~is_first,
    )


def _errors(panel: Panel, name: str, rates: Rates) -> DescriptorErrors | None:
    """Return the squared prediction error of a descriptor, and that of none."""
    levels = [*panel.fixed, *panel.fid[:-1], *panel.others]
    success = rates.success[: 1 + _N_FOR_ERRORS, levels]
    descriptor = rates.descriptor[: 1 + _N_FOR_ERRORS, levels]
    families = [panel.family_names[place] for place in levels]
    kinds = ["white" if family in WHITE_FAMILIES else family for family in families]
    return prediction_errors(
        -descriptor if name in RISING_WITH_NOISE else descriptor, success, kinds
    )
