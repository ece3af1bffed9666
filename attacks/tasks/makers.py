"""The sessions of each task: of a closed set, where everybody is in both, and of handovers.

Each raises `DataError` if too few tracks are long enough, or too few people there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from attacks.tasks.build import Draft, rows_of
from attacks.tasks.sessions import N_FOLDS, Sessions, Windows, halves, joined
from attacks.tasks.task_list import TASKS
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.random import Generator

    from isac_track.types import Bools, Floats, Ints


def rerelease(draft: Draft) -> Sessions:
    """Return two windows of each walk, which may overlap: the same walk is shared twice."""
    length_s = draft.settings.linkage.window_s

    def starts_s(row: int, rng: Generator) -> Floats:
        slack_s = max(float(draft.end_s[row] - draft.start_s[row]) - length_s, 0.0)
        reach_s = min(slack_s, draft.settings.linkage.rerelease_shift_s)
        base_s = draft.start_s[row] + rng.uniform(0.0, slack_s - reach_s)
        starts: Floats = base_s + rng.uniform(0.0, reach_s, 2)
        return starts

    what = f"of {len(draft.tracks)} tracks last {length_s:g} s"
    return _closed(draft, draft.lasting(length_s), what, starts_s=starts_s, length_s=length_s)


def split(draft: Draft) -> Sessions:
    """Return two windows of each walk with a gap between them."""
    length_s, gap_s = draft.settings.linkage.split_window_s, draft.settings.linkage.split_gap_s
    needed_s = 2.0 * length_s + gap_s

    def starts_s(row: int, rng: Generator) -> tuple[float, float]:
        start_s = float(draft.start_s[row])
        slack_s = max(float(draft.end_s[row]) - start_s - needed_s, 0.0)
        first_s, second_s = np.sort(rng.uniform(0.0, slack_s, 2)).tolist()
        return start_s + first_s, start_s + length_s + gap_s + second_s

    what = f"of {len(draft.tracks)} tracks last {needed_s:g} s"
    return _closed(draft, draft.lasting(needed_s), what, starts_s=starts_s, length_s=length_s)


def new_traversal(draft: Draft) -> Sessions:
    """Return a window of each person's walk in either session of a crowd."""
    assert draft.later is not None
    length_s, later = draft.settings.linkage.window_s, replace(draft, tracks=draft.later)
    source = draft.tracks.source
    row_later = {draft.later.source[row]: row for row in later.lasting(length_s)}
    # Who stays at home on the second day is left out.
    both = [row for row in draft.lasting(length_s) if source[row] in row_later]

    def starts_s(row: int, rng: Generator) -> list[float]:
        starts = []
        for day, place in ((draft, row), (later, row_later[source[row]])):
            slack_s = float(day.end_s[place] - day.start_s[place]) - length_s
            starts.append(day.start_s[place] + rng.uniform(0.0, max(slack_s, 0.0)))
        return starts

    what = f"people walk for {length_s:g} s in both sessions"
    long = np.array(both, dtype=np.int64)
    return _closed(draft, long, what, starts_s=starts_s, length_s=length_s)


def _closed(
    draft: Draft,
    long: Ints,
    what: str,
    *,
    starts_s: Callable[[int, Generator], Floats | Sequence[float]],
    length_s: float,
) -> Sessions:
    """Return sessions in which everybody is in both: one search for each half of the people."""
    tracks = draft.tracks
    later = draft if draft.later is None else replace(draft, tracks=draft.later)
    rows = draft.chosen(long, what)
    source = [tracks.source[row] for row in rows]
    rows_later = rows_of(later.tracks, source)
    starts = np.array(
        [starts_s(row, draft.rng("windows", name)) for row, name in zip(rows, source, strict=True)]
    )
    group = joined(
        [tracks.group[row] for row in rows], [later.tracks.group[row] for row in rows_later]
    )
    fold_of = halves(group, rng=draft.rng("folds"))

    def windows(side: str, day: Draft, track: Ints, start_s: Floats, person: Ints) -> Windows:
        cut = day.windows(
            side,
            track[person],
            start_s=start_s[person],
            length_s=length_s,
            person=person,
            search=fold_of[person],
        )
        # Put where somebody, anybody, once was.
        sizes = np.diff(cut.offsets)
        middle_m = np.add.reduceat(cut.xy, cut.offsets[:-1]) / sizes[:, None]
        draws = [draft.rng("place", side, source[one]).random() for one in person]
        there_m = day.tracks.xy[(np.array(draws) * day.tracks.t.size).astype(np.int64)]
        return replace(cut, xy=cut.xy + np.repeat(there_m - middle_m, sizes, axis=0))

    # In an order of its own, lest a place in the list tell who is who.
    order = draft.rng("order").permutation(rows.size)
    return draft.sessions(
        rows,
        group=group,
        may_teach=np.stack([fold_of == 1, fold_of == 0]),
        probe=windows("probe", draft, rows, starts[:, 0], np.arange(rows.size)),
        gallery=windows("gallery", later, rows_later, starts[:, 1], order),
        mate=np.argsort(order),
        fold=np.arange(N_FOLDS),
        searches=("half 1", "half 2"),
        too_short=len(tracks) - long.size,
        not_drawn=long.size - rows.size,
    )


def handover(draft: Draft) -> Sessions:
    """Return windows before and after each instant at which every pseudonym rotates at once.

    Some people come or go meanwhile. Too few instants are refused, too.
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
