"""Made-up detections, and slow answers to questions of association."""

from itertools import product

import numpy as np

from isac_track.tracking import Detections
from isac_track.tracking.detections import CLUTTER, order_detections
from isac_track.types import Sensed

STEP_S = 0.1


def make_detected(scans, *, std_m=0.05, step_s=STEP_S):
    """Detections of scans: a list of (person, x, y) for each scan."""
    rows = [(scan, *point) for scan, points in enumerate(scans) for point in points]
    table = np.array(rows, dtype=float).reshape(-1, 4)
    scan, person = table[:, 0].astype(int), table[:, 1].astype(int)
    n, scan_s = scan.size, step_s * np.arange(float(len(scans)))
    points = Sensed(
        t=scan_s[scan],
        xy=table[:, 2:],
        unit_error=np.zeros((n, 2)),
        sigma_raw=np.full(n, std_m),
        information=np.full(n, std_m**-2.0),
        fid=np.full(n, std_m**-2.0 / step_s),
        offsets=np.arange(n + 1),
        law="isotropic",
    )
    return order_detections(
        scan_s=scan_s,
        xy=table[:, 2:],
        cov=np.tile(std_m**2 * np.eye(2), (n, 1, 1)),
        scan=scan,
        points=points,
        sample=np.where(person == CLUTTER, CLUTTER, np.arange(n)),
        person=person,
    )


def walking(*walks, n_scans=40, step_s=STEP_S):
    """Scans of people who walk straight: (start place, velocity, first, end) each.

    A walk may have a fifth entry: the scans at which it is hidden.
    """
    scans = [[] for _ in range(n_scans)]
    for person, (place, velocity, first, end, *hidden) in enumerate(walks):
        for scan in range(first, end):
            if not hidden or scan not in hidden[0]:
                x, y = np.array(place) + step_s * scan * np.array(velocity)
                scans[scan].append((person, x, y))
    return scans


def no_detections(n_scans=5):
    """Scans without any detection."""
    return Detections(
        scan_s=STEP_S * np.arange(float(n_scans)),
        offsets=np.zeros(n_scans + 1, dtype=np.int64),
        xy=np.zeros((0, 2)),
        cov=np.zeros((0, 2, 2)),
    )


def associations(n_tracks, n_detections):
    """Every way to give tracks a detection or none (-1), no detection twice."""
    for choice in product(range(-1, n_detections), repeat=n_tracks):
        chosen = [column for column in choice if column >= 0]
        if len(set(chosen)) == len(chosen):
            yield choice


def product_of_ratios(ratios, choice):
    """The weight of an association: the product over its pairs."""
    pairs = [ratios[row, column] for row, column in enumerate(choice) if column >= 0]
    return float(np.prod(pairs))


def exact_marginals(ratios):
    """Marginal probabilities of associations by enumeration, (T, 1 + D)."""
    total = np.zeros((len(ratios), ratios.shape[1] + 1))
    for choice in associations(*ratios.shape):
        weight = product_of_ratios(ratios, choice)
        for row, column in enumerate(choice):
            total[row, column + 1] += weight
    return total / total.sum(axis=1, keepdims=True)
