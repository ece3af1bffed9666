"""Compare trackers between a sensing network's detections and the tracks it shares.

    python examples/tracking.py --dataset plaza --set patrol.segment_s=60
    python examples/tracking.py --dataset students03 --tracker oracle --tracker gnn
    python examples/tracking.py --dataset run.txt --format pedpy --fps 16 --unit cm
    python examples/tracking.py --error 0.1 --error range_bearing:trace

The network detects people scan by scan, with misses and clutter, and a tracker joins
its detections. A mechanism adds noise before tracking or after. Every row has metrics
of tracking, what an adversary knows from the tracks, and what a Kalman robot misses.
Intervals are 95 % over blocks of the recording and seeds of sensing, conditional on the
recording. docs/explanation/tracking.md explains every column.
"""

# ruff: noqa: T201 - a comparison is printed

import argparse
from collections import defaultdict
from dataclasses import dataclass, field, replace

import numpy as np

from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.errors import IsacTrackError, SettingsError
from isac_track.patrols import (
    Patrol,
    horizon_scans,
    make_patrol,
    scans_per_query,
    sense_people,
)
from isac_track.patrols.knowledge import guesses_from_map
from isac_track.patrols.utility import first_entries, true_conflicts
from isac_track.place import placed
from isac_track.plugins import parse
from isac_track.sharing import Raw
from isac_track.tracking import (
    METHODS,
    DetectionSettings,
    Likelihood,
    TrackerSettings,
    clutter_density,
    detect_people,
    run_tracker,
)
from isac_track.tracking.blocks import block_ratio
from isac_track.tracking.counts import (
    GOSPA_CUTOFF_M,
    Blocks,
    robot_counts,
    track_counts,
)
from isac_track.tracking.knowledge import TRACK_ESTIMATORS, known_instants
from isac_track.tracking.metrics import GospaScans, gospa_scans
from isac_track.tracking.sharing import (
    SharedTracks,
    perturb_detections,
    share_tracks,
)
from isac_track.tracking.utility import foresee_from_tracks
from predictors.kalman import KalmanCV

MECHANISMS = (
    "raw",
    "fid:1,adding=independent",
    "fixed:0.7,adding=independent",
    "ou:0.4",
)
ERRORS = ("fitted",)
AS_SENT = TRACK_ESTIMATORS.index("interpolate")  # Lines between samples: no smoother.
LEAST_DENSITY_PER_M2 = 0.005  # Of new people, which a tracker assumes without clutter.
COLUMNS = {
    "purity": "purity, %",
    "id_switches": "switches a person-minute",
    "fragments": "fragments a person-minute",
    "gospa": "GOSPA, m",
    "ospa": "OSPA, m",
    "missed_people": "missed a scan, % of people",
    "false_tracks": "false a scan, per person",
    "known_as_sent": "known as sent, %",
    "known_share": "known, %",
    "missed_future_rate": "robot misses, %",
    "false_alarms": "queries with a false alarm, %",
}
SHARES = (
    *("purity", "missed_people", "known_as_sent", "known_share"),
    "missed_future_rate",
)
PERCENT = (*SHARES, "false_alarms")


@dataclass(frozen=True)
class Scene:
    """A recording with its routes, and how its network detects people."""

    patrol: Patrol
    settings: StageSettings
    detection: DetectionSettings
    guesses: np.ndarray
    actual: np.ndarray
    entries: np.ndarray
    block_s: float

    @property
    def blocks(self):
        """Blocks of the recording, which intervals draw."""
        return Blocks(self.patrol, self.block_s)


@dataclass
class Row:
    """Counts of a row, by metric: a (numerator, denominator) of blocks each seed."""

    names: tuple[str, ...]
    counts: dict = field(default_factory=lambda: defaultdict(list))
    known: list = field(default_factory=list)  # (J, B) instants each seed.

    def estimates(self, seed):
        """Return each metric with its interval."""
        best = int(np.sum(self.known, axis=(0, 2)).argmax())
        counts = dict(self.counts)
        instants = [bottom for _, bottom in counts["known_share"]]
        counts["known_share"] = list(
            zip([known[best] for known in self.known], instants, strict=True)
        )
        return TRACK_ESTIMATORS[best], {
            name: block_ratio(
                numerator=np.stack([top for top, _ in pairs], axis=1),
                denominator=np.stack([bottom for _, bottom in pairs], axis=1),
                seed=seed,
                is_share=name in SHARES,
            )
            for name, pairs in counts.items()
        }


def make_scene(tracks, error, *, detection, settings, block_s, seed):
    """Place a recording and set up its errors, which an option names."""
    kind, _, scaling = error.partition(":")
    if kind == "range_bearing":
        detection = replace(detection, measurement=kind, scaling=scaling or "trace")
    elif error != "fitted":
        settings = settings.changed({"sensing.sigma_cap_m": error})
    patrol = make_patrol(
        placed(tracks, settings=settings), settings=settings, seed=seed
    )
    return Scene(
        patrol=patrol,
        settings=settings,
        detection=detection,
        guesses=guesses_from_map(patrol, epsilon_m=settings.privacy.epsilon_m),
        actual=true_conflicts(
            patrol, safety_radius_m=settings.conflict.safety_radius_m
        ),
        entries=first_entries(
            patrol, safety_radius_m=settings.conflict.safety_radius_m
        ),
        block_s=block_s,
    )


def tracker_settings(scene, method):
    """Return a tracker that knows how its network detects people."""
    probability = scene.detection.probability
    density = clutter_density(scene.patrol, settings=scene.detection)
    return TrackerSettings(
        method=method,
        likelihood=Likelihood(
            detection_probability=float(
                np.clip(0.9 if probability is None else probability, 0.1, 0.99)
            ),
            density_per_m2=max(density, LEAST_DENSITY_PER_M2),
        ),
    )


@dataclass(frozen=True)
class Variant:
    """Tracks under a mechanism that acts before tracking or after."""

    mechanism: str
    when: str
    shared: SharedTracks
    gospa: GospaScans


def variants(scene, method, mechanisms, *, seed):
    """Yield the tracks of a tracker under each mechanism, before and after."""
    patrol = scene.patrol
    sensed = sense_people(patrol, settings=scene.settings, seed=seed)
    detected = detect_people(
        patrol,
        sensed,
        settings=scene.detection,
        sensing=scene.settings.sensing,
        seed=seed,
    )
    tracker = tracker_settings(scene, method)
    tracked = run_tracker(detected, settings=tracker)
    scans = gospa_scans(patrol, tracked, cutoff_m=GOSPA_CUTOFF_M)
    for mechanism in mechanisms:
        name, instance = mechanism.spec, mechanism.instance
        if isinstance(instance, Raw):
            yield Variant(name, "-", share_tracks(detected, tracked, seed=seed), scans)
            continue
        noisy = perturb_detections(detected, mechanism=instance, seed=seed)
        again = run_tracker(noisy, settings=tracker)
        yield Variant(
            name,
            "before",
            share_tracks(noisy, again, seed=seed),
            gospa_scans(patrol, again, cutoff_m=GOSPA_CUTOFF_M),
        )
        after = share_tracks(detected, tracked, mechanism=instance, seed=seed)
        yield Variant(name, "after", after, scans)


def add_tracking(row, scene, shared, scans):
    """Add the counts of the tracking field."""
    for name, counts in track_counts(scene.blocks, shared, scans).items():
        row.counts[name].append((counts.numerator, counts.denominator))


def add_answers(row, scene, shared):
    """Add what an adversary knows and what robots miss."""
    patrol, rules = scene.patrol, scene.settings
    known = known_instants(
        patrol,
        shared,
        guesses=scene.guesses,
        epsilon_m=rules.privacy.epsilon_m,
        estimators=TRACK_ESTIMATORS,
    )
    blocks = scene.blocks
    row.known.append(np.stack([blocks.count(patrol.grid.t[flags]) for flags in known]))
    instants = blocks.count(patrol.grid.t)
    row.counts["known_share"].append((None, instants))
    row.counts["known_as_sent"].append((row.known[-1][AS_SENT], instants))
    horizon = horizon_scans(rules)[-1]
    foresight = foresee_from_tracks(
        patrol,
        shared,
        predictor=KalmanCV(),
        safety_radius_m=rules.conflict.safety_radius_m,
        horizons=(horizon,),
    )
    counts = robot_counts(
        blocks,
        foresight,
        actual=scene.actual,
        entries=scene.entries,
        horizon=horizon,
        scans_per_query=scans_per_query(rules.patrol),
    )
    for name, part in (
        ("missed_future_rate", counts.shares["missed_future_rate"]),
        ("false_alarms", counts.false_queries),
    ):
        row.counts[name].append((part.numerator, part.denominator))


def compare(
    tracks, *, errors, methods, mechanisms, detection, settings, seeds, block_s, seed
):
    """Return the rows of a recording."""
    rows = {}
    for error in errors:
        scene = make_scene(
            tracks,
            error,
            detection=detection,
            settings=settings,
            block_s=block_s,
            seed=seed,
        )
        for sensing_seed in range(seed, seed + seeds):
            for method in methods:
                for variant in variants(scene, method, mechanisms, seed=sensing_seed):
                    names = (error, method, variant.mechanism, variant.when)
                    row = rows.setdefault(names, Row(names))
                    add_tracking(row, scene, variant.shared, variant.gospa)
                    add_answers(row, scene, variant.shared)
    return list(rows.values())


def written(name, estimate):
    """Format a number and its interval, as percent where it is a share."""
    scale, digits = (100.0, 1) if name in PERCENT else (1.0, 2)
    value, low, high = (
        f"{scale * number:.{digits}f}"
        for number in (estimate.value, estimate.ci_low, estimate.ci_high)
    )
    return value if low == "nan" else f"{value} [{low}, {high}]"


def report(rows, *, seed):
    """Yield the lines of the table."""
    heads = ["error", "tracker", "noise", "added", *COLUMNS.values(), "estimator"]
    yield "| " + " | ".join(heads) + " |"
    yield "|" + "---|" * len(heads)
    for row in rows:
        estimator, metrics = row.estimates(seed)
        numbers = [written(name, metrics[name]) for name in COLUMNS]
        yield "| " + " | ".join([*row.names, *numbers, estimator]) + " |"


def options(words):
    parser = argparse.ArgumentParser(
        description="From detections to tracks: trackers compared on a recording."
    )
    parser.add_argument("--dataset", default="plaza")
    parser.add_argument("--format", help="of a file of your own")
    parser.add_argument("--fps", type=float, help="frames per second of the file")
    parser.add_argument("--unit", help="unit of the file's coordinates")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=5, help="seeds of sensing")
    parser.add_argument("--block", type=float, default=10.0, help="block length, s")
    parser.add_argument("--tracker", action="append", help=" ".join(METHODS))
    parser.add_argument(
        "--mechanism", action="append", metavar="SPEC", help=" ".join(MECHANISMS)
    )
    parser.add_argument(
        "--error",
        action="append",
        help="fitted, a cap of the error in m, or range_bearing:trace, :information",
    )
    parser.add_argument(
        "--probability", default="0.9", help="of a detection, or `link`: link budget"
    )
    parser.add_argument("--clutter", type=float, default=3.0, help="points a scan")
    parser.add_argument("--antennas", type=int, default=8, help="of the array")
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.KEY=VALUE")
    return parser.parse_args(words)


def detection_settings(given):
    """Return how the network detects people."""
    try:
        probability = None if given.probability == "link" else float(given.probability)
    except ValueError:
        raise SettingsError(
            f"--probability must be a number or link, got {given.probability!r}"
        ) from None
    return DetectionSettings(
        probability=probability,
        clutter_per_scan=given.clutter,
        n_antennas=given.antennas,
    )


def comparison(given):
    """Yield the lines of the comparison."""
    if given.seeds < 1 or not given.block > 0.0:
        raise SettingsError("--seeds must be at least 1 and --block positive")
    settings = StageSettings().changed(
        dict(change.partition("=")[::2] for change in given.set)
    )
    reading = {
        name: value
        for name, value in vars(given).items()
        if name in ("format", "fps", "unit") and value is not None
    }
    dataset = datasets.load(given.dataset, **reading)
    methods = given.tracker or ["oracle", "gnn"]
    for method in methods:
        TrackerSettings(method=method)  # Checks the name before a long computation.
    rows = compare(
        dataset.tracks,
        errors=given.error or ERRORS,
        methods=methods,
        mechanisms=[
            plugin
            for spec in given.mechanism or MECHANISMS
            for plugin in parse("mechanisms", spec)
        ],
        detection=detection_settings(given),
        settings=settings,
        seeds=given.seeds,
        block_s=given.block,
        seed=given.seed,
    )
    yield (
        f"{dataset.name}: detection probability {given.probability}, {given.clutter:g}"
        f" points of clutter a scan, {given.seeds} sensing seeds, blocks of"
        f" {given.block:g} s. Conditional on this recording."
    )
    yield ""
    yield from report(rows, seed=given.seed)


def main(words=None):
    given = options(words)
    try:
        for line in comparison(given):
            print(line, flush=True)
    except IsacTrackError as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()
