"""Recordings as files, and settings, for runs that take seconds."""

import hashlib
from contextlib import contextmanager

import numpy as np
import pytest
from helpers.recordings import build_tracks, write_csv

from evaluation.plan.settings import Settings
from evaluation.pool.workers import spread
from isac_track.config import StageSettings
from isac_track.rng import stream
from isac_track.scenes import cut


def smoke(dataset, out=None, *, scenes=12, **changes):
    """Settings of a run of one process, one predictor and horizon, without attacks."""
    usual = {
        "mechanisms": ("raw", "fixed:0.7"),
        "predictors": ("least_squares",),
        "jobs": 1,
    }
    usual |= {"attacks": (), "tasks": ()}
    if not isinstance(changes.get("stages"), StageSettings):
        own_horizon = {"conflict.horizons_s": ()}
        changes["stages"] = own_horizon | changes.get("stages", {})
    usual |= changes
    return Settings(
        preset="smoke", dataset=str(dataset), scenes=scenes, out=out, **usual
    )


@contextmanager
def single_process():
    """All is computed here, users' plug-ins too: a worker takes seconds to start."""

    def here(function, works, **_):
        return spread(function, works, jobs=1, limit_s=None)

    with pytest.MonkeyPatch.context() as patch:
        for name in ("missing_cells", "sample_tracks", "plugin_calls"):
            patch.setattr(f"evaluation.pool.{name}.spread", here)
        patch.setattr("evaluation.matrix._n_workers", lambda _: 0)
        yield


@contextmanager
def without_pictures():
    """Runs draw no pictures: they take most of the time of a small one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evaluation.api.run_results._draw", lambda *_, **__: None)
        yield


@contextmanager
def cut_once():
    """Plans of one recording, settings and seed share its cut tracks: a second each."""
    known = {}

    def cut_or_recalled(tracks, *, settings, seed):
        content = hashlib.sha256(tracks.xy.tobytes() + tracks.t.tobytes()).digest()
        key = content, settings, seed
        if key not in known:
            known[key] = cut(tracks, settings=settings, seed=seed)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evaluation.plan.fitted_data.cut", cut_or_recalled)
        yield


def write_walks(path, *, n_people=30, seed=0):
    """Write smooth walks, everybody at a pace of their own; a third lasts but 26 s."""
    walks = []
    for person in range(n_people):
        t = np.arange(0.0, 26.0 if person % 3 == 0 else 32.0, 0.4)
        rng = stream(seed, "test", "walk", person)
        turn = 0.08 * rng.standard_normal(t.size).cumsum() + rng.uniform(0, 2 * np.pi)
        steps = (
            0.4 * rng.uniform(0.4, 1.4) * np.column_stack([np.cos(turn), np.sin(turn)])
        )
        walks.append(rng.uniform(-3, 3, 2) + steps.cumsum(axis=0))
    return write_csv(path, build_tracks(*walks))
