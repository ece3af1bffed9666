"""What a finished run's folder holds: rows of its cells, and everything that was computed."""

import numpy as np

from evaluation.compute.tables import ROWS
from evaluation.plan import fingerprint
from evaluation.store import cell_files
from evaluation.store.files import FOLDER
from evaluation.store.manifest import read_manifest


def entry_of(out, spec, consumer, knowledge=""):
    """The manifest's entry of a consumer at a level."""
    wanted = spec, consumer, knowledge
    cells = read_manifest(out)["cells"]
    (entry,) = [
        one
        for one in cells
        if (one["spec"], one["consumer"], one["knowledge"]) == wanted
        and not one["world"]
    ]
    return entry


def rows_of(out, spec, consumer, knowledge=""):
    """All rows of a consumer at a level, with all of its columns."""
    entry = entry_of(out, spec, consumer, knowledge)
    (path, whole, index), *_ = cell_files._opened(out, entry, None)
    first = whole.slice(*cell_files._held(path, index, entry).tables[ROWS])
    columns = [name for name in first.column_names if first[name].null_count == 0]
    return cell_files.read_rows(out, entry, columns=columns).to_pandas()


def held_by(out):
    """Labels of the consumers in each file of cells."""
    return {
        path.name: set(cell_files.index_of(path).consumers)
        for path in (out / FOLDER).iterdir()
    }


def change_code(monkeypatch, *modules):
    """Let the code of some modules look as if somebody had changed it."""
    read = fingerprint._read

    def changed(name, **place):
        found = read(name, **place)
        return (found[0] + b"# changed\n", found[1]) if name in modules else found

    monkeypatch.setattr(fingerprint, "_read", changed)


def arrays(tables, *, tracks=None):
    """The rows of a cell as arrays by name; with `tracks` also which of them, by its source."""
    rows = tables[ROWS]
    found = {
        name: column.to_numpy()
        for name, column in zip(rows.column_names, rows, strict=True)
    }
    if tracks is not None:
        place = {name: row for row, name in enumerate(tracks.source)}
        found["track"] = np.array(
            [place[name] for name in found["source"]], dtype=np.int64
        )
    return found
