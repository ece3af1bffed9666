"""Names of people in a run folder: keyed pseudonyms, whose key never leaves the folder.

A person has an *id* in the recording, a *name* in cells, which is a pseudonym of the id,
and a *label* in results, such as `#000123a`.

`private.json` (mode 0600) holds the key and the path of the recording. `people.json`
lists the names in cells, each with the label that readers use instead. Labels sort as
the ids of the recording do and end in the person's half, so that no draw, order or fold
depends on the key.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from evaluation.store.files import PEOPLE, PRIVATE, read_regular_file, write_whole
from isac_track.errors import DataError

if TYPE_CHECKING:
    from evaluation.plan.plan import Plan

# Of a pseudonym: two of 100,000 people share one once in 10^9 runs.
_DIGITS: Final = 16
_LABEL_DIGITS: Final = 6
_HALVES: Final = "ab"


def in_first_half(name: str) -> bool:
    """Whether a person is in the first half, by a hash of the id that labels carry.

    For cross-fitting: attacks are chosen on one half and scored on the other.
    """
    if name.startswith("#") and name.endswith(tuple(_HALVES)):
        return name.endswith(_HALVES[0])
    return hashlib.sha256(name.encode()).digest()[0] % 2 == 0


def id_labels(plan: Plan) -> dict[str, str]:
    """Return the label of every id of a run: labels sort as the ids do in every run.

    The label of a recorded id is its place in the sorted ids. Simulated people of a
    crowd stand between them, by name.
    """
    tracks = plan.dataset.tracks
    own = sorted(
        {
            *tracks.source,
            *tracks.group,
            *plan.scene_tracks.source,
            *plan.scene_tracks.group,
        }
    )
    place_by_name = {name: place for place, name in enumerate(own, start=1)}
    task_names: set[str] = set()
    for windows in (*plan.task_windows, *plan.model_task_windows):
        task_names.update(windows.source, windows.group)
    labels = {}
    for name in own:
        labels[name] = f"#{place_by_name[name]:0{_LABEL_DIGITS}d}{_half(name)}"
    for name in sorted(task_names - place_by_name.keys()):
        before = f"#{bisect_left(own, name):0{_LABEL_DIGITS}d}"
        # "!" sorts below all characters that a longer name may go on with.
        labels[name] = f"{before}~{name}!{_half(name)}"
    return labels


def _half(name: str) -> str:
    return _HALVES[hashlib.sha256(name.encode()).digest()[0] % 2]


def prepare_names(plan: Plan, *, is_continued: bool) -> dict[str, str]:
    """Write the two files of names of a run; return the name of every id in its files.

    Raises DataError for a run that is continued without its key, and if a file cannot
    be written.
    """
    out, labels = plan.out, id_labels(plan)
    private = _read_private(out)
    if is_continued and "key" not in private:
        raise DataError(
            f"{out / PRIVATE} with the key of this run's pseudonyms is missing (a"
            " published copy has none): the run cannot be continued; use --fresh or"
            " another --out"
        )
    key = str(private.get("key") or secrets.token_hex(32))
    paths = [str(Path(session).absolute()) for session in plan.dataset.sessions]
    recording = {"path": str(Path(plan.dataset.path).absolute()), "sessions": paths}
    _write_private(out, {"key": key, **recording})
    keeps = plan.settings.keep_ids
    name_by_id = {name: name if keeps else pseudonym(name, key) for name in labels}
    earlier = _read_people(out) if is_continued else {}
    rows = earlier | {name_by_id[name]: label for name, label in labels.items()}
    content = json.dumps(rows, ensure_ascii=False, indent=0) + "\n"
    if rows != earlier:
        write_whole(out / PEOPLE, content.encode())
    return {} if keeps else name_by_id


def pseudonym(name: str, key: str) -> str:
    """Return the pseudonym of an id: nobody finds the id without the key."""
    return hmac.digest(bytes.fromhex(key), name.encode(), "sha256").hex()[:_DIGITS]


def share_key(out: Path, sources: Iterable[Path]) -> None:
    """Copy the key of the first source that has one, before its cells are copied.

    A folder that has a key keeps it.
    """
    for source in sources:
        if not _read_private(out) and (private := _read_private(source)):
            _write_private(out, private)


def with_paths(out: Path, manifest: dict[str, Any]) -> dict[str, Any]:
    """Return a manifest with the paths of its recording, if they are still known."""
    paths = {
        name: path
        for name, path in _read_private(out).items()
        if name != "key" and path
    }
    return manifest | {"dataset": manifest["dataset"] | paths}


def read_labels(out: Path) -> Mapping[str, str]:
    """Return the label of every name in the cells of a folder.

    Raises DataError if the list is broken.
    """
    path = out / PEOPLE
    try:
        stat = path.stat()
    except FileNotFoundError:
        return {}  # cells that no run has written are read as they are
    return _read_labels(path, stat.st_mtime_ns, stat.st_size)


# The lists of the newest four runs of a comparison; a changed file is read again.
@lru_cache(maxsize=4)
def _read_labels(path: Path, _changed_ns: int, _size: int) -> Mapping[str, str]:
    return _read_people(path.parent)


def _read_people(out: Path) -> dict[str, str]:
    people = _read_json(out / PEOPLE)
    if not all(isinstance(label, str) for label in people.values()):
        raise DataError(
            f"{out / PEOPLE} is no list of people; run the matrix with --fresh"
        )
    return people


def _read_private(out: Path) -> dict[str, Any]:
    private = _read_json(out / PRIVATE)
    try:
        bytes.fromhex(private.get("key", ""))
    except (TypeError, ValueError) as error:
        raise _unreadable(out / PRIVATE, error) from None
    return private


def _read_json(path: Path) -> dict[str, Any]:
    """Return the object that a JSON file holds; an empty object if there is no file."""
    try:
        content = json.loads(read_regular_file(path))
        if not isinstance(content, dict):
            raise ValueError("it is no JSON object")  # noqa: TRY301, TRY004 - see below
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise _unreadable(path, error) from None
    return content


def _unreadable(path: Path, error: Exception) -> DataError:
    return DataError(f"{path} cannot be read: {error}; run the matrix with --fresh")


def _write_private(out: Path, content: Mapping[str, Any]) -> None:
    """Write the private file, which only its owner can read from the first byte on."""
    text = json.dumps(dict(content), indent=1) + "\n"
    write_whole(out / PRIVATE, text.encode(), mode=0o600)
