"""Cost of linkage over the size of the gallery: ``python -m benchmarks.linkage``.

Probes and candidates are 12 s of simulated walks, shared at fid:1 and linked as they
come. The gallery is searched in blocks, so that memory does not grow with it; a
built-in linker scores a pair alike whatever else is in the block, which is checked
first. One thread.
"""

from __future__ import annotations

import argparse
import os
import sys

# Before numpy: the figures are those of one core.
for _library in ("OPENBLAS", "MKL", "OMP"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"

# ruff: noqa: E402 - as said above
import resource
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track import datasets, plugins
from isac_track.config import StageSettings
from isac_track.protocols import AttackContext
from isac_track.resample import sampling_times, walk
from isac_track.rng import stream
from isac_track.sensing import draw_channel, sense, walked_within

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.types import Floats, Ints, Knowledge, Release, Sensed, Tracks


LINKERS = ("shape", "profile", "dtw", "behaviour", "histogram", "kinematic")
WINDOW_S = 12.0
LEVEL = "fid:1"
N_PROBES = 100
BLOCK = 500


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 0."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.linkage", description=__doc__
    )
    parser.add_argument(
        "--sizes",
        type=int,
        nargs="+",
        default=[100, 300, 1000, 3000, 10_000],
        metavar="G",
    )
    sizes = sorted(parser.parse_args(arguments).sizes)
    probe = released(n=N_PROBES, side="probe")
    gallery = released(n=sizes[-1], side="gallery")
    print(
        f"{N_PROBES} probes, blocks of {BLOCK} candidates, {LEVEL}, microseconds a pair"
    )
    print(f"{'linker':<12}{'G':>8}{'us / pair':>12}{'exponent':>10}{'peak MB':>10}")
    for name in LINKERS:
        fitted = fit(name)
        check_blocks(fitted, probe, gallery.tracks(np.arange(sizes[0])))
        times = []
        for size in sizes:
            seconds = search_s(fitted, probe, gallery.tracks(np.arange(size)))
            times.append(seconds)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            each_us = 1e6 * seconds / (N_PROBES * size)
            print(f"{name:<12}{size:>8}{each_us:>12.2f}{'':>10}{peak:>10.0f}")
        if len(sizes) > 1:
            exponent = np.polyfit(np.log(sizes), np.log(times), 1)[0]
            print(f"{name:<12}{'all':>8}{'':>12}{exponent:>10.2f}")
    print(f"load at the end {os.getloadavg()[0]:.1f}", file=sys.stderr)
    return 0


def fit(name: str) -> Any:  # noqa: ANN401 - from two releases to scores
    """Return a blind linker, ready."""
    (plugin,) = plugins.parse("attacks", name)
    granted: frozenset[Knowledge] = plugin.instance.requires
    context = AttackContext(rng=stream(0, "benchmark"), epsilon_m=0.3, granted=granted)
    return plugin.instance.fit(context)


def search_s(fitted: Any, probe: Release, gallery: Release) -> float:  # noqa: ANN401 - a fitted attack
    """Return the time of the search for the best candidate of every probe, s."""
    started = perf_counter()
    best = np.full(len(probe), -np.inf)
    candidate = np.full(len(probe), -1)
    for rows, scores in blocks(fitted, probe, gallery):
        column = scores.argmax(axis=1)
        block_best = scores[np.arange(len(probe)), column]
        candidate = np.where(block_best > best, rows[column], candidate)
        best = np.maximum(block_best, best)
    assert (candidate >= 0).all()
    return perf_counter() - started


def blocks(fitted: Any, probe: Release, gallery: Release) -> Any:  # noqa: ANN401 - a fitted attack
    """Yield the rows of each block of the gallery, and the scores, (P, B)."""
    for first in range(0, len(gallery), BLOCK):
        rows = np.arange(first, min(first + BLOCK, len(gallery)))
        yield rows, fitted(probe, gallery.tracks(rows))


def check_blocks(fitted: Any, probe: Release, gallery: Release) -> None:  # noqa: ANN401 - a fitted attack
    """Assert that a block's scores are those of the whole gallery."""
    all_scores = fitted(probe, gallery)
    half = np.arange(len(gallery) // 2)
    spread = float(all_scores.std()) or 1.0
    half_scores = fitted(probe, gallery.tracks(half))
    assert np.allclose(half_scores, all_scores[:, half], atol=1e-6 * spread)


def released(*, n: int, side: str) -> Release:
    """Return the release of n windows of simulated walks; people may repeat."""
    rng = stream(0, "benchmark", side)
    tracks = datasets.load("plaza").tracks
    start_s = tracks.t[tracks.offsets[:-1]]
    end_s = tracks.t[tracks.offsets[1:] - 1] - WINDOW_S
    rows = rng.choice(np.flatnonzero(end_s >= start_s), n)
    (mechanism,) = plugins.parse("mechanisms", LEVEL)
    starts_s = rng.uniform(start_s[rows], end_s[rows])
    windows_sensed = sensed(tracks, rows, starts_s, side=side)
    release: Release = mechanism.instance.share(windows_sensed, rng)
    return release.without_sigma()


def windows(*, n: int) -> tuple[Sensed, Sensed]:
    """Return the first and the last window of n simulated people, as sensed."""
    tracks = datasets.load("plaza").tracks
    start_s = tracks.t[tracks.offsets[:-1]]
    end_s = tracks.t[tracks.offsets[1:] - 1] - WINDOW_S
    rows = np.flatnonzero(end_s >= start_s + WINDOW_S)[:n]
    first = sensed(tracks, rows, start_s[rows], side="first")
    last = sensed(tracks, rows, end_s[rows], side="last")
    return first, last


def sensed(tracks: Tracks, rows: Ints, start_s: Floats, *, side: str) -> Sensed:
    """Return the windows of some tracks from `start_s` on, as sensed."""
    stages, rng = StageSettings(), stream(0, "benchmark", side, "times")
    t_parts = [
        sampling_times(
            start_s=begin_s,
            end_s=begin_s + WINDOW_S,
            settings=stages.resample,
            rng=rng,
        )
        for begin_s in start_s
    ]
    xy_parts = [walk(tracks[int(row)])(t) for row, t in zip(rows, t_parts, strict=True)]
    sizes = np.array([[part.size for part in t_parts]])
    xy, offsets = np.concatenate(xy_parts), np.concatenate([[0], np.cumsum(sizes[0])])
    channel = draw_channel(
        walked_m=walked_within(xy, offsets),
        n_samples=sizes,
        keys=[("benchmark", side)],
        settings=stages.sensing,
        seed=0,
    )
    return sense(
        t=np.concatenate(t_parts),
        xy=xy,
        offsets=offsets,
        channel=channel,
        settings=stages.sensing,
    )


if __name__ == "__main__":
    raise SystemExit(main())
