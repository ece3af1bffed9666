"""Recipients of unlabelled detections: each tracks them by a tracker of its own.

A robot has the tracker of the run. An adversary with the same detections may have
another: it takes the strongest that is known. Which is the strongest is learnt on one
half of the recording and scored on the other, so that choosing earns nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.compute.current_cell import note_cell
from evaluation.compute.tables import ROWS
from evaluation.compute.track_rows import FOLLOWED, FOLLOWED_COLUMNS, track_tables
from evaluation.compute.tracking import release_rows
from evaluation.compute.tracking_setup import share_tracked
from isac_track.plugins import parse
from isac_track.tracking.knowledge import TRACK_ESTIMATORS
from isac_track.tracking.methods import REFERENCE_TYPES

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows
    from evaluation.compute.tracking_setup import SeedRelease, TrackingSetup
    from evaluation.plan.consumer import Consumer
    from isac_track.plugins import Plugin
    from isac_track.types import Bools, Ints

ADVERSARY_TRACKERS: Final = ("gnn", "jpda")
"""Trackers that an adversary tries, beside that of the run."""
_KNOWN: Final = tuple(f"known_{estimator}" for estimator in TRACK_ESTIMATORS)
_REJOINED: Final = ("rejoined_share_sum", "rejoined_share_over")


def recipient_rows(
    consumers: Iterable[Consumer],
    releases: list[SeedRelease],
    setup: TrackingSetup,
    *,
    mechanism: Plugin,
) -> Iterator[tuple[Consumer, dict[str, Rows]]]:
    """Yield the recipients of detections, each with the rows of its tables."""
    robots = []
    for consumer in consumers:
        if consumer.plugin is not None:
            robots.append(consumer)
            continue
        assert consumer.track_release is not None
        note_cell(mechanism.spec, consumer.label)
        yield (
            consumer,
            recipient_tables(mechanism, consumer.track_release, releases, setup),
        )
    yield from release_rows(robots, releases, setup, mechanism=mechanism)


def recipient_tables(
    mechanism: Plugin,
    tracker: Plugin,
    releases: list[SeedRelease],
    setup: TrackingSetup,
) -> dict[str, Rows]:
    """Return the tables of tracks, and what the adversary makes of the same detections.

    Metrics of the tracking field are of the robot's tracker. A reference, such as the
    oracle, is that of the adversary, too. PluginError names a tracker that fails.
    """
    own = track_tables(releases, setup)
    if isinstance(tracker.instance, REFERENCE_TYPES):
        return own
    rivals = [parse("trackers", name)[0] for name in ADVERSARY_TRACKERS]
    others = [
        track_tables(share_tracked(mechanism, rival, setup), setup)
        for rival in rivals
        if rival.name != tracker.name
    ]
    return strongest([own, *others], n_blocks=setup.blocks.n)


def strongest(trackers: list[dict[str, Rows]], *, n_blocks: int) -> dict[str, Rows]:
    """Return the tables of the first tracker, with what the strongest reveals.

    Known places and followed people are chosen apart. In either half of the blocks
    stand the numbers of the tracker that reveals most in the other half.
    """
    own = trackers[0]
    rows, followed = dict(own[ROWS]), dict(own[FOLLOWED])
    late = {
        name: _is_late(table["block"], n_blocks)
        for name, table in ((ROWS, rows), (FOLLOWED, followed))
    }
    for half in (False, True):
        here, there = (
            {name: flags == side for name, flags in late.items()}
            for side in (half, not half)
        )
        known = [
            max(each[ROWS][name][there[ROWS]].sum() for name in _KNOWN)
            for each in trackers
        ]
        best = trackers[int(np.argmax(known))]
        for name in _KNOWN:
            rows[name] = np.where(here[ROWS], best[ROWS][name], rows[name])
        held_s = [
            each[FOLLOWED]["followed_s"][there[FOLLOWED]].sum() for each in trackers
        ]
        best = trackers[int(np.argmax(held_s))]
        for name in _REJOINED:
            rows[name] = np.where(here[ROWS], best[ROWS][name], rows[name])
        for name in FOLLOWED_COLUMNS[2:]:
            followed[name] = np.where(
                here[FOLLOWED], best[FOLLOWED][name], followed[name]
            )
    return {**own, ROWS: rows, FOLLOWED: followed}


def _is_late(block: Ints, n_blocks: int) -> Bools:
    """Return whether a block is in the second half of the recording, (K,)."""
    return np.asarray(2 * block >= n_blocks)
