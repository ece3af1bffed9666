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

from evaluation.analysis.matching import (
    ADDING_SUFFIX,
    MIN_DEFINED,
    Measure,
    compare,
    interpolated,
)
from evaluation.analysis.metrics import DESCRIPTORS, SUCCESS
from evaluation.analysis.strongest import strongest_linkers
from evaluation.experiment.presets import SHARED
from evaluation.verdict.items import NAME, Draft, known, with_interval
from evaluation.verdict.rules import (
    DOES_NOT,
    LEAST_SPAN,
    REACH,
    SUCCESS_MARGIN,
    TRACKS,
    UNDECIDED,
    WEAK_MARGIN,
    WEAKLY,
    Effect,
    Option,
    effect,
    p_above,
    p_below,
    p_beyond,
    p_within,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from evaluation.analysis.matching import Sweeps
    from isac_track.types import Floats

_FAMILIES: Final = ("fixed", "fid")
_RULE: Final = "adding=independent"


@dataclass(frozen=True, slots=True)
class Contrast:
    """Success under another mechanism less that under fixed noise of the same descriptor value."""

    mechanism: str
    level: float | None
    """None for a sweep: the mean over the values that both reach."""
    subject: str
    """The linker: the strongest against this mechanism."""
    effect: Effect

    @property
    def label(self) -> str:
        """As people write a mechanism."""
        return self.mechanism if self.level is None else f"{self.mechanism} {self.level:g}"

    def to_json(self) -> dict[str, Any]:
        """Return the contrast for `verdict.json`; its reading is not adjusted."""
        one = self.effect
        reading = "unclear"
        if p_beyond(one, SUCCESS_MARGIN) <= 0.05:  # noqa: PLR2004
            reading = "differs"
        elif p_within(one, SUCCESS_MARGIN) <= 0.05:  # noqa: PLR2004
            reading = "equal"
        return {
            "mechanism": self.mechanism,
            "level": self.level,
            "subject": self.subject,
            "effect": known(one.value),
            "ci_low": known(one.low),
            "ci_high": known(one.high),
            "n": one.n,
            "reading": reading,
        }


def others(mechanisms: list[str], *, adding: str) -> list[str]:
    """Return the mechanisms beside FID and fixed noise that belong to an adding rule.

    One that comes under both rules belongs to its own; one that has no rule belongs to both.
    """
    plain = {name: _without_rule(name) for name in mechanisms}
    twins = {name for name in mechanisms if list(plain.values()).count(plain[name]) > 1}
    return [
        name
        for name in mechanisms
        if plain[name] not in _FAMILIES
        and name not in {"raw", "clean"}
        and (name not in twins or (_RULE in name) == (adding == "independent"))
    ]


def validity(
    sweeps: Sweeps, *, success: Mapping[str, Measure], chance: Mapping[str, float]
) -> Iterator[Draft]:
    """Yield an item for every adding rule, descriptor and task.

    Parameters
    ----------
    sweeps : Sweeps
        Of everything in the run.
    success : mapping
        By task: what its strongest linker achieves; against a control the strongest there counts.
    chance : mapping
        By task: what guessing achieves.
    """
    hits = {key: one for key, one in sweeps.found.items() if key.metric == SUCCESS}
    # An adversary takes what works: against errors of another kind that may be another linker.
    best = {name: strongest_linkers(hits, mechanism=name) for name in sweeps.mechanisms()}
    for adding in ADDING_SUFFIX:
        for descriptor in DESCRIPTORS:
            for task, measure in success.items():
                draft = _item(
                    sweeps,
                    adding=adding,
                    descriptor=descriptor,
                    task=task,
                    success=measure,
                    best={name: of.get(task, measure) for name, of in best.items()},
                    chance=chance[task],
                )
                if draft is not None:
                    yield draft


def _item(
    sweeps: Sweeps,
    *,
    adding: str,
    descriptor: str,
    task: str,
    success: Measure,
    best: Mapping[str, Measure],
    chance: float,
) -> Draft | None:
    fixed = "fixed" + ADDING_SUFFIX[adding]
    value = Measure(SHARED, descriptor)
    levels = sweeps.levels(fixed)
    if sweeps.curve(fixed, value) is None or sweeps.curve(fixed, success) is None:
        return None
    n = sweeps.n(fixed, success)
    ends = [
        (_point(sweeps, "raw", None, one), _point(sweeps, fixed, levels[0], one))
        for one in (success, value)
    ]
    works = effect(ends[0][0] - chance, n=n)
    drop = effect(ends[0][0] - ends[0][1], n=n)
    with np.errstate(divide="ignore", invalid="ignore"):
        span = effect(np.log(ends[1][0] / ends[1][1]), n=n)
    contrasts = list(
        _contrasts(sweeps, fixed, adding=adding, value=value, success=success, best=best)
    )
    condition = max(p_above(works, SUCCESS_MARGIN), p_above(span, np.log(LEAST_SPAN)))
    against = [p_beyond(one.effect, SUCCESS_MARGIN) for one in contrasts]
    flat = p_below(drop, SUCCESS_MARGIN)
    p_not = min(1.0, (len(against) + 1) * min([*against, flat]))
    falls = p_above(drop, SUCCESS_MARGIN)

    # FID alone is no test: it adds the same kind of error as fixed noise does.
    is_tested = any(one.level is not None for one in contrasts)

    def p_equal(margin: float) -> float:
        if not is_tested:
            return 1.0
        return max([condition, falls, *(p_within(one.effect, margin) for one in contrasts)])

    options = (
        Option(DOES_NOT, max(condition, p_not)),
        Option(TRACKS, p_equal(SUCCESS_MARGIN)),
        Option(WEAKLY, p_equal(WEAK_MARGIN)),
    )
    worst = min(contrasts, key=lambda one: p_beyond(one.effect, SUCCESS_MARGIN), default=None)
    is_flat = worst is None or flat < p_beyond(worst.effect, SUCCESS_MARGIN)
    shown = drop if worst is None or (is_flat and options[0].p_value < 1.0) else worst.effect
    name = NAME[descriptor]
    return Draft(
        section="validity",
        adding=adding,
        descriptor=descriptor,
        task=task,
        subject=_named(success),
        criterion="",
        effect=shown,
        unit="fraction",
        options=options,
        sentences=_sentences(name, task=task, worst=worst, drop=drop, shown=shown),
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


def _contrasts(
    sweeps: Sweeps,
    fixed: str,
    *,
    adding: str,
    value: Measure,
    success: Measure,
    best: Mapping[str, Measure],
) -> Iterator[Contrast]:
    """Yield every mechanism against fixed noise where it has the same descriptor value."""
    fid = "fid" + ADDING_SUFFIX[adding]
    for one in compare(sweeps, (fid, fixed), value, [success], ("", adding, "")):
        found = effect(one.mean_difference, n=one.n)
        if np.isfinite(found.value):
            yield Contrast(fid, None, _named(success), found)
    scale, achieved = sweeps.curve(fixed, value), sweeps.curve(fixed, success)
    assert scale is not None
    assert achieved is not None
    change = scale[:, -1:] - scale
    for mechanism in others(sweeps.mechanisms(), adding=adding):
        for level in sweeps.levels(mechanism):
            at = sweeps.point(mechanism, level, value)
            reached = sweeps.point(mechanism, level, best[mechanism])
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
                n = min(sweeps.n(fixed, success), sweeps.n(mechanism, best[mechanism]))
                yield Contrast(mechanism, level, _named(best[mechanism]), effect(difference, n=n))


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


def _without_rule(name: str) -> str:
    family, _, parameters = name.partition(":")
    kept = [one for one in parameters.split(",") if one and one != _RULE]
    return family + (":" + ",".join(kept) if kept else "")


def _named(success: Measure) -> str:
    return f"{success.consumer.partition('/')[2]} ({success.knowledge})"


def _taus(
    sweeps: Sweeps, *, adding: str, value: Measure, success: Measure
) -> dict[str, float | None]:
    """Return Kendall's tau over the levels of each family: necessary, never sufficient."""
    from scipy.stats import kendalltau  # noqa: PLC0415 - a second of every start

    taus = {}
    for family in _FAMILIES:
        mechanism = family + ADDING_SUFFIX[adding]
        pairs = [
            (at[0], reached[0])
            for level in sweeps.levels(mechanism)
            if (at := sweeps.point(mechanism, level, value)) is not None
            and (reached := sweeps.point(mechanism, level, success)) is not None
        ]
        few = 3
        tau = kendalltau(*zip(*pairs, strict=True)).statistic if len(pairs) >= few else np.nan
        taus[family] = known(float(tau))
    return taus


def _sentences(
    name: str, *, task: str, worst: Contrast | None, drop: Effect, shown: Effect
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


def _why(works: Effect, span: Effect, drop: Effect, contrasts: list[Contrast], *, name: str) -> str:
    level = 0.05
    if not works.is_known:
        return "too few people, or no interval"
    if p_above(works, SUCCESS_MARGIN) > level:
        return "the strongest attack hardly links anybody even at raw: nothing could be seen"
    if p_above(span, np.log(LEAST_SPAN)) > level:
        return f"{name} hardly changes from raw to the strongest fixed error"
    if all(one.level is None for one in contrasts):
        return "no dissociation control reaches a value that fixed noise reaches, too"
    if p_above(drop, SUCCESS_MARGIN) > level:
        return "whether success falls with fixed noise is not sure"
    return "the intervals reach on both sides of the margin"
