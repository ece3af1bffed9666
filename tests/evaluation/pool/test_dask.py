"""Runs on a Dask cluster: real scheduler and workers on loopback, some are killed."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.commands import MATRIX, start
from helpers.processes import ROOT, TESTS, wait_for
from helpers.small_runs import smoke, write_walks

import evaluation
from evaluation import matrix
from evaluation.compute.current_cell import Failure
from evaluation.compute.link_views import view_key
from evaluation.compute.work import LinkWork, SceneWork
from evaluation.plan.consumer import Consumer
from evaluation.plan.plan import make_plan
from evaluation.plan.settings import Settings
from evaluation.pool import dask as on_cluster
from evaluation.pool.execute import FailedCellsWarning
from evaluation.pool.failures import Failures
from evaluation.pool.pieces import (
    cell_name,
    cut_for_cluster,
    cut_work,
    planned_cells,
)
from isac_track import plugins
from isac_track.errors import SettingsError

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.usefixtures("single_process")  # what is not on a cluster

PLUGINS = """
import os, time
from isac_track.sharing import Fixed
from predictors.least_squares import LeastSquares

class Slow(Fixed):
    def share(self, sensed, rng):
        time.sleep(float(os.environ.get("SLOW_S", "0")))
        return super().share(sensed, rng)

class Killer(LeastSquares):
    def predict(self, release, t_future):
        if "SLOW_S" in os.environ:  # in a worker
            os._exit(1)
        return super().predict(release, t_future)
"""
# A profiler would take samples of every worker all the time.
OWN = {"SLOW_S": "0.3", "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}
SLOW = "cluster_plugins:Slow:0.1..0.8/8"


@dataclass(frozen=True)
class Cluster:
    """Processes of a scheduler and its workers."""

    address: str
    scheduler: subprocess.Popen
    workers: list
    start_worker: object

    def count(self, question):
        """Ask the scheduler."""
        with distributed.Client(
            self.address, set_as_default=False, timeout=10
        ) as client:
            return client.run_on_scheduler(question)


def cell_path(folder):
    """Where a process finds its plug-ins, and this very project."""
    return os.pathsep.join([str(folder), str(ROOT), str(TESTS)])


@contextlib.contextmanager
def started(folder, *, threads=(1, 2), options=("--no-nanny",), modules=None):
    """A scheduler and workers as the commands start them; all are ended."""
    processes = []

    def start(module, *arguments, modules=modules):
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{module}", *arguments],
            env=os.environ | OWN | {"PYTHONPATH": cell_path(modules or folder)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            cwd=modules or folder,  # what is there comes before PYTHONPATH
        )
        processes.append(process)
        return process

    def start_worker(n_threads, modules=modules):
        words = f"--nthreads {n_threads} --no-dashboard --scheduler-file {file}".split()
        scratch = ["--local-directory", str(own / "scratch")]
        return start("dask_worker", *words, *scratch, *options, modules=modules)

    own = Path(tempfile.mkdtemp(dir=folder))
    file = own / "scheduler.json"
    try:
        words = ["--host=127.0.0.1", "--port=0", "--dashboard-address=127.0.0.1:0"]
        scheduler = start(
            "dask_scheduler", *words, "--no-dashboard", "--scheduler-file", str(file)
        )
        workers = [start_worker(n) for n in threads]
        wait_for(lambda: file.is_file() and file.stat().st_size > 0, most_s=30)
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        if workers:
            with distributed.Client(
                address, set_as_default=False, timeout=10
            ) as client:
                client.wait_for_workers(len(workers), timeout=30)
        yield Cluster(address, scheduler, workers, start_worker)
    finally:
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cluster")
    (folder / "cluster_plugins.py").write_text(PLUGINS, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def cluster(folder):
    with started(folder) as cluster:
        yield cluster


@pytest.fixture
def settings(csv_recording, tmp_path):
    axes = {"mechanisms": ("raw", "fid:1000", "fixed:0.7")}
    axes["predictors"] = ("least_squares", "kalman_cv")
    axes["keep_ids"] = True  # pseudonyms are others in another folder
    return smoke(csv_recording, tmp_path / "run", **axes)


@pytest.fixture
def slow(settings, monkeypatch, folder, tmp_path):
    """Sixteen cells of 0.3 s each in a worker, and the same run on this machine."""
    monkeypatch.syspath_prepend(str(folder))
    axes = {"mechanisms": (SLOW,), "predictors": ()}
    local = replace(settings, scenes=300, out=tmp_path / "local", **axes)
    evaluation.run(local, pictures=False)
    return local


def sent(settings, cluster, **changes):
    """The same run on a cluster."""
    own = {"jobs": None, "executor": "dask", "scheduler": cluster.address}
    return replace(settings, **own, **changes)


def cells(run):
    return sorted((run.out / "cells").glob("*.parquet")) if run.out.is_dir() else []


def assert_same_bits(run, other):
    assert (run.out / "summary.csv").read_bytes() == (
        other.out / "summary.csv"
    ).read_bytes()
    names = [path.name for path in cells(run)]
    assert names == [path.name for path in cells(other)]
    assert names
    for (
        name
    ) in names:  # as tables: how they are compressed is not the same in two local runs
        first, two = (
            pd.read_parquet(where.out / "cells" / name) for where in (run, other)
        )
        pd.testing.assert_frame_equal(first, two, check_exact=True, obj=name)


class TestResults:
    def test_are_those_of_this_machine_to_the_bit(self, settings, cluster, tmp_path):
        write_walks(Path(settings.dataset), n_people=24)  # a task takes twice as many
        axes = {"attacks": ("moving_average", "shape"), "tasks": ("rerelease",)}
        settings = replace(settings, mechanisms=("raw", "fixed:0.7"), **axes)
        there = sent(settings, cluster, out=tmp_path / "there")
        evaluation.run(settings, pictures=False)
        evaluation.run(there, pictures=False)
        assert_same_bits(there, settings)
        # The cluster is left as it was.
        wait_for(lambda: cluster.count(n_tasks) == 0, most_s=5)

    def test_leave_out_a_plugin_that_fails(self, settings, cluster):
        spec = "helpers.bad_plugins:RaisesThen:0.5"
        changed = sent(settings, cluster, mechanisms=("raw", spec))
        with pytest.warns(FailedCellsWarning, match=f"{spec!r} failed: .*no luck"):
            results = evaluation.run(changed, pictures=False)
        assert set(results.failed["spec"]) == {spec}
        assert set(results.failed["consumer"]) == {
            "shared",
            "least_squares",
            "kalman_cv",
        }
        assert set(results.summary["mechanism"]) == {"raw"}


def n_tasks(dask_scheduler):
    return len(dask_scheduler.tasks)


class TestWhatIsKilled:
    def run(self, there, *, act, at_cell=3):
        """Run it, and do something as soon as some cells are finished."""

        def tell(done, _total, _cell):
            if done == at_cell:
                act()

        return evaluation.run(there, progress=tell, pictures=False)

    def test_a_worker_loses_nothing(self, slow, cluster, tmp_path):
        worker = cluster.workers[0]  # the other one has the rest of these tests
        there = sent(slow, cluster, out=tmp_path / "there")
        self.run(there, act=lambda: os.killpg(worker.pid, signal.SIGKILL))
        assert worker.wait() == -signal.SIGKILL
        assert_same_bits(there, slow)

    @pytest.mark.slow
    def test_the_driver_leaves_the_cluster_running(
        self, slow, folder, cluster, tmp_path
    ):
        there = replace(slow, jobs=None, out=tmp_path / "there")
        words = [*MATRIX, "--preset=smoke", "--dataset", slow.dataset, "--scenes=1000"]
        words += [
            "--mechanism",
            SLOW,
            "--predictor=none",
            "--attack=none",
            "--task=none",
        ]
        words += ["--executor=dask", "--scheduler", cluster.address, "--out", there.out]
        with start(tmp_path, *words, changed={"PYTHONPATH": cell_path(folder)}) as run:
            wait_for(lambda: len(cells(there)) > 0, most_s=40)
            run.send_signal(signal.SIGINT)
            _, said = run.communicate(timeout=30)
        assert run.returncode == 130
        assert said.splitlines()[-1].startswith("interrupted; finished cells stay")
        assert "Traceback" not in said
        assert 0 < len(cells(there)) < 4  # blocks
        wait_for(lambda: cluster.count(n_tasks) == 0, most_s=5)

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("processes", "signalled", "message"),
        [
            ("workers", signal.SIGKILL, "has had no worker for 1 s; finished ce"),
            ("scheduler", signal.SIGSTOP, "is gone; finished cells"),
            (
                "scheduler",
                signal.SIGKILL,
                "is gone; finished cells stay; start it and run the",
            ),
        ],
    )
    def test_all_workers_or_the_scheduler_end_the_run_and_the_same_settings_continue(
        self, slow, folder, monkeypatch, tmp_path, processes, signalled, message
    ):
        for limit in ("_NO_WORKER_S", "_ANSWER_S"):
            monkeypatch.setattr(on_cluster, limit, 1.0)
        with started(folder) as own:
            there = sent(slow, own, out=tmp_path / "there")

            def end():
                for process in (
                    own.workers if processes == "workers" else [own.scheduler]
                ):
                    os.killpg(process.pid, signalled)

            with pytest.raises(SettingsError, match=f"{own.address} {message}"):
                # The first of two blocks is finished, and its file written.
                self.run(there, act=end, at_cell=12)
        remaining = {path: path.stat().st_mtime_ns for path in cells(there)}
        assert len(remaining) == 1
        evaluation.run(replace(slow, out=there.out), pictures=False)
        assert_same_bits(there, slow)
        assert all(
            path.stat().st_mtime_ns == stamp for path, stamp in remaining.items()
        )

    @pytest.mark.slow
    def test_workers_that_a_plugin_kills_cost_its_cells(
        self, settings, folder, monkeypatch, tmp_path
    ):
        monkeypatch.syspath_prepend(str(folder))
        changed = replace(
            settings,
            mechanisms=("raw", "fixed:0.7"),
            predictors=("least_squares", "cluster_plugins:Killer", "kalman_cv"),
        )
        with started(folder, options=()) as own:  # with nannies, who start them again
            there = sent(changed, own, out=tmp_path / "there")
            with pytest.warns(FailedCellsWarning, match="its worker died"):
                result = evaluation.run(there, pictures=False)
        assert set(result.failed["consumer"]) == {"cluster_plugins:Killer"}
        assert sorted(result.failed["spec"]) == ["fixed:0.7", "raw"]
        without = replace(changed, predictors=("least_squares", "kalman_cv"))
        evaluation.run(without, pictures=False)
        # Files are named after all that was wanted of them; what they hold is the same.
        failure, two = (where.out / "summary.csv" for where in (there, without))
        assert failure.read_bytes() == two.read_bytes()


class TestWhatIsRefused:
    def test_an_address_where_nobody_answers(self, settings, monkeypatch, capsys):
        monkeypatch.setattr(on_cluster, "_CONNECT_S", 0.5)
        for address in ("tcp://127.0.0.1:1", "nonsense:1", "carrier-pigeon://a:1"):
            words = [
                "--dataset",
                settings.dataset,
                "--out",
                str(settings.out),
                "--mechanism=raw",
            ]
            words += ["--predictor=none", "--attack=none", "--task=none"]
            words += ["--executor", "dask", "--scheduler", address]
            assert matrix.main(words) == 2
            error = capsys.readouterr().err.splitlines()[-1]
            assert error.startswith(
                f"error: no Dask scheduler answers at {address!r} ("
            )
            assert (
                "start one with `dask scheduler`, and workers with `dask worker"
                in error
            )

    def test_a_scheduler_without_workers_and_workers_without_the_package(
        self, settings, folder, monkeypatch, tmp_path
    ):
        (tmp_path / "evaluation.py").write_text(
            "raise ImportError('not here')", encoding="utf-8"
        )
        monkeypatch.setattr(on_cluster, "_FIRST_WORKER_S", 0.2)
        with started(folder, threads=()) as own:
            there = sent(settings, own)
            with pytest.raises(
                SettingsError, match=f"{own.address} has no workers; .*dask worker"
            ):
                evaluation.run(there)
            monkeypatch.setattr(on_cluster, "_FIRST_WORKER_S", 30.0)
            own.start_worker(1, modules=tmp_path)
            with pytest.raises(SettingsError, match="lacks this isac-track"):
                evaluation.run(there)

    def test_a_plugin_that_workers_cannot_import(
        self, settings, cluster, tmp_path, monkeypatch
    ):
        (tmp_path / "here_alone.py").write_text(PLUGINS, encoding="utf-8")
        monkeypatch.syspath_prepend(str(tmp_path))
        there = sent(settings, cluster, mechanisms=("here_alone:Slow:0.5",))
        with pytest.raises(
            SettingsError, match=r"cannot import 'here_alone' .*on every worker"
        ):
            evaluation.run(there)

    def test_a_plugin_that_workers_have_as_it_was(
        self, settings, cluster, folder, monkeypatch
    ):
        source = folder / "edited_plugin.py"
        source.write_text(PLUGINS, encoding="utf-8")
        monkeypatch.syspath_prepend(str(folder))
        there = sent(settings, cluster, mechanisms=("edited_plugin:Slow:0.5",))
        evaluation.run(there, pictures=False)
        source.write_text(PLUGINS + "# better now\n", encoding="utf-8")
        with pytest.raises(
            SettingsError,
            match=r"worker tcp://.* not compute the same: module edited_plugin \w+",
        ):
            evaluation.run(there, pictures=False)

    @pytest.mark.slow
    def test_a_worker_with_another_plugin_that_joins_later(
        self, slow, folder, tmp_path
    ):
        (tmp_path / "cluster_plugins.py").write_text(
            PLUGINS + "# other\n", encoding="utf-8"
        )
        with started(folder, threads=(1,)) as own:
            there = sent(slow, own, scenes=1500, out=tmp_path / "there")

            def tell(done, _total, _cell):
                if done == 3:
                    own.start_worker(1, modules=tmp_path)

            with pytest.raises(SettingsError, match="the same: module cluster_plugins"):
                evaluation.run(there, progress=tell, pictures=False)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"executor": "dask"}, "needs --scheduler ADDRESS"),
            ({"scheduler": "tcp://a:1"}, "goes with --executor dask"),
            ({"executor": "slurm"}, "local or dask, got 'slurm'"),
            (
                {"executor": "dask", "scheduler": "tcp://a:1", "jobs": 2},
                "--jobs is for",
            ),
            (
                {"executor": "dask", "scheduler": "tcp://a:1", "cell_timeout_s": 2},
                "--cell-timeout is for",
            ),
        ],
    )
    def test_options_that_contradict_each_other(self, options, message):
        with pytest.raises(SettingsError, match=message):
            Settings(**options)


class TestADeathAtAnUnknownPlace:
    """Nobody knows at which cell the worker was: each is tried by itself."""

    def block(self, *specs):
        mechanisms = [plugins.parse("mechanisms", spec)[0] for spec in specs]
        (predictor,) = plugins.parse("predictors", "least_squares")
        consumers = (Consumer("shared"), Consumer("predictor", predictor))
        levels = tuple((mechanism, consumers) for mechanism in mechanisms)
        return SceneWork(
            number=3, first_scene=0, order=np.zeros((1, 1), int), levels=levels
        )

    def test_ends_at_the_cell_that_kills(self):
        failures, finished, tries = Failures(), [], 0
        works = deque([self.block("raw", "fixed:0.5", "fixed:0.7")])
        while works:
            work = works.popleft()
            names = [cell_name(cell) for cell in planned_cells(work)]
            if (3, "fixed:0.5", "least_squares") in names:
                tries += 1
                works.extend(
                    failures.work_after(
                        work, Failure((), "died", worker_died=True), finished=set()
                    )
                )
            else:
                finished += names
        ((cell, why),) = failures.cells
        assert (*cell_name(cell), why) == (3, "fixed:0.5", "least_squares", "died")
        assert len(finished) == len(set(finished)) == 5
        assert tries == 2  # the work, the cell


def test_a_piece_for_a_cluster_is_behind_one_reconstruction_and_no_cell_is_lost(
    tmp_path,
):
    attacks = ("shape", "shape@kalman_rts", "kalman_rts")
    axes = {
        "attacks": attacks,
        "tasks": ("rerelease",),
        "mechanisms": ("raw", "fixed:0.7"),
    }
    walks = write_walks(tmp_path / "walks.csv")
    plan = make_plan(smoke(walks, tmp_path / "run", **axes))
    works = deque(cut_work(plan.units, plan))
    before = sorted(cell_name(cell) for work in works for cell in planned_cells(work))
    cut_for_cluster(works)
    assert (
        sorted(cell_name(cell) for work in works for cell in planned_cells(work))
        == before
    )
    seen = [
        {(cell[1].spec, *view_key(cell[2])) for cell in planned_cells(work)}
        for work in works
        if isinstance(work, LinkWork)
    ]
    every = set().union(*seen)
    assert [len(item) for item in seen] == [1] * len(every)
    assert len({spec for spec, *_ in every}) == 3
    assert (
        len({item[1:] for item in every}) >= 4
    )  # As it is, and what three adversaries smooth.
