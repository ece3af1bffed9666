"""Made-up walks as a reconstruction attack gets them, and what its answers come to."""

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
from isac_track.model_world import Motion, errors_of, known_share, simulated
from isac_track.privacy import exposure, leakage_indicator
from isac_track.protocols import TrainingSet
from isac_track.sharing import Fixed
from isac_track.types import Bools, ErrorLaw, Floats, Knowledge, Reconstruction, Release, stretches

N_TRACKS = 24
_MODEL_SIGMA_M = 0.7
EXTENTS, EXTRA_M = 3.0, 10.0
"""How far an answer may lie from the middle of its track: 3 times its extent and 10 m."""


@dataclass(frozen=True, eq=False, slots=True)
class ReconstructionCase(made.Case):
    """One release with M samples, and everything that an adversary may know besides."""

    asked: ClassVar[tuple[str, ...]] = ("release",)  # What the function from `fit` is called with.
    compared: ClassVar[str] = "positions or std"
    unit: ClassVar[str] = " m"
    framed: ClassVar[str] = "the release, the training set and each repeat"
    hit: ClassVar[str] = "samples leak"
    chance: ClassVar[float] = np.pi * EPSILON_M**2 / BOX_M**2
    """Whatever is said of a position drawn uniformly in the square, so probably it is within
    epsilon at most."""
    easy_share: ClassVar[float] = 0.5  # The shared positions themselves come to 1.0 there.
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
        """Return what is wrong with a result that can be read all the same; empty if nothing."""
        if isinstance(result, Reconstruction):
            return ""
        return "expected a Reconstruction, got ndarray; wrap the positions: Reconstruction(xy)"

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return positions and std, if claimed, (M, 2 or 3) m; ValueError if it is neither.

        Positions alone will do: the check of the type is another one.
        """
        found = Reconstruction(result) if isinstance(result, np.ndarray) else result
        if not isinstance(found, Reconstruction):
            raise ValueError(f"expected a Reconstruction, got {type(result).__name__}")  # noqa: TRY004 - of a stranger's
        if found.xy.shape != self.release.xy.shape:
            wanted = f"expected {self.release.xy.shape}: one for every sample of the release"
            raise ValueError(f"positions of shape {found.xy.shape}, {wanted}, in its order")
        return found.xy if found.std is None else np.column_stack([found.xy, found.std])

    def hits(self, answer: Floats) -> Bools:
        """Return which samples leak, (M,)."""
        return leakage_indicator(shared_xy=answer[:, :2], true_xy=self.truth, epsilon_m=EPSILON_M)

    def success(self, answer: Floats) -> Floats:
        """Return the PLR of each track, (N,)."""
        leaked, release = self.hits(answer), self.release
        return exposure(leaked=leaked, t=release.t, offsets=release.offsets).plr

    def out_of_bounds(self, answer: Floats) -> str:
        """Return what is wrong with an answer that flies off; empty if nothing."""
        first, sizes = self.release.offsets[:-1], np.diff(self.release.offsets)
        low, high = (each.reduceat(self.release.xy, first) for each in (np.minimum, np.maximum))
        middle = np.repeat((low + high) / 2, sizes, axis=0)
        away_m = np.maximum.reduceat(np.hypot(*(answer[:, :2] - middle).T), first)
        limit_m = EXTENTS * np.hypot(*(high - low).T) + EXTRA_M
        if (away_m <= limit_m).all():
            return ""
        worst = int(np.argmax(away_m / limit_m))
        room = f"{limit_m[worst]:.0f} m ({EXTENTS:g} times its extent and {EXTRA_M:g} m)"
        away = f"{away_m[worst]:.0f} m from the middle of track {worst}"
        return f"an answer lies {away}, expected at most {room}"

    def reordered(self) -> tuple[ReconstructionCase, Callable[[Floats], Floats]]:
        """Return the ordinary case with its tracks in another order, and how an answer follows."""
        rows, offsets = np.array([5, 2, 7, 0, 3, 6, 1, 4]), self.release.offsets
        samples, _ = stretches(offsets[rows], np.diff(offsets)[rows])
        others = self.train.release
        changed = made.of_each(self, lambda one: one if one is others else one.tracks(rows))
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
        _granted: frozenset[Knowledge],
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
        motion, start = Motion(Q_M2_PER_S3, Q_M2_PER_S3, 1.0), np.zeros((N_TRACKS, 2))
        rng = draws("model", "walks")
        truth = simulated(t=t, offsets=offsets, start=start, motion=motion, rng=rng)
        walked = [(t[lo:hi], truth[lo:hi]) for lo, hi in pairwise(offsets)]
        mechanism = Fixed(d_sigma=_MODEL_SIGMA_M - RAW_SIGMA_M, law=law)
        sensed = made.sensed(walked, ("model", "errors"), law=law)
        release = mechanism.share(sensed, draws("share", "model"))
        errors = errors_of(
            release=release, sensed=sensed, mechanism=mechanism, rng=draws("model", "genie")
        )
        assert errors is not None
        known = {"q": motion.q, "speed_mps": motion.speed_mps, "epsilon_m": EPSILON_M}
        expected = known_share(t=t, offsets=offsets, errors=errors, **known)
        return replace(like, release=release, truth=truth, mechanism=mechanism), expected

    def null(self) -> ReconstructionCase:
        """Return walks with a truth that has nothing to do with them."""
        case = self.noisy(BOX_M, "isotropic")
        truth = draws("unrelated", "truth").uniform(-BOX_M / 2, BOX_M / 2, case.truth.shape)
        about = f"{N_TRACKS} tracks of positions that have nothing to do with the truth"
        return replace(case, about=about, truth=truth)

    def odd(self) -> Iterator[ReconstructionCase]:
        """Yield walks of one to three samples, and such with odd steps."""
        for sizes in ((1,), (1, 2, 30, 1, 2, 3), (2,)):
            about = f"tracks of {', '.join(map(str, sizes))} samples"
            yield made_up("short", about=about, sizes=sizes)
        about = "8 walks with steps from 1 ms to 30 s"
        yield made_up("irregular", about=about, sizes=(60,) * 8, steps_s=made.IRREGULAR_S)


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
    """Return walks of people, shared with errors of standard deviation `sigma_m`.

    All but the size of the errors depends on `name` and `sizes` (samples of each track) alone.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)
    mine, others = (
        made.walks(name, who, sizes=some, steps_s=steps_s)
        for who, some in (("walks", sizes), ("others", range(40, 88, 4)))
    )
    truth, others_truth = (np.concatenate([xy for _, xy in some]) for some in (mine, others))

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
        anchor=Release(release.t[first], truth[first], None, np.arange(len(names) + 1), names),
        companions=(replace(beside, xy=beside.xy + 1.0),),
    )
