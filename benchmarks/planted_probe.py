"""What a copy of the package says while its tests run: which of them reaches which fault's place.

A plug-in of pytest in the process of the tests, a plain module in those that they start.
"""

from __future__ import annotations

import json
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pytest import FixtureDef, Item, TestReport  # noqa: PT013 - for types alone

_FIXTURE = "PLANTED_FIXTURE"
_said: set[tuple[str, ...]] = set()


def hit(*faults: str) -> None:
    """Say that the place of some faults is reached, in which test and which shared fixture."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0]
    line = ("hit", test, os.environ.get(_FIXTURE, ""), *faults)
    if line not in _said:
        _said.add(line)
        _say(*line)


def _say(*words: str | float) -> None:
    # A process whose environment was emptied has nowhere to say it.
    if record := os.environ.get("PLANTED_RECORD"):
        with open(record, "a", encoding="utf-8") as file:  # noqa: PTH123 - in workers, too
            file.write(json.dumps(words) + "\n")


if "pytest" in sys.modules:
    import pytest

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(fixturedef: FixtureDef[object]) -> Iterator[None]:
        """Tell which shared fixture is made: what it reaches, every test that uses it reaches."""
        before = os.environ.get(_FIXTURE, "")
        if fixturedef.scope != "function":
            os.environ[_FIXTURE] = fixturedef.argname
        try:
            return (yield)
        finally:
            os.environ[_FIXTURE] = before

    def pytest_runtest_setup(item: Item) -> None:
        """Tell which fixtures a test uses."""
        _say("uses", item.nodeid, *getattr(item, "fixturenames", ()))

    def pytest_runtest_logreport(report: TestReport) -> None:
        """Tell what became of a test; where there are two processes, once."""
        if "PYTEST_XDIST_WORKER" not in os.environ:
            _say("ran", report.nodeid, report.outcome, report.duration)
