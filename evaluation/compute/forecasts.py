"""The stage *sharing*: the descriptors as shared, and what every predictor makes of a release."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.compute.sharing import guarded, handed, samples_of, showing
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
    from evaluation.plan.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin

# In which a robot's own estimates are held against the truth.
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
    """Return the rows of the descriptors as shared, a track each, or of a predictor, a scene each.

    `scenes` are those of the release, without the samples that it left out; `mechanism`
    shared it. `is_logged`: a robot's own estimates of the past are held against the
    truth, too. Raises PluginError if a predictor raises or breaks its contract, which
    names it, and SettingsError if conflicts are decided by a probability and a
    predictor has none.
    """
    predictor, conflict = consumer.plugin, stages.conflict
    if predictor is None:
        return {
            **track_columns(scenes, np.arange(scenes.track.size)),
            "speed_mps": net_speeds(scenes),
            **descriptors(release, truth=scenes.xy, settings=stages.privacy),
        }
    who = f"predictor {predictor.spec!r}"
    granted = handed(showing(release, predictor.instance.requires), predictor)
    robot_knows = guarded(who, lambda: knowing(predictor.instance, mechanism.instance))
    prediction = guarded(
        who, lambda: robot_knows.predict(granted, scenes.t_future.copy())
    )
    expected = scenes.xy_future.shape
    if not isinstance(prediction, Prediction) or prediction.mean.shape != expected:
        raise PluginError(f"{who} must return a Prediction with mean {expected}")
    if prediction.cov is None and conflict.decision == "probability":
        raise SettingsError(
            f"{who} has no covariance, which conflict.decision=probability needs; leave"
            " it out or decide by the mean"
        )
    robot, radius_m = (
        robot_positions(scenes, settings=conflict),
        conflict.safety_radius_m,
    )
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
        "scene": scenes.index,
        "track": scenes.track[:: scenes.n_agents],
        "exhausted": scenes.exhausted,
        "conflict": scenes.conflict,
        "inside_now": scenes.inside_now,
        "time_to_conflict_s": scenes.time_to_conflict_s,
        "predicted": predicted,
        "separation_m": scenes.separation,
        "predicted_separation_m": separation_m,
        "probability": probability,
        "plr_robot": (
            _own_plr(who, robot_knows, granted, scenes, stages=stages)
            if is_logged
            else np.full(len(scenes), np.nan)
        ),
    }


def _own_plr(
    who: str,
    predictor: object,
    release: Release,
    scenes: Scenes,
    *,
    stages: StageSettings,
) -> Floats:
    """Return of which share of a scene's first agent's samples the robot knew the place by then.

    (S,); NaN after the first `LOGGED_SCENES`, and for a predictor that has no
    ``track``. A scene's cluster is that of its first agent. Raises PluginError as
    `sharing_rows` does.
    """
    found = np.full(len(scenes), np.nan)
    logged = np.flatnonzero(scenes.index < LOGGED_SCENES)
    track = getattr(predictor, "track", None)
    if track is None or not logged.size:
        return found
    rows = logged * scenes.n_agents
    first, samples = release.tracks(rows), samples_of(scenes.offsets, rows)
    places = guarded(who, lambda: Reconstruction(track(first)).xy)
    if places.shape != first.xy.shape:
        raise PluginError(
            f"{who} must track positions {first.xy.shape}, got {places.shape}"
        )
    truth, epsilon_m = scenes.xy.take(samples.rows, axis=0), stages.privacy.epsilon_m
    leaked = leakage_indicator(shared_xy=places, true_xy=truth, epsilon_m=epsilon_m)
    found[logged] = track_means(leaked.astype(np.float64), samples.offsets)
    return found
