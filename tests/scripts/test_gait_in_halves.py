"""Two windows of a walk as two sessions, and what gait links of them."""

import gait_in_halves
import numpy as np
import pytest
from returning_crowds import passage

from isac_track.types import Tracks

WINDOW_S, LENGTHS_S = 5.0, (12.0,) * 9 + (10.5,)


@pytest.fixture(scope="module")
def tracks():
    """Ten walks with habits of their own; the last is too short for two windows."""
    rng = np.random.default_rng(1)
    walks = [passage(rng, 4.0 * rng.standard_normal(6), size) for size in LENGTHS_S]
    names = tuple(f"w{row}" for row in range(len(walks)))
    return Tracks(
        t=np.concatenate([t for t, _ in walks]),
        xy=np.concatenate([xy for _, xy in walks]),
        offsets=np.append(0, np.cumsum([t.size for t, _ in walks])),
        source=names,
        group=names,
    )


def test_windows_of_a_walk_do_not_touch(tracks):
    halves = gait_in_halves.halves(tracks, window_s=WINDOW_S, most_people=99, seed=0)
    assert halves.person == tuple(name for name in tracks.source[:9] for _ in range(2))
    assert halves.session == ("half 0", "half 1") * 9
    first, second = [*halves][:2]
    assert first.t[-1] - first.t[0] == pytest.approx(WINDOW_S, abs=0.05)
    assert second.t[-1] - second.t[0] == pytest.approx(WINDOW_S, abs=0.05)
    assert second.t[0] - first.t[-1] == pytest.approx(1.0, abs=0.05)
    few = gait_in_halves.halves(tracks, window_s=WINDOW_S, most_people=4, seed=0)
    assert len(set(few.person)) == 4
    assert set(few.person) < set(halves.person)


def test_gait_links_windows_until_errors_hide_it(tracks):
    halves = gait_in_halves.halves(tracks, window_s=WINDOW_S, most_people=99, seed=0)
    clean, hidden = gait_in_halves.link_halves(halves, errors=("0", "0.3"), seed=0)
    assert clean["n"] == 9
    assert clean["chance"] == pytest.approx(1 / 9)
    assert clean["rank1"] > 0.5 > hidden["rank1"]
