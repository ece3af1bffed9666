"""The five questions that a run is read for, and a sentence on each, with its numbers."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np

from evaluation.analysis.families import ADDING_RULES, CLEAN, RAW, SWEPT
from evaluation.analysis.keys import Where
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE
from evaluation.analysis.strongest import BEYOND, by_task, strongest_of
from evaluation.reporting.bounds import gap_text
from evaluation.reporting.charts import share
from evaluation.reporting.headline import TASKS, Headline, Shown, headline, robot_name
from evaluation.reporting.rows import HEADLINE, Results
from evaluation.verdict import rules
from isac_track.intervals import Estimate

LIMIT: Final = 0.5
"""Of PLR after attack: below it most positions are kept; what the last answer looks for."""
_HELD: Final = "as far as these attacks go"
_MATTERS: Final = 0.05
_UNTESTED: Final = "not tested: "
_UNDOES: Final = {"repeats": "repeats", "anchor": "a known position"}
"""Who undoes what a slow error hides: who sees a walk twice, or knows where it once was."""
_EVIDENCE: Final = {"attacks": _HELD, "shown": "shown by linking more"}
_LEADS: Final = {
    rules.DOES_NOT: "no",
    rules.TRACKS: "yes",
    rules.BETWEEN: "not shown either way",
    rules.NOT_TESTABLE: "not testable",
}
"""What an item's decision answers: the first that any item has."""
_PLURAL: Final = {rules.TRACKS: "track", rules.DOES_NOT: "do not track"}


@dataclass(frozen=True, slots=True)
class Answer:
    """A question about a run, and what the run says to it."""

    question: str
    topic: str  # The question in a word or two.
    sentence: str  # Values in % with 95 % intervals.


def answers(run: Results, of: Headline | None = None) -> tuple[Answer, ...]:
    """Return the five answers of a run, in the order in which they are asked.

    `of` is what the first table shows, if who calls has it already.
    """
    if of is None:
        of = headline_of(run)
    where = reference(of)
    items = run.verdict.get("items", []) if run.verdict else []
    found = (
        ("What does the robot lose?", "Robot", _lost(of, where)),
        ("What still leaks?", "Leak", _leaks(of, where)),
        ("Can people be linked?", "Links", _linked(of, where)),
        ("Do the descriptors tell?", "Tells", _told(items)),
        ("Which level do I choose?", "Level", _chosen(of)),
    )
    return tuple(
        Answer(question, topic, sentence[:1].upper() + sentence[1:])
        for question, topic, sentence in found
    )


def headline_of(run: Results) -> Headline:
    """Return what the first table of a run shows."""
    return headline(run.summary, attacks=run.strongest, linkability=run.linkability)


def reference(of: Headline) -> Where:
    """Return the level that the answers speak of: the strictest FID, or what costs a robot most.

    Raw of a run that adds nothing, or what else there is.
    """
    wheres = [where for where in of.wheres if of.known[where[0]].is_added]
    if named := [where for one in HEADLINE for where in wheres if where == one]:
        return named[0]

    plain = min(of.wheres, key=lambda where: where[0] != RAW, default=(RAW, None))
    costs = {where: one.value if (one := of.cost(where)) else -1.0 for where in wheres}
    return max(costs, key=costs.__getitem__, default=plain)


def _lost(of: Headline, where: Where) -> str:
    """Return what noise costs the robots."""
    parts = []
    for one in of.robots:
        raw = of.at((RAW, None), one) if where[0] != RAW else None
        if value := _both(of, where, one, *[f"raw {100 * raw.value:.1f} %"] if raw else []):
            parts.append(f"{robot_name(one.measure.consumer)} {value}")
    told = f"missed conflicts at {of.name(where)}: {', '.join(parts)}."
    return told if parts else f"{_UNTESTED}the run has no predictor."


def _leaks(of: Headline, where: Where) -> str:
    """Return what is known of positions, as shared and after the strongest reconstruction."""
    shared = _both(of, where, of.shared)
    if not shared:
        return f"{_UNTESTED}the run has no descriptors."
    told = f"at {of.name(where)} {shared} of positions are known to 0.3 m as shared"
    if of.attacked is None:
        return f"{told}; what an attack makes of them was not tested."
    other = of.at(where, of.attacked, other_law=True)
    law = f" ({share(other)} if errors are isotropic)" if other else ""
    is_headline = of.known[where[0]].family in (*SWEPT, CLEAN)
    who = of.attacked.measure.source.label if is_headline else "the strongest attack on it"
    held = ", ".join(filter(None, [_HELD, gap_text(of.gaps, where)]))
    return f"{told}, {_both(of, where, of.attacked)}{law} after {who}, {held}."


def _linked(of: Headline, where: Where) -> str:
    """Return who is found again, beside chance."""
    found = [(value, one) for one in of.linked if (value := _both(of, where, one))]
    if not found:
        return f"{_UNTESTED}nobody links in this run."
    chances = ", ".join(f"{100 * one.chance:.1f}" for _, one in found)
    parts = ", ".join(f"{value} {_how(one)}" for value, one in found)
    return f"found again at {of.name(where)}: {parts}; chance {chances} %."


def _told(items: Sequence[Mapping[str, Any]]) -> str:
    """Return whether the descriptors tell how linkable people are."""
    mine = [
        one
        for one in items
        if one["section"] == rules.VALIDITY and one["descriptor"] in DESCRIPTORS
    ]
    if not mine:
        return f"{_UNTESTED}that takes levels of fixed noise, and somebody who links."
    counts = Counter(one["decision"] for one in mine)
    count = ", ".join(f"{n} {_PLURAL.get(one, one)}" for one, n in counts.items())
    decision = next(one for one in _LEADS if counts[one])
    of = [one for one in mine if one["decision"] == decision]
    widest = max(of, key=lambda one: one["spread_low"] or 0.0)
    ends = ("spread", "spread_low", "spread_high")
    spread, low, high = (f"{100.0 * (widest[name] or 0.0):.0f}" for name in ends)
    heads = ", ".join(dict.fromkeys(rules.NAME[one["descriptor"]] for one in of))
    head, needed = rules.NAME[widest["descriptor"]], widest["n_needed"]
    equal, where = f"at equal {head} linkage differs by", f"{widest['task']}, {widest['adding']}"
    if decision == rules.DOES_NOT:
        said = f"{equal} {spread} of 100 people, at least {low} ({where})"
        if widest["spread_low"] <= rules.SUCCESS_MARGIN:
            said = f"linkage falls where {head} hardly changes ({where})"
    elif decision == rules.NOT_TESTABLE:
        said = f"{where}: {widest['why']}"
    else:
        said = f"{equal} {low} to {high} of 100 people ({where})"
        if needed and decision == rules.BETWEEN:
            said += f"; were it equal, about {needed:.0f} people would show it"
    # What is so by construction decides nothing by itself.
    rests = "".join(f", {_EVIDENCE[one]}" for one in widest["evidence"] if one in _EVIDENCE)
    return f"{_LEADS[decision]} ({heads}): {said}{rests}; of {len(mine)} items {count}."


class _Choice(NamedTuple):
    """A level, the share of conflicts that a robot misses there, and PLR after attack."""

    at: Where
    cost: Estimate
    left: Estimate
    is_kept: bool = False  # Whether that is below the limit.
    has_interval: bool = False  # Whether any has an interval to be judged by.


def _choices(of: Headline) -> dict[str, _Choice]:
    """Return the level of fewest missed conflicts that keeps the limit, or the closest to it.

    By adding rule: "" where no mechanism has one.
    """
    # By the adversary of the table: `design` asks who is strongest at each level.
    options = [
        _Choice(where, cost, left)
        for where in of.wheres
        if of.attacked and (cost := of.cost(where)) and (left := of.at(where, of.attacked))
    ]
    # Nobody can choose to have no error at all; of a run of that alone it is told.
    options = [one for one in options if of.known[one.at[0]].family != CLEAN] or options
    rule_of = {one: of.known[one.at[0]].adding for one in options}
    found = {}
    for rule in [one for one in ADDING_RULES if one in rule_of.values()] or [""] * bool(options):
        some = [one for one in options if rule_of[one] in ("", rule)]
        has = any(np.isfinite(one.left.ci_high) for one in some)
        kept = [one for one in some if (one.left.ci_high if has else one.left.value) <= LIMIT]
        first = attrgetter("cost.value" if kept else "left.value")
        best = min(kept or some, key=first)
        found[rule] = best._replace(is_kept=bool(kept), has_interval=has)
    return found


def chosen_levels(of: Headline) -> list[Where]:
    """Return the levels that the last answer names."""
    return list(dict.fromkeys(one.at for one in _choices(of).values()))


def _chosen(of: Headline) -> str:
    """Return the level that costs a robot least while most positions stay unknown after attack."""
    said = {rule: _choice(of, one) for rule, one in _choices(of).items()}
    if not said:
        return f"{_UNTESTED}that takes a predictor and a reconstruction attack."
    texts = list(dict.fromkeys(said.values()))
    ruled = texts if len(texts) == 1 else [f"{rule}: {one}" for rule, one in said.items()]
    return f"{'; '.join(ruled)}; {_HELD}."


def _choice(of: Headline, one: _Choice) -> str:
    """Return what to choose, with what it costs and what is left to attacks."""
    at, limit, left, cost = (
        one.at,
        f"attacked PLR below {100 * LIMIT:g} %",
        *map(share, one[2:0:-1]),
    )
    few = "by the values alone, since so few people have no interval, "
    by = "" if one.has_interval else few
    if not one.is_kept:
        least = f"{left} at {of.name(at)}, which misses {cost} of the conflicts"
        return f"{by}no level keeps {limit}; the least is {least}"
    again = [
        f"; found again {_how(linked)}: {share(found)}"
        for linked in of.linked[-1:]
        if (found := of.at(at, linked))
    ]
    everybody = by_task(of.found, metric=EXPOSURE)[""][at]
    more = {
        name: f"{name} {share(of.found[best.measure(EXPOSURE).at(*at)])}"
        for name in BEYOND
        if (best := strongest_of([everybody], among=(name,)))
    }
    untried = ", ".join(words for name, words in _UNDOES.items() if name not in more)
    known = ", ".join(more.values()), untried and f"not tried: {untried}"
    beyond = "; ".join(filter(None, known))
    fewest = f"{of.name(at)} misses fewest conflicts: {cost} at {left} ({beyond})"
    return f"{by}of the levels that keep {limit}, {fewest}" + "".join(again)


def _how(one: Shown) -> str:
    """Return how people are found again."""
    task = one.measure.source.task
    return TASKS[task][1] if task in TASKS else f"in {task}"


def _both(of: Headline, where: Where, one: Shown, *beside: str) -> str:
    """Return a number at a level; in brackets the other adding rule's if it is another, and more.

    It is another if the intervals are apart, by what matters at least.
    """
    value, more = of.at(where, one), list(beside)
    if value is None:
        return ""
    mine = of.known[where[0]]
    for twin in of.known.values():
        other = of.at((twin.mechanism, where[1]), one) if twin.name == mine.name else None
        if other and twin.adding not in ("", mine.adding):
            apart = max(other.ci_low - value.ci_high, value.ci_low - other.ci_high)
            if apart > 0 and abs(other.value - value.value) >= _MATTERS:
                more.insert(0, f"{twin.adding.replace('independent', 'ind.')} {share(other)}")
    return share(value) + f" ({', '.join(more)})" * bool(more)
