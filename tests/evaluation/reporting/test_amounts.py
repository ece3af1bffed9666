"""Shares in text: every formatter by its own examples, and shares that are unknown."""

import math

import pytest

from evaluation.reporting import amounts
from isac_track.intervals import Estimate

SHARE = Estimate(0.3416, 0.305, 0.385)
SMALL = Estimate(0.004, 0.001, 0.008)


@pytest.mark.parametrize(
    ("write", "usual", "small"),
    [
        (amounts.percent, "34 % ±4", "<1 % ±<1"),
        (amounts.percent_cell, "34 ±4", "<1 ±<1"),
        (amounts.bare_percent, "34 %", "<1 %"),
        (amounts.precise_percent, "34.2 % [30.5, 38.5]", "0.4 % [0.1, 0.8]"),
    ],
)
def test_a_formatter_of_estimates_writes_as_its_module_says(write, usual, small):
    assert (write(SHARE), write(SMALL)) == (usual, small)


@pytest.mark.parametrize(
    ("write", "unknown"),
    [
        (lambda nan: amounts.percent(Estimate(nan)), "an unknown share"),
        (lambda nan: amounts.percent_cell(Estimate(nan)), "-"),
        (lambda nan: amounts.bare_percent(Estimate(nan)), "unknown"),
        (lambda nan: amounts.precise_percent(Estimate(nan)), "-"),
        (lambda nan: amounts.share_interval(nan, nan, nan), "-"),
        (lambda nan: amounts.fine_interval(nan, nan, nan), "? %"),
        (amounts.fine_share, "?"),
        (amounts.round_percent, "?"),
        (amounts.whole_percent, "unknown"),
        (amounts.tenth_percent, "unknown"),
    ],
)
def test_an_unknown_share_is_never_written_as_a_number(write, unknown):
    assert write(math.nan) == unknown
