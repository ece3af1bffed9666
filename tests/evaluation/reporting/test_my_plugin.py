"""Sentences about a user's own plug-ins."""

import re
from dataclasses import replace

import pytest
from helpers.finished_runs import make_run

from evaluation.reporting.first_screen import first_screen
from evaluation.reporting.my_plugin import plugin_doubts, plugin_lines
from evaluation.reporting.page import render


def interval(value, low=None, high=None):
    return {"value": value, "ci_low": low, "ci_high": high}


ATTACK = {
    "kind": "attack",
    "plugin": "my_attack",
    "knowledge": "informed",
    "metric": "plr",
    "task": "",
    "horizon_s": None,
    "rival": "radial_rts",
    "rival_knowledge": "informed",
    "levels": 5,
    "n": 106,
    "own": interval(0.65, 0.62, 0.68),
    "other": interval(0.9, 0.88, 0.92),
    "difference": interval(-0.25, -0.28, -0.22),
}
LINKER = ATTACK | {
    "kind": "linker",
    "task": "handover-1s",
    "rival": "kinematic",
    "metric": "rank1",
}
PREDICTOR = ATTACK | {
    "kind": "predictor",
    "plugin": "my_tracker",
    "rival": "kalman_cv",
    "horizon_s": 3.0,
    "alarms": interval(0.05),
    "rival_alarms": interval(0.07),
}
MECHANISM = {
    "kind": "mechanism",
    "plugin": "my_noise",
    "level": 0.2,
    "horizon_s": 3.0,
    "robot": "kalman_cv",
    "missed": interval(0.2),
    "as_sent": interval(0.3),
    "attacked": interval(0.8),
    "task": "handover-1s",
    "linked": interval(0.7),
}


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run"))


def with_plugins(run, *records):
    return replace(run, verdict=run.verdict | {"plugins": [*records]})


def test_a_run_of_built_in_plugins_says_nothing(usual):
    assert (plugin_lines(usual), plugin_doubts(usual)) == ([], [])


def test_each_kind_is_compared_in_its_own_metric(usual):
    gap = "90 %, difference -25 points [-28, -22], mean of 5 levels"
    smoother, alarms = "radial Kalman smoother", "false alarms 5 % against 7 %"
    attack, linker, predictor = plugin_lines(
        with_plugins(usual, ATTACK, LINKER, PREDICTOR)
    )
    text = "Yours: my_attack rebuilds 65 % of positions to epsilon, strongest built-in"
    assert attack == f"{text} ({smoother}) {gap}."
    text = (
        "Yours: my_attack re-identifies 65 % after 1 s of silence, strongest built-in"
    )
    assert linker == f"{text} (kinematic) {gap}."
    text = (
        "Yours: my_tracker misses 65 % of future conflicts within 3 s, strongest"
        " built-in"
    )
    assert predictor == f"{text} (Kalman) {gap}; {alarms}."


@pytest.mark.parametrize(
    ("spec", "name"),
    [
        ("my_attack:0.1", "my_attack:0.1"),
        ("my_attack.my_attack:MyAttack", "my_attack"),
        ("my_attack.my_attack:MyAttack:0.1", "my_attack:0.1"),
        ("a.b:Smoother:tau_s=2", "Smoother:tau_s=2"),
    ],
)
def test_folders_are_no_part_of_a_name(usual, spec, name):
    (line,) = plugin_lines(with_plugins(usual, ATTACK | {"plugin": spec}))
    assert line.startswith(f"Yours: {name} rebuilds 65 %")


def test_a_mechanism_has_its_row(usual):
    text = (
        "Yours: my_noise 0.2: a robot (Kalman) misses 20 % of future conflicts within"
        " 3 s; "
    )
    text += "30 % of positions are known to epsilon as sent, 80 % after attack; "
    text += "70 % are re-identified after 1 s of silence."
    assert plugin_lines(with_plugins(usual, MECHANISM)) == [text]
    without_robot = MECHANISM | {
        "robot": "",
        "linked": interval(None),
        "attacked": interval(None),
    }
    assert plugin_lines(with_plugins(usual, without_robot)) == [
        "Yours: my_noise 0.2: 30 % of positions are known to epsilon as sent."
    ]


def test_a_sweep_of_many_levels_is_short(usual):
    lines = plugin_lines(with_plugins(usual, *[MECHANISM] * 8))
    assert len(lines) == 4
    assert lines[-1] == "5 more levels of your mechanisms: tables.txt"


def test_without_an_interval_it_says_so(usual):
    few = ATTACK | {"difference": interval(-0.25)}
    (line,) = plugin_lines(with_plugins(usual, few))
    assert "difference -25 points (too few people for an interval)" in line


def test_alone_it_is_a_doubt(usual):
    without_rival = ATTACK | {
        "rival": "",
        "other": interval(None),
        "difference": interval(None),
    }
    run = with_plugins(usual, without_rival)
    text = "no built-in attack in this run to compare with: add +my_attack"
    assert plugin_doubts(run) == [text]
    rebuilds = "Yours: my_attack rebuilds 65 % of positions to epsilon"
    assert plugin_lines(run) == [f"{rebuilds}; no built-in attack to compare with."]
    screen = " ".join(line.strip() for line in first_screen(run))
    assert f"Doubts: {text}" in screen


def test_the_first_screen_has_the_line(usual):
    screen = first_screen(with_plugins(usual, ATTACK))
    assert sum(line.startswith("Yours: my_attack") for line in screen) == 1
    assert max(map(len, screen)) <= 80


def test_the_page_has_the_lines_above_its_answers(usual):
    run = with_plugins(usual, ATTACK, MECHANISM)
    top = render(run).partition('<div class="cards">')[0]
    shown = re.findall(r'<p class="own">(.*?)</p>', top)
    assert [text.replace("\u00a0", " ") for text in shown] == plugin_lines(run)
    assert len(shown) == 2
    assert 'class="own"' not in render(usual)
