"""An attack as each adversary runs it, and what holds for attacks of either kind."""

from __future__ import annotations

import inspect
import sys
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias
from unittest import SkipTest

import numpy as np
from scipy.special import bdtrc

from attacks.testing._releases import EPSILON_M, arrays_of, copied, of_each, renamed
from isac_track.errors import told
from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.testing.engine import attempt
from isac_track.types import Knowledge, Release

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from isac_track.protocols import LinkageAttack, ReconstructionAttack
    from isac_track.types import Floats

Attack: TypeAlias = "ReconstructionAttack | LinkageAttack"
Case: TypeAlias = Any
"""`_reconstruction_checks.Case` or `_linkage_checks.LinkageCase`, by the kind of the attack."""
Answer: TypeAlias = Any
"""What `Case.read` makes of a result: `_reconstruction_checks.Estimate`, or scores (P, G)."""

SAME = 1e-6
"""Room for rounding: m, or a share of the spread of the scores."""
SPREADS = 3.0
"""Two runs of an attack that draws may differ by so many times what two seeds differ by."""
SURPRISE = 1e-6
"""Probability with which chance alone would fail an attack."""
STANDARD_ERRORS = 2.5
"""One-sided 99 % for 24 people (Student's t)."""


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """An attack as one adversary runs it."""

    attack: Attack
    adversary: str
    granted: frozenset[Knowledge]
    """What the adversary grants it."""
    given: frozenset[Knowledge]
    """What it is given here: all there is, if it cannot keep to what it was granted."""
    ordinary: Case
    """For checks that compare two runs."""
    another: Case
    """What the function from `fit` may be asked after the ordinary case."""

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

    def fail(self, case: Case, what: str) -> NoReturn:
        """Fail a check, with the row and the case."""
        raise AssertionError(f"{self}, {case.about}: {what}")

    def answer(self, case: Case, *, seed: int = 0) -> Answer:
        """Return what the attack makes of a case, given copies of all arrays."""
        return self.answers(case, seed=seed)[0]

    def answers(self, *cases: Case, seed: int = 0) -> list[Answer]:
        """Return what one call of `fit`, which is for the first case, makes of several in turn."""
        results = self.raw(*map(copied, cases), seed=seed)
        return [self.read(case, result) for case, result in zip(cases, results, strict=True)]

    def read(self, case: Case, result: object) -> Answer:
        """Return a result as arrays, or fail the check."""
        try:
            return case.read(result)
        except ValueError as error:
            raise AssertionError(f"{self}, {case.about}: {error}") from None

    def raw(self, *cases: Case, seed: int = 0) -> list[object]:
        """Return whatever the attack returns for each case, given what it is and no more.

        The context is that of the first case. Whatever the attack raises becomes an
        AssertionError with the line that did.
        """
        first = cases[0]
        asked: Sequence[Case] = cases
        if Knowledge.SIGMA not in self.given:
            asked = [of_each(case, Release.without_sigma) for case in cases]
        context = AttackContext(
            rng=stream(seed, "attacks", "testing", "attack"),
            epsilon_m=EPSILON_M,
            granted=self.given,
            mechanism=asked[0].mechanism,
            train=asked[0].train,
            repeats=asked[0].repeats,
        )
        doing, fitted = "fit(context)", None

        def run() -> list[object]:
            nonlocal doing, fitted
            fitted = self.attack.fit(context)
            if not callable(fitted):
                raise TypeError(f"fit must return a function {first.gives}, got {fitted!r}")
            doing = "the function from fit"
            return [fitted(*(getattr(case, name) for name in case.asked)) for case in asked]

        def failing(error: BaseException) -> str:
            hint = ""
            # One release is asked about by reconstruction, two by linkage.
            n_releases = len(first.asked)
            if not _takes(fitted, n_releases) and _takes(fitted, 3 - n_releases):
                hint = f"; it takes a function {first.gives}: which `kind` is the attack?"
            where = _place(error, self.attack)
            return f"{self}, {first.about}: {doing} raised {told(error)}{where}{hint}"

        found: list[object] = attempt(run, failing=failing)
        return found

    def expect_same(
        self, got: Answer, expected: Answer, *, what: str, hint: str, tolerance: float = SAME
    ) -> None:
        """Fail if two answers differ by more than rounding, or than chance if the attack draws.

        An attack that draws is compared with itself under another seed: of its draws, a check can
        only ask that they have the same spread, which the ordinary case says.
        """
        case = self.ordinary
        plain = self.answer(case)
        spread = case.spread(plain)
        chance = max(map(rms, case.gaps(plain, self.answer(case, seed=1)))) / spread
        size: Callable[[Floats], float] = rms if chance > 0 else np.max
        gap = max(float(size(one)) for one in case.gaps(got, expected)) / spread
        if gap > tolerance + SPREADS * chance:
            unit = case.unit
            drawn = f" (two seeds differ by {chance:.3g}{unit})" if chance > 0 else ""
            self.fail(
                case,
                f"{what}: {case.compared} differ by {gap:.3g}{unit}{case.relative}, expected "
                f"at most {tolerance:g}{unit}{drawn}; {hint}",
            )


def rms(gaps: Floats) -> float:
    """Return the root of the mean square, whatever the scale."""
    # Scaled by the largest, lest the squares of tiny gaps vanish.
    largest = float(np.max(gaps, initial=0.0))
    if largest == 0 or not np.isfinite(largest):
        return largest
    return largest * float(np.sqrt(np.mean((gaps / largest) ** 2)))


def _takes(fitted: Any, n_releases: int) -> bool:  # noqa: ANN401 - whatever came from fit
    """Whether a function can be called with so many releases, as far as it says."""
    try:
        inspect.signature(fitted).bind(*range(n_releases))
    except (TypeError, ValueError):
        return False
    return True


def _place(error: BaseException, attack: object) -> str:
    """Return the last line of the attack's own file on the way to an error."""
    file = getattr(sys.modules.get(type(attack).__module__), "__file__", None)
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename == file] or frames[1:]
    return f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""


# The checks; each is held against every row that an attack makes


def same_seed_same_result(row: Row) -> None:
    """Two runs with the same context.rng agree to the last bit."""
    case = row.ordinary
    first, second = row.answer(case), row.answer(case)
    if not same_bits(first, second):
        changed = case.gaps(first, second)[0] > 0
        row.fail(
            case,
            f"two runs with one seed differ in {np.count_nonzero(changed)} of {changed.size} "
            f"{case.answers}; draw from context.rng alone, and keep nothing between two calls of "
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
            case,
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
        if not same_bits(got, expected):
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


def is_surprising(found: float, *, tries: int, chance: float) -> bool:
    """Whether chance alone brings as many successes or more with a probability below `SURPRISE`."""
    # The survival function counts what exceeds its argument.
    return found >= 1 and bool(bdtrc(int(found) - 1, tries, chance) < SURPRISE)


def least_rise(changes: Floats) -> float:
    """Return what a mean change of people must exceed, each compared with themselves."""
    return STANDARD_ERRORS * float(changes.std(ddof=1) / np.sqrt(changes.size))


def same_bits(one: Answer, other: Answer) -> bool:
    """Whether two answers agree to the last bit."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one.shape == other.shape and one.tobytes() == other.tobytes()
    if isinstance(one, tuple):
        return all(map(same_bits, one, other))
    return one is other
