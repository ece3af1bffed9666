"""Section c of the verdict: the paper's claim that FID has the advantage over fixed noise.

At equal missed rate: descriptors as shared, the same after attack, and who is linked.
Of FID, and of any other mechanism of the run that has levels.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.estimates.families import ADDING_RULES, FID, FIXED
from evaluation.estimates.frontier import TARGETS
from evaluation.estimates.keys import AS_SHARED, Measure, Source
from evaluation.estimates.matching import (
    AT_EQUAL_ALARMS,
    CRITERIA,
    FUTURE,
    MIN_DEFINED,
    MISSED,
    Sweeps,
    at_changes,
)
from evaluation.estimates.metrics import DESCRIPTORS, METRICS, SUCCESS_OF_100
from evaluation.estimates.strongest import success_of
from evaluation.verdict import rules
from evaluation.verdict.items import Draft
from evaluation.verdict.rules import NAME, known
from isac_track.intervals import estimate_of
from isac_track.types import Floats

_WHERE: Final = {
    MISSED: "At an equal rise of missed conflicts",
    AT_EQUAL_ALARMS: "At an equal rise of missed conflicts and equal false alarms",
    FUTURE: "At an equal rise of missed future conflicts and equal false alarms",
}
AS_IS, AFTER, LINKED = "as-shared", "after-attack", "linkage"  # What a claim compares.


def claims(
    sweeps: Sweeps,
    strongest: Mapping[str, Source],
    *,
    predictor: str,
    criteria: Collection[str] = tuple(CRITERIA),
    horizon_s: float | None = None,
) -> Iterator[Draft]:
    """Yield an item for everything that is compared where `predictor` misses as many more.

    Of FID, and of any other mechanism of the run that has levels. The rises over raw,
    which is one for both mechanisms, are fixed beforehand; those that either does not
    reach are listed. `horizon_s` is the further horizon, if it is one, that the robots
    of `sweeps` are judged at.
    """
    wanted = {AS_SHARED.measure(descriptor): AS_IS for descriptor in DESCRIPTORS}
    for task, source in strongest.items():
        by_rank = (success_of(sweeps.found, source),)
        metrics, of = (by_rank, LINKED) if task else (DESCRIPTORS, AFTER)
        wanted |= dict.fromkeys(map(source.measure, metrics), of)
    costs = {
        Measure(predictor, metric): criterion for criterion, metric in CRITERIA.items()
    }
    costs = {by: criterion for by, criterion in costs.items() if criterion in criteria}
    for adding in ADDING_RULES:
        fixed = sweeps.named(FIXED, adding=adding)
        for mechanism in sweeps.swept(adding):
            if mechanism == fixed:
                continue
            name = sweeps.known[mechanism].name
            curves = sweeps.curves(mechanism, fixed, [*costs, *wanted])
            for by, criterion in costs.items():
                found = at_changes(curves, by, wanted, at=np.array(TARGETS))
                for measure, *reached in found:
                    about = _About(
                        adding=adding,
                        criterion=criterion,
                        compared=wanted[measure],
                        mechanism="" if name == FID else name,
                        horizon_s=horizon_s,
                    )
                    people = sweeps.rests_on((mechanism, fixed), by, measure)
                    yield _claim(measure, reached, about, people)


@dataclass(frozen=True, slots=True)
class _About:
    """What an item is about."""

    adding: str
    criterion: str
    compared: str  # `AS_IS`, `AFTER` or `LINKED`.
    mechanism: str  # Empty for the paper's.
    horizon_s: float | None  # At which robots are judged; None: the run's own.

    @property
    def where(self) -> str:
        """The operating points, at the beginning of a sentence."""
        horizon = "" if self.horizon_s is None else f"{self.horizon_s:g} s ahead, "
        return f"{_WHERE[self.criterion]} ({horizon}{self.adding} adding)"


def _claim(
    measure: Measure, curves: Sequence[Floats], about: _About, people: tuple[int, float]
) -> Draft:
    """Return an item from both mechanisms at the rises, (1 + B, P) each.

    `people` are the clusters that it rests on, and the effective ones.
    """
    (ours, theirs), (n, effective) = curves, people
    mechanism = about.mechanism
    gaps = ours - theirs
    reached = np.isfinite(gaps[0]) & (np.isfinite(gaps[1:]).mean(axis=0) >= MIN_DEFINED)
    targets = np.array(TARGETS)
    mean, relative = np.full(len(gaps), np.nan), np.nan
    if reached.any():
        # Of each row over what is known; a row of which nothing is stays unknown.
        is_known = reached & np.isfinite(gaps)
        with np.errstate(invalid="ignore"):
            mean = np.where(is_known, gaps, 0.0).sum(axis=1) / is_known.sum(axis=1)
            relative = float(mean[0] / theirs[0, reached].mean())
    points = [
        {"at": float(at), **rules.numbers(estimate_of(gap, n=n))}
        for at, gap in zip(targets[reached], gaps[:, reached].T, strict=True)
    ]
    source = measure.source
    descriptor = "" if about.compared == LINKED else measure.metric
    gallery = (
        "100" if measure.metric == SUCCESS_OF_100 else "the candidates of this run"
    )
    where = about.where
    who = mechanism or "FID"
    what = {
        AS_IS: f"{NAME.get(descriptor, '')} as shared",
        AFTER: f"{NAME.get(descriptor, '')} after {source.consumer}",
        LINKED: f"the share of people found among {gallery} in {source.task}",
    }[about.compared]
    share = (
        f", {100 * relative:+.0f} % of fixed noise's" if np.isfinite(relative) else ""
    )
    than = f"under {who} than under fixed noise: {{}}{share}."
    least = f"{100 * targets[0]:g} points"
    return Draft(
        adding=about.adding,
        descriptor=descriptor,
        task=source.task,
        subject="" if about.compared == AS_IS else source.attack.label,
        criterion=about.criterion,
        effect=estimate_of(mean, n=n, effective=effective),
        parted_at=0.0,
        above=rules.REVERSED,
        below=rules.HOLDS,
        unit=METRICS[measure.metric].summary_unit,
        sentences={
            rules.HOLDS: f"{where}, {what} is lower {than}",
            rules.REVERSED: f"{where}, {what} is higher {than}",
            rules.BETWEEN: f"{where}, {who} less fixed noise in {what} is {{}}.",
            "": f"{where}, {what} cannot be compared.",
        },
        untestable=(
            "" if reached.any() else f"not both surely miss {least} more than raw"
        ),
        details={
            "of": about.compared,
            **({"metric": measure.metric} if about.compared == LINKED else {}),
            "relative": known(relative),
            "range": (
                [float(targets[reached][place]) for place in (0, -1)]
                if points
                else None
            ),
            "unreached": targets[~reached].tolist(),
            "points": points,
            **({"mechanism": mechanism} if mechanism else {}),
            **({} if about.horizon_s is None else {"horizon_s": about.horizon_s}),
        },
    )
