"""What a manifest must look like, so that whoever reads one need not look at each value."""

from __future__ import annotations

import re
import reprlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

CELL_NAME = re.compile(r"[A-Za-z0-9.=-]{1,80}_[0-9]{5}_[0-9a-f]{16}\.parquet")
LAYOUT = 2
"""Of the folder: a file of cells for each unit of work, where each consumer had its own before."""
_LARGEST = 1e300


def _anything(_value: object) -> bool:
    return True


def _text(value: object) -> bool:
    return isinstance(value, str)


def _text_or_none(value: object) -> bool:
    return value is None or isinstance(value, str)


def _flag(value: object) -> bool:
    return isinstance(value, bool)


def _count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < _LARGEST


def _number(value: object) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and -_LARGEST < value < _LARGEST  # type: ignore[operator]


def _number_or_none(value: object) -> bool:
    return value is None or _number(value)


def _plain(value: object) -> bool:
    return value is None or isinstance(value, str | bool) or _number(value)


def _kind(value: object) -> bool:
    return value in ("shared", "predictor", "attack", "linkage", "control", "windows")


def _files(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) > 0
        and all(isinstance(name, str) and CELL_NAME.fullmatch(name) for name in value)
    )


def _groups(value: object) -> bool:
    """Whether each group is there once: its place in the list is its row in the bootstrap."""
    return (
        isinstance(value, list)
        and len(value) > 0
        and all(isinstance(name, str) for name in value)
        and len(set(value)) == len(value)
    )


_SHAPE = {
    "layout?": _count,
    "identity": {"seed": _count, "scenes": _count, "sha256?": _text, "*": _plain},
    "cells": [
        {
            **dict.fromkeys(("mechanism", "family", "adding", "spec"), _text),
            **dict.fromkeys(("consumer", "knowledge"), _text),
            "level": _number_or_none,
            "kind": _kind,
            "slow?": _flag,
            "files": _files,
        }
    ],
    "dropped_cells?": _count,
    "damaged_cells?": [_text],
    "code?": _text,
    "state?": _text,
    "wall_time_s?": _number,
    "environment?": {"libraries?": {"*": _text}, "command?": [_text], "*": _text_or_none},
    "settings?": {
        "preset?": _text,
        "scenes?": _count,
        "seed?": _count,
        **{f"{axis}?": [_text] for axis in ("mechanisms", "predictors", "attacks", "tasks")},
        "stages?": {"*": _plain},
    },
    "dataset?": {
        **{f"{name}?": _text for name in ("name", "path", "sha256", "format")},
        **{f"{name}?": _count for name in ("tracks", "tracks_used")},
        "simulated?": _flag,
        "notice?": _text_or_none,
    },
    "history?": {"points": _number, "interval_s": _number},
    "figures?": [_text],
    "groups?": _groups,
    "linkage?": {
        "skipped?": {"*": _text},
        "tasks?": {"*": {"about": _text, "people": _count, "candidates": {"*": _count}}},
    },
    "failed?": [
        {
            **dict.fromkeys(("spec", "kind", "consumer", "knowledge", "why"), _text),
            "block": _count,
        }
    ],
}
"""What readers of a manifest rely on: of a table its names (`?`: it may be missing, `*`: all
others), of a list its one kind of member, and of a value a question that it must pass."""
_WITH_CELLS = {
    "environment": (),
    "settings": (
        *("preset", "scenes", "seed", "stages"),
        *("mechanisms", "predictors", "attacks", "tasks"),
    ),
    "dataset": ("name", "path", "sha256", "format", "simulated", "tracks", "tracks_used"),
    "history": (),
    "groups": (),
}
"""What may be missing as long as there are no cells."""


def defect_of(manifest: dict[str, Any]) -> str:
    """Return what readers of a manifest would stumble over, and where; "" if nothing."""
    if manifest.get("layout") != LAYOUT and manifest["cells"]:
        return "its cells are laid out in another way"
    defect = _misfit(manifest, _SHAPE).lstrip(".")
    if defect or not manifest["cells"]:
        return defect
    for part, names in _WITH_CELLS.items():
        missing = [name for name in names if name not in manifest.get(part, ())]
        if part not in manifest or missing:
            return ".".join([part, *missing[:1]]) + " is missing"
    return _unmatched(manifest["cells"])


def _unmatched(entries: list[dict[str, Any]]) -> str:
    """Return which cell is of nobody that there is, or lacks its ceiling; "" if none."""
    from attacks.tasks.controls import CONTROLS  # noqa: PLC0415 - most of this module needs no attacks
    from isac_track.protocols import ADVERSARIES  # noqa: PLC0415

    ceilings = {
        (entry["consumer"], entry["knowledge"])
        for entry in entries
        if entry["mechanism"] == "clean" and entry["kind"] == "linkage"
    }
    for place, entry in enumerate(entries):
        kind, consumer, knowledge = (entry[name] for name in ("kind", "consumer", "knowledge"))
        if knowledge not in (ADVERSARIES if kind in {"attack", "linkage"} else {""}):
            return f"cells[{place}].knowledge is {knowledge!r}"
        if kind == "control" and consumer.partition("/control-")[2] not in CONTROLS:
            return f"cells[{place}].consumer is {consumer!r}"
        if kind == "linkage" and (consumer, knowledge) not in ceilings:
            return f"cells[{place}] has no ceiling"
    return ""


def _misfit(value: Any, shape: Any, *, place: str = "") -> str:  # noqa: ANN401 - as JSON has it
    """Return where a value is not of a shape (see `_SHAPE`); "" if it is."""
    parts: Iterable[tuple[str, Any, Any]]
    if isinstance(shape, list):
        if not isinstance(value, list):
            return f"{place} is no list"
        parts = ((f"{place}[{row}]", one, shape[0]) for row, one in enumerate(value))
    elif isinstance(shape, dict):
        if not isinstance(value, dict):
            return f"{place} is no table"
        for name in shape:
            if name[-1] not in "?*" and name not in value:
                return f"{place}.{name} is missing"
        others = shape.get("*", _anything)
        parts = (
            (f"{place}.{name}", one, shape.get(name, shape.get(f"{name}?", others)))
            for name, one in value.items()
        )
    else:
        return "" if shape(value) else f"{place} is {reprlib.repr(value)}"
    return next((wrong for where, *of in parts if (wrong := _misfit(*of, place=where))), "")
