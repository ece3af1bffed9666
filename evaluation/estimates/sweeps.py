"""Sweeps of mechanisms over their levels, and two of them at equal cost."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from evaluation.estimates.families import AT_RAW, FID, FIXED, RAW, Family
from evaluation.estimates.interpolation import (
    interpolated,
    isotonic_joined,
    positions_at_change,
)
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.metrics import (
    COSTS,
    DESCRIPTORS,
    DISTANCE_MAE,
    EQUAL_ALARMS,
    FUTURE_EQUAL_ALARMS,
    MISSED_RATE,
    PLR,
)
from evaluation.plan.address import AS_SHARED, Address, MechanismLevel
from isac_track.intervals import Estimate
from isac_track.types import Floats

MISSED, AT_EQUAL_ALARMS, FUTURE, EQUAL_PLR = (
    "missed",
    EQUAL_ALARMS,
    "missed_future",
    "plr",
)
"""Criteria of matching."""
CRITERIA: Final = {
    MISSED: MISSED_RATE,
    AT_EQUAL_ALARMS: EQUAL_ALARMS,
    FUTURE: FUTURE_EQUAL_ALARMS,
}
"""Cost of noise by criterion; all but the paper's hold false alarms at raw's rate."""
FEWEST_LEVELS: Final = 2  # Fewest levels of a curve, beside raw.
PLR_AS_SHARED: Final = AS_SHARED.measured(PLR)
Curves: TypeAlias = "dict[Address, tuple[Floats, Floats]]"
"""Curves of two mechanisms over their levels, (1 + B, L) each, by measure."""


class Sweeps:
    """Every estimate of a run, and its mechanisms."""

    def __init__(
        self, estimates: EstimatesByAddress, families: Mapping[str, Family]
    ) -> None:
        self.estimates = estimates
        self.families = families
        self._levels: dict[str, list[float | None]] = {}
        for key in estimates:
            if (
                key.metric == PLR
                and key.measure == PLR_AS_SHARED
                and families[key.mechanism].is_added
            ):
                self._levels.setdefault(key.mechanism, []).append(key.level)
        for mechanism, levels in self._levels.items():
            levels.sort(key=lambda level: (level is None, level))
            family = families[mechanism].family
            plr_first, plr_last = (
                estimates[PLR_AS_SHARED.at(mechanism, levels[end])].value
                for end in (0, -1)
            )
            is_noisiest_first = family == FID or (
                family != FIXED and plr_first < plr_last
            )
            if not is_noisiest_first:
                levels.reverse()

    def levels(self, mechanism: str) -> list[float | None]:
        """Return the levels of a mechanism, noisiest first.

        From there eta grows and the fixed error falls. For any other mechanism PLR at
        the two ends decides: the noisier end shows less.
        """
        return self._levels.get(mechanism, [])

    def named(self, family: str, *, adding: str) -> str:
        """Return a family's mechanism under an adding rule, all else default; or ""."""
        name_by_parts = {
            (mechanism.family, mechanism.adding, mechanism.parameters): name
            for name, mechanism in self.families.items()
        }
        return name_by_parts.get((family, adding, ""), "")

    def swept(self, adding: str) -> list[str]:
        """Return the mechanisms with a curve under a rule, FID and fixed first."""
        papers = [self.named(family, adding=adding) for family in (FID, FIXED)]
        others = [
            name
            for name, levels in self._levels.items()
            if len(levels) >= FEWEST_LEVELS
            and adding in self.families[name].rules
            and name not in papers
        ]
        return [*filter(None, papers), *others]

    def curves(self, a: str, b: str, measures: Iterable[Address]) -> Curves:
        """Return two mechanisms' curves, joined at raw, for each common measure."""
        joined_curves = {
            measure: self.together(dict.fromkeys((a, b, RAW), measure))
            for measure in measures
        }
        return {
            measure: (by_mechanism[a], by_mechanism[b])
            for measure, by_mechanism in joined_curves.items()
            if {a, b} <= by_mechanism.keys()
        }

    def together(self, measures: Mapping[str, Address]) -> dict[str, Floats]:
        """Return the curves of mechanisms, joined at raw and pooled, (1 + B, L) each.

        `measures` gives the measure of each mechanism; without raw among them there
        are no curves. A mechanism with fewer than two levels, or without an estimate at
        one of its levels, is left out.
        """
        stacked: dict[str, Floats] = {}
        if RAW not in measures:
            return stacked
        raw = measures[RAW].at(RAW, None)
        for name, measure in measures.items():
            keys = [*(measure.at(name, level) for level in self.levels(name)), raw]
            if len(keys) > FEWEST_LEVELS and all(key in self.estimates for key in keys):
                drawn = [self.estimates[key].drawn for key in keys]
                stacked[name] = np.stack(drawn, axis=1)
        # The cost of noise falls towards raw; what noise hides rises.
        rises = measures[RAW].metric not in (*COSTS, DISTANCE_MAE)
        curves = (
            isotonic_joined([*stacked.values()], increasing=rises) if stacked else []
        )
        return dict(zip(stacked, curves, strict=True))

    def rests_on(
        self, mechanisms: Iterable[str], *measures: Address
    ) -> tuple[int, float]:
        """Return the least clusters and effective clusters over all levels and raw."""
        levels = [
            MechanismLevel(name, level)
            for name in mechanisms
            for level in self.levels(name)
        ]
        levels.append(AT_RAW)
        keys = (measure.at(*where) for where in levels for measure in measures)
        known = [self.estimates[key] for key in keys if key in self.estimates]
        known = known or [Estimate(np.nan)]
        return (
            min(estimate.n for estimate in known),
            min(estimate.n_effective for estimate in known),
        )

    def n(self, mechanism: str, measure: Address) -> int:
        """Return the least clusters over a mechanism's levels; 0 if none was run."""
        keys = (measure.at(mechanism, level) for level in self.levels(mechanism))
        return min(
            (self.estimates[key].n for key in keys if key in self.estimates), default=0
        )


@dataclass(frozen=True, eq=False, slots=True)
class AtChanges:
    """A measure of two mechanisms, at P equal changes of another from raw."""

    measure: Address
    first: Floats  # (1 + B, P) estimate, then replicates.
    second: Floats  # (1 + B, P) of the other mechanism.


def at_changes(
    curves: Curves, matched_by: Address, measures: Iterable[Address], *, at: Floats
) -> Iterator[AtChanges]:
    """Yield measures of both mechanisms at equal changes from raw.

    The measure `matched_by` has changed from raw by `at` there. Raw is the same for
    both mechanisms; points out of reach are NaN. Measures without an estimate at some
    level are left out.
    """
    if matched_by not in curves:
        return
    positions = [
        positions_at_change(at, np.abs(scale - scale[:, -1:]))
        for scale in curves[matched_by]
    ]
    for measure in measures:
        if measure in curves:
            first, second = (
                interpolated(position, curve, log=measure.metric in DESCRIPTORS)
                for position, curve in zip(positions, curves[measure], strict=True)
            )
            n_rows = min(len(first), len(second))
            yield AtChanges(measure, first[:n_rows], second[:n_rows])
