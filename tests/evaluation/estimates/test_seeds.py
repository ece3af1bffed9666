"""Runs of several seeds as one: against loops, one run alone, and planted worlds."""

from itertools import combinations

import numpy as np
import pytest
from helpers.small_runs import smoke, write_walks

from benchmarks.three_seeds import check_seed_alone, pooled, read
from evaluation.api import run
from evaluation.estimates.seeds import by_intervals, over_seeds, stacked_sums
from isac_track.errors import DataError
from isac_track.intervals import Estimate, jackknife_interval
from isac_track.rng import stream

N_PEOPLE, N_TRIALS = 40, 10


def world(number, *, n_seeds=3, people_spread=0.6, seed_spread=0.0):
    """Hits and trials of people with their own shares, under seeds that shift all."""
    rng = stream(number, "world")
    people = people_spread * rng.standard_normal(N_PEOPLE)
    seeds = seed_spread * rng.standard_normal((n_seeds, 1))
    shares = 1.0 / (1.0 + np.exp(0.5 + people + seeds))
    hits = rng.binomial(N_TRIALS, shares).astype(float)
    return np.stack([hits, np.full_like(hits, N_TRIALS)], axis=1)


def leave_one_out(values, n):
    """Delete-one jackknife variance; the first value is that of all."""
    return (n - 1) / n * sum((value - values[0]) ** 2 for value in values[1:])


def test_variance_is_that_of_leaving_each_person_out_of_every_run():
    sums = world(3, seed_spread=0.3)
    sums[1, :, :5] = 0.0  # who is not in one of the runs
    people = range(N_PEOPLE)

    def ratio(runs, left):
        some = [person for person in people if person != left]
        return sums[runs][:, 0, some].sum() / sums[runs][:, 1, some].sum()

    each = [[ratio([run], left) for left in (None, *people)] for run in range(3)]
    whole = [ratio([0, 1, 2], left) for left in (None, *people)]
    apart = [
        leave_one_out([a - b for a, b in zip(first, second, strict=True)], N_PEOPLE)
        for first, second in combinations(each, 2)
    ]
    between = np.var([run[0] for run in each], ddof=1) - 0.5 * np.mean(apart)
    assert between > 0.0
    expected = leave_one_out(whole, N_PEOPLE) + between / 3
    result = over_seeds(sums, is_share=False)
    assert result.value == pytest.approx(whole[0])
    # Student's t of so few degrees of freedom is wider than of many.
    half = (result.ci_high - result.ci_low) / 2.0
    assert 1.96 < half / np.sqrt(expected) < 4.31
    assert result.n == N_PEOPLE


def test_one_run_has_the_jackknife_of_its_people():
    (sums,) = world(5, n_seeds=1)
    values = (sums[0].sum() - np.append(0.0, sums[0])) / (
        sums[1].sum() - np.append(0.0, sums[1])
    )
    result = over_seeds(sums[None])
    low, high = jackknife_interval(values, effective=N_PEOPLE)
    assert (result.value, result.ci_low, result.ci_high) == pytest.approx(
        (values[0], low, high)
    )


def test_the_same_run_thrice_is_no_more_than_once():
    sums = world(6, n_seeds=1)
    once, thrice = over_seeds(sums), over_seeds(np.repeat(sums, 3, axis=0))
    ends = once.value, once.ci_low, once.ci_high
    assert (thrice.value, thrice.ci_low, thrice.ci_high) == pytest.approx(ends)


@pytest.mark.parametrize("seed_spread", [0.0, 0.4])
def test_interval_covers_the_mean_over_people_and_seeds(seed_spread):
    truth = over_seeds(
        np.concatenate(
            [
                world(number, n_seeds=50, seed_spread=seed_spread)
                for number in range(40)
            ],
            2,
        )
    ).value
    results = [
        over_seeds(world(1000 + number, seed_spread=seed_spread))
        for number in range(200)
    ]
    assert (
        np.mean([estimate.ci_low <= truth <= estimate.ci_high for estimate in results])
        >= 0.91
    )


def test_between_seeds_what_differs_makes_the_interval_wider():
    same, apart = (over_seeds(world(8, seed_spread=spread)) for spread in (0.0, 0.6))
    assert apart.ci_high - apart.ci_low > 2.0 * (same.ci_high - same.ci_low)


def test_without_sums_the_ends_of_intervals_are_taken():
    estimate = Estimate(0.4, 0.3, 0.5, n=40)
    same = by_intervals([estimate, estimate, estimate])
    assert (same.value, same.ci_low, same.ci_high) == pytest.approx((0.4, 0.3, 0.5))
    wide = by_intervals([estimate, Estimate(0.6, 0.5, 0.7, n=30)])
    assert wide.value == pytest.approx(0.5)
    assert wide.ci_high - wide.ci_low > 0.2
    assert wide.n == 30
    lopsided = by_intervals([Estimate(0.1, 0.0, 0.4, n=20)])
    assert (lopsided.ci_low, lopsided.ci_high) == pytest.approx((0.0, 0.4))


@pytest.mark.parametrize("n_seeds", [2, 3])
def test_few_seeds_that_differ_cover_the_mean_over_people_and_seeds(n_seeds):
    """Numbers that are no ratio: people 1, their draws 0.5, seeds 1.

    The mean of the runs' ends is too short.
    """
    rng = stream(n_seeds, "seeds")
    half = 1.96 * np.hypot(1.0, 0.5)
    covered, by_ends = [], []
    for _ in range(1500):
        values = rng.standard_normal() + np.hypot(0.5, 1.0) * rng.standard_normal(
            n_seeds
        )
        mean = by_intervals(
            [Estimate(value, value - half, value + half, 50) for value in values]
        )
        covered.append(mean.ci_low <= 0.0 <= mean.ci_high)
        by_ends.append(abs(mean.value) <= half)
    assert np.mean(covered) > 0.94
    assert np.mean(by_ends) < np.mean(covered) - 0.01


def test_who_is_not_in_a_run_has_nothing_there():
    sums = stacked_sums([{"a": (1.0, 2.0)}, {"b": (3.0, 4.0), "a": (5.0, 6.0)}])
    assert sums.tolist() == [[[1.0, 0.0], [2.0, 0.0]], [[5.0, 3.0], [6.0, 4.0]]]


@pytest.fixture(scope="module")
def outs(tmp_path_factory):
    """Folders of two runs that differ in the seed."""
    folder = tmp_path_factory.mktemp("seeds")
    walks = write_walks(folder / "walks.csv", n_people=24)
    settings = smoke(
        walks,
        folder / "0",
        mechanisms=("raw", "fid:1", "ou:0.4"),
        attacks=("kalman_rts", "radial_rts", "shape"),
        tasks=("split",),
        scenes=20,
    )
    for seed in (0, 1):
        changed = settings.changed(seed=seed, out=folder / str(seed))
        run(changed, progress=False, pictures=False)
    return [folder / "0", folder / "1"]


class TestRuns:
    def test_one_run_pooled_is_the_run_itself(self, outs):
        first = read(outs[0])
        seen = 0
        for where in first.table.levels:
            for number, column in enumerate(first.columns):
                known = first.table.at(where, column)
                if known is not None:
                    estimate, (value,) = pooled([first], where, number)
                    assert estimate.value == pytest.approx(known.value, abs=1e-9)
                    assert value == known.value
                    seen += 1
        assert seen > 8

    def test_two_runs_lie_between_both(self, outs):
        runs = [read(out) for out in outs]
        estimate, each = pooled(
            runs, ("fid", 1.0), 1
        )  # as shared: as many samples in both
        assert min(each) <= estimate.value <= max(each)
        assert estimate.value == pytest.approx(np.mean(each), abs=0.01)

    def test_runs_that_differ_in_more_than_the_seed_are_refused(self, outs, tmp_path):
        check_seed_alone(outs)
        walks = write_walks(tmp_path / "walks.csv", n_people=24)
        run(smoke(walks, tmp_path / "run", scenes=10), progress=False, pictures=False)
        with pytest.raises(DataError, match=r"differ in .*scenes"):
            check_seed_alone([outs[0], tmp_path / "run"])
