"""Labels of people: which passages of a recording are walks of the same person.

A label is a name and nothing else: neither the letter of a sex in it nor a body height
beside it is ever a feature. Labels stand in a column `person`, in comments of PeTrack
or PedPy text (``# 14 M 17``: passage 14 is person M17), or are PeTrack's markerID.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from isac_track.datasets.recording import Label, Place, Repair, Rows
from isac_track.errors import DataError
from isac_track.types import Ints, Tracks

KIND: Final = "people"  # The kind of the repair that counts people and passages.
UNLABELLED: Final = "unlabelled "
"""Begins the name of a person whom no label names, and no other passage shares."""
# A passage, a letter, and the number of the person.
_COMMENT = re.compile(r"#\s*(\d+)\s+([A-Za-z])[\s_.-]*(\d+)\s*")


@dataclass(frozen=True, slots=True)
class Attendance:
    """Numbers of sessions, passages and people of a recording."""

    sessions: int
    passages: int
    people: int  # People with a label.
    returning: int  # People with a label in two sessions or more.
    unlabelled: int  # Passages without a label.

    def __str__(self) -> str:
        """Return the numbers in a line."""
        n_labelled = self.passages - self.unlabelled
        if not n_labelled:
            return f"{self.sessions} sessions; nobody is known to be in two"
        sessions = f"{self.sessions} sessions: " if self.sessions > 1 else ""
        text = f"{sessions}{n_labelled:,} passages of {self.people:,} labelled people"
        if sessions:
            text += f", {self.returning:,} of them in two sessions or more"
        if self.unlabelled:
            text += f"; {self.unlabelled:,} passages without a label"
        return text


def count_attendance(tracks: Tracks) -> Attendance:
    """Return the numbers of sessions, passages and people."""
    sessions = tracks.session or ("",) * len(tracks)
    attended: dict[str, set[str]] = {}
    n_labelled = 0
    for person, session in zip(tracks.person or (), sessions, strict=False):
        if is_labelled(person):
            attended.setdefault(person, set()).add(session)
            n_labelled += 1
    return Attendance(
        sessions=len(set(sessions)),
        passages=len(tracks),
        people=len(attended),
        returning=sum(len(places) > 1 for places in attended.values()),
        unlabelled=len(tracks) - n_labelled,
    )


def is_labelled(person: str) -> bool:
    """Whether a label names this person of `Tracks.person`."""
    return not person.startswith(UNLABELLED)


def parse_label(text: str, *, line: int) -> tuple[str, Label] | None:
    """Return passage and label of a comment such as ``# 14 M 17``; None for others."""
    match = _COMMENT.fullmatch(text)
    if match is None:
        return None
    passage, letter, number = match.groups()
    return str(int(passage)), Label(f"{letter}{number}", line)


def collect_labels(
    labels: Sequence[tuple[str, Label]], *, path: str, unit: str = "line"
) -> dict[str, Label]:
    """Return the label of each passage; DataError if a passage has two people."""
    collected: dict[str, Label] = {}
    for passage, label in labels:
        first = collected.setdefault(passage, label)
        if first.person != label.person:
            raise DataError(
                f"{path}, {unit} {label.line}: passage {passage} is of person"
                f" {label.person} here, and of {first.person} in {unit} {first.line};"
                " leave the right one, or give each passage an id of its own"
            )
    return collected


def label_rows(
    values: Ints, names: Sequence[str], *, owner: Ints, ids: Sequence[str], place: Place
) -> dict[str, Label]:
    """Return the label of each id of a table whose rows name people.

    `values`, (M,), are indices into `names`; an empty name is no label. `owner`, (M,),
    are indices into `ids`. DataError names the row of an id with two people.
    """
    pair, first_row = np.unique(owner * len(names) + values, return_index=True)
    numbers = place.lines()[first_row]
    labels = [
        (ids[code // len(names)], Label(names[code % len(names)], int(number)))
        for code, number in zip(pair.tolist(), numbers.tolist(), strict=True)
    ]
    named = sorted(
        ((name, label) for name, label in labels if label.person),
        key=lambda entry: entry[1].line,
    )
    return collect_labels(named, path=place.path, unit=place.unit)


def withdraw(rows: Rows, withdrawn: Mapping[str, str]) -> Rows:
    """Return rows without the labels of some passages, each noted with its reason."""
    if not withdrawn or rows.people is None:
        return rows
    notes = [
        Repair(
            "label",
            1,
            f"{rows.place.path}, {rows.place.unit} {rows.people[passage].line}: passage"
            f" {passage} is not taken for {rows.people[passage].person}: {reason}",
        )
        for passage, reason in withdrawn.items()
    ]
    people = {
        passage: label
        for passage, label in rows.people.items()
        if passage not in withdrawn
    }
    return replace(rows, people=people, notes=(*rows.notes, *notes))


def check_labels(rows: Rows) -> list[Repair]:
    """Return a note of the people; DataError for labels that fit no passage or person.

    They are a label of a passage that has no rows, and a label in two spellings.
    """
    if rows.people is None:
        return []
    path, unit, ids = rows.place.path, rows.place.unit, {*rows.ids}
    spelt: dict[str, Label] = {}
    for passage, label in rows.people.items():
        where = f"{path}, {unit} {label.line}"
        if passage not in ids:
            raise DataError(
                f"{where}: person {label.person} is to be passage {passage}, which has"
                " no rows; correct the passage's number, or remove the line"
            )
        if label.person.startswith(UNLABELLED):
            raise DataError(
                f"{where}: no person may be called {label.person[:40]!r}; leave the"
                " name empty"
            )
        first = spelt.setdefault(_spelling(label.person), label)
        if first.person != label.person:
            raise DataError(
                f"{where}: person {label.person!r} is spelt {first.person!r} in"
                f" {unit} {first.line}; spell a person in one way"
            )
    detail = f"{path}: labels name the people of {len(rows.people):,} passages"
    _, first_rows = np.unique(rows.person, return_index=True)
    # By line, not by id: ids may be names of people, and manifests are published.
    unlabelled = [
        row
        for row in first_rows.tolist()
        if rows.ids[rows.person[row]] not in rows.people
    ]
    text = "a passage without a label; of a person who is in no other passage"
    return [
        Repair(KIND, len(spelt), detail),
        *rows.place.note_rows("unlabelled", np.array(unlabelled, dtype=np.int64), text),
    ]


def refuse_two_spellings(parts: Sequence[tuple[str, Tracks]]) -> None:
    """Raise DataError if the sessions, (name, tracks), spell a person in two ways."""
    spelt: dict[str, tuple[str, str]] = {}
    for session, tracks in parts:
        for person in filter(is_labelled, tracks.person or ()):
            name, first = spelt.setdefault(_spelling(person), (person, session))
            if name != person:
                raise DataError(
                    f"sessions {first} and {session}: person {name!r} of the first is"
                    f" spelt {person!r} in the other; spell a person in one way"
                )


def _spelling(person: str) -> str:
    """Return a name without capitals, blanks, hyphens and leading zeros."""
    bare = re.sub(r"[\s_.-]+", "", person.casefold()) or person
    return re.sub(r"(?<!\d)0+(?=\d)", "", bare)


def name_people(rows: Rows, ids: Sequence[str]) -> tuple[str, ...]:
    """Return the person of each id: by label, unlabelled, or the id without labels."""
    if rows.people is None:
        return tuple(ids)
    labels = {passage: label.person for passage, label in rows.people.items()}
    return tuple(labels.get(name, f"{UNLABELLED}{name}") for name in ids)


def group_members(people: Sequence[str], ids: Sequence[str]) -> list[tuple[str, str]]:
    """Return (id, label) pairs that make one cluster of a person's passages."""
    times = Counter(people)
    return [
        (name, f"person {person}")
        for name, person in zip(ids, people, strict=True)
        if times[person] > 1
    ]


def refuse_overlaps(tracks: Tracks, rows: Rows, *, passages: Sequence[str]) -> None:
    """Raise DataError if two passages of one person overlap in time.

    `passages`, (N,), are the ids of the tracks.
    """
    if rows.people is None or tracks.person is None:
        return
    start = tracks.t[tracks.offsets[:-1]]
    end = tracks.t[tracks.offsets[1:] - 1]
    latest: dict[str, int] = {}  # The track of each person that ends last so far.
    for row in np.argsort(start, kind="stable").tolist():
        person = tracks.person[row]
        before = latest.get(person, row)
        if before != row and start[row] <= end[before]:
            first, second = passages[before], passages[row]
            raise DataError(
                f"{rows.place.path}, {rows.place.unit} {rows.people[second].line}:"
                f" person {person} walks passage {second} from {start[row]:.4g} s on"
                f" and passage {first} ({rows.place.unit} {rows.people[first].line})"
                f" until {end[before]:.4g} s, in two places at once; correct a label,"
                " or remove it"
            )
        if before == row or end[row] > end[before]:
            latest[person] = row
