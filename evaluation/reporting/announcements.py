"""What a run says of itself in lines: what can be named, what is to be done, what to know of it.

Nothing heavy is imported: `--list` answers at once.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from evaluation.experiment.presets import PRESETS
from isac_track.config import StageSettings

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from evaluation.experiment.plan import Plan
    from isac_track.plugins import Kind

_MOST_SECONDS = 120
_KINDS: tuple[Kind, ...] = ("mechanisms", "predictors", "attacks")


def listing() -> list[str]:
    """Return all that can be named, by what it is."""
    from attacks.tasks.task_list import TASKS  # noqa: PLC0415 - as the others, when asked for
    from isac_track import plugins  # noqa: PLC0415
    from isac_track.datasets.registry import KNOWN  # noqa: PLC0415

    defaults = StageSettings().flat()
    sections: dict[str, dict[str, str]] = {
        "presets": {name: preset.summary for name, preset in PRESETS.items()},
        "data sets": {name: known.about for name, known in KNOWN.items()},
        **{kind: plugins.names(kind) for kind in _KINDS},
        "tasks": {name: task.about for name, task in TASKS.items()},
        "settings (--set)": {name: f"{value}" for name, value in defaults.items()},
    }
    width = max(len(name) for entries in sections.values() for name in entries)
    lines = []
    for title, entries in sections.items():
        lines += [
            f"{title}:",
            *(f"  {name:<{width}}  {text}" for name, text in entries.items()),
            "",
        ]
    return lines


def broken() -> list[str]:
    """Return discovered plug-ins that cannot be used, and why."""
    from isac_track import plugins  # noqa: PLC0415

    return [
        f"skipped {name}: {wrong}"
        for kind in _KINDS
        for name, wrong in plugins.broken(kind).items()
    ]


def plan_lines(ready: Plan) -> Iterator[str]:
    """Yield what a plan is about to do, what it leaves out, and what slow attacks cost."""
    from evaluation.cells.reconstruction import slow_cost_s  # noqa: PLC0415
    from evaluation.runs.files import CHECKSUMS  # noqa: PLC0415
    from evaluation.runs.folder import usable  # noqa: PLC0415
    from evaluation.runs.pieces import n_finished  # noqa: PLC0415

    # Reading all of them would take seconds here; the run does, and says which are damaged.
    with usable(ready.out):
        finished = n_finished(ready)
    is_continued = finished and not ready.settings.fresh
    so_far = f", {finished} of them finished by {CHECKSUMS}" if is_continued else ""
    if ready.dataset.notice:
        yield f"notice: {ready.dataset.notice}"
    yield (
        f"{ready.dataset.name}: {len(ready.tracks)} of {len(ready.dataset.tracks)} tracks used, "
        f"{ready.settings.n_scenes} scenes; {ready.n_cells} cells{so_far}, in {ready.out}"
    )
    for why in ready.axes.skipped.values():
        yield f"notice: left out: {why}"
    n_levels = len(ready.axes.mechanisms)
    for spec in dict.fromkeys(one.spec for one in ready.axes.consumers if one.is_slow):
        rows = [one for one in ready.axes.consumers if one.is_slow and one.spec == spec]
        cost_s = slow_cost_s(rows, tracks=ready.tracks, n_levels=n_levels)
        about = "it does not say how" if math.isnan(cost_s) else f"about {_duration(cost_s)}"
        yield (
            f"notice: attack {spec} is slow: {about} for {len(rows)} adversaries at {n_levels} "
            "levels in one process; it runs on one release of each source track"
        )


def notices(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Yield what a reader of a finished run must know."""
    for spec, asked in manifest["granted"].items():
        yield f"{spec} asked for {' and '.join(asked)}, which a robot does not have by default"
    for family in manifest["without_rule"]:
        yield (
            f"{family} does not say by `adding` how it adds its error: it is judged under both "
            "rules"
        )
    if manifest["dropped_cells"]:
        yield f"{manifest['dropped_cells']} cells of another code version were dropped"
    if damaged := manifest["damaged_cells"]:
        yield (
            f"{len(damaged)} cells were not as they had been written and are computed anew, "
            f"{damaged[0]} for one"
        )
    if manifest["exhausted_redraws"]:
        yield (
            f"{manifest['exhausted_redraws']} background agents found no place with "
            "scenes.clearance_m and kept their last draw"
        )
    for why in manifest["gallery_without"]:
        yield f"track gallery without {why}"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < _MOST_SECONDS else f"{seconds / 60:.0f} min"
