"""Detections of a whole recording: unlabelled points, scan by scan.

Everybody present is detected with a probability at each scan of a patrol's clock, with
the error of the suite. Clutter is added. A tracker, a robot or an adversary gets
`Detections`; the truth stays apart.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from isac_track.config import Scaling, SensingSettings
from isac_track.errors import SettingsError
from isac_track.measurement import (
    axis_variance,
    mean_information,
    mean_variance,
    range_bearing_covariance,
    scalar_covariance,
)
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.routes import CELL_M, walked_cells
from isac_track.rng import stream
from isac_track.sensing import range_information_per_snr, unit_errors
from isac_track.types import Bools, Floats, Ints, Sensed

CLUTTER: Final = -1  # Number of the sample behind a detection of nobody.


@dataclass(frozen=True, slots=True)
class DetectionSettings:
    """How a network detects people at a scan. SettingsError for a bad value."""

    # Probability of detecting a person at a scan; None: from the link budget.
    probability: float | None = 0.9
    # Of the detector's threshold; it counts with the link budget only. Clutter does not
    # follow from it: the two are independent.
    false_alarm_probability: float = 1e-4
    clutter_per_scan: float = 3.0  # Mean number of detections of nobody.
    measurement: Literal["scalar", "range_bearing"] = "scalar"
    scaling: Scaling = "trace"  # Of `range_bearing`.
    n_antennas: int = 8  # Of the array that measures the bearing.

    def __post_init__(self) -> None:
        p = self.probability
        if p is not None and not 0.0 <= p <= 1.0:
            raise SettingsError(f"the detection probability must be in 0..1, got {p}")
        if not 0.0 < self.false_alarm_probability < 1.0:
            raise SettingsError(
                "the false-alarm probability must lie between 0 and 1, got "
                f"{self.false_alarm_probability}"
            )
        if not (self.clutter_per_scan >= 0.0 and np.isfinite(self.clutter_per_scan)):
            raise SettingsError(
                f"clutter_per_scan must not be negative, got {self.clutter_per_scan}"
            )
        if self.measurement not in ("scalar", "range_bearing"):
            raise SettingsError(
                f"unknown measurement {self.measurement!r}; known: scalar,"
                " range_bearing"
            )
        if self.scaling not in ("information", "trace"):
            raise SettingsError(
                f"unknown scaling {self.scaling!r}; known: information, trace"
            )
        if self.n_antennas < 2:  # noqa: PLR2004 - a bearing needs two
            raise SettingsError(
                f"a bearing needs 2 antennas or more, got {self.n_antennas}"
            )


@dataclass(frozen=True, eq=False, slots=True)
class Detections:
    """D unlabelled points in K scans: all that is released without tracks.

    Points of a scan are sorted by place, so that their order says nothing. ValueError
    for arrays whose shapes disagree.
    """

    scan_s: Floats  # (K,) s, times of the scans, rising.
    offsets: Ints  # (K + 1,) scan k has the detections ``offsets[k]:offsets[k + 1]``.
    xy: Floats  # (D, 2) m
    cov: Floats  # (D, 2, 2) m^2, declared covariance of the error.

    def __post_init__(self) -> None:
        n = len(self.xy)
        if self.xy.shape != (n, 2) or self.cov.shape != (n, 2, 2):
            raise ValueError("xy must be (D, 2) and cov (D, 2, 2)")
        if self.offsets.size != self.scan_s.size + 1 or self.offsets[-1] != n:
            raise ValueError("offsets must have an entry more than there are scans")
        if (np.diff(self.offsets) < 0).any() or self.offsets[0] != 0:
            raise ValueError("offsets must rise from 0")
        if not (np.isfinite(self.xy).all() and np.isfinite(self.cov).all()):
            raise ValueError("positions and covariances must be finite")

    def __len__(self) -> int:
        """Return the number of detections."""
        return len(self.xy)

    @property
    def scan(self) -> Ints:
        """Number of the scan of each detection, (D,)."""
        return np.repeat(np.arange(self.scan_s.size), np.diff(self.offsets))


@dataclass(frozen=True, eq=False, slots=True)
class DetectedPatrol:
    """Detections, and what the network and the scoring know besides."""

    detections: Detections
    sensed: Sensed
    """The detections as tracks of a single sample each, the input of a mechanism."""
    sample: Ints  # (D,) sample of the patrol's people behind each, or `CLUTTER`.
    person: Ints  # (D,) row of the person behind each, or `CLUTTER`.


def detection_probability(
    *, information: Floats, false_alarm_probability: float, settings: SensingSettings
) -> Floats:
    """Return the probability of detecting a target of known gain, (M,).

    An envelope detector of a steady target (Swerling 0): Marcum's Q with the SNR that
    the Fisher information implies, ``I / range_information_per_snr``. `information`,
    (M,) 1/m^2, has a floor where sigma_raw is capped; the probability has it, too.
    """
    from scipy.stats import ncx2  # noqa: PLC0415 - heavy to import

    snr = information / range_information_per_snr(bandwidth_mhz=settings.bandwidth_mhz)
    threshold = -2.0 * np.log(false_alarm_probability)
    return np.asarray(ncx2.sf(threshold, 2, 2.0 * snr))


def detect_people(
    patrol: Patrol,
    sensed: Sensed,
    *,
    settings: DetectionSettings,
    sensing: SensingSettings,
    seed: int,
) -> DetectedPatrol:
    """Return the detections of a patrol.

    `sensed` has the people of the patrol, sample by sample (`sense_people`). A person
    and a scan share the draws of all settings; a higher probability only adds
    detections.

    Errors that `sensed` declares with a shape keep it, and clutter has such errors, too;
    SettingsError if `settings` would shape them again.
    """
    if sensed.cov is not None and settings.measurement != "scalar":
        raise SettingsError("errors of range and bearing have their shape already")
    present = np.flatnonzero(
        _are_detected(patrol, sensed, settings=settings, sensing=sensing, seed=seed)
    )
    clutter = _draw_clutter(patrol, sensed, settings=settings, seed=seed)
    xy = np.concatenate([patrol.people.xy[present], clutter.xy])
    unit_error = np.concatenate([sensed.unit_error[present], clutter.unit_error])
    donor = np.concatenate([present, clutter.donor])
    sigma_m = sensed.sigma_raw[donor]
    variance_m2 = axis_variance(sigma_m=sigma_m, law=sensed.law)
    cov = _covariance(xy, variance_m2, settings=settings, sensing=sensing)
    if sensed.cov is not None:
        cov[: present.size] = sensed.cov[present]
    if settings.measurement == "range_bearing":
        unit_error = _shaped(unit_error, cov, variance_m2)
    elif sensed.cov is not None:  # Errors of people have their shape.
        clutter_rows = slice(present.size, None)
        unit_error[clutter_rows] = _shaped(
            unit_error[clutter_rows], cov[clutter_rows], variance_m2[clutter_rows]
        )
    scan = np.concatenate([patrol.scan[present], clutter.scan])
    interval_s = float(patrol.scan_s[1] - patrol.scan_s[0])
    points = Sensed(
        t=patrol.scan_s[scan],
        xy=xy + sigma_m[:, None] * unit_error,
        unit_error=unit_error,
        sigma_raw=sigma_m,
        information=sensed.information[donor],
        # Nobody knows the sample before: the interval is that of the scans.
        fid=sensed.information[donor] / interval_s,
        offsets=np.arange(scan.size + 1),
        law=sensed.law,
        cov=None if sensed.cov is None else cov,
    )
    n_scans = int(patrol.scan.max()) + 1
    return order_detections(
        scan_s=patrol.scan_s[:n_scans],
        xy=points.xy,
        cov=cov,
        scan=scan,
        points=points,
        sample=np.concatenate([present, np.full(clutter.scan.size, CLUTTER)]),
        person=np.concatenate(
            [
                np.searchsorted(patrol.people.offsets, present, side="right") - 1,
                np.full(clutter.scan.size, CLUTTER),
            ]
        ),
    )


def _covariance(
    xy: Floats,
    variance_m2: Floats,
    *,
    settings: DetectionSettings,
    sensing: SensingSettings,
) -> Floats:
    """Return the covariance of the error at true places, (D, 2, 2) m^2."""
    is_scalar = sensing.measurement == settings.measurement == "scalar"
    if is_scalar:
        return scalar_covariance(variance_m2)
    is_sensed = sensing.measurement != "scalar"
    return range_bearing_covariance(
        xy=xy,
        station_m=(sensing.bs_x_m, sensing.bs_y_m),
        variance_m2=variance_m2,
        bandwidth_mhz=sensing.bandwidth_mhz,
        n_antennas=sensing.n_antennas if is_sensed else settings.n_antennas,
        # The variance of sensed errors is that of their shape.
        scaling="trace" if is_sensed else settings.scaling,
    )


def _shaped(unit_error: Floats, cov: Floats, variance_m2: Floats) -> Floats:
    """Return unit errors, (D, 2), with the shape of covariances of a mean variance."""
    factor = np.linalg.cholesky(cov / variance_m2[:, None, None])
    return np.asarray(np.einsum("mab,mb->ma", factor, unit_error))


def _link_information(sensed: Sensed, sensing: SensingSettings) -> Floats:
    """Return the information that follows from the link budget, (M,) 1/m^2.

    At equal mean squared error a shape adds information that no SNR stands behind.
    """
    if sensed.cov is None or sensing.scaling == "information":
        return sensed.information
    shape = mean_information(sensed.cov) * mean_variance(sensed.cov)
    return np.asarray(sensed.information / shape)


def order_detections(
    *,
    scan_s: Floats,
    xy: Floats,
    cov: Floats,
    scan: Ints,
    points: Sensed,
    sample: Ints,
    person: Ints,
) -> DetectedPatrol:
    """Return D detections in the order of scans and places.

    `xy`, (D, 2) m, and `cov`, (D, 2, 2) m^2, are as released; `points` are the same
    detections as sensed. `scan`, `sample` and `person` are (D,).
    """
    order = np.lexsort((xy[:, 1], xy[:, 0], scan))
    return DetectedPatrol(
        detections=Detections(
            scan_s=scan_s,
            offsets=np.searchsorted(scan[order], np.arange(scan_s.size + 1)),
            xy=xy[order],
            cov=cov[order],
        ),
        sensed=Sensed(
            t=points.t[order],
            xy=points.xy[order],
            unit_error=points.unit_error[order],
            sigma_raw=points.sigma_raw[order],
            information=points.information[order],
            fid=points.fid[order],
            offsets=points.offsets,
            law=points.law,
            cov=None if points.cov is None else points.cov[order],
        ),
        sample=sample[order],
        person=person[order],
    )


def _are_detected(
    patrol: Patrol,
    sensed: Sensed,
    *,
    settings: DetectionSettings,
    sensing: SensingSettings,
    seed: int,
) -> Bools:
    """Return which samples are detected, (M,): a stream of draws for each person."""
    people = patrol.people
    draws = [
        stream(seed, "tracking", "detected", source).random(size)
        for source, size in zip(
            people.source, np.diff(people.offsets).tolist(), strict=True
        )
    ]
    if settings.probability is not None:
        return np.concatenate(draws) < settings.probability
    probability = detection_probability(
        information=_link_information(sensed, sensing),
        false_alarm_probability=settings.false_alarm_probability,
        settings=sensing,
    )
    return np.asarray(np.concatenate(draws) < probability)


@dataclass(frozen=True, eq=False, slots=True)
class _Clutter:
    """C detections of nobody."""

    scan: Ints  # (C,)
    xy: Floats  # (C, 2) m, before the error.
    unit_error: Floats  # (C, 2)
    donor: Ints  # (C,) person's sample whose declared error the detection has.


def _draw_clutter(
    patrol: Patrol, sensed: Sensed, *, settings: DetectionSettings, seed: int
) -> _Clutter:
    """Draw clutter: Poisson in number, uniform in the walked area, a stream a scan.

    Each point declares the error of a random sample of people. So declared errors have
    people's distribution, but not jointly with the place: an error of a far sample may
    stand near the station.
    """
    cells = walked_cells(patrol.people.xy)
    scans, places, errors, donors = [], [], [], []
    for scan in range(int(patrol.scan.max()) + 1):
        rng = stream(seed, "tracking", "clutter", scan)
        n = int(rng.poisson(settings.clutter_per_scan))
        if not n:
            continue
        scans.append(np.full(n, scan))
        corner = cells[rng.integers(len(cells), size=n)]
        places.append(corner + CELL_M * rng.random((n, 2)))
        donors.append(rng.integers(sensed.t.size, size=n))
        apart = np.arange(n + 1)  # Each of a track of its own.
        errors.append(unit_errors(n_samples=n, law=sensed.law, rng=rng, offsets=apart))
    if not scans:
        no_points = np.zeros((0, 2))
        none = np.zeros(0, dtype=np.int64)
        return _Clutter(none, no_points, no_points, none)
    return _Clutter(
        scan=np.concatenate(scans),
        xy=np.concatenate(places),
        unit_error=np.concatenate(errors),
        donor=np.concatenate(donors),
    )


def clutter_density(patrol: Patrol, *, settings: DetectionSettings) -> float:
    """Return the mean number of clutter points a scan and square metre, 1/m^2."""
    area_m2 = len(walked_cells(patrol.people.xy)) * CELL_M**2
    return settings.clutter_per_scan / area_m2
