"""What is linked: whose windows, when, and who may learn from whom."""

import re
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from helpers.strategies import reproducible
from helpers.walkers import runs
from helpers.walks import release_of
from hypothesis import given
from hypothesis import strategies as st

from attacks.tasks.build import joined, sample_at, sessions_of
from attacks.tasks.task_list import TASKS, task_named
from isac_track.config import StageSettings
from isac_track.errors import DataError, SettingsError
from isac_track.rng import stream
from isac_track.types import Tracks

STAGES = StageSettings()
CLOSED = ("rerelease", "split", "new_traversal")
HANDOVERS = ("handover-1s", "handover-2s", "handover-5s")
WINDOW_S = STAGES.linkage.window_s


@cache
def crowd(*, n=60, groups=(3, 2, 2), session=0):
    """People who come and go over 100 s, each for 5 to 40 s; the first few walk in groups."""
    walks = []
    for row in range(n):
        rng = stream(0, "test", "crowd", session, row)
        start, length = rng.uniform(0, 80), rng.uniform(5, 40)
        t = np.round(np.arange(start, start + length, 0.4), 2)
        velocity = rng.normal(0, 0.6, 2) + 0.1 * rng.standard_normal(
            (t.size, 2)
        ).cumsum(axis=0)
        walks.append((t, rng.uniform(-3, 3, 2) + 0.4 * velocity.cumsum(axis=0)))
    group = [f"g{number}" for number, size in enumerate(groups) for _ in range(size)]
    group += [f"alone{session}-{row}" for row in range(len(group), n)]
    return tracks_of(walks, source=[f"p{row:03d}" for row in range(n)], group=group)


def tracks_of(walks, *, source, group):
    flat = release_of(walks)
    return Tracks(
        flat.t, flat.xy, flat.offsets, source=tuple(source), group=tuple(group)
    )


@cache
def sessions(name, *, tracks=None, stages=STAGES, seed=0):
    tracks = tracks if tracks is not None else crowd()
    later = crowd(session=1, groups=(2, 2)) if TASKS[name].simulated else None
    return sessions_of(
        TASKS[name], tracks=tracks, stages=stages, seed=seed, later=later
    )


def spans(windows):
    return windows.t[windows.offsets[:-1]], windows.t[windows.offsets[1:] - 1]


def both_sides(found):
    return found.probe, found.gallery


def each(side):
    """Person, search, instants and places of every window of a side."""
    parts = (np.split(flat, side.offsets[1:-1]) for flat in (side.t, side.xy))
    return zip(side.person.tolist(), side.search.tolist(), *parts, strict=True)


def without(tracks, source):
    stay = [one for one in tracks if one.source[0] != source]
    names = {
        name: [getattr(one, name)[0] for one in stay] for name in ("source", "group")
    }
    return tracks_of([(one.t, one.xy) for one in stay], **names)


@pytest.mark.parametrize("name", [*CLOSED, *HANDOVERS])
def test_a_mate_is_the_same_person_in_the_same_search(name):
    found = sessions(name)
    place = {one[:2]: row for row, one in enumerate(each(found.gallery))}
    assert found.mate.tolist() == [place.get(one[:2], -1) for one in each(found.probe)]
    assert (found.mate >= 0).any()
    assert (found.mate >= 0).all() == (name in CLOSED)


@pytest.mark.parametrize("name", [*CLOSED, *HANDOVERS])
def test_windows_are_stretches_of_the_walk_at_instants_of_their_own(name):
    tracks = crowd()
    found = sessions(name, tracks=tracks)
    track_of = dict(zip(tracks.source, tracks, strict=True))
    for person, _, t, xy in each(found.probe):
        track = track_of[found.source[person]]
        assert track.t[0] - 1e-9 <= t[0] < t[-1] <= track.t[-1] + 1e-9
        assert 1 / 16 - 1e-9 <= np.diff(t).min() <= np.diff(t).max() <= 1 / 8 + 1e-9
        # The recorded samples lie on the walk that the window is cut from.
        apart = xy[:, 0] - np.interp(t, track.t, track.xy[:, 0])
        if name in CLOSED:  # put elsewhere, as it is
            assert abs(apart.mean()) > 1e-6
            apart -= apart.mean()
        assert np.abs(apart).max() < 0.1


def test_a_rerelease_is_two_windows_of_one_length_that_mostly_overlap_of_everybody():
    tracks = crowd()
    found = sessions("rerelease", tracks=tracks)
    long = np.subtract(*spans(tracks)[::-1]) >= WINDOW_S - 1e-9
    assert (len(found.source), found.too_short) == (long.sum(), (~long).sum())
    for starts, ends in map(spans, both_sides(found)):
        # The last instant lies within one step of the end.
        assert (np.abs(ends - starts - WINDOW_S + 1 / 16) <= 1 / 16 + 1e-9).all()
    apart = np.abs(spans(found.probe)[0] - spans(found.gallery)[0][found.mate])
    assert (apart <= STAGES.linkage.rerelease_shift_s).all()
    assert apart.max() > 2.0
    assert (apart > 0).mean() > 0.8  # a track of just 12 s has no room to shift
    # The place in the list does not tell who is who.
    assert (found.mate == np.arange(found.mate.size)).mean() < 0.2


def test_the_halves_of_a_split_are_of_one_length_and_do_not_touch():
    found = sessions("split")
    (_, first_end), (second_start, _) = map(spans, both_sides(found))
    gap = second_start[found.mate] - first_end
    assert (gap >= STAGES.linkage.split_gap_s - 1e-9).all()
    assert gap.max() > 5.0
    for starts, ends in map(spans, both_sides(found)):
        assert np.ptp(ends - starts) < 1 / 8 + 1e-9
        assert (ends - starts <= STAGES.linkage.split_window_s + 1e-9).all()


@pytest.mark.parametrize("name", HANDOVERS)
def test_in_a_handover_everyone_who_is_there_is_a_candidate_before_or_after_a_silent_gap(
    name,
):
    tracks = crowd()
    found = sessions(name, tracks=tracks)
    gap_s, least_s = TASKS[name].gap_s, STAGES.linkage.handover_least_s
    start, end = spans(tracks)
    (_, ends), (starts, _) = map(spans, both_sides(found))
    for number, label in enumerate(found.searches):
        at = tracks.t.min() + float(label.removesuffix(" s"))
        before = (start <= at - least_s) & (end >= at - 1e-9)
        after = (start <= at + gap_s) & (end >= at + gap_s + least_s - 1e-9)
        for side, there in ((found.probe, before), (found.gallery, after)):
            seen = np.array(found.source)[side.person[side.search == number]]
            # Labels are rounded: allow for those on the very edge.
            assert np.setxor1d(np.array(tracks.source)[there], seen).size <= 1
            assert np.unique(seen).size == seen.size
        silence_s = starts[found.gallery.search == number].min()
        silence_s -= ends[found.probe.search == number].max()
        assert gap_s - 1e-9 <= silence_s < gap_s + 1 / 8
    # Some have left and some are new.
    assert (found.mate < 0).any()
    assert np.setdiff1d(np.arange(len(found.gallery)), found.mate).size


@pytest.mark.parametrize("name", [*CLOSED, *HANDOVERS])
def test_nobody_is_attacked_or_calibrated_by_who_learnt_from_them_or_their_company(
    name,
):
    found = sessions(name)
    group = np.array(found.group)
    for fold, *teachers in zip((0, 1), found.learns, found.calibrates, strict=True):
        sides = [
            side.person[found.fold[side.search] == fold] for side in both_sides(found)
        ]
        apart = [set(group[who]) for who in (np.concatenate(sides), *teachers)]
        assert all(apart)
        assert sum(map(len, apart)) == len(set.union(*apart))
    with pytest.raises(AssertionError, match="among the training people"):
        replace(found, learns=np.ones_like(found.learns))


def by_person(found):
    """Of either side the instants of each window, by whose it is and, of a handover, when."""
    closed = found.task.name in CLOSED
    return [
        {
            (found.source[who], "" if closed else found.searches[number]): tuple(t)
            for who, number, t, _ in each(side)
        }
        for side in both_sides(found)
    ]


@pytest.mark.parametrize("name", ["rerelease", "split", "handover-2s"])
def test_leaving_one_person_out_changes_no_other_window(name):
    tracks = crowd()
    whole = sessions(name, tracks=tracks)
    # Somebody in the middle of the recording, so that the instants of handovers stay.
    lost = next(
        one.source[0]
        for one in tracks
        if one.source[0] in whole.source
        and one.group[0][:5] == "alone"
        and 20 < one.t[0] < 60
    )
    part = sessions(name, tracks=without(tracks, lost))
    for before, after in zip(by_person(whole), by_person(part), strict=True):
        rest = {key: value for key, value in before.items() if key[0] != lost}
        assert len(rest) < len(before)
        if name in CLOSED:
            assert after == rest
        else:
            # which epochs there are may change, the windows of those that stay do not
            stay = rest.keys() & after.keys()
            assert all(np.allclose(after[key][0], before[key][0]) for key in stay)


@pytest.mark.parametrize(
    ("setting", "value", "name"),
    [
        ("linkage.window_s", 8.0, "rerelease"),
        ("linkage.rerelease_shift_s", 1.0, "rerelease"),
        ("linkage.split_window_s", 4.0, "split"),
        ("linkage.split_gap_s", 4.0, "split"),
        ("linkage.handover_period_s", 15.0, "handover-2s"),
        ("linkage.handover_window_s", 3.0, "handover-2s"),
        ("linkage.handover_least_s", 2.0, "handover-2s"),
        ("linkage.handover_instants", 4, "handover-2s"),
        ("linkage.most_people", 26, "new_traversal"),
        ("linkage.most_people", 26, "rerelease"),
        ("resample.rate_max_hz", 12.0, "split"),
    ],
)
def test_every_setting_and_the_seed_change_what_is_linked(setting, value, name):
    tracks, stages = crowd(n=100), STAGES.changed({setting: value})
    first = [
        sessions(name, tracks=tracks, **given).probe.t
        for given in ({}, {"seed": 1}, {"stages": stages})
    ]
    assert not any(np.array_equal(one, other) for one, other in combinations(first, 2))
    if setting == "linkage.most_people":
        assert len(sessions(name, tracks=tracks, stages=stages).source) == value


def test_of_too_many_people_a_handover_draws_instants_and_takes_everybody_at_these():
    stages = STAGES.changed(
        {"linkage.most_people": 150, "linkage.handover_period_s": 5.0}
    )
    every = STAGES.changed({"linkage.handover_period_s": 5.0})
    for name in HANDOVERS:
        part, whole = (
            sessions(name, tracks=crowd(n=200), stages=one) for one in (stages, every)
        )
        assert (
            len(part.source)
            <= 150
            < len(whole.source)
            == len(part.source) + part.not_drawn
        )
        assert 2 <= len(part.searches) < len(whole.searches)
        assert set(part.searches) <= set(whole.searches)
        for few, all_of in zip(by_person(part), by_person(whole), strict=True):
            assert few == {
                key: one for key, one in all_of.items() if key[1] in part.searches
            }
    assert (
        part.searches
        == sessions("handover-1s", tracks=crowd(n=200), stages=stages).searches
    )


def test_where_a_window_is_sensed_says_nothing_of_where_its_mate_was():
    tracks = crowd(n=400)
    found = sessions("rerelease", tracks=tracks)
    first, second = (
        np.add.reduceat(side.xy, side.offsets[:-1]) / np.diff(side.offsets)[:, None]
        for side in both_sides(found)
    )
    for middle in (first, second):
        assert (middle >= tracks.xy.min(axis=0) - 1e-9).all()
        assert (middle <= tracks.xy.max(axis=0) + 1e-9).all()
    for one, other in zip(first.T, second[found.mate].T, strict=True):
        assert abs(np.corrcoef(one, other)[0, 1]) < 4 / np.sqrt(found.mate.size)


def test_frozen_people_and_company_are_marked():
    tracks = crowd()
    row = int(np.flatnonzero(np.subtract(*spans(tracks)[::-1]) > WINDOW_S)[-1])
    xy = tracks.xy.copy()
    xy[tracks.offsets[row] : tracks.offsets[row + 1]] = (1.0, 1.0)
    found = sessions("rerelease", tracks=replace(tracks, xy=xy))
    frozen = [found.source[one] for one in np.flatnonzero(~found.moving)]
    assert frozen == [tracks.source[row]]
    together = {found.source[one] for one in np.flatnonzero(~found.alone)}
    assert together == {name for name in found.source if name <= "p006"}


def test_who_comes_back_is_searched_for_among_all_by_who_learnt_on_the_others():
    found = sessions("cross_session", tracks=runs())
    assert found.source == tuple(f"p{who:02d}" for who in range(10))
    assert (found.learns == ~np.eye(10, dtype=bool)).all()
    assert not found.calibrates.any()
    assert (found.probe.person == found.gallery.person[found.mate]).all()
    assert (found.probe.search == 0).all()
    assert (spans(found.probe)[1] < 500).all()
    assert (spans(found.gallery)[0] >= 500).all()
    # By hand: everybody turns left about the middle, 20 are there, and walks last
    # alike.
    for side in both_sides(found):
        np.testing.assert_allclose(side.about[:, 2], 1.0, atol=0.02)
        np.testing.assert_allclose(side.about[:, 3], 20)
        start_s = spans(side)[0] % 500
        assert (
            (side.about[:, 4] >= start_s) & (side.about[:, 4] <= start_s + 12)
        ).all()
        np.testing.assert_allclose(side.about[:, 5], 39.6)
        np.testing.assert_allclose(np.hypot(*side.about[:, :2].T), 1.0)
    with pytest.raises(AssertionError, match="among the training people"):
        replace(found, learns=np.ones_like(found.learns))


def test_fewer_than_eight_who_come_back_are_refused():
    assert len(sessions("cross_session", tracks=runs(n=8)).source) == 8
    with pytest.raises(
        DataError, match="7 people walk for 12 s in two sessions, but it takes 8"
    ):
        sessions("cross_session", tracks=runs(n=7))
    for unknown in ({"person": None}, {"session": None}):
        with pytest.raises(DataError, match="no person is known to be in two sessions"):
            sessions("cross_session", tracks=replace(runs(), **unknown))


NAMES, T = [f"p{row}" for row in range(40)], np.arange(0.0, 100.0, 0.4)
WALKS = stream(0, "test", "always").normal(0, 0.2, (40, T.size, 2)).cumsum(axis=1)
ALWAYS = {"tracks": tracks_of([(T, one) for one in WALKS], source=NAMES, group=NAMES)}
FEW = {"tracks": crowd(n=10)}
GROUPED = {"tracks": replace(crowd(), group=("all",) * len(crowd()))}
DRAWN = {"stages": STAGES.changed({"linkage.most_people": 3})}


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        *(
            (name, FEW, f"task {name}: .*takes 24.*--task")
            for name in ("split", "handover-2s", "new_traversal")
        ),
        ("rerelease", GROUPED, "too many share a walking group"),
        ("handover-1s", ALWAYS, "are present all the time"),
        ("rerelease", DRAWN, "most_people must be at least 24"),
    ],
)
def test_what_cannot_be_linked_is_refused_with_the_way_out(name, given, message):
    with pytest.raises((DataError, SettingsError), match=message):
        sessions(name, **given)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("handover-3s", "did you mean 'handover-"),
        ("resplit", "'split'"),
        ("?", "known: rerelease"),
    ],
)
def test_an_unknown_task_is_refused_with_what_may_be_meant(name, hint):
    with pytest.raises(
        SettingsError, match=f"unknown task {re.escape(repr(name))}; .*{hint}"
    ):
        task_named(name)
    with pytest.raises(SettingsError, match="unknown task"):
        sessions_of(
            replace(TASKS["split"], name=name), tracks=crowd(), stages=STAGES, seed=0
        )


GROUP = st.sampled_from("abcdef")
PEOPLE = st.lists(st.tuples(GROUP, GROUP), min_size=1, max_size=12)


def reached(people, one):
    """Brute force: whoever shares a group with somebody reached, again and again."""
    found = {one}
    while True:
        more = {
            other
            for other, (first, second) in enumerate(people)
            if any(
                first == people[known][0] or second == people[known][1]
                for known in found
            )
        }
        if more == found:
            return found
        found = more


@reproducible
@given(PEOPLE)
def test_a_cluster_is_whoever_can_be_reached_over_shared_groups(people):
    """It has the first name of its groups in the first session."""
    cluster = joined([first for first, _ in people], [second for _, second in people])
    for one, name in enumerate(cluster):
        within = reached(people, one)
        assert {k for k in range(len(people)) if cluster[k] == name} == within
        assert type(name) is str
        assert name == min(people[other][0] for other in within)


def sampled(*rates_hz, duration_s=20.0):
    """One person for each rate, all of them there for alike long."""
    times = [np.arange(0.0, duration_s, 1.0 / rate) for rate in rates_hz]
    offsets = np.cumsum([0, *map(len, times)])
    names = tuple(map(str, range(len(times))))
    t = np.concatenate(times)
    return Tracks(t, np.zeros((t.size, 2)), offsets, source=names, group=names)


def shares_of(tracks, n=3001):
    """How often each track is drawn by evenly spread shares."""
    samples = sample_at((np.arange(n) + 0.5) / n, tracks)
    owner = np.searchsorted(tracks.offsets, samples, side="right") - 1
    return np.bincount(owner, minlength=len(tracks)) / n


class TestPlacesByTime:
    def test_alike_sampled_each_sample_is_as_likely_as_another(self):
        tracks, shares = sampled(2.5, 2.5, 2.5), np.linspace(0.0, 0.9999, 777)
        by_sample = (shares * tracks.t.size).astype(np.int64)
        assert np.array_equal(sample_at(shares, tracks), by_sample)

    @pytest.mark.parametrize("fast", [10.0, 1000.0])
    def test_a_faster_track_is_drawn_for_its_time(self, fast):
        assert np.abs(shares_of(sampled(2.5, fast, 2.5)) - 1 / 3).max() < 0.01

    def test_a_burst_within_a_track_is_drawn_for_its_time(self):
        steps = np.repeat([0.4, 0.001, 0.4], [25, 5000, 25])  # 10 s, 5 s, 10 s
        t = np.cumsum(steps)
        slow = sampled(2.5)
        both = Tracks(
            np.concatenate([t, slow.t]),
            np.zeros((t.size + slow.t.size, 2)),
            np.array([0, t.size, t.size + slow.t.size]),
            ("a", "b"),
            ("a", "b"),
        )
        samples = sample_at((np.arange(4000) + 0.5) / 4000, both)
        in_burst = ((samples >= 25) & (samples < 5025)).mean()
        assert abs(in_burst - 5.0 / 45.0) < 0.01

    def test_a_gap_draws_nobody_more_often(self):
        tracks = sampled(2.5, 2.5)
        t = tracks.t.copy()
        t[-1] += 1000.0
        assert np.abs(shares_of(replace(tracks, t=t)) - 0.5).max() < 0.01

    def test_one_sample_a_track(self):
        t = np.zeros(3)
        tracks = Tracks(
            t, np.zeros((3, 2)), np.arange(4), ("a", "b", "c"), ("a", "b", "c")
        )
        assert sample_at(np.array([0.0, 0.5, 0.99]), tracks).tolist() == [0, 1, 2]

    def test_a_track_of_one_sample_does_not_change_what_is_drawn(self):
        even = sampled(2.5, 2.5)
        t, offsets = np.append(even.t, 3.0), np.append(even.offsets, even.t.size + 1)
        names = ("a", "b", "c")
        tracks = Tracks(t, np.zeros((t.size, 2)), offsets, source=names, group=names)
        shares = np.linspace(0.0, 0.9999, 777)
        by_sample = (shares * t.size).astype(np.int64)
        assert np.array_equal(sample_at(shares, tracks), by_sample)
