"""Interfaces of plug-ins: a frozen dataclass of parameters with one method.

The threat model is here as well: the knowledge that each adversary is granted, and the
context that gives an attack the granted knowledge and nothing else.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.random import Generator

from isac_track.errors import KnowledgeDenied
from isac_track.renamed import renamed
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
    from isac_track.tracking.association import Likelihood
    from isac_track.tracking.detections import Detections
    from isac_track.tracking.trackers import Tracked

__all__ = ["ADVERSARIES", "USUAL", "WALK_KNOWLEDGE", "Adversary", "AttackContext"]
__all__ += ["LinkageAttack", "LinkageTrainingSet", "Linker", "Mechanism", "Policy"]
__all__ += ["Predictor", "ReconstructionAttack", "Reconstructor", "Tracker"]
__all__ += ["TrainingSet"]
__all__ += ["attack_kind", "grants", "knowing", "links_same_stretch"]

Reconstructor: TypeAlias = "Callable[[Release], Reconstruction]"
"""Function from a release to its reconstruction, sample for sample."""
Linker: TypeAlias = "Callable[[Release, Release], Floats]"
"""Function from P probes and G candidates to scores, (P, G), higher for a match."""
_INFORMED = frozenset({Knowledge.MECHANISM, Knowledge.TRAIN})
ADVERSARIES: dict[str, frozenset[Knowledge]] = {
    "blind": frozenset(),
    "informed": _INFORMED,
    # Robots that combine their releases need the true frame to align them.
    "repeats": _INFORMED | {Knowledge.REPEATS, Knowledge.SCENE},
    "anchor": _INFORMED | {Knowledge.ANCHOR},
    "companions": _INFORMED | {Knowledge.COMPANIONS},
    "insider": _INFORMED | {Knowledge.SCENE},
    "oracle": frozenset(Knowledge),
}
"""Knowledge that each adversary is granted, by name, weakest first.

The oracle is only a reference.
"""
WALK_KNOWLEDGE = frozenset({Knowledge.REPEATS, Knowledge.ANCHOR, Knowledge.COMPANIONS})
"""Knowledge that reveals whose walk a release is; no linkage attack is granted it."""
USUAL: tuple[str, ...] = ("blind", "informed", "oracle")
"""Adversaries of every run; the others run on request."""


@runtime_checkable
class Mechanism(Protocol):
    """Interface of a sharing mechanism: from what was sensed to what is shared.

    It is a frozen dataclass, whose first field is the level, if it has a level. A class
    attribute ``sweep = "log"`` or ``"linear"`` says how ``name:LOW..HIGH/COUNT`` spaces
    the first field. ``protects = False`` says that the mechanism claims no protection:
    no level of it is ever proposed to a site. Without the attribute a mechanism claims
    protection. ``withholds = True`` says that it leaves samples out: it is not shared on
    patrols, where a policy selects samples.
    """

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the release of N sensed tracks, M samples in all.

        `rng` starts equal for every mechanism, so that all share their draws.
        """


@runtime_checkable
class Predictor(Protocol):
    """Interface of a robot's predictor: where each pedestrian will be.

    A predictor that adapts to the mechanism has a method ``knowing(mechanism)``, which
    returns the adapted predictor; it is called before `predict`. An optional method
    ``track(release)`` returns the causal estimate of every sample, (M, 2) m, for
    `plr_robot`.
    """

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that it cannot run without; at most SIGMA, which it then gets."""

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return the positions of N tracks at H future times each.

        `t_future`, (N, H) s, is on the clock of each track. The prediction has means,
        (N, H, 2) m, and covariances, (N, H, 2, 2) m^2, or None.
        """


def knowing(predictor: Predictor, mechanism: Mechanism) -> Any:  # noqa: ANN401 - another predictor
    """Return the predictor, adapted to the mechanism if it has a method `knowing`."""
    adapt = getattr(predictor, "knowing", None)
    return predictor if adapt is None else adapt(mechanism)


@runtime_checkable
class Policy(Protocol):
    """Interface of a policy: what the answer to a robot's query discloses.

    A class attribute ``protects = False`` says that it claims no protection.
    ``forecasts = True`` says that it decides by the network's forecast, which may equal
    that of a robot.
    """

    @property
    def form(self) -> Form:
        """Form of the answer, which is ``samples``, a ``state`` or a ``flag``."""

    def select(self, query: Query) -> Bools:
        """Return which of the M samples of the query are sent, (M,)."""


@runtime_checkable
class Tracker(Protocol):
    """Interface of a tracker: from unlabelled detections to tracks.

    It is causal: the tracks up to a scan depend on no later scan. A robot is given
    tracks as they grow.
    """

    def track(self, detections: Detections, likelihood: Likelihood) -> Tracked:
        """Return the tracks of D detections in K scans.

        `detections` has unlabelled points with the covariance of each error.
        `likelihood` says what a network knows about its sensing: the probability of
        detecting a person at a scan, and the density of clutter.
        """


class Adversary(Protocol):
    """An attack that declares the knowledge it needs and the knowledge it can use."""

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that it cannot run without."""

    @property
    def uses(self) -> frozenset[Knowledge]:
        """Knowledge that it uses if granted."""


@runtime_checkable
class ReconstructionAttack(Adversary, Protocol):
    """Interface of an attack that estimates true positions from a release.

    A class attribute ``slow = True`` keeps an attack out of the presets and runs it on
    one release of each source track; ``seconds_per_sample`` then states its cost.
    """

    def fit(self, context: AttackContext) -> Callable[[Release], Reconstruction]:
        """Return a function from a release to its reconstruction, sample for sample.

        The reconstruction has positions, (M, 2) m, and their standard deviations on
        each axis, (M,) m, or None. KnowledgeDenied if it reads what was not granted.
        """


@runtime_checkable
class LinkageAttack(Adversary, Protocol):
    """Interface of an attack that links the releases of the same person.

    Class attributes describe it. ``kind = "linkage"`` separates it from a
    reconstruction attack (`attack_kind`). ``same_stretch = True``: it links releases of
    the same steps, and nothing in a task without such releases. ``across_gap = True``:
    it bridges a silence within one walk. It may be given a whole gallery, or with
    `linkage.candidates=K` one probe and K candidates: the score of a pair should not
    depend on the other tracks.
    """

    def fit(self, context: AttackContext) -> Callable[[Release, Release], Floats]:
        """Return a function from P probes and G gallery tracks to scores, (P, G).

        A higher score makes the same person likelier. KnowledgeDenied if it reads what
        was not granted.
        """


def links_same_stretch(attack: object) -> bool:
    """Whether a linkage attack links releases of the same steps alone.

    It is the class attribute ``same_stretch``. Its old name, ``one_stretch``, gives a
    FutureWarning.
    """
    if hasattr(attack, "one_stretch") and not hasattr(attack, "same_stretch"):
        text = (
            f"{type(attack).__name__}.one_stretch is now called same_stretch; the old"
            " name works until 0.3"
        )
        warnings.warn(text, FutureWarning, stacklevel=2)
        return bool(attack.one_stretch)
    return bool(getattr(attack, "same_stretch", False))


def attack_kind(attack: object) -> Literal["reconstruction", "linkage"]:
    """Return the kind of an attack.

    It is the class attribute ``kind``; ValueError if that has another value. Without
    the attribute the annotated return type of ``fit`` decides: a function of two
    releases is linkage. Without either it is a reconstruction attack.
    """
    kind = getattr(attack, "kind", None)
    if kind is None:
        annotations = getattr(getattr(type(attack), "fit", None), "__annotations__", {})
        releases = re.findall(r"\bRelease\b", str(annotations.get("return", "")))
        return "linkage" if len(releases) > 1 else "reconstruction"
    if kind not in ("reconstruction", "linkage"):
        raise ValueError(f'kind must be "reconstruction" or "linkage", got {kind!r}')
    return "linkage" if kind == "linkage" else "reconstruction"


@dataclass(frozen=True, eq=False, slots=True, weakref_slot=True)
class TrainingSet:
    """A release of other people by the same mechanism, with their true positions.

    Attributes
    ----------
    release : Release
        N tracks, M samples in all.
    truth : Floats
        True positions in the frame of the release, (M, 2) m; ValueError for another
        shape.
    """

    release: Release
    truth: Floats

    def __post_init__(self) -> None:
        shape = self.release.xy.shape
        if self.truth.shape != shape:
            raise ValueError(f"truth must have shape {shape}, got {self.truth.shape}")
        object.__setattr__(self, "truth", read_only(self.truth))


@dataclass(frozen=True, eq=False, slots=True)
class LinkageTrainingSet:
    """Two releases of other people by the same mechanism, with the true pairs.

    Attributes
    ----------
    probe : Release
        P probes.
    gallery : Release
        G candidates.
    mate : Ints
        Track of the gallery of the same person, (P,); -1 if there is none. ValueError
        for another shape, for a track that does not exist, or for a track of two
        probes.
    """

    probe: Release
    gallery: Release
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
    """The granted knowledge with which an attack prepares, and nothing else.

    A property raises KnowledgeDenied if its knowledge was not granted.

    Attributes
    ----------
    rng : Generator
        The attack's own random stream.
    epsilon_m : float
        Distance below which a sample counts as leaked, m.
    granted : frozenset of Knowledge
        Knowledge that the adversary has and the attack declares.
    """

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
        """Store the granted knowledge; ValueError if some of it is missing.

        SIGMA and SCENE are part of the release itself: declared standard deviations,
        and the true frame and clock. The other kinds of knowledge are properties of the
        same names.
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
        self._held = {kind: offered[kind] for kind in offered if kind in granted}
        missing = sorted(kind.name for kind, held in self._held.items() if held is None)
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
        """One true position of each walk, in frame and on the clock of the release."""
        anchor: Release = self._get(Knowledge.ANCHOR)
        return anchor

    @property
    def companions(self) -> tuple[Release, ...]:
        """Releases of companions, in the same frame.

        Track i belongs to a person who walks along with track i, or has one sample if
        there is none.
        """
        companions: tuple[Release, ...] = self._get(Knowledge.COMPANIONS)
        return companions

    def _get(self, kind: Knowledge) -> Any:  # noqa: ANN401 - each kind has a type of its own
        if kind not in self._held:
            raise KnowledgeDenied(
                f"{kind.name} was not granted; an attack gets what its adversary knows"
                " and what it declares in `requires` or `uses`"
            )
        return self._held[kind]


def grants(
    attack: Adversary,
    *,
    everyone: frozenset[Knowledge] = frozenset(),
    nobody: frozenset[Knowledge] = frozenset(),
    asked: tuple[str, ...] = (),
) -> dict[str, frozenset[Knowledge]]:
    """Return ``{adversary: knowledge}`` for every adversary that runs an attack.

    An attack runs for each adversary that has all of its `requires`. Among adversaries
    with the same granted knowledge only the weakest runs it. A task may grant knowledge
    to `everyone`, and withhold some from all (`nobody`). `asked` names adversaries
    besides the usual.

    Examples
    --------
    An attack that can use training data, but does without:

    >>> from isac_track.protocols import grants
    >>> from isac_track.types import Knowledge
    >>> class Smoother:
    ...     requires = frozenset()
    ...     uses = frozenset({Knowledge.TRAIN})
    >>> for adversary, granted in grants(Smoother()).items():
    ...     print(adversary, [kind.name for kind in granted])
    blind []
    informed ['TRAIN']
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


if not TYPE_CHECKING:  # type checkers are to know the names that are
    __getattr__ = renamed(
        __name__, {"OF_WALKS": "WALK_KNOWLEDGE", "kind_of": "attack_kind"}
    )
