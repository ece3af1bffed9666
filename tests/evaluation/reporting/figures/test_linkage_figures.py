"""Figures of linkage: whose lines are drawn, that cells are the numbers, and what tells what."""

import re

import numpy as np
import pandas as pd
import pytest
from helpers.drawn import assert_is_readable, draw, named
from helpers.finished_runs import (
    levels,
    make_curves,
    make_linkability,
    make_run,
    make_summary,
)

from evaluation.reporting.figures.drawing import draw_all

LEVELS = levels(swept=(("fid", (1.0, 1000.0, 1e5)), ("fixed", (0.1, 0.7, 1.0))), others=[])
ATTACKS = {"shape@radial_rts": 0.6, "shape": 0.5, "histogram": 0.3}
TASKS = {
    "rerelease": ATTACKS,
    "split": dict.fromkeys(ATTACKS, 0.03),
    "handover-2s": {"kinematic": 0.8, "histogram": 0.2, "dtw": 0.1},
    "new_traversal": {"shape": 0.02, "behaviour": 0.03, "profile": 0.01},
}


def make_frame(tasks=TASKS, *, dataset="students03", at=LEVELS):
    return make_linkability(at, tasks=tasks, dataset=dataset)


def drawn_from(frame, dataset="students03", *, whole=False):
    return draw(make_run(dataset=dataset, at=LEVELS, linkability=frame), "linkability", whole=whole)


@pytest.fixture(scope="module")
def drawn():
    return drawn_from(make_frame(), whole=True)


def grid(figure):
    return np.reshape(figure.axes, figure.axes[0].get_gridspec().get_geometry())


def curves(ax):
    """The lines over the level: neither those across a panel nor the hollow markers."""
    return [line for line in ax.lines if "None" not in (line.get_marker(), line.get_linestyle())]


class TestLinesOverTheLevel:
    def test_levels_in_any_order_are_drawn_by_rising_level_and_gaps_do_not_stop_it(self):
        frame = make_frame({"rerelease": ATTACKS}, at=LEVELS[::-1])
        for ax in grid(drawn_from(frame))[0]:
            assert all(np.all(np.diff(line.get_xdata()) > 0) for line in curves(ax))
        frame[["ci_low", "ci_high"]] = np.nan
        frame.loc[frame["level"] == 1000.0, "rank1"] = np.nan
        lines = curves(drawn_from(frame).axes[0])
        np.testing.assert_array_equal(lines[0].get_xdata(), [1.0, 1e5])

    def test_the_strongest_of_each_task_come_first_and_look_alike_everywhere(self, drawn):
        assert named(drawn)[:5] == [
            "shape@radial_rts (informed)",
            "kinematic (informed)",
            "behaviour (informed)",
            "shape (informed)",
            "histogram (informed)",
        ]
        assert [len(curves(ax)) for ax in grid(drawn)[:, 0]] == [3, 3, 2, 2]
        handles = drawn.legends[0].get_lines()
        looks = {line.get_color(): line.get_marker() for line in handles[:5]}
        assert len(looks) == 5
        for ax in drawn.axes:
            assert all(looks[line.get_color()] == line.get_marker() for line in curves(ax))
        assert "by mean rank 1" in drawn._suptitle.get_text()

    def test_strength_is_that_over_the_levels_without_raw_and_the_ceiling(self):
        frame = make_frame({"rerelease": {"shape": 0.5, "dtw": 0.6}})
        alone = frame["level"].isna() & (frame["consumer"] == "rerelease/shape")
        frame.loc[alone, "rank1"] = 1.0
        assert named(drawn_from(frame))[:2] == ["dtw (informed)", "shape (informed)"]

    def test_a_task_near_chance_has_a_shorter_axis_and_says_so(self, drawn):
        tops = [ax.get_ylim()[1] for ax in grid(drawn)[:, 0]]
        assert tops == pytest.approx([103.0, 10.3, 103.0, 10.3])
        notes = [[text.get_text() for text in ax.texts] for ax in grid(drawn)[:, 0]]
        assert notes == [[], ["axis ends at 10 %"], [], ["axis ends at 10 %"]]
        for in_row in grid(drawn):
            assert len({ax.get_ylim() for ax in in_row}) == 1
        frame = make_frame({"split": {"shape": 0.03}})
        frame.loc[frame["ci_high"] > 0.02, "ci_high"] = 0.4
        assert drawn_from(frame).axes[0].get_ylim()[1] == pytest.approx(103.0)

    def test_without_raw_and_the_ceiling_there_is_chance(self):
        bare = make_frame()
        bare = drawn_from(bare[bare["level"].notna()])
        across = [line for line in bare.axes[0].lines if tuple(line.get_xdata()) == (0, 1)]
        assert [line.get_ydata()[0] for line in across] == pytest.approx([0.72])
        assert named(bare)[5:] == ["chance", "95 % interval (the 2 strongest)"]

    def test_recorded_tasks_are_of_the_data_set_and_the_simulated_one_has_its_own(self):
        def title(frame):
            return drawn_from(frame)._suptitle.get_text()

        other = make_frame({"rerelease": {"dtw": 0.9}}, dataset="plaza")
        figure = drawn_from(pd.concat([make_frame(), other], ignore_index=True))
        assert not any("dtw" in name for name in named(figure))
        assert re.match(
            r"students03: .*\(new_traversal: plaza-two-sessions\)$", figure._suptitle.get_text()
        )
        assert "new_traversal\n(simulated)\nrank 1 (%)" in [ax.get_ylabel() for ax in figure.axes]
        assert title(make_frame({"new_traversal": ATTACKS})).startswith("plaza-two-sessions: ")
        assert "plaza" not in title(make_frame({"rerelease": ATTACKS}))

    def test_without_linkage_or_levels_there_is_none(self):
        frame = make_frame()
        is_linked = frame["knowledge"] != ""
        for nothing in (frame[:0], frame[~is_linked], frame[frame["level"].isna()]):
            assert drawn_from(nothing) is None
        assert drawn_from(frame.assign(rank1=np.nan)) is None
        assert drawn_from(make_frame({"split": ATTACKS}), dataset="plaza") is None
        only = drawn_from(frame[frame["mechanism"] == "fixed"])
        assert grid(only).shape == (4, 1)
        assert only.get_figwidth() == 3.5

    def test_text_lies_within_is_readable_and_the_legend_below_the_panels(self, drawn):
        assert_is_readable(drawn)

    def test_long_names_are_short(self):
        frame = make_frame({"rerelease": {f"mine:{'x' * 200}": 0.5}})
        assert re.fullmatch(r"mine:x+\.\.\.x+ \(informed\)", named(drawn_from(frame))[0])

    def test_the_run_is_drawn_by_any_number_of_workers_alike(self, tmp_path):
        at = [("raw", np.nan), ("fid", 1.0), ("fid", 10.0)]
        few = {"summary": make_summary(at, attacks=()), "linkability": make_frame()[:0]}
        run = make_run(**few, curves=make_curves()[:0])
        one, two = (draw_all(run, folder=tmp_path / f"{jobs}", jobs=jobs) for jobs in (1, 2))
        assert {path.stem for path in one} == {"fid_threshold", "operating_points"}
        assert [path.read_bytes() for path in one] == [path.read_bytes() for path in two]


class TestDescriptorAgainstLinkability:
    def test_controls_are_marked_and_a_descriptor_of_zero_is_on_the_axis(self):
        frame = make_summary()
        frame.loc[frame["mechanism"] == "offset", "value"] = 0.0
        figure = draw(make_run(summary=frame), "dissociation-rerelease", whole=True)
        assert len(figure.axes) == 6
        labels = set(named(figure))
        assert {"control: offset", "control: correlated", "control: thin"} <= labels
        ael = figure.axes[1]
        assert ael.get_xscale() == "symlog"
        (diamond,) = [line for line in ael.lines if line.get_marker() == "D"]
        assert list(diamond.get_xdata()) == [0.0]
        low, high = ael.get_xlim()
        assert low < 0.0 < high

    def test_without_a_sweep_there_is_none(self):
        run = make_run(at=[("raw", np.nan), ("offset", 0.4)])
        assert draw(run, "dissociation-rerelease") is None


def test_without_curves_there_are_no_misses_over_false_alarms():
    assert draw(make_run(curves=make_curves()[:0]), "false_alarms") is None
