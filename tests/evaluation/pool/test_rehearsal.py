"""A dry run fails where the run would, and says how long that will take."""

import json
import re
from dataclasses import replace
from itertools import chain
from typing import get_args, get_type_hints

import pytest
from helpers.commands import FEW, assert_refused
from helpers.processes import ROOT
from helpers.small_runs import write_walks

from evaluation import matrix
from evaluation.compute.plugin_call import PluginTime
from evaluation.plan.axes import expand_axes
from evaluation.plan.consumer import Consumer
from evaluation.plan.plan import make_plan
from evaluation.plan.settings import Settings
from evaluation.pool import duration
from evaluation.pool.duration import expected_s, in_words, measured_rates, rate_name

pytestmark = pytest.mark.usefixtures("cut_once")

BROKEN = """
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Broken:
    requires: ClassVar[frozenset] = frozenset()
    uses: ClassVar[frozenset] = frozenset()

    def fit(self, context):
        raise RuntimeError("it never worked")
"""


COPIES = """
from dataclasses import dataclass
from typing import ClassVar

from isac_track.types import Reconstruction


@dataclass(frozen=True)
class Copies:
    requires: ClassVar[frozenset] = frozenset()
    uses: ClassVar[frozenset] = frozenset()

    def fit(self, context):
        return lambda release: Reconstruction(release.xy)
"""


@pytest.fixture(scope="module")
def usual():
    return make_plan(Settings(preset="smoke", dataset="plaza", jobs=2))


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """A recording that is laid out sooner than the simulated plaza."""
    return write_walks(tmp_path_factory.mktemp("walks") / "walks.csv")


@pytest.fixture
def dry(walks):
    """The words of a dry run."""
    return (*FEW, "--dataset", walks, "--dry-run")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def attack_consumers(unit):
    """The attacks among the consumers of a unit, by key."""
    return {
        key: consumer
        for key, consumer in unit.consumers.items()
        if consumer.kind == "attack"
    }


def everything_in(folder):
    return sorted(path.name for path in folder.rglob("*"))


def test_it_leaves_no_trace_and_says_how_long(here, dry, ran):
    ended = ran(matrix, *dry)
    assert ended.code == 0
    assert re.search(r"about \d+ s on 1 core", ended.err)
    assert everything_in(here) == []


def test_a_folder_of_another_run_is_refused(here, dry, ran):
    words = [word for word in dry if word != "--dry-run"]
    done = ran(matrix, *words, "--scenes", "8", "--no-pictures", "--out", "run")
    assert done.code == 0
    before = everything_in(here)
    assert_refused(
        ran(matrix, *dry, "--out", "run"), "holds another run (scenes 8 -> 40)"
    )
    assert ran(matrix, *dry, "--out", "run", "--fresh").code == 0
    assert everything_in(here) == before


@pytest.mark.usefixtures("here")
def test_a_place_where_nothing_can_be_written_is_refused(dry, ran):
    assert_refused(ran(matrix, *dry, "--out", "/proc/run"), "choose another --out")


def test_a_plugin_that_fails_is_refused(here, walks, ran, monkeypatch):
    monkeypatch.syspath_prepend(here)
    (here / "broken_in_fit.py").write_text(BROKEN, encoding="utf-8")
    words = [
        "--preset",
        "smoke",
        "--dataset",
        walks,
        "--task",
        "none",
        "--mechanism",
        "raw",
    ]
    words += ["--attack", "broken_in_fit:Broken", "--dry-run"]
    ended = ran(matrix, *words)
    assert_refused(ended, "it never worked", "found by a call on a few made-up people")
    names = everything_in(here)
    assert [
        name
        for name in names
        if "__pycache__" not in name and not name.endswith(".pyc")
    ] == ["broken_in_fit.py"]


def test_it_says_that_a_plugin_was_timed(here, walks, ran, monkeypatch):
    monkeypatch.syspath_prepend(here)
    (here / "copies_all.py").write_text(COPIES, encoding="utf-8")
    words = ["--preset", "smoke", "--dataset", walks, "--task", "none"]
    words += ["--mechanism", "raw", "--attack", "copies_all:Copies", "--dry-run"]
    ended = ran(matrix, *words)
    assert ended.code == 0
    assert "with copies_all:Copies, as timed on a few made-up people" in ended.err
    assert "without" not in ended.err


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--set", "resample.min_duration_s=500"), "track"),
        (("--task", "cross_session", "--attack", "profile"), "session"),
        (("--mechanism", "rw"), "did you mean 'raw'?"),
    ],
)
def test_what_the_recording_cannot_do_is_refused(walks, ran, words, says):
    command = ("--preset", "smoke", "--dataset", walks, "--dry-run", *words)
    assert_refused(ran(matrix, *command), says)


class TestHowLong:
    def test_every_built_in_consumer_has_a_rate(self):
        crossed = expand_axes(Settings(preset="paper"))
        # Of plaza, where nobody comes back.
        linkage = crossed.linkage
        tasks = [task for task in linkage.tasks if not task.links_returning_people]
        readers = [linkage.consumers(task) for task in tasks]
        names = {rate_name(item) for item in chain(crossed.scenes.consumers, *readers)}
        assert names <= measured_rates().keys()
        assert all(rate > 0 for rate in measured_rates().values())

    def test_every_kind_of_consumer_has_a_rate(self):
        kinds = get_args(get_type_hints(Consumer)["kind"])
        known = {name.partition("/")[0] for name in measured_rates()}
        assert {Consumer(kind).kind_in_files for kind in kinds} <= known

    def test_more_work_takes_longer_and_more_workers_less(self, usual):
        result = replace(usual, jobs=1)
        many = make_plan(Settings(preset="smoke", dataset="plaza", jobs=2, scenes=1000))
        assert expected_s(usual) < expected_s(result)
        assert expected_s(usual) < expected_s(many)

    def test_it_is_the_sum_of_rates_times_sizes(self, usual, monkeypatch):
        few = replace(usual, units=(usual.units[0],), jobs=1)
        rates = dict.fromkeys(measured_rates(), 0.0)
        monkeypatch.setattr(duration, "measured_rates", lambda: rates)
        idle_s = expected_s(few)
        rates["shared"] = 1e6  # A second for each sample.
        n_samples = usual.scene_tracks.offsets[-1] / len(usual.scene_tracks) * 40 * 4
        assert expected_s(few) - idle_s == pytest.approx(1.12 * n_samples, rel=1e-9)

    def test_the_time_of_a_plugin_comes_on_top_in_each_of_its_cells(self, usual):
        units = [
            replace(unit, consumers=attack_consumers(unit)) for unit in usual.units
        ]
        attacked = tuple(unit for unit in units if unit.consumers and not unit.world)
        alone = replace(usual, units=attacked, jobs=1)
        n_cells = sum(
            consumer.plugin.spec == "kalman_rts"
            for unit in attacked
            for consumer in unit.consumers.values()
        )
        n_samples = usual.scene_tracks.offsets[-1] / len(usual.scene_tracks) * 40 * 4
        fixed_s, all_samples_s = 7.0, 2.0
        time = PluginTime(fixed_s, all_samples_s * 1e6 / n_samples)
        added_s = expected_s(alone, {("attack", "kalman_rts"): time})
        added_s -= expected_s(alone)
        assert n_cells > 0
        expected = 1.12 * n_cells * (fixed_s + all_samples_s)
        assert added_s == pytest.approx(expected, rel=1e-9)

    @pytest.mark.parametrize(
        ("seconds", "jobs", "text"),
        [
            (1.0, 1, "about 5 s on 1 core"),
            (26.4, 2, "about 25 s on 2 cores"),
            (119.0, 4, "about 120 s on 4 cores"),
            (600.0, 2, "about 10 min on 2 cores"),
            (3 * 3600.0, 2, "about 3.0 h on 2 cores"),
        ],
    )
    def test_in_words(self, seconds, jobs, text):
        assert in_words(seconds, jobs=jobs) == text

    def test_rates_are_read_where_they_are_written(self):
        path = duration.rates_path(ROOT)
        assert json.loads(path.read_text("utf-8")) == measured_rates()
