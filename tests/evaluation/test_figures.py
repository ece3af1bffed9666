"""Figures: what is drawn, that it is the same each time, and that odd or missing data survive."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from evaluation.analysis import matching, summary
from evaluation.reporting.figures import attack as attack_figure
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures import sweeps as drawing
from evaluation.reporting.figures.draw import draw_all

UNITS = {"plr": "fraction", "ael": "s", "mel": "s", "missed_conflict_rate": "fraction"}
NAMES = ["fid_threshold", "fixed_error", "operating_points"]
ATTACKS = [
    ("identity", "blind"),
    ("moving_average", "blind"),
    ("moving_average", "informed"),
    ("savgol", "informed"),
    ("kalman_rts", "blind"),
    ("kalman_rts", "informed"),
    ("kalman_rts", "oracle"),
    ("radial_rts", "informed"),
    ("averaging", "oracle"),
]
SUFFIXES = ["", ":adding=independent"]
ODD_NAMES = [
    "<script>",
    "a_$b^{c}$ & \\d",
    "広場 & 'x'",
    "line\nbreak\x1b[31m",
    "x" * 300,
    "",
]


def make_summary(*, dataset="students03", suffixes=SUFFIXES, predictors=("least_squares",)):
    levels = [("raw", np.nan)]
    for suffix in suffixes:
        levels += [(f"fid{suffix}", eta) for eta in (1.0, 1000.0, 1e5)]
        levels += [(f"fixed{suffix}", d_sigma) for d_sigma in (0.1, 0.7, 1.0)]
    rows = []
    for n, (mechanism, level) in enumerate(levels):
        cells = [("shared", "plr", 0.5), ("shared", "ael", 3.0), ("shared", "mel", 5.0)]
        cells += [(p, "missed_conflict_rate", 0.1) for p in predictors]
        for consumer, metric, value in cells:
            shown = value / (1 + n) if consumer == "shared" else value * (1 + 0.2 * n)
            numbers = [shown, 0.9 * shown, 1.1 * shown, 55]
            rows.append([dataset, mechanism, level, consumer, "", metric, *numbers, UNITS[metric]])
    return pd.DataFrame(rows, columns=summary.COLUMNS)


def make_attacked(attacks, *, suffixes=SUFFIXES, dataset="students03"):
    """The rows of `make_summary` and PLR after each attack, given with its adversary."""
    frame = make_summary(suffixes=suffixes, dataset=dataset)
    plr = frame[(frame["consumer"] == "shared") & (frame["metric"] == "plr")]
    after = [
        plr.assign(consumer=attack, knowledge=knowledge, value=0.9 - 0.01 * n - 0.1 * plr["value"])
        for n, (attack, knowledge) in enumerate(attacks)
    ]
    return pd.concat([frame, *after], ignore_index=True)


def make_matched(*, dataset="students03", predictors=("least_squares",)):
    curves = [0.2, 0.1, 0.3, 0.4, 0.3, 0.5, -0.2, -0.3, -0.1, 1.0, 50]
    rows = [
        [dataset, "missed", adding, predictor, "shared", "", metric, rate - 0.1, rate, *curves]
        for predictor in predictors
        for adding in ("linear", "independent")
        for metric in ("plr", "ael", "mel")
        for rate in (0.12, 0.18, 0.24)
    ]
    return pd.DataFrame(rows, columns=matching.COLUMNS)


def figures_of(frame, matched, dataset="students03"):
    with figure_style.style():
        found = [
            drawing.sweep_figure(frame, scheme=drawing.FID, dataset=dataset),
            drawing.sweep_figure(frame, scheme=drawing.FIXED, dataset=dataset),
            drawing.operating_figure(frame, matched, dataset=dataset),
            attack_figure.attack_figure(frame, dataset=dataset),
        ]
        for figure in found:
            if figure is not None:
                figure.draw_without_rendering()
    return found


@pytest.fixture(scope="module")
def drawn():
    return figures_of(make_attacked(ATTACKS), make_matched())


def lines_of(ax, linestyle=None):
    return [
        line
        for line in ax.lines
        if len(line.get_xdata()) > 1 and linestyle in (None, line.get_linestyle())
    ]


def test_every_axis_has_a_label_with_a_unit(drawn):
    for figure in drawn:
        labels = [ax.get_ylabel() for ax in figure.axes if ax.get_subplotspec().is_first_col()]
        labels += [ax.get_xlabel() for ax in figure.axes if ax.get_subplotspec().is_last_row()]
        assert labels
        assert all(label.endswith(("(%)", "(s)", "(m)", "(1/(m² s))")) for label in labels)


def test_the_lines_are_the_numbers_of_the_frame_in_percent(drawn):
    frame = make_summary()
    rows = frame[(frame["mechanism"] == "fid") & (frame["metric"] == "missed_conflict_rate")]
    line = lines_of(drawn[0].axes[0], "-")[0]
    np.testing.assert_array_equal(line.get_xdata(), [1.0, 1000.0, 1e5])
    np.testing.assert_allclose(line.get_ydata(), 100 * rows["value"])
    assert drawn[0].axes[0].get_xscale() == "log"
    assert drawn[1].axes[0].get_xscale() == "linear"


def test_raw_is_a_dotted_line_at_its_value(drawn):
    (raw,) = lines_of(drawn[0].axes[0], ":")
    assert raw.get_ydata()[0] == pytest.approx(10.0)


def test_the_paper_is_marked_on_its_own_recording_in_linear_panels_only(drawn):
    hollow = [
        [line for line in ax.lines if line.get_markerfacecolor() == "white"]
        for ax in drawn[0].axes[:2]
    ]
    assert sorted(line.get_ydata()[0] for line in hollow[0]) == pytest.approx([10.5, 15.2, 30.5])
    assert not hollow[1]
    other = drawing.sweep_figure(make_summary(dataset="plaza"), scheme=drawing.FID, dataset="plaza")
    assert not any(line.get_markerfacecolor() == "white" for ax in other.axes for line in ax.lines)


def test_the_plane_shows_the_matched_curve_and_the_measured_points(drawn):
    ax = drawn[2].axes[0]
    fid, fixed = lines_of(ax, "-")[0], lines_of(ax, "--")[0]
    np.testing.assert_allclose(fid.get_xdata(), [12, 18, 24])
    np.testing.assert_allclose(fid.get_ydata(), 20)
    np.testing.assert_allclose(fixed.get_ydata(), 40)
    markers = [line for line in ax.lines if line.get_linestyle() == "None"]
    assert [len(line.get_xdata()) for line in markers] == [3, 3, 1]


def test_text_lies_within_the_figure_and_the_legend_below_the_panels(drawn):
    for figure in drawn:
        renderer = FigureCanvasAgg(figure).get_renderer()
        room = figure.bbox
        legend = figure.legends[0].get_window_extent(renderer)
        title = figure._suptitle.get_window_extent(renderer)
        assert room.x0 <= legend.x0 <= legend.x1 <= room.x1
        assert room.x0 <= title.x0 <= title.x1 <= room.x1
        for ax in figure.axes:
            panel = ax.get_tightbbox(renderer)
            assert panel.y0 >= legend.y1
            assert panel.y1 <= title.y0


def test_fonts_are_readable_in_print(drawn):
    for figure in drawn:
        assert figure.get_figwidth() in (3.5, 7.16)
        assert all(
            text.get_fontsize() >= 7
            for text in figure.findobj(lambda a: hasattr(a, "get_fontsize"))
        )


@pytest.mark.slow  # test_page.py compares two whole reports
def test_drawn_twice_the_files_are_the_same_bytes(tmp_path):
    first = draw_all(
        make_summary(suffixes=[""]), make_matched(), folder=tmp_path / "a", dataset="students03"
    )
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import test_figures as t; "
        "from pathlib import Path; t.draw_all(t.make_summary(suffixes=['']), t.make_matched(), "
        "folder=Path(sys.argv[2]), dataset='students03')"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    (tmp_path / "matplotlibrc").write_text("font.size: 30\nsvg.fonttype: none\n")
    subprocess.run(
        [sys.executable, "-c", code, Path(__file__).parent, tmp_path / "b"],
        check=True,
        env={**environment, "MATPLOTLIBRC": str(tmp_path / "matplotlibrc")},
    )
    assert sorted(path.name for path in first) == sorted(
        f"{name}.{kind}" for name in NAMES for kind in ("svg", "pdf")
    )
    for path in first:
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
    assert not list((tmp_path / "a").glob(".*"))


@pytest.mark.parametrize("name", ODD_NAMES)
def test_odd_names_are_drawn_as_they_are(tmp_path, name):
    frame = make_summary(dataset=name, suffixes=[""])
    frame = frame[(frame["metric"] == "plr") & (frame["mechanism"] == "fid")]
    paths = draw_all(frame, make_matched(dataset=name)[:0], folder=tmp_path, dataset=name)
    assert len(paths) == 2
    for path in paths:
        if path.suffix == ".svg":
            ET.parse(path)


@pytest.mark.parametrize(
    ("keep", "expected"),
    [
        (lambda f: f["mechanism"] == "fid", ["fid_threshold", "operating_points"]),
        (lambda f: f["mechanism"].isin(["raw", "fixed"]), ["fixed_error", "operating_points"]),
        (lambda f: f["mechanism"] == "raw", []),
        (lambda f: f["consumer"] == "shared", ["fid_threshold", "fixed_error"]),
        (lambda f: f["metric"] == "missed_conflict_rate", ["fid_threshold", "fixed_error"]),
        (lambda f: f["level"].isna() | (f["level"] == 1.0), NAMES),
        (lambda f: f["dataset"] == "", []),
    ],
)
def test_missing_parts_leave_out_no_more_than_they_must(keep, expected):
    frame = make_summary(suffixes=[""])
    found = figures_of(frame[keep(frame)], make_matched()[:0])
    names = [*NAMES, "after_attack"]
    drawn = [name for name, figure in zip(names, found, strict=True) if figure is not None]
    assert drawn == expected


def test_unknown_intervals_and_values_and_zeros_do_not_stop_it():
    frame = make_summary(suffixes=[""])
    frame[["ci_low", "ci_high"]] = np.nan
    frame.loc[frame["metric"] == "ael", "value"] = np.nan
    frame.loc[frame["metric"] == "mel", "value"] = 0.0
    frame.loc[frame["metric"] == "missed_conflict_rate", "value"] = 0.0
    matched = make_matched()
    matched[["fid", "fid_low", "fixed_high"]] = np.nan
    assert None not in figures_of(frame, matched)[:3]


def test_several_predictors_have_a_line_each_with_its_own_look():
    names = [f"predictor_{n}" for n in range(7)]
    frame = make_summary(predictors=names, suffixes=[""])
    figure = drawing.sweep_figure(frame, scheme=drawing.FID, dataset="students03")
    drawn = [line for line in lines_of(figure.axes[0]) if line.get_linestyle() != ":"]
    looks = {(line.get_color(), line.get_marker()) for line in drawn}
    assert len(drawn) == len(looks) == 5


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "1"), (0.25, "0.25"), (1000.0, "1000"), (1e4, "10⁴"), (1e12, "10¹²"), (0.0, "0")],
)
def test_numbers_are_short(value, text):
    assert figure_style.number(value) == text


def test_privacy_says_whose_positions_it_is_of(drawn):
    for figure in drawn:
        labels = [ax.get_ylabel() for ax in figure.axes if ax.get_ylabel()]
        private = [label for label in labels if label != "Missed conflicts (%)"]
        assert private
        assert all("shared" in label for label in private)


def named(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_an_attack_is_drawn_as_the_adversary_who_knows_most_short_of_the_oracle(drawn):
    assert named(drawn[3])[:6] == [
        "as shared",
        "moving_average (informed)",
        "savgol (informed)",
        "kalman_rts (informed)",
        "radial_rts (informed)",
        "averaging (oracle), a reference",
    ]


def test_the_lines_after_attack_are_the_numbers_of_the_frame(drawn):
    frame = make_attacked(ATTACKS)
    for ax, mechanism in zip(
        drawn[3].axes,
        ["fid", "fid:adding=independent", "fixed", "fixed:adding=independent"],
        strict=True,
    ):
        lines = [line for line in lines_of(ax) if line.get_linestyle() != ":"]
        assert len(lines) == 6
        kalman = frame[
            (frame["mechanism"] == mechanism)
            & (frame["consumer"] == "kalman_rts")
            & (frame["knowledge"] == "informed")
        ]
        np.testing.assert_allclose(lines[3].get_ydata(), 100 * kalman["value"])
        raws = lines_of(ax, ":")
        assert len(raws) == 6
        assert tuple(raws[0].get_xdata()) == (0.0, 1.0)


def test_the_oracle_is_set_apart(drawn):
    lines = [line for line in lines_of(drawn[3].axes[0]) if line.get_linestyle() != ":"]
    hollow = [line.get_markerfacecolor() == "white" for line in lines]
    assert hollow == [False] * 5 + [True]
    looks = {(line.get_color(), line.get_marker()) for line in lines}
    assert len(looks) == 6


def test_without_an_attack_or_a_level_there_is_no_such_figure():
    def draw(frame):
        return attack_figure.attack_figure(frame, dataset="students03")

    assert draw(make_summary()) is None
    assert draw(make_attacked([("identity", "blind")])) is None
    attacked = make_attacked([("averaging", "oracle")], suffixes=[""])
    assert draw(attacked[attacked["mechanism"] == "raw"]) is None
    assert draw(attacked[attacked["consumer"] == "shared"]) is None
    only = draw(attacked[attacked["mechanism"] == "fixed"])
    assert len(only.axes) == 1
    assert named(only) == ["as shared", "averaging (oracle), a reference", "95 % interval"]


def test_more_attacks_than_looks_and_odd_names_do_not_stop_it(tmp_path):
    many = [(f"mine_{n}:{'x' * 40}$_", "blind") for n in range(9)]
    frame = make_attacked([*many, *[(f"o{n}", "oracle") for n in range(4)]])
    frame["ci_low"] = np.nan
    figure = attack_figure.attack_figure(frame, dataset="students03")
    assert len(lines_of(figure.axes[0])) == 2 * (1 + 5 + 2)
    paths = draw_all(frame, make_matched(), folder=tmp_path, dataset="students03")
    assert {path.stem for path in paths} == {*NAMES, "after_attack"}


def test_an_attack_that_bears_the_name_of_a_predictor_is_not_drawn_as_one():
    frame = make_attacked([("least_squares", "blind"), ("shared", "blind")])
    same = make_summary()
    odd = frame[frame["knowledge"] != ""].assign(metric="missed_conflict_rate")
    for scheme in (drawing.FID, drawing.FIXED):
        with_attack, without = (
            drawing.sweep_figure(one, scheme=scheme, dataset="students03")
            for one in (pd.concat([frame, odd]), same)
        )
        for ax, other in zip(with_attack.axes, without.axes, strict=True):
            for line, same_line in zip(lines_of(ax), lines_of(other), strict=True):
                np.testing.assert_array_equal(line.get_ydata(), same_line.get_ydata())
