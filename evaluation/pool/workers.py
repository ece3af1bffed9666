"""Works handed out to worker processes of this machine, and what comes back of them.

Each worker is in a lane of its own, at the other end of a pipe: one that dies takes
nobody along. It tells where it is before each cell, which names the culprit and times
it.
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

from evaluation.compute.where import Failed, here, note
from isac_track.command_line import check_interrupt
from isac_track.errors import told

W = TypeVar("W")
R = TypeVar("R")
_ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"),
    "1",
)
"""More would fight over the cores; and a sum depends on how many share it."""
_FREED_STAYS: Final = {
    "MALLOC_TRIM_THRESHOLD_": str(2**26),
    "MALLOC_MMAP_THRESHOLD_": str(2**25),
}
"""Of glibc's malloc, which else gives every larger array back to the system, page by page."""
_LOOK_S: Final = 0.25  # How often running cells are held against their limit.
_WORKER: Final = """
import ctypes, os, signal, sys
if sys.platform == "linux":  # 1: it ends with its parent, even where no other thread may run
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
from multiprocessing.connection import Connection
pipe = Connection(int(sys.argv[1]))
try:
    sys.path[:] = pipe.recv()
except (EOFError, OSError):  # the parent was killed meanwhile
    sys.exit()
from evaluation.pool.workers import serve
serve(pipe, parent=int(sys.argv[2]))
"""
_waiting: Final[
    "list[_Worker]"
] = []  # With nothing to do: who spreads work takes them first.
_CELLS_NEED: Final = (
    "evaluation.pool.pieces",
    "evaluation.compute.sample_tracks",
    "numba",
)
_heard: Final[dict[int, int]] = {}  # Output and errors of this process, as it began.
_M_ARENA_MAX: Final = -8  # Of glibc's malloc.h.


def spread(
    function: Callable[[W], Iterable[R]],
    works: deque[W],
    *,
    jobs: int,
    limit_s: float | None,
    apart: bool = False,
    alone: bool = False,
) -> Generator[tuple[W, Iterable[R | Failed]]]:
    """Yield each work with what the function makes of it, again and again as it comes.

    The function notes with `note` where it is. Works may be added while this runs. With
    one job and no limit, all is computed in this process and while what is yielded is
    read, unless it is to be kept `apart`; else by workers, of which one that takes
    longer than `limit_s` between two notes is killed: what it has sent stays. What is
    left of many still gets one: it may kill its process.

    Workers that are done wait for other work until `ahead` ends; if this goes on
    `alone`, before other work, those do that nobody took. Raises what the function
    raises.
    """
    if limit_s is None and jobs == 1 and not apart:
        with threadpool_limits(limits=1):
            while works:
                work = works.popleft()
                note()
                yield work, function(work)
        return
    with contextlib.ExitStack() as ends:
        lanes = [_Lane[W, R](function, limit_s) for _ in range(min(jobs, len(works)))]
        for lane in lanes:  # to begin takes a worker 1 to 2 s: all at once
            ends.callback(lane.stop, keeps=not alone)
            lane.begin()
        dismiss(len(_waiting) if alone else 0)  # there is no work for more
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
def ahead(n_workers: int = 0, needed: Sequence[str] = _CELLS_NEED) -> Iterator[None]:
    """Start workers that import what is needed meanwhile; at the end dismiss all that wait."""
    try:
        for _ in range(n_workers):
            _waiting.append(_started())
            _waiting[-1].tell("import", needed)
        yield
    finally:
        dismiss()


@contextlib.contextmanager
def aside(call: Callable[[], R]) -> Iterator[Callable[[], R]]:
    """Let a worker that waits call something meanwhile; entered is what waits for the result.

    Without a worker, or if it dies over it, the call is made here, once the result is
    asked for: that raises what the call does.
    """
    if not _waiting:
        yield call
        return
    lane = _Lane[Callable[[], R], R](lambda of: [of()], None)
    lane.start(call)

    def result() -> R:
        found: list[R | Failed] = []
        while lane.is_busy:
            check_interrupt()
            connection.wait([lane.pipe], timeout=_LOOK_S)
            found += lane.items()
        return call() if isinstance(found[0], Failed) else found[0]

    try:
        yield result
    finally:
        lane.stop(keeps=True)


def dismiss(but: int = 0) -> None:
    """End the workers that wait, all but some."""
    while len(_waiting) > but:
        _waiting.pop().end()


@contextlib.contextmanager
def given_back() -> Iterator[None]:
    """Give back to the system what was freed while this was open: one process may run many.

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
        _give_back(libc)


def _glibc() -> Any | None:  # noqa: ANN401 - untyped
    with contextlib.suppress(
        OSError, TypeError
    ):  # Windows: there is no name for "this process"
        libc = ctypes.CDLL(None)
        return libc if hasattr(libc, "malloc_trim") else None
    return None


def _give_back(libc: Any | None) -> None:  # noqa: ANN401 - untyped
    gc.collect()
    if libc is not None:
        libc.malloc_trim(ctypes.c_size_t(0))


class _Worker(NamedTuple):
    """A process at the other end of a pipe."""

    process: subprocess.Popen[bytes]
    pipe: Any

    def tell(self, kind: str, content: object) -> None:
        with contextlib.suppress(
            OSError
        ):  # it is gone: who waits for an answer finds that
            self.pipe.send_bytes(dumps((kind, content)))

    def is_alive(self) -> bool:
        return self.process.poll() is None

    def kill(self) -> None:
        """Kill it, whatever it is at, and all that it started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def end(self) -> None:
        self.kill()
        self.process.wait()
        self.pipe.close()


def _started() -> _Worker:
    """Start a worker in a group of its own, which no Ctrl-C reaches: it waits for the end."""
    pipe, theirs = Pipe()
    with theirs:
        number = theirs.fileno()
        process = subprocess.Popen(  # noqa: S603 - this very Python
            [sys.executable, "-P", "-c", _WORKER, str(number), str(os.getpid())],
            env=_FREED_STAYS | os.environ | _ONE_THREAD,
            pass_fds=[number],
            process_group=0,
        )
    with contextlib.suppress(OSError):  # as above
        pipe.send(sys.path)
    return _Worker(process, pipe)


class _Lane(Generic[W, R]):
    """One worker after another, one piece of work at a time."""

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
        """Take a worker that waits, or start one."""
        while _waiting and not _waiting[-1].is_alive():
            _waiting.pop().end()
        self._worker = _waiting.pop() if _waiting else _started()
        self._worker.tell("function", self._function)
        return self._worker

    def start(self, work: W) -> None:
        self.work, self.is_busy, self._overdue = work, True, ""
        self._at: tuple[str, ...] = ()
        self._since_s = time.monotonic()
        worker = self._worker
        if worker is None or not worker.is_alive():  # killed with nothing to do
            self.stop()
            worker = self.begin()
        worker.tell("work", work)

    def items(self) -> list[R | Failed]:
        """Return what comes next; busy no more if that was all. Kill a worker that is late."""
        # First: what it said before it ended is still there.
        is_gone = self._worker is None or not self._worker.is_alive()
        try:
            while self.is_busy and self.pipe.poll():
                kind, said = _received(self.pipe)
                if kind == "at":
                    self._at, self._since_s = said, time.monotonic()
                elif kind == "item":
                    return [said]
                elif kind == "raised" and isinstance(said, Exception):
                    raise said
                else:
                    self.is_busy = False
                    if (
                        kind == "raised"
                    ):  # KeyboardInterrupt, say: no Ctrl-C reaches a worker
                        return [Failed(self._at, f"it raised {type(said).__name__}")]
        except (EOFError, ConnectionError):
            is_gone = True
        if is_gone and self.is_busy:
            self.stop()
            self.is_busy = False
            why = self._overdue or "its worker died (killed, crashed or out of memory)"
            return [
                Failed(
                    self._at, why, died=not self._overdue, is_late=bool(self._overdue)
                )
            ]
        is_late = (
            self._limit_s is not None
            and time.monotonic() - self._since_s > self._limit_s
        )
        if self.is_busy and self._at and is_late and not self._overdue:
            self._overdue = f"it ran for longer than {self._limit_s:g} s"
            if self._worker is not None:
                self._worker.kill()
        return []

    def stop(self, *, keeps: bool = False) -> None:
        """End the worker, if there is one, or keep it if it has nothing to do."""
        if self._worker is not None:
            if keeps and not self.is_busy:
                _waiting.append(self._worker)
            else:
                self._worker.end()
            self._worker = None


# From here on: in a worker.


def serve(pipe: Any, *, parent: int) -> None:  # noqa: ANN401 - a connection, untyped
    """Do what comes through a pipe, and tell where that is and what came of it."""
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # one here is a plug-in's: the user's goes above
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    here.tell = lambda at: pipe.send_bytes(*_packed("at", at))
    # What was imported stays, and arrays form no circles: to look for them takes one
    # second of 20.
    gc.disable()
    libc = _glibc()
    function: Any = None
    with contextlib.suppress(EOFError, OSError):  # the parent is gone
        while True:
            kind, said = pipe.recv()
            if kind == "function":
                function = said
            elif kind == "work":
                for answer in _answers(function, said):
                    for part in answer:
                        pipe.send_bytes(part)
                    del answer, part  # of a result that is large nothing stays
                said = None
                _give_back(libc)
                gc.freeze()
            else:
                for name in said:
                    with contextlib.suppress(Exception):  # who needs it fails by name
                        import_module(name)


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)


def _answers(function: Callable[[W], Iterable[R]], work: W) -> Iterator[list[Any]]:
    """Yield messages: each item as it comes, and at last that this was all, or what was raised."""
    undo = _as_it_is()
    try:
        note()
        for item in function(work):
            undo()
            yield _packed("item", item)
        yield _packed("done", None)
    except BaseException as error:  # noqa: BLE001 - whatever it is, it is the parent's to tell
        undo()
        error.add_note(traceback.format_exc())
        try:
            yield _packed("raised", error)
        except Exception:  # noqa: BLE001 - a stranger's error may not be sendable
            yield _packed("raised", RuntimeError(told(error)))


def _packed(kind: str, said: object) -> list[Any]:
    """Return a message for `_received`; its arrays are sent from where they are, each by itself."""
    arrays: list[Any] = []
    content = dumps((kind, said), protocol=5, buffer_callback=arrays.append)
    return [dumps((content, len(arrays))), *(one.raw() for one in arrays)]


def _received(pipe: Any) -> Any:  # noqa: ANN401 - a connection, untyped
    content, n_arrays = pipe.recv()
    return loads(content, buffers=[pipe.recv_bytes() for _ in range(n_arrays)])


def _as_it_is() -> Callable[[], None]:
    """Return what undoes that a plug-in changes its process: how deep calls go, who hears it."""
    limit = sys.getrecursionlimit()
    np.seterr(
        all="warn", under="ignore"
    )  # as numpy begins, whatever a plug-in's module set
    if not _heard:
        with contextlib.suppress(OSError):  # nobody listens
            _heard.update({number: os.dup(number) for number in (1, 2)})

    def undo() -> None:
        sys.setrecursionlimit(limit)
        for number, own in _heard.items():
            os.dup2(own, number)

    return undo
