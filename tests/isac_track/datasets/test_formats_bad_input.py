"""What each reader says of a file that it cannot read; in processes of their own: robustness."""

import pytest
from helpers.bad_recordings import ROWS
from helpers.recordings import refusal


@pytest.mark.parametrize(
    ("format_name", "data", "message", "fps"),
    [pytest.param(*row, id=f"{row[0]}: {row[2]}") for row in ROWS],
)
def test_one_clear_error(format_name, data, message, fps):
    assert message in refusal(data, format_name, fps)
