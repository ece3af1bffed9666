"""The worker's side of a pipe: compute the works that come, and send their results.

A message to a worker is a function, or None for the last, and a work. A message
from a worker is a kind and a content: the names of a cell that begins ("cell"), a
result ("result"), and at the end of a work nothing ("done") or its error ("error").
"""

import contextlib
import gc
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import import_module
from typing import Any, Final, TypeVar

import numpy as np
from cloudpickle import dumps, loads

from evaluation.compute.current_cell import Failure, current_cell, note_cell
from evaluation.pool.memory import trim_memory
from isac_track.errors import error_text

W = TypeVar("W")
R = TypeVar("R")
_LOOK_S: Final = 0.25  # How often a worker looks whether its parent is alive.
_own_streams: Final[dict[int, int]] = {}
"""Copies of this process's output and error streams, as they were at its start."""


def serve(pipe: Any, modules: Sequence[str]) -> None:  # noqa: ANN401 - untyped
    """Import some modules, and then answer every message until the parent ends."""
    # An interrupt here is a plug-in's: the user's reaches the parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # Imported modules stay, and arrays form no cycles: to search for cycles would take
    # one second of 20.
    gc.disable()
    for name in modules:
        # An error is ignored here: the cell that needs the module fails by name.
        with contextlib.suppress(Exception):
            import_module(name)
    current_cell.report = lambda names: pipe.send_bytes(*pack_message("cell", names))
    function: Any = None
    with contextlib.suppress(EOFError, OSError):  # the parent has ended
        while True:
            new_function, work = pipe.recv()
            function = function if new_function is None else new_function
            for message in _compute_messages(function, work):
                for part in message:
                    pipe.send_bytes(part)
                del message, part  # a large result must not stay in memory
            del new_function, work
            trim_memory()
            # What has survived stays: the next collection need not search it.
            gc.freeze()


def _end_with_parent() -> None:
    parent = os.getppid()
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)


def _compute_messages(
    function: Callable[[W], Iterable[R]], work: W
) -> Iterator[list[Any]]:
    """Yield packed messages: each result as it comes, and the end of the work."""
    undo = _protect_process()
    try:
        note_cell()  # no cell has begun
        for result in function(work):
            undo()
            yield pack_message("result", result)
        yield pack_message("done", None)
    except Exception as error:  # noqa: BLE001 - the parent raises it
        undo()
        error.add_note(traceback.format_exc())
        try:
            yield pack_message("error", error)
        except Exception:  # noqa: BLE001 - a plug-in's error may not be sendable
            yield pack_message("error", RuntimeError(error_text(error)))
    except GeneratorExit:  # the parent has ended: nobody reads on
        raise
    except BaseException as error:  # noqa: BLE001 - a plug-in's: no Ctrl-C comes here
        undo()
        message = f"it raised {type(error).__name__}"
        yield pack_message("result", Failure(current_cell.names, message))
        yield pack_message("done", None)


def _protect_process() -> Callable[[], None]:
    """Set numpy's handling of errors; return a function that undoes a plug-in's changes.

    The function restores the recursion limit and the output streams.
    """
    limit = sys.getrecursionlimit()
    # As numpy itself begins, whatever a plug-in's module has set.
    np.seterr(all="warn", under="ignore")
    if not _own_streams:
        with contextlib.suppress(OSError):  # without streams
            _own_streams.update({number: os.dup(number) for number in (1, 2)})

    def undo() -> None:
        sys.setrecursionlimit(limit)
        for number, own in _own_streams.items():
            os.dup2(own, number)

    return undo


def pack_message(kind: str, content: object) -> list[Any]:
    """Return the parts of a message for `receive_message`; arrays are not copied."""
    arrays: list[Any] = []
    packed = dumps((kind, content), protocol=5, buffer_callback=arrays.append)
    return [dumps((packed, len(arrays))), *(array.raw() for array in arrays)]


def receive_message(pipe: Any) -> tuple[str, Any]:  # noqa: ANN401 - untyped
    """Return the kind and the content of the next message of a worker."""
    packed, n_arrays = pipe.recv()
    message: tuple[str, Any] = loads(
        packed, buffers=[pipe.recv_bytes() for _ in range(n_arrays)]
    )
    return message
