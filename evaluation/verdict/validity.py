"""Section a of the verdict: how successful is the adversary at equal descriptor value.

Within one mechanism more noise lowers both a descriptor and linkability, so that a rank correlation
near 1 over the levels comes for free. A descriptor that measures linkability must do so whatever
the mechanism: at one value of it, fixed noise, FID and the dissociation controls (`correlated`,
`offset`, `thin`) must let the same attack succeed equally often.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.analysis.families import ADDING_RULES, FID, FIXED, RAW
from evaluation.analysis.keys import AS_SHARED
from evaluation.analysis.matching import MIN_DEFINED, compare
from evaluation.analysis.metrics import DESCRIPTORS, SUCCESS
from evaluation.analysis.strongest import by_task, strongest_of
from evaluation.analysis.sweeps import interpolated
from evaluation.verdict.items import NAME, Draft, known, with_interval
from evaluation.verdict.rules import (
    DOES_NOT,
    LEAST_SPAN,
    REACH,
    SUCCESS_MARGIN,
    TRACKS,
    UNDECIDED,
    VALIDITY,
    WEAK_MARGIN,
    WEAKLY,
    Option,
    is_known,
    p_above,
    p_below,
    p_beyond,
    p_within,
)
from isac_track.intervals import estimate_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from evaluation.analysis.keys import Measure, Source
    from evaluation.analysis.sweeps import Sweeps
    from isac_track.intervals import Estimate
    from isac_track.types import Floats

_UNADJUSTED: Final = 0.05
"""For what is told beside a decision."""
_FEWEST_FOR_TAU: Final = 3


@dataclass(frozen=True, slots=True)
class Contrast:
    """Success under another mechanism less that under fixed noise of the same descriptor value."""

    mechanism: str
    level: float | None
    """None for a sweep, the mean over the values that both reach, and where there is no level."""
    subject: str
    """The linker: the strongest against this mechanism."""
    effect: Estimate
    is_test: bool = True
    """FID alone is none: it adds the same kind of error as fixed noise does."""

    @property
    def label(self) -> str:
        """As people write a mechanism."""
        return self.mechanism if self.level is None else f"{self.mechanism} {self.level:g}"

    @property
    def p_beyond(self) -> float:
        """How likely it is by chance, if nothing but the margin lies between the two."""
        return p_beyond(self.effect, SUCCESS_MARGIN)

    def to_json(self) -> dict[str, Any]:
        """Return the contrast for `verdict.json`; its reading is not adjusted."""
        one = self.effect
        reading = "unclear"
        if self.p_beyond <= _UNADJUSTED:
            reading = "differs"
        elif p_within(one, SUCCESS_MARGIN) <= _UNADJUSTED:
            reading = "equal"
        return {
            "mechanism": self.mechanism,
            "level": self.level,
            "subject": self.subject,
            "effect": known(one.value),
            "ci_low": known(one.ci_low),
            "ci_high": known(one.ci_high),
            "n": one.n,
            "reading": reading,
        }


def validity(
    sweeps: Sweeps, *, success: Mapping[str, Source], chance: Mapping[str, float]
) -> Iterator[Draft]:
    """Yield an item for every adding rule, descriptor and task.

    Parameters
    ----------
    sweeps : Sweeps
        Of everything in the run.
    success : mapping
        By task its strongest linker; against a control the strongest there counts.
    chance : mapping
        By task: what guessing achieves.
    """
    levels = by_task({key: one.value for key, one in sweeps.found.items()}, metric=SUCCESS)
    for adding in ADDING_RULES:
        for descriptor in DESCRIPTORS:
            for task, linker in success.items():
                # An adversary takes what works: against other errors that may be another linker.
                best = {
                    name: strongest_of(
                        block for where, block in levels[task].items() if where[0] == name
                    )
                    or linker
                    for name in sweeps.others(adding)
                }
                draft = _item(
                    sweeps,
                    adding=adding,
                    descriptor=descriptor,
                    linker=linker,
                    best=best,
                    chance=chance[task],
                )
                if draft is not None:
                    yield draft


def _item(
    sweeps: Sweeps,
    *,
    adding: str,
    descriptor: str,
    linker: Source,
    best: Mapping[str, Source],
    chance: float,
) -> Draft | None:
    fixed = sweeps.named(FIXED, adding=adding)
    value, success = AS_SHARED.measure(descriptor), linker.measure(SUCCESS)
    if sweeps.curve(fixed, value) is None or sweeps.curve(fixed, success) is None:
        return None
    n = sweeps.n(fixed, success)
    strongest_fixed = sweeps.levels(fixed)[0]
    ends = [
        (_point(sweeps, RAW, None, one), _point(sweeps, fixed, strongest_fixed, one))
        for one in (success, value)
    ]
    works = estimate_of(ends[0][0] - chance, n=n)
    drop = estimate_of(ends[0][0] - ends[0][1], n=n)
    with np.errstate(divide="ignore", invalid="ignore"):
        span = estimate_of(np.log(ends[1][0] / ends[1][1]), n=n)
    fid = sweeps.named(FID, adding=adding)
    contrasts = [
        *_sweep_contrast(sweeps, (fid, fixed), value=value, success=success),
        *_contrasts(sweeps, fixed, value=value, success=success, best=best),
    ]
    condition = max(p_above(works, SUCCESS_MARGIN), p_above(span, np.log(LEAST_SPAN)))
    against = [one.p_beyond for one in contrasts]
    flat = p_below(drop, SUCCESS_MARGIN)
    p_not = min(1.0, (len(against) + 1) * min([*against, flat]))
    falls = p_above(drop, SUCCESS_MARGIN)

    def p_equal(margin: float) -> float:
        if not any(one.is_test for one in contrasts):
            return 1.0
        return max([condition, falls, *(p_within(one.effect, margin) for one in contrasts)])

    options = (
        Option(DOES_NOT, max(condition, p_not)),
        Option(TRACKS, p_equal(SUCCESS_MARGIN)),
        Option(WEAKLY, p_equal(WEAK_MARGIN)),
    )
    worst = min(contrasts, key=lambda one: one.p_beyond, default=None)
    is_flat = worst is None or flat < worst.p_beyond
    shown = drop if worst is None or (is_flat and options[0].p_value < 1.0) else worst.effect
    name = NAME[descriptor]
    return Draft(
        section=VALIDITY,
        adding=adding,
        descriptor=descriptor,
        task=linker.task,
        subject=linker.attack.label,
        effect=shown,
        unit="fraction",
        options=options,
        sentences=_sentences(name, task=linker.task, worst=worst, drop=drop, shown=shown),
        why_undecided=_why(works, span, drop, contrasts, name=name),
        details={
            "contrasts": [one.to_json() for one in contrasts],
            "against": "" if shown is drop or worst is None else worst.label,
            "success_at_raw": known(float(ends[0][0][0])),
            "success_at_strongest_fixed": known(float(ends[0][1][0])),
            "chance": known(chance),
            "tau": _taus(sweeps, adding=adding, value=value, success=success),
        },
    )


def _sweep_contrast(
    sweeps: Sweeps, arms: tuple[str, str], *, value: Measure, success: Measure
) -> Iterator[Contrast]:
    """Yield FID against fixed noise over all values of a descriptor that both reach."""
    for one in compare(sweeps, arms, value, [success]):
        found = estimate_of(one.mean_difference, n=one.n)
        if np.isfinite(found.value):
            label = success.source.attack.label
            yield Contrast(one.mechanism, None, label, found, is_test=False)


def _contrasts(
    sweeps: Sweeps, fixed: str, *, value: Measure, success: Measure, best: Mapping[str, Source]
) -> Iterator[Contrast]:
    """Yield every level of other mechanisms against fixed noise of the same descriptor value."""
    scale, achieved = sweeps.curve(fixed, value), sweeps.curve(fixed, success)
    assert scale is not None
    assert achieved is not None
    change = scale[:, -1:] - scale
    for mechanism, linker in best.items():
        for level in sweeps.levels(mechanism):
            at = sweeps.point(mechanism, level, value)
            reached = sweeps.point(mechanism, level, linker.measure(SUCCESS))
            if at is None or reached is None:
                continue
            below_raw = _held(scale[:, -1] - at, change[:, 0])
            n_rows = min(reached.size, achieved.shape[0])
            expected = interpolated(
                below_raw[:n_rows, None], change[:n_rows], achieved[:n_rows], log=False
            )
            difference = reached[:n_rows] - expected[:, 0]
            known_share = float(np.isfinite(difference[1:]).mean())
            if known_share >= MIN_DEFINED and np.isfinite(difference[0]):
                n = sweeps.n(fixed, success), sweeps.n(mechanism, linker.measure(SUCCESS))
                found = estimate_of(difference, n=min(n))
                yield Contrast(mechanism, level, linker.attack.label, found)


def _held(below_raw: Floats, span: Floats) -> Floats:
    """Return how far below raw a value lies; a hair beyond an end counts as the end, else NaN."""
    hair = REACH * span
    inside = (below_raw >= -hair) & (below_raw <= span + hair)
    held: Floats = np.where(inside, np.clip(below_raw, 0.0, span), np.nan)
    return held


def _point(sweeps: Sweeps, mechanism: str, level: float | None, measure: Measure) -> Floats:
    found = sweeps.point(mechanism, level, measure)
    assert found is not None
    return found


def _taus(
    sweeps: Sweeps, *, adding: str, value: Measure, success: Measure
) -> dict[str, float | None]:
    """Return Kendall's tau over the levels of each sweep: necessary, never sufficient."""
    from scipy.stats import kendalltau  # noqa: PLC0415 - a second of every start

    taus: dict[str, float | None] = dict.fromkeys((FIXED, FID))
    for mechanism in sweeps.swept(adding):
        points = [
            [sweeps.point(mechanism, level, one) for one in (value, success)]
            for level in sweeps.levels(mechanism)
        ]
        pairs = [(at[0], got[0]) for at, got in points if at is not None and got is not None]
        if len(pairs) >= _FEWEST_FOR_TAU:
            tau = known(float(kendalltau(*zip(*pairs, strict=True)).statistic))
            taus[sweeps.known[mechanism].name] = tau
    return taus


def _sentences(
    name: str, *, task: str, worst: Contrast | None, drop: Estimate, shown: Estimate
) -> dict[str, str]:
    if worst is None or shown is drop:
        gap = (
            f"In {task}, from raw to the strongest fixed error {with_interval(drop, 'share')} "
            f"fewer of 100 people are linked while {name} falls"
        )
        return {DOES_NOT: f"{gap}: {name} does not track.", UNDECIDED: f"{gap}."}
    one = worst.effect
    where = f"In {task}, at equal {name}"
    more = "more" if one.value > 0 else "fewer"
    gap = f"{worst.label} lets {with_interval(one, 'share', absolute=True)} {more}"
    return {
        DOES_NOT: f"{where}, {gap} of 100 people be linked than fixed noise: {name} does not "
        "track.",
        TRACKS: f"{where}, no mechanism lets {100 * SUCCESS_MARGIN:.0f} of 100 people more or "
        f"fewer be linked than fixed noise: {name} tracks.",
        WEAKLY: f"{where}, no mechanism lets {100 * WEAK_MARGIN:.0f} of 100 people more or fewer "
        f"be linked than fixed noise, but {100 * SUCCESS_MARGIN:.0f} cannot be ruled out: {name} "
        "tracks weakly.",
        UNDECIDED: f"{where}, the surest difference from fixed noise is that {gap} of 100 people "
        "be linked.",
    }


def _why(
    works: Estimate, span: Estimate, drop: Estimate, contrasts: Sequence[Contrast], *, name: str
) -> str:
    if not is_known(works):
        return "too few people, or no interval"
    if p_above(works, SUCCESS_MARGIN) > _UNADJUSTED:
        return "the strongest attack hardly links anybody even at raw: nothing could be seen"
    if p_above(span, np.log(LEAST_SPAN)) > _UNADJUSTED:
        return f"{name} hardly changes from raw to the strongest fixed error"
    if not any(one.is_test for one in contrasts):
        return "no dissociation control reaches a value that fixed noise reaches, too"
    if p_above(drop, SUCCESS_MARGIN) > _UNADJUSTED:
        return "whether success falls with fixed noise is not sure"
    return "the intervals reach on both sides of the margin"
