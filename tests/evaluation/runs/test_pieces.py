"""Cells on their way into files: what is whole goes out at once, what is not goes out in parts."""

import pyarrow as pa
import pytest

from evaluation.cells.where import Failed
from evaluation.experiment.axes import Consumer
from evaluation.runs import pieces
from evaluation.runs.cell_files import index_of
from evaluation.runs.pieces import ToCome, WholeFile, in_files
from isac_track import plugins

SPECS = ("raw", "fixed:0.5")
CONSUMERS = (Consumer("shared"), Consumer("windows", task="split"))
FILES = {
    (0, spec, one.label): ToCome(
        f"{spec}.parquet",
        f"key of {spec}",
        {},
        {each.label: (each.label, {}) for each in CONSUMERS},
    )
    for spec in SPECS
    for one in CONSUMERS
}


@pytest.fixture
def items():
    mechanisms = [plugins.parse("mechanisms", spec)[0] for spec in SPECS]
    table = pa.table({"value": [1.0, 2.0]})
    return [(0, one, each, {"rows": table}) for one in mechanisms for each in CONSUMERS]


def held(file):
    index = index_of(file.content)
    return index.unit, list(index.consumers)


def test_what_is_whole_goes_out_at_once_and_parts_before_what_failed(items, monkeypatch):
    death = Failed(("fixed:0.5", "split/windows"), "no luck")
    monkeypatch.setattr(pieces, "attempt", lambda _work: iter([*items[:3], death]))
    first, part, last = in_files(None, files=FILES)
    assert isinstance(first, WholeFile)
    assert first.name == "raw.parquet"
    assert set(first.places) == {(0, "raw", "shared"), (0, "raw", "split/windows")}
    assert held(first) == ("key of raw", ["shared", "split/windows"])
    assert part is items[2]
    assert last is death
