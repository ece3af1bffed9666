"""Calling what a stranger wrote: their mistakes are named, and their hands kept off our arrays."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from isac_track.errors import PluginError

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
    """
    try:
        return call()
    except (Exception, SystemExit) as error:  # a plug-in may do anything
        raise PluginError(f"{who} failed: {type(error).__name__}: {error}") from error


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
