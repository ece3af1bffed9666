"""Killed, interrupted, damaged, out of room, or with broken plug-ins: real processes and signals.

Every result is held against that of a run that nothing happened to, byte by byte.
"""

import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest
from helpers.commands import assert_same, content, in_session
from helpers.processes import ROOT, wait_for
from helpers.runs import rows_of
from helpers.small_runs import write_walks

from evaluation import matrix, report
from evaluation.results import rebuild
from evaluation.runs.files import locked
from evaluation.runs.manifest import read_manifest

END_S = 2.0
"""Within this, everything must be over."""
PLUGINS = '''
"""Plug-ins that go wrong; TASK_FILES is a folder for what they leave behind."""

import os
import re
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from attacks.linkage.alignment import Shape
from isac_track.sharing import Fixed
from predictors.least_squares import LeastSquares

FOLDER = Path(os.environ["TASK_FILES"])


def hold_on():
    """For ever, and no other thread of the process gets a turn."""
    re.match("(a+)+$", 64 * "a" + "b")


def is_trial(batch):
    """Whether these are the people that a plug-in is called with before the run."""
    return len(batch) == 12


def is_first(name):
    try:
        (FOLDER / name).touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


@dataclass(frozen=True)
class ShareHangs(Fixed):
    def share(self, sensed, rng):
        if is_trial(sensed):
            return super().share(sensed, rng)
        time.sleep(3600)


class ShareHolds(Fixed):
    def share(self, sensed, rng):
        if is_trial(sensed):
            return super().share(sensed, rng)
        is_first("held")
        hold_on()


class DiesWhenIdle(LeastSquares):
    def predict(self, release, t_future):
        if is_trial(release):
            return super().predict(release, t_future)
        if is_first("idle"):
            threading.Timer(0.5, os._exit, (1,)).start()
        else:
            time.sleep(1.5)  # the other worker has nothing to do meanwhile
        return super().predict(release, t_future)


class Raises(LeastSquares):
    def predict(self, release, t_future):
        if is_trial(release):
            return super().predict(release, t_future)
        raise KeyError("no idea")


class Dies(LeastSquares):
    def predict(self, release, t_future):
        if is_trial(release):
            return super().predict(release, t_future)
        os.kill(os.getpid(), signal.SIGKILL)


class DiesOnce(LeastSquares):
    def predict(self, release, t_future):
        if is_trial(release):
            return super().predict(release, t_future)
        if is_first("died"):
            os._exit(1)
        return super().predict(release, t_future)


class Holds(LeastSquares):
    def predict(self, release, t_future):
        if is_trial(release):
            return super().predict(release, t_future)
        hold_on()


class LinkExits(Shape):
    uses = frozenset()

    def fit(self, context):
        usual = super().fit(context)
        return lambda *both: usual(*both) if is_trial(both[0]) else os._exit(9)

'''
USUAL = ("raw", "fixed:0.7")
UNDRAWN = (
    "import sys; from evaluation import matrix, results; "
    "results._draw = lambda *_, **__: None; sys.exit(matrix.main())"
)
"""The command, but for pictures: they take most of the time of a small run."""
SCENES = 1000
"""Four blocks."""
FEW = ("--predictor", "least_squares", "--attack", "none", "--task", "none")
LINKED = (
    *("--predictor", "least_squares", "--attack", "moving_average", "--attack", "shape"),
    *("--task", "rerelease"),
)


class Place:
    """A recording, the plug-ins, and a folder for temporary files of our own."""

    def __init__(self, folder):
        self.folder = folder
        self.temporary = folder / "temporary"
        for name in ("temporary", "plugins", "files"):
            (folder / name).mkdir()
        (folder / "plugins" / "faulty.py").write_text(PLUGINS, encoding="utf-8")
        write_walks(folder / "walks.csv", n_people=24)

    @property
    def environment(self):
        return os.environ | {
            "PYTHONPATH": os.pathsep.join([str(self.folder / "plugins"), str(ROOT)]),
            "TASK_FILES": str(self.folder / "files"),
            "TMPDIR": str(self.temporary),
        }

    def arguments(self, out, *options, mechanisms=USUAL, scenes=12, jobs=2):
        words = ["--preset", "smoke", "--dataset", self.folder / "walks.csv", "--jobs", jobs]
        words += ["--scenes", scenes, "--out", out, *options]
        for spec in mechanisms:
            words += ["--mechanism", spec]
        return [str(word) for word in words]

    def start(self, out, *options, most_bytes=None, drawn=False, **axes):
        def limit():
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))

        return subprocess.Popen(
            [
                *(sys.executable, *(("-m", "evaluation.matrix") if drawn else ("-c", UNDRAWN))),
                *self.arguments(out, *options, **axes),
            ],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=None if most_bytes is None else limit,  # noqa: PLW1509 - no threads here
        )

    def run(self, out, *options, **axes):
        """Run to the end; return exit code, output and errors."""
        process = self.start(out, *options, **axes)
        try:
            shown, errors = process.communicate(timeout=180)
        finally:
            end(process)
        assert "Traceback" not in errors, errors
        return process.returncode, shown, errors


def end(process):
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def one_line(errors):
    (line,) = [line for line in errors.splitlines() if line.startswith("error: ")]
    assert errors.splitlines()[-1] == line
    return line


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return Place(tmp_path_factory.mktemp("faults"))


@pytest.fixture(scope="module")
def undisturbed(place):
    """A small run that nothing happened to, and what it computed."""
    out = place.folder / "undisturbed"
    code, _, errors = place.run(out, *LINKED)
    assert code == 0, errors
    return out, content(out)


@pytest.fixture(scope="module")
def many_scenes(place):
    """One with more blocks of scenes and less else, by two workers, and how long it took."""
    return whole(place, drawn=False)


def here(place, out, *, drawn, **axes):
    """Run what has many scenes to the end in this process."""
    with pytest.MonkeyPatch.context() as patch:
        if not drawn:
            patch.setattr("evaluation.results._draw", lambda *_, **__: None)
        assert matrix.main(place.arguments(out, *FEW, scenes=SCENES, **axes)) == 0


def whole(place, *, drawn):
    out, started = place.folder / f"many-scenes-{drawn}", time.monotonic()
    here(place, out, drawn=drawn)
    return content(out), time.monotonic() - started


class TestKilled:
    def check(self, place, capsys, expected, took_s, *, times, out, moments, drawn=False):
        number = 0
        while number < times:
            process = place.start(out, *FEW, scenes=SCENES, drawn=drawn)
            process.stderr.readline()  # it has begun
            time.sleep(moments.uniform(0, 0.5 * took_s))
            if number % 2:
                os.kill(process.pid, signal.SIGKILL)
            else:
                os.killpg(process.pid, signal.SIGKILL)
            if process.wait() == 0:  # it was over: once more from the beginning
                process.communicate()
                shutil.rmtree(out)
                continue
            assert process.returncode == -signal.SIGKILL
            number += 1
            wait_for(lambda: not in_session(process.pid), most_s=END_S)  # noqa: B023 - called before the next turn
            process.communicate()
        capsys.readouterr()
        here(place, out, drawn=drawn, jobs=1)
        assert "not as they had been written" not in capsys.readouterr().err
        assert_same(out, expected)
        assert not [path for path in out.rglob("*") if path.name.endswith((".tmp", ".lock"))]
        # Nothing with a name is put there, so that a kill leaves nothing there.
        assert list(place.temporary.iterdir()) == []

    def test_at_any_moment_it_continues_to_the_same_result(self, place, many_scenes, capsys):
        out, moments = place.folder / "killed", random.Random(5)
        self.check(place, capsys, *many_scenes, times=2, out=out, moments=moments)

    @pytest.mark.slow
    def test_fifty_times(self, place, capsys):
        expected, moments = whole(place, drawn=True), random.Random(50)
        for number in range(10):
            out = place.folder / f"killed-{number}"
            self.check(place, capsys, *expected, times=5, out=out, moments=moments, drawn=True)


@pytest.fixture
def hanging(place):
    """How to start a run that hangs, and wait until it does."""
    flag, started = place.folder / "files" / "held", []

    def start(out):
        flag.unlink(missing_ok=True)
        started.append(place.start(out, *FEW, mechanisms=["faulty:ShareHolds:0.5"]))
        wait_for(flag.exists, most_s=60)
        return started[-1]

    yield start
    for process in started:
        end(process)


def interrupt(process):
    """Send Ctrl-C as a terminal does, to the whole group, and see that all is over at once."""
    os.killpg(process.pid, signal.SIGINT)
    started = time.monotonic()
    _, errors = process.communicate(timeout=30)
    assert time.monotonic() - started < END_S
    assert process.returncode == 130, errors
    assert errors.splitlines()[-1].startswith("interrupted; finished cells are kept, the same")
    assert "Traceback" not in errors
    wait_for(lambda: not in_session(process.pid), most_s=END_S)


class TestInterrupted:
    def test_a_second_run_is_refused_and_ctrl_c_ends_even_what_hangs(self, place, hanging, capsys):
        out = place.folder / "hanging"
        process = hanging(out)
        again = place.arguments(out, *FEW)
        for second in (lambda: matrix.main(again), lambda: report.main([str(out)])):
            assert second() == 2
            line = one_line(capsys.readouterr().err)
            assert f"another run is writing to {out} (process {process.pid})" in line
        interrupt(process)
        # Now the folder is free again.
        with locked(out):
            pass

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("sign", "jobs"), [("cells", 1), ("cells/*.parquet", 2), ("summary.csv", 1)]
    )
    def test_it_ends_at_once_and_the_same_command_continues(self, place, many_scenes, sign, jobs):
        out = place.folder / "interrupted"
        process = place.start(out, *FEW, scenes=SCENES, jobs=jobs)
        wait_for(lambda: any(out.glob(sign)) or process.poll() is not None, most_s=60)
        assert process.poll() is None, process.stderr.read()
        interrupt(process)
        if sign == "summary.csv":  # the last of three, each of which began where one was ended
            code, _, errors = place.run(out, *FEW, scenes=SCENES)
            assert code == 0, errors
            assert_same(out, many_scenes[0])

    def test_a_worker_that_lets_no_thread_run_ends_with_its_parent(self, place, hanging):
        process = hanging(place.folder / "orphaned")
        assert len(in_session(process.pid)) >= 2
        process.kill()
        process.wait()
        wait_for(lambda: not in_session(process.pid), most_s=END_S)


class TestDamaged:
    def test_every_kind_is_found_and_computed_again(self, place, many_scenes, capsys):
        expected, _ = many_scenes
        out = place.folder / "damaged"
        shutil.copytree(place.folder / "many-scenes-False", out)
        cells = sorted((out / "cells").iterdir())
        cut, another, flipped = (bytearray(cells[number].read_bytes()) for number in (0, 1, 2))
        flipped[len(flipped) // 2] ^= 1
        damage = {0: cut[:-100], 2: flipped, 4: b"", 6: another}
        for number, held in damage.items():
            cells[number].write_bytes(held)
        sums = out / "SHA256SUMS"
        by_damage = {cells[number].name for number in damage}
        lines = sums.read_text().splitlines()
        others = [line for line in lines if line.partition("/")[2] not in by_damage]
        # One line is missing, and the last one was cut short.
        left = [line for line in lines if line not in others[:2]]
        sums.write_text("\n".join([*left, others[1][:40]]))
        assert report.main([str(out)]) == 2
        line = one_line(capsys.readouterr().err)
        assert "and 5 more: not as the run wrote it" in line
        assert str(out / "cells") in line
        here(place, out, drawn=False, jobs=1)
        errors = capsys.readouterr().err
        assert "6 cells were not as they had been written and are computed anew" in errors
        named = by_damage | {line.partition("/")[2] for line in others[:2]}
        assert any(name in errors for name in named)
        assert_same(out, expected)
        for name in ("summary.csv", "decisions.csv", "verdict.json"):
            (out / name).unlink()
        rebuild(out, pictures=False)  # it is drawn from the cells alone
        assert_same(out, expected)
        words = ["sha256sum", "--check", "--quiet", "SHA256SUMS"]
        checked = subprocess.run(words, cwd=out, capture_output=True, text=True, check=False)
        assert checked.returncode == 0, checked.stdout  # the next line stands by itself
        assert "1 line is improperly formatted" in checked.stderr


@pytest.mark.slow
class TestNoRoom:
    def test_a_full_disk_is_one_line_and_what_is_finished_is_kept(self, place, undisturbed):
        whole, expected = undisturbed
        sizes = {path.name: path.stat().st_size for path in (whole / "cells").iterdir()}
        most = min(size for name, size in sizes.items() if "rerelease" in name) - 1
        small = {name for name, size in sizes.items() if size <= most}
        assert len(small) == 4
        out = place.folder / "full"
        code, _, errors = place.run(out, *LINKED, most_bytes=most)
        assert code == 2
        line = one_line(errors)
        assert line.startswith(f"error: cannot write {out / 'cells'}")
        assert line.endswith("File too large; finished cells are kept")
        kept = {path.name: path.stat().st_mtime_ns for path in (out / "cells").iterdir()}
        assert len(small & kept.keys()) >= 2  # at least one worker had all of its own written
        assert not [name for name in kept if name.startswith(".")]
        code, _, errors = place.run(out, *LINKED)
        assert code == 0, errors
        assert_same(out, expected)
        assert all((out / "cells" / name).stat().st_mtime_ns == at for name, at in kept.items())


BAD = {
    # Plug-in: how it is named, and why it is left out.
    "Raises": "predictor 'faulty:Raises' failed: KeyError: 'no idea'",
    "Dies": "its worker died (killed, crashed or out of memory)",
    "Holds": "it ran for longer than 3 s",
    "LinkExits": "its worker died (killed, crashed or out of memory)",
}
MECHANISM = "faulty:ShareHangs:0.5"
BAD_OPTIONS = (
    *("--cell-timeout", 3, "--task", "rerelease"),
    *("--predictor", "least_squares", "--predictor", "faulty:DiesOnce"),
    *(f"--predictor=faulty:{name}" for name in ("Raises", "Dies", "Holds")),
    *("--attack", "moving_average", "--attack", "faulty:LinkExits", "--attack", "shape"),
)


def rows_by_consumer(out, *, but=""):
    """Rows of the summary as text, by consumer."""
    rows = pd.read_csv(out / "summary.csv", dtype=str, keep_default_na=False)
    rows = rows[rows["mechanism"] != but].groupby("consumer")
    return {name: part.to_csv(index=False) for name, part in rows}


@pytest.fixture(scope="module")
def faulty(place):
    """One run with everything that can go wrong in it."""
    out = place.folder / "faulty"
    return out, *place.run(out, *BAD_OPTIONS, mechanisms=("fixed:0.7", MECHANISM), drawn=True)


@pytest.mark.slow
class TestPlugins:
    def test_each_fails_alone_and_by_name(self, faulty):
        out, code, _, errors = faulty
        assert code == 3, errors
        failed = pd.read_csv(out / "failed.csv", keep_default_na=False)
        by_mechanism = failed[failed["spec"] == MECHANISM]
        assert set(by_mechanism["why"]) == {"it ran for longer than 3 s"}
        others = failed[failed["spec"] != MECHANISM]
        why = {
            spec: set(part["why"])
            for spec, part in others.groupby(others["consumer"].str.replace("rerelease/", ""))
        }
        assert why.keys() == {f"faulty:{name}" for name in BAD}
        page = (out / "report.html").read_text(encoding="utf-8")
        told = (out / "tables.txt").read_text(encoding="utf-8")
        for said in (" ".join(one.split()) for one in (told, page)):
            assert "left out everywhere" in said
            assert [name for name in BAD if f"faulty:{name}" not in said] == []
        for name, reason in BAD.items():
            assert all(reason in one for one in why[f"faulty:{name}"]), (name, why)
        levels = others.groupby("consumer")["spec"].agg(set)
        for consumer, specs in levels.items():
            assert specs == {"fixed:0.7", *(["clean"] if "/" in consumer else [])}, consumer
        rows = pd.read_csv(out / "summary.csv", keep_default_na=False)
        assert not [name for name in rows["consumer"].unique() if name.split(":")[-1] in BAD]
        assert set(rows["mechanism"]) == {"fixed", "clean"}

    def test_everything_else_is_as_it_is_without_them(self, faulty, undisturbed):
        out, *_ = faulty
        entries = read_manifest(undisturbed[0])["cells"]
        cells = [
            (one["spec"], one["consumer"], one["knowledge"])
            for one in entries
            if one["mechanism"] in ("fixed", "clean")
        ]
        assert len(cells) > 15
        for cell in cells:
            pd.testing.assert_frame_equal(
                rows_of(out, *cell), rows_of(undisturbed[0], *cell), check_exact=True
            )
        usual = rows_by_consumer(undisturbed[0], but="raw")
        assert len(usual) > 6
        rows = rows_by_consumer(out)
        assert {name: rows[name] for name in usual} == usual
        # What died once was tried again.
        assert rows["faulty:DiesOnce"] == usual["least_squares"].replace(
            "least_squares", "faulty:DiesOnce"
        )

    def test_a_worker_that_dies_with_nothing_to_do_is_replaced(self, place):
        out = place.folder / "idle"
        options = ("--attack", "none", "--task", "none", "--predictor", "faulty:DiesWhenIdle")
        options += ("--predictor", "faulty:Raises")
        code, _, errors = place.run(out, *options, mechanisms=("raw", "fixed:0.7"), jobs=2)
        assert code == 3, errors
        assert set(pd.read_csv(out / "failed.csv")["consumer"]) == {"faulty:Raises"}
        assert "faulty:DiesWhenIdle" in (out / "summary.csv").read_text()
