"""Figures over the level: what is drawn, that it is the numbers, and that odd data survive."""

import xml.etree.ElementTree as ET
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from helpers.drawn import assert_is_readable, described, draw, named
from helpers.finished_runs import (
    INDEPENDENT,
    emptied,
    everything,
    levels,
    make_matched,
    make_run,
    make_summary,
)
from helpers.pages import assert_as_approved

from evaluation.analysis import matching
from evaluation.reporting.figures.drawing import draw_all, figures_of, number
from evaluation.reporting.rows import compared_levels, schemes

SWEPT = (("fid", (1.0, 1000.0, 1e5)), ("fixed", (0.1, 0.7, 1.0)))
BOTH = levels(swept=SWEPT)
LINEAR = levels(swept=SWEPT, rules=("",), others=[])
STRANGERS = [
    *levels(swept=SWEPT, rules=("",), others=[]),
    *[("ou", at) for at in (0.2, 0.4, 0.8)],
    *[("mine", at) for at in (1.0, 10.0, 1000.0)],
]
ODD_NAMES = ["<script>", "a_$b^{c}$ & \\d", "広場 & 'x'", "line\nbreak\x1b[31m", "x" * 300, ""]


def drawn_from(frame, name, dataset="students03"):
    return draw(make_run(dataset=dataset, summary=frame.assign(dataset=dataset)), name)


def figures_from(frame, matched):
    run = make_run(summary=frame, matched=matched)
    names = ("fid_threshold", "fixed_error", "operating_points", "after_attack")
    return [draw(run, name, whole=True) for name in names]


def lines_of(ax):
    return [line for line in ax.lines if len(line.get_xdata()) > 1]


def test_what_is_drawn_of_a_run_is_what_was_read_and_approved():
    run = everything()
    drawn = {one.name: draw(run, one.name) for one in figures_of(run)}
    text = "\n".join(f"{name}: {described(one)}" for name, one in drawn.items() if one)
    assert_as_approved(text, Path(__file__).with_name("drawn.txt"))


class TestEveryFigure:
    @pytest.mark.parametrize("at", [BOTH, STRANGERS])
    def test_text_is_readable(self, at):
        for figure in figures_from(make_summary(at), make_matched()):
            assert_is_readable(figure)

    def test_the_users_own_style_changes_no_byte(self, tmp_path):
        # test_untrusted_names.py compares the pages of two processes.
        frame = make_summary(LINEAR, attacks=())
        run = make_run(**emptied(make_run()) | {"summary": frame})
        first = draw_all(run, folder=tmp_path / "a", pdf=True)
        with mpl.rc_context({"font.size": 30, "svg.fonttype": "none"}):
            draw_all(run, folder=tmp_path / "b", pdf=True)
        for path in first:
            assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
        assert not list((tmp_path / "a").glob(".*"))

    @pytest.mark.parametrize("name", ODD_NAMES)
    def test_odd_names_are_drawn_as_they_are(self, tmp_path, name):
        frame = make_summary([("fid", 1.0), ("fid", 10.0)], dataset=name, attacks=())
        frame = frame[frame["metric"] == "plr"]
        run = make_run(dataset=name, **emptied(make_run()) | {"summary": frame})
        paths = draw_all(run, folder=tmp_path, pdf=True)
        assert {path.name for path in paths} == {"fid_threshold.pdf", "fid_threshold.svg"}
        assert all(ET.parse(path) for path in paths if path.suffix == ".svg")

    def test_names_of_files_are_plain_and_each_is_there_once(self):
        at = [("fid", 1.0), ("my.module:Mine,a=../x", 1.0), ("my.module:Mine,a=.._x", 2.0)]
        names = [one.name for one in figures_of(make_run(at=at))]
        assert len(set(names)) == len(names)
        assert all(Path(name).name == name and not name.startswith(".") for name in names)
        assert sum(name.startswith("sweep-my.module") for name in names) == 2

    @pytest.mark.parametrize(
        ("keep", "expected"),
        [
            (lambda f: f["mechanism"] == "fid", [True, False, True, False]),
            (lambda f: f["mechanism"].isin(["raw", "fixed"]), [False, True, True, False]),
            (lambda f: f["mechanism"] == "raw", [False] * 4),
            (lambda f: f["consumer"] == "shared", [True, True, False, False]),
            (lambda f: f["metric"] == "missed_conflict_rate", [True, True, False, False]),
            (lambda f: f["level"].isna() | (f["level"] == 1.0), [True, True, True, False]),
        ],
    )
    def test_missing_parts_leave_out_no_more_than_they_must(self, keep, expected):
        frame = make_summary(LINEAR, attacks=())
        found = figures_from(frame[keep(frame)], make_matched()[:0])
        assert [figure is not None for figure in found] == expected

    def test_unknown_intervals_and_values_and_zeros_do_not_stop_it(self):
        frame = make_summary(LINEAR, attacks=())
        frame[["ci_low", "ci_high"]] = np.nan
        frame.loc[frame["metric"] == "ael", "value"] = np.nan
        frame.loc[frame["metric"].isin(["mel", "missed_conflict_rate"]), "value"] = 0.0
        matched = make_matched()
        matched[["fid", "fid_low", "fixed_high"]] = np.nan
        assert None not in figures_from(frame, matched)[:3]

    @pytest.mark.parametrize(
        ("value", "text"),
        [(1.0, "1"), (0.25, "0.25"), (1000.0, "1000"), (1e4, "10⁴"), (1e12, "10¹²"), (0.0, "0")],
    )
    def test_numbers_are_short(self, value, text):
        assert number(value) == text


class TestSchemes:
    def test_each_mechanism_is_one_but_controls_and_its_rules_stand_together(self):
        names = [one.name for one in schemes(make_summary(levels()))]
        assert names == ["fid", "fid", "fixed", "fixed"]
        at = [("ou:tau=3", 1.0), ("ou:tau=3,adding=independent", 1.0), ("ou:tau=9", 1.0)]
        assert [one.name for one in schemes(make_summary(at))] == ["ou:tau=3"] * 2 + ["ou:tau=9"]
        found = schemes(make_summary([*STRANGERS, *levels(rules=(INDEPENDENT,), others=[])]))
        assert [(one.mechanism, one.log, one.rule_text) for one in found] == [
            ("fid", True, "linear adding"),
            (f"fid{INDEPENDENT}", True, "independent adding"),
            ("fixed", False, "linear adding"),
            (f"fixed{INDEPENDENT}", False, "independent adding"),
            ("ou", False, "any adding"),
            ("mine", True, "linear adding"),
        ]
        # Without a rule it is shown under both.
        assert found[4].rules == ("linear", "independent")

    def test_compared_is_what_costs_most_nearly_the_same(self):
        # Misses rise along the levels: fid 1 costs less than any fixed level of its rule.
        assert compared_levels(make_summary(levels())) == [
            ("raw", None),
            ("fid", 1.0),
            ("fixed", 0.4),
            (f"fid{INDEPENDENT}", 1.0),
            (f"fixed{INDEPENDENT}", 0.4),
        ]
        wheres = compared_levels(make_summary(STRANGERS))
        assert ("ou", 0.2) in wheres
        assert len(wheres) == len(set(wheres)) == 5
        alone = compared_levels(make_summary([("raw", np.nan), ("ou", 0.2), ("ou", 0.8)]))
        assert alone == [("raw", None), ("ou", 0.8)]


class TestTheSweep:
    def test_the_paper_is_marked_on_its_own_recording_in_linear_panels_only(self):
        def hollow(ax):
            lines = [one for one in ax.lines if one.get_markerfacecolor() == "white"]
            return sorted(line.get_ydata()[0] for line in lines)

        own, plaza = (
            drawn_from(make_summary(BOTH), "fid_threshold", name)
            for name in ("students03", "plaza")
        )
        ou = drawn_from(make_summary(STRANGERS), "sweep-ou")
        assert hollow(own.axes[0]) == pytest.approx([10.5, 15.2, 30.5])
        assert not any(hollow(ax) for ax in [own.axes[1], *plaza.axes, *ou.axes])

    def test_several_predictors_have_a_line_each_with_its_own_look(self):
        names = [f"predictor_{n}" for n in range(7)]
        figure = drawn_from(make_summary(LINEAR, predictors=names), "fid_threshold")
        drawn = [line for line in lines_of(figure.axes[0]) if line.get_linestyle() != ":"]
        assert len(drawn) == len({(one.get_color(), one.get_marker()) for one in drawn}) == 5

    def test_an_attack_that_bears_the_name_of_a_predictor_is_not_drawn_as_one(self):
        odd = make_summary(LINEAR, attacks=[("least_squares", "blind"), ("shared", "blind")])
        more = odd[odd["knowledge"] != ""].assign(metric="missed_conflict_rate")
        for name in ("fid_threshold", "fixed_error"):
            one, other = (
                drawn_from(frame, name) for frame in (pd.concat([odd, more]), make_summary(LINEAR))
            )
            assert described(one) == described(other)


def test_without_any_matched_point_the_measured_ones_are_in_the_plane():
    nothing = pd.DataFrame(columns=matching.COLUMNS)
    run = make_run(summary=make_summary(LINEAR), matched=nothing)
    lines = draw(run, "operating_points").axes[0].lines
    assert {line.get_linestyle() for line in lines} == {"None"}


class TestAfterAttack:
    def test_without_an_attack_or_a_level_there_is_none(self):
        frame = make_summary(LINEAR, attacks=[("averaging", "oracle")])
        for nothing in (
            make_summary(attacks=[("identity", "blind")]),
            frame[frame["mechanism"] == "raw"],
            frame[frame["consumer"] == "shared"],
        ):
            assert drawn_from(nothing, "after_attack") is None
        only = drawn_from(frame[frame["mechanism"] == "fixed"], "after_attack")
        assert len(only.axes) == 1
        assert named(only) == ["as shared", "averaging (oracle), a reference", "95 % interval"]

    def test_more_attacks_than_looks_and_odd_names_do_not_stop_it(self):
        many = [(f"mine_{n}:{'x' * 40}$_", "blind") for n in range(9)]
        frame = make_summary(BOTH, attacks=[*many, *[(f"o{n}", "oracle") for n in range(4)]])
        frame["ci_low"] = np.nan
        figure = drawn_from(frame, "after_attack")
        assert len(lines_of(figure.axes[0])) == 2 * (1 + 5 + 2)
