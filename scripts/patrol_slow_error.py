"""What a smoother that models a slow error knows: `python scripts/patrol_slow_error.py`.

The estimators of `known_share` take errors for white. Under `everything` with `ou` this
script puts the slow error into the state of the smoother, as `ou_rts` does, with the
parameters of the mechanism: the adversary knows it (Kerckhoffs).
"""

import argparse
import sys
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from isac_track import datasets
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.config import StageSettings
from isac_track.kalman import Batch
from isac_track.kalman.slow_errors import SlowError, smooth_tracks
from isac_track.mechanisms.protections import Ou
from isac_track.noise import MIN_VARIANCE_M2
from isac_track.patrols import make_patrol
from isac_track.patrols.network import Network, share_patrol
from isac_track.patrols.reports import released_reports
from isac_track.place import placed
from predictors.kalman import KalmanCV

_Q: Final = 0.04  # m^2/s^3, of people's acceleration.
_PRIOR_STD: Final = (100.0, 10.0)  # m and m/s, more than in any walk.
Array = np.ndarray[Any, np.dtype[Any]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/patrol_slow_error.py",
        description="What a smoother that models a slow error knows on patrols.",
    )
    command.add_argument("--dataset", metavar="NAME|PATH", default="students03")
    command.add_argument("--std", metavar="M", type=float, default=0.4)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    settings = StageSettings()
    tracks = placed(datasets.load(options.dataset).tracks, settings=settings)
    mechanism = Ou(options.std)
    network = share_patrol(
        make_patrol(tracks, settings=settings, seed=0),
        mechanism=mechanism,
        forecaster=KalmanCV(),
        settings=settings,
        seed=0,
    )
    slow = SlowError(mechanism.std_m, mechanism.tau_s)
    for name, error in (("white", SlowError(0.0, 0.0)), ("slow", slow)):
        share = known_with(network, error, epsilon_m=settings.privacy.epsilon_m)
        print(f"everything, ou:{options.std:g}, {name} error: {100 * share:.1f} %")
    return DONE


def known_with(network: Network, error: SlowError, *, epsilon_m: float) -> float:
    """Return the share of grid instants that a smoother with this error knows."""
    people, grid = network.patrol.people, network.patrol.grid
    declared_m2 = released_reports(network).variance
    rest = declared_m2 - float(np.asarray(error.std_m)) ** 2
    batch = Batch(
        t=people.t,
        xy=network.release.xy,
        variance=np.maximum(rest, MIN_VARIANCE_M2),
        offsets=people.offsets,
        prior_std=_PRIOR_STD,
    )
    smoothed, _ = smooth_tracks(batch, error, q=_Q)
    hits = 0
    for number in range(len(grid)):
        ours = slice(people.offsets[number], people.offsets[number + 1])
        rows = slice(grid.offsets[number], grid.offsets[number + 1])
        estimates = [
            np.interp(grid.t[rows], people.t[ours], smoothed[ours, axis])
            for axis in (0, 1)
        ]
        gap = np.stack(estimates, axis=1) - grid.xy[rows]
        hits += int((np.hypot(*gap.T) < epsilon_m).sum())
    return hits / grid.t.size


if __name__ == "__main__":
    sys.exit(main())
