"""From rows to tracks: sort, mend, split, and count everything that was not taken as it stood."""

import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from isac_track.datasets.recording import METRES, Repair, Rows, listed, steps_within
from isac_track.errors import DataError
from isac_track.types import Bools, Ints, Tracks

SAME_TIME_S = 1e-7  # Closer samples of an id are one: no rate is above 1 MHz, slopes overflow.
LONGEST_STEP_S = 10.0  # With a longer usual step no walk is seen, and interpolation eats memory.
GAP_STEPS = 1.75  # A step of more median steps of the file is a gap (a lost frame makes 2).
SPLIT_S = 2.0  # A gap over this and `SPLIT_STEPS` ends the track: to bridge it invents a walk.
SPLIT_STEPS = 3.0  # Slow recordings may have longer gaps: this many median steps.
SPEED_LIMITS_MPS = (0.01, 5.0)  # Of the median of all steps that move; beyond them units are wrong.
_WALKING_MPS = (0.2, 2.5)  # A median in another unit that lies here is proposed, never taken.
FAST_STEP_MPS = 12.0  # Faster than a sprinter: a jump of the tracker, counted and kept.


def to_tracks(
    rows: Rows, groups: Iterable[tuple[str, str]] = ()
) -> tuple[Tracks, tuple[Repair, ...]]:
    """Return the tracks of a recording and all that was mended or let pass on the way.

    The tracks do not depend on the order of the rows. `groups` are (id, label) pairs beside
    those of the file itself. It is a DataError if one person is at two places at one time, if no
    track has two samples, or if steps or speeds show that units, frame rate or columns are wrong.
    """
    place, ids, members = rows.place, rows.ids, (*rows.groups, *groups)
    notes = [*rows.notes]

    def taken(rows: Rows, which: Ints | Bools) -> Rows:
        return replace(rows, person=rows.person[which], t=rows.t[which], xy=rows.xy[which])

    order = np.argsort(rows.person, kind="stable")
    late = (np.diff(rows.t[order]) < 0) & (np.diff(rows.person[order]) == 0)
    text = "earlier than the row before of the same id; sorted"
    notes += place.noted("unsorted", order[1:][late], text)
    order = np.lexsort((rows.t, rows.person))  # stable
    rows = taken(rows, order)
    again = _copies(rows, order)
    text = "the same id, time and position again; dropped"
    notes += place.noted("duplicate", order[1:][again], text)
    if again.any():
        keep = np.concatenate([[True], ~again])
        rows, order = taken(rows, keep), order[keep]

    cut, gaps = _cuts(rows, order)
    notes += gaps
    lengths = np.diff(np.flatnonzero(np.concatenate([[True], cut, [True]])))
    single = np.repeat(lengths == 1, lengths)
    text = f"a single sample (id {listed([ids[index] for index in rows.person[single]])}); dropped"
    notes += place.noted("one-point", order[single], text)
    if single.any():
        rows, order = taken(rows, ~single), order[~single]
    offsets = np.concatenate([[0], np.cumsum(lengths[lengths > 1])])
    t, owner = rows.t, rows.person[offsets[:-1]]
    if not t.size:
        raise DataError(f"{place.path}: no track has two samples")
    notes += _check_speeds(rows, offsets, order)
    usual_s = float(np.median(np.diff(t)[steps_within(offsets)], overwrite_input=True))
    if usual_s > LONGEST_STEP_S:
        raise DataError(
            f"{place.path}: the usual step is {usual_s:.3g} s, over {LONGEST_STEP_S:g} s: "
            "milliseconds for seconds, or a wrong --fps?"
        )

    cluster = walking_groups(ids=ids, members=members)
    # The source id of a track is the person's, numbered where it was split.
    longest = max((len(run) for name in ids for run in re.findall("#+", name)), default=0)
    mark = "#" * (longest + 1)
    pieces = np.bincount(owner, minlength=len(ids))
    first = np.cumsum(pieces) - pieces  # the tracks of a person follow each other
    tracks = Tracks(
        t=t,
        xy=rows.xy,
        offsets=offsets,
        source=tuple(
            f"{ids[index]}{mark}{track - first[index] + 1}" if pieces[index] > 1 else ids[index]
            for track, index in enumerate(owner)
        ),
        group=tuple(cluster[index] for index in owner),
        person=tuple(ids[index] for index in owner),
    )
    return tracks, tuple(notes)


def walking_groups(*, ids: tuple[str, ...], members: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Return the cluster of every id: those who share a label, directly or over others.

    An id without a label is a cluster of its own, called like the id; a labelled one is
    ``group:LABEL``, never called like another id. `members` are (id, label) pairs.
    """
    label_of: dict[str, str] = {}
    parent: dict[str, str] = {}

    def root(label: str) -> str:
        while parent.setdefault(label, label) != label:
            parent[label] = parent[parent[label]]
            label = parent[label]
        return label

    for name, label in members:
        # The lesser label names the cluster, whatever the order of the members.
        first, second = sorted((root(label_of.setdefault(name, label)), root(label)))
        parent[second] = first
    prefix = "group:"
    while any(name.startswith(prefix) for name in ids):
        prefix = f"group{prefix}"
    return tuple(prefix + root(label_of[name]) if name in label_of else name for name in ids)


def _copies(rows: Rows, order: Ints) -> Bools:
    """Return (M - 1,) which of the sorted rows say again what the one before them says."""
    person, xy, place = rows.person, rows.xy, rows.place
    again: Bools = (np.diff(rows.t) < SAME_TIME_S) & (person[1:] == person[:-1])
    other = again & (xy[1:] != xy[:-1]).any(axis=1)
    if other.any():
        at = int(other.argmax())
        first, second = sorted((int(order[at]), int(order[at + 1])))
        raise DataError(
            f"{place.at(second)}: id {rows.ids[person[at]]} is somewhere else at the same "
            f"time in {place.unit} {int(place.lines()[first])}"
        )
    return again


def _cuts(rows: Rows, order: Ints) -> tuple[Bools, list[Repair]]:
    """Return (M - 1,) where a new track begins: at a new person, or behind a long gap."""
    steps = np.diff(rows.t)
    new = rows.person[1:] != rows.person[:-1]
    if new.all():
        return new, []
    nominal = float(np.median(steps[~new], overwrite_input=True))
    longest_s = max(SPLIT_S, SPLIT_STEPS * nominal) if rows.split_s is None else rows.split_s
    long = ~new & (steps > longest_s + SAME_TIME_S)
    gap = ~new & (steps > GAP_STEPS * nominal) | long
    notes = []
    for where, kind, done in (
        (gap & ~long, "gap", "kept, to be interpolated"),
        (long, "split", "too long to interpolate; two tracks of one group"),
    ):
        longest = steps[where].max(initial=0)
        text = f"behind a gap (longest {longest:.3g} s, usual step {nominal:.3g} s); {done}"
        notes += rows.place.noted(kind, order[1:][where], text)
    return new | long, notes


def _check_speeds(rows: Rows, offsets: Ints, order: Ints) -> list[Repair]:
    within = steps_within(offsets)
    distance = np.hypot(np.diff(rows.xy[:, 0]), np.diff(rows.xy[:, 1]))[within]
    duration = np.diff(rows.t)[within]
    moving = distance > 0
    if not moving.any():
        return []
    low, high = SPEED_LIMITS_MPS
    speeds = distance[moving]
    with np.errstate(over="ignore"):
        speeds /= duration[moving]
    speed = float(np.median(speeds, overwrite_input=True))
    if not low <= speed <= high:
        units = [] if rows.unit else [one for one in METRES if one != "m"]
        hints = [
            f" (--unit {one} makes it {speed * METRES[one]:.2g} m/s)"
            for one in units
            if _WALKING_MPS[0] <= speed * METRES[one] <= _WALKING_MPS[1]
        ]
        guess = (
            f"pixels or centimetres for metres{''.join(hints)}, a wrong --fps, or frame and id "
            "swapped"
            if speed > high
            else "milliseconds for seconds, kilometres for metres, or a wrong --fps"
        )
        raise DataError(
            f"{rows.place.path}: the median speed of moving people is {speed:.3g} m/s, not within "
            f"{low:g} to {high:g}: {guess}?"
        )
    # Multiplied out: a step of a denormal time would overflow the quotient.
    fast = distance > FAST_STEP_MPS * duration
    text = f"over {FAST_STEP_MPS:g} m/s from the sample before; kept"
    return rows.place.noted("fast-step", order[1:][within][fast], text)
