"""Checks that hold for plug-ins of several kinds, and the rows that run them."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NoReturn, TypeAlias
from unittest import SkipTest

import numpy as np
from scipy.special import bdtrc

from attacks.testing._releases import RAW_SIGMA_M, copied, list_arrays, map_releases
from isac_track.protocols import WALK_KNOWLEDGE, LinkageTrainingSet
from isac_track.rng import stream
from isac_track.testing.engine import Body, by_name, call
from isac_track.types import Floats, Knowledge, Release

Case: TypeAlias = Any  # A case of `_attack_cases` or `_plugin_checks`.

SAME = 1e-6  # Room for rounding: m, or a share of the spread of the scores.
SAME_FRAME = 1e-5  # The same after a motion by some hundred metres and seconds.
# Room for the result of a learner with the same examples in another order.
SAME_LEARNT = 0.01
# Two runs of an attack that draws may differ by so many times the gap of two seeds.
SPREADS = 3.0
SURPRISE = 1e-6  # Probability with which chance alone would fail an attack.
# Standard errors that hardly one of ten thousand sound attacks exceeds.
LEAK_ERRORS = 4.5
STANDARD_ERRORS = 2.5  # One-sided 99 % for 24 people (Student's t).
_LEAKS = "does the truth reach the attack by a way other than its context?"


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """An attack as one adversary runs it, or another plug-in as it runs."""

    subject: Any
    adversary: str  # Empty: a mechanism or a predictor.
    # The knowledge that the adversary grants, or that a predictor requires.
    granted: frozenset[Knowledge]
    # All knowledge, if the plug-in touches more than was granted.
    given: frozenset[Knowledge]
    ordinary: Case  # For checks that compare two runs.
    another: Case  # Run after the ordinary case.

    def __str__(self) -> str:
        knows = ", ".join(sorted(item.name for item in self.granted)) or "nothing"
        row = f" as {self.adversary} (granted {knows})" if self.adversary else ""
        return f"{type(self.subject).__name__}{row}"

    def fail(self, case: Case, wrong: str) -> NoReturn:
        """Fail a check, with the row and the description of the case."""
        raise AssertionError(f"{self}, {case.about}: {wrong}")

    def answer(self, case: Case, *, seed: int = 0) -> Floats:
        """Return the plug-in's result for a case as an array."""
        answer: Floats = case.read(self.results(case, seed=seed)[0])
        return answer

    def results(self, *cases: Case, seed: int = 0) -> list[Any]:
        """Return the plug-in's results for copies of cases, prepared for the first."""
        results = self.raw(*map(copied, cases), seed=seed)
        for case, result in zip(cases, results, strict=True):
            try:
                case.read(result)
            except ValueError as error:
                self.fail(case, str(error))
        return results

    def raw(self, *cases: Case, seed: int = 0) -> list[object]:
        """Return the plug-in's result for each case; an error of it fails the check."""
        if Knowledge.SIGMA not in self.given:
            cases = tuple(map_releases(case, Release.without_sigma) for case in cases)
        actor, asked = f"{self}, {cases[0].about}:", cases[0].asked
        rng = stream(seed, "attacks", "testing", "attack")
        run = cases[0].prepared(self.subject, self.given, rng, actor)
        actor = f"{actor} asked for {' and '.join(asked)}, it"
        results = []
        for case in cases:
            arguments = [getattr(case, name) for name in asked]
            results.append(call(run, *arguments, actor=actor))
        return results

    def expect_same(
        self,
        got: Floats,
        expected: Floats,
        *,
        change: str,
        hint: str,
        tolerance: float = SAME,
    ) -> None:
        """Fail if answers differ by more than rounding.

        An attack that draws may also differ by as much as two seeds of it.
        """
        case = self.ordinary
        gaps = case.gaps(got, expected)
        if gaps.max() <= tolerance:
            return
        between_seeds = case.gaps(self.answer(case, seed=1), self.answer(case))
        chance = np.sqrt(np.mean(between_seeds**2, axis=-1))
        gap = np.sqrt(np.mean(gaps**2, axis=-1))
        gap = np.where(chance > 0, gap, gaps.max(axis=-1))
        if (gap > tolerance + SPREADS * chance).any():
            difference = (
                f"{change}: {case.compared} differ by {gap.max():.3g}{case.unit}"
            )
            limit = f"expected at most {tolerance:g}{case.unit}"
            if chance.any():
                limit += f" (two seeds differ by {chance.max():.3g}{case.unit})"
            self.fail(case, f"{difference}, {limit}; {hint}")


# The checks; each runs on every row of a plug-in.


def result_is_right(row: Row) -> None:
    """The result has the type and shape of the contract, and is finite."""
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
    """A plug-in leaves its inputs, also an attack's context, as they were."""
    case, own = row.ordinary, copied(row.ordinary)
    row.raw(own)
    arrays = zip(list_arrays(case), list_arrays(own), strict=True)
    paths = [
        path[1:]
        for (path, came), (_, left) in arrays
        if came.tobytes() != left.tobytes()
    ]
    if paths:
        changed = ", ".join(
            f"context.{path}" if path.startswith(("train", "repeats")) else path
            for path in paths
        )
        hint = f"work on a copy, as in xy = {case.asked[0]}.xy.copy()"
        row.fail(case, f"changed {changed}; others read the same arrays: {hint}")


def only_granted_knowledge_is_touched(row: Row) -> None:
    """The plug-in runs with the knowledge that it declares and its adversary has."""
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
    """Tracks in another order have the same answers, in that order."""
    changed, follow = row.ordinary.reordered()
    got, expected = row.answer(changed), follow(row.answer(row.ordinary))
    hint = (
        "does anything run from one track into the next, or depend on a track's number?"
    )
    row.expect_same(got, expected, change="tracks in another order", hint=hint)


def frames_do_not_matter(row: Row) -> None:
    """Releases in other frames and on other clocks have the same answer.

    A row that is granted SCENE is exempt: its adversary may know where the walls are.
    """
    if Knowledge.SCENE in row.granted:
        raise SkipTest(
            "granted SCENE in every row: it may depend on the true frame and clock"
        )
    changed, follow = row.ordinary.in_other_frames()
    got, expected = row.answer(changed), follow(row.answer(row.ordinary))
    change = "another frame and clock for every release"
    hint = (
        "without SCENE they are random; does anything depend on x and y taken by"
        " themselves, on headings, on absolute times, or on two of these sharing a"
        " frame?"
    )
    row.expect_same(got, expected, change=change, hint=hint, tolerance=SAME_FRAME)


def pseudonyms_do_not_matter(row: Row) -> None:
    """Other pseudonyms have the same answer."""

    def renamed(release: Release) -> Release:
        # Backwards, so that the order of the pseudonyms changes, too.
        backwards = sorted(release.pseudonym, reverse=True)
        names = (f"p{backwards.index(name):04}" for name in release.pseudonym)
        return replace(release, pseudonym=tuple(names))

    got = row.answer(map_releases(row.ordinary, renamed))
    expected = row.answer(row.ordinary)
    hint = "they are drawn afresh for every release"
    row.expect_same(got, expected, change="other pseudonyms", hint=hint)


def odd_tracks_are_handled(row: Row) -> None:
    """Answers stay in bounds for tracks of 1 to 3 samples and steps of 1 ms to 30 s."""
    for case in row.ordinary.odd():
        if wrong := case.out_of_bounds(row.answer(case)):
            hint = (
                "does a window or a fit get too few samples, or is anything divided by"
                " a time"
            )
            row.fail(case, f"{wrong}; {hint} step?")


def training_without_mates_is_handled(row: Row) -> None:
    """Training probes without a mate (-1) have no influence.

    A third of the training probes has no mate. For every other such probe the gallery
    track is removed, too. The training gallery is then turned back to front: an attack
    that uses -1 as the number of the last track would learn something else.
    """
    train = row.ordinary.train
    mate = train.mate.copy()
    mate[::3] = -1
    remaining = np.setdiff1d(np.arange(len(train.gallery)), train.mate[::6])
    about = (
        f"{row.ordinary.about}, {np.count_nonzero(mate < 0)} of {mate.size} others"
        " mateless"
    )
    cases = []
    for rows in (remaining[::-1], remaining):
        place = np.full(len(train.gallery) + 1, -1)  # the last entry stands for -1
        place[rows] = np.arange(rows.size)
        fewer = LinkageTrainingSet(train.probe, train.gallery.tracks(rows), place[mate])
        cases.append(replace(row.ordinary, about=about, train=fewer))
    got, expected = map(row.answer, cases)
    change = "the gallery of the training set back to front"
    hint = "a mate of -1 is no index: keep only the probes with train.mate >= 0"
    row = replace(row, ordinary=cases[1])
    row.expect_same(got, expected, change=change, hint=hint, tolerance=SAME_LEARNT)


def calls_do_not_remember(row: Row) -> None:
    """Answers of the function from `fit` do not depend on earlier calls.

    Release B, asked between A and A again, has A's pseudonyms and as many samples: a
    cache with these as its key would fail.
    """
    case, other = row.ordinary, row.another
    first, after, again = map(case.read, row.results(case, other, case))
    hint = "one function serves many releases: keep nothing from one to the next"
    for got, expected, change in (
        (again, first, "asked once more, after another release"),
        (after, row.answer(other), "another release, asked after the first"),
    ):
        if got.tobytes() != expected.tobytes():
            row.expect_same(got, expected, change=change, hint=hint, tolerance=0.0)


def null_stays_at_chance(row: Row) -> None:
    """An attack on releases that are unrelated to the truth hits it by chance alone.

    Each part of the truth is drawn by itself: an attack hits it with the probability
    `chance` at most.
    """
    case = row.ordinary.null()
    hits = case.hits(row.answer(case))
    n_hits, chance = float(hits.sum()), case.chance
    # The survival function counts what exceeds its argument.
    if n_hits >= 1 and bdtrc(int(n_hits) - 1, hits.size, chance) < SURPRISE:
        expected = f"expected about {chance * hits.size:.3g} by chance"
        row.fail(case, f"{n_hits:.4g} of {hits.size} {case.hit}, {expected}; {_LEAKS}")


def easy_case_beats_chance(row: Row) -> None:
    """With errors of 5 cm an attack hits a larger share of the truth than by chance."""
    case = row.ordinary.noisy(RAW_SIGMA_M, "radial")
    hits = case.hits(row.answer(case))
    n_hits, needed = hits.sum(), case.easy_share * hits.size
    if n_hits < needed:
        by_chance = f"chance brings {case.chance * hits.size:.3g} ({case.easy_hint})"
        expected = f"expected at least {needed:g}; {by_chance}"
        row.fail(case, f"{n_hits:.4g} of {hits.size} {case.hit}, {expected}")


def success_falls_with_noise(row: Row) -> None:
    """An attack's success falls from each level of isotropic noise to the next.

    People and unit errors are the same at all levels: the comparison is paired.
    """
    world = row.ordinary
    levels = [world.noisy(sigma_m, "isotropic") for sigma_m in world.levels_m]
    success = [case.success(row.answer(case)) for case in levels]
    steps = zip(pairwise(success), pairwise(world.levels_m), levels[1:], strict=True)
    for (low, high), (low_m, high_m), case in steps:
        fall = low - high
        needed = STANDARD_ERRORS * float(fall.std(ddof=1) / np.sqrt(fall.size))
        if not fall.mean() > needed:
            achieved = (
                f"{low.mean():.3f} at {low_m:g} m of noise and {high.mean():.3f} at"
                f" {high_m:g} m"
            )
            wanted = (
                f"a fall of more than {needed:.3f}; what does the attack take the noise"
                " for?"
            )
            row.fail(case, f"{world.achieved} is {achieved}, expected {wanted}")


def nothing_beats_the_optimum(row: Row) -> None:
    """Walks of a model leak no more than under the exact posterior of a genie.

    The genie knows the scales of the errors, isotropic or radial. A row with more than
    one release is exempt.
    """
    for law in ("isotropic", "radial"):
        case, expected = row.ordinary.modelled(law)
        gap = case.success(row.answer(case)) - expected
        limit = LEAK_ERRORS * float(gap.std(ddof=1) / np.sqrt(gap.size))
        if gap.mean() > limit and not row.given & WALK_KNOWLEDGE:
            posterior = f"where the exact posterior comes to {expected.mean():.3f}"
            achieved = f"PLR {(gap + expected).mean():.3f}, {posterior}"
            row.fail(
                case, f"{achieved}, expected no more than {limit:.3f} above ({_LEAKS})"
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
