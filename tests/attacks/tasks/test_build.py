"""The windows of tasks, their mates, and the people to train on."""

import re
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from helpers.strategies import reproducible
from helpers.walkers import runs
from helpers.walks import walk_release
from hypothesis import given
from hypothesis import strategies as st

from attacks.tasks.build import make_task_windows
from attacks.tasks.paired_windows import join_groups, samples_at_shares
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
    """Return people who come and go over 100 s; the first few walk in groups."""
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
    return make_tracks(walks, source=[f"p{row:03d}" for row in range(n)], group=group)


def make_tracks(walks, *, source, group):
    flat = walk_release(walks)
    return Tracks(
        flat.t, flat.xy, flat.offsets, source=tuple(source), group=tuple(group)
    )


@cache
def windows(name, *, tracks=None, stages=STAGES, seed=0):
    tracks = tracks if tracks is not None else crowd()
    second_tracks = crowd(session=1, groups=(2, 2)) if TASKS[name].simulated else None
    return make_task_windows(
        TASKS[name],
        tracks=tracks,
        stages=stages,
        seed=seed,
        second_tracks=second_tracks,
    )


def spans(windows):
    return windows.t[windows.offsets[:-1]], windows.t[windows.offsets[1:] - 1]


def both_sides(linked):
    return linked.probe, linked.gallery


def list_windows(side):
    """Return person, search, instants and positions of every window of a side."""
    parts = (np.split(flat, side.offsets[1:-1]) for flat in (side.t, side.xy))
    return zip(side.person.tolist(), side.search.tolist(), *parts, strict=True)


def without(tracks, source):
    remaining = [track for track in tracks if track.source[0] != source]
    names = {
        name: [getattr(track, name)[0] for track in remaining]
        for name in ("source", "group")
    }
    return make_tracks([(track.t, track.xy) for track in remaining], **names)


@pytest.mark.parametrize("name", [*CLOSED, *HANDOVERS])
def test_a_mate_is_the_same_person_in_the_same_search(name):
    linked = windows(name)
    place = {window[:2]: row for row, window in enumerate(list_windows(linked.gallery))}
    assert linked.mate.tolist() == [
        place.get(window[:2], -1) for window in list_windows(linked.probe)
    ]
    assert (linked.mate >= 0).any()
    assert (linked.mate >= 0).all() == (name in CLOSED)


@pytest.mark.parametrize("name", [*CLOSED, *HANDOVERS])
def test_windows_are_stretches_of_the_walk_at_instants_of_their_own(name):
    tracks = crowd()
    linked = windows(name, tracks=tracks)
    track_by_source = dict(zip(tracks.source, tracks, strict=True))
    for person, _, t, xy in list_windows(linked.probe):
        track = track_by_source[linked.source[person]]
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
    linked = windows("rerelease", tracks=tracks)
    long = np.subtract(*spans(tracks)[::-1]) >= WINDOW_S - 1e-9
    assert (len(linked.source), linked.too_short) == (long.sum(), (~long).sum())
    for starts, ends in map(spans, both_sides(linked)):
        # The last instant lies within one step of the end.
        assert (np.abs(ends - starts - WINDOW_S + 1 / 16) <= 1 / 16 + 1e-9).all()
    apart = np.abs(spans(linked.probe)[0] - spans(linked.gallery)[0][linked.mate])
    assert (apart <= STAGES.linkage.rerelease_shift_s).all()
    assert apart.max() > 2.0
    assert (apart > 0).mean() > 0.8  # a track of just 12 s has no room to shift
    # The place in the list does not tell who is who.
    assert (linked.mate == np.arange(linked.mate.size)).mean() < 0.2


def test_the_halves_of_a_split_are_of_one_length_and_do_not_touch():
    linked = windows("split")
    (_, first_end), (second_start, _) = map(spans, both_sides(linked))
    gap = second_start[linked.mate] - first_end
    assert (gap >= STAGES.linkage.split_gap_s - 1e-9).all()
    assert gap.max() > 5.0
    for starts, ends in map(spans, both_sides(linked)):
        assert np.ptp(ends - starts) < 1 / 8 + 1e-9
        assert (ends - starts <= STAGES.linkage.split_window_s + 1e-9).all()


@pytest.mark.parametrize("name", HANDOVERS)
def test_in_a_handover_all_people_present_are_in_a_side_before_or_after_a_silent_gap(
    name,
):
    tracks = crowd()
    linked = windows(name, tracks=tracks)
    gap_s, least_s = TASKS[name].silence_s, STAGES.linkage.handover_least_s
    start, end = spans(tracks)
    (_, ends), (starts, _) = map(spans, both_sides(linked))
    for number, label in enumerate(linked.search_names):
        at_s = tracks.t.min() + float(label.removesuffix(" s"))
        before = (start <= at_s - least_s) & (end >= at_s - 1e-9)
        after = (start <= at_s + gap_s) & (end >= at_s + gap_s + least_s - 1e-9)
        for side, present in ((linked.probe, before), (linked.gallery, after)):
            seen = np.array(linked.source)[side.person[side.search == number]]
            # Labels are rounded: allow for those on the very edge.
            assert np.setxor1d(np.array(tracks.source)[present], seen).size <= 1
            assert np.unique(seen).size == seen.size
        silence_s = starts[linked.gallery.search == number].min()
        silence_s -= ends[linked.probe.search == number].max()
        assert gap_s - 1e-9 <= silence_s < gap_s + 1 / 8
    # Some have left and some are new.
    assert (linked.mate < 0).any()
    assert np.setdiff1d(np.arange(len(linked.gallery)), linked.mate).size


@pytest.mark.parametrize("name", [*CLOSED, *HANDOVERS])
def test_no_adversary_learns_from_victims_or_their_company(
    name,
):
    linked = windows(name)
    group = np.array(linked.group)
    for fold, *teachers in zip(
        (0, 1), linked.trained_on, linked.calibrated_on, strict=True
    ):
        sides = [
            side.person[linked.fold[side.search] == fold] for side in both_sides(linked)
        ]
        apart = [set(group[people]) for people in (np.concatenate(sides), *teachers)]
        assert all(apart)
        assert sum(map(len, apart)) == len(set.union(*apart))
    with pytest.raises(AssertionError, match="among the training people"):
        replace(linked, trained_on=np.ones_like(linked.trained_on))


def by_person(linked):
    """Return the instants of the windows of each side, by person and rotation."""
    closed = linked.task.name in CLOSED
    return [
        {
            (
                linked.source[person],
                "" if closed else linked.search_names[number],
            ): tuple(t)
            for person, number, t, _ in list_windows(side)
        }
        for side in both_sides(linked)
    ]


@pytest.mark.parametrize("name", ["rerelease", "split", "handover-2s"])
def test_leaving_one_person_out_changes_no_other_window(name):
    tracks = crowd()
    whole = windows(name, tracks=tracks)
    # Somebody in the middle of the recording, so that the instants of handovers stay.
    lost = next(
        track.source[0]
        for track in tracks
        if track.source[0] in whole.source
        and track.group[0][:5] == "alone"
        and 20 < track.t[0] < 60
    )
    part = windows(name, tracks=without(tracks, lost))
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
        windows(name, tracks=tracks, **given).probe.t
        for given in ({}, {"seed": 1}, {"stages": stages})
    ]
    assert not any(
        np.array_equal(first_t, second_t)
        for first_t, second_t in combinations(first, 2)
    )
    if setting == "linkage.most_people":
        assert len(windows(name, tracks=tracks, stages=stages).source) == value


def test_of_too_many_people_a_handover_draws_instants_and_takes_everybody_at_these():
    stages = STAGES.changed(
        {"linkage.most_people": 150, "linkage.handover_period_s": 5.0}
    )
    every = STAGES.changed({"linkage.handover_period_s": 5.0})
    for name in HANDOVERS:
        part, whole = (
            windows(name, tracks=crowd(n=200), stages=settings)
            for settings in (stages, every)
        )
        assert (
            len(part.source)
            <= 150
            < len(whole.source)
            == len(part.source) + part.not_drawn
        )
        assert 2 <= len(part.search_names) < len(whole.search_names)
        assert set(part.search_names) <= set(whole.search_names)
        for few, all_windows in zip(by_person(part), by_person(whole), strict=True):
            assert few == {
                key: settings
                for key, settings in all_windows.items()
                if key[1] in part.search_names
            }
    assert (
        part.search_names
        == windows("handover-1s", tracks=crowd(n=200), stages=stages).search_names
    )


def test_where_a_window_is_sensed_says_nothing_of_where_its_mate_was():
    tracks = crowd(n=400)
    linked = windows("rerelease", tracks=tracks)
    first, second = (
        np.add.reduceat(side.xy, side.offsets[:-1]) / np.diff(side.offsets)[:, None]
        for side in both_sides(linked)
    )
    for middle in (first, second):
        assert (middle >= tracks.xy.min(axis=0) - 1e-9).all()
        assert (middle <= tracks.xy.max(axis=0) + 1e-9).all()
    for probe_axis, gallery_axis in zip(first.T, second[linked.mate].T, strict=True):
        assert abs(np.corrcoef(probe_axis, gallery_axis)[0, 1]) < 4 / np.sqrt(
            linked.mate.size
        )


def test_frozen_people_and_company_are_marked():
    tracks = crowd()
    row = int(np.flatnonzero(np.subtract(*spans(tracks)[::-1]) > WINDOW_S)[-1])
    xy = tracks.xy.copy()
    xy[tracks.offsets[row] : tracks.offsets[row + 1]] = (1.0, 1.0)
    linked = windows("rerelease", tracks=replace(tracks, xy=xy))
    frozen = [linked.source[person] for person in np.flatnonzero(~linked.moving)]
    assert frozen == [tracks.source[row]]
    together = {linked.source[person] for person in np.flatnonzero(~linked.alone)}
    assert together == {name for name in linked.source if name <= "p006"}


def test_returning_people_are_searched_for_among_all():
    linked = windows("cross_session", tracks=runs())
    assert linked.source == tuple(f"p{number:02d}" for number in range(10))
    assert (linked.trained_on == ~np.eye(10, dtype=bool)).all()
    assert not linked.calibrated_on.any()
    assert (linked.probe.person == linked.gallery.person[linked.mate]).all()
    assert (linked.probe.search == 0).all()
    assert (spans(linked.probe)[1] < 500).all()
    assert (spans(linked.gallery)[0] >= 500).all()
    # By hand: everybody turns left about the middle, 20 are there, and walks last
    # alike.
    for side in both_sides(linked):
        np.testing.assert_allclose(side.circumstances[:, 2], 1.0, atol=0.02)
        np.testing.assert_allclose(side.circumstances[:, 3], 20)
        start_s = spans(side)[0] % 500
        assert (
            (side.circumstances[:, 4] >= start_s)
            & (side.circumstances[:, 4] <= start_s + 12)
        ).all()
        np.testing.assert_allclose(side.circumstances[:, 5], 39.6)
        np.testing.assert_allclose(np.hypot(*side.circumstances[:, :2].T), 1.0)
    with pytest.raises(AssertionError, match="among the training people"):
        replace(linked, trained_on=np.ones_like(linked.trained_on))


def test_fewer_than_eight_returning_people_are_refused():
    assert len(windows("cross_session", tracks=runs(n=8)).source) == 8
    with pytest.raises(
        DataError, match="7 people walk for 12 s in two sessions, but it takes 8"
    ):
        windows("cross_session", tracks=runs(n=7))
    single = {"session": ("alone",) * len(runs())}
    for unknown in ({"person": None}, {"session": None}, single):
        with pytest.raises(DataError, match="no person is known to be in two sessions"):
            windows("cross_session", tracks=replace(runs(), **unknown))


NAMES, T = [f"p{row}" for row in range(40)], np.arange(0.0, 100.0, 0.4)
WALKS = stream(0, "test", "always").normal(0, 0.2, (40, T.size, 2)).cumsum(axis=1)
ALWAYS = {
    "tracks": make_tracks([(T, walk) for walk in WALKS], source=NAMES, group=NAMES)
}
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
        windows(name, **given)


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
        make_task_windows(
            replace(TASKS["split"], name=name), tracks=crowd(), stages=STAGES, seed=0
        )


GROUP = st.sampled_from("abcdef")
PEOPLE = st.lists(st.tuples(GROUP, GROUP), min_size=1, max_size=12)


def reached(people, person):
    """Brute force: whoever shares a group with somebody reached, again and again."""
    cluster = {person}
    while True:
        grown = {
            other
            for other, (first, second) in enumerate(people)
            if any(
                first == people[known][0] or second == people[known][1]
                for known in cluster
            )
        }
        if grown == cluster:
            return cluster
        cluster = grown


@reproducible
@given(PEOPLE)
def test_a_cluster_is_whoever_can_be_reached_over_shared_groups(people):
    """It has the first name of its groups in the first session."""
    cluster = join_groups(
        [first for first, _ in people], [second for _, second in people]
    )
    for person, name in enumerate(cluster):
        within = reached(people, person)
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


def draw_shares(tracks, n=3001):
    """How often each track is drawn by evenly spread shares."""
    samples = samples_at_shares((np.arange(n) + 0.5) / n, tracks)
    owner = np.searchsorted(tracks.offsets, samples, side="right") - 1
    return np.bincount(owner, minlength=len(tracks)) / n


class TestPlacesByTime:
    def test_with_equal_steps_each_sample_is_as_likely_as_another(self):
        tracks, shares = sampled(2.5, 2.5, 2.5), np.linspace(0.0, 0.9999, 777)
        by_sample = (shares * tracks.t.size).astype(np.int64)
        assert np.array_equal(samples_at_shares(shares, tracks), by_sample)

    @pytest.mark.parametrize("fast", [10.0, 1000.0])
    def test_a_faster_track_is_drawn_for_its_time(self, fast):
        assert np.abs(draw_shares(sampled(2.5, fast, 2.5)) - 1 / 3).max() < 0.01

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
        samples = samples_at_shares((np.arange(4000) + 0.5) / 4000, both)
        in_burst = ((samples >= 25) & (samples < 5025)).mean()
        assert abs(in_burst - 5.0 / 45.0) < 0.01

    def test_a_gap_draws_nobody_more_often(self):
        tracks = sampled(2.5, 2.5)
        t = tracks.t.copy()
        t[-1] += 1000.0
        assert np.abs(draw_shares(replace(tracks, t=t)) - 0.5).max() < 0.01

    def test_one_sample_a_track(self):
        t = np.zeros(3)
        tracks = Tracks(
            t, np.zeros((3, 2)), np.arange(4), ("a", "b", "c"), ("a", "b", "c")
        )
        assert samples_at_shares(np.array([0.0, 0.5, 0.99]), tracks).tolist() == [
            0,
            1,
            2,
        ]

    def test_a_track_of_one_sample_does_not_change_what_is_drawn(self):
        even = sampled(2.5, 2.5)
        t, offsets = np.append(even.t, 3.0), np.append(even.offsets, even.t.size + 1)
        names = ("a", "b", "c")
        tracks = Tracks(t, np.zeros((t.size, 2)), offsets, source=names, group=names)
        shares = np.linspace(0.0, 0.9999, 777)
        by_sample = (shares * t.size).astype(np.int64)
        assert np.array_equal(samples_at_shares(shares, tracks), by_sample)
