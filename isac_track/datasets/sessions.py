"""Several files as the sessions of one recording, and the people who come back."""

from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False, slots=True)
class Session:
    """A file that is a session of a recording."""

    name: str
    tracks: Tracks
    unit: str  # Of length, in the file.

    @property
    def step_s(self) -> float:
        """The usual time from a sample to the next."""
        steps_s = np.diff(self.tracks.t)[steps_within(self.tracks.offsets)]
        return float(np.median(steps_s))


def join_sessions(sessions: Sequence[Session], *, same_people: bool) -> Tracks:
    """Join the tracks of all sessions on one clock, one session after the other.

    A track is called ``SESSION:ID``. With `same_people` the name of a person is the
    same person in all sessions, and so one cluster. DataError for sessions with the
    same name, with different units or sampling rates, or with two spellings of a
    person.
    """
    _refuse_unlike(sessions)
    t: list[Floats] = []
    for session in sessions:
        start_s = float(t[-1].max()) + APART_S if t else 0.0
        t.append(session.tracks.t - session.tracks.t.min() + start_s)
    all_tracks = [session.tracks for session in sessions]
    sizes = np.concatenate([np.diff(tracks.offsets) for tracks in all_tracks])
    walks = [
        (session.name, session.tracks, row)
        for session in sessions
        for row in range(len(session.tracks))
    ]
    source = tuple(f"{name}:{tracks.source[row]}" for name, tracks, row in walks)
    group = tuple(f"{name}:{tracks.group[row]}" for name, tracks, row in walks)
    person = tuple(_person(name, tracks, row) for name, tracks, row in walks)
    if same_people:
        people.refuse_two_spellings(
            [(session.name, session.tracks) for session in sessions]
        )
        labels = [f"person {name}" for name in person]
        labels += [f"with {name}" for name in group]
        members = list(zip(source + source, labels, strict=True))
        group = walking_groups(ids=source, members=members)
    return Tracks(
        t=np.concatenate(t),
        xy=np.concatenate([tracks.xy for tracks in all_tracks]),
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


def _refuse_unlike(sessions: Sequence[Session]) -> None:
    """Raise DataError for a name given twice, or another unit or sampling rate."""
    names = [session.name for session in sessions]
    for name in names:
        if names.count(name) > 1:
            raise DataError(
                f"two sessions are called {name}; rename one file if they are two"
                " sessions"
            )
    first, first_step_s = sessions[0], sessions[0].step_s
    for session in sessions:
        pair, step_s = f"sessions {first.name} and {session.name}", session.step_s
        if session.unit != first.unit:
            raise DataError(
                f"{pair} are in {first.unit} and {session.unit}; convert one of them"
            )
        if abs(step_s - first_step_s) > _SAME_STEP * first_step_s:
            raise DataError(
                f"{pair} have a sample every {first_step_s:.3g} and {step_s:.3g} s:"
                " people would be known by the rate; resample one of them, or check"
                " --fps"
            )
