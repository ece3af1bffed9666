"""Fusion and ranks of people who come back, against brute force."""

import numpy as np
import pytest

from isac_track.linkability.returns import (
    PersonScores,
    Returning,
    enrolment,
    fuse,
    fusion_laws,
    hits,
    node_scores,
    open_set,
    person_scores,
    return_cell,
)
from isac_track.rng import stream

# Three runs: persons 0 to 5 in runs 0 and 1, persons 4 to 9 in run 2; laps of two.
PERSON = np.concatenate([np.tile(np.arange(6), 4), np.tile(np.arange(4, 10), 2)])
SESSION = np.repeat([0, 1, 2], 12)
RETURNING = Returning(PERSON, SESSION, np.arange(6))
SAME = PERSON[:, None] == PERSON


def scores(rng, *, effect=0.0, slices=1):
    n = PERSON.size
    return np.stack([rng.standard_normal((n, n)) + effect * SAME] * slices)


@pytest.mark.parametrize("probe", ["another session", "same session"])
@pytest.mark.parametrize("most", [1, None])
def test_a_person_scores_the_mean_over_the_enrolled_passages(probe, most):
    values = scores(stream(0, "test", "means"))[0]
    weights = enrolment(RETURNING, most=most, probe=probe)
    measured = person_scores(values, RETURNING, weights)
    for row in range(PERSON.size):
        for person in range(10):
            place = SESSION[row]
            gallery = np.flatnonzero(weights[place][:, person])
            assert (SESSION[gallery] == place).all() == (
                probe == "same session" or not gallery.size
            )
            gallery = gallery[gallery != row]
            if not gallery.size:
                assert np.isnan(measured[row, person])
            else:
                assert measured[row, person] == pytest.approx(
                    values[row, gallery].mean()
                )


def test_enrolling_few_passages_draws_so_many():
    drawn = (enrolment(RETURNING, most=1) > 0).sum(axis=1)
    assert set(np.unique(drawn)) == {0, 1}
    # Person 4 walks in every run; seen from run 0 in four passages.
    assert (enrolment(RETURNING)[0] > 0).sum(axis=0)[4] == 4


def test_hits_without_a_person_are_those_of_a_smaller_gallery():
    rng = stream(0, "test", "hits")
    values = np.round(rng.standard_normal((PERSON.size, 10)), 0)  # with ties
    values[:, 9] = np.nan
    linked = hits(PersonScores(values), RETURNING, np.arange(PERSON.size))
    rows = np.flatnonzero(PERSON != 9)
    assert linked.chance == pytest.approx(1 / 9)
    for place, row in enumerate(rows):
        for aside in range(10):
            if aside == PERSON[row]:
                continue
            left = np.delete(values[row], aside)
            mate = values[row, PERSON[row]]
            expected = 0.0
            if not (left > mate).any():
                expected = 1.0 / (left == mate).sum()
            assert linked.without[aside, place] == pytest.approx(expected)


def test_what_a_person_shows_does_not_calibrate_that_person():
    rng = stream(0, "test", "leave out")
    linkers = [scores(rng, effect=1.0, slices=7), scores(rng, effect=0.5)]
    weights = enrolment(RETURNING)
    laws = fusion_laws(linkers, RETURNING, weights)
    changed = linkers[1].copy()
    changed[:, PERSON == 2] += 7.0 * rng.standard_normal((12 // 3, PERSON.size))
    changed[:, :, PERSON == 2] -= 3.0
    again = fusion_laws([linkers[0], changed], RETURNING, weights)
    assert np.array_equal(laws[2], again[2])
    assert not np.allclose(laws[3], again[3])


def test_a_useless_linker_is_hardly_counted_and_none_speaks_against_a_match():
    rng = stream(0, "test", "weights")
    linkers = [scores(rng, effect=2.0), scores(rng), scores(rng, effect=-2.0)]
    laws = fusion_laws(linkers, RETURNING, enrolment(RETURNING))
    assert (laws[:, :3] >= 0).all()
    assert (laws[:, 0] > 2 * laws[:, 1]).all()
    assert not laws[:, 2].any()
    fused = fuse(linkers, laws, RETURNING, enrolment(RETURNING))
    cell = return_cell(fused, {"none": PersonScores(fused.values * 0)}, RETURNING)
    assert cell.rank1.value > 0.6
    assert cell.control.value == pytest.approx(cell.chance)
    assert cell.gain.value == pytest.approx(cell.rank1.value - cell.chance)


def test_nodes_are_people_in_runs():
    values = scores(stream(0, "test", "nodes"))
    laws = np.tile([1.0, 0.0], (7, 1))
    nodes = node_scores([values], laws, RETURNING)
    person, session = nodes.person, nodes.session
    assert person.size == 18
    for u in range(18):
        for v in range(18):
            rows = (person[u] == PERSON) & (session[u] == SESSION)
            columns = (person[v] == PERSON) & (session[v] == SESSION)
            expected = values[0][np.ix_(rows, columns)].mean()
            if session[u] == session[v]:
                expected = 0.0
            assert nodes.values[u, v] == pytest.approx(expected)


def test_the_control_of_a_person_is_chosen_on_the_others():
    # Each control names its own persons alone; the better one is the wider.
    rng = stream(0, "test", "choice")
    noise = scores(rng)[0]
    fused = PersonScores(person_scores(noise, RETURNING, enrolment(RETURNING)))
    controls = {}
    for name, people in (("few", [0]), ("many", [1, 2])):
        values = fused.values * 0.0
        for person in people:
            values[person == PERSON, person] = 1.0
            values[person == PERSON, (person + 1) % 4] -= 1.0
        controls[name] = PersonScores(values)
    cell = return_cell(fused, controls, RETURNING)
    # Without person 1 or 2 "many" is no better than "few", the first by name.
    assert cell.chosen == {"few": 2, "many": 4}
    with pytest.raises(ValueError, match="no probe"):
        return_cell(fused, controls, RETURNING, rows=np.flatnonzero(PERSON == 9))


def test_an_open_set_names_few_strangers():
    rng = stream(0, "test", "open")
    linked = person_scores(scores(rng, effect=6.0)[0], RETURNING, enrolment(RETURNING))
    result = open_set(PersonScores(linked), RETURNING)
    assert (result.n_enrolled, result.n_strangers) == (6, 4)
    assert result.fpir <= 0.1
    assert result.identified > 0.8
    blind = open_set(PersonScores(linked * 0.0), RETURNING)
    assert blind.identified == 0.0


def gains(rng, n=24):
    """The cell of people of an own rate of hits, in a fixed gallery."""
    person = np.repeat(np.arange(n), 4)
    session = np.tile([0, 0, 1, 1], n)
    returning = Returning(person, session, np.arange(n))
    rate = rng.beta(1.0, 1.0, n)
    values = np.zeros((4 * n, n))
    missed = rng.random(4 * n) > rate[person]
    values[np.arange(4 * n), person] = np.where(missed, -1.0, 1.0)
    control = np.zeros((4 * n, n))
    return return_cell(PersonScores(values), {"none": PersonScores(control)}, returning)


def test_intervals_of_rank_1_and_gain_cover():
    rng = stream(0, "test", "coverage")
    cells = [gains(rng) for _ in range(200)]
    chance = 1 / 24
    covers = np.mean([c.rank1.ci_low <= 0.5 <= c.rank1.ci_high for c in cells])
    gain = 0.5 - chance
    paired = np.mean([c.gain.ci_low <= gain <= c.gain.ci_high for c in cells])
    # 200 draws at 95 %: at least 0.90 in 99.8 of 100 experiments.
    assert covers >= 0.90
    assert paired >= 0.90
