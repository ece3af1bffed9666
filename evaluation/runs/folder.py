"""The run folder: a manifest that can start the run again, and what a run leaves beside it.

The parent alone writes; a file is there whole or not at all.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import shutil
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import isac_track
from evaluation.experiment.fingerprint import can_be_found, source_digest
from evaluation.runs.cell_files import label_of, sound_files
from evaluation.runs.checksums import FOLDER, forget_missing
from evaluation.runs.files import write_whole
from evaluation.runs.lock import LOCK
from evaluation.runs.manifest_shape import CELL_NAME, LAYOUT, defect_of
from isac_track.errors import DataError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from evaluation.runs.cell_files import Index


MANIFEST = "manifest.json"
_TABLES = (
    "summary.csv",
    "paper_table.csv",
    "paper_claims.csv",
    "matched.csv",
    "decisions.csv",
    "curves.csv",
    "flags.json",
    "linkability.csv",
    "verdict.json",
    "report.html",
    "gallery.parquet",
    "SHA256SUMS",
    "failed.csv",
)
_TEX = ("sweep.tex", "attacks.tex", "paper.tex", "linkability.tex", "verdict.tex")
_SHOWN_DIFFERENCES = 3
_LIBRARIES = ("numpy", "scipy", "pandas", "pyarrow")


@contextlib.contextmanager
def usable(out: Path) -> Iterator[None]:
    """Tell in one line what the system says of a run folder within.

    Raises
    ------
    SettingsError
        If no folder can have that name, or it cannot be entered, read or changed.
    """
    try:
        is_name = b"\0" not in os.fsencode(out)
    except UnicodeEncodeError:
        is_name = False
    if not is_name:
        raise SettingsError(f"{str(out)!a} cannot be the name of a folder; choose another --out")
    try:
        yield
    except OSError as error:
        where = error.filename or out
        raise SettingsError(f"cannot use {where}: {error.strerror}; choose another --out") from None


def check_folder(out: Path) -> None:
    """Raise SettingsError if a folder holds something that is no run, or cannot be entered."""
    with usable(out):
        if out.exists() and not out.is_dir():
            raise SettingsError(f"{out} is a file; choose another --out")
        if (
            out.exists()
            and not (out / MANIFEST).exists()
            and not all(_is_of_a_start(one) for one in out.iterdir())
        ):
            raise SettingsError(f"{out} is not empty and holds no run; choose another --out")


def _is_of_a_start(path: Path) -> bool:
    """Whether a run leaves this if it is killed before its manifest is there."""
    if path.name == FOLDER:
        return path.is_dir() and not any(path.iterdir())
    return path.name in (LOCK, f".{MANIFEST}.tmp")


def open_run(
    out: Path, *, identity: dict[str, Any], fresh: bool
) -> tuple[dict[str, Any], dict[str, Index], list[str]]:
    """Return the manifest of a run folder, new or continued, and the files that it has.

    Cells that another version of the code computed are dropped from it and counted. `SHA256SUMS`
    has no line then for which there is no cell.

    Returns
    -------
    manifest : dict
    files : dict
        What the files of cells hold that are as they were written.
    damaged : list of str
        Names of the others.

    Raises
    ------
    SettingsError
        If the folder holds another run (what differs is named) or something else, or cannot be
        used.
    DataError
        If its manifest cannot be read, or is damaged and not to be replaced.
    """
    manifest: dict[str, Any] = {
        "layout": LAYOUT,
        "identity": identity,
        "cells": [],
        "dropped_cells": 0,
    }
    with usable(out):
        is_there = (out / MANIFEST).exists()
        if fresh and is_there:
            found = _parsed(out)
            _remove_run(out, found if not defect_of(found) else {"cells": []})
        elif is_there:
            manifest |= _undamaged(_parsed(out), out=out)
            _refuse_another(out, manifest["identity"], identity)
        (out / FOLDER).mkdir(parents=True, exist_ok=True)
        files, damaged = sound_files(
            out, [name for entry in manifest["cells"] for name in entry["files"]]
        )
        manifest, files = _without_other_code(out, manifest, files)
        forget_missing(out)
    return manifest, files, damaged


def _without_other_code(
    out: Path, manifest: dict[str, Any], files: dict[str, Index]
) -> tuple[dict[str, Any], dict[str, Index]]:
    """Drop the cells whose code is not what is here now, and the files that hold no others.

    Code that is not here at all cannot be told to be another.
    """
    modules = {
        module
        for index in files.values()
        for code in (index.code, *(held.code for held in index.consumers.values()))
        for module in code
    }
    here = {name: source_digest(name)[:16] for name in modules if can_be_found(name)}
    current = {
        name: {
            label
            for label, held in index.consumers.items()
            if all(
                here.get(name, one) == one
                for name, one in (*index.code.items(), *held.code.items())
            )
        }
        for name, index in files.items()
    }
    cells = [
        entry
        for entry in manifest["cells"]
        if all(label_of(entry) in current.get(name, (label_of(entry),)) for name in entry["files"])
    ]
    dropped = sum(len(entry["files"]) for entry in manifest["cells"]) - sum(
        len(entry["files"]) for entry in cells
    )
    for name in [name for name in files if not current[name]]:
        (out / FOLDER / name).unlink(missing_ok=True)
        del files[name]
    return manifest | {"cells": cells} | ({"dropped_cells": dropped} if dropped else {}), files


def _refuse_another(out: Path, earlier: dict[str, Any], identity: dict[str, Any]) -> None:
    different = [
        f"{key} {earlier.get(key)!r} -> {value!r}"
        for key, value in identity.items()
        if earlier.get(key) != value
    ]
    if different:
        more = "; ..." if len(different) > _SHOWN_DIFFERENCES else ""
        raise SettingsError(
            f"{out} holds another run ({'; '.join(different[:_SHOWN_DIFFERENCES])}{more}); "
            "use --fresh to replace it or another --out"
        )


def read_manifest(out: Path) -> dict[str, Any]:
    """Return the manifest of a run folder; all that its readers rely on is there.

    Raises
    ------
    DataError
        If there is none, it cannot be read or is damaged, or the run never started.
    """
    manifest = _undamaged(_parsed(out), out=out)
    if not manifest.keys() >= {"dataset", "settings"}:
        raise DataError(f"{out} holds a run that never started; run the matrix again")
    return manifest


def _parsed(out: Path) -> dict[str, Any]:
    """Return what the manifest holds, if it is one at all."""
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


def _undamaged(manifest: dict[str, Any], *, out: Path) -> dict[str, Any]:
    defect = defect_of(manifest)
    if defect:
        raise DataError(
            f"{out} was written by another version, or its {MANIFEST} is damaged "
            f"({ascii(defect)[1:-1]}); run the matrix again with --fresh or another --out"
        )
    return manifest


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole or not at all."""
    text = json.dumps(manifest, indent=1, ensure_ascii=False) + "\n"
    write_whole(out / MANIFEST, text.encode())


def environment() -> dict[str, Any]:
    """Return what else a run depends on: versions, machine type and commit."""
    libraries = {}
    for name in _LIBRARIES:
        try:
            libraries[name] = version(name)
        except PackageNotFoundError:  # pragma: no cover - all are dependencies
            libraries[name] = "?"
    return {
        "isac_track": isac_track.__version__,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "libraries": libraries,
        "git_commit": _git_commit(),
        "command": [word.encode(errors="replace").decode() for word in sys.argv],
    }


def _remove_run(out: Path, manifest: Mapping[str, Any]) -> None:
    """Delete what a run wrote, by name: the folder may hold what is not ours. Manifest last."""
    ours = [out / FOLDER / name for entry in manifest["cells"] for name in entry["files"]]
    ours += [path for path in (out / FOLDER).glob("*.parquet") if CELL_NAME.fullmatch(path.name)]
    ours += _figures(out, manifest)
    ours += [out / "tables" / name for name in _TEX]
    ours += [out / name for name in _TABLES]
    try:
        for path in ours:
            path.unlink(missing_ok=True)
        for folder in (FOLDER, "figures", "tables"):
            if (out / folder).is_dir() and not any((out / folder).iterdir()):
                (out / folder).rmdir()
        (out / MANIFEST).unlink()
    except OSError as error:
        raise SettingsError(
            f"cannot replace the run in {out}: {error.strerror}; choose another --out"
        ) from None


def note_figures(out: Path, names: Sequence[str]) -> None:
    """Write into the manifest which figures a report draws, before it does, to find them again."""
    write_manifest(out, read_manifest(out) | {"figures": list(names)})


def remove_figures(out: Path) -> None:
    """Delete the page and the figures that an earlier report drew.

    Raises
    ------
    DataError
        If the folder cannot be written.
    """
    for path in (out / "report.html", *_figures(out, read_manifest(out))):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise DataError(
                f"cannot replace {path}: {error.strerror}; finished cells are kept"
            ) from None


def _figures(out: Path, manifest: Mapping[str, Any]) -> list[Path]:
    """Return every file that a report may have drawn: svg for screens, pdf for print."""
    names = [Path(name).name for name in manifest.get("figures", ())]
    return [out / "figures" / f"{name}.{kind}" for name in names for kind in ("svg", "pdf")]


def _git_commit() -> str | None:
    root = Path(isac_track.__file__).parent.parent
    if not (root / ".git").exists():
        return None
    git = shutil.which("git")
    if git is None:
        return None
    answer = subprocess.run(  # noqa: S603 - a fixed command
        [git, "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"],
        capture_output=True,
        text=True,
        check=False,
    )
    return answer.stdout.strip() or None
