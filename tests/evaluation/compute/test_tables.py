"""Columns of cells are those that pyarrow makes, and made without pandas."""

import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest

from evaluation.compute.tables import DESCRIPTORS, ON_TRIAL, column, table

SAYS = """
import sys
import numpy as np
from evaluation.compute import sample_tracks
from evaluation.compute.tables import names_column, table
from evaluation.pool import packing
table({"name": names_column(np.zeros(3, dtype=int), ("a",)), "x": np.zeros(3), "text": ["b"] * 3})
print("pandas" in sys.modules)
"""


@pytest.mark.parametrize(
    "values",
    [
        np.array([0.0, -1.5, np.nan, np.inf]),
        np.arange(6.0).reshape(3, 2)[:, 1],  # not in one piece
        np.array([1, -2], dtype=np.int32),
        np.arange(5),
        np.arange(19) % 3 == 0,
        np.zeros(0),
        ["", "Zürich", "\N{GRINNING FACE}", "Zürich"],
        [],
    ],
)
def test_a_column_is_what_pyarrow_makes(values):
    kind = pa.string() if isinstance(values, list) else None
    expected = pa.array(values, type=kind)
    result = column(values)
    result.validate(full=True)
    assert result.type == expected.type
    assert str(result) == str(expected)  # NaN is there, too
    assert table({"a": values}).column_names == ["a"]


def test_a_worker_does_without_pandas():
    done = subprocess.run(
        [sys.executable, "-c", SAYS],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout.strip() == "False"


def test_every_descriptor_is_on_trial_after_a_smoother_too():
    assert ON_TRIAL[:3] == ("plr_attacked", "ael_attacked", "mel_attacked")
    attacked = [name for name in ON_TRIAL if name.endswith("_attacked")]
    assert len(attacked) == len(DESCRIPTORS)
