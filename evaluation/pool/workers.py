"""Hand out works to worker processes of this machine, and receive their results.

Each worker is in a lane of its own, at the other end of a pipe: its death harms no
other. It reports each cell before it computes it, which names the culprit and times it.
"""

import contextlib
import ctypes
import gc
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from importlib import import_module
from multiprocessing import Pipe, connection
from typing import Any, Final, Generic, NamedTuple, TypeVar

import numpy as np
import pyarrow as pa
from cloudpickle import dumps, loads
from threadpoolctl import threadpool_limits

from evaluation.compute.current_cell import Failure, current_cell, note_cell
from isac_track.command_line import check_interrupt
from isac_track.errors import error_text

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
_WORKER: Final = """
import ctypes, os, signal, sys
if sys.platform == "linux":
    # 1: it ends with its parent, even where no other thread may run.
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
from multiprocessing.connection import Connection
pipe = Connection(int(sys.argv[1]))
try:
    sys.path[:] = pipe.recv()
except (EOFError, OSError):  # the parent was killed
    sys.exit()
from evaluation.pool.workers import serve
serve(pipe, parent=int(sys.argv[2]))
"""
_idle_workers: Final["list[_Worker]"] = []
"""Workers without work, for the next `spread`; `dismiss` and `start_workers_early` end them."""
_CELL_MODULES: Final = (
    "evaluation.pool.pieces",
    "evaluation.compute.sample_tracks",
    "numba",
)
_own_streams: Final[dict[int, int]] = {}
"""Copies of this process's output and error streams, as they were at its start."""
_M_ARENA_MAX: Final = -8  # Of glibc's malloc.h.


def spread(
    function: Callable[[W], Iterable[R]],
    works: deque[W],
    *,
    jobs: int,
    limit_s: float | None,
    in_workers: bool = False,
    is_separate: bool = False,
) -> Generator[tuple[W, Iterable[R | Failure]]]:
    """Yield each work with its results, again and again as they come.

    The function calls `note_cell` before each cell. Works may be added while this runs.
    With one job and no limit, all is computed in this process, while the yielded
    results are read, unless it must be done `in_workers`. A worker that takes longer
    than `limit_s` for a cell is killed: the results that it has sent stay. The last of
    several works still gets a worker, since it may kill its process.

    Workers without work wait for the next call until `start_workers_early` ends. If
    `is_separate`, the workers of this call end with it, and only those that it did not
    take wait. Raises the errors of the function.
    """
    if limit_s is None and jobs == 1 and not in_workers:
        with threadpool_limits(limits=1):
            while works:
                work = works.popleft()
                note_cell()
                yield work, function(work)
        return
    with contextlib.ExitStack() as ends:
        lanes = [_Lane[W, R](function, limit_s) for _ in range(min(jobs, len(works)))]
        for lane in lanes:  # a worker takes 1 to 2 s to begin: start all at once
            ends.callback(lane.stop, keeps=not is_separate)
            lane.begin()
        if not is_separate:
            dismiss()  # there is no work for more
        while works or any(lane.is_busy for lane in lanes):
            check_interrupt()
            for lane in lanes:
                if works and not lane.is_busy:
                    lane.start(works.popleft())
            connection.wait(
                [lane.pipe for lane in lanes if lane.is_busy], timeout=_LOOK_S
            )
            for lane in lanes:
                if lane.is_busy and (items := lane.items()):
                    yield lane.work, items


@contextlib.contextmanager
def start_workers_early(
    n_workers: int = 0, needed: Sequence[str] = _CELL_MODULES
) -> Iterator[None]:
    """Start workers that import modules meanwhile; at the end dismiss all idle ones."""
    try:
        for _ in range(n_workers):
            _idle_workers.append(_start_worker())
            _idle_workers[-1].send("import", needed)
        yield
    finally:
        dismiss()


@contextlib.contextmanager
def run_in_idle_worker(call: Callable[[], R]) -> Iterator[Callable[[], R]]:
    """Let an idle worker make a call; yield the function that waits for its result.

    Without an idle worker, or if it dies, that function makes the call here: it raises
    the errors of the call.
    """
    if not _idle_workers:
        yield call
        return
    lane = _Lane[Callable[[], R], R](lambda function: [function()], None)
    lane.start(call)

    def result() -> R:
        results: list[R | Failure] = []
        while lane.is_busy:
            check_interrupt()
            connection.wait([lane.pipe], timeout=_LOOK_S)
            results += lane.items()
        return call() if isinstance(results[0], Failure) else results[0]

    try:
        yield result
    finally:
        lane.stop(keeps=True)


def dismiss() -> None:
    """End the idle workers."""
    while _idle_workers:
        _idle_workers.pop().end()


@contextlib.contextmanager
def release_memory_after() -> Iterator[None]:
    """Return freed memory to the system at the end: one process may do many runs.

    glibc gives threads arenas of their own, whose ends ``malloc_trim`` cannot reach,
    and pyarrow's pools keep pieces that the next run does not quite fill. So threads
    share an arena from now on, and pyarrow takes its memory from malloc meanwhile.
    Another C library's malloc is left as it is.
    """
    pool, libc = pa.default_memory_pool(), _glibc()
    if libc is not None:
        libc.mallopt(_M_ARENA_MAX, 1)
    pa.set_memory_pool(pa.system_memory_pool())
    try:
        yield
    finally:
        pa.set_memory_pool(pool)
        _trim_memory(libc)


def _glibc() -> Any | None:  # noqa: ANN401 - untyped
    # Windows has no name for "this process".
    with contextlib.suppress(OSError, TypeError):
        libc = ctypes.CDLL(None)
        return libc if hasattr(libc, "malloc_trim") else None
    return None


def _trim_memory(libc: Any | None) -> None:  # noqa: ANN401 - untyped
    gc.collect()
    if libc is not None:
        libc.malloc_trim(ctypes.c_size_t(0))


class _Worker(NamedTuple):
    """A process at the other end of a pipe."""

    process: subprocess.Popen[bytes]
    pipe: Any

    def send(self, kind: str, content: object) -> None:
        # A worker that has ended is noticed by the lane that waits for its answer.
        with contextlib.suppress(OSError):
            self.pipe.send_bytes(dumps((kind, content)))

    def is_alive(self) -> bool:
        return self.process.poll() is None

    def kill(self) -> None:
        """Kill it at once, and all processes that it started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def end(self) -> None:
        self.kill()
        self.process.wait()
        self.pipe.close()


def _start_worker() -> _Worker:
    """Start a worker in a process group of its own, which no Ctrl-C reaches."""
    pipe, theirs = Pipe()
    with theirs:
        number = theirs.fileno()
        process = subprocess.Popen(  # noqa: S603 - this very Python
            [sys.executable, "-P", "-c", _WORKER, str(number), str(os.getpid())],
            env=_FREED_STAYS | os.environ | _SINGLE_THREAD,
            pass_fds=[number],
            process_group=0,
        )
    with contextlib.suppress(OSError):  # as above
        pipe.send(sys.path)
    return _Worker(process, pipe)


class _Lane(Generic[W, R]):
    """A sequence of workers, each with one piece of work at a time."""

    work: W
    _worker: _Worker | None = None

    def __init__(
        self, function: Callable[[W], Iterable[R]], limit_s: float | None
    ) -> None:
        self._function, self._limit_s = function, limit_s
        self.is_busy = False

    @property
    def pipe(self) -> Any:  # noqa: ANN401 - untyped
        return None if self._worker is None else self._worker.pipe

    def begin(self) -> _Worker:
        """Take an idle worker, or start a new worker."""
        while _idle_workers and not _idle_workers[-1].is_alive():
            _idle_workers.pop().end()
        self._worker = _idle_workers.pop() if _idle_workers else _start_worker()
        self._worker.send("function", self._function)
        return self._worker

    def start(self, work: W) -> None:
        self.work, self.is_busy, self._overdue = work, True, ""
        self._cell: tuple[str, ...] = ()
        self._since_s = time.monotonic()
        worker = self._worker
        if worker is None or not worker.is_alive():  # killed with nothing to do
            self.stop()
            worker = self.begin()
        worker.send("work", work)

    def items(self) -> list[R | Failure]:
        """Return the next results, and note the end of the work; kill a late worker."""
        # First: the messages of a worker that has ended are still in the pipe.
        worker_ended = self._worker is None or not self._worker.is_alive()
        try:
            while self.is_busy and self.pipe.poll():
                kind, content = _receive_message(self.pipe)
                if kind == "cell":
                    self._cell, self._since_s = content, time.monotonic()
                elif kind == "item":
                    return [content]
                elif kind == "raised" and isinstance(content, Exception):
                    raise content
                else:
                    self.is_busy = False
                    if kind == "raised":
                        # KeyboardInterrupt, say: no Ctrl-C reaches a worker.
                        message = f"it raised {type(content).__name__}"
                        return [Failure(self._cell, message)]
        except (EOFError, ConnectionError):
            worker_ended = True
        if worker_ended and self.is_busy:
            return [self._end_of_worker()]
        is_late = (
            self._limit_s is not None
            and time.monotonic() - self._since_s > self._limit_s
        )
        if self.is_busy and self._cell and is_late and not self._overdue:
            self._overdue = f"it ran for longer than {self._limit_s:g} s"
            if self._worker is not None:
                self._worker.kill()
        return []

    def _end_of_worker(self) -> Failure:
        """Return the failure of a work whose worker has ended before it was done."""
        self.stop()
        self.is_busy = False
        if self._overdue:
            return Failure(self._cell, self._overdue, timed_out=True)
        message = "its worker died (killed, crashed or out of memory)"
        return Failure(self._cell, message, worker_died=True)

    def stop(self, *, keeps: bool = False) -> None:
        """End the worker, if there is one, or keep it if it has nothing to do."""
        if self._worker is not None:
            if keeps and not self.is_busy:
                _idle_workers.append(self._worker)
            else:
                self._worker.end()
            self._worker = None


# From here on: in a worker.


def serve(pipe: Any, *, parent: int) -> None:  # noqa: ANN401 - a connection, untyped
    """Do the work that comes through a pipe; report each cell and send the results."""
    # An interrupt here is a plug-in's: the user's reaches the parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(parent,), daemon=True).start()
    current_cell.report = lambda names: pipe.send_bytes(*_pack_message("cell", names))
    # Imported modules stay, and arrays form no cycles: to search for cycles would take
    # one second of 20.
    gc.disable()
    libc = _glibc()
    function: Any = None
    with contextlib.suppress(EOFError, OSError):  # the parent is gone
        while True:
            kind, content = pipe.recv()
            if kind == "function":
                function = content
            elif kind == "work":
                for answer in _answer_messages(function, content):
                    for part in answer:
                        pipe.send_bytes(part)
                    del answer, part  # a large result must not stay in memory
                content = None
                _trim_memory(libc)
                gc.freeze()
            else:
                for name in content:
                    # An error is ignored here: the cell that needs it fails by name.
                    with contextlib.suppress(Exception):
                        import_module(name)


def _end_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)


def _answer_messages(
    function: Callable[[W], Iterable[R]], work: W
) -> Iterator[list[Any]]:
    """Yield messages: each item as it comes, and at the end `done`, or the error."""
    undo = _protect_process()
    try:
        note_cell()
        for item in function(work):
            undo()
            yield _pack_message("item", item)
        yield _pack_message("done", None)
    except BaseException as error:  # noqa: BLE001 - the parent reports it
        undo()
        error.add_note(traceback.format_exc())
        try:
            yield _pack_message("raised", error)
        except Exception:  # noqa: BLE001 - a plug-in's error may not be sendable
            yield _pack_message("raised", RuntimeError(error_text(error)))


def _pack_message(kind: str, content: object) -> list[Any]:
    """Return the parts of a message for `_receive_message`; arrays are not copied."""
    arrays: list[Any] = []
    packed = dumps((kind, content), protocol=5, buffer_callback=arrays.append)
    return [dumps((packed, len(arrays))), *(array.raw() for array in arrays)]


def _receive_message(pipe: Any) -> Any:  # noqa: ANN401 - a connection, untyped
    content, n_arrays = pipe.recv()
    return loads(content, buffers=[pipe.recv_bytes() for _ in range(n_arrays)])


def _protect_process() -> Callable[[], None]:
    """Return a function that restores the recursion limit and the output streams."""
    limit = sys.getrecursionlimit()
    # As numpy begins, whatever a plug-in's module has set.
    np.seterr(all="warn", under="ignore")
    if not _own_streams:
        with contextlib.suppress(OSError):  # without streams
            _own_streams.update({number: os.dup(number) for number in (1, 2)})

    def undo() -> None:
        sys.setrecursionlimit(limit)
        for number, own in _own_streams.items():
            os.dup2(own, number)

    return undo
