"""Two mechanisms at equal rises of missed conflicts, on straight lines."""

import re

import numpy as np
import pytest
import shaped_against_ou
from helpers.mechanisms import make_sweeps
from helpers.straight_lines import run

from evaluation.estimates.frontier import frontier_quantities
from evaluation.estimates.metrics import EQUAL_ALARMS
from evaluation.estimates.strongest_table import strongest_attacks


def readings(advantage):
    """Readings of fid and fixed where a line's misses have risen."""
    sweeps = make_sweeps(run(advantage=advantage))
    attacks = strongest_attacks(sweeps.estimates, {}, sweeps.families)
    quantities, _ = frontier_quantities(sweeps, attacks)
    return shaped_against_ou.readings(
        sweeps, quantities, robots=["least_squares"], price=EQUAL_ALARMS
    )


def test_values_and_differences_are_those_of_the_straight_lines():
    head, _, *rows = shaped_against_ou.lines(
        readings(0.1), compared="fid", rivals=["fixed"]
    )
    assert head == "| robot, rise | after | fixed | fid | less fixed |"
    # Misses rise by 0.3 times the noise, and PLR is 2 exp(-0.5 - noise).
    for row, target in zip(rows[::2], shaped_against_ou.TARGETS, strict=True):
        assert row.startswith(f"| least_squares, +{100 * target:.0f} | blind |")
        fixed, fid, gap = re.findall(r"\| (-?[\d.]+) \[", row)
        left = 200.0 * np.exp(-0.5 - target / 0.3)
        assert float(fixed) == pytest.approx(left, abs=0.3)
        assert float(fid) == pytest.approx(left * np.exp(-0.1), abs=0.3)
        assert float(gap) == pytest.approx(left * np.expm1(-0.1), abs=0.3)
    assert all("| rerelease |" in row for row in rows[1::2])


def test_a_mean_of_runs_is_narrower_than_either():
    first, second = readings(0.1), readings(0.3)
    key = "least_squares", 0.03, "blind"
    mean = shaped_against_ou.mean_readings([first, second])[key]["fid"]
    both = [values[key]["fid"] for values in (first, second)]
    assert mean[0] == pytest.approx(np.mean([values[0] for values in both]))
    assert mean[1:].std() < 0.85 * min(values[1:].std() for values in both)


def test_each_level_is_named_once():
    specs = shaped_against_ou.mechanisms()
    assert len(specs) == len(set(specs))
    assert specs[0] == "raw"
