"""The task in which every pseudonym rotates at once, and some people come or go meanwhile."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from attacks.tasks.sessions import N_FOLDS
from attacks.tasks.task_list import TASKS
from isac_track.errors import DataError

if TYPE_CHECKING:
    from attacks.tasks.build import Draft
    from attacks.tasks.sessions import Sessions, Windows
    from isac_track.types import Bools


def handover(draft: Draft) -> Sessions:
    """Return windows before and after each instant at which pseudonyms rotate.

    It raises `DataError` if too few people are there then, or there are too few instants.
    """
    tracks, settings, gap_s = draft.tracks, draft.settings.linkage, draft.task.gap_s
    least_s, window_s = settings.handover_least_s, settings.handover_window_s
    # The same instants whatever the gap, so that the gaps can be compared.
    longest_gap_s = max(task.gap_s for task in TASKS.values())
    first_s, last_s = float(tracks.t.min()), float(tracks.t.max())
    count = int((last_s - first_s - longest_gap_s - least_s) / settings.handover_period_s)
    every_s = settings.handover_period_s * max(1.0, count / settings.handover_instants)
    at_s = first_s + every_s * np.arange(1.0, min(count, settings.handover_instants) + 1)
    # Which tracks are there until then, and after the gap, (S, N).
    from_s, until_s = at_s[:, None], at_s[:, None] + gap_s
    before = (draft.start_s <= from_s - least_s) & (draft.end_s >= from_s)
    after = (draft.start_s <= until_s) & (draft.end_s >= until_s + least_s)
    # Where nobody is to be linked there is nothing to search.
    used = np.flatnonzero((before & after).any(axis=1))
    there = (before | after)[used]
    rows = np.flatnonzero(there.any(axis=0))
    draft.need_people(rows.size, "people are there when pseudonyms rotate")
    if used.size < N_FOLDS:
        raise DataError(
            f"task {draft.task.name}: pseudonyms rotate {used.size} times with somebody to link, "
            "but it takes 2; use a longer recording or a shorter linkage.handover_period_s"
        )
    labels = [f"{at:g} s" for at in at_s[used]]

    def windows(side: str, present: Bools) -> Windows:
        """Return those of one side of every rotation, those of each in an order of its own."""
        # By number among all instants: whatever the gap, the same instant has the same draws.
        order = [
            draft.rng("order", side, n).permutation(np.flatnonzero(present[n]))
            for n in used.tolist()
        ]
        row = np.concatenate(order)
        search = np.repeat(np.arange(used.size), [part.size for part in order])
        rotates_s = at_s[used][search]
        if side == "probe":
            start_s, end_s = np.maximum(draft.start_s[row], rotates_s - window_s), rotates_s
        else:
            start_s = rotates_s + gap_s
            end_s = np.minimum(draft.end_s[row], start_s + window_s)
        return draft.windows(
            side,
            row,
            start_s=start_s,
            length_s=end_s - start_s,
            person=np.searchsorted(rows, row),
            search=search,
            keys=[labels[n] for n in search],
        )

    probe, gallery = windows("probe", before), windows("gallery", after)
    place = np.full((used.size, rows.size), -1)
    place[gallery.search, gallery.person] = np.arange(len(gallery))
    fold = (np.arange(used.size) * N_FOLDS) // used.size
    # Whoever is seen in the other half alone may teach, company included.
    group = tuple(tracks.group[row] for row in rows)
    cluster = np.unique(group, return_inverse=True)[1]
    seen = np.stack([there[fold == half][:, rows].any(axis=0) for half in range(N_FOLDS)])
    company = np.stack([np.bincount(cluster, one) > 0 for one in seen])[:, cluster]
    return draft.sessions(
        rows,
        group=group,
        may_teach=seen[::-1] & ~company,
        probe=probe,
        gallery=gallery,
        mate=place[probe.search, probe.person],
        fold=fold,
        searches=tuple(labels),
        too_short=len(tracks) - rows.size,
        not_drawn=0,
    )
