"""The manifest of a run: what it was made from, its cells, and what failed.

Within the program `cells` is a list of flat entries, one for each consumer at each level. In the
file an entry stands for all consumers of a level that share their files, and sets of consumers that
many levels have are written once, in `consumers`.
"""

from __future__ import annotations

import json
import re
import reprlib
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final

from attacks.tasks.controls import CONTROLS
from evaluation.runs.files import MANIFEST, write_whole
from isac_track.errors import DataError
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

CELL_NAME: Final = re.compile(r"[A-Za-z0-9.=-]{1,80}_[0-9]{5}_[0-9a-f]{16}\.parquet")
LAYOUT: Final = 2
"""Of the folder: a file of cells for each unit of work, where each consumer had its own before."""
FAILED_COLUMNS: Final = ("spec", "kind", "consumer", "knowledge", "block", "why")
_LARGEST: Final = 1e300
_OF_LEVEL: Final = ("mechanism", "level", "family", "adding", "spec", "files")
_OF_CONSUMER: Final = ("kind", "consumer", "knowledge", "slow")
_KINDS: Final = ("shared", "predictor", "attack", "linkage", "control", "windows")
_IS: Final[dict[str, Callable[[Any], object]]] = {
    "anything": lambda _value: True,
    "text": lambda value: isinstance(value, str),
    "text?": lambda value: value is None or isinstance(value, str),
    "flag": lambda value: isinstance(value, bool),
    "count": lambda value: type(value) is int and 0 <= value < _LARGEST,
    "number": lambda value: type(value) in (int, float) and -_LARGEST < value < _LARGEST,
    "number?": lambda value: value is None or _IS["number"](value),
    "plain": lambda value: value is None or isinstance(value, str | bool) or _IS["number"](value),
    "kind": lambda value: value in _KINDS,
    "names": lambda value: (
        isinstance(value, list)
        and all(isinstance(name, str) for name in value)
        and 0 < len(set(value)) == len(value)
    ),
    "files": lambda value: _IS["names"](value) and all(map(CELL_NAME.fullmatch, value)),
}
_SHAPE: Final = {
    "layout?": "count",
    "identity": {"seed": "count", "scenes": "count", "sha256?": "text", "*": "plain"},
    "cells": [
        {
            **dict.fromkeys(("mechanism", "family", "adding", "spec"), "text"),
            "level": "number?",
            "files": "files",
            "consumers": "count",
        }
    ],
    "consumers!": [[{"kind": "kind", "consumer": "text", "knowledge": "text", "slow": "flag"}]],
    "dropped_cells?": "count",
    "damaged_cells?": ["text"],
    "code?": "text",
    "state?": "text",
    "wall_time_s?": "number",
    "environment!": {"libraries?": {"*": "text"}, "command?": ["text"], "*": "text?"},
    "settings!": {
        "preset!": "text",
        "scenes!": "count",
        "seed!": "count",
        "stages!": {"*": "plain"},
        **{f"{axis}!": ["text"] for axis in ("mechanisms", "predictors", "attacks", "tasks")},
    },
    "dataset!": {
        **{f"{name}!": "text" for name in ("name", "path", "sha256", "format")},
        "tracks!": "count",
        "tracks_used!": "count",
        "simulated!": "flag",
        "notice?": "text?",
    },
    "history!": {"points": "number", "interval_s": "number"},
    "figures?": ["text"],
    "groups!": "names",
    "linkage?": {
        "skipped?": {"*": "text"},
        "tasks?": {"*": {"about": "text", "people": "count", "candidates": {"*": "count"}}},
    },
    "failed?": [dict.fromkeys(FAILED_COLUMNS, "text") | {"block": "count"}],
}
"""What readers of a manifest rely on: of a table its names (`?`: it may be missing, `!`: it may as
long as there are no cells, `*`: all others), of a list its one kind of member, and of a value what
it is."""


def read_manifest(out: Path) -> dict[str, Any]:
    """Return the manifest of a run folder; all that its readers rely on is there.

    Raises DataError if there is none, it cannot be read or is damaged, or the run never started.
    """
    manifest = undamaged(parsed(out), out=out)
    if not manifest.keys() >= {"dataset", "settings"}:
        raise DataError(f"{out} holds a run that never started; run the matrix again")
    return manifest


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole or not at all."""
    consumers: list[list[dict[str, Any]]] = []
    cells = []
    for level, entries in groupby(manifest["cells"], key=lambda one: _part(one, _OF_LEVEL)):
        alike = [_part(one, _OF_CONSUMER) for one in entries]
        if alike not in consumers:
            consumers.append(alike)
        cells.append(level | {"consumers": consumers.index(alike)})
    folded = {**manifest, "cells": cells, "consumers": consumers}
    text = json.dumps(folded, indent=1, ensure_ascii=False) + "\n"
    write_whole(out / MANIFEST, text.encode())


def _part(entry: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    return {name: entry[name] for name in names}


def parsed(out: Path) -> dict[str, Any]:
    """Return what the manifest's file holds, if it is one at all; DataError if not."""
    path = out / MANIFEST
    try:
        text = path.read_text(encoding="utf-8")
        manifest = json.loads(text)
        if "\\u" in text:  # half a surrogate pair: no file could be written with it
            json.dumps(manifest, ensure_ascii=False).encode()
    except FileNotFoundError:
        raise DataError(
            f"{out} holds no run ({MANIFEST} is missing); make one with "
            "python -m evaluation.matrix --out DIR"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{path} cannot be read: {error}; choose another --out") from None
    parts = {"identity": dict, "cells": list}
    if not isinstance(manifest, dict) or not all(
        isinstance(manifest.get(name), kind) for name, kind in parts.items()
    ):
        raise DataError(f"{path} is not the manifest of a run; choose another --out")
    return manifest


def undamaged(found: dict[str, Any], *, out: Path) -> dict[str, Any]:
    """Return the manifest that a file holds; DataError if a reader would stumble over it."""
    cells: list[dict[str, Any]] = []
    defect = _defect(found)
    if not defect:
        consumers = found.pop("consumers", [])
        for level in found["cells"]:
            alike = consumers[level.pop("consumers")]
            cells += [level | consumer for consumer in alike]
        defect = _unmatched(cells)
    if defect:
        raise DataError(
            f"{out} was written by another version, or its {MANIFEST} is damaged "
            f"({ascii(defect)[1:-1]}); run the matrix again with --fresh or another --out"
        )
    return found | {"cells": cells}


def _defect(found: Mapping[str, Any]) -> str:
    """Return what is not as it should be in a manifest's file, and where; "" if nothing."""
    if not found["cells"]:
        return _misfit(found, _SHAPE, optional="?!*").lstrip(".")
    if found.get("layout") != LAYOUT:
        return "its cells are laid out in another way"
    defect = _misfit(found, _SHAPE, optional="?*").lstrip(".")
    last = 0 if defect else max(level["consumers"] for level in found["cells"])
    if not defect and last >= len(found["consumers"]):
        return f"cells name consumers[{last}]"
    return defect


def _unmatched(entries: list[dict[str, Any]]) -> str:
    """Return which cell is of nobody that there is, or lacks its ceiling; "" if none."""
    whole = {id(one) for one in with_ceiling(entries)}
    for entry in entries:
        kind, consumer, knowledge = (entry[name] for name in ("kind", "consumer", "knowledge"))
        where = f"of {consumer} at {entry['spec']}"
        if knowledge not in (ADVERSARIES if kind in {"attack", "linkage"} else {""}):
            return f"knowledge {where} is {knowledge!r}"
        if kind == "control" and consumer.partition("/control-")[2] not in CONTROLS:
            return f"{consumer} is no control"
        if id(entry) not in whole:
            return f"the ceiling {where} is missing"
    return ""


def _misfit(value: Any, shape: Any, *, optional: str, place: str = "") -> str:  # noqa: ANN401 - as JSON has it
    """Return where a value is not of a shape (see `_SHAPE`); "" if it is."""
    if isinstance(shape, str):
        return "" if _IS[shape](value) else f"{place} is {reprlib.repr(value)}"
    parts: Iterable[tuple[str, Any, Any]]
    if isinstance(shape, list):
        if not isinstance(value, list):
            return f"{place} is no list"
        parts = ((f"{place}[{row}]", one, shape[0]) for row, one in enumerate(value))
    else:
        if not isinstance(value, dict):
            return f"{place} is no table"
        known = {name.rstrip("?!"): inner for name, inner in shape.items()}
        for name in shape:
            if name[-1] not in optional and name.rstrip("!") not in value:
                return f"{place}.{name.rstrip('!')} is missing"
        others = known.get("*", "anything")
        parts = ((f"{place}.{name}", one, known.get(name, others)) for name, one in value.items())
    wrong = (_misfit(one, inner, optional=optional, place=at) for at, one, inner in parts)
    return next(filter(None, wrong), "")


def others(
    entries: Iterable[dict[str, Any]], *, than: Iterable[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the entries of other consumers at other levels."""
    key = ("spec", "consumer", "knowledge")
    known = {tuple(entry[name] for name in key) for entry in than}
    return [entry for entry in entries if tuple(entry[name] for name in key) not in known]


def with_ceiling(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the index without what is linked without a ceiling.

    What an attack says when it finds nothing depends on it.
    """
    ceilings = {
        (entry["consumer"], entry["knowledge"]) for entry in entries if entry["spec"] == "clean"
    }
    return [
        entry
        for entry in entries
        if entry["kind"] != "linkage" or (entry["consumer"], entry["knowledge"]) in ceilings
    ]
