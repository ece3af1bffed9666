"""The project's own pedestrian crowd: a generator, and two bundled sessions.

``plaza.npz`` and ``plaza_session2.npz`` are the output of ``python -m
isac_track.datasets.crowd --out DIR``. ``docs/explanation/plaza.md`` describes the
model, how it was tuned and what it must not be used for. The same settings, seed and
session give the same millimetres, very likely on any machine: the state is rounded in
every step (`model.GRID_DIGITS`).
"""

import json
from pathlib import Path

import numpy as np

from isac_track.datasets.crowd.model import simulate
from isac_track.datasets.crowd.plan import (
    CrowdSettings,
    draw_traits,
    person_id,
    plan_session,
)
from isac_track.types import Tracks

__all__ = ["BUNDLED_SEED", "FILES", "CrowdSettings", "bundled_path", "generate"]

BUNDLED_SEED = 1
# File of each bundled session, in the folder above.
FILES = {1: "plaza.npz", 2: "plaza_session2.npz"}


def generate(settings: CrowdSettings, *, seed: int, session: int = 1) -> Tracks:
    """Simulate one session of the crowd, numbered from 1.

    The same seed gives the same people with the same traits in every session, on new
    routes, at other times, in other company. Each person has one walk, in whole
    millimetres at multiples of ``settings.frame_s`` seconds. `source` is the person's
    lasting id (``p0001``), `group` the party in this session (``s1g001``).
    """
    traits = draw_traits(settings, seed=seed)
    plan = plan_session(settings, traits, seed=seed, session=session)
    recorded = simulate(plan, seed=seed, session=session)
    order = np.lexsort((recorded.frame, recorded.person))
    rows, first = np.unique(recorded.person[order], return_index=True)
    party_numbers = {
        row: number
        for number, party in enumerate(plan.parties, 1)
        for row in party.members
    }
    return Tracks(
        t=recorded.frame[order].astype(np.float64) * settings.frame_s,
        xy=np.rint(recorded.xy[order] * 1e3) / 1e3,
        offsets=np.append(first, order.size),
        source=tuple(person_id(row) for row in rows),
        group=tuple(f"s{session}g{party_numbers[row]:03d}" for row in rows),
    )


def bundled_path(session: int) -> Path:
    """Return the file of a bundled session of the plaza, 1 or 2."""
    return Path(__file__).parents[1] / FILES[session]


def write_npz(
    path: Path, tracks: Tracks, *, frame_s: float, about: dict[str, object]
) -> None:
    """Write tracks with a sample every `frame_s`, as whole millimetres in int16.

    `about` describes the origin of the tracks; the file keeps it as JSON.
    """
    frame = np.rint(tracks.t / frame_s)
    xy_mm = np.rint(tracks.xy * 1e3).astype(np.int16)
    # Steps compress better than positions. They may wrap around; the sum in read_npz
    # wraps back.
    steps = np.diff(xy_mm, axis=0, prepend=np.zeros((1, 2), dtype=np.int16))
    np.savez_compressed(
        path,
        format=np.int64(1),
        frame_s=np.float64(frame_s),
        first_frame=frame[tracks.offsets[:-1]].astype(np.int32),
        samples=np.diff(tracks.offsets).astype(np.int32),
        steps_mm=np.ascontiguousarray(steps.T),
        source=np.array(tracks.source),
        group=np.array(tracks.group),
        about=np.array(json.dumps(about, sort_keys=True)),
    )


def read_npz(path: Path) -> Tracks:
    """Read what `write_npz` wrote."""
    with np.load(path, allow_pickle=False) as file:
        samples = file["samples"].astype(np.int64)
        offsets = np.concatenate([[0], np.cumsum(samples)])
        frame = np.arange(offsets[-1]) + np.repeat(
            file["first_frame"] - offsets[:-1], samples
        )
        return Tracks(
            t=frame * float(file["frame_s"]),
            xy=np.cumsum(file["steps_mm"], axis=1, dtype=np.int16).T / 1e3,
            offsets=offsets,
            source=tuple(map(str, file["source"])),
            group=tuple(map(str, file["group"])),
        )
