"""The tracker of another package: found by its entry point, checked, and in a run."""

import tomllib
from importlib.metadata import EntryPoint

import pytest
from helpers.processes import ROOT
from helpers.small_runs import smoke, write_walks

import evaluation
from attacks.testing import parametrize_tracker_checks
from isac_track import plugins

FOLDER = ROOT / "examples" / "tracker-two-scan"
GROUP = "isac_track.trackers"


def entry_point():
    """The entry point that an installed package declares."""
    project = tomllib.loads((FOLDER / "pyproject.toml").read_text("utf-8"))["project"]
    ((name, value),) = project["entry-points"][GROUP].items()
    return EntryPoint(name, value, GROUP)


@pytest.fixture(autouse=True)
def _installed(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setattr(
        plugins,
        "_entry_points",
        lambda kind: (entry_point(),) if kind == "trackers" else (),
    )


def tracker():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        return entry_point().load()()


@parametrize_tracker_checks([tracker()])
def test_it_passes_the_kit(tracker, check):
    check(tracker)


@pytest.mark.usefixtures("single_process")
def test_a_run_finds_it_by_its_name(tmp_path):
    recording = write_walks(tmp_path / "walks.csv", n_people=12)
    stages = {
        "tracking.method": "two_scan:gates=2.5",
        "tracking.seeds": 1,
        "patrol.segment_s": 6.0,
        "patrol.fleets": 1,
        "sensing.sigma_cap_m": 0.1,
    }
    settings = smoke(recording, tmp_path / "run", mechanisms=("raw",), stages=stages)
    made = evaluation.run(settings, progress=False, pictures=False)
    purity = made.tracks[made.tracks["metric"] == "purity"].set_index("policy")["value"]
    assert set(purity.index) == {"tracks:oracle", "tracks:two_scan:gates=2.5"}
    assert 0.9 < purity["tracks:two_scan:gates=2.5"] < 1.0
    assert made.manifest["own_plugins"]["trackers"] == ["two_scan:gates=2.5"]
