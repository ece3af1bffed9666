"""Works in real worker processes: what ends a process costs the cell that it was at."""

import os
import re
import signal
from collections import deque
from contextlib import closing

import pytest

from evaluation.compute.current_cell import Failure, note_cell
from evaluation.pool.workers import spread, start_workers_early
from isac_track.errors import DataError

LIMIT_S = 3.0
DIED = "its worker died (killed, crashed or out of memory)"


def interrupt():
    raise KeyboardInterrupt


def hang():
    re.match("(a+)+$", 64 * "a" + "b")  # no other thread gets a turn


ACTS = {
    "goes on": (lambda: None, None),
    "exits with 0": (lambda: os._exit(0), (DIED, True, False)),
    "exits with 3": (lambda: os._exit(3), (DIED, True, False)),
    "is killed": (lambda: os.kill(os.getpid(), signal.SIGKILL), (DIED, True, False)),
    "hangs": (hang, (f"it ran for longer than {LIMIT_S:g} s", False, True)),
    "interrupts": (interrupt, ("it raised KeyboardInterrupt", False, False)),
}


def three_cells(name, *, at_second):
    for number in range(3):
        note_cell(name, str(number))
        if number == 1:
            at_second[name]()
        yield number


def compute(name):
    return three_cells(name, at_second={name: act for name, (act, _) in ACTS.items()})


@pytest.fixture(scope="module")
def results():
    """The results of every work, in the order in which they came."""
    results = {name: [] for name in ACTS}
    with (
        start_workers_early(),
        closing(spread(compute, deque(ACTS), jobs=2, limit_s=LIMIT_S)) as computed,
    ):
        for name, result in computed:
            results[name].append(result)
    return results


@pytest.mark.parametrize("name", ACTS)
def test_a_process_fails_at_its_cell_and_earlier_results_stay(name, results):
    failure = ACTS[name][1]
    if failure is None:
        assert results[name] == [0, 1, 2]
    else:
        assert results[name] == [0, Failure((name, "1"), *failure)]


def refuse(name):
    yield name
    raise DataError("nobody is there")


def test_an_error_that_all_cells_share_is_raised_here():
    works = deque(["a"])
    with start_workers_early():
        computed = spread(refuse, works, jobs=1, limit_s=None, in_workers=True)
        assert next(computed) == ("a", "a")
        with pytest.raises(DataError, match="nobody is there"):
            next(computed)


def add_work(name):
    note_cell(name, "")
    yield os.getpid()


def test_works_may_be_added_while_the_last_runs():
    works, processes = deque(["first"]), {}
    with start_workers_early():
        for name, process in spread(
            add_work, works, jobs=2, limit_s=None, in_workers=True
        ):
            processes[name] = process
            if name == "first":
                works.append("second")
    assert set(processes) == {"first", "second"}
    assert os.getpid() not in processes.values()
