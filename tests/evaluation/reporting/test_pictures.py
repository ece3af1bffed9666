"""The pictures of the page: marks stand where their numbers are, and fronts hold."""

import re
from itertools import product

import numpy as np
import pytest
from helpers.finished_runs import (
    levels,
    make_gallery,
    make_run,
    make_summary,
    with_links,
)

from evaluation.reporting.headline import choose_levels
from evaluation.reporting.names import short_mechanism_name
from evaluation.reporting.pictures import SIZE, panels, pictures, planes

SHARES = re.compile(r" (\d+\.\d) %")


@pytest.fixture(scope="module")
def table():
    summary = make_summary(predictors=("least_squares", "mine"))
    return with_links(make_run(summary=summary)).headline


def middles(chart):
    """Middle of each mark in percent on both axes by its ticks; rows have no number."""
    places = []
    for _, ((x, y),), _ in chart.marks:
        place = [np.interp(x, *np.array(chart.x_ticks, dtype=float).T)]
        if chart.y_label:
            place.append(np.interp(y, *np.array(chart.y_ticks[::-1], dtype=float).T))
        places.append(place)
    return np.array(places)


def plane_charts(table):
    return [picture.chart for drawn in planes(table).values() for picture in drawn]


def test_marks_stand_where_their_numbers_are_and_the_numbers_are_those_of_the_run(
    table,
):
    known = {f"{100 * estimate.value:.1f}" for estimate in table.numbers.values()}
    charts = [picture.chart for picture in pictures(table)]
    assert len(charts) == 5
    for chart in [*charts, *plane_charts(table)]:
        shares = [SHARES.findall(name.partition(": ")[2]) for _, _, name in chart.marks]
        assert known.issuperset(share for mark in shares for share in mark)
        expected = np.array(shares, dtype=float)
        assert np.allclose(middles(chart), expected, atol=0.2), chart.x_label


def test_rows_and_marks_are_those_of_the_first_table(table):
    lost = pictures(table)[0].chart
    levels = choose_levels(table)
    names = [
        short_mechanism_name(table.families[where.mechanism], where.level)
        for where in levels
    ]
    assert [text for _, text in lost.y_ticks] == names
    assert set(lost.hints) == set(names)
    assert len(lost.marks) == len(levels) * len(table.robots)


def test_the_front_turns_at_the_points_that_no_other_beats(table):
    assert list(planes(table)) == ["paper's line", "mine"]
    for chart in plane_charts(table):
        places = [place for _, (place,), _ in chart.marks]
        # Left and down are better: down is a larger number.
        best = {
            (x, y)
            for x, y in places
            if not any(a <= x and b >= y and (a, b) != (x, y) for a, b in places)
        }
        (corners,) = next(line.strokes for line in chart.lines if line.kind == "front")
        for x, y in best:
            assert any(abs(a - x) < 0.11 and abs(b - y) < 0.11 for a, b in corners)
        assert len(corners) == 2 * len(best) + 1


def test_no_two_mechanisms_have_the_same_look_however_many_there_are():
    others = [
        (f"mine{letter}{rule}", 1.0)
        for letter in "abcdef"
        for rule in ("", ":adding=independent")
    ]
    table = make_run(at=levels(others=others)).headline
    for drawn in planes(table).values():
        for picture in drawn:
            looks = {(look.css, look.shape) for look in picture.key.values()}
            assert len(looks) == len(picture.key) >= len(others) + 5


@pytest.mark.parametrize(
    "changes",
    [
        {"at": [("raw", np.nan)]},
        {"summary": make_summary(predictors=())},
        {"summary": make_summary(attacks=()), "strongest": {}},
        {"summary": make_summary()[:0], "strongest": {}},
    ],
)
def test_what_a_run_lacks_has_no_picture_and_stops_nothing(changes):
    table = make_run(**changes).headline
    for picture in pictures(table):
        assert picture is None or picture.chart.marks
    assert all(chart.marks for chart in plane_charts(table))


def test_walks_are_drawn_to_scale_and_leaks_are_counted():
    rows = make_gallery()
    drawn = panels(rows)
    assert [(panel.person, panel.mechanism) for panel in drawn] == list(
        product((1, 2, 3, 4), rows["mechanism"].unique())
    )
    for panel in drawn:
        assert (panel.shared, panel.rebuilt) == (0.5, 0.75)
        paths = dict(panel.paths)
        (walk,) = paths["true"]
        length_px, text = panel.bar
        step = np.hypot(*np.diff(walk, axis=0).T)
        metre_px = length_px / float(text.split()[0])
        assert step == pytest.approx(metre_px, abs=1e-6)  # Each step is 1 m.
        assert len(paths["shared leak"]) == 4
        assert ((walk >= 0) & (walk <= SIZE)).all()


def test_the_limit_is_asked_of_noise_and_not_of_raw_positions(table):
    chosen = pictures(table)[4]
    noisy = [
        name
        for _, _, name in chosen.chart.marks
        if not name.startswith("raw positions")
    ]
    assert len(noisy) < len(chosen.chart.marks)
    assert f"of {len(noisy)} levels" in chosen.caption
