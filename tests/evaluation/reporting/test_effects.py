"""Effects of the verdict and of the paper's claims, in the units of their metrics."""

import pytest

from evaluation.reporting.paper_tables import effect


@pytest.mark.parametrize(
    ("unit", "value", "text"),
    [
        ("fraction", 0.0554, "+5.5 [+5.4, +5.6] points"),
        ("s", 0.0554, "+0.055 [+0.054, +0.056] s"),
        ("correlation", 0.136, "+0.14 [+0.14, +0.14]"),
        ("ratio", 4.537, "4.54 [4.54, 4.54] times"),
    ],
)
def test_an_effect_has_the_digits_that_its_unit_needs(unit, value, text):
    row = {"unit": unit, "effect": value, "ci_low": value - 0.001, "ci_high": value + 0.001}
    assert effect(row, signed=True).full == text
