"""Section c of the verdict: the paper's claim that FID is better than fixed noise.

Compared at equal missed rate are the descriptors as shared, the same after attack, and
linkage. FID is compared, and any other mechanism of the run that has levels.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from evaluation.estimates.families import ADDING_RULES, FID, FIXED
from evaluation.estimates.frontier import TARGETS
from evaluation.estimates.interpolation import MIN_DEFINED
from evaluation.estimates.json_numbers import json_number
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
from evaluation.verdict.items import Draft
from evaluation.verdict.rules import NAME
from isac_track.intervals import Estimate, estimate_from_replicates
from isac_track.types import Floats

_WHERE: Final = {
    MISSED: "At an equal rise of missed conflicts",
    AT_EQUAL_ALARMS: "At an equal rise of missed conflicts and equal false alarms",
    FUTURE: "At an equal rise of missed future conflicts and equal false alarms",
}
AS_SHARED_KIND, AFTER_ATTACK, LINKED = (
    "as-shared",
    "after-attack",
    "linkage",
)  # Kinds of claim.


def claims(
    sweeps: Sweeps,
    strongest: Mapping[str, Address],
    *,
    predictor: str,
    criteria: Collection[str] = tuple(CRITERIA),
    horizon_s: float | None = None,
) -> Iterator[Draft]:
    """Yield an item for every measure compared at equal costs of a predictor's robot.

    A cost is a rise of its missed rate over raw. Compared with fixed noise are FID and
    every other mechanism of the run that has levels. The rises, from the raw that both
    mechanisms share, are fixed beforehand; those that either does not reach are listed.
    `horizon_s` is the further horizon, if any, at which the robots of `sweeps` are
    judged.
    """
    compared = {
        AS_SHARED.measured(descriptor): AS_SHARED_KIND for descriptor in DESCRIPTORS
    }
    for task, reader in strongest.items():
        if task:
            compared[reader.measured(success_metric(sweeps.estimates, reader))] = LINKED
        else:
            compared |= dict.fromkeys(map(reader.measured, DESCRIPTORS), AFTER_ATTACK)
    costs = {
        parse_consumer(predictor).measured(metric): criterion
        for criterion, metric in CRITERIA.items()
        if criterion in criteria
    }
    for adding in ADDING_RULES:
        fixed = sweeps.named(FIXED, adding=adding)
        for mechanism in sweeps.swept(adding):
            if mechanism == fixed:
                continue
            name = sweeps.families[mechanism].name
            curves = sweeps.curves(mechanism, fixed, [*costs, *compared])
            for cost, criterion in costs.items():
                pairs = at_changes(curves, cost, compared, at=np.array(TARGETS))
                for pair in pairs:
                    measure = pair.measure
                    about = _Subject(
                        adding=adding,
                        criterion=criterion,
                        compared=compared[measure],
                        mechanism="" if name == FID else name,
                        horizon_s=horizon_s,
                    )
                    n, effective = sweeps.rests_on((mechanism, fixed), cost, measure)
                    gap = _gap(pair.first, pair.second, n=n, effective=effective)
                    yield _claim(measure, gap, about)


@dataclass(frozen=True, slots=True)
class _Subject:
    """Subject of an item."""

    adding: str
    criterion: str
    compared: str  # `AS_SHARED_KIND`, `AFTER_ATTACK` or `LINKED`.
    mechanism: str  # Empty for the paper's.
    horizon_s: float | None  # Horizon of the robots; None: the run's own.

    @property
    def where(self) -> str:
        """The operating points, at the beginning of a sentence."""
        horizon = "" if self.horizon_s is None else f"{self.horizon_s:g} s ahead, "
        return f"{_WHERE[self.criterion]} ({horizon}{self.adding} adding)"


@dataclass(frozen=True, eq=False, slots=True)
class _Gap:
    """A mechanism less fixed noise in a measure at the rises."""

    mean: Estimate  # Over the rises that both reach.
    relative: float  # The mean over that of fixed noise; NaN if no rise is reached.
    points: list[dict[str, Any]]  # Records of the rises reached.
    reached: list[float]
    unreached: list[float]


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
    points = [
        {
            "at": float(at),
            **rules.numbers(estimate_from_replicates(gap, n=n, effective=effective)),
        }
        for at, gap in zip(targets[reached], gaps[:, reached].T, strict=True)
    ]
    return _Gap(
        mean=estimate_from_replicates(mean, n=n, effective=effective),
        relative=relative,
        points=points,
        reached=targets[reached].tolist(),
        unreached=targets[~reached].tolist(),
    )


def _claim(measure: Address, gap: _Gap, about: _Subject) -> Draft:
    """Return the item of a measure compared at the rises."""
    reader, is_linkage = measure.reader, about.compared == LINKED
    descriptor = "" if is_linkage else measure.metric
    least = f"{100 * TARGETS[0]:g} points"
    details: dict[str, Any] = {"of": about.compared}
    if is_linkage:
        details["metric"] = measure.metric
    details |= {
        "relative": json_number(gap.relative),
        "range": [gap.reached[0], gap.reached[-1]] if gap.points else None,
        "unreached": gap.unreached,
        "points": gap.points,
    }
    if about.mechanism:
        details["mechanism"] = about.mechanism
    if about.horizon_s is not None:
        details["horizon_s"] = about.horizon_s
    return Draft(
        adding=about.adding,
        descriptor=descriptor,
        task=reader.task,
        subject="" if about.compared == AS_SHARED_KIND else reader.without_task.label,
        criterion=about.criterion,
        effect=gap.mean,
        parted_at=0.0,
        above=rules.REVERSED,
        below=rules.HOLDS,
        unit=METRICS[measure.metric].summary_unit,
        sentences=_sentences(measure, gap.relative, about),
        untestable="" if gap.points else f"not both surely miss {least} more than raw",
        details=details,
    )


def _sentences(measure: Address, relative: float, about: _Subject) -> dict[str, str]:
    """Return the sentences of an item by decision."""
    where, name = about.where, about.mechanism or "FID"
    head = NAME.get(measure.metric, "")
    if about.compared == AS_SHARED_KIND:
        subject = f"{head} as shared"
    elif about.compared == AFTER_ATTACK:
        subject = f"{head} after {measure.reader.consumer}"
    else:
        is_of_100 = measure.metric == RANK1_AMONG_100
        gallery = "100" if is_of_100 else "the candidates of this run"
        task = measure.reader.task
        subject = f"the share of people found among {gallery} in {task}"
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
