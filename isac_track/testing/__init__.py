"""The metric suite: the definition of PLR, AEL, MEL and the conflict metrics, as checks.

It needs nothing but numpy and scipy, and runs against any implementation. Offer your functions
as a `Metrics` object; what you leave out is skipped. From the command line::

    python -m isac_track.testing my_package.my_module:METRICS

or with pytest, where every check becomes a test of its own::

    @parametrize_metric_checks(METRICS)
    def test_metrics(check):
        check()

A package rather than one file, so that ``python -m`` and an import see one `Metrics` class.
"""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from isac_track.errors import SettingsError
from isac_track.testing import _conflict_checks, _exposure_checks, _plr_checks
from isac_track.testing._kit import Check, Metrics, registered
from isac_track.testing._own import OWN

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = [
    "CHECKS",
    "OWN",
    "Check",
    "Metrics",
    "Outcome",
    "parametrize_metric_checks",
    "run_checks",
    "select_checks",
]

_DEFINED_IN = (
    _plr_checks,
    _exposure_checks,
    _conflict_checks,
)  # importing them registers the checks

CHECKS: tuple[Check, ...] = registered()
"""All checks, in the order in which they run."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one check."""

    check: str
    status: Literal["passed", "failed", "skipped"]
    detail: str = ""
    """The counterexample of a failure, or the reason of a skip."""


def select_checks(names: Sequence[str] | None = None) -> tuple[Check, ...]:
    """Return the checks called `names`, or all.

    Raises
    ------
    SettingsError
        For a name that does not exist, with the nearest one that does.
    """
    if names is None:
        return CHECKS
    known = {one.name: one for one in CHECKS}
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else "; `--list` names all checks"
            raise SettingsError(f"unknown check {name!r}{hint}")
    return tuple(known[name] for name in dict.fromkeys(names))


def run_checks(metrics: Metrics, *, names: Sequence[str] | None = None) -> Iterator[Outcome]:
    """Run the checks one by one; a function that raises fails its check and ends nothing.

    Parameters
    ----------
    metrics : Metrics
        The functions to check.
    names : sequence of str, optional
        Only these checks; by default all.

    Raises
    ------
    SettingsError
        For a check that does not exist.
    """
    return (_outcome(one, metrics) for one in select_checks(names))


def parametrize_metric_checks(metrics: Metrics, *, names: Sequence[str] | None = None) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    """Return a pytest decorator that runs a test once per check, with ``check`` to call.

    Checks of functions that are not offered are skipped, with the reason.

    Parameters
    ----------
    metrics : Metrics
        The functions to check.
    names : sequence of str, optional
        Only these checks; by default all.
    """
    import pytest  # noqa: PLC0415 - only those who test with pytest need it

    cases = []
    for one in select_checks(names):
        reason = one.missing(metrics)
        marks = [pytest.mark.skip(reason=reason)] if reason else []
        cases.append(pytest.param(partial(one, metrics), id=one.name, marks=marks))
    return pytest.mark.parametrize("check", cases)


def _outcome(one: Check, metrics: Metrics) -> Outcome:
    reason = one.missing(metrics)
    if reason:
        return Outcome(check=one.name, status="skipped", detail=reason)
    try:
        one(metrics)
    except AssertionError as error:
        return Outcome(check=one.name, status="failed", detail=str(error))
    return Outcome(check=one.name, status="passed")
