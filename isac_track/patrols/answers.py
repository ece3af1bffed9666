"""Answers of the network on a patrol: a release of everybody, and the disclosures."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.random import Generator

from isac_track.config import StageSettings
from isac_track.errors import PluginError, SettingsError, error_text
from isac_track.patrols.patrol import Patrol, sense_again, sense_people
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
    read_only,
    stretches,
)

# Samples of histories that are copied at a time for a forecast.
_CHUNK: Final = 2_000_000


@dataclass(frozen=True, eq=False, slots=True)
class Histories:
    """All history of the people at each query, with errors of that query alone."""

    raw: Release  # E tracks, one for each presence, as sensed.
    shared: Release  # The same as the mechanism shares it.


@dataclass(frozen=True, eq=False, slots=True)
class Network:
    """A sensing network on a patrol, with its data, its release and its forecasts."""

    patrol: Patrol
    mechanism: Mechanism
    forecaster: Predictor  # The network's own predictor.
    sensed: Sensed
    release: Release  # Of everybody; samples as in `sensed`.
    raw_forecast: Prediction  # Of the E presences, from all history as sensed.
    shared_forecast: Prediction  # The same from the release.
    seed: int
    # What is sent, if errors are drawn anew at every query; else `release` is.
    histories: Histories | None = None

    @property
    def is_raw(self) -> bool:
        """Whether positions are shared as they are sensed."""
        if self.histories is not None:
            return np.array_equal(self.histories.shared.xy, self.histories.raw.xy)
        return np.array_equal(self.release.xy, self.sensed.xy)

    @property
    def sent_release(self) -> Release:
        """The release that answers are cut from."""
        return self.release if self.histories is None else self.histories.shared

    def sent_rows(self, presence: Ints, sample: Ints) -> Ints:
        """Return the rows of `sent_release` that answers have of samples, (A,)."""
        if self.histories is None:
            return sample
        people = self.patrol.people
        first = people.offsets[self.patrol.presences.person[presence]]
        return np.asarray(self.histories.shared.offsets[presence] + sample - first)

    def forecast(self, select_on: SelectOn) -> Prediction:
        """Return the forecasts of the E presences from raw or shared samples."""
        return self.raw_forecast if select_on == "raw" else self.shared_forecast


@dataclass(frozen=True, eq=False, slots=True)
class Disclosure:
    """Answers of a policy on a patrol: A runs of samples, by query, robot, person."""

    form: Form
    select_on: SelectOn  # Positions that the policy's choice rests on.
    robot: Ints  # (A,)
    presence: Ints  # (A,) query and person.
    first: Ints  # (A,) first sample of the run.
    end: Ints  # (A,) first sample after the run.

    def key(self, *, robots: Ints) -> bytes:
        """Return a key that equal answers share, whichever of `robots` got them."""
        is_ours = np.isin(self.robot, robots)
        runs = np.stack([self.presence, self.first, self.end])[:, is_ours]
        return np.unique(runs, axis=1).tobytes()

    def sent_mask(self, patrol: Patrol, *, robots: Ints) -> Bools:
        """Return which samples were sent to at least one of `robots`, (M,)."""
        is_ours = np.isin(self.robot, robots)
        change = np.zeros(patrol.people.t.size + 1, dtype=np.int64)
        np.add.at(change, self.first[is_ours], 1)
        np.add.at(change, self.end[is_ours], -1)
        return np.asarray(np.cumsum(change[:-1]) > 0)


@dataclass(frozen=True, eq=False, slots=True)
class SensedPatrol:
    """A patrol as its network senses it: the same for all mechanisms."""

    patrol: Patrol
    forecaster: Predictor  # The network's own predictor.
    sensed: Sensed
    raw_forecast: Prediction  # Of the E presences, from all history as sensed.
    seed: int
    # All history of the people at each query with people; empty if errors last.
    sensed_by_query: tuple[Sensed, ...] = ()


def sense_patrol(
    patrol: Patrol, *, forecaster: Predictor, settings: StageSettings, seed: int
) -> SensedPatrol:
    """Sense everybody once, and forecast from what was sensed.

    With `patrol.errors=query` all history is sensed anew at every query.
    """
    sensed = sense_people(patrol, settings=settings, seed=seed)
    if settings.patrol.errors == "query":
        by_query = tuple(
            sense_again(patrol, number, settings=settings, seed=seed)
            for number in np.unique(patrol.presences.query).tolist()
        )
        forecast = _forecast_histories(patrol, _joined_raw(by_query), forecaster)
        return SensedPatrol(patrol, forecaster, sensed, forecast, seed, by_query)
    forecast = _forecast_presences(patrol, _as_sensed(sensed), forecaster)
    return SensedPatrol(patrol, forecaster, sensed, forecast, seed)


def _joined_raw(by_query: Sequence[Sensed]) -> Release:
    """Return the histories of all queries, as sensed, one below the other."""
    return _joined_releases([_as_sensed(sensed) for sensed in by_query])


def _as_sensed(sensed: Sensed) -> Release:
    """Return what a network's own predictor gets: the tracks as sensed."""
    return Release(
        t=sensed.t,
        xy=sensed.xy,
        sigma=sensed.sigma_raw,
        offsets=sensed.offsets,
        pseudonym=tuple(map(str, range(len(sensed)))),
        cov=sensed.cov,
    )


def _joined_releases(parts: Sequence[Release]) -> Release:
    """Return the tracks of several releases, one below the other."""
    sizes = np.concatenate([np.diff(part.offsets) for part in parts])
    sigmas = [part.sigma for part in parts if part.sigma is not None]
    covs = [part.cov for part in parts if part.cov is not None]
    return Release(
        t=np.concatenate([part.t for part in parts]),
        xy=np.concatenate([part.xy for part in parts]),
        sigma=np.concatenate(sigmas) if len(sigmas) == len(parts) else None,
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(map(str, range(sizes.size))),
        cov=np.concatenate(covs) if len(covs) == len(parts) else None,
    )


def _forecast_histories(
    patrol: Patrol, histories: Release, predictor: Predictor
) -> Prediction:
    """Return forecasts of all presences from the histories of their queries, (E, H)."""
    every = np.arange(len(patrol.presences))
    return forecast_runs(
        histories,
        first=histories.offsets[:-1],
        end=histories.offsets[1:],
        track=every,
        t_future=patrol.t_ahead(every),
        predictor=predictor,
    )


def share_patrol(
    patrol: Patrol,
    *,
    mechanism: Mechanism,
    forecaster: Predictor,
    settings: StageSettings,
    seed: int,
) -> Network:
    """Return a network that senses everybody once and shares by a mechanism.

    Raises as `share_sensed`.
    """
    sensed = sense_patrol(patrol, forecaster=forecaster, settings=settings, seed=seed)
    return share_sensed(sensed, mechanism=mechanism)


def share_sensed(sensed_patrol: SensedPatrol, *, mechanism: Mechanism) -> Network:
    """Return a network that shares by a mechanism.

    The random stream starts equal for all mechanisms. SettingsError for a mechanism
    that leaves samples out or moves them in time, since a policy selects samples.
    """
    releases = share_each(sensed_patrol, mechanism.share)
    return make_network(sensed_patrol, mechanism=mechanism, releases=releases)


def share_each(
    sensed_patrol: SensedPatrol, share: Callable[[Sensed, Generator], Release]
) -> list[Release]:
    """Return the release of everybody, and behind it those of each query, if any."""
    seed = sensed_patrol.seed
    releases = [share(sensed_patrol.sensed, stream(seed, "patrols", "sharing"))]
    for number, sensed in enumerate(sensed_patrol.sensed_by_query):
        rng = stream(seed, "patrols", "sharing", "query", number)
        releases.append(share(sensed, rng))
    return releases


def make_network(
    sensed_patrol: SensedPatrol, *, mechanism: Mechanism, releases: Sequence[Release]
) -> Network:
    """Return the network that shared releases; SettingsError as `share_sensed`.

    They are as `share_each` returns them.
    """
    sensed, by_query = sensed_patrol.sensed, sensed_patrol.sensed_by_query
    for part, sensed_part in zip(releases, (sensed, *by_query), strict=True):
        if not np.array_equal(part.t, sensed_part.t):
            name = type(mechanism).__name__
            raise SettingsError(
                f"{name} does not share every sample at its time; on patrols a policy"
                " selects samples, such as window:SECONDS"
            )
    release, *releases_by_query = releases
    histories = None
    if releases_by_query:
        histories = Histories(
            raw=_joined_raw(by_query), shared=_joined_releases(releases_by_query)
        )
    return Network(
        patrol=sensed_patrol.patrol,
        mechanism=mechanism,
        forecaster=sensed_patrol.forecaster,
        sensed=sensed,
        release=release,
        raw_forecast=sensed_patrol.raw_forecast,
        shared_forecast=_forecast_shared(sensed_patrol, release, histories),
        seed=sensed_patrol.seed,
        histories=histories,
    )


def _forecast_shared(
    sensed_patrol: SensedPatrol, release: Release, histories: Histories | None
) -> Prediction:
    """Return the network's forecasts from what is shared, (E, H)."""
    patrol, forecaster = sensed_patrol.patrol, sensed_patrol.forecaster
    if histories is not None:
        return _forecast_histories(patrol, histories.shared, forecaster)
    if _declares_raw(release, sensed_patrol.sensed):
        return sensed_patrol.raw_forecast
    return _forecast_presences(patrol, release, forecaster)


def _declares_raw(release: Release, sensed: Sensed) -> bool:
    """Whether a release has the positions and standard deviations that were sensed."""
    return (
        release.sigma is not None
        and np.array_equal(release.xy, sensed.xy)
        and np.array_equal(release.sigma, sensed.sigma_raw)
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
    a gap. A predictor sees the declared standard deviations if it requires them. The
    result has a covariance if the predictor returns any.
    """
    if not track.size:  # A robot that was sent nobody.
        return Prediction(np.zeros((*t_future.shape, 2)), None)
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
    if Knowledge.SIGMA not in predictor.requires:
        release = release.without_sigma()
    return Release(
        t=release.t[sample],
        xy=release.xy[sample],
        sigma=None if release.sigma is None else release.sigma[sample],
        cov=None if release.cov is None else release.cov[sample],
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(str(number) for number in range(sizes.size)),
    )


def _chunks(sizes: Ints) -> Iterator[slice]:
    """Yield slices of tracks with about `_CHUNK` samples, and at least one track."""
    before, start = np.cumsum(sizes) - sizes, 0
    while start < sizes.size:
        stop = max(int(np.searchsorted(before, before[start] + _CHUNK)), start + 1)
        yield slice(start, stop)
        start = stop


def disclose(network: Network, policy: Policy, *, name: str = "") -> Disclosure:
    """Return the answers of a policy to all queries of all robots.

    PluginError if the policy does not return a mask of the query's samples; `name` is
    its name in messages.
    """
    name = name or type(policy).__name__
    return disclose_each(network, {name: policy})[name]


def disclose_each(
    network: Network, policies: Mapping[str, Policy]
) -> dict[str, Disclosure]:
    """Return the answers of several policies, by their names; otherwise as `disclose`.

    A query's people are gathered once for all of them. A policy's answers depend on no
    other policy.
    """
    runs: dict[str, list[Ints]] = {name: [] for name in policies}
    for number in range(network.patrol.query_scan.size):
        people = _present_people(network, number)
        for name, policy in policies.items():
            for robot in range(network.patrol.n_robots):
                query = _make_query(network, people, robot)
                selected = _select_samples(policy, query, name=name)
                runs[name].append(_answer_runs(selected, people, robot))
    return {
        name: _joined_answers(policy, runs[name]) for name, policy in policies.items()
    }


def _joined_answers(policy: Policy, runs: Sequence[Ints]) -> Disclosure:
    """Return the disclosure of runs as `_answer_runs` returns them."""
    robot, presence, first, end = np.concatenate(runs, axis=1)
    select_on: SelectOn = getattr(policy, "select_on", "raw")
    return Disclosure(
        form=policy.form,
        select_on=select_on,
        robot=robot,
        presence=presence,
        first=first,
        end=end,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _QueryPeople:
    """People who are present at a query of any robot."""

    number: int
    presence: Ints  # (P,)
    shift: Ints  # (P,) added to a sample's number in the query: that in the patrol.
    t: Floats  # (M,) s
    offsets: Ints  # (P + 1,)
    raw: View
    shared: View


def _present_people(network: Network, number: int) -> _QueryPeople:
    """Return the people who are present at the query of this number."""
    patrol = network.patrol
    start, stop = np.searchsorted(patrol.presences.query, [number, number + 1])
    presence = np.arange(start, stop)
    first = patrol.people.offsets[patrol.presences.person[presence]]
    sample, offsets = stretches(first, patrol.presences.sample[presence] + 1 - first)
    raw_xy, shared_xy = network.sensed.xy[sample], network.release.xy[sample]
    if network.histories is not None:
        offsets_of_all = network.histories.raw.offsets
        rows = slice(offsets_of_all[start], offsets_of_all[stop])
        raw_xy = network.histories.raw.xy[rows]
        shared_xy = network.histories.shared.xy[rows]
    raw_forecast = _take_forecasts(network.raw_forecast, presence)
    shared_forecast = _take_forecasts(network.shared_forecast, presence)
    return _QueryPeople(
        number=number,
        presence=presence,
        shift=first - offsets[:-1],
        # Read-only: no policy changes the input of another.
        t=read_only(network.sensed.t[sample]),
        offsets=read_only(offsets),
        raw=View(read_only(raw_xy), raw_forecast),
        shared=View(read_only(shared_xy), shared_forecast),
    )


def _take_forecasts(forecast: Prediction, rows: Ints) -> Prediction:
    cov = None if forecast.cov is None else forecast.cov[rows]
    return Prediction(forecast.mean[rows], cov)


def _make_query(network: Network, people: _QueryPeople, robot: int) -> Query:
    patrol = network.patrol
    now = patrol.query_scan[people.number]
    return Query(
        t=people.t,
        offsets=people.offsets,
        raw=people.raw,
        shared=people.shared,
        robot_xy=patrol.robot_xy[robot, now : now + patrol.ahead_s.size],
        ahead_s=patrol.ahead_s,
        rng=stream(network.seed, "patrols", "policy", robot, people.number),
    )


def _select_samples(policy: Policy, query: Query, *, name: str) -> Bools:
    """Return the mask that a policy returns, (M,); PluginError for anything else."""
    try:
        selected = policy.select(query)
    except Exception as error:
        raise PluginError(f"policy {name} failed: {error_text(error)}") from error
    mask = np.asarray(selected)
    if mask.dtype != np.bool_ or mask.shape != query.t.shape:
        raise PluginError(f"policy {name} must return a mask of {query.t.size} samples")
    return mask


def _answer_runs(selected: Bools, people: _QueryPeople, robot: int) -> Ints:
    """Return robot, presence, first sample and end of each selected run, (4, A).

    No run reaches from one person to the next. A person with gaps has several runs.
    """
    starts, ends = selected.copy(), selected.copy()
    starts[1:] &= ~selected[:-1]
    ends[:-1] &= ~selected[1:]
    first_samples, last_samples = people.offsets[:-1], people.offsets[1:] - 1
    starts[first_samples] = selected[first_samples]
    ends[last_samples] = selected[last_samples]
    first, end = np.flatnonzero(starts), np.flatnonzero(ends) + 1
    person = np.searchsorted(people.offsets, first, side="right") - 1
    shift = people.shift[person]
    return np.stack(
        [
            np.full(person.size, robot),
            people.presence[person],
            first + shift,
            end + shift,
        ]
    )
