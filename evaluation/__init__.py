"""The evaluation matrix: mechanisms x consumers, with intervals.

``evaluation.run(settings)`` gives the same results as ``python -m evaluation.matrix``, as data
frames::

    import evaluation

    results = evaluation.run(evaluation.Settings(preset="smoke"))
    results.summary
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evaluation.experiment.settings import Settings
    from evaluation.reporting.finished import load
    from evaluation.reporting.rows import Results
    from evaluation.results import run

__all__ = ["Results", "Settings", "load", "run"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever the name stands for
    # Lazy: `python -m evaluation.matrix --help` must not wait for pandas.
    if name not in __all__:
        raise AttributeError(f"module 'evaluation' has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415 - as above

    home = {"Settings": "experiment.settings", "run": "results"}.get(name, "reporting.finished")
    return getattr(import_module(f"evaluation.{home}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
