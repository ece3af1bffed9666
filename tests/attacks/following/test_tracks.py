"""Following people through tracks: whole, broken and swapped ones, made by hand."""

from collections import Counter

import numpy as np
import pytest
from helpers.patrols import patrol_past, straight_walks

from attacks.following.logs import Ending
from attacks.following.tracks import HELD_S, follow_tracks, held_spans
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Release

# Twelve people 20 m apart, who walk straight for 20 s: 201 scans each.
WALKS = [
    (0, 20, (20.0 * (row % 4), 20.0 * (row // 4)), (0.5 + 0.1 * row, 0.3))
    for row in range(12)
]
SIZE = 201


@pytest.fixture(scope="module")
def patrol():
    return patrol_past(straight_walks(*WALKS), (0, 0))


def shared_tracks(patrol, tracks):
    """Tracks of true samples, each a list of (person, first scan, end scan)."""
    rows = [
        np.concatenate(
            [
                patrol.people.offsets[person] + np.arange(first, end)
                for person, first, end in parts
            ]
        )
        for parts in tracks
    ]
    sample = np.concatenate(rows)
    offsets = np.cumsum([0, *map(len, rows)])
    people, scan = patrol.people, patrol.scan[sample]
    return SharedTracks(
        release=Release(
            t=people.t[sample],
            xy=people.xy[sample],
            sigma=None,
            offsets=offsets,
            pseudonym=tuple(map(str, range(len(tracks)))),
        ),
        variance=np.full(sample.size, 1e-3),
        scan=scan,
        confirmed=scan[offsets[:-1]],
        last=scan[offsets[1:] - 1],
        person=np.searchsorted(people.offsets, sample, side="right") - 1,
    )


def test_whole_tracks_follow_everybody_to_the_end(patrol):
    whole = shared_tracks(patrol, [[(person, 0, SIZE)] for person in range(12)])
    followed = follow_tracks(patrol, whole)
    assert (followed.ending == Ending.LEFT).all()
    np.testing.assert_allclose(followed.until_s, 20.0)
    np.testing.assert_allclose(followed.followed_s, followed.present_s)
    assert followed.break_s.size == 0


def test_broken_tracks_are_joined_by_the_predicted_place(patrol):
    # Numbered backwards in time: the order of tracks says nothing.
    broken = [[(person, 105, SIZE)] for person in range(12)]
    broken += [[(person, 0, 100)] for person in range(12)]
    followed = follow_tracks(patrol, shared_tracks(patrol, broken))
    assert followed.is_joined.all()
    np.testing.assert_allclose(followed.break_s, 9.9)
    assert (followed.ending == Ending.LEFT).all()
    np.testing.assert_allclose(followed.followed_s, 20.0)


def test_a_swap_ends_the_chase_without_notice(patrol):
    tracks = [[(person, 0, SIZE)] for person in range(2, 11)]
    tracks += [[(0, 0, 101), (1, 101, SIZE)], [(1, 0, 101), (0, 101, SIZE)]]
    followed = follow_tracks(patrol, shared_tracks(patrol, tracks))
    assert followed.ending[:2].tolist() == [Ending.WRONG] * 2
    # Held by majority, so that both ends are within half of the time that decides.
    np.testing.assert_allclose(followed.until_s[:2], 10.0, atol=HELD_S / 2.0)
    np.testing.assert_allclose(followed.followed_s[:2], 10.0, atol=HELD_S / 2.0)
    assert (followed.ending[2:11] == Ending.LEFT).all()
    # The last person is in no track.
    assert followed.ending[11] == Ending.UNSEEN
    assert followed.until_s[11] == followed.followed_s[11] == 0.0


def test_nobody_is_told_apart_where_all_stand_at_one_place():
    still = straight_walks(*[(0, 20, (0.1 * row, 0), (0, 0)) for row in range(12)])
    patrol = patrol_past(still, (5, 5))
    broken = [[(person, 0, 100)] for person in range(12)]
    broken += [[(person, 105, SIZE)] for person in range(12)]
    shared = shared_tracks(patrol, broken)
    blurred = SharedTracks(
        release=shared.release,
        variance=np.full(shared.scan.size, 100.0),
        scan=shared.scan,
        confirmed=shared.confirmed,
        last=shared.last,
        person=shared.person,
    )
    followed = follow_tracks(patrol, blurred)
    assert (followed.ending == Ending.CONFUSED).all()
    np.testing.assert_allclose(followed.until_s, 9.9)
    assert followed.break_s.size == 12


def test_a_track_holds_who_has_most_of_its_samples(patrol):
    rng = np.random.default_rng(0)
    shared = shared_tracks(patrol, [[(0, 0, SIZE)], [(1, 0, SIZE)]])
    mixed = SharedTracks(
        release=shared.release,
        variance=shared.variance,
        scan=shared.scan,
        confirmed=shared.confirmed,
        last=shared.last,
        person=rng.choice([-1, 0, 1], size=shared.scan.size),
    )
    spans = held_spans(mixed)
    t = mixed.release.t
    for track in (0, 1):
        rows = np.arange(*mixed.release.offsets[track : track + 2])
        for row in rows[::7]:
            near = rows[np.abs(t[rows] - t[row]) <= HELD_S / 2.0 + 1e-9]
            counts = Counter(mixed.person[near].tolist())
            holds = (spans.track == track) & (spans.start_s <= t[row])
            holder = spans.person[holds & (spans.end_s >= t[row])].item()
            assert counts[holder] >= max(counts.values()) - 1
    assert (spans.is_first == np.append(True, np.diff(spans.track) != 0)).all()
    assert (spans.is_last == np.append(np.diff(spans.track) != 0, True)).all()
