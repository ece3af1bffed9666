"""Worker processes: each in a lane of its own, so that one that dies takes nobody along.

A pool of several that share a queue breaks as a whole when one of them is killed, and nobody can
tell what it was at. Here each lane is a loky executor of one process. The process notes where it
is before each cell, in a file that outlives it: that names the culprit, and tells how long a cell
has been running. The file has no name in any folder, so that nobody has to remove it.
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
from multiprocessing import resource_tracker
from multiprocessing.reduction import DupFd
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from evaluation.cells.progress import NOTE_BYTES, Failed, note, note_to
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections import deque
    from collections.abc import Callable, Generator, Iterable, Iterator
    from typing import Self

    from joblib.externals.loky import Future

W = TypeVar("W")
R = TypeVar("R")

_ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""More would fight over the cores; and a sum depends on how many share it."""
_LOOK_S: Final = 0.25
"""How often running cells are held against their limit."""
_SET_PARENT_DEATH_SIGNAL: Final = 1
"""Of Linux's prctl."""


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
            lanes.append(_Lane[W, R](ends.enter_context(_Board())))
            ends.callback(lanes[-1].stop)
        while works or any(lane.is_busy for lane in lanes):
            for lane in lanes:
                if works and not lane.is_busy:
                    lane.start(function, works.popleft())
            _wait([lane for lane in lanes if lane.is_busy])
            for lane in lanes:
                if lane.is_busy and limit_s is not None:
                    lane.end_if_longer_than(limit_s)
                finished = lane.finished()
                if finished is not None:
                    yield finished


class _Board:
    """Where a worker's notes are; the worker gets the descriptor of the same file."""

    def __init__(self) -> None:
        try:
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - closed by __exit__
            self.clear()
        except OSError as error:
            raise DataError(
                f"no room for temporary files: {error.strerror}; finished cells are kept "
                "(TMPDIR names another folder)"
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __reduce__(self) -> tuple[Callable[[Any], int], tuple[Any]]:
        return _descriptor, (DupFd(self._file.fileno()),)

    def clear(self) -> None:
        # All of its length: what is written over it later needs no room on a full disk.
        os.pwrite(self._file.fileno(), b" " * NOTE_BYTES, 0)

    def read(self) -> tuple[int, float, list[str]]:
        """Return process, time and place; zeros and nothing if there is no whole note."""
        content = os.pread(self._file.fileno(), NOTE_BYTES, 0)
        try:
            pid, since, at = json.loads(content)
        except ValueError:
            return 0, 0.0, []
        return pid, since, at


def _descriptor(inherited: Any) -> int:  # noqa: ANN401 - of multiprocessing, untyped
    number: int = inherited.detach()
    return number


class _Lane(Generic[W, R]):
    """One worker process after another, one piece of work at a time."""

    def __init__(self, board: _Board) -> None:
        self._board = board
        self._executor: Any = None
        self._work: W
        self._future: Future[list[R]] | None = None
        self._overdue = ""

    @property
    def is_busy(self) -> bool:
        return self._future is not None

    @property
    def future(self) -> Future[list[R]]:
        assert self._future is not None
        return self._future

    def start(self, function: Callable[[W], Iterable[R]], work: W) -> None:
        from joblib.externals.loky import BrokenProcessPool  # noqa: PLC0415 - only with workers

        self._overdue = ""
        self._work = work
        with _ctrl_c_is_not_inherited():
            try:
                self._future = self._ready().submit(_listed, function, work)
            except BrokenProcessPool:  # its worker was killed while it had nothing to do
                self.stop()
                self._future = self._ready().submit(_listed, function, work)

    def _ready(self) -> Any:  # noqa: ANN401 - of loky, untyped
        from joblib.externals.loky import ProcessPoolExecutor  # noqa: PLC0415 - as above

        if self._executor is None:
            self._board.clear()
            self._executor = ProcessPoolExecutor(
                max_workers=1,
                initializer=_begin,
                initargs=(self._board, os.getpid()),
                env=_ONE_THREAD,
            )
        return self._executor

    def finished(self) -> tuple[W, list[R | Failed]] | None:
        """Return the work and what came of it, if it is done or the worker is."""
        from joblib.externals.loky import BrokenProcessPool  # noqa: PLC0415 - as above

        if self._future is None or not self._future.done():
            return None
        future, self._future = self._future, None
        error = future.exception()
        if error is None:
            return self._work, [*future.result()]
        at = tuple(self._board.read()[2])
        if isinstance(error, BrokenProcessPool):
            why = self._overdue or "its worker died (killed, crashed or out of memory)"
            self.stop()
            return self._work, [Failed(at, why, died=not self._overdue)]
        if isinstance(error, Exception):
            raise error
        # KeyboardInterrupt, say: raised by a plug-in, since no Ctrl-C reaches a worker.
        return self._work, [Failed(at, f"it raised {type(error).__name__}")]

    def end_if_longer_than(self, limit_s: float) -> None:
        """Kill the worker if its cell has been running for longer."""
        pid, since, at = self._board.read()
        if pid and at and not self._overdue and time.monotonic() - since > limit_s:
            self._overdue = f"it ran for longer than {limit_s:g} s"
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def stop(self) -> None:
        """End the worker, whatever it is at."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=True)
            self._executor = None


def _wait(lanes: list[_Lane[W, R]]) -> None:
    from joblib.externals.loky import FIRST_COMPLETED, wait  # noqa: PLC0415 - as above

    wait([lane.future for lane in lanes], timeout=_LOOK_S, return_when=FIRST_COMPLETED)


@contextlib.contextmanager
def _ctrl_c_is_not_inherited() -> Iterator[None]:
    """Start processes that no Ctrl-C reaches, not even while they start; it waits for the end."""
    resource_tracker.ensure_running()  # it would let Ctrl-C through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
