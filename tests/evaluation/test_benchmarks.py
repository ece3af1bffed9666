"""The benchmarks judge rightly: exponents planted, results that differ."""

import json
import math
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.small_runs import smoke, write_walks

import evaluation
import isac_track
from benchmarks import frontier_seeds, paired_linkers
from isac_track.datasets import load
from isac_track.errors import SettingsError

ROOT = Path(isac_track.__file__).parent.parent


def benchmark(name):
    """A fixture: one of the benchmarks."""

    @pytest.fixture(name=name)
    def load(monkeypatch):
        monkeypatch.syspath_prepend(str(ROOT))
        return import_module(f"benchmarks.{name}")

    return load


scale, soak = map(benchmark, ("scale", "soak"))

SIZES = np.array([2, 500, 1500, 5000, 15_000, 50_000])


class TestExponent:
    @pytest.mark.parametrize(
        ("sizes", "power", "each"),
        [
            *((SIZES, power, 2.0 / 500**power) for power in (0.8, 1.0, 1.5, 2.0)),
            (np.array([1, 4, 8, 16, 32]), 1.0, 0.5),  # whose smallest run is not small
        ],
    )
    def test_a_planted_power_is_found_behind_a_start_up(self, scale, sizes, power, each):
        # The start-up is a run of the smallest size, whose own units count as well.
        found = scale.grown(sizes, 4.0 + each * sizes.astype(float) ** power)
        assert found.net == pytest.approx(power, abs=0.01)

    def test_the_raw_exponent_flatters_and_the_net_one_does_not(self, scale):
        found = scale.grown(SIZES, 1.0 + 1e-6 * SIZES**1.5)
        assert found.raw < 0.3
        assert found.net == pytest.approx(1.5, abs=0.01)

    def test_points_within_the_noise_of_the_start_up_are_left_out(self, scale):
        wall_s = 4.0 + 6e-4 * SIZES
        wall_s[1] = 3.9  # a run of 500 that was faster than one of 2
        assert scale.grown(SIZES, wall_s).net == pytest.approx(1.0, abs=0.001)

    def test_growth_that_has_only_begun_shows_in_the_last_step(self, scale):
        found = scale.grown(SIZES, 1e-3 * SIZES + 2e-8 * SIZES.astype(float) ** 2)
        assert found.net < found.last
        # log of (50 + 50) / (15 + 4.5) on log of 50 / 15
        assert found.last == pytest.approx(math.log(100 / 19.5) / math.log(50 / 15), abs=0.002)

    def runs(self, sizes, power, *, last_mb=300.0):
        one = {"cpu_s": 3.0, "peak_mb": 300.0, "disk_mb": 1.0, "load": 0.5}
        runs = {n: [one | {"wall_s": 4.0 + 1e-3 * n**power, "cpu_s": 3.0 + n}] * 3 for n in sizes}
        runs[sizes[-1]] = [each | {"peak_mb": last_mb} for each in runs[sizes[-1]]]
        return runs

    def test_what_cannot_be_told_is_not_within_a_limit(self, scale):
        result = scale.judged(scale.AXES["scenes"], self.runs((2, 500), 0.0))
        assert math.isnan(result["exponents"]["wall_s"]["net"])
        assert not result["ok"]

    @pytest.mark.parametrize(
        ("power", "memory_mb", "ok"), [(1.0, 360, True), (1.3, 360, False), (1.0, 400, False)]
    )
    def test_both_limits_count(self, scale, power, memory_mb, ok):
        runs = self.runs((2, 500, 5000, 50_000), power, last_mb=memory_mb)
        result = scale.judged(scale.AXES["scenes"], runs)
        assert result["ok"] is ok
        assert result["memory_ratio"] == pytest.approx(memory_mb / 300)


def test_people_are_copied_as_often_as_it_takes(scale, tmp_path):
    recording = write_walks(tmp_path / "walks.csv", n_people=5)
    scale.write_people(tmp_path / "many.csv", n_people=12, recording=str(recording))
    tracks, few = (load(str(tmp_path / name)).tracks for name in ("many.csv", "walks.csv"))
    assert len(tracks) == 12
    first = {name.partition("-")[2]: one for name, one in zip(tracks.source, tracks, strict=True)}
    assert len(first) == 5
    for row in range(5):
        assert np.allclose(first[str(row)].xy, few[row].xy, atol=1e-3)


@pytest.mark.parametrize("name", ["scale", "soak"])
def test_the_commands_have_help(request, name):
    assert "exit codes: 0" in request.getfixturevalue(name).parser().format_help()


@pytest.mark.parametrize(
    ("command", "arguments", "says"),
    [
        ("scale", ("--axis", "height"), "invalid choice: 'height'"),
        ("scale", ("--repeats", "0"), "at least 1, got '0'"),
        ("soak", ("--times", "3"), "at least 4 runs, got 3"),
    ],
)
def test_wrong_usage_is_refused_by_name(request, command, arguments, says):
    parser = request.getfixturevalue(command).parser()
    with pytest.raises(SettingsError, match=says):
        parser.parse_args(arguments)


def test_a_recording_that_is_not_there_is_one_line_and_code_2(soak, monkeypatch, capsys):
    monkeypatch.setattr(soak.signal, "signal", lambda *_: None)
    assert soak.main(["--dataset", "/nowhere.csv"]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: ")


BESIDE = """
import sys
import numpy as np
from benchmarks import beside
beside.calibration_s, beside.kalman.prepare, beside.linkage_rows = lambda: 1.0, lambda: None, list
ours, wrong = lambda: [np.arange(3.0)], lambda: [np.arange(3.0) * (1 + float(sys.argv[2]))]
beside.smoothers.rows = lambda: [("sums", "numpy", ours, wrong), ("gone", "not-there", None, None)]
sys.exit(beside.main(["--json", sys.argv[1]]))
"""


@pytest.mark.parametrize(("wrong", "code"), [("1e-12", 0), ("1e-3", 1)])
def test_side_by_side_results_that_differ_are_an_error_missing_ones_a_line(wrong, code, tmp_path):
    words = [sys.executable, "-c", BESIDE, tmp_path / "said.json", wrong]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    assert "gone: not-there is missing; `pip install not-there`" in done.stderr
    assert ("error: results differ: sums" in done.stderr) == bool(code)
    (row,) = json.loads((tmp_path / "said.json").read_text())["rows"]
    assert row["theirs"].startswith("numpy ")
    assert row["largest_difference"] == pytest.approx(float(wrong), rel=1e-3)
    assert row["ratio"] == pytest.approx(row["theirs_ms"] / row["ours_ms"])


@pytest.mark.slow
def test_runs_of_one_seed_pooled_are_that_run(tmp_path):
    """Twice the same run is the run: level, descriptors and the robot's own, with intervals."""
    axes = {"predictors": ("kalman_cv",), "mechanisms": ("raw", "fixed:0.4..1.2/3")}
    settings = smoke("plaza", tmp_path / "run", scenes=250, **axes)
    one = evaluation.run(settings, pictures=False).frontier
    both = frontier_seeds.pooled([tmp_path / "run"] * 2)
    assert one["level"].notna().any()
    assert set(one["metric"]) == {"plr", "ael", "mel", "distance_mae", "plr_robot"}
    pd.testing.assert_frame_equal(one, both, check_dtype=False)


@pytest.mark.slow
def test_linkers_are_compared_where_they_know_the_same(tmp_path):
    out, names = tmp_path / "run", ("shape", "likelihood_ratio")
    axes = {"predictors": (), "attacks": names, "tasks": ("rerelease",), "mechanisms": ("raw",)}
    summary = evaluation.run(smoke("plaza", out, **axes), pictures=False).summary
    rows = summary[summary["metric"] == "rank1_g100"].set_index(["consumer", "knowledge"])
    rows = rows[rows["mechanism"] == "raw"]["value"]
    found = [one for one in paired_linkers.paired(out, names[1]) if one[0].mechanism == "raw"]
    assert [key.knowledge for key, _, _ in found] == ["blind", "informed"]
    for key, best, gap in found:
        assert best.consumer == "rerelease/shape"
        apart = rows[key.consumer, key.knowledge] - rows[best.consumer, key.knowledge]
        assert gap.value == pytest.approx(apart)
        assert gap.ci_low < gap.value < gap.ci_high
