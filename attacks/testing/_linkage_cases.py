"""Made-up people as a linkage attack gets them, and what its scores come to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np

from attacks.testing import _releases as made
from attacks.testing._releases import RAW_SIGMA_M, draws
from isac_track.linkability import log_rank, rank1
from isac_track.protocols import OF_WALKS, LinkageTrainingSet
from isac_track.sharing import Fixed
from isac_track.types import ErrorLaw, Floats, Ints, Knowledge, Release

GAP_S = 1.0  # Silence before the gallery goes on, where the scene is shown.
N_PEOPLE = 24
PEOPLE, OTHERS = (128,) * N_PEOPLE, (128,) * 20  # Samples of each: 12 s at 8 to 16 Hz.

ODD = (
    *(((128,) * probes, (128,) * gallery, OTHERS) for probes, gallery in ((1, 1), (4, 1), (1, 4))),
    ((1, 1, 1), (1, 1, 1, 1), (40,) * 8),
    ((1, 2, 3, 128), (3, 2, 128, 1, 2), (40,) * 8),
    ((128, 128, 2), (128, 3, 1, 128), (1, 2, 3, 1, 2, 3, 40, 40, 40, 40)),
)
"""Samples of probes, of the gallery and of the training set."""


@dataclass(frozen=True, eq=False, slots=True)
class LinkageCase(made.Case):
    """P probes, G gallery tracks, and everything that an adversary may know besides.

    Where the scene is hidden, every walk comes in a frame and on a clock of its own, and probe and
    gallery are two recordings of one walk. Where it is shown, all is in one frame and on one clock,
    and the gallery goes on after `GAP_S` of silence.
    """

    asked: ClassVar[tuple[str, ...]] = ("probe", "gallery")
    compared: ClassVar[str] = "scores"
    unit: ClassVar[str] = " of their spread"
    framed: ClassVar[str] = "every walk of either release and of the training set"
    hit: ClassVar[str] = "mates come first"
    chance: ClassVar[float] = 1 / N_PEOPLE
    easy_share: ClassVar[float] = 1 / 4  # Chance alone brings 6 of 24 once in 1000 at most.
    easy_hint: ClassVar[str] = "is the sign right? a higher score means the same person"
    levels_m: ClassVar[tuple[float, ...]] = (0.1, 10.0)
    """Averaged over 128 samples, 10 m come to 0.9 m: of a walk of some 15 m little is left."""
    achieved: ClassVar[str] = "the mean logarithm of candidates over the rank of the mate"

    probe: Release
    gallery: Release
    mate: Ints  # (P,) gallery track of the same person, or -1. No attack is given it.
    mechanism: Fixed
    train: LinkageTrainingSet
    scene: bool  # Whether the true frame and clock are shown.

    @property
    def everything(self) -> frozenset[Knowledge]:  # type: ignore[override]  # a class variable elsewhere
        """All that there is to grant: the repeats of a walk would be linked already."""
        return frozenset(Knowledge) - OF_WALKS - ({Knowledge.SCENE} if not self.scene else set())

    def fault(self, result: object) -> str:
        """Return what is wrong with a result that can be read all the same; empty if nothing."""
        if isinstance(result, np.ndarray) and result.dtype.kind == "f":
            return ""
        of = f" of {result.dtype}" if isinstance(result, np.ndarray) else ""
        return f"expected a numpy array of floats, got {type(result).__name__}{of}"

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return scores as an array of floats; ValueError if they are not finite real numbers."""
        scores, expected = np.asarray(result), (len(self.probe), len(self.gallery))
        if scores.dtype.kind not in "fiub":
            got = f"{type(result).__name__} of {scores.dtype}"
            raise ValueError(f"expected real numbers of shape (P, G) = {expected}, got {got}")
        if scores.shape != expected:
            turned = " (turned round?)" if scores.shape == expected[::-1] else ""
            rows = f"a row for every probe, a column for every gallery track{turned}"
            raise ValueError(
                f"scores of shape {scores.shape}, expected (P, G) = {expected}: {rows}"
            )
        if lost := np.count_nonzero(~np.isfinite(scores)):
            hint = "who cannot tell gives all candidates the same score"
            raise ValueError(f"{lost} of {scores.size} scores are not finite; {hint}")
        return scores.astype(np.float64)

    def gaps(self, one: Floats, other: Floats) -> Floats:
        """Return how far apart scores are, (1, P G): they have no unit, but a spread."""
        # Where all scores are alike there is none; their size will do.
        spread = float(np.ptp(other)) or float(np.abs(other).max()) or 1.0
        return (np.abs(one - other) / spread).reshape(1, -1)

    def hits(self, scores: Floats) -> Floats:
        """Return how often each probe's mate comes first, (P,), over a random order of ties."""
        # One by one, since two may have drawn one mate.
        rows = range(len(self.mate))
        return np.concatenate([rank1(scores=scores[[row]], mate=self.mate[[row]]) for row in rows])

    def success(self, scores: Floats) -> Floats:
        """Return the logarithm of candidates over the mate's rank, (P,)."""
        return log_rank(scores=scores, mate=self.mate)

    def reordered(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the ordinary case with its tracks in another order, and how scores follow."""
        rows, columns = (5, 2, 0, 3, 6, 1, 4), (4, 8, 0, 6, 2, 7, 1, 5, 3)
        changed = replace(self, probe=self.probe.tracks(rows), gallery=self.gallery.tracks(columns))
        return changed, lambda scores: scores[np.ix_(rows, columns)]

    def in_other_frames(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the case with every walk of all four releases in yet another frame and clock."""
        rng = draws("linkage", "other frames")
        changed = made.of_each(self, lambda release: _moved(release, rng, together=False))
        return changed, lambda scores: scores

    @staticmethod
    def ordinary_and_another(granted: frozenset[Knowledge]) -> tuple[LinkageCase, LinkageCase]:
        """Return a small case as most are, with P < G, and one of others under its pseudonyms."""
        sizes = PEOPLE[:7], PEOPLE[:9], OTHERS
        about, scene = "P = 7, G = 9, noise of 0.3 m", Knowledge.SCENE in granted
        case = made_up("ordinary", about=about, sizes=sizes, scene=scene)
        other = made_up("another", about=f"{about}, of others", sizes=sizes, scene=scene)
        probe = replace(other.probe, pseudonym=case.probe.pseudonym)
        gallery = replace(other.gallery, pseudonym=case.gallery.pseudonym)
        return case, replace(other, probe=probe, gallery=gallery, train=case.train)

    def noisy(self, sigma_m: float, law: ErrorLaw) -> LinkageCase:
        """Return the same 24 people against each other, with the same errors times `sigma_m`."""
        about = f"{N_PEOPLE} people, {law} noise of {sigma_m:g} m"
        return made_up("noisy", about=about, sigma_m=sigma_m, law=law, scene=self.scene)

    def null(self) -> LinkageCase:
        """Return probes of people who are not in the gallery, with mates drawn one by one."""
        strangers = made_up("strangers", about="", sigma_m=RAW_SIGMA_M, scene=self.scene)
        return replace(
            self.noisy(RAW_SIGMA_M, "radial"),
            about=f"{N_PEOPLE} probes of people who are not among the {N_PEOPLE} of the gallery",
            gallery=strangers.gallery,
            mate=draws("linkage", "strangers", "mate").integers(0, N_PEOPLE, N_PEOPLE),
        )

    def odd(self) -> Iterator[LinkageCase]:
        """Yield one probe or candidate, tracks of one to three samples, and odd steps."""
        for sizes in ODD:
            probes, candidates, _ = (", ".join(map(str, of_side)) for of_side in sizes)
            about = f"probes of {probes} samples against {candidates}"
            yield made_up("short", about=about, sizes=sizes, scene=self.scene)
        about, sizes = "steps from 1 ms to 30 s", ((60,) * 6, (60,) * 8, (60,) * 12)
        more = {"scene": self.scene, "steps_s": made.IRREGULAR_S}
        yield made_up("irregular", about=about, sizes=sizes, **more)


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

    All but the size of the errors depends on `name` and sizes alone: the samples of each track of
    probe and gallery, which are the same people, and of either release of the training set.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)

    def release(name: tuple[str, ...], who: list[made.Person], sizes: tuple[int, ...]) -> Release:
        walks = []
        for row, size in enumerate(sizes):
            elapsed = made.instants(draws(*name, row), size, steps_s)
            t = GAP_S + elapsed if scene and name[-1] == "gallery" else elapsed - elapsed[-1]
            walks.append((t, who[row](t)))
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
    return LinkageCase(
        about=about + (", in one frame" if scene else ""),
        probe=victims.probe,
        gallery=victims.gallery,
        mate=victims.mate,
        mechanism=mechanism,
        train=pair("others", sizes[2], sizes[2]),
        scene=scene,
    )


def _moved(release: Release, rng: np.random.Generator, *, together: bool) -> Release:
    """Return a release with one motion for all its walks, or with one for each."""
    n_samples = [release.t.size] if together else np.diff(release.offsets)
    frames = made.frames(rng, len(n_samples))
    return made.moved(release, np.repeat(frames, n_samples, axis=0))
