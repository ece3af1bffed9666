"""The handover tasks: all pseudonyms rotate at an instant, with a gap or without."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from attacks.tasks.draft import CLOCK_S, Draft
from attacks.tasks.sessions import N_FOLDS, Sessions, Windows
from attacks.tasks.task_list import TASKS
from isac_track.config import LinkageSettings
from isac_track.errors import DataError
from isac_track.types import Bools, Floats, Ints


def handover(draft: Draft) -> Sessions:
    """Return windows before and after each instant at which all pseudonyms rotate.

    Some people come or go meanwhile. Raises DataError if too few people or too few
    rotations remain.
    """
    tracks, settings, gap_s = draft.tracks, draft.settings.linkage, draft.task.gap_s
    # The same instants whatever the gap, so that the gaps can be compared.
    first_s, last_s = float(tracks.t.min()), float(tracks.t.max())
    at_s = rotation_times(first_s, last_s, settings=settings)
    before, after = _presence(draft, at_s)
    # At other instants nobody can be linked: they have no search.
    linkable = np.flatnonzero((before & after).any(axis=1))
    n_lasting = int((before | after)[linkable].any(axis=0).sum())
    drawn = np.intersect1d(linkable, _draw_instants(draft, at_s, longest_gap_s()))
    present = (before | after)[drawn]
    rows = np.flatnonzero(present.any(axis=0))
    draft.require_people(rows.size, "people are there when pseudonyms rotate")
    if drawn.size < N_FOLDS:
        raise DataError(
            f"task {draft.task.name}: {drawn.size} rotations of pseudonyms have people"
            f" to link, but {N_FOLDS} are needed; use a longer recording or a shorter"
            " linkage.handover_period_s"
        )
    # By the time since the recording began: an instant has the same draws whatever the
    # clock says.
    labels = [f"{since_s:g} s" for since_s in at_s[drawn] - float(tracks.t.min())]
    window_s = settings.handover_window_s
    windows = partial(
        _rotation_windows,
        draft,
        drawn=drawn,
        at_s=at_s[drawn],
        rows=rows,
        labels=labels,
    )
    probe = windows("probe", before, since_s=-window_s, until_s=0.0)
    gallery = windows("gallery", after, since_s=gap_s, until_s=gap_s + window_s)
    gallery_row = np.full((drawn.size, rows.size), -1)
    gallery_row[gallery.search, gallery.person] = np.arange(len(gallery))
    fold = (np.arange(drawn.size) * N_FOLDS) // drawn.size
    group = tuple(tracks.group[row] for row in rows)
    return draft.sessions(
        rows,
        group=group,
        may_teach=seen_in_other_half(present[:, rows], fold=fold, group=group),
        probe=probe,
        gallery=gallery,
        mate=gallery_row[probe.search, probe.person],
        fold=fold,
        searches=tuple(labels),
        too_short=len(tracks) - n_lasting,
        not_drawn=n_lasting - rows.size,
    )


def _rotation_windows(
    draft: Draft,
    side: str,
    present: Bools,
    *,
    drawn: Ints,
    at_s: Floats,
    rows: Ints,
    labels: Sequence[str],
    since_s: float,
    until_s: float,
) -> Windows:
    """Return one side of every rotation, the walks of each in an order of its own.

    `present`, (S, N), tells the tracks at each instant. `drawn` are the numbers of the
    instants, `at_s` their times. Windows last from `since_s` to `until_s` after them.
    """
    # By number among all instants: an instant has the same draws whatever the gap.
    order = [
        draft.rng("order", side, number).permutation(np.flatnonzero(present[number]))
        for number in drawn.tolist()
    ]
    row = np.concatenate(order)
    search = np.repeat(np.arange(drawn.size), [part.size for part in order])
    keys = [labels[number] for number in search.tolist()]
    start_s, end_s = at_s[search] + since_s, at_s[search] + until_s
    stretches = draft.cut(side, row, start_s, end_s, keys)
    return stretches.windows(np.searchsorted(rows, row), search)


def longest_gap_s() -> float:
    """Return the longest silence of all tasks: they have the same instants."""
    return max(task.gap_s for task in TASKS.values())


def rotation_times(
    first_s: float, last_s: float, *, settings: LinkageSettings
) -> Floats:
    """Return all instants at which pseudonyms rotate, (S,) s, evenly spaced."""
    lasting_s = last_s - first_s - longest_gap_s() - settings.handover_least_s
    count = int(lasting_s / settings.handover_period_s)
    every_s = settings.handover_period_s * max(1.0, count / settings.handover_instants)
    n_instants = min(count, settings.handover_instants)
    return np.asarray(first_s + every_s * np.arange(1.0, n_instants + 1))


def _presence(draft: Draft, at_s: Floats) -> tuple[Bools, Bools]:
    """Return the tracks present before each rotation, and after its gap, (S, N)."""
    least_s = draft.settings.linkage.handover_least_s
    ends_s, begins_s = at_s[:, None], at_s[:, None] + draft.task.gap_s
    began_s, left_s = draft.start_s - CLOCK_S, draft.end_s + CLOCK_S
    before = (began_s <= ends_s - least_s) & (left_s >= ends_s)
    after = (began_s <= begins_s) & (left_s >= begins_s + least_s)
    return before, after


def seen_in_other_half(present: Bools, *, fold: Ints, group: tuple[str, ...]) -> Bools:
    """Return the people from whom the adversary of either half may learn, (2, K).

    They, and all people who walk with them, are present in the other half only.
    `present`, (S, K), tells the people at each rotation, `fold`, (S,), its half.
    """
    cluster = np.unique(group, return_inverse=True)[1]
    seen = np.stack([present[fold == half].any(axis=0) for half in range(N_FOLDS)])
    company_seen = np.stack([np.bincount(cluster, half) > 0 for half in seen])
    return np.asarray(seen[::-1] & ~company_seen[:, cluster])


def _draw_instants(draft: Draft, at_s: Floats, gap_s: float) -> Ints:
    """Return the instants to use: all, or as many as `linkage.most_people` allows."""
    began_s, left_s = draft.start_s - CLOCK_S, draft.end_s + CLOCK_S
    present = (began_s <= at_s[:, None] + gap_s) & (left_s >= at_s[:, None])
    drawn = draft.rng("instants").permutation(at_s.size)
    n_people = np.logical_or.accumulate(present[drawn], axis=0).sum(axis=1)
    few = int((n_people <= draft.settings.linkage.most_people).sum())
    return np.sort(drawn[: max(few, N_FOLDS)])
