"""Records of the verdict: its items, decided, and what stands beside them.

`verdict_json` writes them to `verdict.json`. A share is a fraction of people; an
unknown number is NaN.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from evaluation.plan.world import World
from evaluation.verdict import rules
from isac_track.intervals import Estimate


@dataclass(frozen=True, slots=True)
class Topic:
    """What an item is about. Its parts make the item's id, the same in every run."""

    section: str  # One of `rules.SECTIONS`.
    adding: str  # Rule by which noises add: `linear` or `independent`.
    descriptor: str = ""  # `plr`, `ael` or `mel`; empty where linkage is compared.
    task: str = ""  # Linkage task; empty where nobody is linked.
    attack: str = ""  # Label of the linker or reconstruction; no part of the id.
    # Claims only: conflicts at which mechanisms are compared, as in `sweeps.CRITERIA`.
    criterion: str = ""
    compared: str = ""  # Claims only: `as-shared`, `after-attack` or `linkage`.
    # Of an inflation; of a claim, where it is not the paper's (FID).
    mechanism: str = ""
    horizon_s: float | None = None  # Claims only; None: the run's own horizon.

    @property
    def item_id(self) -> str:
        """The id in `verdict.json`: `claim/linear/missed/as-shared/plr`."""
        horizon = World(horizon_s=self.horizon_s).text
        # A claim has its mechanism last, as an addition to the paper's.
        first, last = self.compared, self.mechanism
        if self.section == rules.INFLATION:
            first, last = self.mechanism, ""
        parts = (
            self.section,
            self.adding,
            self.criterion,
            horizon,
            first,
            self.descriptor,
            self.task,
            last,
        )
        return "/".join(part for part in parts if part)


@dataclass(frozen=True, slots=True)
class GapAtRise:
    """A mechanism less fixed noise in a measure, at one rise of missed conflicts."""

    rise: float  # Of the missed rate over raw, a share of conflicts.
    gap: Estimate  # In the unit of the item.


@dataclass(frozen=True, slots=True)
class ClaimDetails:
    """Numbers that only an item of the claim has."""

    metric: str  # Rank 1 that was compared; empty for a descriptor.
    relative: float  # The effect over the mean of fixed noise.
    gaps: tuple[GapAtRise, ...]  # At the rises that both mechanisms reach.
    unreached: tuple[float, ...]  # The other rises.


@dataclass(frozen=True, slots=True)
class WithinDetails:
    """Numbers that only an item within a level has."""

    n_levels: int
    linked: float  # Mean share of people linked, above chance.


@dataclass(frozen=True, slots=True)
class InflationDetails:
    """Number that only an item of inflation has."""

    n_levels: int


Details: TypeAlias = ClaimDetails | WithinDetails | InflationDetails | None


@dataclass(frozen=True, slots=True)
class BandItem:
    """An item of *within*, *claim* or *inflation*, decided by its band (`bands`)."""

    topic: Topic
    decision: str
    effect: Estimate  # With its own 95 % interval; a ratio itself, not its logarithm.
    band_low: float  # Ends of the simultaneous band; NaN for an untestable item.
    band_high: float
    unit: str  # `fraction`, `s`, `ratio` or `correlation`.
    sentence: str
    why: str  # Reason that nothing is decided; empty for a decision.
    details: Details = None
    # Attacks that either half of the people chose; empty: those of the topic.
    scored_by: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SpreadAnswer:
    """Decision on a spread: the largest difference of linkage at equal descriptor."""

    decision: str
    spread: float  # Share of people, as often too high as too low.
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class PredictionError:
    """Error of linkage as predicted from a descriptor; shares of people."""

    value: float
    low: float
    high: float
    null: float  # Error of a prediction without any descriptor.


@dataclass(frozen=True, slots=True)
class Contrast:
    """A mechanism level against fixed noise at the same descriptor value."""

    mechanism: str
    level: float | None  # None: FID, which is read at quarter points.
    quartile: float | None  # Quarter point of FID, under its key in `verdict.json`.
    linker: str  # Label of the linker.
    gap: Estimate  # Share of people linked, less that under fixed noise.
    reading: str  # `differs`, `equal`, `between` or `not testable`.
    evidence: str  # A kind of evidence, as in `rules`.
    only: str  # `more` or `fewer`, if only this could be seen; else empty.
    in_panel: bool  # Whether it counts for the decision.


@dataclass(frozen=True, slots=True)
class ValidityItem:
    """An item of *validity*, decided by the spread of its contrasts (`spread`)."""

    topic: Topic
    answer: SpreadAnswer
    metric: str  # Rank 1: plain, or of 100 candidates.
    error: PredictionError | None
    evidence: tuple[str, ...]  # Kinds on which the decision rests.
    power: Mapping[str, float]  # Probability of each right decision.
    power_if: Mapping[str, Mapping[str, float]]  # The same of all, by supposed truth.
    n: int  # Clusters of people.
    n_needed: int | None  # Clusters that would show a true equal.
    why: str
    contrasts: tuple[Contrast, ...]
    sentence: str

    @property
    def decision(self) -> str:
        """The decision, as every item has it."""
        return self.answer.decision


Item: TypeAlias = BandItem | ValidityItem


@dataclass(frozen=True, slots=True)
class PositiveControl:
    """The question put to a descriptor that must track: linkage of other people."""

    adding: str
    task: str
    answer: SpreadAnswer
    n: int  # Clusters of people.


@dataclass(frozen=True, slots=True)
class DescriptorTrial:
    """A descriptor of the linked windows, and how well it predicts their linkage."""

    adding: str
    task: str
    descriptor: str
    error: PredictionError
    surely_lowest: bool  # The errors of all other descriptors are surely higher.


@dataclass(frozen=True, slots=True)
class ValiditySection:
    """The items of *validity*, and the controls and descriptors beside them."""

    items: tuple[ValidityItem, ...]
    controls: tuple[PositiveControl, ...]
    trials: tuple[DescriptorTrial, ...]


@dataclass(frozen=True, slots=True)
class LinkedPeopleSections:
    """The two sections that rest on linked people."""

    validity: ValiditySection
    within: tuple[BandItem, ...]


@dataclass(frozen=True, slots=True)
class Verdict:
    """All decisions of a run."""

    dataset: str
    is_simulated: bool
    seed: int
    preset: str
    n_scenes: int
    items: tuple[Item, ...]  # In the order of `rules.SECTIONS`.
    controls: tuple[PositiveControl, ...]
    trials: tuple[DescriptorTrial, ...]
