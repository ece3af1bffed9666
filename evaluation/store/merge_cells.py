"""Cells in the manifest of a run: those of a plan, merged with those of earlier runs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from evaluation.compute.return_columns import CLEAN
from evaluation.plan.consumer import TRACK_KINDS
from evaluation.plan.settings import patrol_values, tracking_values
from evaluation.store.cell_index import CellKey
from evaluation.store.entries import Entry, entries_without, make_entry
from evaluation.store.new_files import group_units

if TYPE_CHECKING:
    from evaluation.plan.plan import Plan
    from evaluation.plan.units import Unit
    from evaluation.store.cell_index import FileIndex


def cell_entries(
    plan: Plan, finished: Mapping[CellKey, str], missing: Iterable[Unit]
) -> list[Entry]:
    """Return the entries of a run's cells, whose files are `finished` or to come."""
    files_by_cell = {
        CellKey(unit.key, key): file.name
        for file in group_units(missing)
        for unit in file.units
        for key in unit.consumers
    } | {**finished}
    files: dict[tuple[str, str], list[str]] = defaultdict(list)
    for unit in plan.units:  # block by block
        for key, consumer in unit.consumers.items():
            files[unit.mechanism.spec, consumer.label].append(
                files_by_cell[CellKey(unit.key, key)]
            )
    return [
        make_entry(mechanism, consumer, files=files[mechanism.spec, consumer.label])
        for mechanism, consumer in plan.mechanism_consumers
    ]


def merged_cells(
    earlier: Iterable[Entry],
    entries: list[Entry],
    *,
    index_by_file: Mapping[str, FileIndex],
) -> list[Entry]:
    """Return the entries of this run's cells, and of finished cells of earlier axes.

    An earlier level that was never finished (interrupted, or a plug-in that failed) is
    left out. `index_by_file` has the index of every file that is there.
    """
    finished = [
        entry
        for entry in earlier
        if all(
            name in index_by_file and index_by_file[name].holds(entry.spec, entry.label)
            for name in entry.files
        )
    ]
    return with_ceiling(entries + entries_without(finished, entries))


def with_ceiling(entries: list[Entry]) -> list[Entry]:
    """Return the entries without linkage attacks that have no ceiling.

    The ceiling decides what an attack without success means; in other worlds an attack
    is compared with the optimum instead.
    """
    ceilings = {entry.address.reader for entry in entries if entry.spec == CLEAN}
    return [
        entry
        for entry in entries
        if entry.kind != "linkage"
        or entry.address.world
        or entry.address.reader in ceilings
    ]


def without_other_settings(manifest: Mapping[str, Any], plan: Plan) -> list[Entry]:
    """Return the entries of a manifest, without patrols of other settings than a plan's.

    Tracks of other settings are left out, too. The files of both stay: with the earlier
    settings a run finds them again.
    """
    earlier = manifest.get("settings", {}).get("stages", {})
    ours = plan.settings.stages.flat()
    is_same = patrol_values(earlier) == patrol_values(ours)
    same_tracks = is_same and tracking_values(earlier) == tracking_values(ours)
    return [
        entry
        for entry in manifest["cells"]
        if not entry.address.policy
        or (same_tracks if entry.kind in TRACK_KINDS else is_same)
    ]


def merged_plugins(
    earlier: Mapping[str, Sequence[str]], ours: Mapping[str, Sequence[str]]
) -> dict[str, list[str]]:
    """Return a user's own plug-ins by axis: earlier, whose cells stay, and new."""
    return {
        axis: [*dict.fromkeys([*earlier.get(axis, ()), *ours.get(axis, ())])]
        for axis in dict.fromkeys([*earlier, *ours])
    }
