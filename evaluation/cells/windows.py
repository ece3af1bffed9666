"""What each window of a linkage task gives away by itself: a cell with a row for every window.

Nobody links here. The rows are what a person's linkability is compared with: how long and fast
the walk was, how well it was sensed, and the descriptors of what was shared of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from evaluation.cells.descriptors import DESCRIPTORS, descriptors
from evaluation.cells.link_setup import SIDES
from evaluation.cells.tables import ROWS, names_column

if TYPE_CHECKING:
    from collections.abc import Sequence

    from attacks.tasks.sessions import Sessions, Windows
    from evaluation.cells.link_setup import SensedSessions
    from evaluation.cells.tables import Rows, Tables
    from isac_track.types import Floats, Ints, Release, Sensed

COLUMNS = (
    *("side", "search", "source", "group"),
    *("n_samples", "duration_s", "path_m", "speed_mps"),
    *("sigma_m", "sigma_raw_m"),
    *DESCRIPTORS,
)
"""Of the rows of a cell."""


def window_rows(
    released: Sequence[Release], *, known: SensedSessions, sessions: Sessions, epsilon_m: float
) -> Rows:
    """Return a row for every window of both sides: the columns of `window_tables`.

    Parameters
    ----------
    released : sequence of Release
        Of the probe and of the gallery side, in the true frame.
    known : SensedSessions
        Of these releases, without the samples that they left out.
    sessions : Sessions
        Whole: what the walk was does not depend on which samples were shared.
    epsilon_m : float
    """
    sides = []
    for side, whole, left, sensed, release in zip(
        SIDES,
        (sessions.probe, sessions.gallery),
        (known.sessions.probe, known.sessions.gallery),
        known.sensed,
        released,
        strict=True,
    ):
        exposed = descriptors(
            xy=release.xy,
            truth=left.xy,
            t=left.t,
            offsets=left.offsets,
            epsilon_m=epsilon_m,
        )
        sides.append(
            {
                "side": np.full(len(whole), side),
                "search": whole.search,
                "person": whole.person,
                "n_samples": np.diff(left.offsets),
                **_walked(whole),
                **_noise(release, sensed),
                **{name: exposed[name] for name in DESCRIPTORS},
            }
        )
    return {name: np.concatenate([one[name] for one in sides]) for name in sides[0]}


def window_tables(rows: Rows, sessions: Sessions) -> Tables:
    """Return the table of a cell of windows; its columns are `COLUMNS`.

    `side` (probe or gallery), `search` (a half, or the instant of a handover), `source`, `group`;
    of what was shared `n_samples`, `sigma_m` (mean declared standard deviation, NaN where none is
    declared), `sigma_raw_m` (mean of sensing) and `DESCRIPTORS`; of the true walk, alike at all
    levels, `duration_s`, `path_m` and `speed_mps` (NaN for a window of one sample).
    """
    return {
        ROWS: pa.table(
            {
                "side": pa.array(rows["side"]),
                "search": names_column(rows["search"], sessions.searches),
                "source": names_column(rows["person"], sessions.source),
                "group": names_column(rows["person"], sessions.group),
                **{name: rows[name] for name in COLUMNS[4:]},
            }
        )
    }


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


def _noise(release: Release, sensed: Sensed) -> Rows:
    sigma_m = np.full(release.t.size, np.nan) if release.sigma is None else release.sigma
    return {
        "sigma_m": _means(sigma_m, release.offsets),
        "sigma_raw_m": _means(sensed.sigma_raw, sensed.offsets),
    }


def _means(values: Floats, offsets: Ints) -> Floats:
    mean: Floats = np.add.reduceat(values, offsets[:-1]) / np.diff(offsets)
    return mean
