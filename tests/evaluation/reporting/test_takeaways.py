"""Captions: each tells the numbers of its picture in a short sentence."""

import numpy as np
import pytest
from helpers.finished_runs import levels, make_run, make_summary, with_links

from evaluation.reporting import takeaways
from evaluation.reporting.answers import reference_level
from evaluation.reporting.charts import (
    Axis,
    Curve,
    Look,
    Point,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import make_figures
from evaluation.reporting.pictures import pictures, planes
from isac_track.intervals import Estimate

MOST_WORDS = 25


@pytest.fixture(scope="module")
def run():
    at = levels(others=[("ou", 0.4)])
    summary = make_summary(at, predictors=("least_squares", "kalman_cv"))
    return with_links(make_run(at=at, summary=summary))


@pytest.fixture(scope="module")
def table(run):
    return run.headline


def percent(table, where, shown):
    return f"{100 * table.at(where, shown).value:.0f} %"


def point(name, x, y):
    return Point(Look(0), name, Estimate(x), Estimate(y))


def test_every_caption_is_a_sentence_of_its_numbers(run, table):
    shown = [picture.caption for picture in pictures(table) if picture]
    shown += [picture.caption for drawn in planes(table).values() for picture in drawn]
    shown += [figure.caption for figure in make_figures(run)]
    assert len(shown) > 10
    for text in shown:
        assert text.endswith("."), text
        assert any(character.isdigit() for character in text) or text.startswith(
            "No "
        ), text
        assert max(len(part.split()) for part in text.split(". ")) <= MOST_WORDS, text
        assert "e+" not in text


def test_the_first_three_have_the_numbers_of_the_level_of_the_answers(table):
    where, raw = reference_level(table), ("raw", None)
    text = takeaways.missed_conflicts(table, where)
    assert text.startswith("With FID noise, eta 1, the paper's straight line misses ")
    assert percent(table, where, table.robots[0]) in text
    assert percent(table, raw, table.robots[0]) in text
    text = takeaways.known_positions(table, where)
    assert text.index(percent(table, where, table.shared)) < text.index(
        percent(table, where, table.attacked)
    )
    assert "raises" in text
    assert percent(table, where, table.linked[0]) in takeaways.linked_people(
        table, where
    )


def test_nearly_equal_plr_with_the_widest_gap_is_named():
    points = [point("a", 0.10, 0.9), point("b", 0.11, 0.6), point("c", 0.119, 0.2)]
    points.append(point("d", 0.5, 0.0))
    assert (
        takeaways.unequal_pair(points)
        == "At nearly equal PLR, re-identification differs by up to 70 points: a"
        " against c."
    )
    assert takeaways.unequal_pair(points[2:]).startswith("No two levels")


def test_levels_within_the_limit_are_counted_and_the_cheapest_is_named():
    points = [point("a", 0.1, 0.9), point("b", 0.3, 0.4), point("c", 0.2, 0.45)]
    text = takeaways.within_limit(points, 0.5)
    assert (
        text
        == "2 of 3 levels keep PLR after attack below 50 %; of these, c misses fewest"
        " conflicts, 20 %."
    )
    text = takeaways.within_limit(points[:1], 0.5)
    assert (
        text == "No level keeps PLR after attack below 50 %; the lowest is 90 % with a."
    )


def test_levels_on_the_front_are_counted():
    points = [point("a", 0.1, 0.9), point("b", 0.3, 0.4), point("c", 0.4, 0.45)]
    assert takeaways.on_the_front(points, "PLR").startswith(
        "2 of 3 levels are on the front"
    )
    assert takeaways.on_the_front(points[:2], "PLR").startswith("All 2 levels")


class TestLabels:
    AXES = Axis("level"), Axis("seen (%)")

    def curves(self, *labels, height=50.0):
        x, y = np.array([1.0, 2.0]), np.full((3, 2), height)
        return [
            Curve(Look(n), f"{n}", x, y + n, label) for n, label in enumerate(labels)
        ]

    def test_they_stand_behind_the_axis_and_never_on_each_other(self):
        curves = self.curves("one thing", "another", "third", height=1.0)
        chart = curves_chart(curves, x=self.AXES[0], y=self.AXES[1])
        assert [label.text for label in chart.labels] == [
            "third",
            "another",
            "one thing",
        ]
        heights = np.array([label.y for label in chart.labels])
        assert (np.diff(heights) >= 10.0).all()
        assert heights.max() <= chart.bottom
        assert all(label.x > chart.right for label in chart.labels)

    @pytest.mark.parametrize("labels", [("same", "same"), ("", "a"), ("x" * 40, "a")])
    def test_without_room_or_names_there_are_none(self, labels):
        curves = self.curves(*labels)
        assert label_room(curves) == 0.0
        assert not curves_chart(curves, x=self.AXES[0], y=self.AXES[1]).labels
