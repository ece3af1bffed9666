"""The reference of columns lists what a run writes."""

import re
from pathlib import Path

import pandas as pd
import pytest
from helpers.small_runs import smoke, write_walks

import evaluation
from evaluation.estimates import pooled
from evaluation.store.files import FRAMES, WRITTEN
from evaluation.store.manifest import LAYOUT
from evaluation.verdict import sensitivity

ROOT = Path(evaluation.__file__).parent.parent
PAGE = (ROOT / "docs" / "reference" / "columns.md").read_text("utf-8")
COMMON = "Columns of many tables"
MOST_LINES, MOST_COLUMNS = 250, 88


def code_in(text):
    """Every name in backticks."""
    return set(re.findall(r"`([^`\n]+)`", text))


def sections():
    """The text below each heading of the page."""
    parts = re.split(r"^## (.+)\n", PAGE, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def section_of(name):
    """The text about a file."""
    (text,) = [text for title, text in sections().items() if name in title]
    return text


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A small run with attacks, a linker, a predictor and items of a verdict."""
    folder = tmp_path_factory.mktemp("columns")
    axes = {
        "mechanisms": ("raw", "fixed:0.2", "fixed:1", "fid:1", "fid:1e5"),
        "predictors": ("least_squares",),
        "attacks": ("kalman_rts", "histogram"),
        "tasks": ("rerelease",),
    }
    settings = smoke(write_walks(folder / "walks.csv"), folder / "run", **axes)
    evaluation.run(settings, progress=False, pictures=False)
    return folder / "run"


@pytest.mark.parametrize("name", FRAMES.values())
def test_a_column_that_a_run_writes_is_explained(out, name):
    columns = pd.read_csv(out / name, nrows=0).columns
    assert set(columns) - code_in(section_of(name)) == set()


@pytest.mark.parametrize(
    ("name", "columns"),
    [("sensitivity.csv", sensitivity.COLUMNS), ("study.csv", pooled.COLUMNS)],
)
def test_columns_of_further_commands_are_explained(name, columns):
    assert set(columns) - code_in(section_of(name)) == set()


def test_keys_of_a_verdict_are_explained(out):
    verdict = evaluation.load(out).verdict
    items = {key for item in verdict["items"] for key in item}
    names = code_in(section_of("verdict.json"))
    # A row names these by their ends alone.
    ends = {f"prediction_error{end}" for end in ("_low", "_high", "_null")}
    about_run = {"dataset", "simulated", "seed", "preset", "scenes"}
    assert items - names == ends
    assert verdict.keys() - names <= about_run


def test_metrics_of_a_summary_are_explained(out):
    summary = pd.read_csv(out / "summary.csv")
    assert set(summary["metric"]) - code_in(sections()[COMMON]) == set()


def test_files_of_a_run_are_listed():
    listed = code_in(sections()["Files"])
    missing = [name for name in WRITTEN if name not in listed]
    assert [name for name in missing if not name.startswith("tables/")] == []


def test_the_page_says_its_layout_and_is_short():
    assert f"layout {LAYOUT}:" in PAGE
    lines = PAGE.splitlines()
    assert len(lines) <= MOST_LINES
    assert [line for line in lines if len(line) > MOST_COLUMNS] == []
