"""The weak-attack detector: each rule fires where it must, and nowhere else."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.addresses import address_at
from helpers.small_runs import single_process, smoke, write_walks

import evaluation
from evaluation.estimates import weak_attacks as flags
from evaluation.estimates.weak_attacks import COLUMNS
from isac_track.intervals import Estimate, percentile_interval

DRAW = np.random.default_rng(0).normal(size=400)
BLIND, INFORMED = "blind", "informed"
BAD = "helpers.cells:Blur"


def estimate(value, *, spread=0.03, own=0.0, n=50):
    """An estimate whose replicates move with all others, and by `own` against them."""
    replicates = value + spread * DRAW + own * DRAW[::-1]
    return Estimate(value, *percentile_interval(replicates), n, replicates)


def make_run(plr, *, level=1.0, mechanism="fixed", shared=0.2, rmse=1.5):
    """One level with PLR by attack and adversary."""
    estimates = {
        address_at(mechanism, level, "shared", "plr"): estimate(shared),
        address_at(mechanism, level, "shared", "rmse"): estimate(rmse),
    }
    for (attack, knowledge), value in plr.items():
        number = value if isinstance(value, Estimate) else estimate(value)
        estimates[address_at(mechanism, level, attack, "plr", knowledge)] = number
    return estimates


def parse_plr(text):
    """PLR by attack and adversary, from `savgol blind .7, mine informed .6`."""
    words = [word.split() for word in text.split(", ")]
    return {(attack, knowledge): float(value) for attack, knowledge, value in words}


def beaten(plr, attack=None):
    """Who is beaten, or whether one attack is, and by whom."""
    rows = flags.flags(make_run(plr))[0]
    rows = rows[
        (rows["kind"] == "beaten")
        & rows["attack"].isin([attack or name for name, _ in plr])
    ]
    names = rows[["attack", "knowledge", "by", "by_knowledge"]].to_numpy().tolist()
    return ["{} {} < {} {}".format(*name) for name in names]


@pytest.mark.parametrize(
    ("plr", "expected"),
    [
        ("a blind .71, a informed .70", "a informed < a blind"),
        ("a blind .70, a informed .71", ""),
        ("a informed .70, a oracle .70", ""),
        # Adversaries are no chain: each may know what the other does not.
        ("a insider .4, a repeats .6", ""),
        ("a repeats .4, a insider .6", "a repeats < a insider"),
        ("a companions .4, a anchor .6", ""),
        ("a companions .4, a informed .6", "a companions < a informed"),
        ("savgol repeats .7, kalman_rts insider .6", ""),
        # Not in the list of simple ones: held against these alone.
        ("another blind .7, mine blind .6", ""),
        # Parameters change no rank.
        (
            "savgol:w=2 blind .7, kalman_rts:q=1 blind .6",
            "kalman_rts:q=1 blind < savgol:w=2 blind",
        ),
        ("kalman_rts:q=1 blind .7, kalman_rts blind .6", ""),
        # To know more is an excuse to win.
        ("savgol informed .7, kalman_rts blind .6", ""),
        (
            "savgol blind .7, kalman_rts informed .6",
            "kalman_rts informed < savgol blind",
        ),
        # It does not smooth, and is held against the control alone.
        ("identity blind .2, kalman_rts blind .7, averaging oracle .3", ""),
        ("identity blind .2, averaging oracle .1", "averaging oracle < identity blind"),
        # The control is never flagged.
        ("identity blind .5, identity informed .1", ""),
    ],
)
def test_who_should_win_and_does_not_is_beaten(plr, expected):
    assert ", ".join(beaten(parse_plr(plr))) == expected


@pytest.mark.parametrize(
    ("name", "simpler"),
    [
        *((name, flags.SIMPLER[:place]) for place, name in enumerate(flags.SIMPLER)),
        *(
            (name, flags.SIMPLER)
            for name in ("radial_rts", "my_attack:Mine", "gaussian_process")
        ),
    ],
)
def test_an_attack_is_held_against_all_simpler_ones(name, simpler):
    others = {(simple, BLIND): 0.7 for simple in flags.SIMPLER if simple != name}
    assert beaten(others | {(name, BLIND): 0.8}, name) == []
    worse = beaten(others | {(name, BLIND): 0.6}, name)
    assert worse == [f"{name} blind < {simple} blind" for simple in simpler]


def test_the_interval_of_the_difference_decides_not_those_of_the_values():
    """Much spread in common is no doubt; a little of one's own is."""
    smoother = {("kalman_rts", BLIND): estimate(0.70, spread=0.1)}
    assert beaten(smoother | {("savgol", BLIND): estimate(0.71, spread=0.1)})
    doubtful = estimate(0.71, spread=0.1, own=0.02)
    assert beaten(smoother | {("savgol", BLIND): doubtful}) == []


def test_a_flag_says_how_much_and_how_often_was_looked():
    estimates = make_run({("identity", BLIND): 0.3, ("savgol", BLIND): 0.25}, level=1.0)
    estimates |= make_run(
        {("identity", BLIND): 0.3, ("savgol", BLIND): 0.6}, level=0.5, rmse=1.0
    )
    (row,) = flags.flags(estimates)[0].to_dict("records")
    assert list(row) == COLUMNS
    assert (row["mechanism"], row["level"], row["compared"]) == ("fixed", 1.0, 2)
    assert row["difference"] == pytest.approx(0.05)
    assert row["ci_low"] <= row["difference"] <= row["ci_high"]
    assert (
        row["sentence"]
        == "savgol (blind) is beaten by identity (blind) at fixed 1: PLR 25.0 % against"
        " 30.0 %, +5.0 [+5.0, +5.0] points"
    )


def ends(quiet, noisy, *, rmse=(0.5, 1.5), shared=(0.5, 0.2), mechanism="fid"):
    """Raw and one level of a mechanism: PLR of one attack at either."""
    attack = ("kalman_rts", BLIND)
    return make_run(
        {attack: quiet}, mechanism="raw", level=None, shared=shared[0], rmse=rmse[0]
    ) | make_run(
        {attack: noisy}, mechanism=mechanism, level=7.0, shared=shared[1], rmse=rmse[1]
    )


def test_success_must_fall_with_the_noise():
    (row,) = flags.flags(ends(0.7, 0.8))[0].to_dict("records")
    assert (row["kind"], row["mechanism"], row["level"]) == (
        "does_not_fall",
        "fid",
        7.0,
    )
    assert (row["attack"], row["by"], row["compared"]) == ("kalman_rts", "", 1)
    assert row["difference"] == pytest.approx(0.1)
    assert "PLR 70.0 % at raw, 80.0 % at fid 7" in row["sentence"]


@pytest.mark.parametrize(
    ("noisy", "falls"),
    [(0.7, True), (estimate(0.79, own=0.02), False), (estimate(0.70, own=0.02), True)],
)
def test_a_fall_within_its_interval_is_none(noisy, falls):
    assert flags.flags(ends(0.8, noisy))[0].empty == falls


def leaking(mechanism):
    """A level that hides nothing, and an attack that is a little worse than none."""
    plr = {("identity", BLIND): 1.0, ("kalman_rts", BLIND): 0.99}
    return make_run(plr, mechanism=mechanism, level=None, shared=1.0, rmse=0.0)


FEW = {("savgol", BLIND): estimate(0.7, n=19), ("kalman_rts", BLIND): 0.6}
FEW_EFFECTIVE = {
    ("savgol", BLIND): replace(estimate(0.7), effective=3.0),
    ("kalman_rts", BLIND): 0.6,
}
SLOW = parse_plr("kalman_rts blind .7, slow_one blind .6")


@pytest.mark.parametrize(
    ("estimates", "why"),
    [
        (leaking("clean"), "all that is shared leaks already"),
        (leaking("mine"), "all that is shared leaks already"),
        (make_run(FEW), "fewer than 20 clusters"),
        (make_run(FEW_EFFECTIVE), "fewer than 20 clusters"),
        (ends(0.7, 0.8, rmse=(1.0, 1.09)), "the noise hardly rises"),
        (ends(0.7, 0.8, shared=(0.5, 0.5)), "PLR as shared does not fall either"),
        (make_run(SLOW), "a slow attack, without the others on the same tracks"),
        (ends(0.7, 0.8, mechanism="clean"), None),
        (make_run(parse_plr("kalman_rts blind .5")), None),
    ],
)
def test_what_is_no_test_is_left_out_and_told(estimates, why):
    rows, looked = flags.flags(estimates, slow={"slow_one"})
    assert rows.empty
    assert looked["left_out"] == ({} if why is None else {why: 1})
    assert not any(looked["comparisons"].values())


def test_the_noisiest_level_is_that_of_the_largest_error_whatever_its_number():
    estimates = ends(0.9, 0.8)
    estimates |= make_run(
        {("kalman_rts", BLIND): 0.95}, mechanism="fid", level=0.1, rmse=3.0
    )
    (row,) = flags.flags(estimates)[0].to_dict("records")
    assert row["level"] == 0.1


def test_the_file_explains_itself_and_has_a_list_even_if_it_is_empty():
    content = json.loads(flags.to_json(*flags.flags({})))
    assert content["flags"] == []
    assert (
        content["kinds"].keys()
        == content["comparisons"].keys()
        == {"beaten", "does_not_fall", "far_from_optimum"}
    )
    assert "not adjusted" in content["intervals"]
    content = json.loads(flags.to_json(*flags.flags(ends(0.7, 0.8, mechanism="mine"))))
    assert list(content["flags"][0]) == COLUMNS
    raw = make_run(
        {("identity", BLIND): 0.7, ("a", BLIND): 0.6}, mechanism="raw", level=None
    )
    assert json.loads(flags.to_json(*flags.flags(raw)))["flags"][0]["level"] is None


def test_lines_are_few_and_say_how_many_levels():
    estimates = {}
    for level in (0.1, 0.2, 0.3):
        savgol = {("savgol", BLIND): 0.7, ("savgol", INFORMED): 0.71}
        # At 0.1 the two are equal but for rounding.
        own = {("mine", INFORMED): 0.7 - level, ("mine", BLIND): 0.5 + level}
        estimates |= make_run(savgol | own, level=level, rmse=1.0)
    is_beaten = "flag: mine ({}) is beaten by {} levels, by up to {} points: flags.json"
    assert flags.lines(flags.flags(estimates)[0]) == [
        is_beaten.format(*parts)
        for parts in (
            (INFORMED, "savgol (blind, informed) at 3 of 3", "31.0 [31.0, 31.0]"),
            (BLIND, "savgol (blind) at 1 of 3", "10.0 [10.0, 10.0]"),
            (INFORMED, "mine (blind) at 2 of 3", "40.0 [40.0, 40.0]"),
        )
    ]
    (line,) = flags.lines(flags.flags(ends(0.7, 0.8))[0])
    assert (
        line
        == "flag: kalman_rts (blind) does not fall with the noise in 1 of 1 mechanisms"
        " (fid), by +10.0 [+10.0, +10.0] points: flags.json"
    )
    assert flags.lines(pd.DataFrame(columns=COLUMNS)) == []


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """24 people, each seen about three times."""
    folder = tmp_path_factory.mktemp("flags")
    walks = write_walks(folder / "walks.csv", n_people=24)
    axes = {
        "mechanisms": ("clean", "raw", "fixed:1"),
        "attacks": ("identity", "kalman_rts", BAD),
    }
    settings = smoke(walks, folder / "run", scenes=18, predictors=(), **axes)
    with single_process():
        return evaluation.run(settings, pictures=False)


def test_a_bad_attack_in_a_real_run_is_flagged_in_the_file_and_the_frame(results):
    bad = results.flags[results.flags["kind"] == "beaten"]
    assert set(bad["attack"]) == {BAD}
    assert set(bad["by"]) == {"identity", "kalman_rts"}
    assert set(bad["mechanism"]) == {"raw", "fixed"}
    content = json.loads((results.out / "flags.json").read_text(encoding="utf-8"))
    assert [row["sentence"] for row in content["flags"]] == results.flags[
        "sentence"
    ].tolist()
    assert content["left_out"]["all that is shared leaks already"] > 0
