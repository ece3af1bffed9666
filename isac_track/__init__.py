"""Sharing of sensed pedestrian tracks: the pipeline and its privacy descriptors.

Import the stages as modules (``from isac_track import sensing, sharing, privacy``):
each file is a stage, and data flows one way (see ``docs/``).
"""

import os
import sys
from contextlib import suppress

__version__ = "0.2.0"
_FEW_PROCESSES = 64  # A system limit of all processes of a user, if it is this low.


def _spare_threads() -> None:
    """Let BLAS start no threads where the system allows few processes.

    Otherwise BLAS ends the program if it cannot start a thread. It reads the variable
    when numpy is imported, so this must run before.
    """
    with suppress(ImportError):  # Windows has no such limit
        import resource  # noqa: PLC0415 - as above

        limit, _ = resource.getrlimit(resource.RLIMIT_NPROC)
        if 0 <= limit <= _FEW_PROCESSES and "numpy" not in sys.modules:
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


_spare_threads()
