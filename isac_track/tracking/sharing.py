"""Noise before tracking, on detections, or after it, on the samples of tracks.

Before tracking a mechanism cannot know which detections belong together: each is a
track of a single sample to it. A slow error then is a white error, since nothing says
what it should be slow along.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.errors import SettingsError
from isac_track.measurement import (
    axis_share,
    axis_variance,
    mean_variance,
    scalar_covariance,
)
from isac_track.mechanisms.perturb import draw_pseudonyms
from isac_track.protocols import Mechanism
from isac_track.rng import stream
from isac_track.tracking.detections import DetectedPatrol, order_detections
from isac_track.tracking.trackers import Tracked
from isac_track.types import Floats, Ints, Release, Sensed

_LEAST_SHARE: Final = 1e-6  # Of the raw variance: a filter needs some.


@dataclass(frozen=True, eq=False, slots=True)
class SharedTracks:
    """A release of N tracks of detections, S samples in all, and the truth apart.

    Attack and robot get the `release`, and when a track was confirmed and ended.
    """

    release: Release
    variance: Floats  # (S,) m^2 per axis, as declared.
    scan: Ints  # (S,) scan of each sample.
    confirmed: Ints  # (N,) scan from which the track is released, with its history.
    last: Ints  # (N,) last scan before the track ended.
    person: Ints  # (S,) truth: the row of the person behind each sample, or `CLUTTER`.


def perturb_detections(
    detected: DetectedPatrol, *, mechanism: Mechanism, seed: int
) -> DetectedPatrol:
    """Return the detections with a mechanism's noise, in the order of their new places.

    SettingsError for a mechanism that leaves samples out.
    """
    sensed, detections = detected.sensed, detected.detections
    release = _share(sensed, mechanism, seed=seed)
    return order_detections(
        scan_s=detections.scan_s,
        xy=release.xy,
        cov=_noisy_cov(detections.cov, sensed, release, mechanism),
        scan=detections.scan,
        points=sensed,
        sample=detected.sample,
        person=detected.person,
    )


def share_tracks(
    detected: DetectedPatrol,
    tracked: Tracked,
    *,
    seed: int,
    mechanism: Mechanism | None = None,
) -> SharedTracks:
    """Return the detections of each track as a release.

    With a `mechanism` its noise is added after tracking, along each track. Without, the
    samples are the detections as the tracker got them. SettingsError for a mechanism
    that leaves samples out.
    """
    detections = detected.detections
    row = np.flatnonzero(tracked.detection >= 0)
    point, scan = tracked.detection[row], tracked.scan[row]
    offsets = np.searchsorted(row, tracked.offsets)
    t, cov = detections.scan_s[scan], detections.cov[point]
    if mechanism is None or not point.size:
        rng = stream(seed, "tracking", "pseudonyms")
        names = draw_pseudonyms(len(tracked), rng)
        release = Release(
            t=t,
            xy=detections.xy[point],
            sigma=np.sqrt(mean_variance(cov) / axis_share(detected.sensed.law)),
            offsets=offsets,
            pseudonym=names,
            cov=None if detected.sensed.cov is None else cov,
        )
    else:
        sensed = detected.sensed
        interval_s = float(detections.scan_s[1] - detections.scan_s[0])
        along = Sensed(
            t=t,
            xy=detections.xy[point],
            unit_error=sensed.unit_error[point],
            sigma_raw=sensed.sigma_raw[point],
            information=sensed.information[point],
            fid=sensed.information[point] / interval_s,
            offsets=offsets,
            law=sensed.law,
            cov=None if sensed.cov is None else sensed.cov[point],
        )
        release = _share(along, mechanism, seed=seed)
        cov = _noisy_cov(cov, along, release, mechanism)
    return SharedTracks(
        release=release,
        variance=np.trace(cov, axis1=1, axis2=2) / 2.0,
        scan=scan,
        confirmed=tracked.confirmed,
        last=tracked.scan[tracked.offsets[1:] - 1],
        person=detected.person[point],
    )


def _share(sensed: Sensed, mechanism: Mechanism, *, seed: int) -> Release:
    release = mechanism.share(sensed, stream(seed, "tracking", "sharing"))
    if not np.array_equal(release.t, sensed.t):
        raise SettingsError(
            f"{type(mechanism).__name__} does not share every sample at its time, which"
            " detections and tracks need"
        )
    return release


def _noisy_cov(
    cov: Floats, sensed: Sensed, release: Release, mechanism: Mechanism
) -> Floats:
    """Return the covariances of samples after a mechanism, (D, 2, 2) m^2.

    A release of errors with a shape declares them. Else linear adding scales the error
    ellipse; independent noise is round and has the law of the mechanism.
    """
    if release.cov is not None:
        return np.asarray(release.cov + _LEAST_SHARE * cov)
    if release.sigma is None:
        raise SettingsError(f"{type(mechanism).__name__} declares no error")
    if getattr(mechanism, "adding", "independent") == "linear":
        growth = (release.sigma / sensed.sigma_raw) ** 2
        return np.asarray(cov * growth[:, None, None])
    added_m = np.sqrt(np.maximum(release.sigma**2 - sensed.sigma_raw**2, 0.0))
    law = getattr(mechanism, "law", None) or sensed.law
    # A mechanism that shares less than the raw error, as `clean`, shrinks the ellipse.
    share = np.clip((release.sigma / sensed.sigma_raw) ** 2, _LEAST_SHARE, 1.0)
    return np.asarray(
        cov * share[:, None, None]
        + scalar_covariance(axis_variance(sigma_m=added_m, law=law))
    )
