"""Trackers as plug-ins: their parameters, and what they must return."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.detections import make_detected

from isac_track.errors import PluginError, SettingsError
from isac_track.plugins import parse
from isac_track.tracking import (
    Likelihood,
    TrackerSettings,
    run_tracker,
    track_detections,
    track_patrol,
)
from isac_track.tracking.methods import GNN, JPDA, Genie, Oracle, check_tracked

LIKELIHOOD = Likelihood()


@pytest.fixture(scope="module")
def detected():
    return make_detected(
        [[(0, 0.1 * scan, 0.0), (1, 0.1 * scan, 4.0)] for scan in range(12)]
    )


@dataclass(frozen=True)
class Given:
    """A tracker that returns what it was given."""

    answer: object = None

    def track(self, _detections, _likelihood):
        return self.answer


@pytest.mark.parametrize(
    ("spec", "tracker", "method"),
    [
        ("gnn", GNN(), "gnn"),
        ("jpda", JPDA(), "jpda"),
        ("oracle", Oracle(), "oracle"),
        ("genie", Genie(), "genie"),
    ],
)
def test_a_name_is_its_method(detected, spec, tracker, method):
    (plugin,) = parse("trackers", spec)
    assert (plugin.instance, plugin.spec) == (tracker, spec)
    made = track_patrol(plugin.instance, detected, likelihood=LIKELIHOOD)
    settings = TrackerSettings(method=method, likelihood=LIKELIHOOD)
    expected = run_tracker(detected, settings=settings)
    for name in ("scan", "xy", "detection", "offsets", "confirmed"):
        np.testing.assert_array_equal(getattr(made, name), getattr(expected, name))
    assert len(made) == 2


@pytest.mark.parametrize("kind", [GNN, JPDA])
def test_parameters_reach_the_life_cycle(detected, kind):
    tracker = kind(confirm_hits=1, confirm_scans=2, most_misses=0, q=0.1)
    made = track_patrol(tracker, detected, likelihood=LIKELIHOOD)
    settings = TrackerSettings(
        method=kind.__name__.lower(),
        q=0.1,
        confirm_hits=1,
        confirm_scans=2,
        most_misses=0,
    )
    expected = track_detections(detected.detections, settings=settings)
    np.testing.assert_array_equal(made.confirmed, expected.confirmed)
    np.testing.assert_array_equal(made.xy, expected.xy)
    assert (made.confirmed == 0).all()
    with pytest.raises(SettingsError, match="confirmed at 1 to 5 detections"):
        kind(confirm_hits=6)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: {"scan": t.scan + 1}, "scans must lie in 0 to 11"),
        (lambda t: {"scan": 2 * t.scan}, "a state at every scan"),
        (lambda t: {"detection": t.detection[::-1]}, "must be of its scan"),
        (lambda t: {"detection": t.detection + 99}, "must lie in -1 to 23"),
        (lambda t: {"detection": np.full(t.scan.size, -1)}, "begin with a detection"),
        (lambda t: {"confirmed": t.confirmed + 99}, "confirmed between its first"),
        (lambda t: {"confirmed": t.confirmed[:1]}, "a scan for each track"),
        (lambda t: {"offsets": t.offsets[:-1]}, "offsets must run from 0"),
        (lambda t: {"offsets": t.offsets * [1, 0, 1]}, "a track must have a state"),
        (lambda t: {"xy": t.xy[:, :1]}, "xy must be"),
        (lambda t: {"xy": t.xy * np.nan}, "must be finite"),
        (lambda t: {"scan": t.scan * 1.0}, "must be whole numbers"),
    ],
)
def test_impossible_tracks_are_refused_by_name(detected, change, says):
    tracked = track_patrol(GNN(), detected, likelihood=LIKELIHOOD)
    check_tracked(tracked, detected.detections)
    wrong = Given(replace(tracked, **change(tracked)))
    with pytest.raises(PluginError, match=f"tracker Given .*{says}"):
        track_patrol(wrong, detected, likelihood=LIKELIHOOD)


def test_anything_else_is_no_tracks(detected):
    with pytest.raises(PluginError, match="must return a Tracked, got NoneType"):
        track_patrol(Given(), detected, likelihood=LIKELIHOOD)
