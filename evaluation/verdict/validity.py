"""Section a of the verdict: how successful is the adversary at equal descriptor value.

Within one mechanism more noise lowers both a descriptor and linkability, so that a rank correlation
near 1 over the levels comes for free. A descriptor that measures linkability must do so whatever
the mechanism: at one value of it, fixed noise, FID and the dissociation controls (`correlated`,
`offset`, `thin`) must let the same attack succeed equally often.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from evaluation.analysis.families import ADDING_RULES, FID, FIXED, RAW
from evaluation.analysis.keys import AS_SHARED, Measure, Source
from evaluation.analysis.matching import MIN_DEFINED, Sweeps, compare, interpolated, places
from evaluation.analysis.metrics import DESCRIPTORS, SUCCESS
from evaluation.analysis.strongest import by_task, strongest_of
from evaluation.verdict import rules
from evaluation.verdict.rules import NAME, Draft, known, with_interval
from isac_track.intervals import Estimate, estimate_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from evaluation.analysis.strongest import Levels
    from isac_track.types import Floats

_UNADJUSTED: Final = 0.05
"""For what is told beside a decision."""
_FEWEST_FOR_TAU: Final = 3


class Contrast(NamedTuple):
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
        return rules.p_beyond(self.effect, rules.SUCCESS_MARGIN)

    def to_json(self) -> dict[str, Any]:
        """Return the contrast for `verdict.json`; its reading is not adjusted."""
        is_equal = rules.p_within(self.effect, rules.SUCCESS_MARGIN) <= _UNADJUSTED
        reading = "equal" if is_equal else "unclear"
        return {
            **{name: getattr(self, name) for name in ("mechanism", "level", "subject")},
            **rules.numbers(self.effect),
            "n": self.effect.n,
            "reading": "differs" if self.p_beyond <= _UNADJUSTED else reading,
        }


def validity(sweeps: Sweeps, *, success: Mapping[str, Source]) -> Iterator[Draft]:
    """Yield an item for every adding rule, descriptor and task.

    `success` is by task its strongest linker; against a control the strongest there counts.
    """
    levels, guesses = (by_task(sweeps.found, metric=metric) for metric in (SUCCESS, "chance"))
    for adding in ADDING_RULES:
        for descriptor in DESCRIPTORS:
            for task, linker in success.items():
                guessed = (of.get(linker, 0.0) for of in guesses.get(task, {}).values())
                chance = max(guessed, default=0.0)
                yield from _item(sweeps, levels[task], adding, descriptor, linker, chance)


def _item(
    sweeps: Sweeps, levels: Levels, adding: str, descriptor: str, linker: Source, chance: float
) -> Iterator[Draft]:
    """Yield an item, if there is a sweep of fixed noise to compare with."""
    fixed, fid = (sweeps.named(family, adding=adding) for family in (FIXED, FID))
    value, success = AS_SHARED.measure(descriptor), linker.measure(SUCCESS)
    if sweeps.curve(fixed, value) is None or sweeps.curve(fixed, success) is None:
        return
    n = sweeps.n(fixed, success)
    strongest = fixed, sweeps.levels(fixed)[0]
    (links, links_least), (shows, shows_least) = (
        [sweeps.drawn(one.at(*where)) for where in ((RAW, None), strongest)]
        for one in (success, value)
    )
    works, drop = estimate_of(links - chance, n=n), estimate_of(links - links_least, n=n)
    with np.errstate(divide="ignore", invalid="ignore"):
        span = estimate_of(np.log(shows / shows_least), n=n)
    contrasts = [
        *(  # FID over all values of the descriptor that both reach
            Contrast(fid, None, linker.attack.label, mean, is_test=False)
            for one in compare(sweeps, (fid, fixed), value, [success])
            if np.isfinite((mean := estimate_of(one.mean_difference, n=one.n)).value)
        ),
        *_of_levels(sweeps, levels, adding, value=value, linker=linker),
    ]
    has_test = any(one.is_test for one in contrasts)
    falls, flat = (test(drop, rules.SUCCESS_MARGIN) for test in (rules.p_above, rules.p_below))
    links_few = rules.p_above(works, rules.SUCCESS_MARGIN)
    spans_little = rules.p_above(span, np.log(rules.LEAST_SPAN))
    condition = max(links_few, spans_little)
    against = [*(one.p_beyond for one in contrasts), flat]

    def p_equal(margin: float) -> float:
        equal = (rules.p_within(one.effect, margin) for one in contrasts)
        return max([condition, falls, *equal]) if has_test else 1.0

    options = {
        rules.DOES_NOT: max(condition, min(1.0, len(against) * min(against))),
        rules.TRACKS: p_equal(rules.SUCCESS_MARGIN),
        rules.WEAKLY: p_equal(rules.WEAK_MARGIN),
    }
    worst = min(contrasts, key=lambda one: one.p_beyond, default=None)
    if worst is not None and flat < worst.p_beyond and options[rules.DOES_NOT] < 1.0:
        worst = None  # that success does not fall speaks more against it
    name = NAME[descriptor]
    reasons = {
        "too few people, or no interval": not rules.is_known(works),
        "the strongest attack hardly links anybody even at raw: nothing could be seen": links_few
        > _UNADJUSTED,
        f"{name} hardly changes from raw to the strongest fixed error": spans_little > _UNADJUSTED,
        "no dissociation control reaches a value that fixed noise reaches, too": not has_test,
        "whether success falls with fixed noise is not sure": falls > _UNADJUSTED,
        "the intervals reach on both sides of the margin": True,
    }
    yield Draft(
        adding=adding,
        descriptor=descriptor,
        task=linker.task,
        subject=linker.attack.label,
        effect=drop if worst is None else worst.effect,
        unit="fraction",
        options=options,
        sentences=_sentences(name, task=linker.task, worst=worst, drop=drop),
        why_undecided=next(why for why, holds in reasons.items() if holds),
        details={
            "contrasts": [one.to_json() for one in contrasts],
            "against": "" if worst is None else worst.label,
            "success_at_raw": known(float(links[0])),
            "success_at_strongest_fixed": known(float(links_least[0])),
            "chance": known(chance),
            "tau": _taus(sweeps, adding=adding, value=value, success=success),
        },
    )


def _of_levels(
    sweeps: Sweeps, levels: Levels, adding: str, *, value: Measure, linker: Source
) -> Iterator[Contrast]:
    """Yield every level of other mechanisms against fixed noise of the same descriptor value."""
    fixed, success = sweeps.named(FIXED, adding=adding), linker.measure(SUCCESS)
    scale, achieved = sweeps.curve(fixed, value), sweeps.curve(fixed, success)
    assert scale is not None
    assert achieved is not None
    change = scale[:, -1:] - scale
    span = change[:, 0]
    for mechanism in sweeps.others(adding):
        # An adversary takes what works: against other errors that may be another linker.
        blocks = (block for (name, _), block in levels.items() if name == mechanism)
        rival = strongest_of(blocks) or linker
        theirs = rival.measure(SUCCESS)
        for level in sweeps.levels(mechanism):
            at, reached = (sweeps.point(mechanism, level, one) for one in (value, theirs))
            if at is None or reached is None:
                continue
            # A hair beyond an end of the sweep of fixed noise counts as its end.
            below_raw = scale[:, -1] - at
            inside = (below_raw >= -rules.REACH * span) & (below_raw <= span + rules.REACH * span)
            held = np.where(inside, np.clip(below_raw, 0.0, span), np.nan)
            n_rows = min(reached.size, achieved.shape[0])
            read = places(held[:n_rows, None], change[:n_rows])
            gap = reached[:n_rows] - interpolated(read, achieved, log=False)[:, 0]
            if np.isfinite(gap[1:]).mean() >= MIN_DEFINED and np.isfinite(gap[0]):
                n = min(sweeps.n(fixed, success), sweeps.n(mechanism, theirs))
                yield Contrast(mechanism, level, rival.attack.label, estimate_of(gap, n=n))


def _taus(
    sweeps: Sweeps, *, adding: str, value: Measure, success: Measure
) -> dict[str, float | None]:
    """Return Kendall's tau over the levels of each sweep: necessary, never sufficient."""
    taus: dict[str, float | None] = dict.fromkeys((FIXED, FID))
    for mechanism in sweeps.swept(adding):
        points = (
            [sweeps.found.get(one.at(mechanism, level)) for one in (value, success)]
            for level in sweeps.levels(mechanism)
        )
        pairs = [(at.value, got.value) for at, got in points if at and got]
        if len(pairs) >= _FEWEST_FOR_TAU:
            taus[sweeps.known[mechanism].name] = known(kendall_tau(np.array(pairs)))
    return taus


def kendall_tau(pairs: Floats) -> float:
    """Return Kendall's tau-b of N pairs, (N, 2); NaN if either number never varies.

    That of `scipy.stats` takes a second to import.
    """
    first, second = pairs.T
    x, y = (np.sign(one[:, None] - one) for one in (first, second))
    spread = float(np.sqrt((x * x).sum()) * np.sqrt((y * y).sum()))
    return float((x * y).sum()) / spread if spread else np.nan


def _sentences(name: str, *, task: str, worst: Contrast | None, drop: Estimate) -> dict[str, str]:
    """Return what each decision says; without a contrast, of what noise alone does."""
    if worst is None:
        gap = (
            f"In {task}, from raw to the strongest fixed error {with_interval(drop, 'share')} "
            f"fewer of 100 people are linked while {name} falls"
        )
        return {rules.DOES_NOT: f"{gap}: {name} does not track.", rules.UNDECIDED: f"{gap}."}
    where = f"In {task}, at equal {name}"
    more = "more" if worst.effect.value > 0 else "fewer"
    gap = f"{worst.label} lets {with_interval(worst.effect, 'share', absolute=True)} {more}"
    close, far = (f"{100 * one:.0f}" for one in (rules.SUCCESS_MARGIN, rules.WEAK_MARGIN))
    none = f"{where}, no mechanism lets {{}} of 100 people more or fewer be linked than fixed noise"
    return {
        rules.DOES_NOT: f"{where}, {gap} of 100 people be linked than fixed noise: {name} does not "
        "track.",
        rules.TRACKS: f"{none.format(close)}: {name} tracks.",
        rules.WEAKLY: f"{none.format(far)}, but {close} cannot be ruled out: {name} tracks weakly.",
        rules.UNDECIDED: f"{where}, the surest difference from fixed noise is that {gap} of 100 "
        "people be linked.",
    }
