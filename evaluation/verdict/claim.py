"""The section *claim*: the paper's claim that FID is better than fixed noise.

Compared at equal missed rate are the descriptors as shared, the same after attack, and
linkage. FID is compared, and any other mechanism of the run that has levels.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.estimates.families import ADDING_RULES, FID, FIXED
from evaluation.estimates.frontier import TARGETS
from evaluation.estimates.interpolation import MIN_DEFINED
from evaluation.estimates.metrics import DESCRIPTORS, METRICS, RANK1_AMONG_100
from evaluation.estimates.strongest import success_metric
from evaluation.estimates.sweeps import (
    AT_EQUAL_ALARMS,
    CRITERIA,
    FUTURE,
    MISSED,
    Sweeps,
    at_changes,
)
from evaluation.plan.address import AS_SHARED, Address, parse_consumer
from evaluation.verdict import rules
from evaluation.verdict.bands import Draft
from evaluation.verdict.items import ClaimDetails, GapAtRise, Topic
from evaluation.verdict.rules import NAME
from isac_track.intervals import Estimate, estimate_from_replicates
from isac_track.types import Floats

_WHERE: Final = {
    MISSED: "At an equal rise of missed conflicts",
    AT_EQUAL_ALARMS: "At an equal rise of missed conflicts and equal false alarms",
    FUTURE: "At an equal rise of missed future conflicts and equal false alarms",
}
# Kinds of claim: what is compared.
AS_SHARED_KIND, AFTER_ATTACK, LINKED = "as-shared", "after-attack", "linkage"


def draft_claims(
    sweeps: Sweeps,
    strongest: Mapping[str, Address],
    *,
    predictor: str,
    criteria: Collection[str] = tuple(CRITERIA),
    horizon_s: float | None = None,
) -> Iterator[Draft]:
    """Yield a draft for every measure compared at equal costs of a predictor's robot.

    A cost is a rise of its missed rate over raw. Compared with fixed noise are FID and
    every other mechanism of the run that has levels. The rises, from the raw that both
    mechanisms share, are fixed beforehand; those that either does not reach are listed.
    `horizon_s` is the further horizon, if any, at which the robots of `sweeps` are
    judged.
    """
    compared = _compared_measures(sweeps, strongest)
    costs = {
        parse_consumer(predictor).measured(metric): criterion
        for criterion, metric in CRITERIA.items()
        if criterion in criteria
    }
    for adding in ADDING_RULES:
        fixed = sweeps.named(FIXED, adding=adding)
        rivals = [name for name in sweeps.swept(adding) if name != fixed]
        for mechanism in rivals:
            name = sweeps.families[mechanism].name
            curves = sweeps.curves(mechanism, fixed, [*costs, *compared])
            for cost, criterion in costs.items():
                pairs = at_changes(curves, cost, compared, at=np.array(TARGETS))
                for pair in pairs:
                    measure = pair.measure
                    n, effective = sweeps.rests_on((mechanism, fixed), cost, measure)
                    gap = _gap(pair.first, pair.second, n=n, effective=effective)
                    topic = _topic(
                        measure,
                        adding=adding,
                        criterion=criterion,
                        compared=compared[measure],
                        mechanism="" if name == FID else name,
                        horizon_s=horizon_s,
                    )
                    yield _draft(measure, gap, topic)


def _compared_measures(
    sweeps: Sweeps, strongest: Mapping[str, Address]
) -> dict[Address, str]:
    """Return the measures that are compared, each with its kind of claim."""
    compared = {
        AS_SHARED.measured(descriptor): AS_SHARED_KIND for descriptor in DESCRIPTORS
    }
    for task, reader in strongest.items():
        if task:
            compared[reader.measured(success_metric(sweeps.estimates, reader))] = LINKED
        else:
            compared |= dict.fromkeys(map(reader.measured, DESCRIPTORS), AFTER_ATTACK)
    return compared


def _topic(
    measure: Address,
    *,
    adding: str,
    criterion: str,
    compared: str,
    mechanism: str,
    horizon_s: float | None,
) -> Topic:
    reader = measure.reader
    return Topic(
        rules.CLAIM,
        adding,
        descriptor="" if compared == LINKED else measure.metric,
        task=reader.task,
        attack="" if compared == AS_SHARED_KIND else reader.without_task.label,
        criterion=criterion,
        compared=compared,
        mechanism=mechanism,
        horizon_s=horizon_s,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Gap:
    """A mechanism less fixed noise in a measure at the rises of missed conflicts."""

    mean: Estimate  # Over the rises that both reach.
    relative: float  # The mean over that of fixed noise; NaN if no rise is reached.
    at_rises: tuple[GapAtRise, ...]  # At the rises that both reach.
    unreached: tuple[float, ...]


def _gap(ours: Floats, theirs: Floats, *, n: int, effective: float) -> _Gap:
    """Return the gap between both mechanisms at the rises, (1 + B, P) each.

    `n` are the clusters behind it, `effective` the effective clusters.
    """
    gaps = ours - theirs
    reached = np.isfinite(gaps[0]) & (np.isfinite(gaps[1:]).mean(axis=0) >= MIN_DEFINED)
    targets = np.array(TARGETS)
    mean, relative = np.full(len(gaps), np.nan), np.nan
    if reached.any():
        # The mean of each row over its known values; a row without any stays unknown.
        is_known = reached & np.isfinite(gaps)
        with np.errstate(invalid="ignore"):
            mean = np.where(is_known, gaps, 0.0).sum(axis=1) / is_known.sum(axis=1)
            relative = float(mean[0] / theirs[0, reached].mean())
    at_rises = [
        GapAtRise(rise, estimate_from_replicates(gap, n=n, effective=effective))
        for rise, gap in zip(targets[reached].tolist(), gaps[:, reached].T, strict=True)
    ]
    return _Gap(
        mean=estimate_from_replicates(mean, n=n, effective=effective),
        relative=relative,
        at_rises=tuple(at_rises),
        unreached=tuple(targets[~reached].tolist()),
    )


def _draft(measure: Address, gap: _Gap, topic: Topic) -> Draft:
    """Return the draft of a measure compared at the rises."""
    least = f"{100 * TARGETS[0]:g} points"
    return Draft(
        topic=topic,
        effect=gap.mean,
        parted_at=0.0,
        above=rules.REVERSED,
        below=rules.HOLDS,
        unit=METRICS[measure.metric].summary_unit,
        sentences=_sentences(measure, gap.relative, topic),
        untestable=""
        if gap.at_rises
        else f"not both surely miss {least} more than raw",
        details=ClaimDetails(
            metric=measure.metric if topic.compared == LINKED else "",
            relative=gap.relative,
            gaps=gap.at_rises,
            unreached=gap.unreached,
        ),
    )


def _sentences(measure: Address, relative: float, topic: Topic) -> dict[str, str]:
    """Return the sentences of an item by decision."""
    horizon = "" if topic.horizon_s is None else f"{topic.horizon_s:g} s ahead, "
    where = f"{_WHERE[topic.criterion]} ({horizon}{topic.adding} adding)"
    name = topic.mechanism or "FID"
    head = NAME.get(measure.metric, "")
    if topic.compared == AS_SHARED_KIND:
        subject = f"{head} as shared"
    elif topic.compared == AFTER_ATTACK:
        subject = f"{head} after {measure.reader.consumer}"
    else:
        is_of_100 = measure.metric == RANK1_AMONG_100
        gallery = "100" if is_of_100 else "the candidates of this run"
        subject = f"the share of people found among {gallery} in {topic.task}"
    share = (
        f", {100 * relative:+.0f} % of fixed noise's" if np.isfinite(relative) else ""
    )
    than = f"under {name} than under fixed noise: {{}}{share}."
    return {
        rules.HOLDS: f"{where}, {subject} is lower {than}",
        rules.REVERSED: f"{where}, {subject} is higher {than}",
        rules.BETWEEN: f"{where}, {name} less fixed noise in {subject} is {{}}.",
        "": f"{where}, {subject} cannot be compared.",
    }
