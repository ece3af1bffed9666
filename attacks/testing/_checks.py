"""An attack as each adversary runs it, and what holds for attacks of either kind."""

from __future__ import annotations

import inspect
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NoReturn, TypeAlias
from unittest import SkipTest

import numpy as np
from scipy.special import bdtrc

from attacks.testing._releases import EPSILON_M, arrays_of, copied, of_each, renamed
from isac_track.errors import raised_at, told
from isac_track.protocols import AttackContext, LinkageAttack, ReconstructionAttack
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Knowledge, Release

Attack: TypeAlias = "ReconstructionAttack | LinkageAttack"
Case: TypeAlias = Any
"""`_reconstruction_checks.Case` or `_linkage_checks.LinkageCase`, by the kind of the attack.

Its answers are arrays, as its `read` makes them: positions and std, or scores.
"""

SAME = 1e-6  # Room for rounding: m, or a share of the spread of the scores.
SPREADS = 3.0
"""Two runs of an attack that draws may differ by so many times what two seeds differ by."""
SURPRISE = 1e-6  # Probability with which chance alone would fail an attack.
STANDARD_ERRORS = 2.5  # One-sided 99 % for 24 people (Student's t).


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """An attack as one adversary runs it."""

    attack: Attack
    adversary: str
    granted: frozenset[Knowledge]  # What the adversary grants it.
    given: frozenset[Knowledge]
    """What it is given here: all there is, if it cannot keep to what it was granted."""
    ordinary: Case  # For checks that compare two runs.
    another: Case  # What the function from `fit` may be asked after the ordinary case.

    def __str__(self) -> str:
        knows = ", ".join(sorted(one.name for one in self.granted)) or "nothing"
        return f"{type(self.attack).__name__} as {self.adversary} (granted {knows})"

    @property
    def scene(self) -> bool:
        """Whether it sees the true frame and clock: the cases of linkage differ in that."""
        return Knowledge.SCENE in self.granted

    def with_everything(self) -> Row:
        """Return the row given all that there is in its cases."""
        return replace(self, given=self.ordinary.everything)

    def fail(self, about: str, what: str) -> NoReturn:
        """Fail a check, with the row and what the case is about."""
        raise AssertionError(f"{self}, {about}: {what}")

    def answer(self, case: Case, *, seed: int = 0) -> Floats:
        """Return what the attack makes of a case, given copies of all arrays."""
        return self.answers(case, seed=seed)[0]

    def answers(self, *cases: Case, seed: int = 0) -> list[Floats]:
        """Return what one call of `fit`, which is for the first case, makes of several in turn."""
        results = self.raw(*map(copied, cases), seed=seed)
        return [self.read(case, result) for case, result in zip(cases, results, strict=True)]

    def read(self, case: Case, result: object) -> Floats:
        """Return a result as an array, or fail the check."""
        try:
            answer: Floats = case.read(result)
        except ValueError as error:
            self.fail(case.about, str(error))
        return answer

    def raw(self, *cases: Case, seed: int = 0) -> list[object]:
        """Return whatever the attack returns for each case, given what it is and no more.

        The context is that of the first case. Whatever the attack raises becomes an
        AssertionError with the line that did.
        """
        if Knowledge.SIGMA not in self.given:
            cases = tuple(of_each(case, Release.without_sigma) for case in cases)
        first = cases[0]
        context = AttackContext(
            rng=stream(seed, "attacks", "testing", "attack"),
            epsilon_m=EPSILON_M,
            granted=self.given,
            mechanism=first.mechanism,
            train=first.train,
            repeats=first.repeats,
            anchor=first.anchor,
            companions=first.companions,
        )
        doing, hint = "fit(context)", ""
        try:
            fitted: Any = self.attack.fit(context)
            doing, hint = "the function from fit", _which_kind(fitted, first)
            return [fitted(*(getattr(case, name) for name in case.asked)) for case in cases]
        except (Exception, SystemExit) as error:
            what = f"{doing} raised {told(error)}{raised_at(error)}{hint}"
            raise AssertionError(f"{self}, {first.about}: {what}") from error

    def expect_same(
        self, got: Floats, expected: Floats, *, what: str, hint: str, tolerance: float = SAME
    ) -> None:
        """Fail if two answers differ by more than rounding, or than chance if the attack draws.

        An attack that draws is compared with itself under another seed: of its draws, a check can
        only ask that they have the same spread, which the ordinary case says.
        """
        case = self.ordinary
        plain = self.answer(case)
        chance = _rms(case.gaps(plain, self.answer(case, seed=1), plain))
        gaps = case.gaps(got, expected, plain)
        gap = _rms(gaps) if chance > 0 else float(gaps.max())
        if gap > tolerance + SPREADS * chance:
            drawn = f" (two seeds differ by {chance:.3g}{case.unit})" if chance > 0 else ""
            relative = "" if case.unit else " of their spread"
            self.fail(
                case.about,
                f"{what}: {case.compared} differ by {gap:.3g}{case.unit}{relative}, expected "
                f"at most {tolerance:g}{case.unit}{drawn}; {hint}",
            )


def _rms(gaps: Floats) -> float:
    """Return the root of the mean square of the gaps of one sort, the largest of all sorts."""
    return float(np.sqrt(np.mean(gaps**2, axis=-1)).max())


def _which_kind(fitted: Any, case: Case) -> str:  # noqa: ANN401 - whatever came from fit
    """Return a hint if what came from fit takes another number of releases than its kind says."""
    if not callable(fitted):
        raise TypeError(f"fit must return a function {case.gives}, got {fitted!r}")
    with suppress(ValueError):  # not every function tells what it takes
        try:
            inspect.signature(fitted).bind(*case.asked)
        except TypeError:
            return f"; it takes a function {case.gives}: which `kind` is the attack?"
    return ""


# The checks; each is held against every row that an attack makes


def same_seed_same_result(row: Row) -> None:
    """Two runs with the same context.rng agree to the last bit."""
    case = row.ordinary
    first, second = row.answer(case), row.answer(case)
    if first.tobytes() != second.tobytes():
        changed = case.gaps(first, second, first)[0] > 0
        row.fail(
            case.about,
            f"two runs with one seed differ in {np.count_nonzero(changed)} of {changed.size} "
            f"{case.compared}; draw from context.rng alone, and keep nothing between two calls of "
            "fit",
        )


def inputs_are_not_mutated(row: Row) -> None:
    """What an attack is given, context and releases, is left as it came."""
    case = row.ordinary
    given = copied(case)
    row.raw(given)
    after = arrays_of(given)
    changed = [
        f"context{path}" if path.startswith((".train", ".repeats")) else path.removeprefix(".")
        for path, before in arrays_of(case).items()
        if before.tobytes() != after[path].tobytes()
    ]
    if changed:
        row.fail(
            case.about,
            f"changed {', '.join(changed)}; others read the same arrays: "
            f"work on a copy, as in xy = {case.asked[0]}.xy.copy()",
        )


def only_granted_knowledge_is_touched(row: Row) -> None:
    """Given what its adversary knows and it declares, and no more, the attack runs."""
    case = row.ordinary
    try:
        replace(row, given=row.granted).raw(copied(case))
    except AssertionError as error:
        # Whether more knowledge would help tells a denial from any other fault.
        row.with_everything().raw(copied(case))
        sigmas = " and ".join(f"{name}.sigma" for name in case.asked)
        raise AssertionError(
            f"{error}; given all knowledge it runs: declare what you touch in `requires` or "
            "`uses`, and look into context.granted before you touch what is only in `uses` "
            f"(without SIGMA, {sigmas} {'is' if len(case.asked) == 1 else 'are'} None)"
        ) from error


def order_of_tracks_does_not_matter(row: Row) -> None:
    """Tracks in another order are answered in that order, and otherwise the same."""
    changed, follow = row.ordinary.reordered()
    row.expect_same(
        row.answer(changed),
        follow(row.answer(row.ordinary)),
        what="tracks in another order",
        hint="does anything run from one track into the next, or depend on a track's number?",
    )


def pseudonyms_do_not_matter(row: Row) -> None:
    """Other pseudonyms, same result."""
    row.expect_same(
        row.answer(renamed(row.ordinary)),
        row.answer(row.ordinary),
        what="other pseudonyms",
        hint="they are drawn afresh for every release",
    )


def calls_do_not_remember(row: Row) -> None:
    """What the function from fit answers does not depend on what it was asked before.

    Asked A, B and A again it answers A alike to the last bit, and B as if it had not seen A. B has
    A's pseudonyms and as many samples, lest a cache go by those.
    """
    case, other = row.ordinary, row.another
    releases = "another release" if len(case.asked) == 1 else "other releases"
    first, after, again = row.answers(case, other, case)
    hint = "one function serves many releases: keep nothing from one to the next"
    for got, expected, what in (
        (again, first, f"asked once more, after {releases}"),
        (after, row.answer(other), f"{releases}, asked after the first"),
    ):
        if got.tobytes() != expected.tobytes():
            row.expect_same(got, expected, what=what, hint=hint, tolerance=0.0)


# What the checks of one kind share

FIRST = (
    same_seed_same_result,
    inputs_are_not_mutated,
    only_granted_knowledge_is_touched,
    order_of_tracks_does_not_matter,
)


def frames_do_not_matter(row: Row, *, what: str, hint: str, tolerance: float) -> None:
    """Compare answers in other frames and clocks; skip a row that sees the true ones."""
    if row.scene:
        raise SkipTest("granted SCENE in every row: it may depend on the true frame and clock")
    changed, follow = row.ordinary.in_other_frames()
    expected = follow(row.answer(row.ordinary))
    row.expect_same(row.answer(changed), expected, what=what, hint=hint, tolerance=tolerance)


def expect_chance(
    row: Row, about: str, hits: Floats | Bools, *, chance: float, what: str, hint: str
) -> None:
    """Fail if chance alone brings as many hits or more with less than `SURPRISE`."""
    found = float(np.sum(hits))
    # The survival function counts what exceeds its argument.
    if found >= 1 and bdtrc(int(found) - 1, len(hits), chance) < SURPRISE:
        expected = f"expected about {chance * len(hits):.3g} by chance"
        row.fail(about, f"{found:.4g} of {len(hits)} {what}, {expected}; {hint}")


def least_rise(changes: Floats) -> float:
    """Return what a mean change of people must exceed, each compared with themselves."""
    return STANDARD_ERRORS * float(changes.std(ddof=1) / np.sqrt(changes.size))
