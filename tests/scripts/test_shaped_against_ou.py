"""Two mechanisms at equal rises of missed conflicts, on straight lines."""

import re

import numpy as np
import pytest
import shaped_against_ou
from helpers.mechanisms import make_sweeps
from helpers.straight_lines import run

from evaluation.estimates.frontier import frontier_quantities
from evaluation.estimates.metrics import EQUAL_ALARMS
from evaluation.estimates.strongest_table import strongest_on_each


def test_values_and_differences_are_those_of_the_straight_lines():
    sweeps = make_sweeps(run(advantage=0.1))
    attacks = strongest_on_each(sweeps.estimates, {}, sweeps.families)
    quantities, _ = frontier_quantities(sweeps, attacks)
    axes = [quantity for quantity in quantities if quantity.is_axis]
    curves = shaped_against_ou.Curves(sweeps, axes, price=EQUAL_ALARMS)
    head, _, *rows = shaped_against_ou.lines(
        curves, compared="fid", rivals=["fixed"], robots=["least_squares"]
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


def test_each_level_is_named_once():
    specs = shaped_against_ou.mechanisms()
    assert len(specs) == len(set(specs))
    assert specs[0] == "raw"
