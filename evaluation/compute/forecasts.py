"""The section *sharing*: descriptors of shared tracks, and the robots' predictions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.compute.frames import hide_sigma
from evaluation.compute.guards import copy_for_user_plugin, guarded
from evaluation.compute.sharing import track_samples
from evaluation.compute.tables import (
    Rows,
    descriptors,
    net_speeds,
    track_columns,
    track_means,
)
from isac_track.conflict import conflict_probability, is_conflict, minimum_separation
from isac_track.errors import PluginError, SettingsError
from isac_track.privacy import leakage_indicator
from isac_track.protocols import knowing
from isac_track.scenes import robot_positions
from isac_track.types import Floats, Prediction, Reconstruction, Release, Scenes

if TYPE_CHECKING:
    from evaluation.plan.consumer import Consumer
    from isac_track.config import ConflictSettings, StageSettings
    from isac_track.plugins import Plugin

# The first scenes, in which a robot's own estimates are compared with the truth.
LOGGED_SCENES: Final = 500


def sharing_rows(
    consumer: Consumer,
    release: Release,
    scenes: Scenes,
    *,
    mechanism: Plugin,
    stages: StageSettings,
    is_logged: bool = True,
) -> Rows:
    """Return the rows of a consumer: per track as shared, per scene for a predictor.

    `scenes` are those of the release, without the samples that it left out; `mechanism`
    shared it. With `is_logged` a robot's own estimates of the past are compared with
    the truth, too. Raises PluginError if a predictor raises or breaks its contract,
    which names it. Raises SettingsError if conflicts are decided by a probability and a
    predictor has none.
    """
    predictor, conflict = consumer.plugin, stages.conflict
    if predictor is None:
        return {
            **track_columns(scenes, np.arange(scenes.track.size)),
            "speed_mps": net_speeds(scenes),
            **descriptors(release, truth=scenes.xy, settings=stages.privacy),
        }
    name = f"predictor {predictor.spec!r}"
    shown = copy_for_user_plugin(
        hide_sigma(release, predictor.instance.requires), predictor
    )
    robot_predictor = guarded(
        name, lambda: knowing(predictor.instance, mechanism.instance)
    )
    prediction = guarded(
        name, lambda: robot_predictor.predict(shown, scenes.t_future.copy())
    )
    expected = scenes.xy_future.shape
    if not isinstance(prediction, Prediction) or prediction.mean.shape != expected:
        raise PluginError(f"{name} must return a Prediction with mean {expected}")
    if prediction.cov is None and conflict.decision == "probability":
        raise SettingsError(
            f"{name} has no covariance, which conflict.decision=probability needs;"
            " leave it out or decide by the mean"
        )
    plr_robot = np.full(len(scenes), np.nan)
    if is_logged:
        plr_robot = _own_plr(name, robot_predictor, shown, scenes, stages=stages)
    return {
        "scene": scenes.index,
        "track": scenes.track[:: scenes.n_agents],
        "exhausted": scenes.exhausted,
        "conflict": scenes.conflict,
        "inside_now": scenes.inside_now,
        "time_to_conflict_s": scenes.time_to_conflict_s,
        **_decision_rows(prediction, scenes, conflict=conflict),
        "plr_robot": plr_robot,
    }


def _decision_rows(
    prediction: Prediction, scenes: Scenes, *, conflict: ConflictSettings
) -> Rows:
    """Return the columns of a robot's decision in each scene, (S,)."""
    robot = robot_positions(scenes, settings=conflict)
    radius_m = conflict.safety_radius_m
    mean = prediction.mean.reshape(robot.shape)
    separation_m = minimum_separation(robot=robot, agents=mean)
    probability = np.full(len(scenes), np.nan)
    if prediction.cov is not None:
        cov = prediction.cov.reshape(*robot.shape, 2)
        probability = conflict_probability(
            robot=robot, mean=mean, cov=cov, radius_m=radius_m
        )
    predicted = is_conflict(separation_m=separation_m, safety_radius_m=radius_m)
    if conflict.decision == "probability":
        predicted = probability >= conflict.probability_threshold
    return {
        "predicted": predicted,
        "separation_m": scenes.separation,
        "predicted_separation_m": separation_m,
        "probability": probability,
    }


def _own_plr(
    name: str,
    predictor: object,
    release: Release,
    scenes: Scenes,
    *,
    stages: StageSettings,
) -> Floats:
    """Return the PLR of the robot's own estimates of each scene's first agent, (S,).

    That is the share of the samples whose place the robot knew by then. NaN after the
    first `LOGGED_SCENES`, and for a predictor that has no ``track``. The first agent
    alone: a scene's cluster is that of its first agent. Raises PluginError as
    `sharing_rows` does.
    """
    plr = np.full(len(scenes), np.nan)
    logged = np.flatnonzero(scenes.index < LOGGED_SCENES)
    track = getattr(predictor, "track", None)
    if track is None or not logged.size:
        return plr
    rows = logged * scenes.n_agents
    first, samples = release.tracks(rows), track_samples(scenes.offsets, rows)
    estimate = guarded(name, lambda: Reconstruction(track(first)).xy)
    if estimate.shape != first.xy.shape:
        raise PluginError(
            f"{name} must track positions {first.xy.shape}, got {estimate.shape}"
        )
    truth, epsilon_m = scenes.xy.take(samples.rows, axis=0), stages.privacy.epsilon_m
    leaked = leakage_indicator(shared_xy=estimate, true_xy=truth, epsilon_m=epsilon_m)
    plr[logged] = track_means(leaked.astype(np.float64), samples.offsets)
    return plr
