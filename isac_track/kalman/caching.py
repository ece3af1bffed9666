"""Compile the loops before somebody waits for them."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path


def prepare() -> None:
    """Compile everything, or load it from the cache.

    Otherwise the first call does, for what it needs. The machine code is cached beside the
    package, or in the user's cache if that is read-only; where neither can be written it is
    compiled in every process. Worth a call before a timing or before workers start.

    The interacting models take as long as all the rest: a second process compiles them meanwhile.
    """
    helper = None
    if not _is_cached("_imm_loops"):
        command = [sys.executable, "-c", "import isac_track.kalman._imm_loops"]
        with contextlib.suppress(OSError):  # without a second process it merely takes longer
            helper = subprocess.Popen(  # noqa: S603 - a fixed command
                command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
    try:
        import_module("isac_track.kalman._linear_loops")
    finally:
        if helper is not None:
            helper.wait()
    import_module("isac_track.kalman._imm_loops")


def _is_cached(module: str) -> bool:
    """Whether numba's cache seems to hold a module; a wrong answer costs a second, no more."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else Path(__file__).parent / "__pycache__"
    return any(folder.rglob(f"{module}.*.nbi"))
