"""Calling what a stranger wrote: their mistakes are named, and their hands kept off our arrays."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from isac_track.command_line import check_interrupt, may_be_ctrl_c
from isac_track.errors import PluginError, told

if TYPE_CHECKING:
    from collections.abc import Callable

    from isac_track.types import Release, Sensed

_Batch = TypeVar("_Batch", "Release", "Sensed")


def guarded(who: str, call: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever a plug-in returns
    """Return what a plug-in's function returns.

    Raises
    ------
    PluginError
        Whatever it raises, with who it was.
    KeyboardInterrupt
        If the user pressed Ctrl-C.
    """
    try:
        return call()
    except BaseException as error:  # a plug-in may do anything
        if isinstance(error, KeyboardInterrupt) and may_be_ctrl_c():
            raise
        check_interrupt()  # it may have caught the user's and raised something else
        raise PluginError(f"{who} failed: {told(error)}") from error


def copied(batch: _Batch) -> _Batch:
    """Return a release, or what was sensed, in arrays of its own.

    A stranger may unlock them and write.
    """
    own: dict[str, Any] = {
        one.name: getattr(batch, one.name).copy()
        for one in fields(batch)
        if isinstance(getattr(batch, one.name), np.ndarray)
    }
    return replace(batch, **own)
