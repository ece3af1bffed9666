"""The best robot without the bias of its choice: planted robots, loops over weights."""

import numpy as np
import pytest
from helpers.addresses import address_at, entry_at

from evaluation.estimates.best_robot import BEST, best_robots
from evaluation.estimates.decisions import decision_curve
from evaluation.estimates.metrics import EQUAL_ALARMS, FALSE_ALARMS, FUTURE_EQUAL_ALARMS
from evaluation.estimates.strongest import first_half
from evaluation.estimates.summary import PredictorAnswers, bootstrap_weights
from isac_track.intervals import FEW_CLUSTERS, Estimate, jackknife_interval
from isac_track.rng import stream

LEVELS = (("raw", None), ("ou", 0.4))
ALL, FUTURE = BEST[EQUAL_ALARMS], BEST[FUTURE_EQUAL_ALARMS]


def make_manifest(n_people, *, seed=0):
    """The entries of a manifest about people."""
    names = [f"person {number}" for number in range(n_people)]
    return {"groups": names, "identity": {"seed": seed}}


def planted(noises, *, n_people, rng, scenes_each=6, levels=LEVELS):
    """Robots that predict the separation with errors of these sizes, by name."""
    n_scenes = n_people * scenes_each
    cluster = np.repeat(np.arange(n_people), scenes_each)
    separation = rng.uniform(0.0, 1.8, n_scenes)
    conflict = separation < 0.9
    inside_now = conflict & (rng.random(n_scenes) < 0.5)
    scored = []
    for name, noise in noises.items():
        for mechanism, level in levels:
            foreseen = separation + noise * rng.standard_normal(n_scenes)
            columns = {
                "conflict": conflict,
                "inside_now": inside_now,
                "predicted": foreseen < 0.9,
                "predicted_separation_m": foreseen,
            }
            entry = entry_at(name, kind="predictor", where=(mechanism, level))
            scored.append(PredictorAnswers(entry, cluster, columns))
    return scored


def at(best, consumer, metric, where=LEVELS[1]):
    return best.estimates[address_at(*where, consumer, metric)]


def missed_by_hand(scored, name, people, weight, where, *, future=False):
    """Misses of a robot by some people at the false-alarm rate that it has at raw."""
    by_where = {
        robot.entry.address.mechanism_level: robot
        for robot in scored
        if robot.entry.address.consumer == name
    }
    _, cluster, raw = by_where["raw", None]
    free = ~raw["conflict"] & people[cluster]
    mass = weight[cluster]
    rate = (mass * (free & raw["predicted"])).sum() / (mass * free).sum()
    columns = by_where[where].columns
    in_question = people[cluster] & ~(
        columns["conflict"] & columns["inside_now"] & future
    )
    rates = decision_curve(
        score=-columns["predicted_separation_m"][in_question],
        conflict=columns["conflict"][in_question],
        cluster=cluster[in_question],
        weights=weight[None],
    )
    conflicts = (mass * (columns["conflict"] & in_question)).sum()
    return rates.missed_at(np.full(2, rate))[1], conflicts


def best_by_hand(scored, names, is_first, weight, *, future=False):
    """The best robot's misses at the second level, and the choices of either half."""
    choices = []
    for half in (is_first, ~is_first):
        means = [
            np.mean([missed_by_hand(scored, name, half, weight, where, future=future)[0]
                     for where in LEVELS])
            for name in names
        ]  # fmt: skip
        choices.append(names[int(np.argmin(means))])
    parts = [
        missed_by_hand(scored, choice, half, weight, LEVELS[1], future=future)
        for choice, half in zip(choices[::-1], (is_first, ~is_first), strict=True)
    ]
    return sum(rate * n for rate, n in parts) / sum(n for _, n in parts), tuple(choices)


@pytest.mark.parametrize("n_people", [24, 60])
@pytest.mark.parametrize("future", [False, True])
def test_every_replicate_and_every_deletion_chooses_anew(n_people, future):
    names = ["a", "b", "c"]
    rng = stream(3, "test", "robots", n_people)
    scored = planted(dict.fromkeys(names, 0.4), n_people=n_people, rng=rng)
    manifest = make_manifest(n_people)
    is_first = first_half(tuple(manifest["groups"]))
    best = best_robots(scored, manifest, {}, among={"raw", "ou"})
    consumer, metric = (FUTURE, FUTURE_EQUAL_ALARMS) if future else (ALL, EQUAL_ALARMS)
    estimate = at(best, consumer, metric)

    def by_hand(weight):
        return best_by_hand(scored, names, is_first, weight, future=future)

    value, choices = by_hand(np.ones(n_people))
    assert (estimate.value, best.choices[consumer]) == (pytest.approx(value), choices)
    weights = bootstrap_weights(manifest)[:20]
    # Replicates are all moved by one step, which does not hide how they differ.
    moved = estimate.replicates[:20] - [by_hand(weight)[0] for weight in weights]
    assert moved == pytest.approx(np.full(20, moved[0]))
    if estimate.effective < FEW_CLUSTERS:
        deleted = [by_hand(row) for row in 1.0 - np.eye(n_people)]
        ends = jackknife_interval(
            np.array([value, *(rate for rate, _ in deleted)]),
            effective=estimate.effective,
        )
        assert len({chosen for _, chosen in deleted}) > 1
    else:
        ends = np.quantile(estimate.replicates, [0.025, 0.975])
    assert (estimate.ci_low, estimate.ci_high) == pytest.approx(tuple(ends))


def test_the_best_of_equal_robots_is_not_better_than_they_are():
    names = [f"robot {number}" for number in range(6)]
    naive, crossed, covered = [], [], []
    everybody = np.ones(2000, bool), np.ones(2000), LEVELS[1]
    worlds = (
        planted({"a": 0.4}, n_people=2000, rng=stream(1, "truth", number))
        for number in range(10)
    )
    truth = np.mean([missed_by_hand(scored, "a", *everybody)[0] for scored in worlds])
    for number in range(60):
        rng = stream(number, "test", "equal robots")
        scored = planted(dict.fromkeys(names, 0.4), n_people=30, rng=rng)
        best = best_robots(scored, make_manifest(30), {}, among={"raw", "ou"})
        estimate = at(best, ALL, EQUAL_ALARMS)
        everybody = np.ones(30, bool), np.ones(30), LEVELS[1]
        naive.append(min(missed_by_hand(scored, name, *everybody)[0] for name in names))
        crossed.append(estimate.value)
        covered.append(estimate.ci_low <= truth <= estimate.ci_high)
    error = np.std(crossed) / np.sqrt(len(crossed))
    assert np.mean(naive) < truth - 0.03
    assert abs(np.mean(crossed) - truth) < 3.0 * error < 0.03
    assert np.mean(covered) > 0.85


def test_the_robot_that_is_clearly_better_is_chosen_by_both_halves():
    noises = {"poor": 0.6, "good": 0.1, "worse": 0.9}
    scored = planted(noises, n_people=80, rng=stream(0, "test", "better robot"))
    best = best_robots(scored, make_manifest(80), {}, among={"raw", "ou"})
    assert best.choices == {ALL: ("good", "good"), FUTURE: ("good", "good")}
    estimate = at(best, ALL, EQUAL_ALARMS)
    whole = missed_by_hand(scored, "good", np.ones(80, bool), np.ones(80), LEVELS[1])[0]
    # Each half has its own threshold, hence a small difference.
    assert estimate.value == pytest.approx(whole, abs=0.01)
    assert estimate.ci_low < whole < estimate.ci_high
    good = next(
        robot.columns
        for robot in scored
        if robot.entry.address.consumer == "good" and robot.entry.address.level == 0.4
    )
    is_free = ~good["conflict"]
    false_alarm = (good["predicted"] & is_free).sum() / is_free.sum()
    assert at(best, ALL, FALSE_ALARMS).value == pytest.approx(false_alarm)


def test_a_robot_that_lacks_levels_is_no_rival_and_others_choose_on_shared_levels():
    scored = planted({"a": 0.4}, n_people=40, rng=stream(0, "test", "rivals"))
    scored += planted(
        {"b": 0.1}, n_people=40, rng=stream(0, "test", "rivals"), levels=LEVELS[:1]
    )
    known = {address_at("ou", 0.4, "a", EQUAL_ALARMS): Estimate(0.25, 0.2, 0.3, 9)}
    known[address_at("ou", 0.4, "b", EQUAL_ALARMS)] = Estimate(0.1, 0.05, 0.15, 9)
    alone = best_robots(scored, make_manifest(40), known, among={"raw", "ou"})
    # Nothing is chosen, nothing is halved.
    assert alone.choices[ALL] == ("a", "a")
    assert alone.estimates == {
        address_at("ou", 0.4, ALL, EQUAL_ALARMS): known[
            address_at("ou", 0.4, "a", EQUAL_ALARMS)
        ]
    }
    at_raw = best_robots(scored, make_manifest(40), known, among={"raw"})
    assert at_raw.choices[ALL] == ("b", "b")
    assert {key.mechanism_level for key in at_raw.estimates} == {("raw", None)}


def test_a_half_weighs_the_same_whoever_is_chosen():
    """A costly robot is judged in fewer scenes; its half still counts in full."""
    scored = planted(
        dict.fromkeys("ab", 0.4), n_people=60, rng=stream(0, "test", "fewer scenes")
    )
    few = [
        PredictorAnswers(
            robot.entry,
            robot.cluster[::3],
            {name: values[::3] for name, values in robot.columns.items()},
        )
        for robot in scored[2:]
    ]
    manifest = make_manifest(60)
    is_first = first_half(tuple(manifest["groups"]))
    halves = is_first, ~is_first
    best = best_robots([*scored[:2], *few], manifest, {}, among={"raw", "ou"})
    by_first, by_second = best.choices[ALL]
    assert {by_first, by_second} == {"a", "b"}
    ones, every = np.ones(60), [*scored[:2], *few]
    weighed = [
        (missed_by_hand(every, name, half, ones, LEVELS[1])[0],
         missed_by_hand(scored, "a", half, ones, LEVELS[1])[1])
        for name, half in zip((by_second, by_first), halves, strict=True)
    ]  # fmt: skip
    expected = sum(rate * n for rate, n in weighed) / sum(n for _, n in weighed)
    assert at(best, ALL, EQUAL_ALARMS).value == pytest.approx(expected)


def test_without_raw_there_is_none():
    scored = planted({"a": 0.4, "b": 0.5}, n_people=40, rng=stream(0, "test", "rivals"))
    best = best_robots(scored, make_manifest(40), {}, among={"ou"})
    assert (best.estimates, best.choices) == ({}, {})
