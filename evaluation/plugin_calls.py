"""Calling what a stranger wrote: their mistakes are named, and their hands kept off our arrays."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from isac_track.errors import PluginError

if TYPE_CHECKING:
    from collections.abc import Callable

    from isac_track.types import Release


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


def copied(release: Release) -> Release:
    """Return a release in arrays of its own: a stranger may unlock them and write."""
    return replace(
        release,
        t=release.t.copy(),
        xy=release.xy.copy(),
        sigma=None if release.sigma is None else release.sigma.copy(),
        offsets=release.offsets.copy(),
    )
