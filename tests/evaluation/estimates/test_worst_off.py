"""The worst-off tenth: against loops over people, and worlds where it is known."""

import math

import numpy as np
import pytest

from evaluation.estimates.worst_off import (
    LEAST_PEOPLE,
    LEAST_RELEASES,
    PersonMeans,
    cross_fitted_tail,
    person_means,
    tail_mean,
    worst_tenth,
)
from isac_track.intervals import cluster_weights, jackknife_interval
from isac_track.rng import stream

N_PEOPLE, N_RELEASES = 60, 18


def planted(shares, *, n_releases=N_RELEASES, name="planted", spread=4.0):
    """Values, scenes and clusters of people whose releases leak by their own shares."""
    rng, shares = stream(5, name), np.asarray(shares)
    values = rng.beta(spread * shares, spread * (1 - shares), (n_releases, shares.size))
    cluster = np.tile(np.arange(shares.size), n_releases)
    scene = np.repeat(np.arange(n_releases), shares.size)
    return {"values": values.ravel(), "scene": scene, "cluster": cluster}


def estimated(rows, *, n_clusters=N_PEOPLE, n_replicates=50):
    """The estimate of some rows."""
    weights = cluster_weights(n_clusters=n_clusters, n_replicates=n_replicates, seed=3)
    return worst_tenth(person_means(**rows, n_clusters=n_clusters), weights=weights)


def slow_tail(values, chosen_by):
    """Mean of the tenth by a loop: from the largest on, equals share their places."""
    left = places = 0.1 * len(values)
    total = 0.0
    for level in sorted(set(chosen_by), reverse=True):
        equals = [
            value for value, by in zip(values, chosen_by, strict=True) if by == level
        ]
        taken = min(left, len(equals))
        total += taken * float(np.mean(equals))
        left -= taken
    return total / places


def slow_value(rows, people):
    """The cross-fitted mean of some people by loops over their releases."""
    odd, even = [], []
    for person in people:
        by_scene = {}
        for value, scene, cluster in zip(*rows.values(), strict=True):
            if cluster == person:
                by_scene.setdefault(scene, []).append(value)
        releases = [by_scene[scene] for scene in sorted(by_scene)]
        odd.append(np.mean([value for some in releases[::2] for value in some]))
        even.append(np.mean([value for some in releases[1::2] for value in some]))
    return 0.5 * (slow_tail(even, odd) + slow_tail(odd, even))


def test_the_tenth_of_equals_is_as_exposed_as_all():
    rows = planted(np.full(N_PEOPLE, 0.3))
    result, mean = estimated(rows), rows["values"].mean()
    assert result.ci_low < mean < result.ci_high
    assert abs(result.value - mean) < 0.03
    # What is read off the people's own means is not.
    own = np.sort(rows["values"].reshape(N_RELEASES, N_PEOPLE).mean(axis=0))
    assert own[-N_PEOPLE // 10 :].mean() > mean + 0.07


def test_a_tenth_that_is_exposed_is_found():
    shares = np.where(np.arange(N_PEOPLE) % 10 == 3, 0.8, 0.3)
    rows = planted(shares)
    result = estimated(rows)
    exposed = rows["values"][shares[rows["cluster"]] == 0.8].mean()
    assert result.value == pytest.approx(exposed, abs=0.02)
    assert result.ci_low < 0.8 < result.ci_high
    assert result.n == N_PEOPLE


@pytest.mark.parametrize("decimals", [16, 1])  # to a tenth: many are equal
def test_interval_is_that_of_leaving_out_each_person_by_hand(decimals):
    rows = planted(np.linspace(0.1, 0.6, 23), n_releases=9)
    rows["values"] = rows["values"].round(decimals)
    people = range(23)
    result = estimated(rows, n_clusters=23)
    values = [slow_value(rows, people)]
    values += [
        slow_value(rows, [person for person in people if person != out])
        for out in people
    ]
    assert result.value == pytest.approx(values[0], abs=1e-12)
    squares = (np.array(values[1:]) - values[0]) ** 2
    effective = max(3.3, squares.sum() ** 2 / (squares**2).sum())
    ends = jackknife_interval(np.array(values), effective=effective)
    assert (result.ci_low, result.ci_high) == pytest.approx(ends, abs=1e-9)


def test_a_replicate_is_of_the_people_drawn_as_often():
    rng = stream(1, "replicates")
    values, by = rng.random(30), rng.random(30).round(1)
    weights = cluster_weights(n_clusters=30, n_replicates=20, seed=2)
    for drawn, result in zip(
        weights, tail_mean(values, chosen_by=by, weights=weights), strict=True
    ):
        people = np.repeat(np.arange(30), drawn.astype(int))
        assert result == pytest.approx(slow_tail(values[people], by[people]), abs=1e-12)


def test_order_of_rows_and_of_people_does_not_matter():
    rows = planted(np.linspace(0.1, 0.6, N_PEOPLE))
    order = stream(2, "order").permutation(rows["values"].size)
    first = person_means(**rows, n_clusters=N_PEOPLE)
    other = person_means(
        **{name: column[order] for name, column in rows.items()}, n_clusters=N_PEOPLE
    )
    assert np.allclose([first.odd, first.even], [other.odd, other.even], rtol=1e-12)
    turned = PersonMeans(first.person, first.odd[::-1], first.even[::-1])
    once = np.ones((1, N_PEOPLE))
    assert cross_fitted_tail(first, once) == pytest.approx(
        cross_fitted_tail(turned, once)
    )


def test_a_release_is_a_scene_and_some_people_have_too_few():
    # Person 0 is in scenes 1, 3, ... and twice in the first; person 1 lacks a release.
    scene = np.array([*range(1, 2 * LEAST_RELEASES, 2), 1, *range(LEAST_RELEASES - 1)])
    cluster = np.array([0] * (LEAST_RELEASES + 1) + [1] * (LEAST_RELEASES - 1))
    values = (scene % 4 == 1) * 1.0  # of person 0 every other release
    values[LEAST_RELEASES] = 0.0
    result = person_means(values=values, scene=scene, cluster=cluster, n_clusters=3)
    assert result.person.tolist() == [0]
    n_odd = LEAST_RELEASES // 2 + 1  # tracks in the odd releases
    assert result.odd.tolist() == [(n_odd - 1) / n_odd]
    assert result.even.tolist() == [0.0]


def test_of_too_few_people_nothing_is_said():
    rows = planted(np.full(LEAST_PEOPLE - 1, 0.3))
    result = estimated(rows, n_clusters=N_PEOPLE)
    assert math.isnan(result.value)
    assert math.isnan(result.ci_low)
    assert result.n == LEAST_PEOPLE - 1
    few = estimated(planted(np.full(N_PEOPLE, 0.3), n_releases=LEAST_RELEASES - 1))
    assert math.isnan(few.value)
    assert few.n == 0


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_tenth_that_is_all_known_or_not_at_all_has_the_interval_of_so_few(share):
    rows = planted(np.full(N_PEOPLE, 0.5))
    rows["values"] = np.full_like(rows["values"], share)
    result = estimated(rows)
    assert result.value == share
    assert 0.2 < result.ci_high - result.ci_low < 0.5  # Wilson's of six people


def test_interval_covers_what_many_people_have():
    def world(n, number):
        rng = stream(number, "people")
        shares = rng.beta(3, 6, n)
        odd, even = (
            rng.beta(4 * shares, 4 * (1 - shares), (9, n)).mean(axis=0)
            for _ in range(2)
        )
        return PersonMeans(np.arange(n), odd, even)

    many = world(100_000, 999)
    truth = cross_fitted_tail(many, np.ones((1, 100_000)))[0]
    covered = [
        result.ci_low <= truth <= result.ci_high
        for number in range(200)
        for result in [worst_tenth(world(40, number), weights=np.ones((1, 40)))]
    ]
    assert 0.93 <= np.mean(covered) <= 1.0
