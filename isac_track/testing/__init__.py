"""The metric suite: PLR, AEL, MEL and the conflict metrics, defined by checks.

It needs nothing but numpy and scipy, and runs against any implementation. Offer your
functions as a `Metrics` object; checks of functions that you leave out are skipped.
From the command line::

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
    _conflict_checks,  # noqa: F401 - its import registers checks
    _descriptor_checks,  # noqa: F401 - its import registers checks
    _metrics,
    engine,
)
from isac_track.testing._metrics import OWN, Metrics
from isac_track.testing.engine import Check, Outcome

__all__ = ["CHECKS", "OWN", "Check", "Metrics", "Outcome"]
__all__ += ["parametrize_metric_checks", "run_checks", "select_checks"]

CHECKS: tuple[Check, ...] = tuple(_metrics.CHECKS.values())
"""All checks, in the order in which they run."""


def select_checks(names: Sequence[str] | None = None) -> tuple[Check, ...]:
    """Return the checks called `names`, or all; SettingsError for an unknown name."""
    return engine.select(_metrics.CHECKS, names, known="`--list` names all checks")


def run_checks(
    metrics: Metrics, *, names: Sequence[str] | None = None
) -> Iterator[Outcome]:
    """Run all checks, or those called `names`, on the functions of `metrics`.

    Yields the outcome of each check in turn. A function that raises an error fails its
    check and ends nothing. Raises as `select_checks`.

    Examples
    --------
    A share of leaked samples that counts a distance of exactly epsilon as a leak:

    >>> import numpy as np
    >>> from isac_track.testing import Metrics, run_checks
    >>> def plr(shared, true, epsilon_m):
    ...     return np.mean(np.hypot(*(shared - true).T) <= epsilon_m)
    >>> outcomes = list(run_checks(Metrics(plr=plr)))
    >>> [outcome.name for outcome in outcomes if outcome.status == "failed"]
    ['plr_boundary_is_strict']
    """
    return engine.outcomes(select_checks(names), metrics)


def parametrize_metric_checks(
    metrics: Metrics, *, names: Sequence[str] | None = None
) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    """Return a pytest decorator that runs a test for each check, ``check`` to call.

    It has all checks, or those called `names`. Checks of functions that are not offered
    are skipped. Raises as `select_checks`.
    """
    cases = ((check.name, (partial(check, metrics),)) for check in select_checks(names))
    return engine.parametrize("check", cases)
