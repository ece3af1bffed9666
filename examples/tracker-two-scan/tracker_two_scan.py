"""Begin a track with a point in each of two scans in a row; join the nearest pairs."""

from dataclasses import dataclass

import numpy as np

from isac_track.tracking import Track, join_tracks

MISS = -1
MOST_STEP_M = 0.25  # Between two scans that begin a track: 3 m/s at 12 scans a second.


@dataclass(frozen=True)
class TwoScan:
    """Join the nearest pairs of tracks and points; two scans in a row begin a track."""

    gates: float = 3.0  # Of the distance, in standard deviations of the error.
    patience_s: float = 0.5  # A track ends if it is not detected for longer.

    def __post_init__(self):
        if not (self.gates > 0 and self.patience_s > 0):
            raise ValueError(f"gates and patience_s must be positive, got {self}")

    def track(self, detections, _likelihood):
        tracks, live, waiting = [], [], []
        for scan, now_s in enumerate(detections.scan_s):
            points = np.arange(*detections.offsets[scan : scan + 2])
            xy = detections.xy[points]
            std_m = np.sqrt(np.trace(detections.cov[points], axis1=1, axis2=2) / 2.0)
            places = [path.at(now_s) for path in live]
            pairs = nearest_pairs(places, xy, 0.1 + self.gates * std_m)
            for row, path in enumerate(live):
                column = pairs.get(row)
                if column is None:
                    path.write(places[row], MISS)
                else:
                    path.join(now_s, xy[column], points[column])
            used = set(pairs.values())
            free = [column for column in range(points.size) if column not in used]
            ended = [path for path in live if now_s - path.seen_s > self.patience_s]
            tracks += ended
            live = [path for path in live if path not in ended]
            # Points that nobody joins begin a track with points of the scan before.
            steps = nearest_pairs(
                [place for *_, place in waiting],
                xy[free],
                np.full(len(free), MOST_STEP_M),
            )
            begun = [
                Path(scan, now_s, waiting[old], xy[free[new]], points[free[new]])
                for old, new in steps.items()
            ]
            live += begun
            taken = {free[new] for new in steps.values()}
            waiting = [
                (now_s, int(points[column]), xy[column])
                for column in free
                if column not in taken
            ]
        return join_tracks(
            Track(path.first, path.xy, path.points, path.first + 1)
            for path in [*tracks, *live]
        )


def nearest_pairs(places, xy, gate_m):
    """The point of each place, by row: nearest pairs first, nobody twice."""
    if not len(places) or not len(xy):
        return {}
    gap = np.linalg.norm(np.array(places)[:, None] - xy[None], axis=2)
    pairs = {}
    rows, columns = np.unravel_index(gap.argsort(axis=None), gap.shape)
    for row, column in zip(rows, columns, strict=True):
        is_free = row not in pairs and column not in pairs.values()
        if is_free and gap[row, column] < gate_m[column]:
            pairs[int(row)] = int(column)
    return pairs


class Path:
    """A track that grows: an alpha-beta filter, and all its states."""

    def __init__(self, scan, now_s, before, xy, point):
        then_s, old_point, old_xy = before
        self.first, self.seen_s, self.place = scan - 1, now_s, xy
        # Half of the step, since most of it may be error.
        self.velocity = 0.5 * (xy - old_xy) / (now_s - then_s)
        self.xy, self.points = [old_xy, xy], [old_point, int(point)]

    def at(self, now_s):
        return self.place + self.velocity * (now_s - self.seen_s)

    def join(self, now_s, xy, point):
        place, step_s = self.at(now_s), now_s - self.seen_s
        self.velocity = self.velocity + 0.05 * (xy - place) / step_s
        self.place, self.seen_s = place + 0.35 * (xy - place), now_s
        self.write(self.place, int(point))

    def write(self, xy, point):
        self.xy.append(xy)
        self.points.append(point)
