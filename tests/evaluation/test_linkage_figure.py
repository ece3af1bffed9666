"""The linkage figure: whose lines are drawn, that they are the numbers, and where axes end."""

import xml.etree.ElementTree as ET
from functools import partial

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from evaluation.analysis import linkability, matching, summary
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.draw import draw_all
from evaluation.reporting.figures.linkage import linkage_figure

LEVELS = [
    ("clean", np.nan),
    ("raw", np.nan),
    *[
        (f"{name}{suffix}", level)
        for suffix in ("", ":adding=independent")
        for name, levels in (("fid", (1.0, 1000.0, 1e5)), ("fixed", (0.1, 0.7, 1.0)))
        for level in levels
    ],
]
ATTACKS = {"shape@radial_rts": 0.6, "shape": 0.5, "histogram": 0.3}
TASKS = {
    "rerelease": ATTACKS,
    "split": dict.fromkeys(ATTACKS, 0.03),
    "handover-2s": {"kinematic": 0.8, "histogram": 0.2, "dtw": 0.1},
    "new_traversal": {"shape": 0.02, "behaviour": 0.03, "profile": 0.01},
}


def make_frame(tasks=TASKS, *, dataset="students03", levels=LEVELS):
    rows = []
    for task, attacks in tasks.items():
        for m, (mechanism, level) in enumerate(levels):
            where = {
                "dataset": linkability.dataset_of(f"{task}/x", dataset=dataset),
                "mechanism": mechanism,
                "level": level,
                "invalid": "",
                "outcome": "links",
                "chance": 0.007,
            }
            control = {"consumer": f"{task}/control-random", "knowledge": "", "rank1": 0.99}
            rows.append(where | control | {"cohort": "all"})
            for attack, strength in attacks.items():
                for knowledge, share in (("blind", 0.5), ("informed", 1.0), ("oracle", 1.2)):
                    rank1 = share * strength / (1 + 0.1 * m)
                    row = {"consumer": f"{task}/{attack}", "knowledge": knowledge, "rank1": rank1}
                    row |= {"ci_low": 0.9 * rank1, "ci_high": 1.1 * rank1}
                    rows.append(where | row | {"cohort": "all"})
                    rows.append(where | row | {"cohort": "without_groups", "rank1": 0.99})
    return pd.DataFrame(rows, columns=linkability.COLUMNS)


def drawn_from(frame, dataset="students03"):
    with figure_style.style():
        figure = linkage_figure(frame, dataset=dataset)
        if figure is not None:
            figure.draw_without_rendering()
    return figure


@pytest.fixture(scope="module")
def drawn():
    return drawn_from(make_frame())


def grid(figure):
    return np.reshape(figure.axes, figure.axes[0].get_gridspec().get_geometry())


def curves(ax):
    """The lines over the level: neither those across a panel nor the hollow markers."""
    return [line for line in ax.lines if line.get_marker() not in ("", "None", None)
            and line.get_linestyle() != "None"]  # fmt: skip


def across(ax):
    return [line.get_ydata()[0] for line in ax.lines if tuple(line.get_xdata()) == (0, 1)]


def named(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_each_task_has_a_row_and_each_way_of_adding_a_column(drawn):
    axes = grid(drawn)
    assert [ax.get_ylabel() for ax in axes[:, 0]] == [
        "rerelease\n(upper bound)\nrank 1 (%)",
        "split\nrank 1 (%)",
        "handover-2s\nrank 1 (%)",
        "new_traversal\n(simulated)\nrank 1 (%)",
    ]
    titles = [ax.get_title(loc="left") for ax in axes[0]]
    assert titles == [
        f"{scheme},\n{rule} adding"
        for scheme in ("FID-controlled sharing", "fixed added error")
        for rule in ("linear", "independent")
    ]
    assert [ax.get_xscale() for ax in axes[0]] == ["log", "log", "linear", "linear"]
    assert all(ax.get_xlabel().endswith(("(m)", "(1/(m² s))")) for ax in axes[-1])


def test_the_lines_are_the_results_of_informed_adversaries_in_percent(drawn):
    frame = make_frame()
    of = (frame["cohort"] == "all") & (frame["knowledge"] == "informed")
    panels = ["fid", "fid:adding=independent", "fixed", "fixed:adding=independent"]
    for ax, mechanism in zip(grid(drawn)[0], panels, strict=True):
        rows = frame[of & (frame["consumer"] == "rerelease/shape@radial_rts")]
        rows = rows[rows["mechanism"] == mechanism]
        line = curves(ax)[0]
        np.testing.assert_array_equal(line.get_xdata(), rows["level"])
        np.testing.assert_allclose(line.get_ydata(), 100 * rows["rank1"])
        (edge, *_) = ax.collections
        assert edge.get_datalim(ax.transData).y1 == pytest.approx(100 * rows["ci_high"].max())


def test_levels_in_any_order_are_drawn_by_rising_level():
    frame = make_frame({"rerelease": ATTACKS}, levels=LEVELS[::-1])
    for ax in grid(drawn_from(frame))[0]:
        assert all(np.all(np.diff(line.get_xdata()) > 0) for line in curves(ax))


def test_the_strongest_of_each_task_come_first_and_look_alike_everywhere(drawn):
    assert named(drawn)[:5] == [
        "shape@radial_rts (informed)",
        "kinematic (informed)",
        "behaviour (informed)",
        "shape (informed)",
        "histogram (informed)",
    ]
    counts = [len(curves(ax)) for ax in grid(drawn)[:, 0]]
    assert counts == [3, 3, 2, 2]
    handles = drawn.legends[0].get_lines()
    looks = {line.get_color(): line.get_marker() for line in handles[:5]}
    assert len(looks) == 5
    for ax in drawn.axes:
        assert all(looks[line.get_color()] == line.get_marker() for line in curves(ax))
    shape = handles[3].get_color()
    assert [any(line.get_color() == shape for line in curves(ax)) for ax in grid(drawn)[:, 0]] == [
        True, True, False, True,
    ]  # fmt: skip
    assert "by mean rank 1" in drawn._suptitle.get_text()


def test_strength_is_that_over_the_levels_without_raw_and_the_ceiling():
    frame = make_frame({"rerelease": {"shape": 0.5, "dtw": 0.6}})
    alone = frame["level"].isna() & (frame["consumer"] == "rerelease/shape")
    frame.loc[alone, "rank1"] = 1.0
    assert named(drawn_from(frame))[:2] == ["dtw (informed)", "shape (informed)"]


def test_a_task_near_chance_has_a_shorter_axis_and_says_so(drawn):
    tops = [ax.get_ylim()[1] for ax in grid(drawn)[:, 0]]
    assert tops == pytest.approx([103.0, 10.3, 103.0, 10.3])
    notes = [[text.get_text() for text in ax.texts] for ax in grid(drawn)[:, 0]]
    assert notes == [[], ["axis ends at 10 %"], [], ["axis ends at 10 %"]]
    for in_row in grid(drawn):
        assert len({ax.get_ylim() for ax in in_row}) == 1
    frame = make_frame({"split": {"shape": 0.03}})
    frame.loc[frame["ci_high"] > 0.02, "ci_high"] = 0.4
    assert drawn_from(frame).axes[0].get_ylim()[1] == pytest.approx(103.0)


def test_chance_the_ceiling_and_raw_are_there(drawn):
    for ax in grid(drawn)[2]:
        assert across(ax) == pytest.approx([0.7, 80.0])
    raws = [line for line in grid(drawn)[2, 0].lines if line.get_linestyle() == ":"]
    assert [line.get_ydata()[0] for line in raws] == pytest.approx([80 / 1.1, 20 / 1.1])
    assert {tuple(line.get_xdata()) for line in raws} == {(0.95, 1.0)}
    assert named(drawn)[5:] == [
        "raw (at its edge)",
        "ceiling (no error at all)",
        "chance",
        "95 % interval (the 2 strongest)",
    ]
    bare = make_frame()
    bare = drawn_from(bare[bare["level"].notna()])
    assert across(bare.axes[0]) == pytest.approx([0.7])
    assert named(bare)[5:] == ["chance", "95 % interval (the 2 strongest)"]


def test_what_does_not_link_is_hollow():
    frame = make_frame()
    at = (frame["consumer"] == "rerelease/shape") & (frame["mechanism"] == "fid")
    frame.loc[at & (frame["level"] == 1.0), "outcome"] = "no link detected"
    frame.loc[at & (frame["level"] == 1000.0), "invalid"] = "clock"
    figure = drawn_from(frame)
    hollow = [
        list(line.get_xdata())
        for line in figure.axes[0].lines
        if line.get_markerfacecolor() == "white" and len(line.get_xdata())
    ]
    assert hollow == [[1.0, 1000.0]]
    assert "does not link, or is invalid" in named(figure)


def test_recorded_tasks_are_of_the_data_set_and_the_simulated_one_has_its_own():
    other = make_frame({"rerelease": {"dtw": 0.9}}, dataset="plaza")
    figure = drawn_from(pd.concat([make_frame(), other], ignore_index=True))
    assert not any("dtw" in name for name in named(figure))
    assert figure._suptitle.get_text().endswith("(new_traversal: plaza-two-sessions)")
    assert figure._suptitle.get_text().startswith("students03: ")
    only = drawn_from(make_frame({"new_traversal": ATTACKS}))
    assert only._suptitle.get_text().startswith("plaza-two-sessions: ")
    recorded = drawn_from(make_frame({"rerelease": ATTACKS}))
    assert "plaza" not in recorded._suptitle.get_text()


def test_without_linkage_or_levels_there_is_no_such_figure():
    frame = make_frame()
    assert drawn_from(frame[:0]) is None
    assert drawn_from(frame[frame["knowledge"] == ""]) is None
    assert drawn_from(frame[frame["level"].isna()]) is None
    assert drawn_from(make_frame({"split": ATTACKS}), dataset="plaza") is None
    only = drawn_from(frame[frame["mechanism"] == "fixed"])
    assert grid(only).shape == (4, 1)
    assert only.get_figwidth() == 3.5


def test_text_lies_within_the_figure_is_readable_and_the_legend_below_the_panels(drawn):
    renderer = FigureCanvasAgg(drawn).get_renderer()
    room = drawn.bbox
    legend = drawn.legends[0].get_window_extent(renderer)
    title = drawn._suptitle.get_window_extent(renderer)
    for box in (legend, title):
        assert room.x0 <= box.x0 <= box.x1 <= room.x1
    for ax in drawn.axes:
        panel = ax.get_tightbbox(renderer)
        assert legend.y1 <= panel.y0 <= panel.y1 <= title.y0
        assert room.x0 <= panel.x0 <= panel.x1 <= room.x1
    assert drawn.get_figwidth() == 7.16
    sizes = [text.get_fontsize() for text in drawn.findobj(lambda a: hasattr(a, "get_fontsize"))]
    assert min(sizes) >= 7


def test_unknown_values_and_intervals_do_not_stop_it():
    frame = make_frame()
    frame[["ci_low", "ci_high"]] = np.nan
    frame.loc[frame["level"] == 1000.0, "rank1"] = np.nan
    figure = drawn_from(frame)
    np.testing.assert_array_equal(curves(figure.axes[0])[0].get_xdata(), [1.0, 1e5])
    frame["rank1"] = np.nan
    assert drawn_from(frame) is None


@pytest.mark.parametrize("name", ["a_$b^{c}$ & \\d<x>", "広場", "x" * 200])
def test_odd_names_are_drawn_as_they_are(tmp_path, name):
    frame = make_frame({"rerelease": {f"mine:{name}": 0.5}}, dataset=name)
    columns = {*summary.COLUMNS, *matching.COLUMNS}
    empty = pd.DataFrame({column: np.zeros(0) for column in columns})
    paths = draw_all(empty, empty, folder=tmp_path, dataset=name, linkability=frame)
    assert [path.name for path in paths] == [
        f"{figure}.{kind}"
        for figure in ("linkability", "heat_map-rerelease")
        for kind in ("svg", "pdf")
    ]
    ET.parse(paths[0])
    (attack, *_) = named(drawn_from(frame, dataset=name))
    assert attack.startswith("mine:")
    assert attack.endswith(" (informed)")
    assert len(attack) <= 40


def test_drawn_twice_it_is_the_same_and_without_rows_nothing_is_drawn(tmp_path):
    frame = make_frame({"rerelease": {"mine:one": 0.5}})
    columns = {*summary.COLUMNS, *matching.COLUMNS}
    empty = pd.DataFrame({column: np.zeros(0) for column in columns})
    draw = partial(draw_all, empty, empty, dataset="students03")
    first, again = (draw(folder=tmp_path / name, linkability=frame) for name in "ab")
    assert len(first) == 4
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in again]
    assert draw(folder=tmp_path / "c") == []
