"""What holds for plug-ins of several kinds, which differ in their cases, and how they are run."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NoReturn, TypeAlias
from unittest import SkipTest

import numpy as np
from scipy.special import bdtrc

from attacks.testing._releases import RAW_SIGMA_M, arrays_of, copied, of_each
from isac_track.protocols import OF_WALKS, LinkageTrainingSet
from isac_track.rng import stream
from isac_track.testing.engine import Body, by_name, call
from isac_track.types import Floats, Knowledge, Release

Case: TypeAlias = Any  # One of those of `_attack_cases` or `_plugin_checks`.

SAME = 1e-6  # Room for rounding: m, or a share of the spread of the scores.
SAME_FRAME = 1e-5  # The same after a motion by some hundred metres and seconds.
# Room for what a learner makes of the same examples in another order.
SAME_LEARNT = 0.01
# So many times what two seeds of an attack that draws differ by, two runs may.
SPREADS = 3.0
SURPRISE = 1e-6  # Probability with which chance alone would fail an attack.
# Of ten thousand sound attacks hardly one leaks so many standard errors.
LEAK_ERRORS = 4.5
STANDARD_ERRORS = 2.5  # One-sided 99 % for 24 people (Student's t).
_LEAKS = "does the truth reach the attack by a way other than its context?"


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """An attack as one adversary runs it, or another plug-in as it runs."""

    subject: Any
    adversary: str  # Empty: a mechanism or a predictor.
    granted: frozenset[
        Knowledge
    ]  # What the adversary grants it, or a predictor requires.
    given: frozenset[
        Knowledge
    ]  # All there is, if it cannot keep to what it was granted.
    ordinary: Case  # For checks that compare two runs.
    another: Case  # What it may be asked after the ordinary case.

    def __str__(self) -> str:
        knows = ", ".join(sorted(one.name for one in self.granted)) or "nothing"
        row = f" as {self.adversary} (granted {knows})" if self.adversary else ""
        return f"{type(self.subject).__name__}{row}"

    def fail(self, case: Case, what: str) -> NoReturn:
        """Fail a check, with the row and what the case is about."""
        raise AssertionError(f"{self}, {case.about}: {what}")

    def answer(self, case: Case, *, seed: int = 0) -> Floats:
        """Return as an array what the plug-in makes of a case."""
        answer: Floats = case.read(self.results(case, seed=seed)[0])
        return answer

    def results(self, *cases: Case, seed: int = 0) -> list[Any]:
        """Return what the plug-in, prepared for the first, makes of copies of cases in turn."""
        results = self.raw(*map(copied, cases), seed=seed)
        for case, result in zip(cases, results, strict=True):
            try:
                case.read(result)
            except ValueError as error:
                self.fail(case, str(error))
        return results

    def raw(self, *cases: Case, seed: int = 0) -> list[object]:
        """Return whatever the plug-in returns for each case; what it raises fails the check."""
        if Knowledge.SIGMA not in self.given:
            cases = tuple(of_each(case, Release.without_sigma) for case in cases)
        who, asked = f"{self}, {cases[0].about}:", cases[0].asked
        rng = stream(seed, "attacks", "testing", "attack")
        run = cases[0].prepared(self.subject, self.given, rng, who)
        who = f"{who} asked for {' and '.join(asked)}, it"
        return [
            call(run, *(getattr(one, name) for name in asked), who=who) for one in cases
        ]

    def expect_same(
        self,
        got: Floats,
        expected: Floats,
        *,
        what: str,
        hint: str,
        tolerance: float = SAME,
    ) -> None:
        """Fail if answers differ by more than rounding, or two seeds of an attack that draws."""
        case = self.ordinary
        gaps = case.gaps(got, expected)
        if gaps.max() <= tolerance:
            return
        between_seeds = case.gaps(self.answer(case, seed=1), self.answer(case))
        chance, gap = (
            np.sqrt(np.mean(one**2, axis=-1)) for one in (between_seeds, gaps)
        )
        gap = np.where(chance > 0, gap, gaps.max(axis=-1))
        if (gap > tolerance + SPREADS * chance).any():
            drawn = f" (two seeds differ by {chance.max():.3g}{case.unit})" * bool(
                chance.any()
            )
            found = f"{what}: {case.compared} differ by {gap.max():.3g}{case.unit}"
            self.fail(
                case,
                f"{found}, expected at most {tolerance:g}{case.unit}{drawn}; {hint}",
            )


# The checks; each is held against every row that an attack makes


def result_is_right(row: Row) -> None:
    """What comes back is of the type and shape that the contract says, and finite."""
    cases = row.ordinary, row.another
    for case, result in zip(cases, row.results(*cases), strict=True):
        if wrong := case.fault(result):
            row.fail(case, wrong)


def same_seed_same_result(row: Row) -> None:
    """Two runs with the same random stream agree to the last bit."""
    case = row.ordinary
    first, second = row.answer(case), row.answer(case)
    if first.tobytes() != second.tobytes():
        changed = case.gaps(first, second).max(axis=0) > 0
        many = f"{np.count_nonzero(changed)} of {changed.size} {case.compared}"
        hint = (
            "draw from the rng that is given and from nothing else, and keep nothing"
            " from run"
        )
        row.fail(case, f"two runs with one seed differ in {many}; {hint} to run")


def inputs_are_not_mutated(row: Row) -> None:
    """What a plug-in is given, an attack's context too, is left as it came."""
    case, own = row.ordinary, copied(row.ordinary)
    row.raw(own)
    arrays = zip(arrays_of(case), arrays_of(own), strict=True)
    paths = [
        path[1:]
        for (path, came), (_, left) in arrays
        if came.tobytes() != left.tobytes()
    ]
    if paths:
        of_context = ("train", "repeats")
        changed = ", ".join(
            "context." * path.startswith(of_context) + path for path in paths
        )
        hint = f"work on a copy, as in xy = {case.asked[0]}.xy.copy()"
        row.fail(case, f"changed {changed}; others read the same arrays: {hint}")


def only_granted_knowledge_is_touched(row: Row) -> None:
    """Given what it declares and its adversary knows, and no more, the plug-in runs."""
    case = row.ordinary
    try:
        replace(row, given=row.granted).raw(copied(case))
    except AssertionError as error:
        # Whether more knowledge would help tells a denial from any other fault.
        replace(row, given=case.everything).raw(copied(case))
        raise AssertionError(
            f"{error}; given all knowledge it runs: declare what you touch in"
            " `requires` or `uses`, and look into context.granted before you touch"
            f" what is only in `uses` (without SIGMA, {case.asked[0]}.sigma is None)"
        ) from error


def order_of_tracks_does_not_matter(row: Row) -> None:
    """Tracks in another order are answered in that order, and otherwise alike."""
    changed, follow = row.ordinary.reordered()
    got, expected = row.answer(changed), follow(row.answer(row.ordinary))
    hint = (
        "does anything run from one track into the next, or depend on a track's number?"
    )
    row.expect_same(got, expected, what="tracks in another order", hint=hint)


def frames_do_not_matter(row: Row) -> None:
    """Whatever came in a frame of its own comes in another frame and clock: the same answer.

    Whoever is granted SCENE may well know where the walls are: such a row is exempt.
    """
    if Knowledge.SCENE in row.granted:
        raise SkipTest(
            "granted SCENE in every row: it may depend on the true frame and clock"
        )
    changed, follow = row.ordinary.in_other_frames()
    got, expected = row.answer(changed), follow(row.answer(row.ordinary))
    what = "another frame and clock for every release"
    hint = (
        "without SCENE they are random; does anything depend on x and y taken by"
        " themselves, on headings, on absolute times, or on two of these sharing a"
        " frame?"
    )
    row.expect_same(got, expected, what=what, hint=hint, tolerance=SAME_FRAME)


def pseudonyms_do_not_matter(row: Row) -> None:
    """Other pseudonyms, same result."""

    def renamed(release: Release) -> Release:
        backwards = sorted(
            release.pseudonym, reverse=True
        )  # so that their order is another one
        names = (f"p{backwards.index(name):04}" for name in release.pseudonym)
        return replace(release, pseudonym=tuple(names))

    got, expected = row.answer(of_each(row.ordinary, renamed)), row.answer(row.ordinary)
    hint = "they are drawn afresh for every release"
    row.expect_same(got, expected, what="other pseudonyms", hint=hint)


def odd_tracks_are_handled(row: Row) -> None:
    """With tracks of one to three samples and steps from 1 ms to 30 s answers stay in bounds."""
    for case in row.ordinary.odd():
        if wrong := case.out_of_bounds(row.answer(case)):
            hint = (
                "does a window or a fit get too few samples, or is anything divided by"
                " a time"
            )
            row.fail(case, f"{wrong}; {hint} step?")


def training_without_mates_is_handled(row: Row) -> None:
    """Where a third of the training probes has no mate (-1), nobody is taken for theirs.

    Of every other such probe the gallery track is gone. The training gallery is then
    turned back to front: who takes -1 for the last track learns something else.
    """
    train = row.ordinary.train
    mate = train.mate.copy()
    mate[::3] = -1
    stays = np.setdiff1d(np.arange(len(train.gallery)), train.mate[::6])
    about = (
        f"{row.ordinary.about}, {np.count_nonzero(mate < 0)} of {mate.size} others"
        " mateless"
    )
    cases = []
    for rows in (stays[::-1], stays):
        place = np.full(len(train.gallery) + 1, -1)  # the last is that of nobody, -1
        place[rows] = np.arange(rows.size)
        fewer = LinkageTrainingSet(train.probe, train.gallery.tracks(rows), place[mate])
        cases.append(replace(row.ordinary, about=about, train=fewer))
    got, expected = map(row.answer, cases)
    what = "the gallery of the training set back to front"
    hint = "a mate of -1 is no index: keep only the probes with train.mate >= 0"
    row = replace(row, ordinary=cases[1])
    row.expect_same(got, expected, what=what, hint=hint, tolerance=SAME_LEARNT)


def calls_do_not_remember(row: Row) -> None:
    """What the function from fit answers does not depend on what it was asked before.

    B, asked between A and A again, has A's pseudonyms and as many samples, lest a cache
    go by them.
    """
    case, other = row.ordinary, row.another
    first, after, again = map(case.read, row.results(case, other, case))
    hint = "one function serves many releases: keep nothing from one to the next"
    for got, expected, what in (
        (again, first, "asked once more, after another release"),
        (after, row.answer(other), "another release, asked after the first"),
    ):
        if got.tobytes() != expected.tobytes():
            row.expect_same(got, expected, what=what, hint=hint, tolerance=0.0)


def null_stays_at_chance(row: Row) -> None:
    """Where the releases say nothing of the truth, it is hit no more often than by chance.

    Each part of the truth is drawn by itself: it is hit with the probability `chance`
    at most.
    """
    case = row.ordinary.null()
    hits = case.hits(row.answer(case))
    found, chance = float(hits.sum()), case.chance
    # The survival function counts what exceeds its argument.
    if found >= 1 and bdtrc(int(found) - 1, hits.size, chance) < SURPRISE:
        expected = f"expected about {chance * hits.size:.3g} by chance"
        row.fail(case, f"{found:.4g} of {hits.size} {case.hit}, {expected}; {_LEAKS}")


def easy_case_beats_chance(row: Row) -> None:
    """With errors of 5 cm a share of the truth is hit that chance alone would not bring."""
    case = row.ordinary.noisy(RAW_SIGMA_M, "radial")
    hits = case.hits(row.answer(case))
    found, needed = hits.sum(), case.easy_share * hits.size
    if found < needed:
        by_chance = f"chance brings {case.chance * hits.size:.3g} ({case.easy_hint})"
        expected = f"expected at least {needed:g}; {by_chance}"
        row.fail(case, f"{found:.4g} of {hits.size} {case.hit}, {expected}")


def success_falls_with_noise(row: Row) -> None:
    """What an attack achieves falls from each level of isotropic noise to the next.

    The same people with the same unit errors, so that each is compared with themselves.
    """
    world = row.ordinary
    levels = [world.noisy(sigma_m, "isotropic") for sigma_m in world.levels_m]
    success = [case.success(row.answer(case)) for case in levels]
    both = pairwise(success), pairwise(world.levels_m)
    for (low, high), (less, more), case in zip(*both, levels[1:], strict=True):
        fall = low - high
        needed = STANDARD_ERRORS * float(fall.std(ddof=1) / np.sqrt(fall.size))
        if not fall.mean() > needed:
            found = (
                f"{low.mean():.3f} at {less:g} m of noise and {high.mean():.3f} at"
                f" {more:g} m"
            )
            wanted = (
                f"a fall of more than {needed:.3f}; what does the attack take the noise"
                " for?"
            )
            row.fail(case, f"{world.achieved} is {found}, expected {wanted}")


def nothing_beats_the_optimum(row: Row) -> None:
    """Of walks that follow a model no more leaks than the exact posterior of a genie tells.

    Of isotropic and radial errors, told their scales. A row with more than one release
    is exempt.
    """
    for law in ("isotropic", "radial"):
        case, expected = row.ordinary.modelled(law)
        gap = case.success(row.answer(case)) - expected
        limit = LEAK_ERRORS * float(gap.std(ddof=1) / np.sqrt(gap.size))
        if gap.mean() > limit and not row.given & OF_WALKS:
            posterior = f"where the exact posterior comes to {expected.mean():.3f}"
            found = f"PLR {(gap + expected).mean():.3f}, {posterior}"
            row.fail(
                case, f"{found}, expected no more than {limit:.3f} above ({_LEAKS})"
            )


_FIRST = by_name(
    same_seed_same_result,
    inputs_are_not_mutated,
    only_granted_knowledge_is_touched,
    order_of_tracks_does_not_matter,
)
_THEN = by_name(pseudonyms_do_not_matter, odd_tracks_are_handled)
_LAST = by_name(
    calls_do_not_remember,
    null_stays_at_chance,
    easy_case_beats_chance,
    success_falls_with_noise,
)
RECONSTRUCTION: dict[str, Body] = {
    "result_is_a_reconstruction": result_is_right,
    **_FIRST,
    "frame_and_clock_do_not_matter": frames_do_not_matter,
    **_THEN,
    **_LAST,
    **by_name(nothing_beats_the_optimum),
}
LINKAGE: dict[str, Body] = {
    "result_is_a_score_matrix": result_is_right,
    **_FIRST,
    "frames_and_clocks_do_not_matter": frames_do_not_matter,
    **_THEN,
    **by_name(training_without_mates_is_handled),
    **_LAST,
}
