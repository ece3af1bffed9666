"""The metric suite: the definition of PLR, AEL, MEL and the conflict metrics, as checks.

It needs nothing but numpy and scipy, and runs against any implementation. Offer your
functions
as a `Metrics` object; what you leave out is skipped. From the command line::

    python -m isac_track.testing my_package.my_module:METRICS

or with pytest, where every check becomes a test of its own::

    @parametrize_metric_checks(METRICS)
    def test_metrics(check):
        check()
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

# The two modules of checks fill the kit as they are imported.
from isac_track.testing import (
    _conflict_checks,  # noqa: F401 - as said
    _descriptor_checks,  # noqa: F401 - as said
    _metrics,
    engine,
)
from isac_track.testing._metrics import OWN, Metrics
from isac_track.testing.engine import Check, Outcome

__all__ = ["CHECKS", "OWN", "Check", "Metrics", "Outcome"]
__all__ += ["parametrize_metric_checks", "run_checks", "select_checks"]

CHECKS: tuple[Check, ...] = tuple(
    _metrics.CHECKS.values()
)  # In the order in which they run.


def select_checks(names: Sequence[str] | None = None) -> tuple[Check, ...]:
    """Return the checks called `names`, or all; SettingsError for a name that does not exist."""
    return engine.select(_metrics.CHECKS, names, known="`--list` names all checks")


def run_checks(
    metrics: Metrics, *, names: Sequence[str] | None = None
) -> Iterator[Outcome]:
    """Run all checks, or those called `names`, one by one on the functions of `metrics`.

    A function that raises fails its check and ends nothing. Raises as `select_checks`.
    """
    return engine.outcomes(select_checks(names), metrics)


def parametrize_metric_checks(
    metrics: Metrics, *, names: Sequence[str] | None = None
) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    """Return a pytest decorator that runs a test once per check, with ``check`` to call.

    All checks, or those called `names`; those of functions that are not offered are
    skipped.
    """
    cases = ((one.name, (partial(one, metrics),)) for one in select_checks(names))
    return engine.parametrize("check", cases)
