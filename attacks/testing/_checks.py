"""What holds for attacks of either kind; each check is held against every row that one makes."""

from __future__ import annotations

from typing import TYPE_CHECKING
from unittest import SkipTest

import numpy as np
from scipy.special import bdtrc

from attacks.testing._releases import arrays_of, copied, renamed
from attacks.testing._rows import expect_same

if TYPE_CHECKING:
    from attacks.testing._rows import Answer, Row
    from isac_track.types import Floats

SAME = 1e-6
"""Room for rounding: m, or a share of the spread of the scores."""
SURPRISE = 1e-6
"""Probability with which chance alone would fail an attack."""
STANDARD_ERRORS = 2.5
"""One-sided 99 % for 24 people (Student's t)."""


def same_seed_same_result(row: Row) -> None:
    """Two runs with the same context.rng agree to the last bit."""
    case = row.ordinary
    first, second = row.answers(case), row.answers(case)
    if not same_bits(first, second):
        changed = case.gaps(*first, *second)[0] > 0
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
    row.raw([given])
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
        row.strict().raw([copied(case)])
    except AssertionError as error:
        # Whether more knowledge would help tells a denial from any other fault.
        row.with_everything().raw([copied(case)])
        sigmas = " and ".join(f"{name}.sigma" for name in case.asked)
        raise AssertionError(
            f"{error}; given all knowledge it runs: declare what you touch in `requires` or "
            "`uses`, and look into context.granted before you touch what is only in `uses` "
            f"(without SIGMA, {sigmas} {'is' if len(case.asked) == 1 else 'are'} None)"
        ) from error


def order_of_tracks_does_not_matter(row: Row) -> None:
    """Tracks in another order are answered in that order, and otherwise the same."""
    case = row.ordinary
    changed, follow = case.reordered()
    expect_same(
        row,
        case,
        got=row.answer(changed),
        expected=follow(row.answer(case)),
        tolerance=SAME,
        what="tracks in another order",
        hint="does anything run from one track into the next, or depend on a track's number?",
    )


def pseudonyms_do_not_matter(row: Row) -> None:
    """Other pseudonyms, same result."""
    case = row.ordinary
    expect_same(
        row,
        case,
        got=row.answer(renamed(case)),
        expected=row.answer(case),
        tolerance=SAME,
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
    (alone,) = row.answers(other)
    for got, expected, what in (
        (again, first, f"asked once more, after {releases}"),
        (after, alone, f"{releases}, asked after the first"),
    ):
        if not same_bits(got, expected):
            expect_same(
                row,
                case,
                got=got,
                expected=expected,
                tolerance=0.0,
                what=what,
                hint="one function serves many releases: keep nothing from one to the next",
            )


# What the checks of one kind share


def frames_do_not_matter(row: Row, *, tolerance: float, what: str, hint: str) -> None:
    """Compare answers in other frames and clocks, unless the row sees the true ones.

    Raises
    ------
    SkipTest
        For a row with SCENE.
    """
    if row.scene:
        raise SkipTest("granted SCENE in every row: it may depend on the true frame and clock")
    case = row.ordinary
    changed, follow = case.in_other_frames()
    expected = follow(row.answer(case))
    got = row.answer(changed)
    expect_same(row, case, got=got, expected=expected, tolerance=tolerance, what=what, hint=hint)


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
    if isinstance(one, list | tuple):
        return all(map(same_bits, one, other))
    return one is other
