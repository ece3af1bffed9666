"""Planted crowds of people who come back: sway and steps that we know.

People walk in single file through a corridor, several times in each session. A person
has habits of gait, and so has a place in the queue: whoever walks there is disturbed in
its way. Both have the same form, so that no feature tells them apart.
"""

import numpy as np

from isac_track.rng import stream
from isac_track.types import Tracks

STRENGTHS = {"none": 0.0, "weak": 1.0, "strong": 3.0}
"""Spread of habits; 1 is about that of people: 8 % of cadence, 25 % of amplitudes."""
SESSIONS = ((14, 5, 3.6), (21, 5, 5.8), (30, 3, 12.0))
"""People, passages of each, and median length of a passage in s, as in `returners`."""
_RATE_HZ = 25.0
_WAY_M = 4.0


def returning_crowd(
    seed, *, traits, is_order_kept, sessions=SESSIONS, place_effect=0.7, n_people=41
):
    """Tracks of `n_people` people, of whom about half walk in two sessions or more.

    `traits` is the spread of a person's habits (`STRENGTHS`), `place_effect` that of
    the places. With `is_order_kept` people keep their order over sessions.
    """
    rng = stream(seed, "planted", "returns")
    habits = traits * rng.standard_normal((n_people, 6))
    places = place_effect * rng.standard_normal((n_people, 6))
    order = rng.permutation(n_people)
    parts = []
    for number, (size, laps, median_s) in enumerate(sessions):
        present = np.sort(rng.choice(n_people, size, replace=False))
        queue = order[present] if is_order_kept else rng.permutation(order[present])
        headway_s = 2.0 * median_s / np.sqrt(size)
        for lap in range(laps):
            for slot, person in enumerate(queue.tolist()):
                at = np.flatnonzero(order == person)[0] if is_order_kept else slot
                start_s = (lap * size + slot) * headway_s + rng.uniform(0, 0.3)
                length_s = max(3.1, median_s * np.exp(0.15 * rng.standard_normal()))
                t, xy = passage(rng, habits[person] + places[at], length_s)
                parts.append((number, f"p{person:02d}", start_s + t, xy))
    return Tracks(
        t=np.concatenate([part[2] for part in parts]),
        xy=np.concatenate([part[3] for part in parts]),
        offsets=np.append(0, np.cumsum([part[2].size for part in parts])),
        source=tuple(f"{part[0]}:{row}" for row, part in enumerate(parts)),
        group=tuple(part[1] for part in parts),
        person=tuple(part[1] for part in parts),
        session=tuple(f"run {part[0]}" for part in parts),
    )


def passage(rng, habit, length_s):
    """Times, s, and positions, m, of a passage with six habits in standard units."""
    t = np.arange(0.0, length_s, 1.0 / _RATE_HZ)
    speed = _WAY_M / length_s
    mood = 0.5 * rng.standard_normal(6)
    cadence, sway, surge, second, phase, skew = habit + mood
    step_hz = 1.9 * np.sqrt(min(speed, 1.4) / 1.3) * np.exp(0.08 * cadence)
    stride = np.pi * step_hz * t + rng.uniform(0, 2 * np.pi)
    stride += 0.1 * np.cumsum(rng.standard_normal(t.size)) / np.sqrt(_RATE_HZ)
    side_m = 0.03 * np.exp(0.25 * sway)
    lateral = side_m * (
        np.sin(stride) + 0.2 * np.exp(0.3 * second) * np.sin(3 * stride)
    )
    ahead = 0.012 * np.exp(0.25 * surge) * np.sin(2 * stride + 0.6 * phase)
    ahead += 0.006 * np.exp(0.3 * skew) * np.sin(stride + 1.0)
    drift = 0.02 * np.cumsum(rng.standard_normal((2, t.size)), axis=1) / _RATE_HZ**0.5
    x = speed * t + ahead + 0.5 * drift[0]
    return t, np.column_stack([x, lateral + 0.3 * drift[1]])
