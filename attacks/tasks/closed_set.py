"""Tasks in which everybody is in both releases: a closed set."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from attacks.tasks.draft import CLOCK_S, elsewhere, windows_of
from attacks.tasks.roles import alone, halves, joined, roles
from attacks.tasks.sessions import N_FOLDS, Sessions
from isac_track.datasets.summary import summarise

if TYPE_CHECKING:
    from attacks.tasks.draft import Draft
    from isac_track.types import Floats, Ints


def rerelease(draft: Draft) -> Sessions:
    """Return two windows of each walk, which may overlap: the same walk is shared twice.

    Raises
    ------
    DataError
        If too few tracks are long enough.
    """
    length_s = draft.settings.linkage.window_s
    shift_s = draft.settings.linkage.rerelease_shift_s
    long = draft.lasting(length_s)
    rows = draft.chosen(long, f"of {len(draft.tracks)} tracks last {length_s:g} s")
    starts = np.empty((2, rows.size))
    for place, row in enumerate(rows):
        rng = draft.rng("windows", draft.tracks.source[row])
        slack_s = max(float(draft.end_s[row] - draft.start_s[row]) - length_s, 0.0)
        reach_s = min(slack_s, shift_s)
        base_s = draft.start_s[row] + rng.uniform(0.0, slack_s - reach_s)
        starts[:, place] = base_s + rng.uniform(0.0, reach_s, 2)
    return _closed(draft, rows=rows, starts=starts, length_s=length_s, n_long=long.size)


def split(draft: Draft) -> Sessions:
    """Return two windows of each walk with a gap between them.

    Raises
    ------
    DataError
        If too few tracks are long enough.
    """
    length_s, gap_s = draft.settings.linkage.split_window_s, draft.settings.linkage.split_gap_s
    needed_s = 2.0 * length_s + gap_s
    long = draft.lasting(needed_s)
    rows = draft.chosen(long, f"of {len(draft.tracks)} tracks last {needed_s:g} s")
    starts = np.empty((2, rows.size))
    for place, row in enumerate(rows):
        rng = draft.rng("windows", draft.tracks.source[row])
        slack_s = max(float(draft.end_s[row] - draft.start_s[row]) - needed_s, 0.0)
        first_s, second_s = np.sort(rng.uniform(0.0, slack_s, 2))
        starts[:, place] = (
            draft.start_s[row] + first_s,
            (draft.start_s[row] + length_s + gap_s + second_s),
        )
    return _closed(draft, rows=rows, starts=starts, length_s=length_s, n_long=long.size)


def new_traversal(draft: Draft) -> Sessions:
    """Return a window of each person's walk in either session of a crowd.

    Raises
    ------
    DataError
        If too few people walk for long enough in both.
    """
    assert draft.later is not None
    length_s, later = draft.settings.linkage.window_s, draft.later
    row_later = {source: row for row, source in enumerate(later.source)}
    lasts_s = later.t[later.offsets[1:] - 1] - later.t[later.offsets[:-1]]
    both = [
        row
        for row in draft.lasting(length_s)
        if draft.tracks.source[row] in row_later  # who stays at home on the second day is left out
        and lasts_s[row_later[draft.tracks.source[row]]] >= length_s - CLOCK_S
    ]
    rows = draft.chosen(
        np.array(both, dtype=np.int64), f"people walk for {length_s:g} s in both sessions"
    )
    rows_later = np.array([row_later[draft.tracks.source[row]] for row in rows])
    starts = np.empty((2, rows.size))
    for place, row in enumerate(rows):
        rng = draft.rng("windows", draft.tracks.source[row])
        slack_s = float(draft.end_s[row] - draft.start_s[row]) - length_s
        slack_later_s = float(lasts_s[rows_later[place]]) - length_s
        start_later_s = later.t[later.offsets[rows_later[place]]]
        starts[0, place] = draft.start_s[row] + rng.uniform(0.0, max(slack_s, 0.0))
        starts[1, place] = start_later_s + rng.uniform(0.0, max(slack_later_s, 0.0))
    return _closed(
        draft,
        rows=rows,
        starts=starts,
        length_s=length_s,
        n_long=len(both),
        rows_later=rows_later,
    )


def _closed(
    draft: Draft,
    *,
    rows: Ints,
    starts: Floats,
    length_s: float,
    n_long: int,
    rows_later: Ints | None = None,
) -> Sessions:
    """Return sessions in which everybody is in both: one search for each half of the people."""
    tracks, later = draft.tracks, draft.tracks if draft.later is None else draft.later
    rows_later = rows if rows_later is None else rows_later
    source = tuple(tracks.source[row] for row in rows)
    group = joined([tracks.group[row] for row in rows], [later.group[row] for row in rows_later])
    fold_of = halves(group, rng=draft.rng("folds"))
    cut = partial(windows_of, draft, length_s=length_s)
    everybody = np.arange(rows.size)
    probe = cut("probe", tracks, rows=rows, start_s=starts[0], person=everybody, search=fold_of)
    # In an order of its own, lest a place in the list tell who is who.
    order = draft.rng("order").permutation(rows.size)
    probe = elsewhere(draft, "probe", tracks, probe, source)
    gallery = cut(
        "gallery",
        later,
        rows=rows_later[order],
        start_s=starts[1][order],
        person=order,
        search=fold_of[order],
    )
    gallery = elsewhere(draft, "gallery", later, gallery, source)
    learns, calibrates = roles(
        group, may_teach=np.stack([fold_of == 1, fold_of == 0]), rng=draft.rng("roles")
    )
    return Sessions(
        task=draft.task,
        source=source,
        group=group,
        alone=alone(tracks, rows) & alone(later, rows_later),
        moving=~(
            summarise(tracks).frozen.to_numpy()[rows]
            | summarise(later).frozen.to_numpy()[rows_later]
        ),
        probe=probe,
        gallery=gallery,
        mate=np.argsort(order),
        fold=np.arange(N_FOLDS),
        searches=("half 1", "half 2"),
        learns=learns,
        calibrates=calibrates,
        too_short=len(tracks) - n_long,
        not_drawn=n_long - rows.size,
    )
