"""Several files as the sessions of one recording, and who of them comes back."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from isac_track.datasets.recording import steps_within
from isac_track.datasets.registry import shown
from isac_track.datasets.repair import walking_groups
from isac_track.errors import DataError
from isac_track.types import Floats, Tracks

# From the last sample of a session to the first of the next, on one clock.
APART_S = 60.0
_SUFFIXES = (".csv", ".ndjson", ".parquet", ".txt")
_SAME_STEP = 0.01  # Usual steps of sessions may differ by this share.


def files_in(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the files of a folder that are sessions, sorted; DataError if there are none."""
    try:
        every = folder.glob(pattern)
        found = [
            one for one in every if one.suffix.lower() in _SUFFIXES and one.is_file()
        ]
    except OSError as error:
        raise DataError(f"{shown(folder)}: cannot be read ({error.strerror})") from None
    if not found:
        named = pattern if pattern != "*" else " ".join(_SUFFIXES)
        raise DataError(
            f"{shown(folder)}: this is a folder, and holds no session ({named})"
        )
    return sorted(found)


def as_one(parts: Sequence[tuple[str, Tracks, str]], *, same_people: bool) -> Tracks:
    """Return the tracks of all sessions on one clock, one session after the other.

    `parts` are name, tracks and unit of each file; a track is called ``SESSION:ID``.
    With `same_people` an id is the same person in all of them, and so one cluster.
    DataError for sessions that are called alike, or of other units or sampling rates.
    """
    names = [name for name, _, _ in parts]
    for name in names:
        if names.count(name) > 1:
            raise DataError(
                f"two sessions are called {name}; rename one file if they are two"
                " sessions"
            )
    steps_s = [
        float(np.median(np.diff(its.t)[steps_within(its.offsets)]))
        for _, its, _ in parts
    ]
    for (name, _, unit), step_s in zip(parts, steps_s, strict=True):
        both = f"sessions {names[0]} and {name}"
        if unit != parts[0][2]:
            raise DataError(
                f"{both} are in {parts[0][2]} and {unit}; convert one of them"
            )
        if abs(step_s - steps_s[0]) > _SAME_STEP * steps_s[0]:
            raise DataError(
                f"{both} have a sample every {steps_s[0]:.3g} and {step_s:.3g} s:"
                " people would be known by the rate; resample one of them, or check"
                " --fps"
            )
    t: list[Floats] = []
    for _, tracks, _ in parts:
        t.append(
            tracks.t - tracks.t.min() + (float(t[-1].max()) + APART_S if t else 0.0)
        )
    sizes = np.concatenate([np.diff(tracks.offsets) for _, tracks, _ in parts])
    each = [
        (name, tracks, row) for name, tracks, _ in parts for row in range(len(tracks))
    ]
    source = tuple(f"{name}:{tracks.source[row]}" for name, tracks, row in each)
    group = tuple(f"{name}:{tracks.group[row]}" for name, tracks, row in each)
    person = tuple((tracks.person or tracks.group)[row] for _, tracks, row in each)
    if same_people:
        people = [
            (one, f"person {who}") for one, who in zip(source, person, strict=True)
        ]
        company = [(one, f"with {who}") for one, who in zip(source, group, strict=True)]
        group = walking_groups(ids=source, members=[*people, *company])
    return Tracks(
        t=np.concatenate(t),
        xy=np.concatenate([tracks.xy for _, tracks, _ in parts]),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        source=source,
        group=group,
        person=person if same_people else None,
        session=tuple(name for name, _, _ in each),
    )
