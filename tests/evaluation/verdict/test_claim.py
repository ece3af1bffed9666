"""The paper's claim: intervals of an item and of its points."""

from dataclasses import replace

import pytest
from helpers.mechanisms import make_sweeps
from helpers.straight_lines import PREDICTORS, run

from evaluation.plan.address import parse_consumer
from evaluation.verdict.claim import claims
from evaluation.verdict.items import decided_items


@pytest.mark.parametrize(("n_effective", "has_ends"), [(8.0, False), (30.0, True)])
def test_an_item_and_its_points_have_an_interval_or_neither(n_effective, has_ends):
    estimates = {
        key: replace(item, effective=n_effective)
        for key, item in run(advantage=0.1).items()
    }
    strongest = {"": parse_consumer("kalman_rts", "blind")}
    drafts = [*claims(make_sweeps(estimates), strongest, predictor=PREDICTORS[0])]
    items = decided_items("c", drafts)
    assert items
    for item in items:
        assert (item["ci_low"] is not None) == has_ends
        for point in item["points"]:
            assert (point["ci_low"] is not None) == has_ends
