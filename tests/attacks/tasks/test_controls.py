"""Controls: each sees what it is there for, and nothing else."""

import numpy as np
import pytest
from helpers.walks import walk_release
from scipy.spatial.distance import cdist

from attacks.tasks.controls import CONTROLS, closeness
from attacks.tasks.task_list import TASKS
from attacks.tasks.window_circumstances import CIRCUMSTANCE_COLUMNS
from isac_track.linkability import Search, permutation_p
from isac_track.rng import stream

N = 60
ALPHA = 1e-3


DRAWN = {
    "duration_s": (8, 12, N),
    "rate_hz": (8, 16, N),
    "level": (0.1, 1, N),
    "place": (-50, 50, (N, 2)),
    "start_s": (0, 1e4, N),
}


def release(rng, **given):
    """Return N random tracks that differ by the given values alone, one a track."""
    drawn = {
        name: rng.uniform(*how) for name, how in DRAWN.items() if name not in given
    } | given
    walks, sigma = [], []
    for duration_s, rate_hz, level, place, start_s in zip(
        *map(drawn.get, DRAWN), strict=True
    ):
        size = int(duration_s * rate_hz)
        steps = rng.uniform(0.8, 1.2, size) / rate_hz
        t = start_s + np.cumsum(steps) - steps[0]
        walks.append((t, place + 0.2 * rng.standard_normal((size, 2)).cumsum(axis=0)))
        sigma.append(level * rng.uniform(0.9, 1.1, size))
    return walk_release(walks, sigma=np.concatenate(sigma))


LEAKS = {
    "duration": lambda rng: {"duration_s": rng.uniform(5, 20, N)},
    "sample_count": lambda rng: {
        "duration_s": rng.uniform(5, 20, N),
        "rate_hz": np.full(N, 12.0),
    },
    "sampling_times": lambda rng: {"rate_hz": rng.uniform(4, 20, N)},
    "noise_level": lambda rng: {"level": rng.uniform(0.1, 2, N)},
    "frame": lambda rng: {"place": rng.uniform(-50, 50, (N, 2))},
    "clock": lambda rng: {"start_s": rng.uniform(0, 1e4, N)},
}


def p_value(name, *, probe, gallery, rng, task="rerelease"):
    """Of the control's ranks among those of shuffled mates."""
    scores = CONTROLS[name].scorer(TASKS[task])(probe, gallery, rng)
    assert scores.shape == (N, N)
    assert np.isfinite(scores).all()
    people = np.arange(N)
    search = Search(
        scores=scores, mate=people, probe_cluster=people, gallery_cluster=people
    )
    return permutation_p(searches=[search], rng=rng, n_shuffles=9999)


def leaking(name, leak=None):
    rng = np.random.default_rng(5)
    shared = {} if leak is None else LEAKS[leak](np.random.default_rng(1))
    return p_value(
        name, probe=release(rng, **shared), gallery=release(rng, **shared), rng=rng
    )


def test_every_audit_has_a_leak_to_find():
    audits = {
        name
        for name, control in CONTROLS.items()
        if control.is_audit and not control.circumstance
    }
    assert LEAKS.keys() == audits


@pytest.mark.parametrize("name", LEAKS)
def test_an_audit_finds_its_leak(name):
    assert leaking(name, name) < ALPHA


@pytest.mark.parametrize("name", [*LEAKS, "random"])
def test_a_control_stays_at_chance_where_nothing_leaks(name):
    assert leaking(name) > ALPHA


@pytest.mark.parametrize(
    ("name", "leak"),
    [("noise_level", "clock"), ("frame", "noise_level"), ("clock", "frame")],
)
def test_an_audit_sees_nothing_but_its_own(name, leak):
    assert leaking(name, leak) > ALPHA


def test_the_frame_is_place_and_heading_by_hand():
    # All begin at 0 and end 1 m off, in three directions.
    ways = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]])
    tracks = walk_release(
        [(np.arange(4.0), np.repeat([[0.0, 0.0], way], 2, axis=0)) for way in ways]
    )
    scores = CONTROLS["frame"].score(tracks, tracks, None)
    # First and second: 1 m and 2, over standard deviations of 1/2 and 1 times the root
    # of 2/3.
    assert scores[0, :2].tolist() == pytest.approx([0.0, -2.0 * np.sqrt(3.0)])


def test_in_the_true_frame_noise_counts_beyond_what_the_place_explains():
    def p_values_for(task, make_level):
        p_values = []
        for seed in range(5):
            rng = np.random.default_rng(seed)
            place, own = rng.uniform(-50, 50, (N, 2)), rng.uniform(0.2, 5, N)
            sides = {
                side: release(rng, place=place, level=make_level(place, own, rng))
                for side in ("probe", "gallery")
            }
            p_values.append(p_value("noise_level", **sides, rng=rng, task=task))
        return np.array(p_values)

    def by_place(place, own, rng):
        del own
        return np.exp(0.02 * place[:, 0]) * rng.uniform(0.5, 2, N)

    def by_person(place, own, rng):
        return by_place(place, own, rng) * own

    assert (p_values_for("rerelease", by_place) < ALPHA).any()
    assert (p_values_for("handover-1s", by_place) > ALPHA).all()
    assert (p_values_for("handover-1s", by_person) < ALPHA).any()


def test_equal_noise_shows_nothing_not_even_through_rounding():
    rng = np.random.default_rng(3)
    same_noise = release(rng, level=np.full(N, 0.0))
    assert (
        not CONTROLS["noise_level"]
        .scorer(TASKS["handover-1s"])(same_noise, same_noise, rng)
        .any()
    )


def test_frame_and_clock_are_no_shortcuts_where_the_scene_shows():
    for name, control in CONTROLS.items():
        assert control.applies(TASKS["cross_session"])
        assert control.applies(TASKS["rerelease"]) == (name not in CIRCUMSTANCE_COLUMNS)
        if name in CIRCUMSTANCE_COLUMNS:
            continue
        assert control.applies(TASKS["handover-1s"]) == (name not in {"frame", "clock"})


def test_the_noise_level_is_a_shortcut_only_where_the_channel_is_another_one():
    ablated = {"split", "handover-1s", "handover-2s", "handover-5s"}
    for name, task in TASKS.items():
        assert CONTROLS["noise_level"].audits(task) == (name not in ablated), name
        assert CONTROLS["noise_level"].applies(task)
        assert CONTROLS["duration"].audits(task)
        assert not CONTROLS["random"].audits(task)


def test_closeness_is_the_distance_of_features_in_units_of_their_spread():
    rng = stream(0, "test", "closeness")
    first, second = (
        rng.normal([0, 5, 0], [1, 100, 0], (7, 3)),
        rng.normal(0, [1, 9, 0], (4, 3)),
    )
    both = np.concatenate([first, second])
    expected = -cdist(first, second, "seuclidean", V=[*both[:, :2].var(axis=0), 1.0])
    assert closeness(first, second) == pytest.approx(expected, rel=1e-12)
