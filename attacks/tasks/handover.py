"""The handover tasks: all pseudonyms rotate at an instant, after a silence.

The old pseudonyms of the live recording end at an instant, and new ones begin after the
silence. The windows before it are the probes, those after it the gallery. Every
rotation is a search.
"""

from dataclasses import dataclass

import numpy as np

from attacks.tasks.assembly import Searches, assemble
from attacks.tasks.cutting import cut_windows
from attacks.tasks.folds import N_FOLDS, present_in_other_fold
from attacks.tasks.rotations import (
    Rotations,
    find_rotations,
    longest_silence_s,
    present_throughout,
)
from attacks.tasks.task_input import TaskInput
from attacks.tasks.windows import TaskWindows, Windows
from isac_track.errors import DataError
from isac_track.types import Bools, Floats, Ints


@dataclass(frozen=True, eq=False, slots=True)
class _UsedRotations:
    """S rotations in which people are linked, and who of N tracks is there."""

    number: Ints  # (S,) among all rotations of the recording.
    old_end_s: Floats  # (S,) last instant of the old pseudonyms.
    new_begin_s: Floats  # (S,) first instant of the new pseudonyms.
    names: tuple[str, ...]  # (S,)
    before: Bools  # (S, N) present up to the rotation.
    after: Bools  # (S, N) present from the end of the silence on.
    n_lasting: int
    """Tracks present at a rotation with somebody to link, whether drawn or not."""

    @property
    def present(self) -> Bools:
        """Tracks present on either side, (S, N)."""
        return self.before | self.after


def handover(task_input: TaskInput) -> TaskWindows:
    """Return windows before and after each rotation of all pseudonyms.

    Some people come or go meanwhile. Raises DataError if too few people or too few
    rotations remain.
    """
    used = _used_rotations(task_input)
    rows = np.flatnonzero(used.present.any(axis=0))
    _require_enough(task_input, n_people=rows.size, n_rotations=used.number.size)
    group = tuple(task_input.tracks.group[row] for row in rows)
    fold = (np.arange(used.number.size) * N_FOLDS) // used.number.size
    may_train_on = present_in_other_fold(used.present[:, rows], fold=fold, group=group)
    window_s = task_input.settings.linkage.handover_window_s
    probe = _cut_side(
        task_input,
        "probe",
        used,
        rows=rows,
        present=used.before,
        start_s=used.old_end_s - window_s,
        end_s=used.old_end_s,
    )
    gallery = _cut_side(
        task_input,
        "gallery",
        used,
        rows=rows,
        present=used.after,
        start_s=used.new_begin_s,
        end_s=used.old_end_s + (task_input.task.silence_s + window_s),
    )
    return assemble(
        task_input,
        rows,
        group=group,
        searches=Searches(used.names, fold, may_train_on),
        probe=probe,
        gallery=gallery,
        mate=_find_mates(probe, gallery, shape=(used.number.size, rows.size)),
        too_short=len(task_input.tracks) - used.n_lasting,
        not_drawn=used.n_lasting - rows.size,
    )


def _used_rotations(task_input: TaskInput) -> _UsedRotations:
    """Return the rotations with somebody to link, as many as are drawn."""
    came_s, left_s, t = task_input.start_s, task_input.end_s, task_input.tracks.t
    rotations = find_rotations(
        float(t.min()),
        float(t.max()),
        task=task_input.task,
        settings=task_input.settings.linkage,
    )
    before = rotations.present_before(came_s, left_s)
    after = rotations.present_after(came_s, left_s)
    linkable = np.flatnonzero((before & after).any(axis=1))
    number = np.intersect1d(linkable, _draw_rotations(task_input, rotations))
    old_end_s = rotations.old_end_s[number]
    return _UsedRotations(
        number=number,
        old_end_s=old_end_s,
        new_begin_s=rotations.new_begin_s[number],
        # By the time since the recording began: a rotation has the same draws whatever
        # the clock says.
        names=tuple(f"{since_s:g} s" for since_s in old_end_s - float(t.min())),
        before=before[number],
        after=after[number],
        n_lasting=int((before | after)[linkable].any(axis=0).sum()),
    )


def _draw_rotations(task_input: TaskInput, rotations: Rotations) -> Ints:
    """Return numbers of rotations: all, or as `linkage.most_people` allows.

    The draw is the same whatever the silence of the task.
    """
    present = present_throughout(
        task_input.start_s,
        task_input.end_s,
        rotations.old_end_s + longest_silence_s(),
        rotations.old_end_s,
    )
    drawn = task_input.rng("instants").permutation(rotations.old_end_s.size)
    n_people = np.logical_or.accumulate(present[drawn], axis=0).sum(axis=1)
    few = int((n_people <= task_input.settings.linkage.most_people).sum())
    return np.sort(drawn[: max(few, N_FOLDS)])


def _require_enough(task_input: TaskInput, *, n_people: int, n_rotations: int) -> None:
    """Raise DataError for too few people, or for too few rotations."""
    task_input.require_people(n_people, "people are there when pseudonyms rotate")
    if n_rotations < N_FOLDS:
        raise DataError(
            f"task {task_input.task.name}: {n_rotations} rotations of pseudonyms have"
            f" people to link, but {N_FOLDS} are needed; use a longer recording or a"
            " shorter linkage.handover_period_s"
        )


def _cut_side(
    task_input: TaskInput,
    side: str,
    used: _UsedRotations,
    *,
    rows: Ints,
    present: Bools,
    start_s: Floats,
    end_s: Floats,
) -> Windows:
    """Return one side of every rotation, its walks in a drawn order.

    `present`, (S, N), are the tracks of the side, `start_s` and `end_s`, (S,), the ends
    of its windows. `rows`, (K,), are the tracks of all people of the task.
    """
    # By number among all rotations: a rotation has the same draws whatever the silence.
    order = [
        task_input.rng("order", side, number).permutation(np.flatnonzero(tracks))
        for number, tracks in zip(used.number.tolist(), present, strict=True)
    ]
    track = np.concatenate(order)
    search = np.repeat(np.arange(len(order)), [part.size for part in order])
    cut = cut_windows(
        task_input,
        side,
        track,
        start_s[search],
        end_s[search],
        keys=[used.names[number] for number in search.tolist()],
    )
    return cut.in_searches(np.searchsorted(rows, track), search)


def _find_mates(probe: Windows, gallery: Windows, *, shape: tuple[int, int]) -> Ints:
    """Return each probe's gallery window of the same search and person, or -1, (P,).

    `shape` is the number of searches and of people.
    """
    gallery_row = np.full(shape, -1)
    gallery_row[gallery.search, gallery.person] = np.arange(len(gallery))
    return np.asarray(gallery_row[probe.search, probe.person])
