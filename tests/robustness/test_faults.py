"""Killed, interrupted or damaged: real processes and signals.

Every result is held against that of a run that nothing happened to, byte by byte.
"""

import os
import shutil
import signal
import subprocess
import time

import pandas as pd
import pytest
from helpers.commands import (
    FEW,
    UNDRAWN,
    assert_refused,
    assert_same,
    content,
    end,
    in_session,
    start,
)
from helpers.processes import ROOT, wait_for
from helpers.small_runs import without_pictures, write_walks

from evaluation import matrix, report
from evaluation.api import rebuild
from evaluation.store.lock import locked

END_S = 2.0
"""Within this, everything must be over."""
PLUGINS = '''
"""Plug-ins that go wrong; TASK_FILES is a folder for what they leave behind."""

import ctypes
import os
import threading
import time
from pathlib import Path

from isac_track.sharing import Fixed
from predictors.least_squares import LeastSquares


def is_trial(batch):
    """Whether these are the people that a plug-in is called with before the run."""
    return len(batch) == 12


def is_first(name):
    try:
        Path(os.environ["TASK_FILES"], name).touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


class ShareHolds(Fixed):
    """For ever, and no other thread of the process gets a turn."""

    def share(self, sensed, rng):
        if not is_trial(sensed):
            is_first("held")
            ctypes.PyDLL(None).sleep(1000)  # PyDLL: with the interpreter's lock
        return super().share(sensed, rng)


class DiesWhenIdle(LeastSquares):
    def predict(self, release, t_future):
        if not is_trial(release):
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
'''
SCENES = 1750
"""Seven blocks, each with a file."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A recording, the plug-ins, and a folder for temporary files of our own."""
    folder = tmp_path_factory.mktemp("faults")
    for name in ("temporary", "files"):
        (folder / name).mkdir()
    (folder / "faulty.py").write_text(PLUGINS, encoding="utf-8")
    write_walks(folder / "walks.csv", n_people=24)
    return folder


def words(place, out, *options, scenes=12, jobs=2):
    much = (
        "--dataset",
        place / "walks.csv",
        "--scenes",
        scenes,
        "--jobs",
        jobs,
        "--set",
        "scenes.agents=2",
        "--out",
        out,
    )
    return [str(word) for word in (*FEW, *much, *options)]


def begin(place, out, *options, **axes):
    own = {"PYTHONPATH": f"{place}:{ROOT}", "TASK_FILES": place / "files"}
    changed = own | {"TMPDIR": place / "temporary"}
    return start(place, *UNDRAWN, *words(place, out, *options, **axes), changed=changed)


def here(place, out, **axes):
    """Run what has many scenes to the end in this process."""
    with without_pictures():
        assert matrix.main(words(place, out, scenes=SCENES, **axes)) == 0


@pytest.fixture(scope="module")
def many_scenes(place):
    """What a run by two workers holds that nothing happened to."""
    here(place, out := place / "many-scenes")
    return content(out)


def test_killed_at_work_it_continues_to_the_same_result(place, many_scenes, capsys):
    out = place / "killed"
    process = begin(place, out, scenes=SCENES)
    wait_for(lambda: any(out.glob("cells/*.parquet")), most_s=60)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    wait_for(lambda: not in_session(process.pid), most_s=END_S)
    capsys.readouterr()
    here(place, out, jobs=1)
    assert "damaged cell" not in capsys.readouterr().err
    assert_same(out, many_scenes)
    # Nothing with a name is put there, so that a kill leaves nothing there.
    assert list((place / "temporary").iterdir()) == []


@pytest.fixture
def hanging(place):
    """How to start a run that hangs, and wait until it does."""
    flag, started = place / "files" / "held", []

    def hang(out, *, jobs=2):
        flag.unlink(missing_ok=True)
        started.append(
            begin(place, out, "--mechanism", "faulty:ShareHolds:0.5", jobs=jobs)
        )
        wait_for(flag.exists, most_s=60)
        return started[-1]

    yield hang
    for process in started:
        end(process)


class TestInterrupted:
    def test_a_second_run_is_refused_and_ctrl_c_ends_even_what_hangs(
        self, place, hanging, ran
    ):
        out = place / "hanging"
        process = hanging(out)
        for second in (ran(matrix, *words(place, out)), ran(report, out)):
            assert_refused(
                second, f"another run is writing to {out} (process {process.pid})"
            )
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        started = time.monotonic()
        _, errors = process.communicate(timeout=30)
        assert time.monotonic() - started < END_S
        assert process.returncode == 130, errors
        assert errors.splitlines()[-1].startswith(
            "interrupted; finished cells stay, the same"
        )
        assert "Traceback" not in errors
        wait_for(lambda: not in_session(process.pid), most_s=END_S)
        # Now the folder is free again.
        with locked(out):
            pass

    def test_a_worker_that_lets_no_thread_run_ends_with_its_parent(
        self, place, hanging
    ):
        process = hanging(place / "orphaned", jobs=1)
        assert len(in_session(process.pid)) >= 2
        process.kill()
        process.wait()
        wait_for(lambda: not in_session(process.pid), most_s=END_S)


def test_every_kind_of_damage_is_found_and_computed_again(
    place, many_scenes, ran, capsys
):
    out = place / "damaged"
    shutil.copytree(place / "many-scenes", out)
    cells = sorted((out / "cells").iterdir())
    cut, another, flipped = (
        bytearray(cells[number].read_bytes()) for number in (0, 1, 2)
    )
    flipped[len(flipped) // 2] ^= 1
    damage = {0: cut[:-100], 2: flipped, 4: b"", 5: another}
    for number, held in damage.items():
        cells[number].write_bytes(held)
    sums = out / "SHA256SUMS"
    by_damage = {cells[number].name for number in damage}
    lines = sums.read_text().splitlines()
    others = [line for line in lines if line.partition("/")[2] not in by_damage]
    # One line is missing, and the last one was cut short.
    left = [line for line in lines if line not in others[:2]]
    sums.write_text("\n".join([*left, others[1][:40]]))
    assert_refused(
        ran(report, out), "and 5 more: not as the run wrote it", str(out / "cells")
    )
    here(place, out, jobs=1)
    errors = capsys.readouterr().err
    assert "6 damaged cells computed again" in errors
    named = by_damage | {line.partition("/")[2] for line in others[:2]}
    assert any(name in errors for name in named)
    assert_same(out, many_scenes)
    for name in ("summary.csv", "decisions.csv", "verdict.json"):
        (out / name).unlink()
    rebuild(out)  # it is drawn from the cells alone
    shutil.rmtree(out / "figures")  # which the others were made without
    assert_same(out, many_scenes)
    check = ["sha256sum", "--check", "--quiet", "SHA256SUMS"]
    checked = subprocess.run(
        check, cwd=out, capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stdout  # the next line stands by itself
    assert "1 line is improperly formatted" in checked.stderr


@pytest.mark.slow
def test_a_worker_that_dies_with_nothing_to_do_is_replaced(place):
    out = place / "idle"
    odd = (f"--predictor=faulty:{name}" for name in ("DiesWhenIdle", "Raises"))
    process = begin(place, out, *odd)
    _, errors = process.communicate(timeout=180)
    assert process.returncode == 3, errors
    assert set(pd.read_csv(out / "failed.csv")["consumer"]) == {"faulty:Raises"}
    assert "faulty:DiesWhenIdle" in (out / "summary.csv").read_text()
