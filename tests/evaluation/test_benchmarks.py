"""The benchmarks judge rightly: exponents and growth planted, memory known beforehand."""

import json
import math
import subprocess
import sys
import tempfile
import time
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
from isac_track.errors import DataError, SettingsError
from isac_track.rng import stream

ROOT = Path(isac_track.__file__).parent.parent

HOLDS_50_MB = """
import subprocess, sys
child = "held = b'x' * 50_000_000; print(flush=True); input()"
if sys.argv[1:] == ["below"]:
    below = subprocess.Popen([sys.executable, "-c", child], stdout=subprocess.PIPE)
    below.stdout.readline()
    print(flush=True)
    below.wait()
else:
    exec(child if sys.argv[1:] == ["here"] else "print(flush=True); input()")
"""


def benchmark(name):
    """A fixture: one of the benchmarks."""

    @pytest.fixture(name=name)
    def load(monkeypatch):
        monkeypatch.syspath_prepend(str(ROOT))
        return import_module(f"benchmarks.{name}")

    return load


scale, planted_faults, processes, soak = map(
    benchmark, ("scale", "planted_faults", "processes", "soak")
)


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


class TestMemory:
    @pytest.fixture
    def holding(self):
        started = []

        def start(where):
            process = subprocess.Popen(
                [sys.executable, "-c", HOLDS_50_MB, where],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            started.append(process)
            process.stdout.readline()
            return process

        yield start
        for process in started:
            process.communicate()  # its input ends, and so does it
            assert process.returncode is not None

    @pytest.mark.parametrize("where", ["here", "below"])
    def test_50_mb_are_50_mb_in_a_process_and_in_its_child(self, processes, holding, where):
        idle, full = holding("nowhere"), holding(where)
        extra = processes.tree_pss_mb(full.pid) - processes.tree_pss_mb(idle.pid)
        # A child interpreter of its own takes about 5 MB beside what it holds.
        assert 49 < extra < 51 if where == "here" else 50 < extra < 70
        assert len(processes.descendants(full.pid)) == (1 if where == "below" else 0)


class TestSoakGrowth:
    NOISE = stream(1, "test", "soak").normal(0, 2, 20)

    @pytest.mark.parametrize(
        ("values", "grown", "last_over_third", "ok"),
        [
            ([900.0, 990.0, *[1000.0] * 18], 0.0, 1.0, True),
            (1000 + 5 * NOISE, 0.0, 1.0, True),
            (1000 + 100 * (np.arange(20) - 2) / 20 + NOISE, 0.1, 1.1, False),
            ([*[1000.0] * 19, 1500.0], 0.0, 1.5, True),  # one high run is no leak
            ([100.0, 500.0, *[1000.0] * 10], 0.0, 1.0, True),  # the first two runs warm up
        ],
    )
    def test_a_leak_is_told_from_noise(self, soak, values, grown, last_over_third, ok):
        found = soak.growth(list(values))
        assert found.ok is ok
        assert found.low <= found.grown <= found.high
        assert found.grown == pytest.approx(grown, abs=0.03)
        assert found.last_over_third == pytest.approx(last_over_third, abs=0.05)
        assert (found.low > soak.MOST_GROWTH) is not ok


class TestSoakPlace:
    def test_what_is_left_shows_and_everything_is_put_back(self, soak, monkeypatch, tmp_path):
        monkeypatch.chdir(tmp_path)
        before = tempfile.gettempdir()
        with soak.own_place() as watched:
            assert not soak.files_left(watched, shared_before=soak.shared_files())
            with Path("results.txt").open("w") as file:
                file.write("left in the working directory")
            folder = Path(tempfile.mkdtemp())
            left = soak.files_left(watched, shared_before=soak.shared_files())
            assert left == {watched[0] / "results.txt", folder}
        assert Path.cwd() == tmp_path
        assert tempfile.gettempdir() == before
        assert not watched[0].parent.exists()

    def test_a_child_has_a_name_until_it_is_collected(self, processes):
        child = subprocess.Popen([sys.executable, "-c", "pass"])
        deadline = time.monotonic() + 10
        while "not collected" not in processes.command_of(child.pid):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        child.wait()
        assert "gone" in processes.command_of(child.pid)


class TestPlantedFaults:
    def every(self, planted_faults, tmp_path, source):
        """Every fault of a source, as the line that holds it."""
        path = tmp_path / "one.py"
        path.write_text(source)
        for one in planted_faults.statements(path, root=tmp_path):
            for _, node, text in one.rewrites:
                yield planted_faults.rewritten(source.encode(), node, text).decode()

    @pytest.mark.parametrize(
        ("sound", "faulty"),
        [
            ("x = a < b", {"x = (a >= b)"}),
            ("x = a - 2", {"x = (a + 2)", "x = a - 3"}),
            ("assert a", {"assert not (a)"}),
            ("x = f(a, key=b)", {"x = f(a)"}),
            ("x = not a", {"x = (a)"}),
            ("x = max(é, a)", {"x = min(é, a)"}),
            ("x = 'key' in a", {"x = ('key' not in a)", "x = 'keyx' in a"}),
            ("'prose stays, and so does what is inside f-strings'", set()),
            ("x = f'{a + b}'", set()),
            ("x += 1", {"x -= 1", "x += 2"}),
        ],
    )
    def test_of_a_statement(self, planted_faults, tmp_path, sound, faulty):
        assert set(self.every(planted_faults, tmp_path, sound)) == faulty

    @pytest.mark.slow
    def test_are_found_by_the_tests_that_reach_them(self, planted_faults, tmp_path):
        tree = tmp_path / "tree"
        for name, source in {
            "evaluation/__init__.py": "",
            "evaluation/sums.py": "def add(a, b):\n    return a + b\n\n\n"
            "def never(a):\n    return a - 1\n",
            "tests/test_sums.py": "from evaluation.sums import add\n\n\n"
            "def test_add():\n    assert add(2, 1) == 3\n\n\n"
            "def test_other():\n    raise AssertionError\n",
        }.items():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            (tree / name).write_text(source)
        words = [sys.executable, planted_faults.__file__, "--tree", tree, "--tests", "tests"]
        words += ["--json", tmp_path / "said.json"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        said = json.loads((tmp_path / "said.json").read_text())
        assert said["suite"]["failed"] == ["tests/test_sums.py::test_other"]
        assert (said["planted"], said["killed"]) == (2, 1)
        faults = {one["line"]: one for one in said["faults"]}
        assert faults[2]["killed_by"] == "tests/test_sums.py::test_add"
        assert (faults[6]["killed_by"], faults[6]["tests"]) == ("", 0)
        assert "return a + b" in (tree / "evaluation" / "sums.py").read_text()
        assert "survived 0" in done.stdout


def run(*arguments):
    return subprocess.run(
        [sys.executable, "-m", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )


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


@pytest.mark.slow
def test_a_quick_measurement_of_growth(tmp_path):
    words = ("--quick", "--axis", "people", "--axis", "scenes", "--json", tmp_path / "said.json")
    done = run("benchmarks.scale", *words, "--", "--mechanism", "raw")
    assert done.returncode in (0, 1), done.stderr
    axes = {one["axis"]: one for one in json.loads((tmp_path / "said.json").read_text())["axes"]}
    assert set(axes) == {"people", "scenes"}
    assert done.returncode == (0 if all(one["ok"] for one in axes.values()) else 1)
    for one in axes.values():
        names = ("wall_s", "cpu_s", "peak_mb", "disk_mb")
        assert all(point[name] > 0 for point in one["points"] for name in names)
    first, *_, last = axes["people"]["points"]
    assert last["cpu_s"] > first["cpu_s"]


@pytest.mark.slow
def test_a_short_soak():
    options = ("--times", "4", "--preset", "smoke", "--scenes", "10", "--json", "--jobs", "2")
    done = run("benchmarks.soak", *options)
    assert done.returncode in (0, 1), done.stderr
    found = json.loads(done.stdout)
    assert len(found["runs"]) == 4
    # Workers end with their run.
    assert found["left"]["children"] == []
    assert found["left"]["threads"] == []


class TestDefaultRun:
    RUN = """
import sys, time, pathlib
folder = pathlib.Path(sys.argv[1])
(folder / "cells").mkdir(parents=True)
held, until = b"x" * 40_000_000, time.process_time() + 0.4
while time.process_time() < until: pass
(folder / "cells" / "one").write_bytes(b"0" * 1000)
time.sleep(0.5)
(folder / "cells" / "two").write_bytes(b"0" * 500)
(folder / "verdict.json").write_text("{}")
"""

    @pytest.fixture
    def default_run(self, monkeypatch):
        monkeypatch.syspath_prepend(str(ROOT))
        return import_module("benchmarks.default_run")

    def test_what_a_process_takes_is_told(self, default_run, tmp_path):
        found = default_run.measure(["-c", self.RUN, str(tmp_path / "run")], tree=tmp_path)
        assert found["cpu_s"] >= 0.4
        assert found["wall_s"] >= 0.9
        assert found["peak_mb"] > 40
        assert (found["files"], found["disk_mb"]) == (3, pytest.approx(0.001502))
        assert sum(found["stages"].values()) == pytest.approx(found["wall_s"], abs=0.01)
        assert found["stages"]["cells"] == pytest.approx(0.5, abs=0.4)

    def test_a_run_that_failed_is_no_measurement(self, default_run, tmp_path):
        with pytest.raises(DataError, match="ended with 3: no room"):
            default_run.measure(
                ["-c", "import sys; print('no room', file=sys.stderr); sys.exit(3)", "out"],
                tree=tmp_path,
            )


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
def test_side_by_side_results_that_differ_are_an_error_and_what_is_missing_a_line(
    wrong, code, tmp_path
):
    words = [sys.executable, "-c", BESIDE, tmp_path / "said.json", wrong]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    assert "gone: not-there is missing; `pip install not-there`" in done.stderr
    assert ("error: results differ: sums" in done.stderr) == bool(code)
    (row,) = json.loads((tmp_path / "said.json").read_text())["rows"]
    assert row["theirs"].startswith("numpy ")
    assert row["largest_difference"] == pytest.approx(float(wrong), rel=1e-3)
    assert row["ratio"] == pytest.approx(row["theirs_ms"] / row["ours_ms"])


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
