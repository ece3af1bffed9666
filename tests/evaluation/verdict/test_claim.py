"""The paper's claim: intervals of an item and of its points."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.mechanisms import make_sweeps
from helpers.straight_lines import PREDICTORS, run

from evaluation.plan.address import parse_consumer
from evaluation.verdict.bands import decide_section
from evaluation.verdict.claim import draft_claims


@pytest.mark.parametrize(("n_effective", "has_ends"), [(8.0, False), (30.0, True)])
def test_an_item_and_its_points_have_an_interval_or_neither(n_effective, has_ends):
    estimates = {
        key: replace(item, effective=n_effective)
        for key, item in run(advantage=0.1).items()
    }
    strongest = {"": parse_consumer("kalman_rts", "blind")}
    drafts = draft_claims(make_sweeps(estimates), strongest, predictor=PREDICTORS[0])
    items = decide_section(drafts)
    assert items
    for item in items:
        assert np.isfinite(item.effect.ci_low) == has_ends
        for point in item.details.gaps:
            assert np.isfinite(point.gap.ci_low) == has_ends
