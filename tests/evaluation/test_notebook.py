"""A run in a notebook's kernel: one progress display, whole files, completed names."""

import inspect
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import ROOT

import evaluation
from evaluation.plan.settings import Settings
from isac_track import datasets

nbclient = pytest.importorskip(
    "nbclient", reason="nbclient is not installed: the extra `test`"
)
nbformat = pytest.importorskip(
    "nbformat", reason="nbformat is not installed: the extra `test`"
)
pytest.importorskip("ipykernel", reason="ipykernel is not installed: the extra `test`")

SMALL = (
    'preset="smoke", dataset="plaza", mechanisms=["raw", "fixed:1"],'
    ' attacks=["savgol"], '
)
SMALL += 'predictors=["least_squares"], tasks=[], jobs=1, pictures=False'
CELLS = [
    "import evaluation\nfrom isac_track import datasets",
    f'results = evaluation.run(out="shown", {SMALL})',
    f'silent = evaluation.run(out="silent", {SMALL}, progress=False)',
    "results",
    "datasets.load('plaza')",
    "datasets.load('plaza').tracks",
]


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    """The outputs of every cell, and the folder that the notebook ran in."""
    folder = tmp_path_factory.mktemp("notebook")
    book = nbformat.v4.new_notebook(cells=[*map(nbformat.v4.new_code_cell, CELLS)])
    path = [f"import sys; sys.path.insert(0, {str(ROOT)!r})"]
    book.cells[0].source = "\n".join([*path, book.cells[0].source])
    client = nbclient.NotebookClient(
        book,
        timeout=500,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    return [cell.outputs for cell in book.cells], folder


def test_a_run_has_one_display_and_nothing_else(cells):
    (shown,) = cells[0][1]
    assert shown.output_type == "display_data"
    heading, *_, last = shown.data["text/plain"].splitlines()
    assert heading.startswith("plaza: ")
    assert last.startswith("done in ")


def test_without_progress_a_run_is_silent(cells):
    assert cells[0][2] == []


@pytest.mark.parametrize("name", ["shown", "silent"])
def test_the_tables_are_in_their_file(cells, name):
    text = (Path(cells[1]) / name / "tables.txt").read_text("utf-8")
    assert "missed" in text
    assert len(text.splitlines()) > 20


def test_results_show_as_the_first_table(cells):
    (shown,) = cells[0][3]
    assert shown.output_type == "execute_result"
    assert shown.data["text/html"].count("<tr>") >= 3
    first, heads, *rows = shown.data["text/plain"].splitlines()
    assert first.startswith("<Results shown: plaza (simulated people), 40 scenes")
    assert "missed" in heads
    assert [" ".join(row.split()[:2]) for row in rows][:2] == [
        "raw positions",
        "fixed noise,",
    ]


def test_a_data_set_and_its_tracks_are_a_line(cells):
    dataset, tracks = (cells[0][at][0].data["text/plain"] for at in (4, 5))
    loaded = datasets.load("plaza").tracks
    size = f"{len(loaded):,} tracks, {np.sum(np.diff(loaded.offsets)):,} samples"
    assert dataset.startswith(f"<Dataset plaza (simulated people): {size}")
    assert tracks == f"<Tracks: {size}>"


def test_every_option_of_a_run_has_a_name_that_completes():
    parameters = inspect.signature(evaluation.run).parameters
    named = [
        parameter
        for parameter in parameters.values()
        if parameter.kind is parameter.KEYWORD_ONLY
    ]
    assert {item.name for item in fields(Settings)} <= {item.name for item in named}
    assert all(item.name in evaluation.run.__doc__ for item in named)
    assert all(
        parameter.annotation is not parameter.empty for parameter in parameters.values()
    )
