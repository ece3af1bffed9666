"""The same cells on a Dask cluster, to the bit: the user's scheduler, the user's workers.

A worker that is killed costs what it was at, which Dask gives to another. Work that has killed
several is tried once more with nothing beside it, so that no innocent work is blamed.
"""

from __future__ import annotations

import contextlib
import logging
import platform
import threading
import time
import uuid
from collections import deque
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from evaluation.cells.progress import Failed, note
from evaluation.experiment.fingerprint import code_hash, source_digest
from isac_track.command_line import check_interrupt
from isac_track.errors import SettingsError, told

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping

    from evaluation.experiment.axes import Consumer
    from isac_track.plugins import Plugin

W = TypeVar("W")
R = TypeVar("R")
Client: TypeAlias = Any
Task: TypeAlias = Any
"""A future. Neither has types, and both are an extra."""

_CONNECT_S: Final = 5.0
_FIRST_WORKER_S: Final = 10.0
_NO_WORKER_S: Final = 60.0
"""Longest time without any worker: those that died may be started again."""
_ANSWER_S: Final = 8.0
"""Longest time that a scheduler may take to say how many threads its workers have."""
_ASK_S: Final = 2.0
_LOOK_S: Final = 0.02
_FETCH_S: Final = 10.0
_AHEAD: Final = 3
"""Works handed out per thread: no worker waits, and neither driver nor scheduler holds many."""
_LARGE: Final = {"distributed.admin.large-graph-warning-threshold": "1GiB"}
"""Dask warns of large graphs; ours holds the tracks, once."""
_LIBRARIES: Final = ("numpy", "scipy", "numba")
_BEGIN: Final = "start one with `dask scheduler`, and workers with `dask worker ADDRESS`"
_LOADING: Final = threading.Lock()
_FIRST_SEEN: Final[dict[str, str]] = {}
"""Digests of the source as this process loaded it: files may change under a running worker."""


def spread_on_cluster(
    function: Callable[[W], Iterable[R]],
    works: deque[W],
    *,
    scheduler: str,
    modules: Iterable[str] = (),
) -> Generator[tuple[W, Iterable[R | Failed]]]:
    """Yield each work with what the function makes of it, as it is finished.

    Works may be added while this runs. A work whose workers died again and again yields a `Failed`
    of unknown place.

    Parameters
    ----------
    function : callable
        Sent to each worker once; the works with every task.
    works : deque
        Emptied.
    scheduler : str
        Its address, such as ``tcp://host:8786``.
    modules : iterable of str
        Of the user's own plug-ins: the workers must have the same.

    Raises
    ------
    SettingsError
        If the scheduler cannot be reached or is gone, no worker is there, or a worker would not
        compute the same.
    Exception
        What the function raises.
    """
    expected = _about(tuple(modules), seen={})
    with _connected(scheduler) as client:
        cluster = _Cluster(client, scheduler)
        cluster.check_workers(expected)
        run = f"isac-track-{uuid.uuid4().hex}"
        context = _submitted(client, _loaded, _packed(function), key=f"{run}-context")
        under_way: dict[Task, W] = {}
        suspects: deque[W] = deque()
        """They killed workers, or were where one that did was: one at a time, at the end."""
        count = 0
        try:
            while works or suspects or under_way:
                check_interrupt()
                cluster.check()
                most = _AHEAD * cluster.threads
                while (works and len(under_way) < most) or (suspects and not under_way):
                    work = works.popleft() if works else suspects.popleft()
                    count += 1
                    task = _submitted(
                        client,
                        _computed,
                        context,
                        _packed(work),
                        expected,
                        key=f"{run}-{count}",
                    )
                    under_way[task] = work
                ended = [task for task in under_way if task.status not in ("pending", "lost")]
                if not ended:
                    time.sleep(_LOOK_S)
                for task in ended:
                    items = cluster.items(task)
                    if items is None:
                        time.sleep(_LOOK_S)
                        continue
                    work = under_way.pop(task)
                    task.release()
                    known = len(works)
                    yield work, items
                    if any(isinstance(one, Failed) and one.died for one in items):
                        again = [works.pop() for _ in range(len(works) - known)]
                        suspects.extend(reversed(again))
        finally:
            if under_way and client.status == "running":
                with contextlib.suppress(Exception):
                    client.cancel([*under_way])


def own_modules(cells: Iterable[tuple[Plugin, Consumer]]) -> tuple[str, ...]:
    """Return the modules of the plug-ins that are not built in."""
    plugins = {
        one.origin.partition(":")[0]
        for mechanism, consumer in cells
        for one in (mechanism, *consumer.plugins)
    }
    ours = ("isac_track", "predictors", "attacks")
    return tuple(sorted(name for name in plugins if name.partition(".")[0] not in ours))


class _Cluster:
    """A connection to a scheduler, and how many threads its workers have."""

    def __init__(self, client: Client, scheduler: str) -> None:
        self._client = client
        self._scheduler = scheduler
        self._asked_s = self._worked_s = time.monotonic()
        self.threads = 1

    def check_workers(self, expected: Mapping[str, str]) -> None:
        """Raise SettingsError unless workers are there that compute the same."""
        until = time.monotonic() + _FIRST_WORKER_S
        while not self._count():
            if time.monotonic() > until:
                raise SettingsError(
                    f"the scheduler at {self._scheduler} has no workers; start some with "
                    f"`dask worker {self._scheduler}`"
                )
            time.sleep(_LOOK_S)
        modules = tuple(key.removeprefix("module ") for key in expected if " " in key)
        try:
            answers = self._client.run(_about, modules, on_error="return")
        except (OSError, TimeoutError):
            raise self._gone() from None
        for worker, answer in answers.items():
            if isinstance(answer, SettingsError):
                raise SettingsError(f"worker {worker}: {answer}")
            if isinstance(answer, Exception):
                raise SettingsError(
                    f"worker {worker} lacks this isac-track ({type(answer).__name__}: {answer}); "
                    "install it there"
                )
            _check_alike(answer, expected, worker=worker)

    def check(self) -> None:
        """Raise SettingsError if the scheduler is gone, or no worker has been left for long."""
        if self._client.status != "running":
            raise self._gone()
        now = time.monotonic()
        if now < self._asked_s + _ASK_S:
            return
        if self._count():
            self._worked_s = time.monotonic()
        elif now > self._worked_s + _NO_WORKER_S:
            raise SettingsError(
                f"the scheduler at {self._scheduler} has had no worker for {_NO_WORKER_S:g} s; "
                f"finished cells are kept; start some (`dask worker {self._scheduler}`) and run "
                "the same command again"
            )

    def items(self, task: Task) -> list[Any] | None:
        """Return what came of a task; None if it is not there (any more)."""
        from distributed import CancelledError  # noqa: PLC0415 - an extra
        from distributed.scheduler import KilledWorker  # noqa: PLC0415

        try:
            found: list[Any] = task.result(timeout=_FETCH_S)
        except KilledWorker:
            why = "its worker died (killed, crashed or out of memory), and others before it"
            return [Failed((), why, died=True)]
        except CancelledError:
            raise self._gone() from None
        except (OSError, TimeoutError):
            if task.status == "error":  # its own
                raise
            return None  # whoever had it is gone, or it takes long
        except RuntimeError as error:
            if "deserialization of the task graph" in str(error):
                raise SettingsError(
                    f"the scheduler at {self._scheduler} lacks this isac-track; install it there, "
                    "too"
                ) from None
            raise
        return found

    def _count(self) -> int:
        """Ask for the threads of all workers; 0 without workers."""
        try:
            threads = self._client.sync(self._client.scheduler.ncores, callback_timeout=_ANSWER_S)
        except (OSError, TimeoutError, AttributeError):  # without a connection it is None
            raise self._gone() from None
        self._asked_s = time.monotonic()
        n_threads: int = sum(threads.values())
        self.threads = n_threads or self.threads
        return n_threads

    def _gone(self) -> SettingsError:
        return SettingsError(
            f"the scheduler at {self._scheduler} is gone; finished cells are kept; start it and "
            "run the same command again"
        )


@contextlib.contextmanager
def _connected(scheduler: str) -> Iterator[Client]:
    """Connect, and leave the cluster as it was."""
    try:
        import dask  # noqa: PLC0415 - an extra
        import distributed  # noqa: PLC0415
    except ImportError:
        raise SettingsError("--executor dask: pip install 'isac-track[dask]'") from None
    with _silenced(), dask.config.set(_LARGE):
        try:
            client: Client = distributed.Client(  # type: ignore[no-untyped-call,unused-ignore]
                scheduler, timeout=_CONNECT_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise SettingsError(
                f"no Dask scheduler answers at {scheduler!r} ({why}); {_BEGIN}"
            ) from None
        try:
            yield client
        finally:
            with contextlib.suppress(Exception):  # it may be gone
                client.close(timeout=_CONNECT_S)


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """Keep Dask's loggers quiet: what matters is told in one line."""
    names = [name for name in logging.root.manager.loggerDict if _is_noisy(name)]
    loggers = [logging.getLogger(name) for name in {*names, "distributed", "asyncio"}]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _is_noisy(name: str) -> bool:
    return name.partition(".")[0] in ("distributed", "tornado", "asyncio")


def _submitted(client: Client, function: Callable[..., Any], *arguments: object, key: str) -> Task:
    return client.submit(function, *arguments, key=key, pure=False)


def _packed(content: object) -> bytes:
    """Return it for the workers alone: the scheduler has no use for a user's plug-in."""
    import cloudpickle  # type: ignore[import-untyped,import-not-found,unused-ignore]  # noqa: PLC0415

    packed: bytes = cloudpickle.dumps(content)
    return packed


# From here on: in a worker, several threads at a time.


def _loaded(packed: bytes) -> Any:  # noqa: ANN401 - what was packed
    import cloudpickle  # type: ignore[import-untyped,import-not-found,unused-ignore]  # noqa: PLC0415

    with _LOADING:
        return cloudpickle.loads(packed)


def _computed(
    function: Callable[[W], Iterable[R]], packed: bytes, expected: Mapping[str, str]
) -> list[R]:
    """Return what a worker makes of a work; it may have joined after the others were checked."""
    from distributed import get_worker  # noqa: PLC0415 - an extra

    modules = tuple(key.removeprefix("module ") for key in expected if " " in key)
    _check_alike(_about(modules), expected, worker=get_worker().address)
    work: W = _loaded(packed)
    # Not lifted afterwards: it counts for the whole process, where others may be computing.
    threadpool_limits(limits=1)
    note()
    return list(function(work))


def _about(modules: tuple[str, ...], *, seen: dict[str, str] | None = None) -> dict[str, str]:
    """Return all that the bits of a result depend on in a process.

    Parameters
    ----------
    modules : tuple of str
        Of the user's plug-ins.
    seen : dict, optional
        Digests of the source, filled at first sight; by default those of this process.

    Raises
    ------
    SettingsError
        If a module cannot be imported here.
    """
    seen = _FIRST_SEEN if seen is None else seen
    with _LOADING:
        if "code" not in seen:
            seen["code"] = code_hash()
        for name in modules:
            if f"module {name}" not in seen:
                seen[f"module {name}"] = _source(name)
    return {
        "code": seen["code"],
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in _LIBRARIES},
        **{f"module {name}": seen[f"module {name}"] for name in modules},
    }


def _source(name: str) -> str:
    try:
        import_module(name)
        return source_digest(name)[:16]
    except (Exception, SystemExit) as error:  # noqa: BLE001 - an import may do anything at all
        raise SettingsError(
            f"cannot import {name!r} ({told(error)}), which a plug-in of the "
            "run needs; it must be importable on every worker, as by PYTHONPATH"
        ) from None


def _check_alike(answer: Mapping[str, str], expected: Mapping[str, str], *, worker: str) -> None:
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
