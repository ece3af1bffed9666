"""Open a run folder, refuse a folder of another run, replace and copy runs."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluation.plan.presets import DEFAULT
from evaluation.plan.source_digest import ModuleFiles, has_source, short_digest
from evaluation.store import files
from evaluation.store.cell_index import FileIndex, UnitIndex, sound_files
from evaluation.store.checksums import check_sound, drop_stale_checksums, write_checked
from evaluation.store.entries import Entry
from evaluation.store.manifest import (
    CELL_FILE_NAME,
    file_names,
    load_manifest_json,
    parse_manifest,
    read_manifest,
    write_manifest,
)
from isac_track.errors import DataError, SettingsError

_SHOWN_DIFFERENCES = 3


@contextlib.contextmanager
def usable(out: Path) -> Iterator[None]:
    """Turn an impossible folder name, and any OSError within, into a SettingsError."""
    name = str(out)
    if "\0" in name or name.encode(errors="ignore").decode() != name:
        raise SettingsError(
            f"{name!a} cannot be the name of a folder; choose another --out"
        )
    try:
        yield
    except OSError as error:
        place = error.filename or out
        raise SettingsError(
            f"cannot use {place}: {error.strerror}; choose another --out"
        ) from None


def check_folder(out: Path) -> None:
    """Raise SettingsError if a folder holds other files than a run, or is no folder."""
    with usable(out):
        existing = next(
            path for path in (out, *out.absolute().parents) if path.exists()
        )
        if not existing.is_dir():
            place = existing if existing == out else f"{out}: {existing}"
            raise SettingsError(f"{place} is a file; choose another --out")
        if not out.exists() or (out / files.MANIFEST).exists():
            return
        # A run that was killed before it wrote its manifest leaves some files.
        left_files = {files.LOCK, files.PLUGIN_ERROR, files.PEOPLE, files.PRIVATE}
        for path in out.iterdir():
            may_be_left = path.name in left_files or files.is_temporary(path.name)
            is_empty = (
                path.name == files.CELLS_FOLDER
                and path.is_dir()
                and not any(path.iterdir())
            )
            if not (may_be_left or is_empty):
                raise SettingsError(
                    f"{out} is not empty and holds no run; choose another --out"
                )


def check_preset(out: Path, *, preset: str) -> None:
    """Raise SettingsError if a folder has another preset's run, and either is `quick`.

    `quick` is the preset of a command that names none. Continued, the run would have the
    levels of both presets, as no single command does.
    A manifest that cannot be read passes: `open_run` reports it.
    """
    with contextlib.suppress(DataError):
        earlier = read_manifest(out)["settings"].get("preset", preset)
        if earlier != preset and DEFAULT in {earlier, preset}:
            raise SettingsError(
                f"{out} holds a run of --preset {earlier}, not of {preset}; "
                "use --fresh to replace it or another --out"
            )


@dataclass(frozen=True, eq=False, slots=True)
class OpenedRun:
    """A run folder that was opened."""

    manifest: dict[str, Any]
    index_by_file: dict[str, FileIndex]  # Of the sound files of cells.
    damaged: list[str]  # Names of the others.


def open_run(out: Path, *, identity: dict[str, Any], fresh: bool) -> OpenedRun:
    """Open a run folder, new or continued.

    Cells that another version of the code computed are dropped and counted, and so are
    lines of `SHA256SUMS` without a cell.

    Raises SettingsError if the folder holds another run (it names the differences) or
    cannot be used, and DataError if its manifest cannot be read, or is damaged and not
    to be replaced.
    """
    manifest: dict[str, Any] = {"identity": identity, "cells": [], "dropped_cells": 0}
    with usable(out):
        is_there = (out / files.MANIFEST).exists()
        if fresh and is_there:
            _remove_run(out)
        elif is_there:
            manifest |= parse_manifest(load_manifest_json(out), out=out)
            refuse_other_run(manifest["identity"], identity, out=out)
        (out / files.CELLS_FOLDER).mkdir(parents=True, exist_ok=True)
        sound = sound_files(out, file_names(manifest))
        _drop_other_code(out, manifest, sound.index_by_file)
        drop_stale_checksums(out)
    return OpenedRun(manifest, sound.index_by_file, sound.damaged)


def refuse_other_run(
    earlier: Mapping[str, Any], identity: Mapping[str, Any], *, out: Path
) -> None:
    """Raise SettingsError with the differences if a folder holds another run."""
    different = [
        f"{key} {earlier.get(key)!r} -> {value!r}"
        for key, value in identity.items()
        if earlier.get(key) != value
    ]
    if different:
        more = "; ..." if len(different) > _SHOWN_DIFFERENCES else ""
        raise SettingsError(
            f"{out} holds another run"
            f" ({'; '.join(different[:_SHOWN_DIFFERENCES])}{more}); use --fresh to"
            " replace it or another --out"
        )


def _drop_other_code(
    out: Path, manifest: dict[str, Any], index_by_file: dict[str, FileIndex]
) -> None:
    """Drop cells whose code has changed here, and delete files that hold no others.

    They are dropped from the manifest and from the index, in place.
    """
    digests = _digests_here(index_by_file)
    earlier = manifest["cells"]
    cells = _current_cells(earlier, index_by_file, digests)
    n_dropped = sum(len(entry.files) for entry in earlier)
    n_dropped -= sum(len(entry.files) for entry in cells)
    manifest["cells"] = cells
    # If nothing is dropped now, the count of an earlier start stays.
    manifest["dropped_cells"] = n_dropped or manifest["dropped_cells"]
    for name in _outdated_files(index_by_file, digests):
        (out / files.CELLS_FOLDER / name).unlink(missing_ok=True)
        del index_by_file[name]


def _digests_here(index_by_file: Mapping[str, FileIndex]) -> dict[str, str]:
    """Return the digest of the source here of each module that computed some cells.

    By name; a module that has no source here is left out.
    """
    units = [unit for index in index_by_file.values() for unit in index.units.values()]
    modules = {module for unit in units for module in unit.code}
    for unit in units:
        for consumer in unit.consumers.values():
            modules.update(consumer.code)
    known: ModuleFiles = {}
    return {
        name: short_digest(name, known=known) for name in modules if has_source(name)
    }


def _is_unchanged(unit: UnitIndex, label: str, digests: Mapping[str, str]) -> bool:
    """Whether the code that computed a consumer's tables is the code here."""
    code = {**unit.code, **unit.consumers[label].code}
    return all(
        digests.get(module, earlier) == earlier for module, earlier in code.items()
    )


def _current_cells(
    entries: Iterable[Entry],
    index_by_file: Mapping[str, FileIndex],
    digests: Mapping[str, str],
) -> list[Entry]:
    """Return the entries whose tables in all files are of the code here."""

    def is_current(entry: Entry, name: str) -> bool:
        # A damaged file has no index: its cells are computed again in any case.
        if name not in index_by_file:
            return True
        unit = index_by_file[name].unit_at(entry.spec)
        return (
            unit is not None
            and entry.label in unit.consumers
            and _is_unchanged(unit, entry.label, digests)
        )

    return [
        entry
        for entry in entries
        if all(is_current(entry, name) for name in entry.files)
    ]


def _outdated_files(
    index_by_file: Mapping[str, FileIndex], digests: Mapping[str, str]
) -> list[str]:
    """Return the names of files none of whose tables is of the code here."""
    return [
        name
        for name, index in index_by_file.items()
        if not any(
            _is_unchanged(unit, label, digests)
            for unit in index.units.values()
            for label in unit.consumers
        )
    ]


def _remove_run(out: Path) -> None:
    """Delete the files of a run by name, the manifest last; other files stay."""
    manifest = load_manifest_json(out)
    cells = (out / files.CELLS_FOLDER).glob("*.parquet")
    written = [path for path in cells if CELL_FILE_NAME.fullmatch(path.name)]
    written += [out / name for name in files.WRITTEN]
    with contextlib.suppress(DataError):
        written += _figures(out, parse_manifest(manifest, out=out))
    try:
        for path in written:
            path.unlink(missing_ok=True)
        for folder in files.SUBFOLDERS:
            if (out / folder).is_dir() and not any((out / folder).iterdir()):
                (out / folder).rmdir()
        (out / files.MANIFEST).unlink()
    except OSError as error:
        message = f"cannot replace the run in {out}: {error.strerror}"
        raise SettingsError(f"{message}; choose another --out") from None


def record_figures(out: Path, names: Sequence[str]) -> None:
    """Write the names of a report's figures into the manifest, before they are drawn.

    A later report finds the figures by them.
    """
    write_manifest(out, read_manifest(out) | {"figures": list(names)})


def remove_figures(out: Path) -> None:
    """Delete the page and figures of an earlier report; DataError if that fails."""
    for path in (out / files.PAGE, *_figures(out, read_manifest(out))):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            message = f"cannot replace {path}: {error.strerror}"
            raise DataError(f"{message}; finished cells stay") from None


def _figures(out: Path, manifest: Mapping[str, Any]) -> list[Path]:
    """Return all files that a report may have drawn: svg for screens, pdf for print."""
    names = [Path(name).name for name in manifest.get("figures", ())]
    return [
        out / "figures" / f"{name}.{kind}" for name in names for kind in ("svg", "pdf")
    ]


def copy_without_private(out: Path, to: Path) -> None:
    """Copy a finished run's manifest, cells and list of people: all that reports need.

    Raises SettingsError if the copy exists or cannot be written, or the run keeps its
    ids, and DataError if it is not finished, or its files have changed.
    """
    manifest = read_manifest(out)
    if manifest.get("state") != "finished":
        raise DataError(f"the run in {out} is not finished; run the matrix again")
    if manifest["identity"].get("ids") == "kept" or not (out / files.PEOPLE).exists():
        raise SettingsError(
            f"{out} keeps the recording's own ids; run the matrix without --keep-ids,"
            " anew"
        )
    names = file_names(manifest)
    check_sound(out, names, sizes=manifest.get("sizes", ()))
    try:
        to.mkdir(parents=True)
        (to / files.CELLS_FOLDER).mkdir()
        people = files.read_regular_file(out / files.PEOPLE)
        files.write_whole(to / files.PEOPLE, people)
        for name in names:
            content = files.read_regular_file(out / files.CELLS_FOLDER / name)
            write_checked(to, name, content)
        write_manifest(to, manifest)  # last: its sizes are those of the copies
    except FileExistsError:
        raise SettingsError(f"{to} exists; choose another --to") from None
    except OSError as error:
        raise SettingsError(
            f"cannot write {to}: {error.strerror}; choose another --to"
        ) from None
