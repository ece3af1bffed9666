"""The five questions that a run is read for, and a sentence on each, with its numbers."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from evaluation.analysis.families import CLEAN, RAW, SWEPT
from evaluation.analysis.keys import Where
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.reporting.bounds import gap_text
from evaluation.reporting.charts import share
from evaluation.reporting.headline import TASKS, Headline, Shown, headline, robot_name
from evaluation.reporting.markup import paragraphs
from evaluation.reporting.recommendation import screen_sentence
from evaluation.reporting.rows import HEADLINE, Results
from evaluation.verdict import rules

_MATTERS: Final = 0.05
_MOST_AHEAD: Final = 2  # Robots of which misses at the further horizon are told.
_LEADS: Final = {  # What an item's decision answers: the first that any item has.
    rules.DOES_NOT: "no",
    rules.TRACKS: "yes",
    rules.BETWEEN: "not shown either way",
    rules.NOT_TESTABLE: "not testable",
}
_QUESTIONS: Final = (
    ("What does the robot lose?", "Robot"),
    ("What still leaks?", "Leak"),
    ("Can people be linked?", "Links"),
    ("Do the descriptors tell?", "Tells"),
    ("Which level do I choose?", "Level"),
)


@dataclass(frozen=True, slots=True)
class Answer:
    """A question about a run, and what the run says to it."""

    question: str
    topic: str  # The question in a word or two.
    sentence: str  # Values in % with 95 % intervals.


def answers(run: Results, of: Headline | None = None) -> tuple[Answer, ...]:
    """Return the five answers of a run in their order; `of` is its first table, if at hand."""
    of = headline_of(run) if of is None else of
    where = reference(of)
    is_headline = where[0] not in of.known or of.known[where[0]].family in (*SWEPT, CLEAN)
    who = of.attacked.measure.source.label if of.attacked else ""
    told = _told(run.verdict.get("items", ()))
    every = (*of.robots, *of.future[:_MOST_AHEAD], *of.linked)
    found = {one: text for one in every if (text := _both(of, where, one))}
    said = paragraphs(
        "answers.sentences",
        _WORDS,
        of=of,
        level=of.name(where),
        lost=[(robot_name(one.measure.consumer), found[one]) for one in of.robots if one in found],
        ahead=[
            (robot_name(robot.measure.consumer), found[robot])
            for robot in of.future
            if robot in found
        ],
        beaten=_beaten(run.verdict.get("robots", ()), of.robots),
        shared=_both(of, where, of.shared),
        attacked=of.attacked and _both(of, where, of.attacked),
        other_law=of.attacked and of.at(where, of.attacked, other_law=True),
        worst=of.worst and of.at(where, of.worst),
        who=who if is_headline else "the strongest attack on it",
        near=gap_text(of.gaps, where),
        linked=[(one, found[one]) for one in of.linked if one in found],
        told=told,
        linked_near=gap_text(of.gaps, where, told[0]["task"]) if told else "",
        choice=screen_sentence(run),
    )
    return tuple(
        Answer(question, topic, sentence[:1].upper() + sentence[1:])
        for (question, topic), sentence in zip(_QUESTIONS, said, strict=True)
    )


def _beaten(
    robots: Sequence[Mapping[str, Any]], shown: Sequence[Shown]
) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the robots shown that lose to standing still, each where it does at most levels."""
    worst: dict[str, Mapping[str, Any]] = {}
    names = [robot.measure.consumer for robot in shown]
    for record in sorted(robots, key=lambda record: -len(record["loses"])):
        if record["loses"] and record["robot"] in names:
            worst.setdefault(record["robot"], record)
    return [(robot_name(name), worst[name]) for name in names if name in worst]


def headline_of(run: Results) -> Headline:
    """Return what the first table of a run shows."""
    return headline(
        run.summary,
        attacks=run.strongest,
        linkability=run.linkability,
        attacked=run.attacked,
        epsilon_m=float(run.manifest["settings"]["stages"]["privacy.epsilon_m"]),
    )


def reference(of: Headline) -> Where:
    """Return the level of the answers: the strictest FID, or what costs a robot most, or raw."""
    wheres = [where for where in of.wheres if of.known[where[0]].is_added]
    if named := [where for where in HEADLINE if where in wheres]:
        return named[0]
    plain = min(of.wheres, key=lambda where: where[0] != RAW, default=(RAW, None))
    costs = {where: one.value if (one := of.cost(where)) else -1.0 for where in wheres}
    return max(costs, key=costs.__getitem__, default=plain)


def _told(items: Sequence[Mapping[str, Any]]) -> tuple[Any, ...] | None:
    """Return the item of the widest spread, decisions counted, heads so decided, spread, ends."""
    mine = [one for one in items if one["section"] == rules.VALIDITY]
    mine = [one for one in mine if one["descriptor"] in DESCRIPTORS]
    if not mine:
        return None
    counts = Counter(one["decision"] for one in mine)
    of = [one for one in mine if one["decision"] == next(each for each in _LEADS if counts[each])]
    widest = max(of, key=lambda one: one["spread_low"] or 0.0)
    ends = ("spread", "spread_low", "spread_high")
    heads = dict.fromkeys(rules.NAME[one["descriptor"]] for one in of)
    return widest, counts, [*heads], *(f"{100.0 * (widest[name] or 0.0):.0f}" for name in ends)


def _how(one: Shown) -> str:
    task = one.measure.source.task
    text = TASKS[task][1] if task in TASKS else f"in {task}"
    return text + " (joint matching)" * one.is_joint


_WORDS: dict[str, Any] = {  # What the template calls.
    "share": share,
    "how": _how,
    "head": lambda item: rules.NAME[item["descriptor"]],
    # It does not tell because linkage falls where the descriptor does not.
    "is_steep": lambda item: item["spread_low"] <= rules.SUCCESS_MARGIN,
    "leads": _LEADS,
}


def _both(of: Headline, where: Where, one: Shown) -> str:
    """Return a number at a level; in brackets the other adding rule's, and raw's of a robot."""
    value = of.at(where, one)
    if value is None:
        return ""
    is_robot = one in of.robots or one.is_later
    raw = of.at((RAW, None), one) if is_robot and where[0] != RAW else None
    more = [f"raw {100 * raw.value:.1f} %"] if raw else []
    mine = of.known[where[0]]
    for twin in of.known.values():
        other = of.at((twin.mechanism, where[1]), one) if twin.name == mine.name else None
        if other and twin.adding not in ("", mine.adding):
            # Only if it is another: the intervals are apart, by what matters at least.
            apart = max(other.ci_low - value.ci_high, value.ci_low - other.ci_high)
            if apart > 0 and abs(other.value - value.value) >= _MATTERS:
                more.insert(0, f"{twin.adding.replace('independent', 'ind.')} {share(other)}")
    return share(value) + f" ({', '.join(more)})" * bool(more)
