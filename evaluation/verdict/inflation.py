"""Section d of the verdict: how much higher each descriptor is after attack than as shared."""

from collections.abc import Iterable, Iterator
from itertools import product

import numpy as np

from evaluation.estimates.families import ADDING_RULES
from evaluation.estimates.keys import AS_SHARED, Source
from evaluation.estimates.matching import Sweeps
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.verdict import rules
from evaluation.verdict.items import Draft
from evaluation.verdict.rules import NAME
from isac_track.intervals import estimate_of


def inflation(sweeps: Sweeps, attacks: Iterable[Source]) -> Iterator[Draft]:
    """Yield an item for every adding rule, mechanism and descriptor, by the strongest attack."""
    for attack, adding in product(attacks, ADDING_RULES):
        for mechanism, descriptor in product(sweeps.swept(adding), DESCRIPTORS):
            yield from _inflated(sweeps, mechanism, adding, attack, descriptor)


def _inflated(
    sweeps: Sweeps, mechanism: str, adding: str, attack: Source, descriptor: str
) -> Iterator[Draft]:
    """Yield an item, if any level of a mechanism was attacked."""
    measures, levels = (attack.measure(descriptor), AS_SHARED.measure(descriptor)), []
    for level in sweeps.levels(mechanism):
        keys = [one.at(mechanism, level) for one in measures]
        if {*keys} <= sweeps.found.keys():
            levels.append([sweeps.found[key].drawn for key in keys])
    if not levels:
        return
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.mean([np.log(after / before) for after, before in levels], axis=0)
    n, effective = sweeps.rests_on([mechanism], *measures)
    name = sweeps.known[mechanism].name
    yield Draft(
        adding=adding,
        descriptor=descriptor,
        subject=attack.label,
        effect=estimate_of(mean, n=n, effective=effective),
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
        untestable=(
            "" if np.isfinite(mean[0]) else f"{NAME[descriptor]} is 0 at a level"
        ),
        details={"of": name, "levels": len(levels)},
    )
