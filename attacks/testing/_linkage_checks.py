"""The checks of linkage attacks, each held against every row that an attack makes."""

# ruff: noqa: D401 - a check states what holds

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias
from unittest import SkipTest

import numpy as np
from scipy.special import bdtrc

from attacks.testing import _linkage_cases as cases
from attacks.testing._linkage_kit import (
    expect_same,
    hits,
    log_ranks,
    read,
    rows,
    run,
    strict_rows,
)
from attacks.testing._releases import RAW_SIGMA_M

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from attacks.testing._linkage_cases import LinkageCase
    from isac_track.protocols import LinkageAttack

LinkageCheck: TypeAlias = "Callable[[LinkageAttack], None]"

SAME = 1e-6
"""Room for rounding, as a share of the spread of the scores."""
SAME_LEARNT = 0.01
"""Room for what a learner makes of the same examples in another order."""
SURPRISE = 1e-6
"""Probability with which chance alone would fail an attack."""
EASY_SURPRISE = 1e-3
"""Chance alone would succeed as often with a smaller probability."""
EASY_SIGMA_M = RAW_SIGMA_M
SIGMAS_M = (0.1, 10.0)
"""Averaged over 128 samples, 10 m come to 0.9 m: of a walk of some 15 m little is left."""
STANDARD_ERRORS = 2.5
"""One-sided 99 % for the 24 people (Student's t)."""
SHORT = (
    ((1, 1, 1), (1, 1, 1, 1), (40,) * 8),
    ((1, 2, 3, 128), (3, 2, 128, 1, 2), (40,) * 8),
    ((128, 128, 2), (128, 3, 1, 128), (1, 2, 3, 1, 2, 3, 40, 40, 40, 40)),
)
"""Samples of probes, of the gallery and of the training set."""


def result_is_a_score_matrix(attack: LinkageAttack) -> None:
    """An array (P, G) of finite floats comes back, with fewer probes than candidates or more."""
    for row in rows(attack):
        for case in (cases.ordinary(scene=row.scene), cases.sized(9, 7, scene=row.scene)):
            result = row.raw(case)
            read(result, case, who=str(row))
            if not (isinstance(result, np.ndarray) and result.dtype.kind == "f"):
                dtype = getattr(result, "dtype", None)
                raise AssertionError(
                    f"{row}, {case.about}: expected a numpy array of floats, got "
                    f"{type(result).__name__}{'' if dtype is None else f' of {dtype}'}"
                )


def same_seed_same_result(attack: LinkageAttack) -> None:
    """Two runs with the same context.rng agree to the last bit."""
    for row in rows(attack):
        case = cases.ordinary(scene=row.scene)
        first, second = row.scores(case), row.scores(case)
        if first.tobytes() != second.tobytes():
            raise AssertionError(
                f"{row}, {case.about}: two runs with one seed differ in "
                f"{np.count_nonzero(first != second)} of {first.size} scores; draw from "
                "context.rng alone, and keep nothing between two calls of fit"
            )


def inputs_are_not_mutated(attack: LinkageAttack) -> None:
    """Both releases and the training set are left as they came."""
    for row in rows(attack):
        case = cases.ordinary(scene=row.scene)
        given = cases.copied(case)
        before = _arrays(case)
        run(attack, [given], granted=row.given, who=str(row))
        after = _arrays(given)
        changed = [name for name in before if before[name].tobytes() != after[name].tobytes()]
        if changed:
            raise AssertionError(
                f"{row}, {case.about}: changed {', '.join(changed)}; others read the same arrays: "
                "work on a copy, as in xy = probe.xy.copy()"
            )


def only_granted_knowledge_is_touched(attack: LinkageAttack) -> None:
    """Given what its adversary knows and it declares, and no more, the attack runs."""
    for row in strict_rows(attack):
        case = cases.ordinary(scene=row.scene)
        try:
            row.raw(case)
        except AssertionError as error:
            # Whether more knowledge would help tells a denial from any other fault.
            row.with_everything().raw(case)
            raise AssertionError(
                f"{error}; given all knowledge it runs: declare what you touch in `requires` or "
                "`uses`, and look into context.granted before you touch what is only in `uses` "
                "(without SIGMA, probe.sigma and gallery.sigma are None)"
            ) from error


def order_of_tracks_does_not_matter(attack: LinkageAttack) -> None:
    """Probes in another order permute the rows, gallery tracks the columns, and nothing else."""
    order, columns = [5, 2, 0, 3, 6, 1, 4], [4, 8, 0, 6, 2, 7, 1, 5, 3]
    for row in rows(attack):
        case = cases.ordinary(scene=row.scene)
        expect_same(
            row,
            case,
            got=row.scores(cases.reordered(case, order, columns)),
            expected=row.scores(case)[np.ix_(order, columns)],
            tolerance=SAME,
            what="tracks in another order",
            hint="does anything run from one track into the next, or depend on a track's number?",
        )


def frames_and_clocks_do_not_matter(attack: LinkageAttack) -> None:
    """With every walk of all four releases in another frame and clock the scores are the same.

    Without SCENE that is how an adversary gets them. Whoever is granted SCENE links by where and
    when somebody was, and may know where the walls are: such a row is exempt.
    """
    tested = [row for row in rows(attack) if not row.scene]
    if not tested:
        raise SkipTest("granted SCENE in every row: it may depend on the true frame and clock")
    for row in tested:
        case = cases.ordinary(scene=False)
        expect_same(
            row,
            case,
            got=row.scores(cases.in_other_frames(case)),
            expected=row.scores(case),
            tolerance=SAME,
            what="every walk of either release and of the training set in another frame and clock",
            hint="without SCENE they are random for each walk; does anything depend on x and y "
            "taken by themselves, on headings, on absolute times, or on two walks sharing a frame?",
        )


def pseudonyms_do_not_matter(attack: LinkageAttack) -> None:
    """Other pseudonyms, same scores."""
    for row in rows(attack):
        case = cases.ordinary(scene=row.scene)
        expect_same(
            row,
            case,
            got=row.scores(cases.renamed(case)),
            expected=row.scores(case),
            tolerance=SAME,
            what="other pseudonyms",
            hint="they are drawn afresh for every release",
        )


def one_candidate_is_handled(attack: LinkageAttack) -> None:
    """With one probe or one gallery track or one of either, scores are finite and (P, G)."""
    for row in rows(attack):
        for n_probes, n_gallery in ((1, 1), (4, 1), (1, 4)):
            row.scores(cases.sized(n_probes, n_gallery, scene=row.scene))


def short_tracks_are_handled(attack: LinkageAttack) -> None:
    """Tracks of one, two or three samples, alone or among others, get finite scores."""
    for row in rows(attack):
        for probe, gallery, others in SHORT:
            row.scores(cases.short(probe, gallery, others, scene=row.scene))


def irregular_sampling_is_handled(attack: LinkageAttack) -> None:
    """With steps from 1 ms to 30 s scores are finite."""
    for row in rows(attack):
        row.scores(cases.irregular(scene=row.scene))


def training_without_mates_is_handled(attack: LinkageAttack) -> None:
    """Where a third of the training probes has no mate (-1), nobody is taken for theirs.

    The training gallery is then turned back to front: who takes -1 for the last track learns
    something else. Who learns may differ by 1 % of the spread.
    """
    for row in rows(attack):
        case = cases.without_mates(cases.ordinary(scene=row.scene))
        expect_same(
            row,
            case,
            got=row.scores(cases.with_others_reordered(case)),
            expected=row.scores(case),
            tolerance=SAME_LEARNT,
            what="the gallery of the training set back to front",
            hint="a mate of -1 is no index: keep only the probes with train.mate >= 0",
        )


def calls_do_not_remember(attack: LinkageAttack) -> None:
    """What the function from fit answers does not depend on what it was asked before.

    Asked A, B and A again it answers A alike to the last bit, and B as if it had not seen A. B has
    A's pseudonyms and as many samples, lest a cache go by those.
    """
    for row in rows(attack):
        case = cases.ordinary(scene=row.scene)
        # What was learnt comes from the case that fit was called for, which is the first.
        other = replace(cases.another(scene=row.scene), train=case.train)
        first, after, again = row.scores_in_turn([case, other, case])
        (alone,) = row.scores_in_turn([other])
        for got, expected, what in (
            (again, first, "asked once more, after other releases"),
            (after, alone, "other releases, asked after the first"),
        ):
            if got.tobytes() == expected.tobytes():
                continue
            expect_same(
                row,
                case,
                got=got,
                expected=expected,
                tolerance=0.0,
                what=what,
                hint="one function serves many releases: keep nothing from one to the next",
            )


def null_stays_at_chance(attack: LinkageAttack) -> None:
    """Where no probe is in the gallery, drawn mates come first no more often than by chance.

    Mates are drawn apart from both releases: whatever the scores, the number of mates that come
    first is binomial with p = 1 / G. Among equals each is first with the same probability.
    """
    for row in rows(attack):
        case = cases.unrelated(scene=row.scene)
        mate, chance = case.mate, 1 / len(case.gallery)
        found = hits(row.scores(case), mate)
        # P(as many or more): the survival function counts what exceeds its argument.
        if found >= 1 and bdtrc(int(found) - 1, len(mate), chance) < SURPRISE:
            raise AssertionError(
                f"{row}, {case.about}: {found:.3g} of {len(mate)} drawn mates come first, "
                f"expected about {chance * len(mate):.3g} by chance; does it reach the attack by a "
                "way other than its context who the mates are?"
            )


def easy_case_beats_chance(attack: LinkageAttack) -> None:
    """With errors of 5 cm so many mates come first as chance brings once in 1000 at most."""
    for row in rows(attack):
        case = cases.noisy(EASY_SIGMA_M, "radial", scene=row.scene)
        n_probes, chance = len(case.mate), 1 / len(case.gallery)
        found = hits(row.scores(case), case.mate)
        needed = next(
            count
            for count in range(1, n_probes + 1)
            if bdtrc(count - 1, n_probes, chance) < EASY_SURPRISE
        )
        if found < needed:
            raise AssertionError(
                f"{row}, {case.about}: {found:.3g} of {n_probes} mates come first, expected at "
                f"least {needed}; chance brings {chance * n_probes:.3g} (is the sign right? a "
                "higher score means the same person)"
            )


def success_falls_with_noise(attack: LinkageAttack) -> None:
    """The rank of a mate is worse at 10 m of isotropic noise than at 0.1 m.

    The same people with the same unit errors, so that each probe is compared with itself: the
    mean rise of the logarithm of its mate's rank must exceed 2.5 of its standard errors.
    """
    for row in rows(attack):
        levels = [cases.noisy(sigma_m, "isotropic", scene=row.scene) for sigma_m in SIGMAS_M]
        low, high = (log_ranks(row.scores(case), case.mate) for case in levels)
        rise = high - low
        needed = STANDARD_ERRORS * float(rise.std(ddof=1)) / np.sqrt(rise.size)
        if not rise.mean() > needed:
            raise AssertionError(
                f"{row}, {len(rise)} people: mates have the rank {np.exp(low.mean()):.3g} at "
                f"{SIGMAS_M[0]:g} m of noise and {np.exp(high.mean()):.3g} at {SIGMAS_M[1]:g} m "
                f"(geometric mean of 1 to {len(levels[0].gallery)}), expected a rise by a factor "
                f"of more than {np.exp(needed):.3g}; what does the attack take the noise for?"
            )


LINKAGE_CHECKS: dict[str, LinkageCheck] = {
    check.__name__: check
    for check in (
        result_is_a_score_matrix,
        same_seed_same_result,
        inputs_are_not_mutated,
        only_granted_knowledge_is_touched,
        order_of_tracks_does_not_matter,
        frames_and_clocks_do_not_matter,
        pseudonyms_do_not_matter,
        one_candidate_is_handled,
        short_tracks_are_handled,
        irregular_sampling_is_handled,
        training_without_mates_is_handled,
        calls_do_not_remember,
        null_stays_at_chance,
        easy_case_beats_chance,
        success_falls_with_noise,
    )
}
"""All checks of linkage attacks by name, in the order in which they run."""


def _arrays(case: LinkageCase) -> dict[str, NDArray[Any]]:
    named: dict[str, NDArray[Any]] = {"context.train.mate": case.train.mate}
    for name, release in (
        ("probe", case.probe),
        ("gallery", case.gallery),
        ("context.train.probe", case.train.probe),
        ("context.train.gallery", case.train.gallery),
    ):
        for field in ("t", "xy", "sigma", "offsets"):
            named[f"{name}.{field}"] = getattr(release, field)
    return named
