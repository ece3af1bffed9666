"""Cells that other runs have: taken over instead of computed again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluation.runs import folder
from evaluation.runs.cell_files import adopt, sound_cells
from evaluation.runs.lock import locked

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from evaluation.experiment.plan import Plan


def borrow(ready: Plan, *, sources: Sequence[Path], fresh: bool = False) -> None:
    """Open the folder of a run and copy the cells into it that other runs have.

    A cell's name is keyed by all that its rows depend on: those of one name are the same.

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
        manifest = folder.open_run(ready.out, identity=ready.identity, code=ready.code, fresh=fresh)
        folder.write_manifest(ready.out, manifest | {"code": ready.code, "state": "running"})
        names = [name for _, _, names in ready.cells for name in names]
        sound, _ = sound_cells(ready.out, names)
        adopt(ready.out, [name for name in names if name not in sound], sources=sources)
