"""Choose the trackers' process noise by likelihood: `python -m benchmarks.tune`.

The defaults come from the bundled crowd alone, and from shared histories alone, never
from the hidden futures. No recording was fitted, but the crowd's own constants were set
by hand until its statistics agreed with those of Students03. Other recordings are shown
beside it for comparison.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from scipy.optimize import minimize

from isac_track import datasets, plugins
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.config import StageSettings
from isac_track.errors import DataError, SettingsError
from isac_track.rng import stream
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes
from predictors.kalman import KalmanCA, KalmanCV, KalmanIMM

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from isac_track.types import Release

Tracker: TypeAlias = KalmanCV | KalmanCA | KalmanIMM
LEVELS = ("raw", "fixed:0.7,adding=independent", "fid:1000,adding=independent")
"""Likely releases for a robot; the tracker estimates the noise of each."""
TUNED: dict[str, tuple[Tracker, tuple[str, ...]]] = {
    "kalman_cv": (KalmanCV(), ("q",)),
    "kalman_ca": (KalmanCA(), ("q",)),
    "kalman_imm": (KalmanIMM(), ("q", "q_turn")),
}
LEAST_Q = 1e-3
"""Bound on every q, as the likelihood of the walking mode rises towards q = 0."""
_WHOLE_HISTORY = 10**9


def releases(dataset: str, *, n_scenes: int, seed: int) -> tuple[Release, ...]:
    """Return the shared histories of a data set's scenes, one release a level.

    Raises
    ------
    DataError
        If the data set is not here or its tracks are too short.
    """
    stages = StageSettings()
    tracks = cut(
        datasets.load(dataset, download=False).tracks, settings=stages, seed=seed
    )
    order = track_order(n_tracks=len(tracks), n_scenes=n_scenes, agents=4, seed=seed)
    scenes = make_scenes(tracks, order=order, first=0, settings=stages, seed=seed)
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed)
    return tuple(
        mechanism.instance.share(sensed, stream(seed, "tune")).without_sigma()
        for mechanism in plugins.parse_all("mechanisms", LEVELS)
    )


def tune(
    tracker: Tracker, names: tuple[str, ...], *, shared: tuple[Release, ...]
) -> Tracker:
    """Return the tracker with the parameters of the largest likelihood, to two digits.

    The gate is open: a likelihood of only the samples within the gate would reward a
    narrow gate. The whole history counts.
    """
    start = replace(tracker, gate=float("inf"), window=_WHOLE_HISTORY)

    def loss(logarithms: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
        bounded = np.maximum(np.exp(logarithms), LEAST_Q)
        values: dict[str, Any] = dict(zip(names, bounded.tolist(), strict=True))
        trial = replace(start, **values)
        return -float(sum(trial.log_likelihood(release).sum() for release in shared))

    first = np.log([getattr(tracker, name) for name in names])
    result = minimize(
        loss, first, method="Nelder-Mead", options={"xatol": 5e-3, "fatol": 0.5}
    )
    bounded = np.maximum(np.exp(result.x), LEAST_Q).tolist()
    best: dict[str, Any] = {
        name: float(f"{value:.2g}") for name, value in zip(names, bounded, strict=True)
    }
    return replace(tracker, **best)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = Parser(
        prog="python -m benchmarks.tune",
        description=(
            "Choose the trackers' process noise by likelihood on shared histories."
        ),
    )
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    return exit_code(lambda: _run(parser.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    if options.scenes < 1 or options.seed < 0:
        raise SettingsError("--scenes must be at least 1 and --seed not negative")
    _show(n_scenes=options.scenes, seed=options.seed)
    return DONE


def _show(*, n_scenes: int, seed: int) -> None:
    print(f"{'tracker':<11} {'parameter':<10} {'default':>8}  largest likelihood on")
    names = ("plaza", "zara01", "students03")
    print(
        f"{'':<31}  {names[0]:>10} (the default), for comparison {', '.join(names[1:])}"
    )
    tuned: dict[str, dict[str, Tracker]] = {}
    for dataset in names:
        try:
            shared = releases(dataset, n_scenes=n_scenes, seed=seed)
        except DataError as error:
            print(f"{dataset} is left out: {error}", file=sys.stderr)
            continue
        tuned[dataset] = {
            name: tune(tracker, parameters, shared=shared)
            for name, (tracker, parameters) in TUNED.items()
        }
    for name, (tracker, parameters) in TUNED.items():
        for parameter in parameters:
            values = [
                (
                    f"{getattr(tuned[dataset][name], parameter):>10g}"
                    if dataset in tuned
                    else ""
                )
                for dataset in names
            ]
            default = getattr(tracker, parameter)
            print(f"{name:<11} {parameter:<10} {default:>8g}  {' '.join(values)}")


if __name__ == "__main__":
    sys.exit(main())
