"""The same cells, bit by bit, on the scheduler and workers of a user's Dask cluster.

When a worker dies, Dask gives its work to another worker. Work that has killed several
workers is tried once more with nothing beside it, so that no innocent work is blamed.
"""

import contextlib
import logging
import platform
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from importlib import import_module
from importlib.metadata import version
from typing import Any, Final, Generic, TypeAlias, TypeVar

from cloudpickle import dumps, loads
from threadpoolctl import threadpool_limits

from evaluation.compute.current_cell import Failure, note_cell
from evaluation.plan.origins import OURS
from evaluation.plan.source_digest import code_hash, short_digest
from evaluation.pool.memory import release_memory_after
from isac_track.command_line import check_interrupt
from isac_track.errors import SettingsError, error_text

W = TypeVar("W")
R = TypeVar("R")
# Both are of `distributed`: an optional dependency, without types.
Client: TypeAlias = Any
Future: TypeAlias = Any

_CONNECT_S: Final = 5.0  # Longest time until a scheduler answers.
_FIRST_WORKER_S: Final = 10.0  # Longest time until it has a worker.
# Longest time without any worker: those that died may be started again.
_NO_WORKER_S: Final = 60.0
# Longest time that a scheduler may take to say how many threads there are.
_ANSWER_S: Final = 8.0
_ASK_S: Final = 2.0  # Between two such questions.
_LOOK_S: Final = 0.02  # Between two looks for ended works.
_FETCH_S: Final = 10.0  # Longest time that fetching the results of a work may take.
# Works handed out per thread: no worker waits, and nobody holds many.
_AHEAD: Final = 2
# Graphs with tracks are larger than the usual limit: no warning.
_LARGE: Final = {"distributed.admin.large-graph-warning-threshold": "1GiB"}
_LIBRARIES: Final = ("numpy", "scipy", "numba")
_LOADING: Final = threading.Lock()
_LOADED: Final[dict[str, str]] = {}
"""Digests of the source that this process has loaded: see `_describe_worker`."""


def spread_on_cluster(
    function: Callable[[W], Iterable[R]],
    works: deque[W],
    *,
    scheduler: str,
    modules: Iterable[str],
) -> Generator[tuple[W, R | Failure]]:
    """Yield every result with its work, as works end: `spread` on a cluster.

    A work whose workers died again and again yields a `Failure` of an unknown cell.
    `scheduler` is an address, such as ``tcp://host:8786``; workers must have the same
    source of all `modules`.

    Raises SettingsError if the scheduler cannot be reached or has stopped, no worker is
    there, or a worker would not compute the same.
    """
    user_modules = tuple(
        module for module in modules if module.partition(".")[0] not in OURS
    )
    with _connected(scheduler) as client:
        cluster = _Cluster(function, client, scheduler, user_modules)
        suspects: deque[W] = deque()
        try:
            while works or suspects or cluster.under_way:
                check_interrupt()
                while works and len(cluster.under_way) < _AHEAD * cluster.n_threads:
                    cluster.start(works.popleft())
                if suspects and not cluster.under_way:
                    cluster.start(suspects.popleft())
                for work, result in cluster.new_results():
                    n_before = len(works)
                    yield work, result
                    # A death may be a neighbour's fault: work that is added after it
                    # waits until all else is done, and is tried one at a time.
                    if isinstance(result, Failure) and result.worker_died:
                        again = [works.pop() for _ in range(len(works) - n_before)]
                        suspects.extend(reversed(again))
        finally:
            if cluster.under_way and client.status == "running":
                with contextlib.suppress(Exception):
                    client.cancel([*cluster.under_way])


class _Cluster(Generic[W, R]):
    """The workers of a scheduler."""

    def __init__(
        self,
        function: Callable[[W], Iterable[R]],
        client: Client,
        scheduler: str,
        modules: tuple[str, ...],
    ) -> None:
        from distributed import as_completed  # noqa: PLC0415 - an extra

        self._client, self._scheduler, self._modules = client, scheduler, modules
        # Some versions of distributed have no types here, others do.
        untyped: Any = as_completed
        self._completed = untyped(loop=client.loop)
        self._expected = _describe_process(modules, digests={})
        self.n_threads = 1
        self.under_way: dict[Future, W] = {}
        self._asked_s = self._worked_s = time.monotonic()
        self._check_workers()
        # Packed for the workers only: the scheduler may lack a user's plug-in.
        self._function = self._submit(_load, dumps(function))

    def _check_workers(self) -> None:
        """Raise SettingsError unless there are workers that compute the same."""
        until = time.monotonic() + _FIRST_WORKER_S
        while not self._ask_threads():
            if time.monotonic() > until:
                raise SettingsError(
                    f"the scheduler at {self._scheduler} has no workers; start some"
                    f" with `dask worker {self._scheduler}`"
                )
            time.sleep(_LOOK_S)
        try:
            answers = self._client.run(
                _describe_worker, self._modules, on_error="return"
            )
        except (OSError, TimeoutError):
            raise self._lost_error() from None
        for worker, answer in answers.items():
            if isinstance(answer, SettingsError):
                raise SettingsError(f"worker {worker}: {answer}")
            if isinstance(answer, Exception):
                raise SettingsError(
                    f"worker {worker} lacks this isac-track ({type(answer).__name__}:"
                    f" {answer}); install it there"
                )
            _check_same_versions(answer, self._expected, worker=worker)

    def start(self, work: W) -> None:
        arguments = (self._function, dumps(work), self._modules, self._expected)
        task = self._submit(_compute, *arguments)
        self.under_way[task] = work
        self._completed.add(task)

    def _submit(self, function: Callable[..., Any], *arguments: object) -> Future:
        return self._client.submit(
            function, *arguments, key=f"isac-track-{uuid.uuid4().hex}"
        )

    def new_results(self) -> Iterator[tuple[W, R | Failure]]:
        """Yield the results of works that have ended, if there are any by now.

        Raises SettingsError if the scheduler or all workers are lost.
        """
        self._check_alive()
        time.sleep(_LOOK_S)
        for task in self._completed.next_batch(block=False):
            results = self._task_results(task)
            if results is None:
                self._completed.add(task)
                continue
            work = self.under_way.pop(task)
            task.release()
            for result in results:
                yield work, result

    def _check_alive(self) -> None:
        if self._client.status != "running":
            raise self._lost_error()
        if time.monotonic() < self._asked_s + _ASK_S:
            return
        if self._ask_threads():
            self._worked_s = time.monotonic()
        elif self._asked_s > self._worked_s + _NO_WORKER_S:
            start = f"some (`dask worker {self._scheduler}`)"
            raise self._lost_error(f"has had no worker for {_NO_WORKER_S:g} s", start)

    def _task_results(self, task: Future) -> list[R | Failure] | None:
        """Return the results of a task; None if they cannot be fetched (any more)."""
        from distributed import CancelledError  # noqa: PLC0415 - an extra
        from distributed.scheduler import KilledWorker  # noqa: PLC0415 - an extra

        try:
            results: list[R | Failure] = task.result(timeout=_FETCH_S)
        except KilledWorker:
            why = (
                "its worker died (killed, crashed or out of memory), and others"
                " before it"
            )
            return [Failure((), why, worker_died=True)]
        except CancelledError:
            raise self._lost_error() from None
        except (OSError, TimeoutError):
            if task.status == "error":  # its own
                raise
            # The worker that had them is lost, or fetching takes long.
            return None
        except RuntimeError as error:
            if "deserialization of the task graph" not in str(error):
                raise
            raise SettingsError(
                f"the scheduler at {self._scheduler} lacks this isac-track; install it"
                " there, too"
            ) from None
        return results

    def _ask_threads(self) -> int:
        """Ask for the threads of all workers; 0 without workers."""
        try:
            threads = self._client.sync(
                self._client.scheduler.ncores, callback_timeout=_ANSWER_S
            )
        except (OSError, TimeoutError, AttributeError):
            # Without a connection the scheduler is None.
            raise self._lost_error() from None
        self._asked_s = time.monotonic()
        n_threads: int = sum(threads.values())
        self.n_threads = n_threads or self.n_threads
        return n_threads

    def _lost_error(self, state: str = "is gone", start: str = "it") -> SettingsError:
        return SettingsError(
            f"the scheduler at {self._scheduler} {state}; finished cells stay;"
            f" start {start} and run the same command again"
        )


@contextlib.contextmanager
def _connected(scheduler: str) -> Iterator[Client]:
    """Connect, and leave the cluster as it was; Dask's loggers are quiet meanwhile."""
    try:
        import dask  # noqa: PLC0415 - an extra
        import distributed  # noqa: PLC0415 - an extra
    except ImportError:
        raise SettingsError("--executor dask: pip install 'isac-track[dask]'") from None
    noisy = ("distributed", "tornado", "asyncio")
    names = [
        name
        for name in logging.root.manager.loggerDict
        if name.partition(".")[0] in noisy
    ]
    with contextlib.ExitStack() as ends:
        for logger in map(logging.getLogger, {*names, "distributed", "asyncio"}):
            ends.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)  # important errors are raised in one line
        ends.enter_context(dask.config.set(_LARGE))
        try:
            # Some versions of distributed have no types here, others do.
            untyped: Any = distributed.Client
            client: Client = untyped(
                scheduler, timeout=_CONNECT_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise SettingsError(
                f"no Dask scheduler answers at {scheduler!r} ({why}); start one with "
                "`dask scheduler`, and workers with `dask worker ADDRESS`"
            ) from None
        try:
            yield client
        finally:
            with contextlib.suppress(Exception):  # it may be gone
                client.close(timeout=_CONNECT_S)


# From here on: in a worker, several threads at a time.


def _load(packed: bytes) -> Any:  # noqa: ANN401 - what was packed
    with _LOADING:
        return loads(packed)


def _compute(
    function: Callable[[W], Iterable[R]],
    packed: bytes,
    modules: tuple[str, ...],
    expected: Mapping[str, str],
) -> list[R]:
    """Compute a work in a worker, which may have joined after the first check."""
    from distributed import get_worker  # noqa: PLC0415 - an extra

    _check_same_versions(
        _describe_worker(modules), expected, worker=get_worker().address
    )
    work: W = _load(packed)
    # Never lifted: the limit is the process's, and other threads may be computing.
    threadpool_limits(limits=1)
    note_cell()
    with release_memory_after():
        return list(function(work))


def _describe_worker(modules: tuple[str, ...]) -> dict[str, str]:
    """Return all that the bits of a result depend on in a worker.

    A worker computes with the source that it loaded first, whatever the files hold
    later. Its digests stay in `_LOADED` for the life of the process: nothing empties it.
    """
    return _describe_process(modules, digests=_LOADED)


def _describe_process(
    modules: tuple[str, ...], *, digests: dict[str, str]
) -> dict[str, str]:
    """Return all that the bits of a result depend on in a process.

    Digests of the source that are not in `digests` yet are added to it.
    """
    with _LOADING:
        if "code" not in digests:
            digests["code"] = code_hash()
        for name in modules:
            if f"module {name}" not in digests:
                try:
                    import_module(name)
                    digests[f"module {name}"] = short_digest(name)
                # A user's module may raise anything.
                except (Exception, SystemExit) as error:  # noqa: BLE001 - as said
                    raise SettingsError(
                        f"cannot import {name!r} ({error_text(error)}), which a plug-in"
                        " of the run needs; it must be importable on every worker, as"
                        " by PYTHONPATH"
                    ) from None
    return {
        "code": digests["code"],
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in _LIBRARIES},
        **{f"module {name}": digests[f"module {name}"] for name in modules},
    }


def _check_same_versions(
    answer: Mapping[str, str], expected: Mapping[str, str], *, worker: str
) -> None:
    """Raise SettingsError if a worker's results might not be the same to the bit."""
    different = [
        f"{key} {answer.get(key)} instead of {value}"
        for key, value in expected.items()
        if answer.get(key) != value
    ]
    if different:
        raise SettingsError(
            f"worker {worker} would not compute the same: {', '.join(different)}; "
            "bring it to the same version and start it again"
        )
