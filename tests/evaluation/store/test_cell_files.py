"""Cells in parquet: damage after the checksums were compared, and earlier files."""

import contextlib
import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers.addresses import entry_at

from evaluation.compute.tables import ROWS
from evaluation.store import cell_files
from evaluation.store.cell_files import (
    ComputedCell,
    ComputedUnit,
    pack_units,
    read_rows,
    read_units,
)
from evaluation.store.cell_index import read_index
from isac_track.errors import DataError

VALUES = [1.5 * number for number in range(1000)]
ENTRY = entry_at("shared", files=("cell.parquet",))


@pytest.fixture
def cell(tmp_path):
    """The file of a cell whose single column is `plr_over`."""
    tables = {ROWS: pa.table({"plr_over": VALUES})}
    (tmp_path / "cells").mkdir()
    path = tmp_path / "cells" / "cell.parquet"
    path.write_bytes(pack_units([unit_of("raw", tables)]))
    return path


def unit_of(spec, tables):
    """A unit of work whose single cell is `shared` at a level."""
    return ComputedUnit(spec, "u", {}, [ComputedCell("shared", "key", {}, tables)])


def values(path, entry=ENTRY):
    for memo in (cell_files._read_level, cell_files._read_metadata):
        memo.cache_clear()  # two writes may have one time and size
    rows = read_rows(path.parent.parent, entry, columns=["plr_over"])
    return rows["plr_over"].to_pylist()


def column_span(path):
    chunk = pq.read_metadata(path).row_group(0).column(0)
    first = chunk.data_page_offset
    return range(first, first + chunk.total_compressed_size)


def test_no_columns_are_none_and_not_all(cell):
    assert read_units(cell.parent.parent, ENTRY, None)[0].table.num_columns == 1
    assert read_units(cell.parent.parent, ENTRY, [])[0].table.num_columns == 0


def test_no_flipped_bit_of_a_page_is_read_as_another_number(cell):
    whole, span = cell.read_bytes(), column_span(cell)
    assert values(cell) == VALUES
    places, n_harmless = [*span[::41], span[-1]], 0
    for place in places:
        damaged = bytearray(whole)
        damaged[place] ^= 16
        cell.write_bytes(damaged)
        with contextlib.suppress(DataError):
            # A bit of a page's header may say nothing of the numbers.
            assert values(cell) == VALUES
            n_harmless += 1
    assert n_harmless < len(places) / 4


def test_each_level_of_a_file_has_its_own_rows(cell):
    rows_by_spec = {"raw": [1.0], "fid:1": [], "fixed:0.7": [2.0, 3.0]}
    units = [
        unit_of(spec, {ROWS: pa.table({"plr_over": pa.array(rows, pa.float64())})})
        for spec, rows in rows_by_spec.items()
    ]
    cell.write_bytes(pack_units(units))
    for spec in ("raw", "fixed:0.7"):
        entry = entry_at("shared", spec=spec, files=("cell.parquet",))
        assert values(cell, entry) == rows_by_spec[spec]
    # A reader of a level decodes that level alone.
    metadata = pq.read_metadata(cell)
    groups = range(metadata.num_row_groups)
    assert [metadata.row_group(group).num_rows for group in groups] == [1, 0, 2]
    other = entry_at("shared", spec="ou:0.4", files=("cell.parquet",))
    with pytest.raises(DataError, match=r"cell\.parquet has no rows at ou:0\.4"):
        values(cell, other)


def test_a_file_of_an_earlier_version_without_checksums_is_read(cell):
    table = pq.read_table(cell)
    tables = {"shared": {"key": "k", "code": {}, "tables": {ROWS: [0, len(VALUES)]}}}
    index = {"unit": "u", "code": {}, "consumers": tables}
    with pq.ParquetWriter(cell, table.schema, store_schema=False) as writer:
        # Its single unit may be in several row groups.
        writer.write_table(table, row_group_size=600)
        writer.add_key_value_metadata({b"isac_track.cells": json.dumps(index).encode()})
    assert values(cell) == VALUES
    assert read_index(cell).unit_at("raw").key == "u"


def test_an_index_of_more_levels_than_the_file_has_is_refused(cell):
    content = pack_units([unit_of("raw", {ROWS: pa.table({"plr_over": VALUES})})])
    table = pq.read_table(pa.BufferReader(content))
    tables = {"shared": {"key": "k", "code": {}, "tables": {ROWS: [0, len(VALUES)]}}}
    unit = {"unit": "u", "code": {}, "consumers": tables}
    units = [unit | {"spec": "raw"}, unit | {"spec": "fid:1"}]
    with pq.ParquetWriter(cell, table.schema, store_schema=False) as writer:
        writer.write_table(table)
        index = json.dumps({"units": units}).encode()
        writer.add_key_value_metadata({b"isac_track.cells": index})
    assert values(cell) == VALUES
    missing = entry_at("shared", spec="fid:1", files=("cell.parquet",))
    with pytest.raises(DataError, match=r"cell\.parquet cannot be read"):
        values(cell, missing)


def test_a_link_is_not_read(cell):
    elsewhere = cell.rename(cell.with_name("elsewhere"))
    cell.symlink_to(elsewhere)
    assert read_index(cell) is None
    with pytest.raises(DataError, match=r"cell\.parquet cannot be read"):
        values(cell)
