"""The stage *sharing*: the descriptors as shared, and what every predictor makes of a release."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from evaluation.cells.descriptors import descriptors, track_columns
from evaluation.cells.plugin_calls import copied, guarded
from isac_track.conflict import conflict_probability, is_conflict
from isac_track.errors import PluginError, SettingsError
from isac_track.scenes import predicted_separation, robot_positions
from isac_track.types import Knowledge, Prediction

if TYPE_CHECKING:
    from evaluation.cells.tables import Rows
    from evaluation.experiment.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.types import Floats, Release, Scenes


def sharing_rows(
    consumer: Consumer, release: Release, scenes: Scenes, *, stages: StageSettings
) -> Rows:
    """Return the rows of the descriptors as shared, a track each, or of a predictor, a scene each.

    Parameters
    ----------
    consumer : Consumer
    release : Release
        Of the scenes.
    scenes : Scenes
        Without the samples that the release left out.
    stages : StageSettings

    Raises
    ------
    PluginError
        If a predictor raises or breaks its contract; the message names it.
    """
    if consumer.plugin is not None:
        return _forecast(consumer.plugin, release, scenes, stages=stages)
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
