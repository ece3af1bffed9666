"""Works handed out and taken back, and worker processes of this machine that do them.

Each worker is in a lane of its own, so that one that dies takes nobody along: a pool of several
that share a queue breaks as a whole when one of them is killed, and nobody can tell what it was at.
Here each lane is a loky executor of one process. The process notes where it is before each cell, in
a file that outlives it: that names the culprit, and tells how long a cell has been running. The
file has no name in any folder, so that nobody has to remove it.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections import deque
from multiprocessing import resource_tracker
from multiprocessing.reduction import DupFd
from operator import methodcaller
from typing import TYPE_CHECKING, Any, Final, Generic, Protocol, TypeAlias, TypeVar

import pyarrow as pa
from joblib.externals.loky import (
    FIRST_COMPLETED,
    BrokenProcessPool,
    Future,
    ProcessPoolExecutor,
    wait,
)
from threadpoolctl import threadpool_limits

from evaluation.cells.work import NOTE_BYTES, Failed, note, note_to
from isac_track.command_line import check_interrupt
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator

W = TypeVar("W")
R = TypeVar("R")
Ended: TypeAlias = "tuple[W, list[R | Failed]]"
"""A work, and what came of it."""

_ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""More would fight over the cores; and a sum depends on how many share it."""
_LOOK_S: Final = 0.25
"""How often running cells are held against their limit."""
_SET_PARENT_DEATH_SIGNAL: Final = 1
"""Of Linux's prctl."""
_M_ARENA_MAX: Final = -8
"""Of glibc's malloc.h."""


class _Crew(Protocol[W, R]):
    """Those who compute: lanes of this machine, or a cluster."""

    knows_culprits: bool
    """Whether a worker's death blames nobody but the cell at which it came."""

    def n_busy(self) -> int: ...
    def has_room(self) -> bool: ...
    def start(self, work: W) -> None: ...
    def ended(self) -> Iterator[Ended[W, R]]: ...  # of the works under way, after a moment


def hand_out(works: deque[W], crew: _Crew[W, R]) -> Generator[Ended[W, R]]:
    """Yield each work with what came of it, as it is finished; works may be added meanwhile.

    Where a death may be a neighbour's fault, what is added after one waits until nothing else is
    left, and is tried one at a time.
    """
    suspects: deque[W] = deque()
    while works or suspects or crew.n_busy():
        check_interrupt()
        while works and crew.has_room():
            crew.start(works.popleft())
        if suspects and not crew.n_busy():
            crew.start(suspects.popleft())
        for work, items in crew.ended():
            known = len(works)
            yield work, items
            died = any(isinstance(one, Failed) and one.died for one in items)
            if died and not crew.knows_culprits:
                again = [works.pop() for _ in range(len(works) - known)]
                suspects.extend(reversed(again))


def spread(
    function: Callable[[W], Iterable[R]], works: deque[W], *, jobs: int, limit_s: float | None
) -> Generator[tuple[W, Iterable[R | Failed]]]:
    """Yield each work with what the function makes of it, as it is finished.

    Works may be added while this runs. With one job and no limit, all is computed in this process
    and while what is yielded is read; else a worker's whole list is yielded at once. One piece of
    work that is left of many still gets a worker: it may be what kills its process.

    Parameters
    ----------
    function : callable
        Notes with `note` where it is.
    works : deque
        Emptied.
    jobs : int
        Worker processes.
    limit_s : float, optional
        Longest time between two notes; a worker that takes longer is killed.

    Raises
    ------
    DataError
        If the workers have no room for their notes.
    Exception
        What the function raises.
    """
    if limit_s is None and jobs == 1:
        with threadpool_limits(limits=1):
            while works:
                work = works.popleft()
                note()
                yield work, function(work)
        return
    with contextlib.ExitStack() as ends:
        lanes = []
        for _ in range(min(jobs, len(works))):
            lanes.append(_Lane[W, R](function, limit_s))
            ends.callback(lanes[-1].close)
        yield from hand_out(works, _Lanes(lanes))


@contextlib.contextmanager
def given_back() -> Iterator[None]:
    """Give back to the system what was freed while this was open: one process may run many.

    The results of workers arrive in threads. glibc gives these arenas of their own, whose ends
    ``malloc_trim`` cannot reach, and pyarrow's pools keep pieces that the next run does not quite
    fill: eight small runs in a row grew from 548 to 763 MB with nothing leaked. So threads share
    an arena from now on (one that has its own already keeps it), and pyarrow takes its memory
    from malloc meanwhile. With another C library, malloc is left as it is.
    """
    pool = pa.default_memory_pool()
    libc: Any = None
    with contextlib.suppress(OSError, TypeError):  # Windows: there is no name for "this process"
        libc = ctypes.CDLL(None)
    is_glibc = hasattr(libc, "malloc_trim")
    if is_glibc:
        libc.mallopt(_M_ARENA_MAX, 1)
    pa.set_memory_pool(pa.system_memory_pool())
    try:
        yield
    finally:
        pa.set_memory_pool(pool)
        gc.collect()
        if is_glibc:
            libc.malloc_trim(ctypes.c_size_t(0))


class _Lanes(Generic[W, R]):
    knows_culprits = True

    def __init__(self, lanes: list[_Lane[W, R]]) -> None:
        self._lanes = lanes

    def _futures(self) -> list[Future[list[R]]]:
        return [lane.future for lane in self._lanes if lane.future is not None]

    def n_busy(self) -> int:
        return len(self._futures())

    def has_room(self) -> bool:
        return self.n_busy() < len(self._lanes)

    def start(self, work: W) -> None:
        next(lane for lane in self._lanes if lane.future is None).start(work)

    def ended(self) -> Iterator[Ended[W, R]]:
        wait(self._futures(), timeout=_LOOK_S, return_when=FIRST_COMPLETED)
        for lane in self._lanes:
            if lane.future is not None and (items := lane.items()) is not None:
                yield lane.work, items


class _Board:
    """Where a worker's notes are; the worker gets the descriptor of the same file."""

    def __init__(self) -> None:
        try:
            self.file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - closed by its lane
            self.clear()
        except OSError as error:
            raise DataError(
                f"no room for temporary files: {error.strerror}; finished cells are kept "
                "(TMPDIR names another folder)"
            ) from None

    def __reduce__(self) -> tuple[Callable[[Any], int], tuple[Any]]:
        return methodcaller("detach"), (DupFd(self.file.fileno()),)

    def clear(self) -> None:
        # All of its length: what is written over it later needs no room on a full disk.
        os.pwrite(self.file.fileno(), b" " * NOTE_BYTES, 0)

    def read(self) -> tuple[int, float, list[str]]:
        """Return process, time and place; zeros and nothing if there is no whole note."""
        try:
            pid, since, at = json.loads(os.pread(self.file.fileno(), NOTE_BYTES, 0))
        except ValueError:
            return 0, 0.0, []
        return pid, since, at


class _Lane(Generic[W, R]):
    """One worker process after another, one piece of work at a time."""

    work: W

    def __init__(self, function: Callable[[W], Iterable[R]], limit_s: float | None) -> None:
        self._function, self._limit_s = function, limit_s
        self._board = _Board()
        self._executor: Any = None
        self._overdue = ""
        self.future: Future[list[R]] | None = None

    def start(self, work: W) -> None:
        self.work, self._overdue = work, ""
        with _ctrl_c_is_not_inherited():
            try:
                self.future = self._submitted()
            except BrokenProcessPool:  # its worker was killed while it had nothing to do
                self._stop()
                self.future = self._submitted()

    def _submitted(self) -> Future[list[R]]:
        if self._executor is None:
            self._board.clear()
            self._executor = ProcessPoolExecutor(
                max_workers=1,
                initializer=_begin,
                initargs=(self._board, os.getpid()),
                env=_ONE_THREAD,
            )
        future: Future[list[R]] = self._executor.submit(_listed, self._function, self.work)
        return future

    def items(self) -> list[R | Failed] | None:
        """Return what came of the work, if it is done or the worker is; kill one that is late."""
        assert self.future is not None
        pid, since, at = self._board.read()
        is_late = self._limit_s is not None and time.monotonic() - since > self._limit_s
        if pid and at and is_late and not self._overdue:
            self._overdue = f"it ran for longer than {self._limit_s:g} s"
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        if not self.future.done():
            return None
        error, future = self.future.exception(), self.future
        self.future = None
        if error is None:
            return [*future.result()]
        at = self._board.read()[2]
        if isinstance(error, BrokenProcessPool):
            self._stop()
            why = self._overdue or "its worker died (killed, crashed or out of memory)"
            return [Failed(tuple(at), why, died=not self._overdue)]
        if isinstance(error, Exception):
            raise error
        # KeyboardInterrupt, say: raised by a plug-in, since no Ctrl-C reaches a worker.
        return [Failed(tuple(at), f"it raised {type(error).__name__}")]

    def _stop(self) -> None:
        """End the worker, whatever it is at."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=True)
            self._executor = None

    def close(self) -> None:
        self._stop()
        self._board.file.close()


@contextlib.contextmanager
def _ctrl_c_is_not_inherited() -> Iterator[None]:
    """Start processes that no Ctrl-C reaches, not even while they start; it waits for the end."""
    resource_tracker.ensure_running()  # it would let Ctrl-C through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# From here on: in a worker.


def _begin(file: int, parent: int) -> None:
    """Begin a worker: it notes where it is, leaves Ctrl-C to its parent, and ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    note_to(file)
    if sys.platform == "linux":
        # The system ends it also where a plug-in lets no other thread run.
        ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)


def _listed(function: Callable[[W], Iterable[R]], work: W) -> list[R]:
    # What was imported stays, and arrays form no circles: to look for them takes one second of 20.
    gc.freeze()
    gc.disable()
    try:
        note()
        found = list(function(work))
        note()  # idle: no cell is under way
    finally:
        gc.enable()
        gc.collect()
    return found
