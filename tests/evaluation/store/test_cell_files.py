"""Cells in parquet: damage after the checksums were compared, and earlier files."""

import contextlib
import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers.addresses import entry_at

from evaluation.compute.tables import ROWS
from evaluation.store import cell_files
from evaluation.store.cell_files import pack_cells, read_index, read_rows
from isac_track.errors import DataError

VALUES = [1.5 * number for number in range(1000)]
ENTRY = entry_at("shared", files=("cell.parquet",))


@pytest.fixture
def cell(tmp_path):
    """The file of a cell whose single column is `plr_over`."""
    tables = {ROWS: pa.table({"plr_over": VALUES})}
    (tmp_path / "cells").mkdir()
    path = tmp_path / "cells" / "cell.parquet"
    path.write_bytes(pack_cells([("shared", "key", {}, tables)], unit="u", code={}))
    return path


def values(path):
    cell_files._read_files.cache_clear()  # two writes may have one time and size
    rows = read_rows(path.parent.parent, ENTRY, columns=["plr_over"])
    return rows["plr_over"].to_pylist()


def column_span(path):
    chunk = pq.read_metadata(path).row_group(0).column(0)
    first = chunk.data_page_offset
    return range(first, first + chunk.total_compressed_size)


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


def test_a_file_of_an_earlier_version_without_checksums_is_read(cell):
    table, metadata = pq.read_table(cell), pq.read_metadata(cell).metadata
    with pq.ParquetWriter(cell, table.schema, store_schema=False) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata(
            {b"isac_track.cells": metadata[b"isac_track.cells"]}
        )
    assert values(cell) == VALUES
    index = json.loads(metadata[b"isac_track.cells"])
    assert read_index(cell).unit == index["unit"] == "u"


def test_a_link_is_not_read(cell):
    elsewhere = cell.rename(cell.with_name("elsewhere"))
    cell.symlink_to(elsewhere)
    assert read_index(cell) is None
    with pytest.raises(DataError, match=r"cell\.parquet cannot be read"):
        values(cell)
