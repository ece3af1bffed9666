"""What an attack of your own may build on: stable names, as `isac_track.types` has.

Reconstruction: `choose` and `make_smoother` learn parameters from the training set,
`learn_variance` and `noise_m2` estimate how large errors are, and `looks_radial` tells
their law. Linkage: `mated_rows` and `select_pairs` take a training set apart, and
`features` describes walks. `make_attack` returns another attack, to begin with or to
combine. `memoised` and `memoised_by_track` compute once what several attacks or
adversaries ask of a release. Model walks: `Motion`, `simulate_walks`, `scale_m2`.

The filters and smoothers are in `isac_track.kalman`. `examples/attacks` is a package of
attacks that are made of these names alone.
"""

from typing import Any

from attacks.linkage.behaviour import FEATURES, features
from attacks.linkage.learning import LEAST_MATES, mated_rows, select_pairs
from attacks.reconstruction.kalman_rts import looks_radial
from attacks.reconstruction.learning import (
    COMMON_KNOWLEDGE,
    choose,
    learn_variance,
    make_smoother,
)
from attacks.remembered import memoised, memoised_by_track, noise_m2, select_tracks
from isac_track import plugins
from isac_track.errors import SettingsError
from isac_track.kalman.slow_errors import added_error
from isac_track.mechanisms.protections import Laplace
from isac_track.model_world import Motion, scale_m2, simulate_walks

__all__ = ["COMMON_KNOWLEDGE", "FEATURES", "LEAST_MATES", "Laplace", "Motion"]
__all__ += ["added_error", "choose", "features", "learn_variance", "looks_radial"]
__all__ += ["make_attack", "make_smoother", "mated_rows", "memoised"]
__all__ += ["memoised_by_track", "noise_m2", "scale_m2", "select_pairs"]
__all__ += ["select_tracks", "simulate_walks"]


def make_attack(spec: str) -> Any:  # noqa: ANN401 - of either kind, maybe a stranger's
    """Return the attack of a SPEC, built in or installed.

    SettingsError if it names none, or more than one.

    Examples
    --------
    >>> from attacks.building_blocks import make_attack
    >>> make_attack("kalman_rts:q=0.1")
    KalmanRTS(q=0.1)
    """
    made = plugins.parse("attacks", spec)
    if len(made) > 1:
        raise SettingsError(f"{spec!r} names {len(made)} attacks; name one of them")
    return made[0].instance
