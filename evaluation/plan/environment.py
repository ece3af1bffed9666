"""Checks of the environment before a run, where a library would fail within it."""

import os
from importlib import import_module

from isac_track.errors import SettingsError


def check_drawing() -> None:
    """Raise SettingsError before a run if matplotlib cannot be imported after it."""
    # Without the variable the import cannot fail, and takes a while.
    if "MPLBACKEND" in os.environ:
        try:
            import_module("matplotlib")
        except ValueError:
            raise SettingsError(
                f"matplotlib knows no backend {os.environ['MPLBACKEND']!r}; unset"
                " MPLBACKEND: figures need none"
            ) from None


def check_threads() -> None:
    """Raise SettingsError before a run if numba cannot be imported within it."""
    text = os.environ.get("NUMBA_NUM_THREADS", "1")
    try:
        fits = int(text) > 0
    except ValueError:  # numba would warn, with a traceback
        fits = False
    if not fits:
        raise SettingsError(
            f"NUMBA_NUM_THREADS must be at least 1, got {text[:40]!r}; unset it"
        )
