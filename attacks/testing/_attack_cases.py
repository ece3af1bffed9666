"""Cases of attacks with made-up people, and the success of answers and scores."""

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
from isac_track.model_world import Motion, known_share, release_errors, simulate_walks
from isac_track.privacy import exposure, leakage_indicator
from isac_track.protocols import WALK_KNOWLEDGE, LinkageTrainingSet, TrainingSet
from isac_track.sharing import Fixed
from isac_track.types import (
    Bools,
    ErrorLaw,
    Floats,
    Ints,
    Knowledge,
    Reconstruction,
    Release,
    lengths,
)

N_TRACKS = 24  # And as many people.
_MODEL_SIGMA_M = 0.7
EXTENTS, EXTRA_M = 3.0, 10.0  # How far an answer may lie from the middle of its track.
GAP_S = 1.0  # Silence before the gallery goes on, where the scene is shown.
PEOPLE, OTHERS = (128,) * N_TRACKS, (128,) * 20  # Samples of each: 12 s at 8 to 16 Hz.
# Samples of probes, of the gallery and of the training set.
ODD: tuple[tuple[tuple[int, ...], ...], ...] = (
    ((128,), (128,), OTHERS),
    ((128,) * 4, (128,), OTHERS),
    ((128,), (128,) * 4, OTHERS),
    ((1, 1, 1), (1, 1, 1, 1), (40,) * 8),
    ((1, 2, 3, 128), (3, 2, 128, 1, 2), (40,) * 8),
    ((128, 128, 2), (128, 3, 1, 128), (1, 2, 3, 1, 2, 3, 40, 40, 40, 40)),
)


@dataclass(frozen=True, eq=False, slots=True)
class ReconstructionCase(made.Case):
    """A release with M samples, and all knowledge that an adversary may have."""

    # Arguments of the function from `fit`.
    asked: ClassVar[tuple[str, ...]] = ("release",)
    compared: ClassVar[str] = "positions or std"
    unit: ClassVar[str] = " m"
    hit: ClassVar[str] = "samples leak"
    # Of a truth drawn in the square.
    chance: ClassVar[float] = np.pi * EPSILON_M**2 / BOX_M**2
    # The shared positions themselves have a share of 1.0.
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
        if isinstance(result, Reconstruction):
            return ""
        return (
            "expected a Reconstruction, got ndarray; wrap the positions:"
            " Reconstruction(xy)"
        )

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return positions and std, if claimed, (M, 2 or 3) m; or ValueError."""
        reconstruction = (
            Reconstruction(result) if isinstance(result, np.ndarray) else result
        )
        if not isinstance(reconstruction, Reconstruction):
            raise ValueError(f"expected a Reconstruction, got {type(result).__name__}")  # noqa: TRY004 - of a stranger's
        if reconstruction.xy.shape != self.release.xy.shape:
            wanted = (
                f"expected {self.release.xy.shape}: one for every sample of the release"
            )
            raise ValueError(
                f"positions of shape {reconstruction.xy.shape}, {wanted}, in its order"
            )
        if reconstruction.std is None:
            return reconstruction.xy
        return np.column_stack([reconstruction.xy, reconstruction.std])

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
        low = np.minimum.reduceat(self.release.xy, first)
        high = np.maximum.reduceat(self.release.xy, first)
        middle = np.repeat((low + high) / 2, sizes, axis=0)
        away_m = np.maximum.reduceat(lengths(answer[:, :2] - middle), first)
        limit_m = EXTENTS * lengths(high - low) + EXTRA_M
        if (away_m <= limit_m).all():
            return ""
        worst = int(np.argmax(away_m / limit_m))
        room = (
            f"{limit_m[worst]:.0f} m ({EXTENTS:g} times its extent and {EXTRA_M:g} m)"
        )
        away = f"{away_m[worst]:.0f} m from the middle of track {worst}"
        return f"an answer lies {away}, expected at most {room}"

    def reordered(self) -> tuple[ReconstructionCase, Callable[[Floats], Floats]]:
        """Return the case with its tracks in another order, and the map of answers."""
        rows, others = np.array([5, 2, 7, 0, 3, 6, 1, 4]), self.train.release
        place = np.repeat(np.argsort(rows), np.diff(self.release.offsets))
        samples = np.argsort(place, kind="stable")
        changed = made.map_releases(
            self,
            lambda release: release if release is others else release.tracks(rows),
        )
        return changed, lambda answer: answer[samples]

    def in_other_frames(self) -> tuple[ReconstructionCase, Callable[[Floats], Floats]]:
        """Return the case with releases in other frames, and the map of answers."""
        own_frame, train_frame, *repeats = made.frames(draws("frames"), 4)
        # The anchor and the companions have the frame of the release.
        frames = [own_frame, train_frame, *repeats, own_frame, own_frame]
        changed = made.map_releases(
            self, lambda release: made.moved(release, frames.pop(0))
        )
        train = replace(changed.train, truth=made.turned(self.train.truth, train_frame))
        return replace(changed, train=train), lambda answer: np.hstack(
            [made.turned(answer[:, :2], own_frame), answer[:, 2:]]
        )

    @staticmethod
    def ordinary_and_another(
        _granted: object, **_shown: bool
    ) -> tuple[ReconstructionCase, ReconstructionCase]:
        """Return a small ordinary case, and another release of its walks."""
        sizes = tuple(20 + 4 * row for row in range(8))
        case = made_up("ordinary", about="8 walks, noise of 0.3 m", sizes=sizes)
        other = replace(case.repeats[0], pseudonym=case.release.pseudonym)
        return case, replace(case, release=other)

    def noisy(self, sigma_m: float, law: ErrorLaw) -> ReconstructionCase:
        """Return 24 walks of 60 to 198 samples, with errors scaled by `sigma_m`."""
        sizes = tuple(60 + 6 * row for row in range(N_TRACKS))
        about = f"{N_TRACKS} walks, {law} noise of {sigma_m:g} m"
        return made_up("noisy", about=about, sizes=sizes, sigma_m=sigma_m, law=law)

    # Made-up walks, the same for every attack; for the process.
    @staticmethod
    @cache
    def modelled(law: ErrorLaw) -> tuple[ReconstructionCase, Floats]:
        """Return walks of a model behind 0.7 m of noise, and a genie's PLR, (N,)."""
        about = f"{N_TRACKS} walks of a model, {law} noise"
        template = made_up("model", about=about, sizes=(150,) * N_TRACKS, law=law)
        t, offsets = template.release.t, template.release.offsets
        motion, rng = Motion(Q_M2_PER_S3, 1.0), draws("model", "walks")
        start = np.zeros((N_TRACKS, 2))
        truth = simulate_walks(
            t=t, offsets=offsets, start=start, motion=motion, rng=rng
        )
        walked = [(t[lo:hi], truth[lo:hi]) for lo, hi in pairwise(offsets)]
        mechanism = Fixed(d_sigma=_MODEL_SIGMA_M - RAW_SIGMA_M, law=law)
        sensed = made.sensed(walked, ("model", "errors"), law=law)
        release = mechanism.share(sensed, draws("share", "model"))
        rng = draws("model", "genie")
        errors = release_errors(
            release=release, sensed=sensed, mechanism=mechanism, rng=rng
        )
        assert errors is not None
        expected = known_share(
            t=t, offsets=offsets, errors=errors, motion=motion, epsilon_m=EPSILON_M
        )
        return (
            replace(template, release=release, truth=truth, mechanism=mechanism),
            expected,
        )

    def null(self) -> ReconstructionCase:
        """Return walks with an unrelated truth."""
        case = self.noisy(BOX_M, "isotropic")
        truth = draws("unrelated", "truth").uniform(
            -BOX_M / 2, BOX_M / 2, case.truth.shape
        )
        about = f"{N_TRACKS} tracks of positions that have nothing to do with the truth"
        return replace(case, about=about, truth=truth)

    def odd(self) -> Iterator[ReconstructionCase]:
        """Yield walks of one to three samples, and walks with odd steps."""
        for sizes in ((1,), (1, 2, 30, 1, 2, 3), (2,)):
            about = f"tracks of {', '.join(map(str, sizes))} samples"
            yield made_up("short", about=about, sizes=sizes)
        about = "8 walks with steps from 1 ms to 30 s"
        yield made_up(
            "irregular", about=about, sizes=(60,) * 8, steps_s=made.IRREGULAR_S
        )


# As above.
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
    """Return a case whose draws depend on `name` and `sizes` alone.

    `sigma_m` scales the errors, `law` is their law.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)
    own_walks = made.walks(name, "walks", sizes=sizes, steps_s=steps_s)
    other_walks = made.walks(name, "others", sizes=range(40, 88, 4), steps_s=steps_s)
    truth = np.concatenate([xy for _, xy in own_walks])
    others_truth = np.concatenate([xy for _, xy in other_walks])

    def share(walked: list[made.Walk], *words: str | int) -> Release:
        return made.shared(walked, (name, *words), mechanism=mechanism)

    release, beside = share(own_walks, "release"), share(own_walks, "beside")
    first, names = release.offsets[:-1], release.pseudonym
    return ReconstructionCase(
        about=about,
        release=release,
        truth=truth,
        mechanism=mechanism,
        train=TrainingSet(share(other_walks, "train"), others_truth),
        repeats=tuple(share(own_walks, "repeat", row) for row in range(2)),
        anchor=Release(
            release.t[first], truth[first], None, np.arange(len(names) + 1), names
        ),
        companions=(replace(beside, xy=beside.xy + 1.0),),
    )


@dataclass(frozen=True, eq=False, slots=True)
class LinkageCase(made.Case):
    """P probes, G gallery tracks, and all knowledge that an adversary may have.

    If the scene is hidden, every walk comes in a frame and on a clock of its own. If it
    is shown, all walks are in one frame, and the gallery goes on after `GAP_S` of
    silence. For a linker of one stretch of a walk it shows the same steps instead, at
    other instants.
    """

    asked: ClassVar[tuple[str, ...]] = ("probe", "gallery")
    compared: ClassVar[str] = "scores"
    unit: ClassVar[str] = " of their spread"
    hit: ClassVar[str] = "mates come first"
    chance: ClassVar[float] = 1 / N_TRACKS
    # By chance alone, 6 of 24 happen once in 1000 at most.
    easy_share: ClassVar[float] = 1 / 4
    easy_hint: ClassVar[str] = "is the sign right? a higher score means the same person"
    levels_m: ClassVar[tuple[float, ...]] = (0.1, 10.0)
    """Averaged over 128 samples, 10 m become 0.9 m, which hides most of a walk."""
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
    def everything(self) -> frozenset[Knowledge]:
        """All knowledge that can be granted: repeats of a walk are linked already."""
        everything = frozenset(Knowledge) - WALK_KNOWLEDGE
        return everything if self.scene else everything - {Knowledge.SCENE}

    @property
    def shown(self) -> dict[str, bool]:
        """The parameters by which other people are shown in the same way."""
        return {"scene": self.scene, "same_steps": self.same_steps}

    def fault(self, result: object) -> str:
        if isinstance(result, np.ndarray) and result.dtype.kind == "f":
            return ""
        got = type(result).__name__
        if isinstance(result, np.ndarray):
            got += f" of {result.dtype}"
        return f"expected a numpy array of floats, got {got}"

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return scores as floats; ValueError if they are not finite real numbers."""
        scores, expected = np.asarray(result), (len(self.probe), len(self.gallery))
        if scores.dtype.kind not in "fiub":
            got = f"{type(result).__name__} of {scores.dtype}"
            raise ValueError(
                f"expected real numbers of shape (P, G) = {expected}, got {got}"
            )
        if scores.shape != expected:
            turned = " (turned round?)" if scores.shape == expected[::-1] else ""
            rows = f"a row for every probe, a column for every gallery track{turned}"
            actual = f"scores of shape {scores.shape}, expected (P, G) = {expected}"
            raise ValueError(f"{actual}: {rows}")
        if lost := np.count_nonzero(~np.isfinite(scores)):
            hint = "who cannot tell gives all candidates the same score"
            raise ValueError(f"{lost} of {scores.size} scores are not finite; {hint}")
        return scores.astype(np.float64)

    def gaps(self, first: Floats, second: Floats) -> Floats:
        """Return the distances of scores, (1, P G), in units of their spread."""
        # If all scores are equal they have no spread; their size replaces it.
        spread = float(np.ptp(second)) or float(np.abs(second).max()) or 1.0
        return (np.abs(first - second) / spread).reshape(1, -1)

    def hits(self, scores: Floats) -> Floats:
        """Return the share of tie orders in which the mate comes first, (P,)."""
        # Probe by probe, since two may have drawn the same mate.
        probes = zip(scores[:, None], self.mate[:, None], strict=True)
        return np.concatenate([rank1(scores=row, mate=mate) for row, mate in probes])

    def success(self, scores: Floats) -> Floats:
        """Return the logarithm of candidates over the mate's rank, (P,)."""
        return log_rank(scores=scores, mate=self.mate)

    def reordered(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the case with its tracks in another order, and the map of scores."""
        rows, columns = (5, 2, 0, 3, 6, 1, 4), (4, 8, 0, 6, 2, 7, 1, 5, 3)
        changed = replace(
            self, probe=self.probe.tracks(rows), gallery=self.gallery.tracks(columns)
        )
        return changed, lambda scores: scores[np.ix_(rows, columns)]

    def in_other_frames(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the case with every walk in another frame and on another clock."""
        rng = draws("linkage", "other frames")
        changed = made.map_releases(
            self, lambda release: made.moved(release, made.frames(rng, len(release)))
        )
        return changed, lambda scores: scores

    @staticmethod
    def ordinary_and_another(
        granted: frozenset[Knowledge], *, same_steps: bool = False
    ) -> tuple[LinkageCase, LinkageCase]:
        """Return a small ordinary case, P < G, and others under the same pseudonyms."""
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
        """Return the same 24 people, with the same errors times `sigma_m`."""
        about = f"{N_TRACKS} people, {law} noise of {sigma_m:g} m"
        return people_made_up(
            "noisy", about=about, sigma_m=sigma_m, law=law, **self.shown
        )

    def null(self) -> LinkageCase:
        """Return probes of people outside the gallery, with mates drawn at random."""
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
        """Yield lone probes or candidates, tracks of 1 to 3 samples, and odd steps."""
        for sizes in ODD:
            probes = ", ".join(map(str, sizes[0]))
            candidates = ", ".join(map(str, sizes[1]))
            about = f"probes of {probes} samples against {candidates}"
            yield people_made_up("short", about=about, sizes=sizes, **self.shown)
        sizes, about = ((60,) * 6, (60,) * 8, (60,) * 12), "steps from 1 ms to 30 s"
        steps_s = made.IRREGULAR_S
        yield people_made_up(
            "irregular", about=about, sizes=sizes, steps_s=steps_s, **self.shown
        )


# As above.
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
    """Return people who differ in mean speed, changes of speed, and turning.

    All draws depend on `name` and `sizes` alone, the size of the errors on `sigma_m`.
    `sizes` are the samples of each track of probe, of gallery (the same people), and of
    either release of the training set.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)

    def release(
        name: tuple[str, ...], people: list[made.Person], sizes: tuple[int, ...]
    ) -> Release:
        walks = []
        for row, size in enumerate(sizes):
            elapsed = made.instants(draws(*name, row), size, steps_s)
            is_later = scene and not same_steps and name[-1] == "gallery"
            t = GAP_S + elapsed if is_later else elapsed - elapsed[-1]
            walks.append((t, people[row](t)))
        # A single motion if all walks are in one frame, or else a motion per walk.
        rng = draws(*(name[:-1] if scene else name), "frames")
        frames = made.frames(rng, 1 if scene else len(walks))
        return made.moved(made.shared(walks, name, mechanism=mechanism), frames)

    def pair(role: str, *sizes: tuple[int, ...]) -> LinkageTrainingSet:
        stream_name = ("linkage", name, role)
        rng = draws(*stream_name, "people")
        speeds = rng.permutation(np.linspace(*made.SPEEDS_MPS, max(map(len, sizes))))
        people = [made.person(float(speed_mps), rng) for speed_mps in speeds]
        probe = release((*stream_name, "probe"), people, sizes[0])
        gallery = release((*stream_name, "gallery"), people, sizes[1])
        # In an order of its own, so that a place in the list gives no mate away.
        order = draws(*stream_name, "order").permutation(len(gallery))
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
