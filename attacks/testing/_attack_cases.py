"""Made-up people as attacks get them, and what answers and scores come to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from attacks.testing import _releases as made
from attacks.testing._releases import BOX_M, EPSILON_M, RAW_SIGMA_M, draws
from isac_track.kalman.steady import Q_M2_PER_S3
from isac_track.linkability import log_rank, rank1
from isac_track.model_world import Motion, errors_of, known_share, simulated
from isac_track.privacy import exposure, leakage_indicator
from isac_track.protocols import OF_WALKS, LinkageTrainingSet, TrainingSet
from isac_track.sharing import Fixed
from isac_track.types import (
    Bools,
    ErrorLaw,
    Floats,
    Ints,
    Knowledge,
    Reconstruction,
    Release,
)

N_TRACKS = 24  # And people.
_MODEL_SIGMA_M = 0.7
EXTENTS, EXTRA_M = 3.0, 10.0  # How far an answer may lie from the middle of its track.
GAP_S = 1.0  # Silence before the gallery goes on, where the scene is shown.
PEOPLE, OTHERS = (128,) * N_TRACKS, (128,) * 20  # Samples of each: 12 s at 8 to 16 Hz.
ODD = (  # Samples of probes, of the gallery and of the training set.
    *(
        ((128,) * probes, (128,) * gallery, OTHERS)
        for probes, gallery in ((1, 1), (4, 1), (1, 4))
    ),
    ((1, 1, 1), (1, 1, 1, 1), (40,) * 8),
    ((1, 2, 3, 128), (3, 2, 128, 1, 2), (40,) * 8),
    ((128, 128, 2), (128, 3, 1, 128), (1, 2, 3, 1, 2, 3, 40, 40, 40, 40)),
)


@dataclass(frozen=True, eq=False, slots=True)
class ReconstructionCase(made.Case):
    """One release with M samples, and everything that an adversary may know besides."""

    asked: ClassVar[tuple[str, ...]] = (
        "release",
    )  # What the function from `fit` is called with.
    compared: ClassVar[str] = "positions or std"
    unit: ClassVar[str] = " m"
    hit: ClassVar[str] = "samples leak"
    chance: ClassVar[float] = (
        np.pi * EPSILON_M**2 / BOX_M**2
    )  # Of a truth drawn in the square.
    # The shared positions themselves come to 1.0 there.
    easy_share: ClassVar[float] = 0.5
    easy_hint: ClassVar[str] = "does it smooth too much, or lag behind?"
    levels_m: ClassVar[tuple[float, ...]] = (0.3, 1.0, 3.0)
    achieved: ClassVar[str] = "PLR"

    release: Release
    truth: Floats  # (M, 2) m. No attack is given it.
    mechanism: Fixed
    train: TrainingSet
    repeats: tuple[Release, ...]
    anchor: Release
    companions: tuple[Release, ...]

    def fault(self, result: object) -> str:
        wrong = (
            "expected a Reconstruction, got ndarray; wrap the positions:"
            " Reconstruction(xy)"
        )
        return "" if isinstance(result, Reconstruction) else wrong

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return positions, of either type, and std, if claimed, (M, 2 or 3) m; or ValueError."""
        found = Reconstruction(result) if isinstance(result, np.ndarray) else result
        if not isinstance(found, Reconstruction):
            raise ValueError(f"expected a Reconstruction, got {type(result).__name__}")  # noqa: TRY004 - of a stranger's
        if found.xy.shape != self.release.xy.shape:
            wanted = (
                f"expected {self.release.xy.shape}: one for every sample of the release"
            )
            raise ValueError(
                f"positions of shape {found.xy.shape}, {wanted}, in its order"
            )
        return found.xy if found.std is None else np.column_stack([found.xy, found.std])

    def hits(self, answer: Floats) -> Bools:
        """Return which samples leak, (M,)."""
        return leakage_indicator(
            shared_xy=answer[:, :2], true_xy=self.truth, epsilon_m=EPSILON_M
        )

    def success(self, answer: Floats) -> Floats:
        """Return the PLR of each track, (N,)."""
        leaked, release = self.hits(answer), self.release
        return exposure(leaked=leaked, t=release.t, offsets=release.offsets).plr

    def out_of_bounds(self, answer: Floats) -> str:
        first, sizes = self.release.offsets[:-1], np.diff(self.release.offsets)
        low, high = (
            each.reduceat(self.release.xy, first) for each in (np.minimum, np.maximum)
        )
        middle = np.repeat((low + high) / 2, sizes, axis=0)
        away_m = np.maximum.reduceat(np.hypot(*(answer[:, :2] - middle).T), first)
        limit_m = EXTENTS * np.hypot(*(high - low).T) + EXTRA_M
        if (away_m <= limit_m).all():
            return ""
        worst = int(np.argmax(away_m / limit_m))
        room = (
            f"{limit_m[worst]:.0f} m ({EXTENTS:g} times its extent and {EXTRA_M:g} m)"
        )
        away = f"{away_m[worst]:.0f} m from the middle of track {worst}"
        return f"an answer lies {away}, expected at most {room}"

    def reordered(self) -> tuple[ReconstructionCase, Callable[[Floats], Floats]]:
        """Return the ordinary case with its tracks in another order, and how an answer follows."""
        rows, others = np.array([5, 2, 7, 0, 3, 6, 1, 4]), self.train.release
        place = np.repeat(np.argsort(rows), np.diff(self.release.offsets))
        samples = np.argsort(place, kind="stable")
        changed = made.of_each(
            self, lambda one: one if one is others else one.tracks(rows)
        )
        return changed, lambda answer: answer[samples]

    def in_other_frames(self) -> tuple[ReconstructionCase, Callable[[Floats], Floats]]:
        """Return the case as without SCENE, every release in its own frame; how answers follow."""
        mine, others, *repeats = made.frames(draws("frames"), 4)
        # The anchor and who walks along are seen as the release is.
        frames = [mine, others, *repeats, mine, mine]
        changed = made.of_each(self, lambda release: made.moved(release, frames.pop(0)))
        train = replace(changed.train, truth=made.turned(self.train.truth, others))
        return replace(changed, train=train), lambda answer: np.hstack(
            [made.turned(answer[:, :2], mine), answer[:, 2:]]
        )

    @staticmethod
    def ordinary_and_another(
        _granted: object, **_shown: bool
    ) -> tuple[ReconstructionCase, ReconstructionCase]:
        """Return a small case as most are, and one with another release of the same walks."""
        sizes = tuple(20 + 4 * row for row in range(8))
        case = made_up("ordinary", about="8 walks, noise of 0.3 m", sizes=sizes)
        other = replace(case.repeats[0], pseudonym=case.release.pseudonym)
        return case, replace(case, release=other)

    def noisy(self, sigma_m: float, law: ErrorLaw) -> ReconstructionCase:
        """Return the same 24 walks of 60 to 200 samples, with the same errors times `sigma_m`."""
        sizes = tuple(60 + 6 * row for row in range(N_TRACKS))
        about = f"{N_TRACKS} walks, {law} noise of {sigma_m:g} m"
        return made_up("noisy", about=about, sizes=sizes, sigma_m=sigma_m, law=law)

    @staticmethod
    @cache
    def modelled(law: ErrorLaw) -> tuple[ReconstructionCase, Floats]:
        """Return walks of a model behind 0.7 m of noise, and the PLR that a genie expects, (N,)."""
        about = f"{N_TRACKS} walks of a model, {law} noise"
        like = made_up("model", about=about, sizes=(150,) * N_TRACKS, law=law)
        t, offsets = like.release.t, like.release.offsets
        motion, rng = Motion(Q_M2_PER_S3, 1.0), draws("model", "walks")
        start = np.zeros((N_TRACKS, 2))
        truth = simulated(t=t, offsets=offsets, start=start, motion=motion, rng=rng)
        walked = [(t[lo:hi], truth[lo:hi]) for lo, hi in pairwise(offsets)]
        mechanism = Fixed(d_sigma=_MODEL_SIGMA_M - RAW_SIGMA_M, law=law)
        sensed = made.sensed(walked, ("model", "errors"), law=law)
        release = mechanism.share(sensed, draws("share", "model"))
        rng = draws("model", "genie")
        errors = errors_of(release=release, sensed=sensed, mechanism=mechanism, rng=rng)
        assert errors is not None
        expected = known_share(
            t=t, offsets=offsets, errors=errors, motion=motion, epsilon_m=EPSILON_M
        )
        return (
            replace(like, release=release, truth=truth, mechanism=mechanism),
            expected,
        )

    def null(self) -> ReconstructionCase:
        """Return walks with a truth that has nothing to do with them."""
        case = self.noisy(BOX_M, "isotropic")
        truth = draws("unrelated", "truth").uniform(
            -BOX_M / 2, BOX_M / 2, case.truth.shape
        )
        about = f"{N_TRACKS} tracks of positions that have nothing to do with the truth"
        return replace(case, about=about, truth=truth)

    def odd(self) -> Iterator[ReconstructionCase]:
        """Yield walks of one to three samples, and such with odd steps."""
        for sizes in ((1,), (1, 2, 30, 1, 2, 3), (2,)):
            about = f"tracks of {', '.join(map(str, sizes))} samples"
            yield made_up("short", about=about, sizes=sizes)
        about = "8 walks with steps from 1 ms to 30 s"
        yield made_up(
            "irregular", about=about, sizes=(60,) * 8, steps_s=made.IRREGULAR_S
        )


@cache
def made_up(
    name: str,
    *,
    about: str,
    sizes: tuple[int, ...],
    sigma_m: float = 0.3,
    law: ErrorLaw = "radial",
    steps_s: tuple[float, float] = made.STEADY_S,
) -> ReconstructionCase:
    """Return walks of people, of which all but the size of errors is that of `name` and `sizes`."""
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)
    mine = made.walks(name, "walks", sizes=sizes, steps_s=steps_s)
    others = made.walks(name, "others", sizes=range(40, 88, 4), steps_s=steps_s)
    truth, others_truth = (
        np.concatenate([xy for _, xy in some]) for some in (mine, others)
    )

    def share(walked: list[made.Walk], *words: str | int) -> Release:
        return made.shared(walked, (name, *words), mechanism=mechanism)

    release, beside = share(mine, "release"), share(mine, "beside")
    first, names = release.offsets[:-1], release.pseudonym
    return ReconstructionCase(
        about=about,
        release=release,
        truth=truth,
        mechanism=mechanism,
        train=TrainingSet(share(others, "train"), others_truth),
        repeats=tuple(share(mine, "repeat", row) for row in range(2)),
        anchor=Release(
            release.t[first], truth[first], None, np.arange(len(names) + 1), names
        ),
        companions=(replace(beside, xy=beside.xy + 1.0),),
    )


@dataclass(frozen=True, eq=False, slots=True)
class LinkageCase(made.Case):
    """P probes, G gallery tracks, and everything that an adversary may know besides.

    Where the scene is hidden, every walk comes in a frame and on a clock of its own, in
    two recordings. Where it is shown, all is in one, and the gallery goes on after
    `GAP_S` of silence, or, for a linker of one stretch of a walk, shows the same steps
    at other instants.
    """

    asked: ClassVar[tuple[str, ...]] = ("probe", "gallery")
    compared: ClassVar[str] = "scores"
    unit: ClassVar[str] = " of their spread"
    hit: ClassVar[str] = "mates come first"
    chance: ClassVar[float] = 1 / N_TRACKS
    easy_share: ClassVar[float] = (
        1 / 4
    )  # Chance alone brings 6 of 24 once in 1000 at most.
    easy_hint: ClassVar[str] = "is the sign right? a higher score means the same person"
    levels_m: ClassVar[tuple[float, ...]] = (0.1, 10.0)
    """Averaged over 128 samples, 10 m come to 0.9 m: of a walk of some 15 m little is left."""
    achieved: ClassVar[str] = (
        "the mean logarithm of candidates over the rank of the mate"
    )

    probe: Release
    gallery: Release
    mate: Ints  # (P,) gallery track of the same person, or -1. No attack is given it.
    mechanism: Fixed
    train: LinkageTrainingSet
    scene: bool  # Whether the true frame and clock are shown.
    # Whether the gallery then shows the same steps as the probes.
    same_steps: bool = False

    @property
    def everything(self) -> frozenset[Knowledge]:  # type: ignore[override]  # a class variable elsewhere
        """All that there is to grant: the repeats of a walk would be linked already."""
        return (
            frozenset(Knowledge)
            - OF_WALKS
            - ({Knowledge.SCENE} if not self.scene else set())
        )

    @property
    def shown(self) -> dict[str, bool]:
        """How other people are to be shown alike."""
        return {"scene": self.scene, "same_steps": self.same_steps}

    def fault(self, result: object) -> str:
        if isinstance(result, np.ndarray) and result.dtype.kind == "f":
            return ""
        of = f" of {result.dtype}" if isinstance(result, np.ndarray) else ""
        return f"expected a numpy array of floats, got {type(result).__name__}{of}"

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return scores as an array of floats; ValueError if they are not finite real numbers."""
        scores, expected = np.asarray(result), (len(self.probe), len(self.gallery))
        if scores.dtype.kind not in "fiub":
            got = f"{type(result).__name__} of {scores.dtype}"
            raise ValueError(
                f"expected real numbers of shape (P, G) = {expected}, got {got}"
            )
        if scores.shape != expected:
            turned = " (turned round?)" if scores.shape == expected[::-1] else ""
            rows = f"a row for every probe, a column for every gallery track{turned}"
            found = f"scores of shape {scores.shape}, expected (P, G) = {expected}"
            raise ValueError(f"{found}: {rows}")
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
        each = zip(scores[:, None], self.mate[:, None], strict=True)
        return np.concatenate([rank1(scores=row, mate=mate) for row, mate in each])

    def success(self, scores: Floats) -> Floats:
        """Return the logarithm of candidates over the mate's rank, (P,)."""
        return log_rank(scores=scores, mate=self.mate)

    def reordered(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the ordinary case with its tracks in another order, and how scores follow."""
        rows, columns = (5, 2, 0, 3, 6, 1, 4), (4, 8, 0, 6, 2, 7, 1, 5, 3)
        changed = replace(
            self, probe=self.probe.tracks(rows), gallery=self.gallery.tracks(columns)
        )
        return changed, lambda scores: scores[np.ix_(rows, columns)]

    def in_other_frames(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the case with every walk of all four releases in yet another frame and clock."""
        rng = draws("linkage", "other frames")
        changed = made.of_each(
            self, lambda one: made.moved(one, made.frames(rng, len(one)))
        )
        return changed, lambda scores: scores

    @staticmethod
    def ordinary_and_another(
        granted: frozenset[Knowledge], *, same_steps: bool = False
    ) -> tuple[LinkageCase, LinkageCase]:
        """Return a small case as most are, with P < G, and one of others under its pseudonyms."""
        sizes, about = (PEOPLE[:7], PEOPLE[:9], OTHERS), "P = 7, G = 9, noise of 0.3 m"
        shown: dict[str, bool] = {
            "scene": Knowledge.SCENE in granted,
            "same_steps": same_steps,
        }
        case = people_made_up("ordinary", about=about, sizes=sizes, **shown)
        other = people_made_up(
            "another", about=f"{about}, of others", sizes=sizes, **shown
        )
        probe = replace(other.probe, pseudonym=case.probe.pseudonym)
        gallery = replace(other.gallery, pseudonym=case.gallery.pseudonym)
        return case, replace(other, probe=probe, gallery=gallery, train=case.train)

    def noisy(self, sigma_m: float, law: ErrorLaw) -> LinkageCase:
        """Return the same 24 people against each other, with the same errors times `sigma_m`."""
        about = f"{N_TRACKS} people, {law} noise of {sigma_m:g} m"
        return people_made_up(
            "noisy", about=about, sigma_m=sigma_m, law=law, **self.shown
        )

    def null(self) -> LinkageCase:
        """Return probes of people who are not in the gallery, with mates drawn one by one."""
        strangers = people_made_up(
            "strangers", about="", sigma_m=RAW_SIGMA_M, **self.shown
        )
        return replace(
            self.noisy(RAW_SIGMA_M, "radial"),
            about=(
                f"{N_TRACKS} probes of people who are not among the {N_TRACKS} of the"
                " gallery"
            ),
            gallery=strangers.gallery,
            mate=draws("linkage", "strangers", "mate").integers(0, N_TRACKS, N_TRACKS),
        )

    def odd(self) -> Iterator[LinkageCase]:
        """Yield one probe or candidate, tracks of one to three samples, and odd steps."""
        for sizes in ODD:
            probes, candidates, _ = (", ".join(map(str, of_side)) for of_side in sizes)
            about = f"probes of {probes} samples against {candidates}"
            yield people_made_up("short", about=about, sizes=sizes, **self.shown)
        sizes, about = ((60,) * 6, (60,) * 8, (60,) * 12), "steps from 1 ms to 30 s"
        steps_s = made.IRREGULAR_S
        yield people_made_up(
            "irregular", about=about, sizes=sizes, steps_s=steps_s, **self.shown
        )


@cache
def people_made_up(
    name: str,
    *,
    about: str,
    sizes: tuple[tuple[int, ...], ...] = (PEOPLE, PEOPLE, OTHERS),
    sigma_m: float = 0.3,
    scene: bool,
    same_steps: bool = False,
    law: ErrorLaw = "radial",
    steps_s: tuple[float, float] = made.STEADY_S,
) -> LinkageCase:
    """Return people who differ in speed, in how evenly they walk and in how they turn.

    All but the size of the errors depends on `name` and `sizes` alone: the samples of
    each track of probe and gallery, the same people, and of either release of the
    training set.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)

    def release(
        name: tuple[str, ...], who: list[made.Person], sizes: tuple[int, ...]
    ) -> Release:
        walks = []
        for row, size in enumerate(sizes):
            elapsed = made.instants(draws(*name, row), size, steps_s)
            is_later = scene and not same_steps and name[-1] == "gallery"
            t = GAP_S + elapsed if is_later else elapsed - elapsed[-1]
            walks.append((t, who[row](t)))
        # One motion for all that is in one frame, or one for every walk.
        rng = draws(*(name[:-1] if scene else name), "frames")
        frames = made.frames(rng, 1 if scene else len(walks))
        return made.moved(made.shared(walks, name, mechanism=mechanism), frames)

    def pair(who: str, *sizes: tuple[int, ...]) -> LinkageTrainingSet:
        name_of = ("linkage", name, who)
        rng = draws(*name_of, "people")
        speeds = rng.permutation(np.linspace(*made.SPEEDS_MPS, max(map(len, sizes))))
        people = [made.person(float(speed_mps), rng) for speed_mps in speeds]
        probe = release((*name_of, "probe"), people, sizes[0])
        gallery = release((*name_of, "gallery"), people, sizes[1])
        # In an order of its own, lest a place in the list tell who is who.
        order = draws(*name_of, "order").permutation(len(gallery))
        mate = np.concatenate([np.argsort(order), np.full(len(probe), -1)])[
            : len(probe)
        ]
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
        same_steps=same_steps,
    )
