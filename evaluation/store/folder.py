"""The run folder: opened, refused where it is another's or something else, and replaced."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from evaluation.plan.fingerprint import can_be_found, source_digest
from evaluation.plan.presets import DEFAULT
from evaluation.store import files
from evaluation.store.cell_files import Index, sound_files
from evaluation.store.manifest import (
    CELL_NAME,
    parsed,
    read_manifest,
    undamaged,
    write_manifest,
)
from isac_track.errors import DataError, SettingsError

_SHOWN_DIFFERENCES = 3


@contextlib.contextmanager
def usable(out: Path) -> Iterator[None]:
    """Make one line, a SettingsError, of an impossible name, and of what the system says within."""
    name = str(out)
    if "\0" in name or name.encode(errors="ignore").decode() != name:
        raise SettingsError(
            f"{name!a} cannot be the name of a folder; choose another --out"
        )
    try:
        yield
    except OSError as error:
        where = error.filename or out
        raise SettingsError(
            f"cannot use {where}: {error.strerror}; choose another --out"
        ) from None


def check_folder(out: Path) -> None:
    """Raise SettingsError if a folder holds something that is no run, or cannot be entered."""
    with usable(out):
        there = next(path for path in (out, *out.absolute().parents) if path.exists())
        if not there.is_dir():
            what = there if there == out else f"{out}: {there}"
            raise SettingsError(f"{what} is a file; choose another --out")
        if not out.exists() or (out / files.MANIFEST).exists():
            return
        for path in (
            out.iterdir()
        ):  # a run that is killed before its manifest is there leaves some
            is_ours = path.name in {
                files.LOCK,
                files.PLUGIN_ERROR,
                files.PEOPLE,
                files.PRIVATE,
            } or files.is_temporary(path.name)
            is_empty = (
                path.name == files.FOLDER and path.is_dir() and not any(path.iterdir())
            )
            if not (is_ours or is_empty):
                raise SettingsError(
                    f"{out} is not empty and holds no run; choose another --out"
                )


def check_preset(out: Path, *, preset: str) -> None:
    """Raise SettingsError if a folder holds a run of another preset, and one of both is `quick`.

    The levels of other presets would add up to a run that no command makes. A manifest
    that cannot be read is left to `open_run`.
    """
    with contextlib.suppress(DataError):
        earlier = read_manifest(out)["settings"].get("preset", preset)
        if earlier != preset and DEFAULT in {earlier, preset}:
            raise SettingsError(
                f"{out} holds a run of --preset {earlier}, not of {preset}; "
                "use --fresh to replace it or another --out"
            )


def open_run(
    out: Path, *, identity: dict[str, Any], fresh: bool
) -> tuple[dict[str, Any], dict[str, Index], list[str]]:
    """Return the manifest of a run folder, new or continued, and its files: sound ones, and others.

    Cells that another version of the code computed are dropped and counted, and so are
    lines of `SHA256SUMS` for which there is no cell.

    Raises SettingsError if the folder holds another run (what differs is named) or
    cannot be used, and DataError if its manifest cannot be read, or is damaged and not
    to be replaced.
    """
    manifest: dict[str, Any] = {"identity": identity, "cells": [], "dropped_cells": 0}
    with usable(out):
        is_there = (out / files.MANIFEST).exists()
        if fresh and is_there:
            _remove_run(out)
        elif is_there:
            manifest |= undamaged(parsed(out), out=out)
            refuse_other_run(manifest["identity"], identity, out=out)
        (out / files.FOLDER).mkdir(parents=True, exist_ok=True)
        names = [name for entry in manifest["cells"] for name in entry["files"]]
        held, damaged = sound_files(out, names)
        _drop_other_code(out, manifest, held)
        files.forget_missing(out)
    return manifest, held, damaged


def refuse_other_run(
    earlier: Mapping[str, Any], identity: Mapping[str, Any], *, out: Path
) -> None:
    """Raise SettingsError, and name what differs, if a folder holds a run of another identity."""
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
    out: Path, manifest: dict[str, Any], held: dict[str, Index]
) -> None:
    """Drop cells whose code is here but another, and the files that hold no other cells."""
    modules = {
        module
        for index in held.values()
        for code in (index.code, *(one.code for one in index.consumers.values()))
        for module in code
    }
    here = {name: source_digest(name)[:16] for name in modules if can_be_found(name)}
    current = {
        (name, label)
        for name, index in held.items()
        for label, own in index.consumers.items()
        if all(
            here.get(one, was) == was for one, was in {**index.code, **own.code}.items()
        )
    }
    cells = [
        entry
        for entry in manifest["cells"]
        if all(
            (one, files.label_of(entry)) in current or one not in held
            for one in entry["files"]
        )
    ]
    before, after = (
        sum(len(one["files"]) for one in of) for of in (manifest["cells"], cells)
    )
    manifest["cells"] = cells
    manifest["dropped_cells"] = before - after or manifest["dropped_cells"]
    for name in held.keys() - {name for name, _ in current}:
        (out / files.FOLDER / name).unlink(missing_ok=True)
        del held[name]


def _remove_run(out: Path) -> None:
    """Delete what a run wrote, by name: the folder may hold what is not ours. Manifest last."""
    found, cells = parsed(out), (out / files.FOLDER).glob("*.parquet")
    ours = [path for path in cells if CELL_NAME.fullmatch(path.name)]
    ours += [out / name for name in files.WRITTEN]
    with contextlib.suppress(DataError):
        ours += _figures(out, undamaged(found, out=out))
    try:
        for path in ours:
            path.unlink(missing_ok=True)
        for folder in files.SUBFOLDERS:
            if (out / folder).is_dir() and not any((out / folder).iterdir()):
                (out / folder).rmdir()
        (out / files.MANIFEST).unlink()
    except OSError as error:
        what = f"cannot replace the run in {out}: {error.strerror}"
        raise SettingsError(f"{what}; choose another --out") from None


def note_figures(out: Path, names: Sequence[str]) -> None:
    """Write into the manifest which figures a report draws, before it does, to find them again."""
    write_manifest(out, read_manifest(out) | {"figures": list(names)})


def remove_figures(out: Path) -> None:
    """Delete the page and the figures of an earlier report; DataError where that cannot be."""
    for path in (out / files.PAGE, *_figures(out, read_manifest(out))):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            what = f"cannot replace {path}: {error.strerror}"
            raise DataError(f"{what}; finished cells are kept") from None


def _figures(out: Path, manifest: Mapping[str, Any]) -> list[Path]:
    """Return every file that a report may have drawn: svg for screens, pdf for print."""
    names = [Path(name).name for name in manifest.get("figures", ())]
    return [
        out / "figures" / f"{name}.{kind}" for name in names for kind in ("svg", "pdf")
    ]


def copy_without_private(out: Path, to: Path) -> None:
    """Copy a finished run's manifest, cells and list of people: all that its report is made from.

    Raises SettingsError if the copy exists or cannot be written, or the run keeps its
    ids, and DataError if it is not finished, or not as it was written.
    """
    manifest = read_manifest(out)
    if manifest.get("state") != "finished":
        raise DataError(f"the run in {out} is not finished; run the matrix again")
    if manifest["identity"].get("ids") == "kept" or not (out / files.PEOPLE).exists():
        raise SettingsError(
            f"{out} keeps the recording's own ids; run the matrix without --keep-ids,"
            " anew"
        )
    names = dict.fromkeys(
        name for entry in manifest["cells"] for name in entry["files"]
    )
    files.check_sound(out, names)
    try:
        to.mkdir(parents=True)
        (to / files.FOLDER).mkdir()
        write_manifest(to, manifest)
        files.write_whole(to / files.PEOPLE, files.content_of(out / files.PEOPLE))
        for name in names:
            files.write_checked(to, name, files.content_of(out / files.FOLDER / name))
    except FileExistsError:
        raise SettingsError(f"{to} exists; choose another --to") from None
    except OSError as error:
        raise SettingsError(
            f"cannot write {to}: {error.strerror}; choose another --to"
        ) from None
