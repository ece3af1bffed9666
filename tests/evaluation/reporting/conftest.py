"""The page of a made-up run with everything in it, drawn once."""

import pytest
from helpers.finished_runs import levels, make_gallery, make_run

from evaluation.reporting import page
from evaluation.reporting.figures.drawing import draw_all


@pytest.fixture(scope="session")
def page_path(tmp_path_factory):
    out = tmp_path_factory.mktemp("run")
    run = make_run(out, at=levels(rules=("",)), gallery=make_gallery())
    return page.write(run, drawn=draw_all(run, folder=out / "figures"))
