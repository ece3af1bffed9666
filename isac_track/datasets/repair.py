"""From rows to tracks: sort, mend, split, and count all that was changed."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from isac_track.datasets import people
from isac_track.datasets.recording import FOOT_M, TIMES, Repair, Rows, steps_within
from isac_track.errors import DataError
from isac_track.types import Bools, Floats, Ints, Tracks, lengths

# Closer samples of an id are the same: no rate is above 1 MHz, slopes overflow.
SAME_TIME_S = 1e-7
# With a longer usual step the walk cannot be seen, and interpolation eats memory.
LONGEST_STEP_S = 10.0
# A step of more median steps of the file is a gap (a lost frame makes 2).
GAP_STEPS = 1.75
# A longer gap, also over `SPLIT_STEPS`, ends the track: no walk is invented.
SPLIT_S = 2.0
# Slow recordings may have longer gaps: this many median steps.
SPLIT_STEPS = 3.0
# Limits of the median of all steps that move; outside, the units are wrong.
SPEED_LIMITS_MPS = (0.01, 5.0)
# Another unit whose median is within these is proposed, never used.
_WALKING_MPS = (0.2, 2.5)
FAST_STEP_MPS = 12.0  # Faster than a sprinter: a jump of the tracker.
JUMP_M = 1.0  # A shorter jump is the noise of quick samples: counted, not cut.
WALK_MPS = 4.0  # Nobody walks faster.
REUSE_M = 2.0  # Further away behind a gap than a walk leads is another person.
# A longer jump without a gap leads to another person; a shorter jump is an error.
SWITCH_M = 4.0
# An id returns from another person within this number of further cuts.
DETOUR_CUTS = 3
METRES_PER_DEGREE = 111_320.0  # Along a meridian.
# A step of fewer usual steps of its id is the same sample twice,
NEAR_STEPS = 0.5
NEAR_M = 0.5  # unless it leads further than this.
# No sensor has shorter steps: they do not count in the usual step.
CLOCK_S = 1e-4
FROZEN_S = 2.0  # At exactly the same place for this long: a repeated box.
_ZIGZAG_M = 0.02  # Tolerance of a walk at `WALK_MPS`.
_LEAST_RUN = 3  # Rows between two falls of a clock; fewer are rows out of order.


@dataclass(frozen=True, eq=False, slots=True)
class _InOrder:
    """M rows in order of person, run of the clock and time, and notes of all changes."""

    rows: Rows
    order: Ints  # (M,) place of each row in the file
    run: Ints  # (M,) run of the clock: it ends where the clock falls back
    notes: list[Repair]

    def take(self, keep: Bools, notes: list[Repair]) -> "_InOrder":
        """Drop rows; `notes` say why."""
        rows, order, run = _take(self.rows, keep), self.order[keep], self.run[keep]
        return _InOrder(rows, order, run, self.notes + notes)


@dataclass(frozen=True, eq=False, slots=True)
class _CutRows:
    """M rows in order, cut into tracks, and notes of all changes."""

    rows: Rows
    order: Ints  # (M,) place of each row in the file
    cut: Bools  # (M - 1,) whether another track begins behind a row
    notes: list[Repair]


def to_tracks(
    rows: Rows,
    groups: Iterable[tuple[str, str]] = (),
    *,
    on_duplicate: str = "error",
    drop_frozen_s: float | None = None,
) -> tuple[Tracks, tuple[Repair, ...]]:
    """Convert the rows of a recording to tracks; return all that was mended, too.

    The tracks do not depend on the order of the rows, unless a clock falls back.
    `groups` are (id, label) pairs besides those of the file itself. `on_duplicate` is
    the treatment of a person at two places at one time. A person who stays at exactly
    the same place for `drop_frozen_s` ends a track. DataError if no track has two
    samples, or if steps or speeds show that units, frame rate or columns are wrong.
    """
    place, members = rows.place, [*rows.groups, *groups]
    notes = [*rows.notes, *people.check_labels(rows)]
    in_order = _drop_copies(_sort(rows), on_duplicate=on_duplicate)
    in_order = _merge_near(in_order)
    _check_speeds(in_order.rows)
    cut_rows = _drop_frozen(_cut_tracks(in_order), drop_s=drop_frozen_s)
    notes += cut_rows.notes
    rows, order, ids = cut_rows.rows, cut_rows.order, cut_rows.rows.ids
    sizes = np.diff(np.flatnonzero(np.concatenate([[True], cut_rows.cut, [True]])))
    single = np.repeat(sizes == 1, sizes)
    notes += place.note_rows(
        "one-point", order[single], "a single sample of an id; dropped"
    )
    if single.any():
        rows, order = _take(rows, ~single), order[~single]
    offsets = np.concatenate([[0], np.cumsum(sizes[sizes > 1])])
    if not rows.t.size:
        raise DataError(f"{place.path}: no track has two samples")
    notes += _note_fast_steps(rows, offsets, order)
    _check_usual_step(rows, offsets)
    names = people.name_people(rows, ids)
    members += people.group_members(names, ids)
    clusters = walking_groups(ids=ids, members=members)
    tracks = _build_tracks(rows, offsets, ids=ids, clusters=clusters, names=names)
    passages = [ids[index] for index in rows.person[offsets[:-1]]]
    people.refuse_overlaps(tracks, rows, passages=passages)
    return tracks, tuple(notes)


def _sort(rows: Rows) -> _InOrder:
    """Sort rows by person, run of the clock and time."""
    order = np.argsort(rows.person, kind="stable")
    run, fallen = _find_clock_runs(rows, order)
    text = (
        "earlier than the row before of the same id, which walks on: the clock falls"
        " back; cut"
    )
    notes = rows.place.note_rows("clock", order[1:][fallen], text)
    late = (np.diff(rows.t[order]) < 0) & (np.diff(rows.person[order]) == 0) & ~fallen
    text = "earlier than the row before of the same id; sorted"
    notes += rows.place.note_rows("unsorted", order[1:][late], text)
    order, run = _sort_rows(rows, order, run)
    return _InOrder(_take(rows, order), order, run, notes)


def _check_usual_step(rows: Rows, offsets: Ints) -> None:
    """Raise DataError if the usual step is too long for a walk."""
    steps_s = np.diff(rows.t)[steps_within(offsets)]
    usual_s = float(np.median(steps_s, overwrite_input=True))
    if usual_s > LONGEST_STEP_S:
        raise DataError(
            f"{rows.place.path}: the usual step is {usual_s:.3g} s, over"
            f" {LONGEST_STEP_S:g} s: milliseconds for seconds, or a wrong --fps?"
        )


def _build_tracks(
    rows: Rows,
    offsets: Ints,
    *,
    ids: tuple[str, ...],
    clusters: tuple[str, ...],
    names: tuple[str, ...],
) -> Tracks:
    """Return the tracks of sorted rows; each of `ids` has its cluster and person."""
    owner = rows.person[offsets[:-1]]
    # The source id of a track is the person's, numbered if the person has several.
    longest = max(
        (len(marks) for name in ids for marks in re.findall("#+", name)), default=0
    )
    mark = "#" * (longest + 1)
    pieces = np.bincount(owner, minlength=len(ids))
    first = np.cumsum(pieces) - pieces  # The tracks of a person follow each other.
    sources = []
    for track, index in enumerate(owner):
        name = ids[index]
        if pieces[index] > 1:
            name += f"{mark}{track - first[index] + 1}"
        sources.append(name)
    return Tracks(
        t=rows.t,
        xy=rows.xy,
        offsets=offsets,
        source=tuple(sources),
        group=tuple(clusters[index] for index in owner),
        person=tuple(names[index] for index in owner),
    )


def walking_groups(
    *, ids: tuple[str, ...], members: Iterable[tuple[str, str]]
) -> tuple[str, ...]:
    """Return the cluster of every id: ids that share a label, directly or by others.

    An id without a label is a cluster of its own, called like the id; a labelled
    cluster is ``group:LABEL``, never called like another id. `members` are (id, label)
    pairs.
    """
    name_label: dict[str, str] = {}
    parent: dict[str, str] = {}

    def root(label: str) -> str:
        while parent.setdefault(label, label) != label:
            parent[label] = parent[parent[label]]
            label = parent[label]
        return label

    for name, label in members:
        # The smaller label names the cluster, whatever the order of the members.
        first, second = sorted((root(name_label.setdefault(name, label)), root(label)))
        parent[second] = first
    prefix = "group:"
    while any(name.startswith(prefix) for name in ids):
        prefix = f"group{prefix}"
    return tuple(
        prefix + root(name_label[name]) if name in name_label else name for name in ids
    )


def _take(rows: Rows, selection: Ints | Bools) -> Rows:
    return replace(
        rows, person=rows.person[selection], t=rows.t[selection], xy=rows.xy[selection]
    )


def _sort_rows(rows: Rows, order: Ints, run: Ints | None) -> tuple[Ints, Ints]:
    """Return the rows in order of person, run of the clock and time, and their runs."""
    if run is None:
        order = np.lexsort((rows.t, rows.person))  # stable
        return order, np.zeros(order.size, dtype=np.int8)
    inner = np.lexsort((rows.t[order], run, rows.person[order]))
    return order[inner], run[inner]


def _find_clock_runs(rows: Rows, order: Ints) -> tuple[Ints | None, Bools]:
    """Return each row's run of its clock, (M,), and where the clock falls, (M - 1,).

    The runs are None if no clock falls. A clock falls back where the rows of an id go
    back in time while the walk goes on, and sorting them by time would make a zigzag
    that nobody walks. `order` sorts the rows by person.
    """
    t, person = rows.t[order], rows.person[order]
    same = person[1:] == person[:-1]
    back = same & (np.diff(t) < 0)
    fallen = np.zeros_like(back)
    if not back.any():
        return None, fallen
    xy = rows.xy[order]
    begins = np.flatnonzero(np.concatenate([[True], back | ~same, [True]]))
    usual_s = (
        float(np.median(np.diff(t)[same & ~back])) if (same & ~back).any() else 0.0
    )
    for first, middle, last in zip(begins, begins[1:], begins[2:], strict=False):
        is_long = min(middle - first, last - middle) >= _LEAST_RUN
        if not (is_long and back[middle - 1]):
            continue
        stride_m = float(lengths(xy[middle] - xy[middle - 1]))
        if stride_m > WALK_MPS * usual_s * GAP_STEPS + _ZIGZAG_M:
            continue
        merged = np.argsort(t[first:last], kind="stable")
        crossing = np.diff(merged >= middle - first)
        step_s = np.diff(t[first:last][merged])[crossing]
        step_m = lengths(np.diff(xy[first:last][merged], axis=0)[crossing])
        fallen[middle - 1] = np.median(step_m - WALK_MPS * step_s) > _ZIGZAG_M
    if not fallen.any():
        return None, fallen
    return np.concatenate([[0], np.cumsum(fallen)]), fallen


def _drop_copies(in_order: _InOrder, *, on_duplicate: str) -> _InOrder:
    """Drop or average rows with the id and time of another."""
    rows, order = in_order.rows, in_order.order
    again = _find_copies(rows, in_order.run)
    if not again.any():
        return in_order
    place, notes = rows.place, list[Repair]()
    elsewhere = again & (rows.xy[1:] != rows.xy[:-1]).any(axis=1)
    text = "the same id, time and position again; dropped"
    notes += place.note_rows("duplicate", order[1:][again & ~elsewhere], text)
    keep = np.concatenate([[True], ~again])
    if elsewhere.any() and on_duplicate == "error":
        index = int(elsewhere.argmax())
        first, second = sorted((int(order[index]), int(order[index + 1])))
        rounded = (
            "; are the times rounded?" if elsewhere.sum() > elsewhere.size / 2 else ""
        )
        raise DataError(
            f"{place.at(second)}: id {rows.ids[rows.person[index]]} is somewhere else"
            f" at the same time in {place.unit} {int(place.lines()[first])}"
            f" ({int(elsewhere.sum())} such rows); --on-duplicate first or mean takes"
            f" the first or their mean{rounded}"
        )
    how = (
        "their mean stands"
        if on_duplicate == "mean"
        else "the first in the file stands"
    )
    text = f"the same id and time at another place; {how}"
    notes += place.note_rows("same-time", order[1:][elsewhere], text)
    if on_duplicate == "mean":
        in_order = replace(in_order, rows=_average(rows, keep, average_time=False))
    return in_order.take(keep, notes)


def _average(rows: Rows, keep: Bools, *, average_time: bool) -> Rows:
    """Average each row that stays with the dropped rows behind it."""
    begins = np.flatnonzero(keep)
    sizes = np.diff(np.append(begins, keep.size))
    xy, t = rows.xy.copy(), rows.t.copy()
    several = sizes > 1  # The others stay to the bit.
    for column in (xy[:, 0], xy[:, 1], *([t] if average_time else [])):
        base = column[begins]
        excess = np.add.reduceat(column - np.repeat(base, sizes), begins)
        column[begins[several]] = (base + excess / sizes)[several]
    return replace(rows, xy=xy, t=t)


def _merge_near(in_order: _InOrder) -> _InOrder:
    """Merge samples of an id that are much closer than usual."""
    rows, run = in_order.rows, in_order.run
    steps = np.diff(rows.t)
    within = (rows.person[1:] == rows.person[:-1]) & (run[1:] == run[:-1])
    usual_s = _usual_steps(rows, steps, within & (steps > CLOCK_S))
    near = within & (steps < NEAR_STEPS * usual_s[rows.person[1:]])
    near &= lengths(np.diff(rows.xy, axis=0)) <= NEAR_M
    if not near.any():
        return in_order
    # In a chain of such samples none is further from the first than half a step.
    behind = np.flatnonzero(near) + 1
    keep = np.ones(rows.t.size, dtype=bool)
    anchor = -1
    for row in behind.tolist():
        if anchor < 0 or keep[row - 1]:
            anchor = row - 1
        keep[row] = (
            rows.t[row] - rows.t[anchor] >= NEAR_STEPS * usual_s[rows.person[row]]
        )
    text = "less than half a usual step behind the row before of the same id; merged"
    notes = rows.place.note_rows("near-duplicate", in_order.order[~keep], text)
    averaged = _average(rows, keep, average_time=True)
    return replace(in_order, rows=averaged).take(keep, notes)


def _usual_steps(rows: Rows, steps: Floats, chosen: Bools) -> Floats:
    """Return the median in s of the chosen steps of each id, (P,); 0 without steps."""
    owner, length = rows.person[1:][chosen], steps[chosen]
    inner = np.lexsort((length, owner))
    counts = np.bincount(owner, minlength=len(rows.ids))
    ends = np.cumsum(counts)
    usual = np.zeros(len(rows.ids))
    has_steps = counts > 0
    usual[has_steps] = length[inner][(ends - counts + (counts - 1) // 2)[has_steps]]
    return usual


def _find_copies(rows: Rows, run: Ints) -> Bools:
    """Return whether sorted rows repeat the id and time of the row before, (M - 1,)."""
    person = rows.person
    again: Bools = (np.diff(rows.t) < SAME_TIME_S) & (person[1:] == person[:-1])
    same_run: Bools = run[1:] == run[:-1]
    return np.asarray(again & same_run)


def _cut_tracks(in_order: _InOrder) -> _CutRows:
    """Cut rows into tracks.

    A new track begins at a new person, behind a long gap or a jump, and where the clock
    fell back. An id that returns as another person gets a new id.
    """
    rows, order, run = in_order.rows, in_order.order, in_order.run
    steps = np.diff(rows.t)
    new = rows.person[1:] != rows.person[:-1]
    fell = ~new & (run[1:] != run[:-1])
    if (new | fell).all():
        return _CutRows(rows, order, new | fell, in_order.notes)
    within = ~new & ~fell
    nominal = float(np.median(steps[within], overwrite_input=True))
    longest_s = (
        max(SPLIT_S, SPLIT_STEPS * nominal) if rows.split_s is None else rows.split_s
    )
    long = within & (steps > longest_s + SAME_TIME_S)
    gap = within & (steps > GAP_STEPS * nominal) | long
    distance = lengths(np.diff(rows.xy, axis=0))
    jumped = within & (distance > np.maximum(FAST_STEP_MPS * steps, JUMP_M))
    elsewhere = gap & (distance > np.maximum(WALK_MPS * steps, REUSE_M))
    elsewhere |= jumped & (distance > SWITCH_M)
    detour = _find_detours(
        rows, run, new | fell | long | jumped | elsewhere, longest_s=longest_s
    )
    reused = elsewhere & ~detour
    fast = (jumped | elsewhere) & ~reused & ~long
    notes = list(in_order.notes)
    for selected, kind, action in (
        (gap & ~long & ~reused & ~fast, "gap", "to be interpolated"),
        (long & ~reused, "split", "too long to interpolate; two tracks of one group"),
    ):
        longest = steps[selected].max(initial=0)
        text = (
            f"behind a gap (longest {longest:.3g} s, usual step {nominal:.3g} s);"
            f" {action}"
        )
        notes += rows.place.note_rows(kind, order[1:][selected], text)
    text = "from the sample before, further than anybody walks; cut"
    notes += rows.place.note_rows("jump", order[1:][fast], text)
    text = "at another place, where no walk leads; the id is taken for another person"
    notes += rows.place.note_rows("id-reuse", order[1:][reused], text)
    cut = new | fell | long | fast | reused
    return _CutRows(_with_new_ids(rows, reused, new), order, cut, notes)


def _find_detours(rows: Rows, run: Ints, cut: Bools, *, longest_s: float) -> Bools:
    """Return the cuts, (M - 1,), of an id that soon returns to its own walk.

    A tracker that strays for a moment, by a sample or several, is no other person.
    `cut` (M - 1,) are the cuts between sorted rows. The id must return within
    `longest_s` s and `DETOUR_CUTS`.
    """
    positions = np.flatnonzero(cut)
    detour = np.zeros(cut.size, dtype=bool)
    for lag in range(1, DETOUR_CUTS + 1):
        leaves = positions[:-lag]  # The last row before.
        returns = positions[lag:] + 1  # The first row behind.
        lasting_s = rows.t[returns] - rows.t[leaves]
        away_m = lengths(rows.xy[returns] - rows.xy[leaves])
        is_back = (rows.person[returns] == rows.person[leaves]) & (
            run[returns] == run[leaves]
        )
        is_back &= lasting_s <= longest_s + SAME_TIME_S
        is_back &= away_m <= np.maximum(WALK_MPS * lasting_s, REUSE_M)
        for shift in range(lag + 1):
            detour[positions[shift : positions.size - lag + shift][is_back]] = True
    return detour


def _with_new_ids(rows: Rows, reused: Bools, new: Bools) -> Rows:
    """Return rows in which an id that returns as another person is a new id."""
    if not reused.any():
        return rows
    known_ids = {*rows.ids}
    mark = "~"
    while any(mark in name for name in known_ids):
        mark += "~"
    begins = np.concatenate([[True], new | reused])
    numbers = np.cumsum(begins) - 1
    owners = rows.person[begins]
    # How often its id belonged to somebody before.
    first = np.concatenate([[True], owners[1:] != owners[:-1]])
    nth = np.arange(owners.size) - np.maximum.accumulate(
        np.where(first, np.arange(owners.size), 0)
    )
    ids = tuple(
        rows.ids[owner] + (f"{mark}{place + 1}" if place else "")
        for owner, place in zip(owners.tolist(), nth.tolist(), strict=True)
    )
    return replace(rows, person=numbers, ids=ids)


def _drop_frozen(cut_rows: _CutRows, *, drop_s: float | None) -> _CutRows:
    """Drop stretches at exactly one place for `drop_s`; None: note them alone."""
    rows, order, cut = cut_rows.rows, cut_rows.order, cut_rows.cut
    still = ~cut & (rows.xy[1:] == rows.xy[:-1]).all(axis=1)
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], still, [False]]).astype(np.int8))
    )
    first, last = edges[::2], edges[1::2]  # Rows of a stretch, both ends included.
    least_s = FROZEN_S if drop_s is None else drop_s
    long = rows.t[last] - rows.t[first] >= least_s - SAME_TIME_S
    first, last = first[long], last[long]
    keep = np.ones(rows.t.size, dtype=bool)
    if not first.size:
        return cut_rows
    n_samples = int((last - first + 1).sum())
    description = (
        f"at exactly one place for {least_s:g} s or longer ({n_samples} of {keep.size}"
        " samples)"
    )
    if drop_s is None:
        text = f"{description}; --drop-frozen {least_s:g} drops it"
        note = rows.place.note_rows("frozen", order[first], text)
        return replace(cut_rows, notes=cut_rows.notes + note)
    begins = np.concatenate([[True], cut])
    for start, end in zip(first.tolist(), last.tolist(), strict=True):
        keep[start + 1 : end] = False
        begins[end] = True
    note = rows.place.note_rows(
        "frozen-dropped", order[first], f"{description}; dropped, the track is cut"
    )
    return _CutRows(
        rows=_take(rows, keep),
        order=order[keep],
        cut=begins[keep][1:],
        notes=cut_rows.notes + note,
    )


def _note_fast_steps(rows: Rows, offsets: Ints, order: Ints) -> list[Repair]:
    """Return the note of steps that are fast, but too short for a jump."""
    within = steps_within(offsets)
    distance = lengths(np.diff(rows.xy, axis=0)[within])
    # Multiplied out: a step of a denormal time would overflow the quotient.
    fast = distance > FAST_STEP_MPS * np.diff(rows.t)[within]
    text = f"over {FAST_STEP_MPS:g} m/s from the sample before; not cut"
    return rows.place.note_rows("fast-step", order[1:][within][fast], text)


def _check_speeds(rows: Rows) -> None:
    """Raise DataError if speeds of sorted rows show a wrong unit, rate or column."""
    within = (rows.person[1:] == rows.person[:-1]) & (np.diff(rows.t) > 0)
    distance = lengths(np.diff(rows.xy, axis=0)[within])
    duration = np.diff(rows.t)[within]
    moving = distance > 0
    if not moving.any():
        return
    low, high = SPEED_LIMITS_MPS
    speeds = distance[moving]
    with np.errstate(over="ignore"):
        speeds /= duration[moving]
    speed = float(np.median(speeds, overwrite_input=True))
    if not low <= speed <= high:
        on_earth = bool((np.abs(rows.xy) <= (180.0, 180.0)).all()) and not rows.unit
        degrees_mps = speed * METRES_PER_DEGREE
        is_clocked = float(np.median(duration)) <= LONGEST_STEP_S
        near_walk = _WALKING_MPS[0] / 4 <= degrees_mps <= _WALKING_MPS[1] * 2
        if on_earth and is_clocked and near_walk:
            raise DataError(
                f"{rows.place.path}: the median speed of moving people is {speed:.3g}"
                " m/s, as of degrees of longitude and latitude; --crs degrees makes"
                " metres of x (longitude) and y (latitude)"
            )
        hints = _suggest_options(speed, has_unit=bool(rows.unit))
        is_projected = any(note.kind == "crs" for note in rows.notes)
        if speed > high and is_projected:
            guess = (
                "degrees of too few decimals (the sixth is 0.1 m), or a clock not in"
                f" seconds{hints}"
            )
        elif speed > high:
            guess = (
                f"pixels or centimetres for metres{hints}, a wrong --fps, or frame and"
                " id swapped"
            )
        else:
            guess = (
                "milliseconds for seconds (of a table: --columns t=t[ms]),"
                f" kilometres for metres (--unit 1000), or a wrong --fps{hints}"
            )
        raise DataError(
            f"{rows.place.path}: the median speed of moving people is {speed:.3g} m/s,"
            f" not within {low:g} to {high:g}: {guess}?"
        )


def _suggest_options(speed_mps: float, *, has_unit: bool) -> str:
    """Suggest options with which this median speed is a walk; empty without any."""
    unit_lengths = (
        {} if has_unit else {"cm": 0.01, "mm": 0.001, "ft": FOOT_M, "0.0254": 0.0254}
    )
    options = {f"--unit {unit}": metres for unit, metres in unit_lengths.items()}
    for unit in ("min", "ms", "us", "ns"):
        options[f"--columns t=t[{unit}]"] = 1.0 / TIMES[unit]
    low, high = _WALKING_MPS
    return "".join(
        f" ({option} makes it {speed_mps * factor:.2g} m/s)"
        for option, factor in options.items()
        if low <= speed_mps * factor <= high
    )
