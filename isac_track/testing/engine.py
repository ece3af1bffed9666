"""The engine of the conformance kits: named checks, run one by one on a stranger's code.

A kit is a dictionary of `Check`s by name. What its checks are held against is the kit's
own.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal, TypeAlias
from unittest import SkipTest

from isac_track.errors import SettingsError, did_you_mean, raised_at, told

Body: TypeAlias = Callable[
    ..., None
]  # Raises AssertionError, SkipTest where it says nothing.


@dataclass(frozen=True, eq=False, slots=True)
class Check:
    """One named statement about somebody's code."""

    name: str
    statement: str  # What it shows, one line.
    body: Body
    needs: tuple[
        str, ...
    ] = ()  # Names of the attributes of its subject that it cannot do without.

    def missing(self, subject: object) -> str:
        """Return what the check needs and the subject does not offer."""
        return ", ".join(name for name in self.needs if getattr(subject, name) is None)

    def __call__(self, subject: object) -> None:
        """Run the check: AssertionError with the counterexample if the statement does not hold.

        SkipTest, which pytest takes for a skip, with the reason if it does not apply.
        """
        if missing := self.missing(subject):
            raise SkipTest(f"not offered: {missing}")
        self.body(subject)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one check; `check` and `detail` are its name and message."""

    name: str
    status: Literal["passed", "failed", "skipped"]
    message: str = ""  # The counterexample of a failure, or the reason of a skip.

    check, detail = property(attrgetter("name")), property(attrgetter("message"))

    @property
    def passed(self) -> bool:
        """Whether the check ran and what it states holds."""
        return self.status == "passed"


def call(function: Callable[..., Any], *given: object, who: str) -> Any:  # noqa: ANN401 - a stranger's
    """Return what a stranger's function makes of its arguments.

    Whatever it raises becomes an AssertionError that tells `who` did, in which line.
    """
    try:
        return function(*given)
    except (Exception, SystemExit) as error:
        raise AssertionError(f"{who} raised {told(error)}{raised_at(error)}") from error


def statement_of(function: Body) -> str:
    """Return the first line of a docstring: what a check shows."""
    return (function.__doc__ or "").strip().partition("\n")[0]


def by_name(*bodies: Body) -> dict[str, Body]:
    """Return the bodies of checks by the names of their functions."""
    return {one.__name__: one for one in bodies}


def select(
    checks: Mapping[str, Check],
    names: Sequence[str] | None,
    *,
    kit: str = "",
    known: str,
) -> tuple[Check, ...]:
    """Return the checks called `names`, each once, or all.

    SettingsError for a wrong name, with the nearest right one, or how to learn of them,
    `known`.
    """
    for name in names or ():
        if name not in checks:
            hint = did_you_mean(name, checks, quote="'") or f"; {known}"
            raise SettingsError(f"unknown check {name!r}{kit}{hint}")
    return tuple(
        checks[name] for name in dict.fromkeys(checks if names is None else names)
    )


def outcomes(checks: Iterable[Check], subject: object) -> Iterator[Outcome]:
    """Run checks one by one; one that fails ends nothing."""
    for one in checks:
        try:
            one(subject)
        except AssertionError as error:
            yield Outcome(one.name, "failed", str(error))
        except SkipTest as reason:
            yield Outcome(one.name, "skipped", str(reason))
        else:
            yield Outcome(one.name, "passed")


def report(found: Iterable[Outcome], *, line: Callable[[Outcome], str]) -> bool:
    """Print a line for each outcome as it comes, and their counts; return whether none failed."""
    counts = {"passed": 0, "failed": 0, "skipped": 0}
    for outcome in found:
        counts[outcome.status] += 1
        print(line(outcome).rstrip(), flush=True)  # noqa: T201 - a command's output
    print(", ".join(f"{count} {status}" for status, count in counts.items()))  # noqa: T201 - as above
    return not counts["failed"]


def parametrize(arguments: str, cases: Iterable[tuple[str, tuple[object, ...]]]) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    """Return a pytest decorator that runs a test once for each (id, values) of its arguments."""
    import pytest  # noqa: PLC0415 - only those who test with pytest need it

    given = [pytest.param(*values, id=name) for name, values in cases]
    return pytest.mark.parametrize(arguments, given)
