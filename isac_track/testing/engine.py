"""The engine of the conformance kits: named checks, run one by one on other code.

A kit is a dictionary of `Check`s by name. Each kit defines the subject of its checks.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal, TypeAlias
from unittest import SkipTest

from isac_track.errors import SettingsError, did_you_mean, error_text, raised_at

# Raises AssertionError if the statement does not hold, SkipTest if it does not apply.
Body: TypeAlias = Callable[..., None]


@dataclass(frozen=True, eq=False, slots=True)
class Check:
    """A named statement about a subject: somebody's code.

    Attributes
    ----------
    name : str
        Name by which a check is selected.
    statement : str
        What the check shows, in one line.
    body : callable
        Raises AssertionError if the statement does not hold, SkipTest if it does not
        apply.
    needs : tuple of str
        Names of the subject's attributes that the check cannot do without.
    """

    name: str
    statement: str
    body: Body
    needs: tuple[str, ...] = ()

    def missing(self, subject: object) -> str:
        """Return the attributes that the check needs and the subject does not offer."""
        return ", ".join(name for name in self.needs if getattr(subject, name) is None)

    def __call__(self, subject: object) -> None:
        """Run the check; raise AssertionError with a counterexample if it fails.

        SkipTest, a skip to pytest, with the reason if the check does not apply.
        """
        if missing := self.missing(subject):
            raise SkipTest(f"not offered: {missing}")
        self.body(subject)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a check; `check` and `detail` are aliases of its name and message.

    Attributes
    ----------
    name : str
        Name of the check.
    status : str
        ``passed``, ``failed`` or ``skipped``.
    message : str
        The counterexample of a failure, or the reason of a skip.
    """

    name: str
    status: Literal["passed", "failed", "skipped"]
    message: str = ""

    check, detail = property(attrgetter("name")), property(attrgetter("message"))

    @property
    def passed(self) -> bool:
        """Whether the check ran and its statement holds."""
        return self.status == "passed"


def call(function: Callable[..., Any], *arguments: object, actor: str) -> Any:  # noqa: ANN401 - a stranger's
    """Call somebody else's function and return its result.

    Any error becomes an AssertionError that names `actor` and the line.
    """
    try:
        return function(*arguments)
    except (Exception, SystemExit) as error:
        raise AssertionError(
            f"{actor} raised {error_text(error)}{raised_at(error)}"
        ) from error


def read_statement(function: Body) -> str:
    """Return the first line of a docstring: the statement of a check."""
    return (function.__doc__ or "").strip().partition("\n")[0]


def by_name(*bodies: Body) -> dict[str, Body]:
    """Return the bodies of checks by the names of their functions."""
    return {body.__name__: body for body in bodies}


def select(
    checks: Mapping[str, Check],
    names: Sequence[str] | None,
    *,
    kit: str = "",
    known: str,
) -> tuple[Check, ...]:
    """Return the checks called `names`, each once, or all.

    SettingsError for an unknown name, with the nearest name or, without any, the hint
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
    """Run checks one by one; a failed check ends nothing."""
    for check in checks:
        try:
            check(subject)
        except AssertionError as error:
            yield Outcome(check.name, "failed", str(error))
        except SkipTest as reason:
            yield Outcome(check.name, "skipped", str(reason))
        else:
            yield Outcome(check.name, "passed")


def report(outcomes: Iterable[Outcome], *, line: Callable[[Outcome], str]) -> bool:
    """Print a line for each outcome, then their counts; return whether none failed."""
    counts = {"passed": 0, "failed": 0, "skipped": 0}
    for outcome in outcomes:
        counts[outcome.status] += 1
        print(line(outcome).rstrip(), flush=True)  # noqa: T201 - a command's output
    print(", ".join(f"{count} {status}" for status, count in counts.items()))  # noqa: T201 - as above
    return not counts["failed"]


def parametrize(arguments: str, cases: Iterable[tuple[str, tuple[object, ...]]]) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    """Return a pytest decorator that runs a test once for each (id, values)."""
    import pytest  # noqa: PLC0415 - only kits used with pytest need it

    parameters = [pytest.param(*values, id=name) for name, values in cases]
    return pytest.mark.parametrize(arguments, parameters)
