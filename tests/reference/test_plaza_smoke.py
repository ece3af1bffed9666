"""Numbers of the smoke preset on the bundled crowd against the published ones."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import evaluation
from evaluation.reporting.tables import filled

ROOT = Path(evaluation.__file__).parent.parent
RESULTS = ROOT / "docs" / "results"
KEY = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]

PART = {"mechanisms": ("fid:1",), "tasks": ("rerelease", "handover-1s")}
"""A level and the ceiling, an open and a closed task: CI compares a whole run."""


def test_a_fresh_run_gives_the_published_numbers(tmp_path):
    """A whole run of an installed wheel if there is one, else a part of a run."""
    whole = os.environ.get("ISAC_TRACK_SMOKE_RUN")
    out = Path(whole or tmp_path / "run")
    if whole is None:
        settings = evaluation.Settings(preset="smoke", dataset="plaza", out=out, **PART)
        evaluation.run(settings, pictures=False)
    published, fresh = (
        pd.read_csv(path / name).fillna({"knowledge": "", "family": "", "adding": ""})
        for path, name in ((RESULTS, "plaza-smoke-0.csv"), (out, "summary.csv"))
    )
    assert list(fresh.columns) == list(published.columns)
    if whole is None:
        task = published["consumer"].where(published["consumer"].str.contains("/"), "/")
        is_run = task.str.partition("/")[0].isin(["", *PART["tasks"]])
        levels = (published["mechanism"] == "clean") | (
            (published["mechanism"] == "fid") & (published["level"] == 1)
        )
        published = published[is_run & levels]
    merged = published.merge(
        fresh, on=KEY, suffixes=("", "_fresh"), how="outer", indicator=True
    )
    assert (merged["_merge"] == "both").all()
    assert len(merged) > 400
    for name in ("value", "ci_low", "ci_high", "n"):
        actual, expected = merged[f"{name}_fresh"].to_numpy(), merged[name].to_numpy()
        np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-9, err_msg=name)
    for name in ("unit", "family", "adding"):
        assert (merged[f"{name}_fresh"] == merged[name]).all()


@pytest.mark.parametrize(
    "page",
    [path.relative_to(ROOT).as_posix() for path in ROOT.glob("docs/**/*.md")]
    + ["README.md"],
)
def test_every_result_table_is_what_its_file_gives(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert filled(text, results=RESULTS) == text
