"""Figures: curves stand where their numbers are; odd data survive; files are valid."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from helpers.finished_runs import (
    INDEPENDENT,
    emptied,
    levels,
    make_frontier,
    make_run,
    make_speeds,
    make_summary,
    with_links,
)

from evaluation.estimates.frontier import WHITE_NOISE
from evaluation.reporting.charts import (
    Axis,
    Curve,
    Guide,
    LonePoint,
    Look,
    curves_chart,
)
from evaluation.reporting.figures.figure import make_figures, write
from evaluation.reporting.schemes import schemes

SWEPT = (("fid", (1.0, 1000.0, 1e5)), ("fixed", (0.1, 0.7, 1.0)))
BOTH = levels(swept=SWEPT)
LINEAR = levels(swept=SWEPT, rules=("",), others=[])
STRANGERS = [*LINEAR, *(("ou", at) for at in (0.2, 0.4, 0.8))]
STRANGERS += [("mine", at) for at in (1.0, 10.0, 1000.0)]
ODD_NAMES = [
    "<script>",
    "a_$b^{c}$ & \\d",
    "広場 & 'x'",
    "line\nbreak\x1b[31m",
    "x" * 300,
    "",
]
NAMES = (
    "fid_threshold",
    "fixed_error",
    "operating_points",
    "after_attack",
    "linkability",
    "by_speed",
)


def drawn(**changes):
    """The figures of a run by name."""
    return {figure.name: figure for figure in make_figures(make_run(**changes))}


def values(places, chart, *, log):
    """Values of places, (P, 2), by the ticks."""
    rows = []
    for x, y in places:
        row = []
        for place, ticks, is_log in (
            (x, chart.x_ticks, log[0]),
            (y, chart.y_ticks, log[1]),
        ):
            plain = [tick for tick in ticks if tick[1].isascii()]  # not 10⁴
            tick_places, numbers = np.array(plain, dtype=float).T
            numbers = np.log10(numbers) if is_log else numbers
            slope, start = np.polyfit(tick_places, numbers, 1)
            value = start + slope * place
            row.append(10**value if is_log else value)
        rows.append(row)
    return np.array(rows)


@pytest.mark.parametrize("log", [(False, False), (True, False), (True, True)])
def test_marks_bars_and_lines_stand_where_the_numbers_are(log):
    x, y = np.array([1.0, 20.0, 300.0, 900.0]), np.array([0.5, 30.0, np.nan, 60.0])
    curve = Curve(Look(1), "mine", x, np.stack([y, 0.9 * y, 1.1 * y]))
    axes = Axis("level", log[0]), Axis("seen (%)", log[1])
    marked = [LonePoint(Look(6), np.inf, 10.0, "paper")]
    chart = curves_chart(
        [curve], x=axes[0], y=axes[1], guides=[Guide(6, 20.0)], marked=marked
    )
    (_, marks, _), (_, paper, name) = chart.marks
    known, close = np.isfinite(y), {"rtol": 0.03, "atol": 0.4}
    np.testing.assert_allclose(
        values(marks, chart, log=log),
        np.column_stack([x, y])[known],
        rtol=0.03,
        atol=2.0,
    )
    paths = {line.css: line.strokes for line in chart.lines}
    ends = [high for _, high in paths["bar k1"]]
    np.testing.assert_allclose(
        values(ends, chart, log=log)[:, 1], 1.1 * y[known], **close
    )
    for places, value in ((paper, 10.0), (paths["across k6"][0], 20.0)):
        assert values(places, chart, log=log)[0, 1] == pytest.approx(value, rel=0.03)
    assert name == "paper"


@pytest.mark.parametrize("levels", [[3.0], [60.0, 80.0], [1.4], [0.034], [700.0]])
def test_a_logarithmic_axis_has_a_tick_over_any_few_values(levels):
    x = np.array(levels)
    curve = Curve(Look(1), "mine", x, np.ones((3, x.size)))
    chart = curves_chart([curve], x=Axis("level", log=True), y=Axis("seen (%)"))
    assert chart.x_ticks
    for tick in chart.x_ticks:
        assert chart.left <= tick.at <= chart.right
        assert x.min() / 1.1 <= float(tick.text) <= 1.1 * x.max()


def test_a_labelled_curve_without_a_known_value_has_no_label():
    x, known = np.array([1.0, 2.0]), np.ones((3, 2))
    curves = [
        Curve(Look(0), "a", x, known, label="seen"),
        Curve(Look(1), "b", x, np.full((3, 2), np.nan), label="never seen"),
    ]
    chart = curves_chart(curves, x=Axis("level"), y=Axis("seen (%)"))
    assert [label.text for label in chart.labels] == ["seen"]


def test_a_line_over_the_level_is_the_run_and_its_name_tells_the_ends():
    summary = make_summary(LINEAR)
    _, chart = drawn(summary=summary)["fid_threshold"].panels[1]
    (_, path, name), *papers = chart.marks
    is_plr = (summary["consumer"] == "shared") & (summary["metric"] == "plr")
    rows = summary[is_plr & (summary["mechanism"] == "fid")].sort_values("level")
    plr = 100.0 * rows["value"].to_numpy()
    np.testing.assert_allclose(
        values(path, chart, log=(True, False))[:, 1], plr, atol=0.5
    )
    assert name == f"PLR: {plr[0]:.1f} % at eta 1 to {plr[-1]:.1f} % at eta 100000"
    assert sorted(text for *_, text in papers) == [
        "paper: PLR 18.4 % at eta 1",
        "paper: PLR 24 % at eta 1000",
        "paper: PLR 52.6 % at raw",
    ]


def test_the_paper_is_marked_on_its_own_recording_under_linear_adding_only():
    def papers(dataset, name="fid_threshold", at=BOTH):
        summary = make_summary(at, dataset=dataset)
        figure = drawn(dataset=dataset, summary=summary)[name]
        return [
            sum("paper: " in mark[2] for mark in chart.marks)
            for _, chart in figure.panels
        ]

    assert papers("students03") == [3, 0, 3, 0, 4, 0]
    assert not any(papers("plaza") + papers("students03", "sweep-ou", STRANGERS))


def test_plr_over_speed_has_a_curve_a_level_under_its_rules():
    speeds = make_speeds()
    figure = drawn(speeds=speeds)["by_speed"]
    headings = [heading for heading, _ in figure.panels]
    assert headings == ["linear adding", "independent adding"]
    for rule, (_, chart) in zip(("", INDEPENDENT), figure.panels, strict=True):
        ends = "60.0 % at 0.20 m/s to 20.0 % at 1.20 m/s"
        assert [name for *_, name in chart.marks] == [
            f"raw positions after radial_rts (informed): {ends}",
            f"FID noise, eta 1 after radial_rts (informed): {ends}",
        ]
        labels = [label.text for label in chart.labels]
        assert labels == ["raw positions", "FID noise, eta 1"]
        is_curve = speeds["mechanism"] == f"fid{rule}"
        rows = speeds[is_curve & (speeds["consumer"] != "shared")]
        expected = rows[["speed_mps", "value"]].to_numpy() * [1.0, 100.0]
        marked = values(chart.marks[1][1], chart, log=(False, False))
        np.testing.assert_allclose(marked, expected, rtol=0.03, atol=0.4)
    assert "by_speed" not in drawn(speeds=speeds.head(0))


class TestFiles:
    def test_the_users_own_style_changes_no_byte_and_each_kind_is_there(self, tmp_path):
        figures = make_figures(with_links(make_run(summary=make_summary(LINEAR))))
        write(figures, folder=tmp_path / "a", dataset="mine", pdf=True)
        with mpl.rc_context({"font.size": 30, "lines.linewidth": 9}):
            write(figures, folder=tmp_path / "b", dataset="mine", pdf=True)
        paths = sorted((tmp_path / "a").iterdir())
        assert [path.name for path in paths] == sorted(
            f"{name}.{kind}" for name in NAMES for kind in ("pdf", "svg")
        )
        for path in paths:
            assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()

    @pytest.mark.parametrize("name", ODD_NAMES)
    def test_odd_names_are_drawn_as_they_are(self, tmp_path, name):
        frame = make_summary([("fid", 1.0), ("fid", 10.0)], dataset=name, attacks=())
        frame = frame[frame["metric"] == "plr"]
        run = make_run(dataset=name, **emptied(make_run()) | {"summary": frame})
        write(make_figures(run), folder=tmp_path, dataset=name, pdf=True)
        assert {path.name for path in tmp_path.iterdir()} == {
            "fid_threshold.pdf", "fid_threshold.svg",
        }  # fmt: skip
        text = "".join(ET.parse(tmp_path / "fid_threshold.svg").getroot().itertext())
        assert re.sub(r"[\n\x1b]", "?", name[:18]) in text

    def test_names_of_files_are_plain_and_each_is_there_once(self):
        at = [
            ("fid", 1.0),
            ("my.module:Mine,a=../x", 1.0),
            ("my.module:Mine,a=.._x", 2.0),
        ]
        names = [figure.name for figure in make_figures(make_run(at=at))]
        assert len(set(names)) == len(names)
        assert all(
            Path(name).name == name and not name.startswith(".") for name in names
        )
        assert sum(name.startswith("sweep-my.module") for name in names) == 2


def names(swept):
    return [scheme.name for scheme in swept]


def test_each_mechanism_is_a_scheme_but_controls_and_its_rules_stand_together():
    assert names(schemes(make_summary(levels()))) == ["fid", "fid", "fixed", "fixed"]
    at = [("ou:tau=3", 1.0), ("ou:tau=3,adding=independent", 1.0), ("ou:tau=9", 1.0)]
    by_rule = ["ou:tau=3", "ou:tau=3", "ou:tau=9"]
    assert names(schemes(make_summary(at))) == by_rule
    few = make_summary([("ou", 0.2), ("ou", 0.4), *levels()])
    # Beside mechanisms of three levels, two levels are no curve.
    assert set(names(schemes(few))) == {"fid", "fixed"}
    assert set(names(schemes(few, as_points=True))) == {"fid", "fixed", "ou"}
    swept = schemes(
        make_summary([*STRANGERS, *levels(rules=(INDEPENDENT,), others=[])])
    )
    assert [(scheme.mechanism, scheme.log, scheme.rule_text) for scheme in swept] == [
        ("fid", True, "linear adding"),
        (f"fid{INDEPENDENT}", True, "independent adding"),
        ("fixed", False, "linear adding"),
        (f"fixed{INDEPENDENT}", False, "independent adding"),
        ("ou", False, "any adding"),
        ("mine", True, "linear adding"),
    ]
    # A mechanism without a rule is shown under both.
    assert swept[4].rules == ("linear", "independent")


def test_the_frontier_stands_beside_white_noise_and_further_adversaries_are_hollow():
    usual = make_frontier().assign(
        criterion="missed_at_equal_false_alarms", robot="kalman_cv"
    )
    white = usual[usual["mechanism"] == "fixed"].assign(mechanism=WHITE_NOISE)
    many = [
        white,
        *(
            usual.query("mechanism == 'fid'").assign(mechanism=f"m{n}")
            for n in range(7)
        ),
    ]
    knows = many[1][many[1]["metric"] == "plr"].assign(
        consumer="ou_rts", knowledge="anchor"
    )
    made = drawn(frontier=pd.concat([*many, knows.assign(value=0.95)]))["frontier"]
    assert [heading for heading, _ in made.panels] == [
        "robot: Kalman, 1",
        "robot: Kalman, 2",
    ]
    chart = made.panels[0][1]
    assert not made.key
    assert {label.text for label in chart.labels} == {
        "white",
        *(f"m{n}" for n in range(6)),
    }
    marked = [name for _, _, name in chart.marks]
    assert marked[1] == "m0: 77 % at +3, 75 % at +5, 73 % at +7.5"
    (look, places, _), *_ = [mark for mark in chart.marks if "anchor" in mark[2]]
    assert look.hollow
    assert values(places, chart, log=(False, False)) == pytest.approx(
        np.array([[3.0, 95.0]]), abs=0.3
    )
    points = values(chart.marks[1][1], chart, log=(False, False))
    assert points == pytest.approx(
        np.array([[3.0, 77.0], [5.0, 75.0], [7.5, 72.5]]), abs=0.4
    )
    assert "frontier" not in drawn()  # none where alarms differ
    assert "frontier" not in drawn(frontier=usual.iloc[:0].astype(object))
