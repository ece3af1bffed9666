"""The manifest of a run: its code, settings and data, its cells, and its failures.

Within the program `cells` and `failed` are lists of records (`store.entries`), one for
each consumer at each level. In the file an entry stands for all consumers of a level
that share their files, and sets of consumers that many levels have are written once, in
`consumers`.

`sizes` has the bytes of each file of cells of a finished run. A report needs every file
that it names; whether a file is whole, its checksum says (`checksums.check_sound`).

A seal over all of it shows damage, and files of other layouts: readers need not check
every value. It does not show a forgery.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from evaluation.plan.fingerprint import digest
from evaluation.store.entries import Entry, parse_entries, parse_failed
from evaluation.store.files import (
    CELLS_FOLDER,
    MANIFEST,
    read_regular_file,
    write_whole,
)
from isac_track.errors import DataError

CELL_FILE_NAME: Final = re.compile(
    r"[A-Za-z0-9.=-]{1,80}_[0-9]{5}_[0-9a-f]{16}\.parquet"
)
"""Name of a file of cells, as a run writes it."""
# The number changes whenever a reader of another would miss or mistake a value.
LAYOUT: Final = 5
# Folders that are read as well: in layout 4 each unit of work has a file of its own.
_READABLE_LAYOUTS: Final = (LAYOUT, 4)


def read_manifest(out: Path) -> dict[str, Any]:
    """Return a run's manifest; DataError if it is missing, damaged, or of no run."""
    manifest = parse_manifest(load_manifest_json(out), out=out)
    if not manifest.keys() >= {"dataset", "settings"}:
        raise DataError(f"{out} holds a run that never started; run the matrix again")
    return manifest


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole or not at all."""
    consumers: list[list[dict[str, Any]]] = []
    cells = []
    for level, entries in groupby(manifest["cells"], key=Entry.level_fields):
        level_consumers = [entry.consumer_fields() for entry in entries]
        if level_consumers not in consumers:
            consumers.append(level_consumers)
        cells.append(level | {"consumers": consumers.index(level_consumers)})
    folded = {**manifest, "cells": cells, "consumers": consumers}
    if "failed" in manifest:
        folded["failed"] = [entry.fields() for entry in manifest["failed"]]
    folded["sizes"] = _file_sizes(out, manifest)
    sealed = folded | {"seal": digest([LAYOUT, folded])}
    text = json.dumps(sealed, indent=1, ensure_ascii=False) + "\n"
    write_whole(out / MANIFEST, text.encode())


def file_names(manifest: Mapping[str, Any]) -> list[str]:
    """Return the names of the files of a manifest's cells, each once."""
    names = (name for entry in manifest["cells"] for name in entry.files)
    return list(dict.fromkeys(names))


def _file_sizes(out: Path, manifest: Mapping[str, Any]) -> dict[str, int]:
    """Return the bytes of each file of a run that is finished, by name."""
    if manifest.get("state") != "finished":
        return {}
    paths = (out / CELLS_FOLDER / name for name in file_names(manifest))
    return {path.name: path.lstat().st_size for path in paths if path.exists()}


def load_manifest_json(out: Path) -> dict[str, Any]:
    """Return the content of the manifest's file; DataError if it is no manifest."""
    path = out / MANIFEST
    try:
        manifest: dict[str, Any] = json.loads(read_regular_file(path))
    except FileNotFoundError:
        raise DataError(
            f"{out} holds no run ({MANIFEST} is missing); make one with "
            "python -m evaluation.matrix --out DIR"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(
            f"{path} cannot be read: {error}; choose another --out"
        ) from None
    match manifest:
        case {"identity": dict(), "cells": list()}:
            return manifest
    raise DataError(f"{path} is not the manifest of a run; choose another --out")


def parse_manifest(manifest: dict[str, Any], *, out: Path) -> dict[str, Any]:
    """Return the manifest that a file holds; DataError if its seal does not fit.

    DataError, too, for a name that is not that of a file of cells.
    """
    content = {name: value for name, value in manifest.items() if name != "seal"}
    seals = [digest([layout, content]) for layout in _READABLE_LAYOUTS]
    is_sealed = manifest.get("seal") in seals
    # A forger can reseal, and files are deleted by these names.
    if not is_sealed or not all(
        CELL_FILE_NAME.fullmatch(name)
        for level in content["cells"]
        for name in level["files"]
    ):
        raise DataError(
            f"{out} was written by another version, or its {MANIFEST} is damaged; "
            "run the matrix again with --fresh or another --out"
        )
    content["cells"] = parse_entries(content["cells"], content.pop("consumers"))
    if "failed" in content:
        content["failed"] = parse_failed(content["failed"])
    return content
