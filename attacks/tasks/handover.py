"""The task in which every pseudonym rotates at once, and some people come or go meanwhile."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from attacks.tasks.sessions import N_FOLDS
from attacks.tasks.task_list import TASKS
from isac_track.errors import DataError

if TYPE_CHECKING:
    from attacks.tasks.draft import Draft
    from attacks.tasks.sessions import Sessions, Windows
    from isac_track.types import Ints


class _Rotation(NamedTuple):
    """An instant at which somebody is there to be linked."""

    number: int
    """Among all instants: whatever the gap, the same instant has the same draws."""
    at_s: float
    before: Ints
    """Tracks that are there until then."""
    after: Ints
    """Tracks that are there after the gap."""


def handover(draft: Draft) -> Sessions:
    """Return windows before and after each instant at which pseudonyms rotate.

    Raises
    ------
    DataError
        If too few people are there at these instants, or there are too few instants.
    """
    rotations = _rotations(draft)
    there = [rows for one in rotations for rows in (one.before, one.after)]
    rows = np.unique(np.concatenate([*there, np.zeros(0, dtype=np.int64)]))
    draft.need_people(rows.size, "people are there when pseudonyms rotate")
    if len(rotations) < N_FOLDS:
        raise DataError(
            f"task {draft.task.name}: pseudonyms rotate {len(rotations)} times with somebody to "
            "link, but it takes 2; use a longer recording or a shorter linkage.handover_period_s"
        )
    probe, gallery = (_side(draft, side, rotations, rows=rows) for side in ("probe", "gallery"))
    fold = (np.arange(len(rotations)) * N_FOLDS) // len(rotations)
    # Whoever is seen in the other half alone may teach, company included.
    group = tuple(draft.tracks.group[row] for row in rows)
    cluster = np.unique(group, return_inverse=True)[1]
    seen = np.zeros((N_FOLDS, rows.size), dtype=bool)
    for side in (probe, gallery):
        seen[fold[side.search], side.person] = True
    company = np.stack([np.bincount(cluster, one) > 0 for one in seen])[:, cluster]
    place = {key: row for row, key in enumerate(_keys(gallery))}
    return draft.sessions(
        rows,
        group=group,
        may_teach=seen[::-1] & ~company,
        probe=probe,
        gallery=gallery,
        mate=np.array([place.get(key, -1) for key in _keys(probe)]),
        fold=fold,
        searches=tuple(f"{one.at_s:g} s" for one in rotations),
        too_short=len(draft.tracks) - rows.size,
        not_drawn=0,
    )


def _rotations(draft: Draft) -> list[_Rotation]:
    settings, gap_s = draft.settings.linkage, draft.task.gap_s
    least_s, period_s = settings.handover_least_s, settings.handover_period_s
    # The same instants whatever the gap, so that the gaps can be compared.
    longest_gap_s = max(task.gap_s for task in TASKS.values())
    first_s, last_s = float(draft.tracks.t.min()), float(draft.tracks.t.max())
    count = int((last_s - first_s - longest_gap_s - least_s) / period_s)
    every_s = period_s * max(1.0, count / settings.handover_instants)
    start_s, end_s = draft.start_s, draft.end_s
    rotations = []
    for number in range(min(count, settings.handover_instants)):
        at_s = first_s + every_s * (number + 1)
        before = np.flatnonzero((start_s <= at_s - least_s) & (end_s >= at_s))
        after = np.flatnonzero((start_s <= at_s + gap_s) & (end_s >= at_s + gap_s + least_s))
        # Where nobody is to be linked there is nothing to search.
        if np.intersect1d(before, after).size:
            rotations.append(_Rotation(number, at_s, before, after))
    return rotations


def _side(draft: Draft, side: str, rotations: list[_Rotation], *, rows: Ints) -> Windows:
    """Return the windows on one side of every rotation, those of each in an order of its own."""
    window_s = draft.settings.linkage.handover_window_s
    order = [
        draft.rng("order", side, one.number).permutation(
            one.before if side == "probe" else one.after
        )
        for one in rotations
    ]
    row = np.concatenate(order)
    search = np.repeat(np.arange(len(order)), [part.size for part in order])
    at_s = np.array([one.at_s for one in rotations])[search]
    if side == "probe":
        start_s, end_s = np.maximum(draft.start_s[row], at_s - window_s), at_s
    else:
        start_s = at_s + draft.task.gap_s
        end_s = np.minimum(draft.end_s[row], start_s + window_s)
    return draft.windows(
        side,
        row,
        start_s=start_s,
        length_s=end_s - start_s,
        person=np.searchsorted(rows, row),
        search=search,
        keys=[f"{rotations[n].at_s:g} s" for n in search],
    )


def _keys(windows: Windows) -> list[tuple[int, int]]:
    """Return the search and the person of each window."""
    return list(zip(windows.search.tolist(), windows.person.tolist(), strict=True))
