"""The sensing network on a patrol: what it senses, shares and forecasts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from isac_track.config import StageSettings
from isac_track.errors import SettingsError
from isac_track.patrols.forecasts import forecast_runs
from isac_track.patrols.patrol import Patrol, sense_again, sense_people
from isac_track.policies.query import SelectOn
from isac_track.protocols import Mechanism, Predictor
from isac_track.rng import stream
from isac_track.types import Ints, Prediction, Release, Sensed


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
    def shares_raw_positions(self) -> bool:
        """Whether positions are shared as they are sensed, whatever is declared."""
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
    # `row` counts queries with people, and differs from the number of the query.
    for row, sensed in enumerate(sensed_patrol.sensed_by_query):
        rng = stream(seed, "patrols", "sharing", "query", row)
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
    if _equals_sensed(release, sensed_patrol.sensed):
        return sensed_patrol.raw_forecast
    return _forecast_presences(patrol, release, forecaster)


def _equals_sensed(release: Release, sensed: Sensed) -> bool:
    """Whether a release has both positions and standard deviations as sensed."""
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
