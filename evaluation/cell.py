"""What one cell computes: a block of scenes, one mechanism level, one consumer.

A level is shared once; every consumer of the block reads the same release.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from isac_track import privacy
from isac_track.conflict import is_conflict
from isac_track.encounter import conflict_probability
from isac_track.errors import PluginError, SettingsError
from isac_track.rng import stream
from isac_track.scenes import make_scenes, predicted_separation, robot_positions
from isac_track.sensing import draw_channel, sense
from isac_track.types import Knowledge, Prediction, Release

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isac_track.config import StageSettings
    from isac_track.registry import Plugin
    from isac_track.scenes import Cut
    from isac_track.types import Floats, Ints, Scenes, Sensed

SHARED = "shared"
"""Consumer of the descriptors as shared."""

Rows: TypeAlias = dict[str, np.ndarray[Any, np.dtype[Any]]]


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """Work of one block of scenes: which levels, and which of their consumers are missing."""

    number: int
    first_scene: int
    order: Ints
    """(S, A) rows of the tracks."""
    levels: tuple[tuple[Plugin, tuple[Plugin | None, ...]], ...]
    """Mechanism and its consumers; None stands for the descriptors as shared."""


def compute_block(
    block: Block, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[tuple[Plugin, Plugin | None, Rows]]:
    """Yield the rows of every cell of a block.

    Rows of `shared` are per track (scene, agent), those of a predictor per scene; `track` is
    the row in `tracks` (of the first agent, for a scene).

    Raises
    ------
    PluginError
        If a plug-in raises or breaks its contract; the message names it.
    """
    scenes = make_scenes(
        tracks, order=block.order, first=block.first_scene, settings=stages, seed=seed
    )
    sensed = sense_scenes(scenes, stages=stages, seed=seed)
    for mechanism, consumers in block.levels:
        release = _share(mechanism, sensed, block=block.number, seed=seed)
        for consumer in consumers:
            if consumer is None:
                rows = _descriptors(release, scenes, stages=stages)
            else:
                rows = _forecast(consumer, release, scenes, stages=stages)
            yield mechanism, consumer, rows


def sense_scenes(scenes: Scenes, *, stages: StageSettings, seed: int) -> Sensed:
    """Return what the network senses of the histories; every scene draws from its own stream."""
    channel = draw_channel(
        n_samples=np.diff(scenes.offsets).reshape(len(scenes), -1),
        keys=[("scene", int(index)) for index in scenes.index],
        settings=stages.sensing,
        seed=seed,
    )
    return sense(
        t=scenes.t,
        xy=scenes.xy,
        offsets=scenes.offsets,
        channel=channel,
        settings=stages.sensing,
    )


def _share(mechanism: Plugin, sensed: Sensed, *, block: int, seed: int) -> Release:
    # Every mechanism gets the same stream: common random numbers.
    rng = stream(seed, "sharing", "block", block)
    try:
        release = mechanism.instance.share(sensed, rng)
    except (Exception, SystemExit) as error:  # a plug-in may do anything
        raise PluginError(
            f"mechanism {mechanism.spec!r} failed: {type(error).__name__}: {error}"
        ) from error
    if not isinstance(release, Release):
        raise PluginError(
            f"mechanism {mechanism.spec!r} must return a Release, got {type(release).__name__}"
        )
    if not (
        np.array_equal(release.offsets, sensed.offsets) and np.array_equal(release.t, sensed.t)
    ):
        raise PluginError(f"mechanism {mechanism.spec!r} changed the tracks or their times")
    if release.sigma is not None and not (release.sigma >= 0).all():
        raise PluginError(f"mechanism {mechanism.spec!r} declared a sigma below 0 or NaN")
    # Fresh for every release: the common stream gives every mechanism the same ones.
    names = stream(seed, "pseudonyms", mechanism.spec, "block", block).bytes(8 * len(release))
    fresh = tuple(names[8 * row : 8 * row + 8].hex() for row in range(len(release)))
    return replace(release, pseudonym=fresh)


def _descriptors(release: Release, scenes: Scenes, *, stages: StageSettings) -> Rows:
    leaked = privacy.leakage_indicator(
        shared_xy=release.xy, true_xy=scenes.xy, epsilon_m=stages.privacy.epsilon_m
    )
    exposure = privacy.exposure(leaked=leaked, t=scenes.t, offsets=scenes.offsets)
    squared_m2 = ((release.xy - scenes.xy) ** 2).sum(axis=1)
    n_samples = np.diff(scenes.offsets)
    return {
        "scene": np.repeat(scenes.index, scenes.n_agents),
        "agent": np.tile(np.arange(scenes.n_agents), len(scenes)),
        "track": scenes.track,
        "n_samples": n_samples,
        "plr": exposure.plr,
        "ael_s": exposure.ael_s,
        "mel_s": exposure.mel_s,
        "segments": exposure.segments,
        "mse_m2": np.add.reduceat(squared_m2, scenes.offsets[:-1]) / n_samples,
    }


def _forecast(
    predictor: Plugin, release: Release, scenes: Scenes, *, stages: StageSettings
) -> Rows:
    granted = release
    if Knowledge.SIGMA not in predictor.instance.requires:
        granted = release.without_sigma()
    try:
        prediction = predictor.instance.predict(granted, scenes.t_future)
    except (Exception, SystemExit) as error:  # a plug-in may do anything
        raise PluginError(
            f"predictor {predictor.spec!r} failed: {type(error).__name__}: {error}"
        ) from error
    expected = scenes.xy_future.shape
    if not isinstance(prediction, Prediction) or prediction.mean.shape != expected:
        raise PluginError(
            f"predictor {predictor.spec!r} must return a Prediction with mean {expected}"
        )
    separation_m = predicted_separation(scenes, mean=prediction.mean, settings=stages.conflict)
    probability = _probability(prediction, scenes, stages=stages)
    if stages.conflict.decision == "mean":
        predicted = is_conflict(
            separation_m=separation_m, safety_radius_m=stages.conflict.safety_radius_m
        )
    elif prediction.cov is not None:
        predicted = probability >= stages.conflict.probability_threshold
    else:
        raise SettingsError(
            f"predictor {predictor.spec!r} has no covariance, which "
            "conflict.decision=probability needs; leave it out or decide by the mean"
        )
    return {
        "scene": scenes.index,
        "track": scenes.track[:: scenes.n_agents],
        "exhausted": scenes.exhausted,
        "conflict": scenes.conflict,
        "predicted": predicted,
        "separation_m": scenes.separation,
        "predicted_separation_m": separation_m,
        "probability": probability,
    }


def _probability(prediction: Prediction, scenes: Scenes, *, stages: StageSettings) -> Floats:
    """Return the probability of a conflict in each scene; NaN without a covariance."""
    if prediction.cov is None:
        return np.full(len(scenes), np.nan)
    robot = robot_positions(scenes, settings=stages.conflict)
    return conflict_probability(
        robot=robot,
        mean=prediction.mean.reshape(robot.shape),
        cov=prediction.cov.reshape(*robot.shape, 2),
        radius_m=stages.conflict.safety_radius_m,
    )
