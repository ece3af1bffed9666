"""Whether equal descriptor values mean equal linkage: section a of the verdict.

Over the levels of a single mechanism, descriptor and linkability always fall together.
A measure of linkability must hold for every mechanism: at the same descriptor value,
fixed noise, FID and the dissociation controls must let equally many people be linked.
The mechanisms compared are in `panel`, the decision in `spread`; items and their
sentences are here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from evaluation.estimates.families import ADDING_RULES, Family
from evaluation.estimates.json_numbers import json_number
from evaluation.estimates.keys import where_text
from evaluation.estimates.linked_people import TaskSums
from evaluation.estimates.metrics import DESCRIPTORS, RANK1, RANK1_AMONG_100
from evaluation.verdict import rules, spread
from evaluation.verdict.panel import (
    Panel,
    Rates,
    Sums,
    build_panel,
    contrasts,
    drawn_weights,
)
from evaluation.verdict.prediction_error import (
    WHITE_FAMILIES,
    SquaredError,
    prediction_errors,
)
from evaluation.verdict.rules import BETWEEN, NAME, with_interval
from evaluation.verdict.spread import (
    BOTH,
    NEITHER,
    ONLY_FEWER,
    ONLY_MORE,
    Contrasts,
    Widths,
)
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate
from isac_track.rng import stream
from isac_track.types import Floats

# Kinds of evidence.
CONSTRUCTION: Final = "construction"  # The task hides what the mechanism changes.
SHOWN: Final = "shown"  # More people are linked.
ATTACKS: Final = "attacks"  # Fewer people are linked, as far as these attacks go.
# Descriptors that rise with noise, as PLR, AEL and MEL fall.
RISING_WITH_NOISE: Final = ("alignment_error", "posterior_std")
_N_FOR_ERRORS: Final = 200  # Replicates of a prediction error.
OTHER_HALF: Final = "rank 1 of the other half of the people"
"""The positive control: no descriptor could tell more about how linkable people are."""
_ONLY: Final = {ONLY_MORE: "more", ONLY_FEWER: "fewer"}
_WHY_ONE_SIDED: Final = {
    ONLY_MORE: "has a lower {} than any fixed noise, so that only more could be seen",
    ONLY_FEWER: "has a higher {} than raw, so that only fewer could be seen",
    NEITHER: "has a {} of too few people",
}
Errors: TypeAlias = "tuple[SquaredError, SquaredError] | None"
"""Prediction errors with a descriptor, and without."""
_QUARTILE: Final = dict(zip(spread.QUARTILES, ("low", "middle", "high"), strict=True))


@dataclass(frozen=True, eq=False, slots=True)
class ValidityTest:
    """A descriptor in a task under an adding rule, before its section is decided."""

    panel: Panel
    descriptor: str
    contrasts: Contrasts
    beside: Contrasts | None = None  # Of mechanisms outside the panel.
    errors: Errors = None

    @property
    def n(self) -> int:
        """Clusters, the least over all contrasts."""
        return int(min(self.contrasts.people, default=0))


def validity(
    tasks: Sequence[TaskSums],
    *,
    families: Mapping[str, Family],
    preset: str,
    dataset: str,
    seed: int,
) -> dict[str, list[dict[str, Any]]]:
    """Return items, positive controls, and descriptors on trial.

    `families` are by mechanism.
    """
    tested: list[ValidityTest] = []
    halves: list[ValidityTest] = []
    on_trial: list[dict[str, Any]] = []
    for task in tasks:
        weights = drawn_weights(task, tasks, dataset, seed)
        sums = {name: _sums(task, name) for name in task.levels[0].descriptors}
        rates = {name: own.drawn(weights) for name, own in sums.items()}
        half = _half(task, next(iter(sums.values())), seed)
        for adding in ADDING_RULES:
            panel = build_panel(task, families, adding=adding, preset=preset)
            if panel is None:
                continue
            errors = {name: _errors(panel, name, rates[name]) for name in rates}
            on_trial += _on_trial(panel, errors)
            tested += [
                _tested(panel, name, sums[name], rates[name], errors=errors[name])
                for name in DESCRIPTORS
                if name in sums
            ]
            half_contrasts = contrasts(
                half, half.drawn(weights), panel, others=panel.others, fid=panel.fid
            )
            halves.append(ValidityTest(panel, "", half_contrasts))
    section = spread.furthest_together([item.contrasts for item in tested])
    control_section = spread.furthest_together([item.contrasts for item in halves])
    return {
        "items": [_item(item, section) for item in tested],
        "controls": [_control(item, control_section) for item in halves],
        "on_trial": on_trial,
    }


def _tested(
    panel: Panel,
    name: str,
    sums: Sums,
    rates: Rates,
    *,
    errors: Errors,
) -> ValidityTest:
    """Return a descriptor with its contrasts, those beside the panel included."""
    own = contrasts(sums, rates, panel, others=panel.others, fid=panel.fid)
    beside = None
    if panel.beside:
        beside = contrasts(sums, rates, panel, others=panel.beside)
    return ValidityTest(panel, name, own, beside, errors)


def _sums(task: TaskSums, name: str) -> Sums:
    values, windows = (
        np.array([level.descriptors[name][part] for level in task.levels])
        for part in (0, 1)
    )
    return Sums(
        success=np.array([level.success for level in task.levels]),
        probes=np.array([level.probes for level in task.levels]),
        values=values,
        windows=windows,
    )


def _half(task: TaskSums, sums: Sums, seed: int) -> Sums:
    """Return a half of the people, with the other half's linkage as its descriptor."""
    order = stream(seed, "halves", task.task).permutation(len(task.clusters))
    is_first = order < len(task.clusters) / 2
    return Sums(
        success=sums.success * is_first,
        probes=sums.probes * is_first,
        values=sums.success * ~is_first,
        windows=sums.probes * ~is_first,
    )


def _errors(panel: Panel, name: str, rates: Rates) -> Errors:
    """Return the squared prediction error of a descriptor, and that of none."""
    levels = [*panel.fixed, *panel.fid[:-1], *panel.others]
    success, descriptor = (values[: 1 + _N_FOR_ERRORS, levels] for values in rates)
    families = [panel.families[place] for place in levels]
    kinds = ["white" if family in WHITE_FAMILIES else family for family in families]
    return prediction_errors(
        -descriptor if name in RISING_WITH_NOISE else descriptor, success, kinds
    )


def _on_trial(panel: Panel, errors: Mapping[str, Errors]) -> list[dict[str, Any]]:
    """Return each descriptor's prediction error, and whether it is surely lowest."""
    known_errors = {name: pair[0] for name, pair in errors.items() if pair is not None}
    return [
        {
            "adding": panel.adding,
            "task": panel.task.task,
            "descriptor": name,
            **_error_numbers(errors[name]),
            "surely_lowest": len(known_errors) > 1
            and all(
                rival_error.less(error).ends[0] > 0
                for rival, rival_error in known_errors.items()
                if rival != name
            ),
        }
        for name, error in known_errors.items()
    ]


def _error_numbers(pair: Errors) -> dict[str, float | None]:
    keys = ("prediction_error", "prediction_error_low", "prediction_error_high")
    values = (None, None, None) if pair is None else pair[0].roots
    null = None if pair is None else pair[1].roots[0]
    return {**dict(zip(keys, values, strict=True)), "prediction_error_null": null}


def _item(tested: ValidityTest, section: Floats) -> dict[str, Any]:
    """Return an item as in `verdict.json`."""
    panel, own = tested.panel, tested.contrasts
    wide = spread.widths(own, section)
    answer = _answer(own, wide, span=own.span[:1])
    decision, low, high = (
        answer[name] for name in ("decision", "spread_low", "spread_high")
    )
    compared, beside = _contrasts(panel, panel.compared, own, wide), []
    if tested.beside is not None:
        beside_wide = spread.widths(tested.beside, section)
        beside = _contrasts(panel, panel.beside, tested.beside, beside_wide)
    is_flat = rules.is_flat_miss(decision, low)
    # A difference by construction decided nothing. Equality, and a miss by a flat
    # descriptor, hold as far as these attacks go.
    sure = {gap["evidence"] for gap in compared if gap["reading"] == rules.DIFFERS}
    kinds = sorted(sure - {CONSTRUCTION}) if sure and not is_flat else [ATTACKS]
    families = [panel.families[place] for place in panel.compared]
    answers = spread.answer_probabilities(own, wide, families)
    needed = None if is_flat else spread.clusters_needed(own, wide, tested.n)
    why = ""
    if decision == rules.NOT_TESTABLE:
        why = _why_not(tested, wide)
    elif decision == BETWEEN:
        why = f"between {_points(low)} and {_points(high)} of 100 people"
    item = {
        "id": f"{rules.VALIDITY}/{panel.adding}/{tested.descriptor}/{panel.task.task}",
        "section": rules.VALIDITY,
        "adding": panel.adding,
        "descriptor": tested.descriptor,
        "task": panel.task.task,
        "subject": panel.task.levels[panel.fixed[-1]].linker.without_task.label,
        "criterion": "",
        **answer,
        "sign": rules.SIGN[decision],
        "effect": answer["spread"],
        "ci_low": low,
        "ci_high": high,
        "unit": "fraction",
        "metric": RANK1 if panel.task.gallery is None else RANK1_AMONG_100,
        **_error_numbers(tested.errors),
        "evidence": kinds if decision in (rules.DOES_NOT, rules.TRACKS) else [],
        "power": spread.decision_power(answers),
        "power_if": answers,
        "n": tested.n,
        "n_needed": needed,
        "why": why,
        "contrasts": compared + beside,
    }
    return {**item, "sentence": _sentence(tested, item)}


def _control(tested: ValidityTest, section: Floats) -> dict[str, Any]:
    """Return the record of a positive control, which must not fail."""
    wide = spread.widths(tested.contrasts, section)
    # Linkage itself as the descriptor: any span will do.
    answer = _answer(tested.contrasts, wide, span=np.full(1, np.inf))
    about = {
        "adding": tested.panel.adding,
        "task": tested.panel.task.task,
        "descriptor": OTHER_HALF,
    }
    return {**about, **answer, "n": tested.n}


def _answer(own: Contrasts, wide: Widths, *, span: Floats) -> dict[str, Any]:
    """Return decision and spread."""
    gaps, fall = own.gaps[:1], own.fall[:1]
    codes, low, high = spread.decided(own, wide, gaps=gaps, fall=fall, span=span)
    return {
        "decision": spread.ANSWERS[codes[0]],
        "spread": spread.shown(own),
        "spread_low": float(low[0]),
        "spread_high": float(high[0]),
    }


def _contrasts(
    panel: Panel, places: Sequence[int], own: Contrasts, wide: Widths
) -> list[dict[str, Any]]:
    """Return contrasts as in `verdict.json`, each with its own, unadjusted interval."""
    low, high = (end[0] for end in spread.ends(own, wide, own.gaps[:1]))
    ci_low, ci_high = spread.intervals(own)
    rows = []
    for k, (place, gap) in enumerate(zip(places, own.gaps[0].tolist(), strict=True)):
        level, is_fid = panel.task.levels[place], place in panel.fid
        readings = {
            rules.NOT_TESTABLE: own.side[k] == NEITHER,
            rules.DIFFERS: low[k] > rules.SUCCESS_MARGIN,
            rules.EQUAL: high[k] < rules.SUCCESS_MARGIN,
        }
        shown = SHOWN if gap > 0 else ATTACKS
        rows.append(
            {
                "mechanism": level.mechanism,
                "level": None if is_fid else level.level,
                "quartile": spread.QUARTILES[k] if is_fid else None,
                "subject": level.linker.without_task.label,
                "effect": gap if np.isfinite(own.errors[k]) else None,
                "ci_low": json_number(ci_low[k]),
                "ci_high": json_number(ci_high[k]),
                "unit": "fraction",
                "n": int(own.people[k]),
                "reading": next(
                    (name for name, is_so in readings.items() if is_so), BETWEEN
                ),
                "evidence": CONSTRUCTION if panel.is_hidden(place) else shown,
                "only": _ONLY.get(int(own.side[k]), ""),
                "in_panel": place not in panel.beside,
            }
        )
    return rows


def _mechanism_name(gap: Mapping[str, Any]) -> str:
    """Return the mechanism of a contrast as people write it."""
    if gap["quartile"] is not None:
        return f"{gap['mechanism']} ({_QUARTILE[gap['quartile']]})"
    return where_text(gap["mechanism"], gap["level"])


def _why_not(tested: ValidityTest, wide: Widths) -> str:
    """Return why it cannot be tested whether a descriptor tracks."""
    panel, own = tested.panel, tested.contrasts
    effective = own.fall_degrees + 1
    if effective < FEWEST_EFFECTIVE:
        return (
            f"it rests on {tested.n} people or groups, who count as {effective:.0f}: "
            f"{FEWEST_EFFECTIVE} are needed"
        )
    if own.fall_error < rules.NO_SPREAD:
        return "all people fare the same: that says nothing of others"
    raw = panel.task.levels[panel.fixed[-1]]
    links, guess = (
        float(sums.sum() / raw.probes.sum()) for sums in (raw.success, raw.chance)
    )
    if links - guess < rules.SUCCESS_MARGIN:
        return (
            f"the strongest attack links {_points(links)} of 100 people even at raw, "
            f"a guess {_points(guess)}: nothing could be seen"
        )
    fall = float(own.fall[0])
    if fall - wide.fall < rules.LEAST_FALL:
        low, high = _points(fall - wide.fall), _points(fall + wide.fall)
        least = _points(rules.LEAST_FALL, 0)
        return (
            f"linkage falls by {_points(fall)} [{low}, {high}] of 100 people from raw "
            f"to the strongest fixed error, not surely by {least}: anything would track"
        )
    return panel.missing or "; ".join(_untestable_sides(tested))


def _untestable_sides(tested: ValidityTest) -> list[str]:
    """Return the mechanisms with an untestable side, each with the reason."""
    name, levels = NAME[tested.descriptor], tested.panel.task.levels
    reasons: dict[str, None] = {}
    sides = tested.contrasts.side.tolist()
    for place, side in zip(tested.panel.compared, sides, strict=True):
        if side != BOTH:
            level = levels[place]
            reason = _WHY_ONE_SIDED[side].format(name)
            reasons[f"{where_text(level.mechanism, level.level)} {reason}"] = None
    return list(reasons)


def _sentence(tested: ValidityTest, item: Mapping[str, Any]) -> str:
    """Return the sentence of an item."""
    name, decision, low = NAME[tested.descriptor], item["decision"], item["spread_low"]
    task = tested.panel.task
    plain = "" if task.gallery else " (plain rank 1, galleries of its own)"
    where = f"In {task.task}{plain}"
    equal = f"{where}, at equal {name}"
    either = "more or fewer be linked than fixed noise"
    fails = f"{name} does not track."
    if decision == rules.NOT_TESTABLE:
        return f"In {task.task}, whether {name} tracks cannot be tested: {item['why']}."
    if decision == rules.TRACKS:
        high = _points(item["spread_high"])
        return (
            f"{equal}, no mechanism lets {high} of 100 people {either}: {name} tracks."
        )
    if decision == BETWEEN:
        would = _people_needed(item["n_needed"])
        return f"{equal}, mechanisms let {item['why']} {either}{would}."
    if rules.is_flat_miss(decision, low):
        own = tested.contrasts
        fall, span = _points(own.fall[0]), np.exp(own.span[0])
        return (
            f"{where}, from raw to the strongest fixed error {fall} fewer of 100 people"
            f" are linked while {name} hardly changes ({span:.2f} times): {fails}"
        )
    worst = max(
        (
            gap
            for gap in item["contrasts"]
            if gap["reading"] == rules.DIFFERS and gap["in_panel"]
        ),
        key=lambda gap: (gap["evidence"] != CONSTRUCTION, abs(gap["effect"])),
    )
    gap = Estimate(*(worst[key] for key in ("effect", "ci_low", "ci_high")))
    more, limit = "more", ""
    if not gap.value > 0:
        more, limit = "fewer", ", as far as these attacks go"
    return (
        f"{equal}, {_mechanism_name(worst)} lets"
        f" {with_interval(gap, 'share', absolute=True)} {more} of 100 people be linked"
        f" than fixed noise{limit}: {fails}"
    )


def _people_needed(n: float | None) -> str:
    """Return the number of people that would show equal linkage; empty if unknown."""
    if not n:
        return ""
    return f"; if truly equal, {rules.people_amount(n)} people would show it"


def _points(share: float, digits: int = 1) -> str:
    return f"{100.0 * share:.{digits}f}"
