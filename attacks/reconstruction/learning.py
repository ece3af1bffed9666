"""Hyper-parameters from other people: what an adversary with a training set does first."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from attacks.reconstruction.noise import learn_variance
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from isac_track.protocols import AttackContext
    from isac_track.types import Floats, Ints, Reconstruction, Release

_Choice = TypeVar("_Choice")
_POWERS = (-1.0, 0.0, 1.0)
N_CANDIDATES = len(_POWERS)
"""What a built-in attack tries before it attacks."""


def around(default: float, *, factor: float) -> tuple[float, ...]:
    """Return ``default / factor``, the default and ``default * factor``.

    Every attack that learns a number tries these: no recording had a say in the grid.
    """
    return tuple(default * factor**power for power in _POWERS)


def choose(
    context: AttackContext,
    *,
    default: _Choice,
    candidates: Sequence[_Choice],
    reconstruct: Callable[[_Choice, Release], Floats],
) -> _Choice:
    """Return the candidate that reconstructs the training set best; without one the default.

    Of equals the first is taken.

    Parameters
    ----------
    context : AttackContext
    default : object
        What a blind adversary uses: tuned on the bundled crowd, which is nobody's recording.
    candidates : sequence of objects
    reconstruct : callable
        From a candidate and a release to positions, (M, 2) m.
    """
    if Knowledge.TRAIN not in context.granted:
        return default
    release, truth = context.train.release, context.train.truth
    losses = [
        exposure_loss(
            xy=reconstruct(candidate, release),
            truth=truth,
            offsets=release.offsets,
            epsilon_m=context.epsilon_m,
        )
        for candidate in candidates
    ]
    return candidates[int(np.argmin(losses))]


def smoother(
    context: AttackContext,
    smooth: Callable[[Release, Floats, _Choice], Reconstruction],
    *,
    given: _Choice | None,
    candidates: Sequence[_Choice],
    tried: Callable[[Release, Floats, _Choice], Reconstruction] | None = None,
) -> Callable[[Release], Reconstruction]:
    """Return what smooths releases like those in the training set, by the noise of each sample.

    Parameters
    ----------
    context : AttackContext
    smooth : callable
        From a release, the error variance per axis, (M,) m^2, and a choice.
    given : object or None
        The choice; None: learnt.
    candidates : sequence of objects
        The default in the middle, as from `around`.
    tried : callable, optional
        In place of `smooth` where candidates are compared.
    """
    variance = learn_variance(context)
    if given is not None:
        return lambda release: smooth(release, variance(release), given)
    attempt = smooth if tried is None else tried
    known = variance(context.train.release) if Knowledge.TRAIN in context.granted else None
    choice = choose(
        context,
        default=candidates[len(candidates) // 2],
        candidates=candidates,
        reconstruct=lambda candidate, release: attempt(release, known, candidate).xy,
    )
    return lambda release: smooth(release, variance(release), choice)


def exposure_loss(*, xy: Floats, truth: Floats, offsets: Ints, epsilon_m: float) -> float:
    """Return a smooth stand-in for 1 - PLR: the mean of d^2 / (d^2 + epsilon^2).

    The mean is over the samples of a track, then over tracks, as for PLR. One person with
    hopeless errors does not outweigh all others, as in a mean square.

    Parameters
    ----------
    xy, truth : (M, 2) m
    offsets : (N + 1,) int
    epsilon_m : float
    """
    gap = xy - truth
    square = gap[:, 0] ** 2 + gap[:, 1] ** 2
    share = np.add.reduceat(square / (square + epsilon_m**2), offsets[:-1]) / np.diff(offsets)
    return float(share.mean())
