"""Queues by hand: people behind each other on a ring in view, in laps, past a line."""

import numpy as np

from attacks.tasks.passage_circumstances import compare_circumstances
from attacks.tasks.queues import NOBODY, find_queue
from attacks.tasks.window_circumstances import measure_circumstances
from attacks.tasks.windows import Windows
from isac_track.types import Tracks

N = 10


def walks(starts_s, starts_m, people, *, session=None):
    """Tracks of two samples, 4 s apart, that all walk 1 m in x."""
    begin_s = np.asarray(starts_s, dtype=float)
    start_m = np.asarray(starts_m, dtype=float)
    names = tuple(f"p{person}" for person in people)
    return Tracks(
        t=np.column_stack([begin_s, begin_s + 4.0]).ravel(),
        xy=np.stack([start_m, start_m + np.array([1.0, 0.0])], axis=1).reshape(-1, 2),
        offsets=2 * np.arange(begin_s.size + 1),
        source=tuple(map(str, range(begin_s.size))),
        group=names,
        person=names,
        session=session or ("a",) * begin_s.size,
    )


def past_a_line(people):
    """People who enter one after another, 2 s apart, at the same place."""
    return walks(2.0 * np.arange(len(people)), np.zeros((len(people), 2)), people)


def on_a_ring(n=N):
    """People who are on a circle from the start, clockwise from its lowest point."""
    turn = np.pi + 2.0 * np.pi * (np.arange(n) + 0.5) / n
    return walks(
        np.zeros(n), 5.0 * np.column_stack([np.sin(turn), np.cos(turn)]), range(n)
    )


def queue_in(tracks):
    person = np.array([int(name[1:]) for name in tracks.person])
    return find_queue(tracks, np.arange(len(tracks)), person)


def closeness(tracks):
    person = np.unique(tracks.person, return_inverse=True)[1]
    session = np.unique(tracks.session, return_inverse=True)[1]
    return compare_circumstances(tracks, person, session, np.arange(len(tracks)))


def test_past_a_line_the_first_and_the_last_are_farthest_apart():
    place = closeness(past_a_line(range(N)))["queue place"]
    np.testing.assert_allclose(place[0], -np.arange(N) / N)
    assert place[0].argmin() == N - 1


def test_past_a_line_the_first_and_the_last_lack_a_neighbour():
    queue = queue_in(past_a_line(range(N)))
    assert not queue.is_ring
    assert queue.ahead.tolist() == [NOBODY, *range(N - 1)]
    assert queue.behind.tolist() == [*range(1, N), NOBODY]


def test_on_a_ring_the_first_and_the_last_follow_each_other():
    tracks = on_a_ring()
    place = closeness(tracks)["queue place"]
    step = np.arange(N)
    np.testing.assert_allclose(place[0], -np.minimum(step, N - step) / N)
    queue = queue_in(tracks)
    assert queue.is_ring
    assert queue.ahead.tolist() == [N - 1, *range(N - 1)]
    assert queue.behind.tolist() == [*range(1, N), 0]


def test_two_sessions_on_a_ring_share_all_neighbours_wherever_the_seam_is():
    first = on_a_ring()
    turned = np.roll(first.xy.reshape(N, 2, 2)[:, 0], 3, axis=0)
    both = walks(
        np.append(np.zeros(N), np.full(N, 100.0)),
        np.concatenate([first.xy[::2], turned]),
        [*range(N), *range(N)],
        session=("a",) * N + ("b",) * N,
    )
    neighbours = closeness(both)["neighbours"][:N, N:]
    assert (np.diagonal(neighbours) == 2.0).all()


def test_people_who_come_round_in_laps_walk_on_a_ring():
    queue = queue_in(past_a_line([*range(N), *range(N), 0, 1]))
    assert queue.is_ring
    np.testing.assert_allclose(queue.place[N : 2 * N], np.arange(N) / N)
    # The last of a lap is in front of the first of the next. Nobody is recorded before
    # the first entry nor after the last.
    assert queue.ahead[[0, N, 2 * N]].tolist() == [NOBODY, N - 1, N - 1]
    assert queue.behind[[N - 1, 2 * N - 1, 2 * N + 1]].tolist() == [0, 0, NOBODY]


def test_an_overtaking_between_laps_leaves_a_ring():
    assert queue_in(past_a_line([0, 1, 2, 3, 4, 1, 2, 0, 3, 4])).is_ring


def test_walks_in_two_parts_make_no_ring():
    queue = queue_in(past_a_line([0, 0, 1, 1, 2, 2, 3, 3]))
    assert not queue.is_ring
    # Nobody is their own neighbour: this would name the person.
    assert queue.ahead.tolist() == [NOBODY, NOBODY, 0, NOBODY, 1, NOBODY, 2, NOBODY]


def test_alone_on_a_ring_nobody_has_neighbours():
    queue = queue_in(on_a_ring(1))
    assert (queue.ahead.item(), queue.behind.item()) == (NOBODY, NOBODY)


def test_a_place_on_a_line_and_on_a_ring_are_compared_along_the_line():
    ring = on_a_ring()
    both = walks(
        np.append(np.zeros(N), 100.0 + 2.0 * np.arange(N)),
        np.concatenate([ring.xy[::2], np.zeros((N, 2))]),
        [*range(N), *range(N)],
        session=("a",) * N + ("b",) * N,
    )
    place = closeness(both)["queue place"]
    assert np.isclose(place[0, N - 1], -1.0 / N)
    np.testing.assert_allclose(place[0, N:], -np.arange(N) / N)


def columns_of_windows(tracks):
    """Return cosine and sine of the place in the queue, a window for each track."""
    windows = Windows(
        t=tracks.t,
        xy=tracks.xy,
        offsets=tracks.offsets,
        person=np.arange(len(tracks)),
        search=np.zeros(len(tracks), dtype=int),
    )
    return measure_circumstances(tracks, np.arange(len(tracks)), windows)[:, :2]


def test_windows_of_a_line_lie_on_half_a_circle_and_of_a_ring_on_all_of_it():
    for tracks, whole in ((past_a_line(range(N)), np.pi), (on_a_ring(), 2.0 * np.pi)):
        angle = whole * np.arange(N) / N
        np.testing.assert_allclose(
            columns_of_windows(tracks),
            np.column_stack([np.cos(angle), np.sin(angle)]),
            atol=1e-12,
        )
