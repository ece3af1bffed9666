"""The page of a made-up run with everything in it, drawn once."""

import pytest
from helpers.finished_runs import (
    levels,
    make_gallery,
    make_run,
    make_summary,
    with_links,
)

from evaluation.reporting import page
from evaluation.reporting.figures.figure import make_figures


@pytest.fixture(scope="session")
def page_path(tmp_path_factory):
    out, at = tmp_path_factory.mktemp("run"), levels(rules=("",))
    summary = make_summary(at, predictors=("least_squares", "kalman_cv"))
    run = with_links(make_run(out, at=at, gallery=make_gallery(), summary=summary))
    return page.write(run, figures=make_figures(run))
