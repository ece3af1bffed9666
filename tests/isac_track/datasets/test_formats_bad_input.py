"""Each reader's message for a file that it cannot read.

`tests/robustness` reads such files in processes of their own.
"""

import pytest
from helpers.bad_recordings import ROWS
from helpers.recordings import refusal


@pytest.mark.parametrize(
    ("format_name", "data", "message", "fps"),
    [pytest.param(*row, id=f"{row[0]}: {row[2]}") for row in ROWS],
)
def test_one_clear_error(format_name, data, message, fps):
    assert message in refusal(data, format_name, fps)
