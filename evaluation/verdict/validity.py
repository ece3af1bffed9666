"""Section a of the verdict: how often are people linked at equal descriptor value.

Over the levels of one mechanism descriptor and linkability fall together for free. What
measures linkability does so whatever the mechanism: at one value of it, fixed noise,
FID and the dissociation controls must let equally many people be linked. Who is
compared is in `panel`, what follows in `spread`; here are items and words.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from evaluation.estimates.families import ADDING_RULES, Family
from evaluation.estimates.keys import where_text
from evaluation.estimates.linked_people import LinkedTask
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.verdict import rules, spread
from evaluation.verdict.panel import Panel, Sums, contrasts, drawn_weights, panel
from evaluation.verdict.prediction_error import WHITE, Squared, prediction_errors
from evaluation.verdict.rules import BETWEEN, NAME, known, with_interval
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

CONSTRUCTION, SHOWN, ATTACKS = "construction", "shown", "attacks"
"""Kinds of evidence: the task hides what the mechanism changes; more people are linked; fewer are,
as far as these attacks go."""
FALLING: Final = (
    "alignment_error",
    "posterior_std",
)  # Larger, the less is left of a track.
_N_FOR_ERRORS: Final = 200  # Replicates that a prediction error is described with.
OTHER_HALF: Final = "rank 1 of the other half of the people"
"""The positive control: if anything tells how linkable people are, this does."""
_ONLY: Final = {ONLY_MORE: "more", ONLY_FEWER: "fewer"}
_WHY_ONE_SIDED: Final = {
    ONLY_MORE: "has a lower {} than any fixed noise, so that only more could be seen",
    ONLY_FEWER: "has a higher {} than raw, so that only fewer could be seen",
    NEITHER: "has a {} of too few people",
}
Errors: TypeAlias = "tuple[Squared, Squared] | None"  # Of a descriptor, and of none.
_QUARTILE: Final = dict(zip(spread.QUARTILES, ("low", "middle", "high"), strict=True))


@dataclass(frozen=True, eq=False, slots=True)
class Tested:
    """A descriptor in a task under an adding rule, before its section is decided."""

    of: Panel
    descriptor: str
    found: Contrasts
    beside: Contrasts | None = None  # Of mechanisms that the panel has not.
    errors: Errors = None

    @property
    def n(self) -> int:
        """Clusters, the least over all contrasts."""
        return int(self.found.people.min(initial=max(self.found.people, default=0)))


def validity(
    tasks: Sequence[LinkedTask],
    *,
    families: Mapping[str, Family],
    preset: str,
    dataset: str,
    seed: int,
) -> dict[str, list[dict[str, Any]]]:
    """Return items, positive controls, and descriptors on trial; `families` are by mechanism."""
    tested: list[Tested] = []
    halves: list[Tested] = []
    on_trial: list[dict[str, Any]] = []
    for task in tasks:
        weights = drawn_weights(task, tasks, dataset, seed)
        names = task.levels[0].descriptors
        drawn = {
            name: (sums := _sums(task, name), sums.drawn(weights)) for name in names
        }
        half = _half(task, next(iter(drawn.values()))[0], seed)
        for adding in ADDING_RULES:
            of = panel(task, families, adding=adding, preset=preset)
            if of is None:
                continue
            errors = {
                name: _errors(of, name, rates) for name, (_, rates) in drawn.items()
            }
            on_trial += _on_trial(of, errors)
            for name in DESCRIPTORS:
                if name in drawn:
                    sums, rates = drawn[name]
                    own = contrasts(sums, rates, of, others=of.others, fid=of.fid)
                    more = (
                        contrasts(sums, rates, of, others=of.beside)
                        if of.beside
                        else None
                    )
                    tested.append(Tested(of, name, own, more, errors[name]))
            own = contrasts(half, half.drawn(weights), of, others=of.others, fid=of.fid)
            halves.append(Tested(of, "", own))
    section, apart = (
        spread.together([one.found for one in of]) for of in (tested, halves)
    )
    return {
        "items": [_item(one, section) for one in tested],
        "controls": [_control(one, apart) for one in halves],
        "on_trial": on_trial,
    }


def _sums(task: LinkedTask, name: str) -> Sums:
    of = [(one.success, one.probes, *one.descriptors[name]) for one in task.levels]
    return Sums(*map(np.array, zip(*of, strict=True)))


def _half(task: LinkedTask, every: Sums, seed: int) -> Sums:
    """Return one half of the people, whose descriptor is how many of the other half are linked."""
    order = stream(seed, "halves", task.task).permutation(len(task.clusters))
    mine = order < len(task.clusters) / 2
    linked = every.success, every.probes
    return Sums(*(one * mine for one in linked), *(one * ~mine for one in linked))


def _errors(of: Panel, name: str, rates: tuple[Floats, Floats]) -> Errors:
    """Return the squared prediction error of a descriptor, and that without one."""
    levels = [*of.fixed, *of.fid[:-1], *of.others]
    success, shows = (one[: 1 + _N_FOR_ERRORS, levels] for one in rates)
    families = [of.families[place] for place in levels]
    kinds = ["white" if family in WHITE else family for family in families]
    return prediction_errors(-shows if name in FALLING else shows, success, kinds)


def _on_trial(of: Panel, errors: Mapping[str, Errors]) -> list[dict[str, Any]]:
    """Return how well each descriptor foretells linkage, and whether one does so surely best."""
    have = {name: pair[0] for name, pair in errors.items() if pair is not None}
    return [
        {
            "adding": of.adding,
            "task": of.task.task,
            "descriptor": name,
            **_error_numbers(errors[name]),
            "surely_lowest": (
                len(have) > 1
                and all(
                    one.less(mine).ends[0] > 0
                    for rival, one in have.items()
                    if rival != name
                )
            ),
        }
        for name, mine in have.items()
    ]


def _error_numbers(pair: Errors) -> dict[str, float | None]:
    keys = ("prediction_error", "prediction_error_low", "prediction_error_high")
    values = (None, None, None) if pair is None else pair[0].roots
    null = None if pair is None else pair[1].roots[0]
    return {**dict(zip(keys, values, strict=True)), "prediction_error_null": null}


def _item(one: Tested, section: Floats) -> dict[str, Any]:
    """Return an item as in `verdict.json`."""
    of, found = one.of, one.found
    wide, answer = _answer(one, section, span=found.span[:1])
    decision, low, high = (
        answer[name] for name in ("decision", "spread_low", "spread_high")
    )
    compared, beside = _contrasts(of, of.compared, found, wide), []
    if one.beside is not None:
        beside = _contrasts(
            of, of.beside, one.beside, spread.widths(one.beside, section)
        )
    is_flat = decision == rules.DOES_NOT and low <= rules.SUCCESS_MARGIN
    # What is so by construction decided nothing. What is equal, and what a flat
    # descriptor misses, is so as far as these attacks go.
    sure = {gap["evidence"] for gap in compared if gap["reading"] == rules.DIFFERS}
    kinds = sorted(sure - {CONSTRUCTION}) if sure and not is_flat else [ATTACKS]
    answers = spread.answers(found, wide, [of.families[place] for place in of.compared])
    needed = None if is_flat else spread.clusters_needed(found, wide, one.n)
    why = f"between {_points(low)} and {_points(high)} of 100 people" * (
        decision == BETWEEN
    )
    said = {
        "id": f"{rules.VALIDITY}/{of.adding}/{one.descriptor}/{of.task.task}",
        "section": rules.VALIDITY,
        "adding": of.adding,
        "descriptor": one.descriptor,
        "task": of.task.task,
        "subject": of.task.levels[of.fixed[-1]].linker.attack.label,
        "criterion": "",
        **answer,
        "sign": rules.SIGN[decision],
        "effect": answer["spread"],
        "ci_low": low,
        "ci_high": high,
        "unit": "fraction",
        "metric": "rank1" if of.task.gallery is None else "rank1_g100",
        **_error_numbers(one.errors),
        "evidence": kinds if decision in (rules.DOES_NOT, rules.TRACKS) else [],
        "power": spread.of_each(answers),
        "power_if": answers,
        "n": one.n,
        "n_needed": needed,
        "why": _why_not(one, wide) if decision == rules.NOT_TESTABLE else why,
        "contrasts": compared + beside,
    }
    return {**said, "sentence": _sentence(one, said)}


def _control(one: Tested, section: Floats) -> dict[str, Any]:
    """Return the record of a positive control: it must not be said to fail."""
    # Of linkage itself any span will do.
    _, answer = _answer(one, section, span=np.full(1, np.inf))
    about = {
        "adding": one.of.adding,
        "task": one.of.task.task,
        "descriptor": OTHER_HALF,
    }
    return {**about, **answer, "n": one.n}


def _answer(
    one: Tested, section: Floats, *, span: Floats
) -> tuple[Widths, dict[str, Any]]:
    """Return how far the ends lie from the estimates, and decision and spread."""
    wide, found = spread.widths(one.found, section), one.found
    gaps, fall = found.gaps[:1], found.fall[:1]
    codes, low, high = spread.decided(found, wide, gaps=gaps, fall=fall, span=span)
    return wide, {
        "decision": spread.ANSWERS[codes[0]],
        "spread": spread.shown(found),
        "spread_low": float(low[0]),
        "spread_high": float(high[0]),
    }


def _contrasts(
    of: Panel, places: Sequence[int], found: Contrasts, wide: Widths
) -> list[dict[str, Any]]:
    """Return contrasts as in `verdict.json`, each with its own interval, not adjusted."""
    low, high = (one[0] for one in spread.ends(found, wide, found.gaps[:1]))
    own = spread.intervals(found)
    rows = []
    for k, (place, gap) in enumerate(zip(places, found.gaps[0].tolist(), strict=True)):
        level = of.task.levels[place]
        readings = {
            rules.NOT_TESTABLE: found.side[k] == NEITHER,
            rules.DIFFERS: low[k] > rules.SUCCESS_MARGIN,
            rules.EQUAL: high[k] < rules.SUCCESS_MARGIN,
        }
        shown = SHOWN if gap > 0 else ATTACKS
        rows.append(
            {
                "mechanism": level.mechanism,
                "level": None if place in of.fid else level.level,
                "quartile": spread.QUARTILES[k] if place in of.fid else None,
                "subject": level.linker.attack.label,
                "effect": gap if np.isfinite(found.errors[k]) else None,
                "ci_low": known(own[0][k]),
                "ci_high": known(own[1][k]),
                "unit": "fraction",
                "n": int(found.people[k]),
                "reading": next(
                    (name for name, is_so in readings.items() if is_so), BETWEEN
                ),
                "evidence": CONSTRUCTION if of.is_hidden(place) else shown,
                "only": _ONLY.get(int(found.side[k]), ""),
                "in_panel": place not in of.beside,
            }
        )
    return rows


def _named(gap: Mapping[str, Any]) -> str:
    """Return the mechanism of a contrast as people write it."""
    if gap["quartile"] is not None:
        return f"{gap['mechanism']} ({_QUARTILE[gap['quartile']]})"
    return where_text(gap["mechanism"], gap["level"])


def _why_not(one: Tested, wide: Widths) -> str:
    """Return why it cannot be tested whether a descriptor tracks."""
    of, found = one.of, one.found
    raw = of.task.levels[of.fixed[-1]]
    links, guess = (
        float(sums.sum() / raw.probes.sum()) for sums in (raw.success, raw.chance)
    )
    fall, name = float(found.fall[0]), NAME[one.descriptor]
    odd = [
        f"{where_text(level.mechanism, level.level)}"
        f" {_WHY_ONE_SIDED[side].format(name)}"
        for place, side in zip(of.compared, found.side.tolist(), strict=True)
        for level in [of.task.levels[place]]
        if side != BOTH
    ]
    effective = found.fall_degrees + 1
    if effective < FEWEST_EFFECTIVE:
        return (
            f"it rests on {one.n} people or groups, who count as {effective:.0f}: "
            f"{FEWEST_EFFECTIVE} are needed"
        )
    if found.fall_error < rules.NO_SPREAD:
        return "all people fare alike: that says nothing of others"
    if links - guess < rules.SUCCESS_MARGIN:
        return (
            f"the strongest attack links {_points(links)} of 100 people even at raw, "
            f"a guess {_points(guess)}: nothing could be seen"
        )
    if fall - wide.fall < rules.LEAST_FALL:
        low, high = (_points(fall + sign * wide.fall) for sign in (-1, 1))
        least = _points(rules.LEAST_FALL, 0)
        return (
            f"linkage falls by {_points(fall)} [{low}, {high}] of 100 people from raw "
            f"to the strongest fixed error, not surely by {least}: anything would track"
        )
    return of.missing or "; ".join(dict.fromkeys(odd))


def _sentence(one: Tested, said: Mapping[str, Any]) -> str:
    """Return what an item says."""
    name, decision, low = NAME[one.descriptor], said["decision"], said["spread_low"]
    task = one.of.task.task
    where = f"In {task}{'' if one.of.task.gallery else ' (plain rank 1, galleries of its own)'}"
    equal = f"{where}, at equal {name}"
    either = "more or fewer be linked than fixed noise"
    fails = f"{name} does not track."
    if decision == rules.NOT_TESTABLE:
        return f"In {task}, whether {name} tracks cannot be tested: {said['why']}."
    if decision == rules.TRACKS:
        high = _points(said["spread_high"])
        return (
            f"{equal}, no mechanism lets {high} of 100 people {either}: {name} tracks."
        )
    if decision == BETWEEN:
        would = _people_needed(said["n_needed"])
        return f"{equal}, mechanisms let {said['why']} {either}{would}."
    if low <= rules.SUCCESS_MARGIN:
        fall, span = _points(one.found.fall[0]), np.exp(one.found.span[0])
        return (
            f"{where}, from raw to the strongest fixed error {fall} fewer of 100 people"
            f" are linked while {name} hardly changes ({span:.2f} times): {fails}"
        )
    worst = max(
        (
            gap
            for gap in said["contrasts"]
            if gap["reading"] == rules.DIFFERS and gap["in_panel"]
        ),
        key=lambda gap: (gap["evidence"] != CONSTRUCTION, abs(gap["effect"])),
    )
    gap = Estimate(*(worst[key] for key in ("effect", "ci_low", "ci_high")))
    more, held = (
        ("more", "") if gap.value > 0 else ("fewer", ", as far as these attacks go")
    )
    return (
        f"{equal}, {_named(worst)} lets {with_interval(gap, 'share', absolute=True)}"
        f" {more} of 100 people be linked than fixed noise{held}: {fails}"
    )


def _people_needed(n: float | None) -> str:
    """Return how many people would show that linkage is equal, if it is; empty if unknown."""
    if not n:
        return ""
    many = (
        f"about {float(f'{n:.2g}'):,.0f}"
        if n < rules.MOST_PEOPLE
        else "no realistic number of"
    )
    return f"; if truly equal, {many} people would show it"


def _points(share: float, digits: int = 1) -> str:
    return f"{100.0 * share:.{digits}f}"
