"""What one cell computes: a block of scenes, one mechanism level, one consumer.

A level is shared once; every consumer of the block reads the same release.
"""

from __future__ import annotations

import traceback
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from evaluation.cells.left_out import kept, reduced
from evaluation.cells.link_file import to_parquet
from evaluation.cells.link_scores import Linked
from evaluation.cells.link_setup import ground as link_ground
from evaluation.cells.linkage import link_level
from evaluation.cells.plugin_calls import copied, guarded
from evaluation.cells.progress import Failed, note, noted
from evaluation.cells.reconstruction import (
    attack_rows,
    descriptors,
    ground,
    ground_without,
    level,
    track_columns,
)
from evaluation.cells.windows import to_parquet as windows_to_parquet
from isac_track.conflict import is_conflict
from isac_track.encounter import conflict_probability
from isac_track.errors import IsacTrackError, PluginError, SettingsError, told
from isac_track.rng import stream
from isac_track.scenes import make_scenes, predicted_separation, robot_positions
from isac_track.sensing import sense_scenes
from isac_track.types import SHARED_LIMIT_M, Knowledge, Prediction, Release, within

if TYPE_CHECKING:
    from collections.abc import Iterator

    from attacks.tasks.sessions import Sessions
    from evaluation.cells.reconstruction import Rows
    from evaluation.experiment.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut
    from isac_track.types import Floats, Ints, Scenes, Sensed


_OURS = ("isac_track", "predictors", "attacks", "evaluation")

Item: TypeAlias = "tuple[int, Plugin, Consumer, Rows | bytes]"
"""A finished cell: its block, mechanism, consumer, and rows or file."""


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """Work of one block of scenes: which levels, and which of their consumers are missing."""

    number: int
    first_scene: int
    order: Ints
    """(S, A) rows of the tracks."""
    levels: tuple[tuple[Plugin, tuple[Consumer, ...]], ...]
    """Mechanism and its consumers."""


@dataclass(frozen=True, eq=False, slots=True)
class LinkWork:
    """Work of one linkage task: which levels, and which of their consumers are missing."""

    sessions: Sessions
    groups: tuple[str, ...]
    """Clusters of the run's scenes."""
    levels: tuple[tuple[Plugin, tuple[Consumer, ...]], ...]
    """Mechanism and its consumers."""


def cells(
    work: Block | LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item]:
    """Yield every cell of a piece of work: its block, mechanism, consumer, and rows or file.

    Raises
    ------
    PluginError
        If a plug-in raises or breaks its contract; the message names it.
    """
    if isinstance(work, LinkWork):
        for mechanism, consumer, content in compute_links(work, stages=stages, seed=seed):
            yield 0, mechanism, consumer, content
        return
    for mechanism, consumer, rows in compute_block(work, tracks=tracks, stages=stages, seed=seed):
        yield work.number, mechanism, consumer, rows


def attempt(
    work: Block | LinkWork, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[Item | Failed]:
    """Yield `cells` until something fails, and then that (for workers, too).

    A fault of our own fails by name as a plug-in's does: what an odd plug-in brings to light in one
    cell takes no others along.

    Raises
    ------
    IsacTrackError
        For what fails all cells alike: data or settings that do not fit.
    """
    try:
        yield from cells(work, tracks=tracks, stages=stages, seed=seed)
    except PluginError as error:
        yield Failed(noted(), str(error))
    except IsacTrackError:
        raise
    except Exception as error:  # noqa: BLE001 - nobody knows what else goes wrong
        yield Failed(noted(), f"{told(error)} ({_place(error)})")


def _place(error: Exception) -> str:
    """Return which line of ours an error comes from, and what to do about it."""
    ours = [
        (module, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if (module := frame.f_globals.get("__name__", "")).partition(".")[0] in _OURS
    ]
    module, line = ours[-1]  # the innermost; there is one: `attempt` itself
    return f"in isac-track's own code, {module}, line {line}: please report this"


def compute_links(
    work: LinkWork, *, stages: StageSettings, seed: int
) -> Iterator[tuple[Plugin, Consumer, bytes]]:
    """Yield the file of every linkage cell.

    Raises
    ------
    PluginError
        If a plug-in raises or breaks its contract; the message names it.
    """
    ground = link_ground(work.sessions, groups=work.groups, stages=stages, seed=seed)
    controlled: dict[str, Linked] = {}
    for mechanism, consumers in work.levels:
        note(mechanism.spec, "")
        for consumer, linked in link_level(
            mechanism,
            consumers,
            ground=ground,
            controlled=controlled,
            share=partial(_share, mechanism, seed=seed),
            epsilon_m=stages.privacy.epsilon_m,
            seed=seed,
        ):
            if isinstance(linked, Linked):
                yield mechanism, consumer, to_parquet(linked, work.sessions)
            else:
                yield mechanism, consumer, windows_to_parquet(linked, work.sessions)


def compute_block(
    block: Block, *, tracks: Cut, stages: StageSettings, seed: int
) -> Iterator[tuple[Plugin, Consumer, Rows]]:
    """Yield the rows of every cell of a block.

    Rows of `shared` and of an attack are per track (scene, agent), those of a predictor per
    scene; `track` is the row in `tracks` (of the first agent, for a scene).

    Raises
    ------
    PluginError
        If a plug-in raises or breaks its contract; the message names it.
    """
    scenes = make_scenes(
        tracks, order=block.order, first=block.first_scene, settings=stages, seed=seed
    )
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed)
    attacks = [one for _, consumers in block.levels for one in consumers if one.kind == "attack"]
    attacked = None
    if attacks:
        attacked = ground(
            scenes=scenes,
            sensed=sensed,
            tracks=tracks,
            repeats=any(Knowledge.REPEATS in one.granted for one in attacks),
            stages=stages,
            seed=seed,
        )
    for mechanism, consumers in block.levels:
        note(mechanism.spec, "")
        release = _share(mechanism, sensed, ("block", block.number), seed=seed)
        left = kept(release, sensed)
        known = scenes if left is None else reduced(scenes, left)
        attacked_ground = attacked
        if attacked is not None and left is not None:
            attacked_ground = ground_without(attacked, left)
        attacked_level = None
        for consumer in consumers:
            note(mechanism.spec, consumer.label)
            if consumer.kind == "shared":
                rows = _descriptors(release, known, stages=stages)
            elif consumer.kind == "predictor":
                assert consumer.plugin is not None
                rows = _forecast(consumer.plugin, release, known, stages=stages)
            else:
                assert attacked_ground is not None
                attacked_level = attacked_level or level(
                    mechanism=mechanism,
                    release=release,
                    share=partial(_share, mechanism, seed=seed),
                    ground=attacked_ground,
                    consumers=[one for one in consumers if one.kind == "attack"],
                    stages=stages,
                    seed=seed,
                )
                rows = attack_rows(
                    consumer,
                    level=attacked_level,
                    ground=attacked_ground,
                    epsilon_m=stages.privacy.epsilon_m,
                    seed=seed,
                )
            yield mechanism, consumer, rows


def _share(mechanism: Plugin, sensed: Sensed, key: tuple[str | int, ...], *, seed: int) -> Release:
    # Every mechanism gets the same stream: common random numbers.
    rng = stream(seed, "sharing", *key)
    release = guarded(
        f"mechanism {mechanism.spec!r}", lambda: mechanism.instance.share(copied(sensed), rng)
    )
    if not isinstance(release, Release):
        raise PluginError(
            f"mechanism {mechanism.spec!r} must return a Release, got {type(release).__name__}"
        )
    try:
        kept(release, sensed)
    except ValueError as error:
        raise PluginError(
            f"mechanism {mechanism.spec!r} changed the tracks or their times: {error}"
        ) from None
    _check_shared(release, who=f"mechanism {mechanism.spec!r}")
    # Fresh for every release: the common stream gives every mechanism the same ones.
    names = stream(seed, "pseudonyms", mechanism.spec, *key).bytes(8 * len(release))
    fresh = tuple(names[8 * row : 8 * row + 8].hex() for row in range(len(release)))
    return replace(release, pseudonym=fresh)


def _check_shared(release: Release, *, who: str) -> None:
    """Raise PluginError if what was shared is no number to compute with."""
    if not within(release.xy, -SHARED_LIMIT_M, SHARED_LIMIT_M):
        raise PluginError(
            f"{who} shared a position that is not within {SHARED_LIMIT_M:g} m of the origin"
        )
    if release.sigma is None or within(release.sigma, 0.0, SHARED_LIMIT_M):
        return
    if not (release.sigma >= 0).all():
        raise PluginError(f"{who} declared a sigma below 0 or NaN")
    raise PluginError(f"{who} declared a sigma above {SHARED_LIMIT_M:g} m, the limit")


def _descriptors(release: Release, scenes: Scenes, *, stages: StageSettings) -> Rows:
    return {
        **track_columns(scenes, np.arange(scenes.track.size)),
        **descriptors(
            xy=release.xy,
            truth=scenes.xy,
            t=scenes.t,
            offsets=scenes.offsets,
            epsilon_m=stages.privacy.epsilon_m,
        ),
    }


def _forecast(
    predictor: Plugin, release: Release, scenes: Scenes, *, stages: StageSettings
) -> Rows:
    granted = release
    if Knowledge.SIGMA not in predictor.instance.requires:
        granted = release.without_sigma()
    prediction = guarded(
        f"predictor {predictor.spec!r}",
        lambda: predictor.instance.predict(copied(granted), scenes.t_future.copy()),
    )
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
