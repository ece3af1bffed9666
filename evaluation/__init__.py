"""The evaluation matrix: mechanisms x consumers, with intervals.

``evaluation.run(settings)`` gives the same results as ``python -m evaluation.matrix``,
as data frames::

    import evaluation

    results = evaluation.run(evaluation.Settings(preset="smoke"))
    results.summary
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evaluation.api import run
    from evaluation.plan.settings import Settings
    from evaluation.reporting.finished import load
    from evaluation.reporting.rows import Results


def _check_own_packages() -> None:
    """Refuse a user's folder with the name of one of our packages: it hides ours."""
    for name in ("isac_track", "predictors", "attacks"):
        spec = find_spec(name)
        folder: Path | str = "nowhere"
        if spec is not None and spec.origin is not None:
            folder = Path(spec.origin).parent
        if folder == Path(__file__).parent.with_name(name):
            continue
        message = (
            f"{folder} has the name of the package {name!r} of isac-track, and stands"
            " before it; say `isac-track matrix` instead of"
            " `python -m evaluation.matrix`, or rename it"
        )
        # A command, not a notebook: it ends in one line.
        if sys.argv and sys.argv[0] == "-m":
            sys.stderr.write(f"error: {message}\n")
            raise SystemExit(2)
        raise ImportError(message)


_check_own_packages()

__all__ = ["Results", "Settings", "load", "run"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - a function or a class
    # Lazy: `python -m evaluation.matrix --help` must not wait for pandas.
    if name not in __all__:
        raise AttributeError(f"module 'evaluation' has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415 - as above

    home = {"Settings": "plan.settings", "run": "api"}.get(name, "reporting.finished")
    return getattr(import_module(f"evaluation.{home}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
