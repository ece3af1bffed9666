"""Worker processes of this machine: hand out works, and receive their results.

Each worker has a pipe of its own: its death harms no other. It reports each cell before
it computes it. So the parent knows the cell at which a worker dies, or is late.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from multiprocessing import Pipe, connection
from typing import Any, Final, Generic, TypeVar

from cloudpickle import dumps
from threadpoolctl import threadpool_limits

from evaluation.compute.current_cell import Failure, note_cell
from evaluation.pool.serve import receive_message
from isac_track.command_line import check_interrupt

W = TypeVar("W")
R = TypeVar("R")
_SINGLE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"),
    "1",
)
"""More threads would fight over the cores; and a sum depends on their number."""
_FREED_STAYS: Final = {
    "MALLOC_TRIM_THRESHOLD_": str(2**26),
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
}
"""Settings of glibc's malloc: else it gives every larger array back page by page."""
_LOOK_S: Final = 0.25  # How often running cells are compared with their time limit.
_BEGIN: Final = """
import ctypes, signal, sys
if sys.platform == "linux":
    # 1: it ends with its parent, even where no other thread may run.
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
from multiprocessing.connection import Connection
pipe = Connection(int(sys.argv[1]))
try:
    sys.path[:], modules = pipe.recv()
except (EOFError, OSError):  # the parent was killed
    sys.exit()
from evaluation.pool.serve import serve
serve(pipe, modules)
"""
"""Not `multiprocessing`, whose workers run a user's script again."""
_idle_workers: Final["list[_Worker[Any, Any]]"] = []
"""Workers without work, for the next call; `dismiss` and `start_workers_early` end them."""
_CELL_MODULES: Final = (
    "evaluation.pool.packing",
    "evaluation.compute.sample_tracks",
    "numba",
)


def spread(
    function: Callable[[W], Iterable[R]],
    works: deque[W],
    *,
    jobs: int,
    limit_s: float | None,
    in_workers: bool = False,
    is_separate: bool = False,
) -> Generator[tuple[W, R | Failure]]:
    """Yield each work with each of its results, in the order in which results come.

    The function calls `note_cell` before each cell. The caller may add works meanwhile.
    With one job, no limit and not `in_workers`, this process computes a work when the
    caller asks for its results. Otherwise workers compute, even a single work: it may
    kill its process. A worker that takes longer than `limit_s` for a cell is killed;
    the results that it has sent are yielded.

    Afterwards the workers wait for the next call until `start_workers_early` ends. If
    `is_separate`, they end with this call instead. Raises the errors of the function.
    """
    if limit_s is None and jobs == 1 and not in_workers:
        return _compute_here(function, works)
    return _compute_in_workers(
        function,
        works,
        n_workers=min(jobs, len(works)),
        limit_s=limit_s,
        is_separate=is_separate,
    )


def _compute_here(
    function: Callable[[W], Iterable[R]], works: deque[W]
) -> Generator[tuple[W, R | Failure]]:
    with threadpool_limits(limits=1):
        while works:
            work = works.popleft()
            note_cell()
            for result in function(work):
                yield work, result


def _compute_in_workers(
    function: Callable[[W], Iterable[R]],
    works: deque[W],
    *,
    n_workers: int,
    limit_s: float | None,
    is_separate: bool,
) -> Generator[tuple[W, R | Failure]]:
    workers: list[_Worker[W, R]] = []
    try:
        # A worker takes 1 to 2 s to begin: start all at once.
        for _ in range(n_workers):
            workers.append(_idle_worker() or _Worker())  # noqa: PERF401 - an error may come between
        if not is_separate:
            dismiss()  # there is no work for more
        while works or any(worker.is_busy for worker in workers):
            check_interrupt()
            for place, worker in enumerate(workers):
                if works and not worker.is_busy:
                    if not worker.is_alive():
                        worker.end()
                        workers[place] = _idle_worker() or _Worker()
                    workers[place].start(function, works.popleft())
            busy = [worker for worker in workers if worker.is_busy]
            connection.wait([worker.pipe for worker in busy], timeout=_LOOK_S)
            for worker in busy:
                for result in worker.next_results(limit_s):
                    yield worker.work, result
    finally:
        for worker in workers:
            worker.end_unless_idle(is_needed=not is_separate)


@contextlib.contextmanager
def start_workers_early(
    n_workers: int = 0, needed: Sequence[str] = _CELL_MODULES
) -> Iterator[None]:
    """Start workers that import modules meanwhile; at the end dismiss the idle."""
    try:
        for _ in range(n_workers):
            _idle_workers.append(_Worker(needed))
        yield
    finally:
        dismiss()


@contextlib.contextmanager
def run_in_idle_worker(call: Callable[[], R]) -> Iterator[Callable[[], R]]:
    """Let an idle worker make a call; yield the function that waits for its result.

    Without an idle worker, or if it dies, that function makes the call here: it raises
    the errors of the call.
    """
    worker = _idle_worker()
    if worker is None:
        yield call
        return

    def wait_for_result() -> R:
        results: list[R | Failure] = []
        while worker.is_busy:
            check_interrupt()
            connection.wait([worker.pipe], timeout=_LOOK_S)
            results += worker.next_results(None)
        return call() if isinstance(results[0], Failure) else results[0]

    worker.start(lambda function: [function()], call)
    try:
        yield wait_for_result
    finally:
        worker.end_unless_idle(is_needed=True)


def dismiss() -> None:
    """End the idle workers."""
    while _idle_workers:
        _idle_workers.pop().end()


def _idle_worker() -> "_Worker[Any, Any] | None":
    """Take an idle worker that is alive, if there is any."""
    while _idle_workers:
        worker = _idle_workers.pop()
        if worker.is_alive():
            return worker
        worker.end()
    return None


class _Worker(Generic[W, R]):
    """A process at the other end of a pipe, with at most one work at a time."""

    work: W

    def __init__(self, modules: Sequence[str] = ()) -> None:
        """Start the process in a group of its own, which no Ctrl-C reaches."""
        self.is_busy = self._is_late = False
        self._cell: tuple[str, ...] = ()
        self._cell_since_s = 0.0
        self._function: Callable[[W], Iterable[R]] | None = None
        self.pipe, theirs = Pipe()
        with theirs:
            number = theirs.fileno()
            self._process = subprocess.Popen(  # noqa: S603 - this very Python
                [sys.executable, "-P", "-c", _BEGIN, str(number)],
                env=_FREED_STAYS | os.environ | _SINGLE_THREAD,
                pass_fds=[number],
                process_group=0,
            )
        self._send((sys.path, modules))

    def start(self, function: Callable[[W], Iterable[R]], work: W) -> None:
        """Let it compute a work."""
        self.work, self.is_busy, self._is_late = work, True, False
        self._cell, self._cell_since_s = (), time.monotonic()
        # A function holds the tracks of a run: it is sent once.
        self._send((None if function is self._function else function, work))
        self._function = function

    def next_results(self, limit_s: float | None) -> list[R | Failure]:
        """Return the next result, or the failure of a process that has ended; or none.

        A process that takes longer than `limit_s` for a cell is killed, which a later
        call reports. Raises the error of the work.
        """
        kind, content = self._next_message()
        if kind == "error":
            raise content
        if kind == "result":
            return [content]
        if kind == "cell":
            self._cell, self._cell_since_s = content, time.monotonic()
            # A late cell may still end before the kill takes effect.
            self._is_late = False
        elif kind == "done":
            self.is_busy = False
        elif kind == "ended":
            self.is_busy = False
            self.end()
            return [self._failure(limit_s)]
        elif limit_s is not None and self._cell:
            self._is_late = time.monotonic() - self._cell_since_s > limit_s
            if self._is_late:
                self._kill()
        return []

    def _next_message(self) -> tuple[str, Any]:
        """Return the next message; "nothing" if none has come, "ended" if none will."""
        # Ask this before the pipe: a process may send its last message and end between.
        has_ended = not self.is_alive()
        with contextlib.suppress(EOFError, ConnectionError):
            if self.pipe.poll():
                return receive_message(self.pipe)
            if not has_ended:
                return "nothing", None
        return "ended", None

    def _failure(self, limit_s: float | None) -> Failure:
        """Return the failure of a process that has ended before its work was done."""
        if self._is_late:
            message = f"it ran for longer than {limit_s:g} s"
            return Failure(self._cell, message, timed_out=True)
        message = "its worker died (killed, crashed or out of memory)"
        return Failure(self._cell, message, worker_died=True)

    def is_alive(self) -> bool:
        return self._process.poll() is None

    def end_unless_idle(self, *, is_needed: bool) -> None:
        """Let the process wait for further work if it is idle and needed, or end it."""
        if is_needed and not self.is_busy and self.is_alive():
            _idle_workers.append(self)
        else:
            self.end()

    def end(self) -> None:
        """End the process and all that it started; more than once does no harm."""
        if not self.pipe.closed:
            self._kill()
            self._process.wait()
            self.pipe.close()

    def _kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def _send(self, message: object) -> None:
        # A process that has ended is noticed when its results are read.
        with contextlib.suppress(OSError):
            self.pipe.send_bytes(dumps(message))
