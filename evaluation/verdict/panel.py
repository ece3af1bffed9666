"""The panel: the mechanisms that are compared with fixed noise at equal descriptor.

The preset fixes it: FID at three places, and every level of its other mechanisms under
an adding rule. Among these must be a *dissociation control*: a mechanism that changes
what a descriptor sees and what a linker uses in different ways. Mechanisms that a user
adds are listed beside the panel and decide nothing.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from attacks.tasks.task_list import TASKS
from evaluation.estimates.families import FID, FIXED, RAW, Family
from evaluation.estimates.keys import where_text
from evaluation.estimates.linked_people import TaskSums
from evaluation.estimates.sweeps import FEWEST_LEVELS
from evaluation.plan.presets import PRESETS
from evaluation.verdict.curves import QUARTER_POINTS
from isac_track import plugins

# It moves a whole walk: an adversary that links in a hidden frame cannot notice.
OFFSET: Final = "offset"


@dataclass(frozen=True, eq=False, slots=True)
class Panel:
    """The levels of a task under an adding rule, as places in `task.levels`."""

    task: TaskSums
    adding: str
    family_names: tuple[str, ...]  # (L,) of all levels
    fixed: list[int]  # From the noisiest to raw, which is the last.
    fid: list[int]  # In the same order; empty without a sweep.
    others: list[int]  # Of the preset.
    beside: list[int]  # Of the user, or added to the preset as protections.
    # Text on missing parts; empty if the panel is whole, with a dissociation control.
    missing: str

    def is_hidden(self, place: int) -> bool:
        """Return whether a level changes only the part that the task hides.

        It then differs by construction.
        """
        task = TASKS.get(self.task.task)
        is_offset = self.family_names[place] == OFFSET
        return is_offset and task is not None and not task.shows_scene

    @property
    def compared(self) -> list[int]:
        """The level of each contrast; of FID the noisiest."""
        return self.fid[:1] * len(QUARTER_POINTS) + self.others


def build_panel(
    task: TaskSums, known: Mapping[str, Family], *, adding: str, preset: str
) -> Panel | None:
    """Return the panel of a task; None without raw or a sweep of fixed noise.

    `known` has the family of each mechanism.
    """
    families = [known[level.mechanism] for level in task.levels]
    raw = [place for place, family in enumerate(families) if family.family == RAW]
    fixed = _sweep(task, families, raw, name=FIXED, adding=adding)
    fid = _sweep(task, families, raw, name=FID, adding=adding)
    if not raw or not fixed:
        return None
    swept = {*fixed, *fid}
    judged = [
        place
        for place, family in enumerate(families)
        if family.is_added and adding in family.rules and place not in swept
    ]
    levels = [(level.mechanism, level.level) for level in task.levels]
    wanted = {
        (plugin.name, plugin.level): Family(plugin.name, plugin.family, plugin.adding)
        for plugin in plugins.parse_all("mechanisms", PRESETS[preset].mechanisms)
    }
    others = [place for place in judged if levels[place] in wanted]
    lacks = [] if fid else ["a sweep of fid"]
    lacks += _lacking_levels(wanted, levels, adding=adding)
    missing = ""
    if lacks:
        missing = f"the run lacks {', '.join(lacks)} of the panel"
    elif all(families[place].protects for place in others):
        missing = "the panel has no dissociation control"
    return Panel(
        task=task,
        adding=adding,
        family_names=tuple(family.family for family in families),
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
    # A larger level of fixed noise is noisier, a larger eta of FID less noisy.
    larger_is_noisier = name == FIXED
    places.sort(
        key=lambda place: task.levels[place].level or 0.0, reverse=larger_is_noisier
    )
    return places + raw if len(places) >= FEWEST_LEVELS else []


def _lacking_levels(
    wanted: Mapping[tuple[str, float | None], Family],
    levels: Collection[tuple[str, float | None]],
    *,
    adding: str,
) -> list[str]:
    """Return the levels of the preset's other mechanisms that a task does not have."""
    return [
        where_text(*where)
        for where, family in wanted.items()
        if family.is_added
        and adding in family.rules
        and family.family not in (FID, FIXED)
        and where not in levels
    ]
