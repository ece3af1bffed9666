"""The strongest attack on each mechanism, by task and adversaries: `strongest.csv`.

Each is chosen against that mechanism only, over all of its levels. Where sums over
people are known its numbers are cross-fitted, and so not raised by the choice. Else
they are the plain numbers of the attack that all people together choose.

The columns `first_choice` and `second_choice` name the attacks that the first and the
second half of the people chose; each half is scored by the other's choice. For plain
numbers both name the attack itself.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates.families import Family
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    PLR,
    RANK1,
    RANK1_AMONG_100,
    RANK1_JOINT,
)
from evaluation.estimates.recordings import in_run
from evaluation.estimates.strongest import (
    GROUPS,
    HEADLINE,
    CrossFitted,
    by_task,
    cross_fitted,
    strongest_by_mechanism,
)
from evaluation.plan.address import Address, MechanismLevel
from evaluation.store.linkage_outcomes import ClusterSums
from isac_track.intervals import Estimate

# Group of the headline's adversaries: blind and informed.
SINGLE_RELEASE: Final = "one release"
COLUMNS: Final = [
    "dataset",
    "mechanism",
    "level",
    "task",
    "adversary",
    "consumer",
    "knowledge",
    "metric",
    "value",
    "ci_low",
    "ci_high",
    "n",
    "first_choice",
    "second_choice",
]
_LINKER_METRICS: Final = (RANK1, RANK1_AMONG_100)


@dataclass(frozen=True, eq=False, slots=True)
class StrongestAttack:
    """The strongest attack of a group of adversaries against one mechanism."""

    mechanism: str
    among: tuple[str, ...]  # One of `GROUPS`.
    reader: Address  # The attack that all people together choose.
    levels: tuple[MechanismLevel, ...]  # The mechanism's levels.
    crossed: CrossFitted  # Without estimates where sums over people are not known.

    def at(
        self, where: MechanismLevel, metric: str, estimates: EstimatesByAddress
    ) -> Estimate | None:
        """Return a number at a level, cross-fitted if possible; None if unknown.

        Of a plain rank 1 the better rule of naming mates counts.
        """
        number = self.reader.at(*where, metric)
        if number in self.crossed.estimates:
            return self.crossed.estimates[number]
        candidates = [number]
        if metric == RANK1:
            candidates.append(number.measured(RANK1_JOINT))
        known = [
            estimates[key]
            for key in candidates
            if key in estimates and np.isfinite(estimates[key].value)
        ]
        return max(known, key=lambda estimate: estimate.value, default=None)


def strongest_attacks(
    estimates: EstimatesByAddress,
    sums: Mapping[Address, ClusterSums],
    families: Mapping[str, Family],
) -> tuple[StrongestAttack, ...]:
    """Return the strongest attacks against every mechanism of a run.

    `estimates` are all those of the run, `sums` those of attacks by cluster, `families`
    the mechanisms.
    """
    own_sums: dict[tuple[str, str], dict[Address, ClusterSums]] = {}
    for key, summed in sums.items():
        group = key.mechanism, key.reader.task
        own_sums.setdefault(group, {})[key] = summed
    strongest = []
    for ranked_by in (PLR, RANK1):
        for task, levels in by_task(estimates, metric=ranked_by).items():
            for among in GROUPS:
                for mechanism, reader in strongest_by_mechanism(
                    levels, among=among
                ).items():
                    mechanism_levels = tuple(
                        where for where in levels if where.mechanism == mechanism
                    )
                    known = own_sums.get((mechanism, task), {})
                    crossed = cross_fitted(known, families, reader, by=ranked_by)
                    strongest.append(
                        StrongestAttack(
                            mechanism, among, reader, mechanism_levels, crossed
                        )
                    )
    return tuple(strongest)


def strongest_table(
    strongest: Sequence[StrongestAttack], estimates: EstimatesByAddress, *, dataset: str
) -> pd.DataFrame:
    """Return a row for each number of the strongest attacks: `COLUMNS`."""
    rows = [row for attack in strongest for row in _rows(attack, estimates, dataset)]
    return pd.DataFrame(rows, columns=COLUMNS)


def _rows(
    attack: StrongestAttack, estimates: EstimatesByAddress, dataset: str
) -> Iterable[dict[str, Any]]:
    reader, task = attack.reader, attack.reader.task
    for where in attack.levels:
        for metric in _LINKER_METRICS if task else DESCRIPTORS:
            number = reader.at(*where, metric)
            estimate = attack.at(where, metric, estimates)
            if estimate is None or not np.isfinite(estimate.value):
                continue
            ranked = PLR if not task else metric
            first, second = attack.crossed.choices.get(ranked) or (reader, reader)
            yield {
                **in_run(number, dataset=dataset).to_columns(),
                "task": task,
                "adversary": (
                    SINGLE_RELEASE if attack.among == HEADLINE else attack.among[0]
                ),
                "value": estimate.value,
                "ci_low": estimate.ci_low,
                "ci_high": estimate.ci_high,
                "n": estimate.n,
                "first_choice": first.without_task.label,
                "second_choice": second.without_task.label,
            }
