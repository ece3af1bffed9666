"""What each window of a linkage task gives away by itself: a cell with a row for every window.

Nobody links here. The rows are what a person's linkability is compared with: how long and fast
the walk was, how well it was sensed, and the descriptors of what was shared of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from evaluation.cells.link_setup import SIDES
from evaluation.cells.tables import (
    DESCRIPTORS,
    ROWS,
    Rows,
    Tables,
    descriptors,
    names_column,
    track_means,
)

if TYPE_CHECKING:
    from attacks.tasks.sessions import Windows
    from evaluation.cells.linkage import LinkedLevel

COLUMNS = (
    *("side", "search", "source", "group"),
    *("n_samples", "duration_s", "path_m", "speed_mps"),
    *("sigma_m", "sigma_raw_m"),
    *DESCRIPTORS,
)
"""Of the rows of a cell."""


def window_tables(level: LinkedLevel) -> Tables:
    """Return the table of a cell of windows: a row for every window of both sides, `COLUMNS`.

    `side` (probe or gallery), `search` (a half, or the instant of a handover), `source`, `group`;
    of what was shared `n_samples`, `sigma_m` (mean declared standard deviation, NaN where none is
    declared), `sigma_raw_m` (mean of sensing) and `DESCRIPTORS`; of the true walk, alike at all
    levels, `duration_s`, `path_m` and `speed_mps` (NaN for a window of one sample).
    """
    known, sessions = level.known, level.whole.sessions
    sides = []
    for side, sensed, release in zip(SIDES, known.sensed, level.shared, strict=True):
        whole: Windows = getattr(sessions, side)
        exposed = descriptors(
            xy=release.xy,
            truth=getattr(known.sessions, side).xy,
            t=release.t,
            offsets=release.offsets,
            epsilon_m=known.epsilon_m,
        )
        sigma_m = np.full(release.t.size, np.nan) if release.sigma is None else release.sigma
        columns = {
            "side": pa.array(np.full(len(whole), side)),
            "search": names_column(whole.search, sessions.searches),
            "source": names_column(whole.person, sessions.source),
            "group": names_column(whole.person, sessions.group),
            "n_samples": np.diff(release.offsets),
            # What the walk was does not depend on which samples were shared.
            **_walked(whole),
            "sigma_m": track_means(sigma_m, release.offsets),
            "sigma_raw_m": track_means(sensed.sigma_raw, sensed.offsets),
            **{name: exposed[name] for name in DESCRIPTORS},
        }
        sides.append(pa.table(columns))
    return {ROWS: pa.concat_tables(sides).combine_chunks()}


def _walked(windows: Windows) -> Rows:
    """Return how long each window lasted, how far its walk was and how fast."""
    step_m = np.zeros(windows.t.size)
    step_m[1:] = np.hypot(*np.diff(windows.xy, axis=0).T)
    step_m[windows.offsets[:-1]] = 0.0  # from one window to the next
    duration_s = windows.t[windows.offsets[1:] - 1] - windows.t[windows.offsets[:-1]]
    path_m = np.add.reduceat(step_m, windows.offsets[:-1])
    speed_mps = np.full(duration_s.size, np.nan)
    np.divide(path_m, duration_s, out=speed_mps, where=duration_s > 0)
    return {"duration_s": duration_s, "path_m": path_m, "speed_mps": speed_mps}
