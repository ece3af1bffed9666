"""The picture of the README: the longest walk, turned, with its numbers."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from helpers.finished_runs import make_gallery, make_run

from evaluation.reporting.docs_pages import FIGURES, GLOSSARY_PAGE, PICTURE, write_pages
from evaluation.reporting.one_walk import PANEL, caption, draw_walk, longest_walk


@pytest.fixture
def gallery():
    rows = make_gallery()
    is_last = rows["track"] == rows["track"].max()
    # The last person goes twice as far, and along y.
    rows.loc[is_last, "y_true"] += 2.0 * rows.loc[is_last, "t"]
    return rows


def test_the_furthest_walk_runs_from_left_to_right_and_keeps_its_distances(gallery):
    walk = longest_walk(gallery)
    assert walk.mechanism == "fid:1"
    assert walk.true[0] == pytest.approx([0.0, 0.0])
    assert walk.true[-1] == pytest.approx([7.0 * np.sqrt(5.0), 0.0])
    rows = gallery[(gallery["track"] == 3) & (gallery["mechanism"] == "fid:1")]
    before = np.hypot(
        rows["x_shared"] - rows["x_true"], rows["y_shared"] - rows["y_true"]
    )
    np.testing.assert_allclose(np.hypot(*(walk.shared - walk.true).T), before)


def test_it_says_how_much_leaks_and_draws_every_shared_position(gallery):
    walk = longest_walk(gallery)
    text = caption(walk, level_name="FID noise, eta 1")
    assert (
        text == "FID noise, eta 1: 50 % of the shared positions are within 0.3 m of the"
        " walk; "
        "after a radial Kalman smoother, 75 % are."
    )
    root = ET.fromstring(draw_walk(walk, level_name="FID noise, eta 1"))
    assert text in "".join(root.itertext())
    paths = list(root.iter("{http://www.w3.org/2000/svg}path"))
    places = {
        name: [p for p in paths if p.get("class") == f"line {name}"]
        for name in ("far", "near")
    }
    assert [places[name][0].get("d").count("M") for name in ("far", "near")] == [4, 4]
    assert float(root.get("viewBox").split()[2]) == pytest.approx(2 * PANEL[0] + 30)


def test_raw_positions_alone_make_no_picture(gallery):
    assert longest_walk(gallery[gallery["mechanism"] == "raw"]) is None


@pytest.mark.parametrize("simulated", [True, False])
def test_walks_of_recorded_people_are_not_drawn(tmp_path, simulated):
    run = make_run(tmp_path / "run", gallery=make_gallery())
    run.manifest["dataset"]["simulated"] = simulated
    written = write_pages(run, root=tmp_path)
    run.manifest["dataset"]["simulated"] = False
    assert written == [
        tmp_path / GLOSSARY_PAGE,
        *([tmp_path / PICTURE] if simulated else []),
    ]
    assert all(path.stat().st_size for path in written)


def test_figures_of_the_paper_preset_go_into_the_docs(tmp_path):
    figures = tmp_path / "run" / "figures"
    figures.mkdir(parents=True)
    for name in ("frontier", "by_speed"):
        (figures / f"{name}.svg").write_text(f"<svg>{name}</svg>")
    written = write_pages(make_run(tmp_path / "run"), root=tmp_path)
    assert written == [tmp_path / GLOSSARY_PAGE, tmp_path / FIGURES / "frontier.svg"]
    assert written[1].read_text() == "<svg>frontier</svg>"
