"""Several files as the sessions of one recording, and the people who come back."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from isac_track.datasets import people
from isac_track.datasets.recording import steps_within
from isac_track.datasets.registry import shown
from isac_track.datasets.repair import walking_groups
from isac_track.errors import DataError
from isac_track.types import Floats, Tracks

# Time from the last sample of a session to the first of the next, on one clock.
APART_S = 60.0
_SUFFIXES = (".csv", ".ndjson", ".parquet", ".txt")
_SAME_STEP = 0.01  # Usual steps of sessions may differ by this share.


def files_in(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the files of a folder that are sessions, sorted; DataError without any."""
    try:
        candidates = folder.glob(pattern)
        files = [
            file
            for file in candidates
            if file.suffix.lower() in _SUFFIXES and file.is_file()
        ]
    except OSError as error:
        raise DataError(f"{shown(folder)}: cannot be read ({error.strerror})") from None
    if not files:
        listing = pattern if pattern != "*" else " ".join(_SUFFIXES)
        raise DataError(
            f"{shown(folder)}: this is a folder, and holds no session ({listing})"
        )
    return sorted(files)


def join_sessions(
    parts: Sequence[tuple[str, Tracks, str]], *, same_people: bool
) -> Tracks:
    """Join the tracks of all sessions on one clock, one session after the other.

    `parts` are name, tracks and unit of length of each file; a track is called
    ``SESSION:ID``. With `same_people` the name of a person is the same person in all
    sessions, and so one cluster. DataError for sessions with the same name, with
    different units or sampling rates, or with two spellings of a person.
    """
    names = [name for name, _, _ in parts]
    for name in names:
        if names.count(name) > 1:
            raise DataError(
                f"two sessions are called {name}; rename one file if they are two"
                " sessions"
            )
    steps_s = [
        float(np.median(np.diff(tracks.t)[steps_within(tracks.offsets)]))
        for _, tracks, _ in parts
    ]
    for (name, _, unit), step_s in zip(parts, steps_s, strict=True):
        pair = f"sessions {names[0]} and {name}"
        if unit != parts[0][2]:
            raise DataError(
                f"{pair} are in {parts[0][2]} and {unit}; convert one of them"
            )
        if abs(step_s - steps_s[0]) > _SAME_STEP * steps_s[0]:
            raise DataError(
                f"{pair} have a sample every {steps_s[0]:.3g} and {step_s:.3g} s:"
                " people would be known by the rate; resample one of them, or check"
                " --fps"
            )
    t: list[Floats] = []
    for _, tracks, _ in parts:
        t.append(
            tracks.t - tracks.t.min() + (float(t[-1].max()) + APART_S if t else 0.0)
        )
    sizes = np.concatenate([np.diff(tracks.offsets) for _, tracks, _ in parts])
    walks = [
        (name, tracks, row) for name, tracks, _ in parts for row in range(len(tracks))
    ]
    source = tuple(f"{name}:{tracks.source[row]}" for name, tracks, row in walks)
    group = tuple(f"{name}:{tracks.group[row]}" for name, tracks, row in walks)
    person = tuple(_person(name, tracks, row) for name, tracks, row in walks)
    if same_people:
        people.refuse_two_spellings([(name, tracks) for name, tracks, _ in parts])
        labels = [f"person {name}" for name in person]
        labels += [f"with {name}" for name in group]
        members = list(zip(source + source, labels, strict=True))
        group = walking_groups(ids=source, members=members)
    return Tracks(
        t=np.concatenate(t),
        xy=np.concatenate([tracks.xy for _, tracks, _ in parts]),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        source=source,
        group=group,
        person=person if same_people else None,
        session=tuple(name for name, _, _ in walks),
    )


def _person(session: str, tracks: Tracks, row: int) -> str:
    """Return the person of a track: without a label, known in no other session."""
    person = (tracks.person or tracks.group)[row]
    if people.is_labelled(person):
        return person
    return f"{people.UNLABELLED}{session}:{person.removeprefix(people.UNLABELLED)}"
