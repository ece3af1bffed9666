"""The content of a finished run's folder: rows of its cells, and all its files."""

import numpy as np

from evaluation.compute.tables import ROWS
from evaluation.plan import source_digest
from evaluation.store import cell_files, cell_index
from evaluation.store.files import CELLS_FOLDER
from evaluation.store.manifest import read_manifest


def cell_entry(out, spec, consumer, knowledge=""):
    """The manifest's entry of a consumer at a level."""
    wanted = spec, consumer, knowledge
    cells = read_manifest(out)["cells"]
    (entry,) = [
        cell
        for cell in cells
        if (cell.spec, cell.address.consumer, cell.address.adversary) == wanted
        and not cell.address.world
    ]
    return entry


def stored_rows(out, spec, consumer, knowledge=""):
    """All rows of a consumer at a level, with all of its columns."""
    entry = cell_entry(out, spec, consumer, knowledge)
    file, *_ = cell_files.read_units(out, entry, None)
    first = file.table.slice(*cell_files.consumer_tables(file, entry).tables[ROWS])
    columns = [name for name in first.column_names if first[name].null_count == 0]
    return cell_files.read_rows(out, entry, columns=columns).to_pandas()


def stored_consumers(out):
    """Labels of the consumers at each level, by SPEC, in each file of cells."""
    return {
        path.name: {
            spec: set(unit.consumers)
            for spec, unit in cell_index.read_index(path).units.items()
        }
        for path in (out / CELLS_FOLDER).iterdir()
    }


def change_code(monkeypatch, *modules):
    """Let the code of some modules look as if somebody had changed it."""
    read = source_digest._read_source

    def changed(name, **place):
        result = read(name, **place)
        return (result[0] + b"# changed\n", result[1]) if name in modules else result

    monkeypatch.setattr(source_digest, "_read_source", changed)


def arrays(tables, *, tracks=None):
    """Rows of a cell as arrays by name; with `tracks`, their places by source, too."""
    rows = tables[ROWS]
    result = {
        name: column.to_numpy()
        for name, column in zip(rows.column_names, rows, strict=True)
    }
    if tracks is not None:
        place = {name: row for row, name in enumerate(tracks.source)}
        result["track"] = np.array(
            [place[name] for name in result["source"]], dtype=np.int64
        )
    return result
