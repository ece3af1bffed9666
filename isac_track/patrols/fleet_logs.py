"""Logs of fleets: entries about samples of a patrol, by person."""

from dataclasses import dataclass

import numpy as np

from isac_track.measurement import error_ellipses
from isac_track.noise import UNKNOWN_VARIANCE_M2
from isac_track.patrols.answers import Disclosure
from isac_track.patrols.network import Network
from isac_track.patrols.reports import Reports, average_draws, sent_reports
from isac_track.patrols.utility import scans_left
from isac_track.types import Bools, Floats, Ints


@dataclass(frozen=True, eq=False, slots=True)
class Log:
    """Entries that a fleet was sent about samples of a patrol, ordered by person."""

    sample: Ints  # (L,) sample with the time of the entry, rising.
    t: Floats  # (L,) s
    xy: Floats  # (L, 2) m
    variance: Floats  # (L,) m^2 per axis, as the network declares it.
    offsets: Ints  # (N + 1,) entries of each person; a person may have none.
    # (L, 2, 2) m^2, of declared errors with a shape; `variance` is their mean then.
    cov: Floats | None = None

    @property
    def ellipse(self) -> Floats | None:
        """Shape of the errors, (L, 2, 2) in units of `variance`; None: round errors."""
        return None if self.cov is None else error_ellipses(self.cov)


def fleet_log(network: Network, disclosure: Disclosure, *, robots: Ints) -> Log:
    """Return the log of a fleet of `robots`: samples, or states at their samples.

    A state gives an entry at every scan until the next query, by its position and
    velocity. A later state replaces an earlier state. Several draws of a sample are
    averaged.
    """
    people = network.patrol.people
    if disclosure.form == "state":
        sent = disclosure.sent_mask(network.patrol, robots=robots)
        sample, reports = _state_entries(network, sent)
    else:
        row = _sent_rows(network, disclosure, robots)
        sample, reports = average_draws(
            sent_samples(network, row), sent_reports(network)[row]
        )
    reports = reports.floored()
    return Log(
        sample=sample,
        t=people.t[sample],
        xy=reports.xy,
        variance=reports.variance,
        offsets=np.searchsorted(sample, people.offsets),
        cov=reports.cov,
    )


def _sent_rows(network: Network, disclosure: Disclosure, robots: Ints) -> Ints:
    """Return the ascending rows of `network.sent_release` that robots got, (L,)."""
    is_ours = np.isin(disclosure.robot, robots)
    begins = network.sent_rows(disclosure.presence[is_ours], disclosure.first[is_ours])
    sizes = disclosure.end[is_ours] - disclosure.first[is_ours]
    change = np.zeros(network.sent_release.t.size + 1, dtype=np.int64)
    np.add.at(change, begins, 1)
    np.add.at(change, begins + sizes, -1)
    return np.flatnonzero(np.cumsum(change[:-1]) > 0)


def sent_samples(network: Network, row: Ints) -> Ints:
    """Return the samples of the patrol at rows of `network.sent_release`, (L,)."""
    if network.histories is None:
        return row
    offsets, pairs = network.sent_release.offsets, network.patrol.presences
    presence = np.searchsorted(offsets, row, side="right") - 1
    first = network.patrol.people.offsets[pairs.person[presence]]
    return np.asarray(first + row - offsets[presence])


def _state_entries(network: Network, sent: Bools) -> tuple[Ints, Reports]:
    """Return the samples at which states give an entry, and the entries.

    Forecasts have a shape if the release declares it.
    """
    patrol, forecast = network.patrol, network.shared_forecast
    n_samples = patrol.people.t.size
    xy, variance = np.zeros((n_samples, 2)), np.full(n_samples, UNKNOWN_VARIANCE_M2)
    cov = UNKNOWN_VARIANCE_M2 * np.tile(np.eye(2), (n_samples, 1, 1))
    is_entry = np.zeros(n_samples, dtype=bool)
    rows = np.flatnonzero(sent[patrol.presences.sample])
    sample, stay = patrol.presences.sample[rows], scans_left(patrol)[rows]
    n_scans = int(np.diff(patrol.query_scan).max(initial=1))
    # Of several states for a scan the latest has the fewest steps: it is written last.
    for step in reversed(range(n_scans)):
        is_present = stay >= step
        entry, row = sample[is_present] + step, rows[is_present]
        xy[entry], is_entry[entry] = forecast.mean[row, step], True
        if forecast.cov is not None:
            variance[entry] = (
                np.trace(forecast.cov[row, step], axis1=-2, axis2=-1) / 2.0
            )
            cov[entry] = forecast.cov[row, step]
    sample = np.flatnonzero(is_entry)
    has_shape = network.release.cov is not None and forecast.cov is not None
    return sample, Reports(
        xy[sample], variance[sample], cov[sample] if has_shape else None
    )
