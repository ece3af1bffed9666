"""The five questions that a run is read for, each answered in a few plain sentences."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from evaluation.estimates.families import CLEAN, RAW, SWEPT
from evaluation.estimates.keys import Where
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.reporting.amounts import (
    PERCENT,
    bare_percent,
    listed,
    percent,
    sentence_case,
    whole,
)
from evaluation.reporting.bounds import gap_text
from evaluation.reporting.headline import Headline, Shown
from evaluation.reporting.lookups import HEADLINE, family_of
from evaluation.reporting.names import (
    adding_phrase,
    attack_name,
    descriptor_name,
    is_built_in_robot,
    mechanism_phrase,
    robot_subject,
    task_phrase,
)
from evaluation.reporting.recommendation import share_answer, share_details
from evaluation.reporting.rows import Results
from evaluation.verdict import rules
from isac_track.intervals import Estimate

_MATTERS: Final = 0.05  # Difference between the adding rules that a sentence mentions.
_LEADS: Final = (rules.DOES_NOT, rules.TRACKS, rules.BETWEEN, rules.NOT_TESTABLE)
"""Decisions of the items on descriptors: the first that any item has is the answer."""


_RULE_NOISE: Final = {
    "linear": "noise as in the paper",
    "independent": "independent noise",
}
"""Adding rules, in brackets."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A question about a run, and the answer of the run."""

    question: str
    topic: str  # The question in a word.
    # What the first screen says: shares in % with half of their 95 % interval.
    sentence: str
    details: tuple[str, ...] = ()  # Further sentences, for the page and `--verbose`.


def answers(
    run: Results, first: Headline | None = None, *, names_level: bool = True
) -> tuple[Answer, ...]:
    """Return the five answers of a run in their order; `first` is its first table, if at hand.

    Without `names_level` the first three do not say which level they are about: it is
    `reference(first)`.
    """
    table = headline_of(run) if first is None else first
    where, items = reference(table), run.verdict.get("items", ())
    robot = lead_robot(table, best=best_robot(run))
    beaten = beaten_by_standing_still(table, run.verdict.get("robots", ()))
    start = f"With {level_phrase(table, where)}, " if names_level else ""
    said = {
        ("What does the robot lose?", "Robot"): (
            _robot_sentence(table, where, robot, beaten, start=start),
            _robot_details(table, where, robot),
        ),
        ("What still leaks?", "Leak"): (
            _leak_sentence(table, where, start=start),
            _leak_details(table, where),
        ),
        ("Can people be linked?", "Links"): (
            _links_sentence(table, where, start=start),
            _links_details(table, where),
        ),
        ("Do the descriptors tell?", "Descriptors"): (
            _descriptors_sentence(items),
            _descriptors_details(items, table, where),
        ),
        ("What should I share?", "Share"): (share_answer(run), share_details(run)),
    }
    return tuple(Answer(*question, *answer) for question, answer in said.items())


def headline_of(run: Results) -> Headline:
    """Return the first table of a run."""
    return run.headline


def reference(table: Headline) -> Where:
    """Return the level of the answers: the strictest FID, or what costs a robot most, or raw."""
    wheres = [where for where in table.wheres if table.known[where[0]].is_added]
    if named := [where for where in HEADLINE if where in wheres]:
        return named[0]
    plain = min(table.wheres, key=lambda where: where[0] != RAW, default=(RAW, None))
    costs = {
        where: cost.value if (cost := table.cost(where)) else -1.0 for where in wheres
    }
    return max(costs, key=costs.__getitem__, default=plain)


def best_robot(run: Results) -> str:
    """Return the robot by which levels are chosen: of two chosen ones the first; empty if none."""
    return next(iter(run.recommendation().robots), "")


def lead_robot(table: Headline, *, best: str = "") -> Shown | None:
    """Return the robot that the first screen shows, by the conflicts that are still to come.

    A user's own predictor comes first, then the `best` of the run, then the first.
    """
    robots = table.future or list(table.robots)
    own = [shown for shown in robots if not is_built_in_robot(shown.measure.consumer)]
    usual = [shown for shown in robots if shown.measure.consumer == best]
    return next(iter([*own, *usual, *robots]), None)


def _robot_sentence(
    table: Headline,
    where: Where,
    robot: Shown | None,
    beaten: Sequence[tuple[str, int, int]],
    *,
    start: str,
) -> str:
    """Return what a robot misses at a level, and whether a robot loses to standing still."""
    missed = table.at(where, robot) if robot else None
    if robot is None or missed is None:
        return "Not tested: the run has no predictor."
    subject = robot_subject(robot.measure.consumer)
    conflicts = "future conflicts" if robot.is_later else "conflicts"
    raw = _raw_beside(table, where, robot)
    sentences = [
        sentence_case(
            f"{start}{subject} misses {percent(missed)} of {conflicts}{raw}."
        ),
        *_other_rule(table, where, [robot]),
    ]
    if beaten:
        # The shown robot counts most, else the first that loses.
        name, n_loses, n_levels = next(
            (row for row in beaten if row[0] == robot.measure.consumer), beaten[0]
        )
        sentences.append(
            f"At {n_loses} of {n_levels} levels, expecting people to stand beats "
            f"{robot_subject(name)}."
        )
    return " ".join(sentences)


def beaten_by_standing_still(
    table: Headline, records: Sequence[Mapping[str, Any]]
) -> list[tuple[str, int, int]]:
    """Return shown robots that lose to standing still: name, levels where they lose, levels."""
    names = [robot.measure.consumer for robot in table.robots]
    worst: dict[str, tuple[str, int, int]] = {}
    for record in sorted(records, key=lambda record: -len(record["loses"])):
        name = record["robot"]
        if record["loses"] and name in names:
            worst.setdefault(name, (name, len(record["loses"]), record["levels"]))
    return sorted(worst.values(), key=lambda row: names.index(row[0]))


def _robot_details(
    table: Headline, where: Where, robot: Shown | None
) -> tuple[str, ...]:
    """Return what the other robots miss, each at both horizons."""
    sentences = []
    for shown in (*table.future, *table.robots):
        missed = table.at(where, shown)
        if missed is None or shown == robot:
            continue
        conflicts = "all conflicts"
        if shown.is_later:
            conflicts = f"future conflicts within {table.horizon_s:g} s"
        subject = sentence_case(robot_subject(shown.measure.consumer))
        raw = _raw_beside(table, where, shown)
        sentences.append(f"{subject} misses {percent(missed)} of {conflicts}{raw}.")
    return tuple(sentences)


def _leak_sentence(table: Headline, where: Where, *, start: str) -> str:
    """Return how many positions are known as sent and after an attack."""
    shared = table.at(where, table.shared)
    if shared is None:
        return "Not tested: the run has no descriptors."
    known = sentence_case(
        f"{start}{percent(shared)} of positions are known to {table.epsilon_m:g} m as"
        " sent"
    )
    attacked = table.at(where, table.attacked) if table.attacked else None
    if table.attacked is None or attacked is None:
        return f"{known}. The run has no attack on them."
    columns = [table.shared, table.attacked]
    other = _other_rule(table, where, columns)
    return " ".join([f"{known}, {percent(attacked)} after an attack.", *other])


def _leak_details(table: Headline, where: Where) -> tuple[str, ...]:
    """Return which attack it is, and the numbers under other assumptions."""
    column = table.attacked
    if column is None or table.at(where, column) is None:
        return ()
    is_headline = where[0] not in table.known or table.known[where[0]].family in (
        *SWEPT,
        CLEAN,
    )
    source = column.measure.source
    attack = f"the {attack_name(source.consumer)} ({source.label})"
    if not is_headline:
        attack = "the strongest against this mechanism"
    sentences = [f"The attack is {attack}. A stronger attack may know more."]
    if table.worst and (worst := table.at(where, table.worst)):
        sentences.append(
            f"Of the most exposed tenth of people it knows {percent(worst)}."
        )
    if isotropic := table.at(where, column, other_law=True):
        sentences.append(
            "The run assumes the error law of the paper, along the line of sight. "
            f"With isotropic errors the attack knows {percent(isotropic)}."
        )
    if gap := gap_text(table.gaps, where):
        sentences.append(gap)
    return tuple(sentences)


def _links_sentence(table: Headline, where: Where, *, start: str) -> str:
    """Return how many people an attack re-identifies, in the first two tasks of the table."""
    numbers = _linked_numbers(table, where)[:2]
    if not numbers:
        return "Not tested: the run has no linkage task with a linkage attack."
    (lead, rank1), *further = numbers
    phrase = task_phrase(lead.measure.source.task)
    sentence = f"{start}{phrase} {percent(rank1)} of people are re-identified"
    for column, later in further:
        phrase = task_phrase(column.measure.source.task).removesuffix(" of silence")
        sentence += f", {phrase} {bare_percent(later)}"
    other = _other_rule(table, where, [column for column, _ in numbers])
    return " ".join([sentence_case(f"{sentence}."), *other])


def _links_details(table: Headline, where: Where) -> tuple[str, ...]:
    """Return each task with its attack, its chance and the size of its gallery."""
    sentences = []
    for column, rank1 in _linked_numbers(table, where):
        source = column.measure.source
        phrase = sentence_case(task_phrase(source.task))
        way = " It matches all people at once." if column.is_joint else ""
        sentences.append(
            f"{phrase}, the strongest attack is {source.attack.label} with"
            f" {percent(rank1)}.{way}"
        )
        if math.isfinite(column.candidates):
            chance = whole(PERCENT * column.chance)
            sentences.append(
                f"Guessing among {column.candidates:.0f} people finds {chance} %."
            )
    return tuple(sentences)


def _linked_numbers(table: Headline, where: Where) -> list[tuple[Shown, Estimate]]:
    """Return the linkage tasks that have a number at a level."""
    numbers = [(column, table.at(where, column)) for column in table.linked]
    return [(column, rank1) for column, rank1 in numbers if rank1 is not None]


def level_phrase(table: Headline, where: Where) -> str:
    """Return a level in the middle of a sentence."""
    return mechanism_phrase(family_of(table.known, where[0]), where[1])


def _descriptor_items(items: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the items of the verdict on the descriptors of the paper."""
    own = [item for item in items if item["section"] == rules.VALIDITY]
    return [item for item in own if item["descriptor"] in DESCRIPTORS]


def _leading_item(items: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the item of the widest spread among those that have the leading decision."""
    decisions = {item["decision"] for item in items}
    lead = next(decision for decision in _LEADS if decision in decisions)
    leading = [item for item in items if item["decision"] == lead]
    return max(leading, key=lambda item: item["spread_low"] or 0.0)


def _descriptors_sentence(items: Sequence[Mapping[str, Any]]) -> str:
    """Return whether PLR, AEL and MEL say how linkable people are."""
    own = _descriptor_items(items)
    if not own:
        return "Not tested: that takes levels of fixed noise and a linkage attack."
    lead = _leading_item(own)
    same = [item for item in own if item["decision"] == lead["decision"]]
    names = list(dict.fromkeys(descriptor_name(item["descriptor"]) for item in same))
    under = list(dict.fromkeys(item["adding"] for item in own))
    shown = list(dict.fromkeys(item["adding"] for item in same))
    # Where the adding rules disagree, the sentence says under which the decision holds.
    where = f" ({_RULE_NOISE[shown[0]]})" if len(shown) < len(under) else ""
    return _decision_sentence(lead, names, where=where)


def _decision_sentence(
    item: Mapping[str, Any], names: Sequence[str], *, where: str
) -> str:
    """Return the decision of an item in words, with by how much linkage differs."""
    low, high = (
        whole(PERCENT * (item[name] or 0.0)) for name in ("spread_low", "spread_high")
    )
    several = len(names) > 1
    subject = f"The {listed(names)}"
    if len(names) == len(DESCRIPTORS):
        subject = "The paper's three descriptors"
    says_not = "do not say" if several else "does not say"
    says = "say" if several else "says"
    head = descriptor_name(item["descriptor"])
    match item["decision"]:
        case rules.DOES_NOT if (item["spread_low"] or 0.0) <= rules.SUCCESS_MARGIN:
            return (
                f"{subject} {says_not} how linkable people are: linkage falls where the"
                f" {head} hardly changes{where}."
            )
        case rules.DOES_NOT:
            return (
                f"{subject} {says_not} how linkable people are: at equal values,"
                f" linkage differs by at least {low} points{where}."
            )
        case rules.TRACKS:
            return (
                f"{subject} {says} how linkable people are: at equal values, linkage"
                f" differs by {low} to {high} points{where}."
            )
        case rules.BETWEEN:
            needed = item.get("n_needed")
            more = f" {people_needed(needed)}" if needed else ""
            return (
                f"The run cannot say whether the {head} tells how linkable people are."
                f" At equal values, linkage differs by {low} to {high}"
                f" points{where}.{more}"
            )
    # The reason in short: the details have it in full.
    why = item["why"].partition(": ")[0].partition(", not surely")[0]
    return f"The run cannot test the descriptors: {why}."


def people_needed(n: float) -> str:
    """Return how many people would decide an item that is open now."""
    if not n < rules.MOST_PEOPLE:
        return "No realistic number of people would decide it."
    return f"About {float(f'{n:.2g}'):,.0f} people would decide it."


def _descriptors_details(
    items: Sequence[Mapping[str, Any]], table: Headline, where: Where
) -> tuple[str, ...]:
    """Return where the answer comes from, on which evidence, and all decisions counted."""
    own = _descriptor_items(items)
    if not own:
        return ()
    lead = _leading_item(own)
    head = descriptor_name(lead["descriptor"])
    how = f"{task_phrase(lead['task'])}, with {adding_phrase(lead['adding'])}"
    spread = whole(PERCENT * (lead["spread"] or 0.0))
    sentences = [f"The widest spread is {spread} of 100 people at equal {head}, {how}."]
    if lead["decision"] == rules.NOT_TESTABLE:
        sentences = [f"Not testable {how}: {lead['why']}."]
    if "shown" in lead["evidence"]:
        sentences.append("An attack that links more people shows it.")
    if "attacks" in lead["evidence"]:
        sentences.append(
            "It holds as far as these attacks go; a stronger attack may change it."
        )
        if gap := gap_text(table.gaps, where, lead["task"]):
            sentences.append(gap)
    counts = Counter(item["decision"] for item in own)
    decided = listed([f"{n} {decision!r}" for decision, n in counts.items()])
    sentences.append(f"Decisions on all {len(own)} items: {decided}.".replace("'", '"'))
    return tuple(sentences)


def _raw_beside(table: Headline, where: Where, column: Shown) -> str:
    """Return raw's number in brackets; empty at raw itself, or where it is unknown."""
    raw = table.at((RAW, None), column) if where[0] != RAW else None
    return f" (raw positions: {bare_percent(raw)})" if raw else ""


def _other_rule(table: Headline, where: Where, columns: Sequence[Shown]) -> list[str]:
    """Return a sentence with the numbers under the other adding rule, where any clearly differs.

    A number clearly differs if the intervals are apart and the values by five points.
    """
    own = family_of(table.known, where[0])
    for twin in table.known.values():
        if twin.name != own.name or twin.adding in ("", own.adding):
            continue
        pairs = [
            (table.at(where, column), table.at((twin.mechanism, where[1]), column))
            for column in columns
        ]
        known = [(value, other) for value, other in pairs if value and other]
        if len(known) == len(pairs) and any(
            _differ(value, other) for value, other in known
        ):
            shares = listed([percent(other) for _, other in known])
            return [f"With {adding_phrase(twin.adding)}: {shares}."]
    return []


def _differ(value: Estimate, other: Estimate) -> bool:
    apart = max(other.ci_low - value.ci_high, value.ci_low - other.ci_high)
    return apart > 0 and abs(other.value - value.value) >= _MATTERS
