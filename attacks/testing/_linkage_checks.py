"""What holds for linkage attacks alone, and the list of their checks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import bdtrc

from attacks.testing import _checks as common
from attacks.testing import _linkage_cases as cases
from attacks.testing._releases import RAW_SIGMA_M, copied
from attacks.testing._rows import expect_same

if TYPE_CHECKING:
    from attacks.testing._rows import Row
    from isac_track.types import Floats, Ints

SAME_LEARNT = 0.01
"""Room for what a learner makes of the same examples in another order."""
EASY_SURPRISE = 1e-3
"""Chance alone would succeed as often with a smaller probability."""
EASY_SIGMA_M = RAW_SIGMA_M
SIGMAS_M = (0.1, 10.0)
"""Averaged over 128 samples, 10 m come to 0.9 m: of a walk of some 15 m little is left."""
SHORT = (
    ((1, 1, 1), (1, 1, 1, 1), (40,) * 8),
    ((1, 2, 3, 128), (3, 2, 128, 1, 2), (40,) * 8),
    ((128, 128, 2), (128, 3, 1, 128), (1, 2, 3, 1, 2, 3, 40, 40, 40, 40)),
)
"""Samples of probes, of the gallery and of the training set."""


def result_is_a_score_matrix(row: Row) -> None:
    """An array (P, G) of finite floats comes back, with fewer probes than candidates or more."""
    for case in (row.ordinary, cases.sized(9, 7, scene=row.scene)):
        (result,) = row.raw([copied(case)])
        row.read(case, result)
        if not (isinstance(result, np.ndarray) and result.dtype.kind == "f"):
            dtype = getattr(result, "dtype", None)
            of = "" if dtype is None else f" of {dtype}"
            row.fail(case, f"expected a numpy array of floats, got {type(result).__name__}{of}")


def frames_and_clocks_do_not_matter(row: Row) -> None:
    """With every walk of all four releases in another frame and clock the scores are the same.

    Without SCENE that is how an adversary gets them. Whoever is granted SCENE links by where and
    when somebody was, and may know where the walls are: such a row is exempt.
    """
    common.frames_do_not_matter(
        row,
        tolerance=common.SAME,
        what="every walk of either release and of the training set in another frame and clock",
        hint="without SCENE they are random for each walk; does anything depend on x and y "
        "taken by themselves, on headings, on absolute times, or on two walks sharing a frame?",
    )


def one_candidate_is_handled(row: Row) -> None:
    """With one probe or one gallery track or one of either, scores are finite and (P, G)."""
    for n_probes, n_gallery in ((1, 1), (4, 1), (1, 4)):
        row.answer(cases.sized(n_probes, n_gallery, scene=row.scene))


def short_tracks_are_handled(row: Row) -> None:
    """Tracks of one, two or three samples, alone or among others, get finite scores."""
    for probe, gallery, others in SHORT:
        row.answer(cases.short(probe, gallery, others, scene=row.scene))


def irregular_sampling_is_handled(row: Row) -> None:
    """With steps from 1 ms to 30 s scores are finite."""
    row.answer(cases.irregular(scene=row.scene))


def training_without_mates_is_handled(row: Row) -> None:
    """Where a third of the training probes has no mate (-1), nobody is taken for theirs.

    The training gallery is then turned back to front: who takes -1 for the last track learns
    something else. Who learns may differ by 1 % of the spread.
    """
    case = cases.without_mates(row.ordinary)
    expect_same(
        row,
        case,
        got=row.answer(cases.with_others_reordered(case)),
        expected=row.answer(case),
        tolerance=SAME_LEARNT,
        what="the gallery of the training set back to front",
        hint="a mate of -1 is no index: keep only the probes with train.mate >= 0",
    )


def null_stays_at_chance(row: Row) -> None:
    """Where no probe is in the gallery, drawn mates come first no more often than by chance.

    Mates are drawn apart from both releases: whatever the scores, the number of mates that come
    first is binomial with p = 1 / G. Among equals each is first with the same probability.
    """
    case = cases.unrelated(scene=row.scene)
    mate, chance = case.mate, 1 / len(case.gallery)
    found = hits(row.answer(case), mate)
    if common.is_surprising(found, tries=len(mate), chance=chance):
        row.fail(
            case,
            f"{found:.3g} of {len(mate)} drawn mates come first, expected about "
            f"{chance * len(mate):.3g} by chance; does it reach the attack by a way other than "
            "its context who the mates are?",
        )


def easy_case_beats_chance(row: Row) -> None:
    """With errors of 5 cm so many mates come first as chance brings once in 1000 at most."""
    case = cases.noisy(EASY_SIGMA_M, "radial", scene=row.scene)
    n_probes, chance = len(case.mate), 1 / len(case.gallery)
    found = hits(row.answer(case), case.mate)
    # P(as many or more) for every count from one.
    tail = bdtrc(np.arange(n_probes), n_probes, chance)
    needed = 1 + int(np.argmax(tail < EASY_SURPRISE))
    if found < needed:
        row.fail(
            case,
            f"{found:.3g} of {n_probes} mates come first, expected at least {needed}; chance "
            f"brings {chance * n_probes:.3g} (is the sign right? a higher score means the same "
            "person)",
        )


def success_falls_with_noise(row: Row) -> None:
    """The rank of a mate is worse at 10 m of isotropic noise than at 0.1 m.

    The same people with the same unit errors, so that each probe is compared with itself: the
    mean rise of the logarithm of its mate's rank must exceed 2.5 of its standard errors.
    """
    levels = [cases.noisy(sigma_m, "isotropic", scene=row.scene) for sigma_m in SIGMAS_M]
    low, high = (log_ranks(row.answer(case), case.mate) for case in levels)
    needed = common.least_rise(high - low)
    if not (high - low).mean() > needed:
        raise AssertionError(
            f"{row}, {low.size} people: mates have the rank {np.exp(low.mean()):.3g} at "
            f"{SIGMAS_M[0]:g} m of noise and {np.exp(high.mean()):.3g} at {SIGMAS_M[1]:g} m "
            f"(geometric mean of 1 to {len(levels[0].gallery)}), expected a rise by a factor "
            f"of more than {np.exp(needed):.3g}; what does the attack take the noise for?"
        )


ALL = (
    result_is_a_score_matrix,
    common.same_seed_same_result,
    common.inputs_are_not_mutated,
    common.only_granted_knowledge_is_touched,
    common.order_of_tracks_does_not_matter,
    frames_and_clocks_do_not_matter,
    common.pseudonyms_do_not_matter,
    one_candidate_is_handled,
    short_tracks_are_handled,
    irregular_sampling_is_handled,
    training_without_mates_is_handled,
    common.calls_do_not_remember,
    null_stays_at_chance,
    easy_case_beats_chance,
    success_falls_with_noise,
)
"""In the order in which they run."""


def hits(scores: Floats, mate: Ints) -> float:
    """Return how many probes have their mate first, as expected if equals are drawn from."""
    own = scores[np.arange(len(mate)), mate]
    best = scores.max(axis=1)
    ties = (scores == best[:, None]).sum(axis=1)
    return float(np.sum((own == best) / ties))


def log_ranks(scores: Floats, mate: Ints) -> Floats:
    """Return the logarithm of the rank of each probe's mate, (P,): 0 is first.

    Among equals a mate is in the middle.
    """
    own = scores[np.arange(len(mate)), mate][:, None]
    better, equal = (scores > own).sum(axis=1), (scores == own).sum(axis=1)
    ranks: Floats = np.log(better + (equal + 1) / 2)
    return ranks
