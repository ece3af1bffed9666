"""Sensed pedestrian tracks, shared: the pipeline of the paper and its privacy descriptors.

Import the stages as modules (``from isac_track import sensing, sharing, privacy``):
each file is one stage, data flows one way (see ``docs/``).
"""

import os
import sys
from contextlib import suppress

__version__ = "0.1.0"
_FEW_PROCESSES = 64  # As a limit of the system, for all that a user runs.


def _spare_threads() -> None:
    """Let BLAS start no threads where few processes may run: without one it ends the program.

    It reads this when numpy is imported, so it must be said before.
    """
    with suppress(ImportError):  # Windows has no such limit
        import resource  # noqa: PLC0415 - as above

        most, _ = resource.getrlimit(resource.RLIMIT_NPROC)
        if 0 <= most <= _FEW_PROCESSES and "numpy" not in sys.modules:
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


_spare_threads()
