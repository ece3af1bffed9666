"""The pictures of the page: a mark stands where its number is, and the front is what none beats."""

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

from evaluation.reporting.answers import headline_of
from evaluation.reporting.headline import levels_of
from evaluation.reporting.names import short_mechanism_name
from evaluation.reporting.pictures import SIZE, panels, pictures, planes

SHARES = re.compile(r" (\d+\.\d) %")


@pytest.fixture(scope="module")
def of():
    summary = make_summary(predictors=("least_squares", "mine"))
    return headline_of(with_links(make_run(summary=summary)))


def middles(chart):
    """Middle of each mark in percent on both axes, as its ticks say; rows have no number."""
    found = []
    for _, ((x, y),), _ in chart.marks:
        at = [np.interp(x, *np.array(chart.x_ticks, dtype=float).T)]
        if chart.y_label:
            at.append(np.interp(y, *np.array(chart.y_ticks[::-1], dtype=float).T))
        found.append(at)
    return np.array(found)


def test_marks_stand_where_their_numbers_are_and_the_numbers_are_those_of_the_run(of):
    known = {f"{100 * one.value:.1f}" for one in of.numbers.values()}
    found = [one.chart for one in pictures(of)]
    assert len(found) == 5
    found += [one.chart for both in planes(of).values() for one in both]
    for chart in found:
        told = [SHARES.findall(name.partition(": ")[2]) for _, _, name in chart.marks]
        assert known.issuperset(share for of_mark in told for share in of_mark)
        expected = np.array(told, dtype=float)
        assert np.allclose(middles(chart), expected, atol=0.2), chart.x_label


def test_rows_and_marks_are_those_of_the_first_table(of):
    lost = pictures(of)[0].chart
    levels, _ = levels_of(of)
    names = [short_mechanism_name(of.known[where[0]], where[1]) for where in levels]
    assert [text for _, text in lost.y_ticks] == names
    assert set(lost.hints) == set(names)
    assert len(lost.marks) == len(levels) * len(of.robots)


def test_the_front_turns_at_the_points_that_no_other_beats(of):
    both = planes(of)
    assert list(both) == ["paper's line", "mine"]
    for chart in [one.chart for of_robot in both.values() for one in of_robot]:
        places = [place for _, (place,), _ in chart.marks]
        # Left and down are better: down is a larger number.
        best = {
            (x, y)
            for x, y in places
            if not any(a <= x and b >= y and (a, b) != (x, y) for a, b in places)
        }
        (corners,) = next(lines for css, lines in chart.lines if css == "front")
        for x, y in best:
            assert any(abs(a - x) < 0.11 and abs(b - y) < 0.11 for a, b in corners)
        assert len(corners) == 2 * len(best) + 1


def test_no_two_mechanisms_look_alike_however_many_there_are():
    others = [
        (f"mine{letter}{rule}", 1.0)
        for letter in "abcdef"
        for rule in ("", ":adding=independent")
    ]
    of = headline_of(make_run(at=levels(others=others)))
    for one in (one for both in planes(of).values() for one in both if one):
        drawn = {(look.css, look.shape) for look in one.key.values()}
        assert len(drawn) == len(one.key) >= len(others) + 5


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
    of = headline_of(make_run(**changes))
    for picture in [
        *pictures(of),
        *[one for both in planes(of).values() for one in both],
    ]:
        assert picture is None or picture.chart.marks


def test_walks_are_drawn_to_scale_and_leaks_are_counted():
    rows = make_gallery()
    found = panels(rows)
    assert [(one.person, one.mechanism) for one in found] == list(
        product((1, 2, 3, 4), rows["mechanism"].unique())
    )
    for one in found:
        assert (one.shared, one.rebuilt) == (0.5, 0.75)
        paths = dict(one.paths)
        (walk,) = paths["true"]
        length_px, text = one.bar
        step = np.hypot(*np.diff(walk, axis=0).T)
        assert step == pytest.approx(
            length_px / float(text.split()[0]), abs=1e-6
        )  # of 1 m each
        assert len(paths["shared leak"]) == 4
        assert ((walk >= 0) & (walk <= SIZE)).all()


def test_the_limit_is_asked_of_noise_and_not_of_raw_positions(of):
    chosen = pictures(of)[4]
    noisy = [
        name
        for _, _, name in chosen.chart.marks
        if not name.startswith("raw positions")
    ]
    assert len(noisy) < len(chosen.chart.marks)
    assert f"of {len(noisy)} levels" in chosen.caption
