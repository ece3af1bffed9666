"""The example that compares trackers: a small run, its table, and what it refuses."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import isac_track
from isac_track.config import StageSettings
from isac_track.plugins import parse
from isac_track.tracking import DetectionSettings

EXAMPLE = Path(isac_track.__file__).parents[1] / "examples" / "tracking.py"
FEW = {"patrol.fleets": 2, "patrol.segment_s": 6.0}


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("tracking_example", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def compare(example, tracks, *, methods, mechanisms, errors=("fitted",), seeds=1):
    rows = example.compare(
        tracks,
        errors=errors,
        methods=methods,
        mechanisms=[
            plugin for spec in mechanisms for plugin in parse("mechanisms", spec)
        ],
        detection=DetectionSettings(),
        settings=StageSettings().changed(FEW),
        seeds=seeds,
        block_s=3.0,
        seed=0,
    )
    return {row.names: row.estimates(0)[1] for row in rows}


def values(metrics):
    return {name: estimate.value for name, estimate in metrics.items()}


def test_a_row_depends_on_no_other_tracker_mechanism_or_error(example, tracks):
    alone = compare(example, tracks, methods=["gnn"], mechanisms=["ou:0.4"])
    among = compare(
        example,
        tracks,
        methods=["oracle", "gnn"],
        mechanisms=["raw", "ou:0.4"],
        errors=["range_bearing:information", "fitted"],
    )
    assert [names[-1] for names in alone] == ["before", "after"]
    assert len(among) == 2 * 2 * 3
    for names, metrics in alone.items():
        np.testing.assert_equal(values(among[names]), values(metrics))
        assert set(metrics) == set(example.COLUMNS)


def test_prints_a_row_for_every_tracker_mechanism_and_time(
    example, capsys, csv_recording
):
    words = ["--dataset", str(csv_recording), "--seeds", "1", "--block", "3"]
    words += ["--tracker", "gnn", "--mechanism", "raw", "--mechanism", "fid:1"]
    for name, value in FEW.items():
        words += ["--set", f"{name}={value}"]
    example.main(words)
    lines = capsys.readouterr().out.splitlines()
    assert "Conditional on this recording" in lines[0]
    rows = [
        line.split(" | ")[2:4] for line in lines if line.startswith("| fitted | gnn")
    ]
    assert rows == [["raw", "-"], ["fid:1", "before"], ["fid:1", "after"]]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--tracker", "gmm"], "unknown tracker 'gmm'"),
        (["--probability", "most"], "--probability must be a number or link"),
        (["--probability", "1.5"], "must be in 0..1"),
        (["--clutter", "-1"], "clutter_per_scan must not be negative"),
        (["--seeds", "0"], "--seeds must be at least 1"),
        (["--block", "0"], "--block positive"),
        (["--error", "range_bearing:mean"], "unknown scaling 'mean'"),
        (["--error", "large"], "sensing.sigma_cap_m"),
        (["--antennas", "1"], "2 antennas"),
        (["--mechanism", "window:1"], "does not share every sample"),
    ],
)
def test_a_mistake_ends_in_a_line(example, csv_recording, words, message):
    segment = ["--set", "patrol.segment_s=4", "--set", "patrol.fleets=1"]
    with pytest.raises(SystemExit, match=message):
        example.main(["--dataset", str(csv_recording), *segment, *words])
