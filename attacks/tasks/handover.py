"""The task in which every pseudonym rotates at once, and some people come or go meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from attacks.tasks.draft import windows_of
from attacks.tasks.roles import alone, roles
from attacks.tasks.sessions import N_FOLDS, Sessions
from attacks.tasks.task_list import TASKS
from isac_track.datasets.summary import summarise
from isac_track.errors import DataError

if TYPE_CHECKING:
    from attacks.tasks.draft import Draft
    from attacks.tasks.sessions import Windows
    from isac_track.types import Bools, Floats, Ints


@dataclass(frozen=True, eq=False, slots=True)
class _Rotations:
    """S instants at which somebody is there to be linked."""

    number: list[int]
    """S, among all instants: whatever the gap, the same instant has the same draws."""
    at_s: Floats
    """(S,)"""
    before: list[Ints]
    """S times the tracks that are there until then."""
    after: list[Ints]
    """S times those that are there after the gap."""

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"{at:g} s" for at in self.at_s)


def handover(draft: Draft) -> Sessions:
    """Return windows before and after each instant at which pseudonyms rotate.

    Raises
    ------
    DataError
        If too few people are there at these instants, or there are too few instants.
    """
    tracks = draft.tracks
    rotations = _rotations(draft)
    rows = np.unique(
        np.concatenate([*rotations.before, *rotations.after, np.zeros(0, dtype=np.int64)])
    )
    draft.need_people(rows.size, "people are there when pseudonyms rotate")
    count = rotations.at_s.size
    if count < N_FOLDS:
        raise DataError(
            f"task {draft.task.name}: pseudonyms rotate {count} times with somebody to link, "
            "but it takes 2; use a longer recording or a shorter linkage.handover_period_s"
        )
    probe, gallery = (_side(draft, side, rotations, rows=rows) for side in ("probe", "gallery"))
    fold = (np.arange(count) * N_FOLDS) // count
    group = tuple(tracks.group[row] for row in rows)
    learns, calibrates = roles(
        group,
        may_teach=_may_teach(group, fold=fold, sides=(probe, gallery)),
        rng=draft.rng("roles"),
    )
    return Sessions(
        task=draft.task,
        source=tuple(tracks.source[row] for row in rows),
        group=group,
        alone=alone(tracks, rows),
        moving=~summarise(tracks).frozen.to_numpy()[rows],
        probe=probe,
        gallery=gallery,
        mate=_mates(probe, gallery),
        fold=fold,
        searches=rotations.labels,
        learns=learns,
        calibrates=calibrates,
        too_short=len(tracks) - rows.size,
        not_drawn=0,
    )


def _rotations(draft: Draft) -> _Rotations:
    settings, gap_s = draft.settings.linkage, draft.task.gap_s
    least_s, period_s = settings.handover_least_s, settings.handover_period_s
    # The same instants whatever the gap, so that the gaps can be compared.
    longest_gap_s = max(task.gap_s for task in TASKS.values())
    first_s, last_s = float(draft.tracks.t.min()), float(draft.tracks.t.max())
    count = int((last_s - first_s - longest_gap_s - least_s) / period_s)
    every_s = period_s * max(1.0, count / settings.handover_instants)
    steps = np.arange(1, min(count, settings.handover_instants) + 1, dtype=np.float64)
    at_s = first_s + every_s * steps
    start_s, end_s = draft.start_s, draft.end_s
    before = [np.flatnonzero((start_s <= at - least_s) & (end_s >= at)) for at in at_s]
    after = [
        np.flatnonzero((start_s <= at + gap_s) & (end_s >= at + gap_s + least_s)) for at in at_s
    ]
    # Where nobody is to be linked there is nothing to search.
    used = [n for n in range(at_s.size) if np.intersect1d(before[n], after[n]).size]
    return _Rotations(
        number=used,
        at_s=at_s[used],
        before=[before[n] for n in used],
        after=[after[n] for n in used],
    )


def _side(draft: Draft, side: str, rotations: _Rotations, *, rows: Ints) -> Windows:
    """Return the windows on one side of every rotation, those of each in an order of its own."""
    tracks, window_s = draft.tracks, draft.settings.linkage.handover_window_s
    present = rotations.before if side == "probe" else rotations.after
    order = [
        draft.rng("order", side, n).permutation(part)
        for n, part in zip(rotations.number, present, strict=True)
    ]
    row = np.concatenate(order)
    search = np.repeat(np.arange(len(order)), [part.size for part in order])
    if side == "probe":
        end_s = rotations.at_s[search]
        start_s = np.maximum(draft.start_s[row], end_s - window_s)
    else:
        start_s = rotations.at_s[search] + draft.task.gap_s
        end_s = np.minimum(draft.end_s[row], start_s + window_s)
    return windows_of(
        draft,
        side,
        tracks,
        rows=row,
        start_s=start_s,
        length_s=end_s - start_s,
        person=np.searchsorted(rows, row),
        search=search,
        keys=[rotations.labels[n] for n in search],
    )


def _may_teach(group: tuple[str, ...], *, fold: Ints, sides: tuple[Windows, ...]) -> Bools:
    """Return who is seen in the other half alone, (2, K), company included."""
    seen = np.zeros((N_FOLDS, len(group)), dtype=bool)
    for side in sides:
        seen[fold[side.search], side.person] = True
    cluster = np.unique(group, return_inverse=True)[1]
    seen_cluster = np.stack([np.bincount(cluster, one) > 0 for one in seen])
    may_teach: Bools = seen[::-1] & ~seen_cluster[:, cluster]
    return may_teach


def _mates(probe: Windows, gallery: Windows) -> Ints:
    """Return the gallery window of the same person in the same search, (P,), or -1."""
    window = {
        (int(n), int(who)): place
        for place, (n, who) in enumerate(zip(gallery.search, gallery.person, strict=True))
    }
    return np.array(
        [
            window.get((int(n), int(who)), -1)
            for n, who in zip(probe.search, probe.person, strict=True)
        ]
    )
