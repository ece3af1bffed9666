"""Cells that other runs have: taken over instead of computed again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluation.runs import folder
from evaluation.runs.cell_files import places_of, sound_files
from evaluation.runs.checksums import FOLDER, write_checked
from evaluation.runs.lock import locked
from evaluation.runs.missing_work import missing_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from evaluation.experiment.plan import Plan


def borrow(ready: Plan, *, sources: Sequence[Path], fresh: bool = False) -> None:
    """Open the folder of a run and copy the cells into it that other runs have.

    Each is taken from the first folder that has it: what is keyed alike is the same.

    Parameters
    ----------
    ready : Plan
        Of the run.
    sources : sequence of Path
        Folders of other runs.
    fresh : bool
        Replace what is in the folder.

    Raises
    ------
    DataError
        If the folder cannot be written or another process runs in it.
    SettingsError
        If it holds another run.
    """
    folder.check_folder(ready.out)
    with locked(ready.out):
        manifest, files, _ = folder.open_run(ready.out, identity=ready.identity, fresh=fresh)
        folder.write_manifest(ready.out, manifest | {"code": ready.code, "state": "running"})
        missing = missing_of(ready, places_of(files))
        wanted = {(one.unit.key, key) for one in missing for key in one.keys}
        for source in sources:
            theirs, _ = sound_files(source)
            for name, index in theirs.items():
                held = {(index.unit, one.key) for one in index.consumers.values()}
                if wanted & held:
                    content = (source / FOLDER / name).read_bytes()
                    write_checked(ready.out, name, content)
                    wanted -= held
