"""What a plug-in must offer: a frozen dataclass of its parameters plus one method.

The threat model is here as well: which adversary is granted which knowledge, and the
context that hands an attack what it was granted and nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.random import Generator

from isac_track.errors import KnowledgeDenied
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Knowledge,
    Prediction,
    Reconstruction,
    Release,
    Sensed,
    read_only,
)

if TYPE_CHECKING:
    from isac_track.policies.query import Form, Query

Reconstructor: TypeAlias = "Callable[[Release], Reconstruction]"
"""What turns a release into a reconstruction, sample for sample."""
# Scores (P, G), higher = same person.
Linker: TypeAlias = "Callable[[Release, Release], Floats]"
_INFORMED = frozenset({Knowledge.MECHANISM, Knowledge.TRAIN})
ADVERSARIES: dict[str, frozenset[Knowledge]] = {
    "blind": frozenset(),
    "informed": _INFORMED,
    # Robots that put together what each was sent lay it upon each other in one frame.
    "repeats": _INFORMED | {Knowledge.REPEATS, Knowledge.SCENE},
    "anchor": _INFORMED | {Knowledge.ANCHOR},
    "companions": _INFORMED | {Knowledge.COMPANIONS},
    "insider": _INFORMED | {Knowledge.SCENE},
    "oracle": frozenset(Knowledge),
}
"""Weakest first. The oracle is a reference, never the headline; see docs/threat-model.md."""
OF_WALKS = frozenset({Knowledge.REPEATS, Knowledge.ANCHOR, Knowledge.COMPANIONS})
"""What tells whose walk a release is, so that nobody who links is granted it."""
USUAL: tuple[str, ...] = (
    "blind",
    "informed",
    "oracle",
)  # Of every run; the others are asked for.


@runtime_checkable
class Mechanism(Protocol):
    """Turns what was sensed into what is shared.

    A class attribute ``sweep = "log"`` or ``"linear"`` says how
    ``name:LOW..HIGH/COUNT`` spaces the first field; ``protects = False`` that it claims
    no protection, so that no level of it is ever proposed to a site (without it a
    mechanism does claim that).
    """

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the release; `rng` starts alike for every mechanism (common random numbers)."""


@runtime_checkable
class Predictor(Protocol):
    """The robot's forecast of where each pedestrian will be.

    One that is aware has a method ``knowing(mechanism)``, which returns the predictor
    as it is where that mechanism shares; it is called before `predict`. One that has a
    method ``track(release)`` returns its causal estimate of every sample, (M, 2) m, for
    `plr_robot`.
    """

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that it cannot run without; a robot has no SIGMA unless this asks for it."""

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return positions of the N tracks at `t_future`, (N, H) s on each track's clock."""


def knowing(predictor: Predictor, mechanism: Mechanism) -> Any:  # noqa: ANN401 - another predictor
    """Return a predictor as it is where a mechanism shares: one that is aware knows it."""
    told = getattr(predictor, "knowing", None)
    return predictor if told is None else told(mechanism)


@runtime_checkable
class Policy(Protocol):
    """Decides what the answer to a robot's query discloses.

    A class attribute ``protects = False`` says that it claims no protection;
    ``forecasts = True`` that it decides by the network's forecast, which a robot may
    share.
    """

    @property
    def form(self) -> Form:
        """What is sent: ``samples``, or in their place a ``state`` or a ``flag``."""

    def select(self, query: Query) -> Bools:
        """Return which samples of the query are sent, (M,)."""


class Adversary(Protocol):
    """Who says which knowledge it needs and which it takes."""

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that it cannot run without."""

    @property
    def uses(self) -> frozenset[Knowledge]:
        """Knowledge that it takes if granted."""


@runtime_checkable
class ReconstructionAttack(Adversary, Protocol):
    """An adversary who estimates where people truly were from what was shared.

    A class attribute ``slow = True`` keeps an attack out of the presets and runs it on
    one release of each source track; ``seconds_per_sample`` then says what it costs.
    """

    def fit(self, context: AttackContext) -> Callable[[Release], Reconstruction]:
        """Return what turns a release into a reconstruction, sample for sample."""


@runtime_checkable
class LinkageAttack(Adversary, Protocol):
    """An adversary who tells which releases of two sessions are of one person.

    A class attribute ``kind = "linkage"`` tells it from a reconstruction attack
    (`kind_of`); ``one_stretch = True`` that it links the same steps, and nothing where
    a task has none; ``across_gap = True`` that it bridges a silence within one walk.
    What it scores may be a whole search, or with `linkage.candidates=K` one probe and K
    candidates: the score of a pair should not depend on who else is there.
    """

    def fit(self, context: AttackContext) -> Callable[[Release, Release], Floats]:
        """Return what scores P probes against G gallery tracks: (P, G), higher = same person."""


def kind_of(attack: object) -> Literal["reconstruction", "linkage"]:
    """Return which of the two kinds an attack is.

    A class attribute ``kind`` says so (ValueError if it says anything else); without it
    the annotation of what ``fit`` returns does (two releases in: linkage), and without
    either it is a reconstruction attack.
    """
    said = getattr(attack, "kind", None)
    if said is None:
        annotations = getattr(getattr(type(attack), "fit", None), "__annotations__", {})
        releases = re.findall(r"\bRelease\b", str(annotations.get("return", "")))
        return "linkage" if len(releases) > 1 else "reconstruction"
    if said not in ("reconstruction", "linkage"):
        raise ValueError(f'kind must be "reconstruction" or "linkage", got {said!r}')
    return "linkage" if said == "linkage" else "reconstruction"


@dataclass(frozen=True, eq=False, slots=True, weakref_slot=True)
class TrainingSet:
    """A release of other people, perturbed by the same mechanism, and where they truly were."""

    release: Release
    truth: Floats  # (M, 2) m, in the frame of the release.

    def __post_init__(self) -> None:
        shape = self.release.xy.shape
        if self.truth.shape != shape:
            raise ValueError(f"truth must have shape {shape}, got {self.truth.shape}")
        object.__setattr__(self, "truth", read_only(self.truth))


@dataclass(frozen=True, eq=False, slots=True)
class LinkageTrainingSet:
    """Two releases of other people, perturbed by the same mechanism, and who is who in them."""

    probe: Release
    gallery: Release
    # (P,) track of the gallery that is the same person, or -1 if there is none.
    mate: Ints

    def __post_init__(self) -> None:
        mate = np.asarray(self.mate)
        if mate.shape != (len(self.probe),) or mate.dtype.kind not in "iu":
            raise ValueError(
                f"mate must hold {len(self.probe)} integers, got {mate.shape}"
            )
        if mate.size and not (mate.min() >= -1 and mate.max() < len(self.gallery)):
            raise ValueError(f"mate must lie within -1 and {len(self.gallery) - 1}")
        known = mate[mate >= 0]
        if np.unique(known).size < known.size:
            raise ValueError("two probes have one mate")
        object.__setattr__(self, "mate", read_only(mate.astype(np.int64, copy=False)))


class AttackContext:
    """What an attack is given to prepare with; it holds nothing that was not granted."""

    __slots__ = ("_held", "epsilon_m", "granted", "rng")

    def __init__(
        self,
        *,
        rng: Generator,
        epsilon_m: float,
        granted: frozenset[Knowledge] = frozenset(),
        mechanism: Mechanism | None = None,
        train: TrainingSet | LinkageTrainingSet | None = None,
        repeats: tuple[Release, ...] | None = None,
        anchor: Release | None = None,
        companions: tuple[Release, ...] | None = None,
    ) -> None:
        """Keep what was granted; ValueError if something is not there.

        `rng` is the attack's own stream, `epsilon_m` the distance below which a sample
        counts as leaked, m. SIGMA and SCENE show in the release itself: declared
        standard deviations, and the true frame and clock. The others are properties of
        the same names.
        """
        self.rng = rng
        self.epsilon_m = epsilon_m
        self.granted = granted
        offered: dict[Knowledge, Any] = {
            Knowledge.MECHANISM: mechanism,
            Knowledge.TRAIN: train,
            Knowledge.REPEATS: repeats,
            Knowledge.ANCHOR: anchor,
            Knowledge.COMPANIONS: companions,
        }
        self._held = {what: held for what, held in offered.items() if what in granted}
        missing = sorted(what.name for what, held in self._held.items() if held is None)
        if missing:
            raise ValueError(f"granted, but not given: {', '.join(missing)}")

    @property
    def mechanism(self) -> Any:  # noqa: ANN401 - whichever class the mechanism is
        """The frozen mechanism object with its parameters (Kerckhoffs)."""
        return self._get(Knowledge.MECHANISM)

    @property
    def train(self) -> Any:  # noqa: ANN401 - of one of two kinds
        """A `TrainingSet`, or a `LinkageTrainingSet` for a linkage attack."""
        return self._get(Knowledge.TRAIN)

    @property
    def repeats(self) -> tuple[Release, ...]:
        """Further releases of the same walks, sample by sample at the same instants."""
        repeats: tuple[Release, ...] = self._get(Knowledge.REPEATS)
        return repeats

    @property
    def anchor(self) -> Release:
        """One true position of each walk, in the frame and on the clock of the release."""
        anchor: Release = self._get(Knowledge.ANCHOR)
        return anchor

    @property
    def companions(self) -> tuple[Release, ...]:
        """Releases in the same frame: track i is of who walks along with track i, or one sample."""
        companions: tuple[Release, ...] = self._get(Knowledge.COMPANIONS)
        return companions

    def _get(self, what: Knowledge) -> Any:  # noqa: ANN401 - each kind has a type of its own
        if what not in self._held:
            raise KnowledgeDenied(
                f"{what.name} was not granted; an attack gets what its adversary knows"
                " and what it declares in `requires` or `uses`"
            )
        return self._held[what]


def grants(
    attack: Adversary,
    *,
    everyone: frozenset[Knowledge] = frozenset(),
    nobody: frozenset[Knowledge] = frozenset(),
    asked: tuple[str, ...] = (),
) -> dict[str, frozenset[Knowledge]]:
    """Return ``{adversary: what it is granted}`` of every row that an attack makes.

    An attack runs once for each adversary that grants all of its `requires`; of those
    that grant it the same, the weakest names the row. A task may grant some knowledge
    to `everyone`, and withhold some from all (`nobody`). Beside the usual adversaries
    those `asked` for count.
    """
    rows: dict[str, frozenset[Knowledge]] = {}
    for name, always in ADVERSARIES.items():
        if name not in (*USUAL, *asked):
            continue
        knows = (always | everyone) - nobody
        granted = knows & (attack.requires | attack.uses)
        if attack.requires <= knows and granted not in rows.values():
            rows[name] = granted
    return rows
