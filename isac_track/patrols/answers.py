"""What leaves the network on a patrol: one release of everybody, and what policies pick."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.config import StageSettings
from isac_track.errors import PluginError, SettingsError, told
from isac_track.patrols.patrol import Patrol, sense_people
from isac_track.policies.query import Form, Query, SelectOn, View
from isac_track.protocols import Mechanism, Policy, Predictor
from isac_track.rng import stream
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Knowledge,
    Prediction,
    Release,
    Sensed,
    stretches,
)

# Samples of histories that are copied for a forecast at a time.
_CHUNK: Final = 2_000_000


@dataclass(frozen=True, eq=False, slots=True)
class Network:
    """A sensing network on a patrol: what it holds, shares and foresees."""

    patrol: Patrol
    mechanism: Mechanism
    forecaster: Predictor  # The network's own.
    sensed: Sensed
    release: Release  # Of everybody; samples as in `sensed`.
    raw_forecast: Prediction  # Of the E presences, from all history as sensed.
    shared_forecast: Prediction  # The same from the release.
    seed: int

    def forecast(self, select_on: SelectOn) -> Prediction:
        """Return the network's forecasts of the E presences from raw or shared samples."""
        return self.raw_forecast if select_on == "raw" else self.shared_forecast


@dataclass(frozen=True, eq=False, slots=True)
class Disclosure:
    """What a policy answers on a patrol: A runs of samples, ordered by query, robot, person."""

    form: Form
    select_on: SelectOn  # Positions that the policy's choice rests on.
    robot: Ints  # (A,)
    presence: Ints  # (A,) query and person.
    first: Ints  # (A,) first sample of the run, and
    end: Ints  # (A,) the first one after it.

    def sent(self, patrol: Patrol, *, robots: Ints) -> Bools:
        """Return which samples any of some robots was sent, (M,)."""
        ours = np.isin(self.robot, robots)
        change = np.zeros(patrol.people.t.size + 1, dtype=np.int64)
        np.add.at(change, self.first[ours], 1)
        np.add.at(change, self.end[ours], -1)
        return np.asarray(np.cumsum(change[:-1]) > 0)


def share_patrol(
    patrol: Patrol,
    *,
    mechanism: Mechanism,
    forecaster: Predictor,
    settings: StageSettings,
    seed: int,
) -> Network:
    """Return the network that senses everybody once and shares by a mechanism.

    The random stream of the mechanism starts alike for all of them. SettingsError for a
    mechanism that leaves samples out or moves them in time: a policy selects samples.
    """
    sensed = sense_people(patrol, settings=settings, seed=seed)
    release = mechanism.share(sensed, stream(seed, "patrols", "sharing"))
    if not np.array_equal(release.t, sensed.t):
        name = type(mechanism).__name__
        raise SettingsError(
            f"{name} does not share every sample at its time; on patrols a policy"
            " selects samples, such as window:SECONDS"
        )
    raw = Release(
        sensed.t, sensed.xy, sensed.sigma_raw, sensed.offsets, release.pseudonym
    )
    return Network(
        patrol=patrol,
        mechanism=mechanism,
        forecaster=forecaster,
        sensed=sensed,
        release=release,
        raw_forecast=_forecast_presences(patrol, raw, forecaster),
        shared_forecast=_forecast_presences(patrol, release, forecaster),
        seed=seed,
    )


def _forecast_presences(
    patrol: Patrol, release: Release, predictor: Predictor
) -> Prediction:
    """Return forecasts of all presences from their whole histories, (E, H)."""
    pairs = patrol.presences
    return forecast_runs(
        release,
        first=patrol.people.offsets[pairs.person],
        end=pairs.sample + 1,
        track=np.arange(len(pairs)),
        t_future=patrol.t_ahead(np.arange(len(pairs))),
        predictor=predictor,
    )


def forecast_runs(
    release: Release,
    *,
    first: Ints,
    end: Ints,
    track: Ints,
    t_future: Floats,
    predictor: Predictor,
) -> Prediction:
    """Return a predictor's forecasts of U tracks at times (U, H) s.

    A track is made of runs of samples of the release: run a holds the samples
    ``first[a]:end[a]`` and belongs to ``track[a]``, which rises from 0 to U - 1 without
    a gap. A predictor sees the declared standard deviations if it requires them. There
    is a covariance if the predictor has one.
    """
    parts = []
    for tracks in _chunks(np.bincount(track, weights=end - first).astype(np.int64)):
        runs = slice(*np.searchsorted(track, [tracks.start, tracks.stop]))
        answer = _track_runs(release, first[runs], end[runs], track[runs], predictor)
        parts.append(predictor.predict(answer, t_future[tracks]))
    cov = [part.cov for part in parts if part.cov is not None]
    mean = np.concatenate([part.mean for part in parts])
    return Prediction(mean, np.concatenate(cov) if len(cov) == len(parts) else None)


def _track_runs(
    release: Release, first: Ints, end: Ints, track: Ints, predictor: Predictor
) -> Release:
    """Return runs of samples as tracks that a robot receives."""
    sample, _ = stretches(first, end - first)
    sizes = np.bincount(track - track[0], weights=end - first).astype(np.int64)
    sigma = release.sigma if Knowledge.SIGMA in predictor.requires else None
    return Release(
        t=release.t[sample],
        xy=release.xy[sample],
        sigma=None if sigma is None else sigma[sample],
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(str(number) for number in range(sizes.size)),
    )


def _chunks(sizes: Ints) -> Iterator[slice]:
    """Yield slices of tracks that hold about `_CHUNK` samples, and at least one track."""
    before, start = np.cumsum(sizes) - sizes, 0
    while start < sizes.size:
        stop = max(int(np.searchsorted(before, before[start] + _CHUNK)), start + 1)
        yield slice(start, stop)
        start = stop


def disclose(network: Network, policy: Policy, *, name: str = "") -> Disclosure:
    """Return what a policy answers to every query of every robot.

    PluginError if it returns anything but a mask of the samples of the query; `name` is
    that of the policy in messages.
    """
    name = name or type(policy).__name__
    select_on: SelectOn = getattr(policy, "select_on", "raw")
    runs = []
    for number in range(network.patrol.query_scan.size):
        scene = _scene(network, number)
        for robot in range(network.patrol.n_robots):
            selected = _selected(policy, _query(network, scene, robot), name=name)
            runs.append(_answer_runs(selected, scene, robot))
    return Disclosure(policy.form, select_on, *np.concatenate(runs, axis=1))


@dataclass(frozen=True, eq=False, slots=True)
class _Scene:
    """Everybody present at a query, whichever robot asks."""

    number: int
    presence: Ints  # (P,)
    shift: Ints  # (P,) from a sample's number in the query to that in the patrol.
    t: Floats
    offsets: Ints
    raw: View
    shared: View


def _scene(network: Network, number: int) -> _Scene:
    patrol = network.patrol
    presence = np.arange(*np.searchsorted(patrol.presences.query, [number, number + 1]))
    first = patrol.people.offsets[patrol.presences.person[presence]]
    sample, offsets = stretches(first, patrol.presences.sample[presence] + 1 - first)
    raw, shared = (
        View(positions[sample], _forecast_at(forecast, presence))
        for positions, forecast in (
            (network.sensed.xy, network.raw_forecast),
            (network.release.xy, network.shared_forecast),
        )
    )
    t = network.sensed.t[sample]
    return _Scene(number, presence, first - offsets[:-1], t, offsets, raw, shared)


def _forecast_at(forecast: Prediction, rows: Ints) -> Prediction:
    cov = None if forecast.cov is None else forecast.cov[rows]
    return Prediction(forecast.mean[rows], cov)


def _query(network: Network, scene: _Scene, robot: int) -> Query:
    patrol = network.patrol
    now = patrol.query_scan[scene.number]
    return Query(
        t=scene.t,
        offsets=scene.offsets,
        raw=scene.raw,
        shared=scene.shared,
        robot_xy=patrol.robot_xy[robot, now : now + patrol.ahead_s.size],
        ahead_s=patrol.ahead_s,
        rng=stream(network.seed, "patrols", "policy", robot, scene.number),
    )


def _selected(policy: Policy, query: Query, *, name: str) -> Bools:
    try:
        selected = policy.select(query)
    except Exception as error:
        raise PluginError(f"policy {name} failed: {told(error)}") from error
    mask = np.asarray(selected)
    if mask.dtype != np.bool_ or mask.shape != query.t.shape:
        raise PluginError(f"policy {name} must return a mask of {query.t.size} samples")
    return mask


def _answer_runs(selected: Bools, scene: _Scene, robot: int) -> Ints:
    """Return robot, presence, first sample and end of each run of selected samples, (4, A).

    No run reaches from one person to the next. A person with gaps has several runs.
    """
    starts, ends = selected.copy(), selected.copy()
    starts[1:] &= ~selected[:-1]
    ends[:-1] &= ~selected[1:]
    first_samples, last_samples = scene.offsets[:-1], scene.offsets[1:] - 1
    starts[first_samples] = selected[first_samples]
    ends[last_samples] = selected[last_samples]
    first, end = np.flatnonzero(starts), np.flatnonzero(ends) + 1
    person = np.searchsorted(scene.offsets, first, side="right") - 1
    shift = scene.shift[person]
    return np.stack(
        [
            np.full(person.size, robot),
            scene.presence[person],
            first + shift,
            end + shift,
        ]
    )
