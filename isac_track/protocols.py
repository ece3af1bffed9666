"""What a plug-in must offer: a frozen dataclass of its parameters plus one method.

The threat model is here as well: which adversary is granted which knowledge, and the context
that hands an attack what it was granted and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from isac_track.errors import KnowledgeDenied
from isac_track.types import Knowledge, read_only

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.random import Generator

    from isac_track.types import Floats, Prediction, Reconstruction, Release, Sensed

ADVERSARIES: dict[str, frozenset[Knowledge]] = {
    "blind": frozenset(),
    "informed": frozenset({Knowledge.MECHANISM, Knowledge.TRAIN}),
    "oracle": frozenset(Knowledge),
}
"""Weakest first. The oracle is a reference, never the headline."""


@runtime_checkable
class Mechanism(Protocol):
    """Turns what was sensed into what is shared.

    A class attribute ``sweep = "log"`` or ``"linear"`` says how ``name:LOW..HIGH/COUNT``
    spaces the first field.
    """

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the release; `rng` starts alike for every mechanism (common random numbers)."""
        ...


@runtime_checkable
class Predictor(Protocol):
    """The robot's forecast of where each pedestrian will be."""

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that it cannot run without; a robot has no SIGMA unless this asks for it."""
        ...

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return positions of the N tracks at `t_future`, (N, H) s on each track's clock."""
        ...


@runtime_checkable
class ReconstructionAttack(Protocol):
    """An adversary who estimates where people truly were from what was shared.

    A class attribute ``slow = True`` keeps an attack out of the presets and runs it on one
    release of each source track; ``seconds_per_sample`` then says what it costs.
    """

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that it cannot run without."""
        ...

    @property
    def uses(self) -> frozenset[Knowledge]:
        """Knowledge that it takes if granted."""
        ...

    def fit(self, context: AttackContext) -> Callable[[Release], Reconstruction]:
        """Return what turns a release into a reconstruction, sample for sample."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class TrainingSet:
    """A release of other people, perturbed by the same mechanism, and where they truly were."""

    release: Release
    truth: Floats
    """(M, 2) m, in the frame of the release."""

    def __post_init__(self) -> None:
        if self.truth.shape != self.release.xy.shape:
            raise ValueError(
                f"truth must have shape {self.release.xy.shape}, got {self.truth.shape}"
            )
        object.__setattr__(self, "truth", read_only(self.truth))


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
        train: TrainingSet | None = None,
        repeats: tuple[Release, ...] | None = None,
    ) -> None:
        """Keep what was granted.

        Parameters
        ----------
        rng : Generator
            The attack's own stream.
        epsilon_m : float
            Distance below which a sample counts as leaked, m.
        granted : frozenset of Knowledge
            SIGMA and SCENE show in the release itself: declared standard deviations, and the true
            frame and clock.
        mechanism : Mechanism, optional
            The frozen object, for MECHANISM.
        train : TrainingSet, optional
            For TRAIN.
        repeats : tuple of Release, optional
            Further releases of the same walks, sample by sample at the same instants, for
            REPEATS.

        Raises
        ------
        ValueError
            If something was granted and is not there.
        """
        self.rng = rng
        self.epsilon_m = epsilon_m
        self.granted = granted
        offered: dict[Knowledge, Any] = {
            Knowledge.MECHANISM: mechanism,
            Knowledge.TRAIN: train,
            Knowledge.REPEATS: repeats,
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
    def train(self) -> TrainingSet:
        """Other people, perturbed by the same mechanism."""
        train: TrainingSet = self._get(Knowledge.TRAIN)
        return train

    @property
    def repeats(self) -> tuple[Release, ...]:
        """Further releases of the same walks, sample by sample at the same instants."""
        repeats: tuple[Release, ...] = self._get(Knowledge.REPEATS)
        return repeats

    def _get(self, what: Knowledge) -> Any:  # noqa: ANN401
        if what not in self._held:
            raise KnowledgeDenied(
                f"{what.name} was not granted; an attack gets what its adversary knows and what "
                "it declares in `requires` or `uses`"
            )
        return self._held[what]


def grants(attack: ReconstructionAttack) -> dict[str, frozenset[Knowledge]]:
    """Return ``{adversary: what it is granted}`` of every row that an attack makes.

    An attack runs once for each adversary that grants all of its `requires`; of those that
    grant it the same, the weakest names the row.
    """
    rows: dict[str, frozenset[Knowledge]] = {}
    for name, knows in ADVERSARIES.items():
        granted = knows & (attack.requires | attack.uses)
        if attack.requires <= knows and granted not in rows.values():
            rows[name] = granted
    return rows
