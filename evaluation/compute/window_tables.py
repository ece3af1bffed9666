"""The table of a cell of windows: each with its own descriptors.

A person's linkability is compared with these.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from evaluation.compute.link_setup import SIDES
from evaluation.compute.link_views import (
    LinkedLevel,
    LinkerView,
    linker_view,
    true_walks,
)
from evaluation.compute.tables import (
    DESCRIPTORS,
    ON_TRIAL,
    ROWS,
    Tables,
    descriptors,
    names_column,
    table,
    track_means,
)
from isac_track import privacy
from isac_track.types import Floats, derived, lengths

if TYPE_CHECKING:
    from attacks.tasks.windows import Windows
    from evaluation.plan.consumer import Consumer


# Columns of the rows of a cell of windows.
WINDOW_COLUMNS = (
    "side",
    "search",
    "source",
    "group",
    "n_samples",
    "duration_s",
    "speed_mps",
    "sigma_m",
    *DESCRIPTORS,
    *ON_TRIAL,
)


def window_tables(consumer: Consumer, level: LinkedLevel) -> Tables:
    """Return the table of a cell of windows: `WINDOW_COLUMNS` for each of both sides.

    `side` is probe or gallery, `search` a half or the instant of a handover. Of the
    shared samples: `n_samples`, `sigma_m` (mean declared standard deviation) and
    `DESCRIPTORS`. Of the true walk, the same at all levels: `duration_s` and
    `speed_mps` (NaN for a window of a single sample). After the reconstruction that the
    consumer stands behind, whatever else is in the run: `ON_TRIAL`, which are the
    descriptors, `privacy.alignment_error`, and the mean standard deviation that it
    claims.
    """
    smoothed = linker_view(consumer, level, 0)
    sides = [_side_table(level, smoothed, side) for side in range(len(SIDES))]
    return {ROWS: pa.concat_tables(sides).combine_chunks()}


def _side_table(level: LinkedLevel, smoothed: LinkerView, side: int) -> pa.Table:
    """Return the rows of `window_tables` of one side, 0 or 1."""
    setup, task_windows = level.setup, level.full_setup.task_windows
    release, offsets = level.shared[side], level.shared[side].offsets
    assert release.sigma is not None  # `share` refuses a release without
    windows: Windows = getattr(task_windows, SIDES[side])
    # The full windows: these do not depend on which samples were shared.
    duration_s, speed_mps = _durations_and_speeds(windows)
    attacked_xy, claimed_std = smoothed.releases[side].xy, smoothed.claimed_std[side]
    if claimed_std is None:
        claimed_std = np.full(release.t.size, np.nan)
    true_xy = getattr(setup.task_windows, SIDES[side]).xy
    walked_xy = true_walks(level, side)
    as_shared = descriptors(release, truth=true_xy, settings=setup.privacy)
    rebuilt = derived(release, xy=attacked_xy)
    attacked = descriptors(rebuilt, truth=walked_xy, settings=setup.privacy)
    columns = (
        [SIDES[side]] * len(windows),
        names_column(windows.search, task_windows.search_names),
        names_column(windows.person, task_windows.source),
        names_column(windows.person, task_windows.group),
        np.diff(offsets),
        duration_s,
        speed_mps,
        track_means(release.sigma, offsets),
        *(as_shared[name] for name in DESCRIPTORS),
        *(attacked[name] for name in DESCRIPTORS),
        privacy.alignment_error(xy=attacked_xy, truth=walked_xy, offsets=offsets),
        track_means(claimed_std, offsets),
    )
    return table(dict(zip(WINDOW_COLUMNS, columns, strict=True)))


def _durations_and_speeds(windows: Windows) -> tuple[Floats, Floats]:
    """Return the duration of each window, s, and the speed of its walk, m/s."""
    step_m = np.zeros(windows.t.size)
    step_m[1:] = lengths(np.diff(windows.xy, axis=0))
    step_m[windows.offsets[:-1]] = 0.0  # between windows
    duration_s = windows.t[windows.offsets[1:] - 1] - windows.t[windows.offsets[:-1]]
    path_m = np.add.reduceat(step_m, windows.offsets[:-1])
    speed_mps = np.full(duration_s.size, np.nan)
    np.divide(path_m, duration_s, out=speed_mps, where=duration_s > 0)
    return duration_s, speed_mps
