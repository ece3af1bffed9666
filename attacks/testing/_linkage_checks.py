"""Made-up people as a linkage attack gets them, and what holds for such attacks alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np
from scipy.special import bdtrc

from attacks.testing import _checks as common
from attacks.testing import _releases as made
from attacks.testing._releases import RAW_SIGMA_M, draws
from isac_track.linkability import log_rank, rank1
from isac_track.protocols import OF_WALKS, LinkageTrainingSet
from isac_track.sharing import Fixed
from isac_track.types import ErrorLaw, Floats, Ints, Knowledge, Release

GAP_S = 1.0  # Silence before the gallery goes on, where the scene is shown.
N_PEOPLE = 24
PEOPLE, OTHERS = (128,) * N_PEOPLE, (128,) * 20  # Samples of each: 12 s at 8 to 16 Hz.
_FARTHEST_M = 100.0
_LATEST_S = 1000.0

SAME_LEARNT = 0.01  # Room for what a learner makes of the same examples in another order.
EASY_SURPRISE = 1e-3  # Chance alone would succeed as often with a smaller probability.
SIGMAS_M = (0.1, 10.0)
"""Averaged over 128 samples, 10 m come to 0.9 m: of a walk of some 15 m little is left."""
ODD = (
    *(((128,) * probes, (128,) * gallery, OTHERS) for probes, gallery in ((1, 1), (4, 1), (1, 4))),
    ((1, 1, 1), (1, 1, 1, 1), (40,) * 8),
    ((1, 2, 3, 128), (3, 2, 128, 1, 2), (40,) * 8),
    ((128, 128, 2), (128, 3, 1, 128), (1, 2, 3, 1, 2, 3, 40, 40, 40, 40)),
)
"""Samples of probes, of the gallery and of the training set."""


@dataclass(frozen=True, eq=False, slots=True)
class LinkageCase:
    """P probes, G gallery tracks, and everything that an adversary may know besides.

    Where the scene is hidden, every walk of all four releases comes in a frame and on a clock of
    its own. Probe and gallery are then two recordings of one walk. Where the scene is shown, all
    is in one frame and on one clock, and the gallery goes on after `GAP_S` of silence.
    """

    asked: ClassVar[tuple[str, ...]] = ("probe", "gallery")
    gives: ClassVar[str] = "from two releases, probe and gallery, to a matrix of scores"
    repeats: ClassVar[None] = None
    anchor: ClassVar[None] = None
    companions: ClassVar[None] = None
    """Nobody who links is granted any: the repeats of a walk would be linked already."""
    compared: ClassVar[str] = "scores"
    unit: ClassVar[str] = ""

    about: str
    probe: Release
    gallery: Release
    mate: Ints  # (P,) gallery track of the same person, or -1. No attack is given it.
    mechanism: Fixed
    train: LinkageTrainingSet
    everything: frozenset[Knowledge]
    """All that there is to grant; SCENE where the true frame and clock are shown."""

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return a result as an array, or raise ValueError if it is not one of scores.

        That is a finite real number for each probe and gallery track; the type is another check's.
        """
        expected = (len(self.probe), len(self.gallery))
        try:
            scores = np.asarray(result)
        except ValueError:  # rows of different lengths
            scores = np.asarray(None)
        if scores.dtype.kind not in "fiub":
            shown = type(result).__name__ if scores.ndim == 0 else f"an array of {scores.dtype}"
            raise ValueError(f"expected real numbers of shape (P, G) = {expected}, got {shown}")
        if scores.shape != expected:
            turned = " (turned round?)" if scores.shape == expected[::-1] else ""
            raise ValueError(
                f"scores of shape {scores.shape}, expected (P, G) = {expected}: "
                f"a row for every probe, a column for every gallery track{turned}"
            )
        scores = scores.astype(np.float64)
        if lost := np.count_nonzero(~np.isfinite(scores)):
            raise ValueError(
                f"{lost} of {scores.size} scores are not finite; who cannot tell gives all "
                "candidates the same score"
            )
        return scores

    def gaps(self, one: Floats, other: Floats, plain: Floats) -> Floats:
        """Return how far apart scores are, (1, P G): they have no unit, but a spread."""
        # Where all scores are alike there is none; their size will do.
        spread = float(np.ptp(plain)) or float(np.abs(plain).max()) or 1.0
        return (np.abs(one - other) / spread).reshape(1, -1)

    def reordered(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the ordinary case with its tracks in another order, and how scores follow."""
        rows, columns = (5, 2, 0, 3, 6, 1, 4), (4, 8, 0, 6, 2, 7, 1, 5, 3)
        changed = replace(
            self,
            probe=self.probe.tracks(rows),
            gallery=self.gallery.tracks(columns),
            mate=np.argsort(columns)[self.mate[list(rows)]],
        )
        return changed, lambda scores: scores[np.ix_(rows, columns)]

    def in_other_frames(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the case with every walk of all four releases in yet another frame and clock."""
        rng = draws("linkage", "other frames")
        changed = made.of_each(self, lambda release: _moved(release, rng, together=False))
        return changed, lambda scores: scores


def ordinary_and_another(granted: frozenset[Knowledge]) -> tuple[LinkageCase, LinkageCase]:
    """Return a small case as most are, with P < G, and one of other people under its pseudonyms."""
    scene = Knowledge.SCENE in granted
    case, other = (sized(7, 9, scene=scene, name=name) for name in ("ordinary", "another"))
    return case, replace(
        other,
        about=f"{case.about}, of other people",
        probe=replace(other.probe, pseudonym=case.probe.pseudonym),
        gallery=replace(other.gallery, pseudonym=case.gallery.pseudonym),
        train=case.train,
    )


def sized(n_probes: int, n_gallery: int, *, scene: bool, name: str = "ordinary") -> LinkageCase:
    """Return so many probes against so many gallery tracks."""
    about = f"P = {n_probes}, G = {n_gallery}, noise of 0.3 m"
    sizes = PEOPLE[:n_probes], PEOPLE[:n_gallery], OTHERS
    return made_up(name, about=about, sizes=sizes, scene=scene)


def noisy(sigma_m: float, law: ErrorLaw, *, scene: bool) -> LinkageCase:
    """Return the same 24 people against each other, with the same errors times `sigma_m`."""
    about = f"{N_PEOPLE} people, {law} noise of {sigma_m:g} m"
    return made_up("noisy", about=about, sigma_m=sigma_m, law=law, scene=scene)


@cache
def made_up(
    name: str,
    *,
    about: str,
    sizes: tuple[tuple[int, ...], ...] = (PEOPLE, PEOPLE, OTHERS),
    sigma_m: float = 0.3,
    scene: bool,
    law: ErrorLaw = "radial",
    steps_s: tuple[float, float] = made.STEADY_S,
) -> LinkageCase:
    """Return people who differ in speed, in how evenly they walk and in how they turn.

    People, sampling instants, frames and unit errors depend on `name` and sizes alone, so that two
    noise levels, of `RAW_SIGMA_M` or more, differ in nothing else. `sizes` are the samples of each
    track of probe and gallery, which are the same people, and of either release of the training
    set, which is other people.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)

    def release(
        name: tuple[str, ...], people: list[made.Person], sizes: tuple[int, ...]
    ) -> Release:
        walks = []
        for row, size in enumerate(sizes):
            elapsed = made.instants(draws(*name, row), size, steps_s)
            t = GAP_S + elapsed if scene and name[-1] == "gallery" else elapsed - elapsed[-1]
            walks.append((t, people[row](t)))
        # One motion for all that is in one frame, or one for every walk.
        frames = draws(*(name[:-1] if scene else name), "frames")
        return _moved(made.shared(walks, name, mechanism=mechanism), frames, together=scene)

    def pair(who: str, *sizes: tuple[int, ...]) -> LinkageTrainingSet:
        name_of = ("linkage", name, who)
        rng = draws(*name_of, "people")
        speeds = rng.permutation(np.linspace(*made.SPEEDS_MPS, max(map(len, sizes))))
        people = [made.person(float(speed_mps), rng) for speed_mps in speeds]
        probe = release((*name_of, "probe"), people, sizes[0])
        gallery = release((*name_of, "gallery"), people, sizes[1])
        # In an order of its own, lest a place in the list tell who is who.
        order = draws(*name_of, "order").permutation(len(gallery))
        mate = np.concatenate([np.argsort(order), np.full(len(probe), -1)])[: len(probe)]
        return LinkageTrainingSet(probe, gallery.tracks(order), mate)

    victims = pair("victims", *sizes[:2])
    hidden = OF_WALKS if scene else OF_WALKS | {Knowledge.SCENE}
    return LinkageCase(
        about=about + (", in one frame" if scene else ""),
        probe=victims.probe,
        gallery=victims.gallery,
        mate=victims.mate,
        mechanism=mechanism,
        train=pair("others", sizes[2], sizes[2]),
        everything=frozenset(Knowledge) - hidden,
    )


def _moved(release: Release, rng: np.random.Generator, *, together: bool) -> Release:
    """Return a release with one motion for all its walks, or with one for each."""
    low = 0.0, -_FARTHEST_M, -_FARTHEST_M, 0.0
    high = 2.0 * np.pi, _FARTHEST_M, _FARTHEST_M, _LATEST_S
    n_samples = [release.t.size] if together else np.diff(release.offsets)
    drawn = np.repeat(rng.uniform(low, high, (len(n_samples), 4)), n_samples, axis=0)
    return made.moved(release, (drawn[:, 0], drawn[:, 1:3], drawn[:, 3]))


def _with_gallery(train: LinkageTrainingSet, mate: Ints, rows: Ints) -> LinkageTrainingSet:
    """Return a training set with these rows of its gallery; mates are given as they were."""
    place = np.full(len(train.gallery) + 1, -1)  # the last is that of nobody, -1
    place[rows] = np.arange(rows.size)
    return LinkageTrainingSet(train.probe, train.gallery.tracks(rows), place[mate])


# The checks


def result_is_a_score_matrix(row: common.Row) -> None:
    """An array (P, G) of finite floats comes back, with fewer probes than candidates or more."""
    for case in (row.ordinary, sized(9, 7, scene=row.scene)):
        (result,) = row.raw(made.copied(case))
        row.read(case, result)
        if not (isinstance(result, np.ndarray) and result.dtype.kind == "f"):
            dtype = getattr(result, "dtype", None)
            of = "" if dtype is None else f" of {dtype}"
            row.fail(
                case.about, f"expected a numpy array of floats, got {type(result).__name__}{of}"
            )


def frames_and_clocks_do_not_matter(row: common.Row) -> None:
    """With every walk of all four releases in another frame and clock the scores are the same.

    Whoever is granted SCENE links by where and when somebody was: such a row is exempt.
    """
    common.frames_do_not_matter(
        row,
        tolerance=common.SAME,
        what="every walk of either release and of the training set in another frame and clock",
        hint="without SCENE they are random for each walk; does anything depend on x and y "
        "taken by themselves, on headings, on absolute times, or on two walks sharing a frame?",
    )


def odd_tracks_are_handled(row: common.Row) -> None:
    """Of one probe or candidate, tracks of 1 to 3 samples, steps of 1 ms to 30 s: finite scores."""
    for sizes in ODD:
        probes, candidates, _ = (", ".join(map(str, of_side)) for of_side in sizes)
        about = f"probes of {probes} samples against {candidates}"
        row.answer(made_up("short", about=about, sizes=sizes, scene=row.scene))
    about, sizes = "steps from 1 ms to 30 s", ((60,) * 6, (60,) * 8, (60,) * 12)
    steps_s = made.IRREGULAR_S
    row.answer(made_up("irregular", about=about, sizes=sizes, scene=row.scene, steps_s=steps_s))


def training_without_mates_is_handled(row: common.Row) -> None:
    """Where a third of the training probes has no mate (-1), nobody is taken for theirs.

    Of every other such probe the gallery track is gone, of the rest it stays as a stranger's. The
    training gallery is then turned back to front: who takes -1 for the last track learns something
    else. Who learns may differ by 1 % of the spread.
    """
    case, train = row.ordinary, row.ordinary.train
    mate = train.mate.copy()
    mate[::3] = -1
    stays = np.setdiff1d(np.arange(len(train.gallery)), train.mate[::6])
    about = f"{case.about}, {np.count_nonzero(mate < 0)} of {mate.size} others without a mate"
    case = replace(case, about=about, train=_with_gallery(train, mate, stays))
    turned = _with_gallery(case.train, case.train.mate, np.arange(stays.size)[::-1])
    replace(row, ordinary=case).expect_same(
        row.answer(replace(case, train=turned)),
        row.answer(case),
        tolerance=SAME_LEARNT,
        what="the gallery of the training set back to front",
        hint="a mate of -1 is no index: keep only the probes with train.mate >= 0",
    )


def null_stays_at_chance(row: common.Row) -> None:
    """Where no probe is in the gallery, drawn mates come first no more often than by chance.

    Mates are drawn one by one, apart from both releases. Whatever the scores, each probe's mate
    comes first with probability 1 / G, independently of all others.
    """
    mate = draws("linkage", "strangers", "mate").integers(0, N_PEOPLE, N_PEOPLE)
    strangers = made_up("strangers", about="", sigma_m=RAW_SIGMA_M, scene=row.scene)
    case = replace(
        noisy(RAW_SIGMA_M, "radial", scene=row.scene),
        about=f"{N_PEOPLE} probes of people who are not among the {N_PEOPLE} of the gallery",
        gallery=strangers.gallery,
        mate=mate,
    )
    scores, what = row.answer(case), "drawn mates come first"
    # One by one, since two may have drawn one mate.
    hits = [rank1(scores=scores[[one]], mate=mate[[one]]) for one in range(N_PEOPLE)]
    hint = "does it reach the attack by a way other than its context who the mates are?"
    chance = 1 / N_PEOPLE
    common.expect_chance(row, case.about, np.concatenate(hits), chance=chance, what=what, hint=hint)


def easy_case_beats_chance(row: common.Row) -> None:
    """With errors of 5 cm so many mates come first as chance brings once in 1000 at most."""
    case = noisy(RAW_SIGMA_M, "radial", scene=row.scene)
    found = rank1(scores=row.answer(case), mate=case.mate).sum()
    # P(as many or more) for every count from one.
    tail = bdtrc(np.arange(N_PEOPLE), N_PEOPLE, 1 / N_PEOPLE)
    needed = 1 + int(np.argmax(tail < EASY_SURPRISE))
    if found < needed:
        row.fail(
            case.about,
            f"{found:.3g} of {N_PEOPLE} mates come first, expected at least {needed}; chance "
            "brings 1 (is the sign right? a higher score means the same person)",
        )


def success_falls_with_noise(row: common.Row) -> None:
    """The rank of a mate is worse at 10 m of isotropic noise than at 0.1 m.

    The same people with the same unit errors, so that each probe is compared with itself: the
    mean rise of the logarithm of its mate's rank must exceed 2.5 of its standard errors.
    """
    levels = [noisy(sigma_m, "isotropic", scene=row.scene) for sigma_m in SIGMAS_M]
    low, high = (
        np.log(N_PEOPLE) - log_rank(scores=row.answer(case), mate=case.mate) for case in levels
    )
    needed = common.least_rise(high - low)
    if not (high - low).mean() > needed:
        row.fail(
            f"{N_PEOPLE} people",
            f"mates have the rank {np.exp(low.mean()):.3g} at {SIGMAS_M[0]:g} m of noise and "
            f"{np.exp(high.mean()):.3g} at {SIGMAS_M[1]:g} m (geometric mean of 1 to {N_PEOPLE}), "
            f"expected a rise by a factor of more than {np.exp(needed):.3g}; what does the attack "
            "take the noise for?",
        )


ALL = (
    result_is_a_score_matrix,
    *common.FIRST,
    frames_and_clocks_do_not_matter,
    common.pseudonyms_do_not_matter,
    odd_tracks_are_handled,
    training_without_mates_is_handled,
    common.calls_do_not_remember,
    null_stays_at_chance,
    easy_case_beats_chance,
    success_falls_with_noise,
)
"""In the order in which they run."""
