"""The section *inflation*: how much each descriptor rises from shared to attacked.

A descriptor is *as shared* on the positions that a mechanism releases, and *attacked*
on those that the strongest reconstruction makes of them.
"""

from collections.abc import Iterable, Iterator
from itertools import product

import numpy as np

from evaluation.estimates.families import ADDING_RULES
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.estimates.sweeps import Sweeps
from evaluation.plan.address import AS_SHARED, Address
from evaluation.verdict import rules
from evaluation.verdict.bands import Draft
from evaluation.verdict.items import InflationDetails, Topic
from evaluation.verdict.rules import NAME
from isac_track.intervals import estimate_from_replicates


def draft_inflation(sweeps: Sweeps, attacks: Iterable[Address]) -> Iterator[Draft]:
    """Yield a draft for every attack, adding rule, mechanism and descriptor."""
    for attack, adding in product(attacks, ADDING_RULES):
        for mechanism, descriptor in product(sweeps.swept(adding), DESCRIPTORS):
            yield from _draft(sweeps, mechanism, adding, attack, descriptor)


def _draft(
    sweeps: Sweeps, mechanism: str, adding: str, attack: Address, descriptor: str
) -> Iterator[Draft]:
    """Yield a draft, if any level of a mechanism was attacked."""
    measures = attack.measured(descriptor), AS_SHARED.measured(descriptor)
    levels = []
    for level in sweeps.levels(mechanism):
        keys = [measure.at(mechanism, level) for measure in measures]
        if {*keys} <= sweeps.estimates.keys():
            levels.append([sweeps.estimates[key].drawn for key in keys])
    if not levels:
        return
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.mean([np.log(after / before) for after, before in levels], axis=0)
    n, effective = sweeps.rests_on([mechanism], *measures)
    name = sweeps.families[mechanism].name
    is_known = np.isfinite(mean[0])
    yield Draft(
        topic=Topic(
            rules.INFLATION,
            adding,
            descriptor=descriptor,
            attack=attack.label,
            mechanism=name,
        ),
        effect=estimate_from_replicates(mean, n=n, effective=effective),
        parted_at=0.0,
        above=rules.INFLATED,
        below=rules.DEFLATED,
        unit="ratio",
        sentences={
            "": (
                f"After {attack.label} {NAME[descriptor]} under {name} ({adding}"
                " adding) is {} what it was as shared (geometric mean over the"
                " levels)."
            )
        },
        untestable="" if is_known else f"{NAME[descriptor]} is 0 at a level",
        details=InflationDetails(n_levels=len(levels)),
    )
