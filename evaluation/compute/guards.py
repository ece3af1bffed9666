"""Calls of a user's plug-in: errors that name it, and arrays of its own.

`guarded` calls it and names its mistakes; `copied` protects our arrays from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from attacks.tasks.windows import Windows
from evaluation.plan.origins import is_user_plugin
from isac_track.command_line import check_interrupt, may_be_ctrl_c
from isac_track.errors import PluginError, error_text, raised_at
from isac_track.types import Release, Scenes, Sensed, derived

if TYPE_CHECKING:
    from isac_track.plugins import Plugin


Batch = TypeVar("Batch", Release, Scenes, Sensed, Windows)


def guarded(name: str, call: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever a plug-in returns
    """Return what a plug-in's function returns.

    Raises PluginError for whatever it raises, with the plug-in's name and the place in
    its code. The user's Ctrl-C passes.
    """
    try:
        with np.errstate():  # undoes what the call sets
            return call()
    except BaseException as error:  # a plug-in may do anything
        if isinstance(error, KeyboardInterrupt) and may_be_ctrl_c():
            raise
        check_interrupt()  # it may have caught the user's and raised something else
        raise PluginError(
            f"{name} failed: {error_text(error)}{raised_at(error)}"
        ) from error


def copy_for_user_plugin(batch: Batch, plugin: Plugin) -> Batch:
    """Return a batch as a plug-in gets it: a user's own plug-in gets a copy."""
    return copied(batch) if is_user_plugin(plugin) else batch


def copied(batch: Batch) -> Batch:
    """Return a batch in arrays of its own: a plug-in may unlock them and write."""
    values = ((field.name, getattr(batch, field.name)) for field in fields(batch))
    copies = {
        name: value.copy() for name, value in values if isinstance(value, np.ndarray)
    }
    return derived(batch, **copies)
