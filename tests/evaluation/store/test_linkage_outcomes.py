"""Outcomes of linkage read from cells: damage that checksums do not show."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers.addresses import entry_at

from evaluation.compute.link_tables import ABOUT, ESTIMATES
from evaluation.compute.tables import ROWS
from evaluation.store.linkage_outcomes import _OUTCOME, read_outcomes
from isac_track.errors import DataError


def test_an_index_that_points_behind_the_rows_names_the_file(tmp_path):
    (tmp_path / "cells").mkdir()
    path = tmp_path / "cells" / "cell.parquet"
    places = {ESTIMATES: [0, 1], ROWS: [0, 1], ABOUT: [9, 1]}
    consumers = {"shared": {"key": "k", "code": {}, "tables": places}}
    unit = {"spec": "raw", "unit": "u", "code": {}, "consumers": consumers}
    table = pa.table({name: ["{}"] for name in _OUTCOME})
    with pq.ParquetWriter(path, table.schema, store_schema=False) as writer:
        writer.write_table(table)
        index = json.dumps({"units": [unit]}).encode()
        writer.add_key_value_metadata({b"isac_track.cells": index})
    entry = entry_at("shared", files=("cell.parquet",))
    with pytest.raises(DataError, match=r"cell\.parquet cannot be read"):
        read_outcomes(tmp_path, [entry])
