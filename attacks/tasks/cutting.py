"""Cut windows out of recorded walks, resampled at the instants of the network."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from attacks.tasks.task_input import TaskInput
from attacks.tasks.windows import Windows
from isac_track.datasets.repair import FAST_STEP_MPS
from isac_track.resample import sampling_times, walk
from isac_track.types import Floats, Ints, Tracks, squared_lengths

# Step of the way along a walk: the mean step at which it is sensed.
WAY_STEP_S = 1 / 12


@dataclass(frozen=True, eq=False, slots=True)
class CutWindows:
    """N windows of recorded walks, M samples in all, before they get a search."""

    t: Floats  # (M,) s
    xy: Floats  # (M, 2) m
    walked_m: Floats  # (M,) m since the recorded walk began.
    offsets: Ints  # (N + 1,)

    def in_searches(
        self, person: Ints, search: Ints, *, shift_m: Floats | float = 0.0
    ) -> Windows:
        """Return them as windows of people in searches, each shifted by (N, 2) m."""
        moved = np.repeat(
            np.broadcast_to(shift_m, (person.size, 2)), np.diff(self.offsets), axis=0
        )
        return Windows(
            self.t,
            self.xy + moved,
            self.offsets,
            person,
            search,
            walked_m=self.walked_m,
        )


def cut_windows(
    task_input: TaskInput,
    side: str,
    rows: Ints,
    start_s: Floats,
    end_s: Floats,
    keys: Sequence[str] = (),
) -> CutWindows:
    """Return windows of the tracks in `rows`, each at sampling instants of its own.

    `rows`, `start_s`, `end_s` and `keys` are (N,). A window ends where its walk ends.
    `rows` may hold a track more than once, each time with another of `keys`, which
    name the streams of the instants.
    """
    tracks, resample = task_input.tracks, task_input.settings.resample
    start_s = np.maximum(start_s, task_input.start_s[rows])
    end_s = np.minimum(end_s, task_input.end_s[rows])
    keys = keys or [""] * rows.size
    t, xy, walked_m = [], [], []
    for row, start, end, key in zip(
        rows.tolist(), start_s, end_s.tolist(), keys, strict=True
    ):
        rng = task_input.rng("sampling", side, tracks.source[row], key)
        instants_s = sampling_times(
            start_s=start, end_s=end, settings=resample, rng=rng
        )
        way = _way_walked(tracks, row, resample.max_overshoot_m)
        t.append(instants_s)
        xy.append(_walk(tracks, row, resample.max_overshoot_m)(instants_s))
        walked_m.append(np.interp(instants_s, way.t, way.walked_m))
    return CutWindows(
        t=np.concatenate(t),
        xy=np.concatenate(xy),
        walked_m=np.concatenate(walked_m),
        offsets=np.cumsum([0, *map(len, t)]),
    )


# All tasks of a recording cut their windows from the same walks; the oldest of 2,048
# goes, and all with the process.
@lru_cache(maxsize=2048)
def _walk(
    tracks: Tracks, row: int, max_overshoot_m: float
) -> Callable[[Floats], Floats]:
    """Return the walk of a track: from instants, (K,) s, to positions, (K, 2) m."""
    return walk(tracks[row], max_overshoot_m=max_overshoot_m)


@dataclass(frozen=True, eq=False, slots=True)
class _WayWalked:
    """The way walked since a recorded walk began, at K instants of even steps."""

    t: Floats  # (K,) s
    walked_m: Floats  # (K,) m


# As above.
@lru_cache(maxsize=2048)
def _way_walked(tracks: Tracks, row: int, max_overshoot_m: float) -> _WayWalked:
    """Return the way along a whole walk: the same wherever windows are cut."""
    track = tracks[row]
    n_steps = int((track.t[-1] - track.t[0]) / WAY_STEP_S)
    t = np.append(track.t[0] + WAY_STEP_S * np.arange(n_steps + 1), track.t[-1])
    steps_m = np.sqrt(
        squared_lengths(np.diff(_walk(tracks, row, max_overshoot_m)(t), axis=0))
    )
    # A faster step is a jump of the annotation.
    steps_m = np.minimum(steps_m, WAY_STEP_S * FAST_STEP_MPS)
    return _WayWalked(t, np.concatenate([[0.0], np.cumsum(steps_m)]))
