"""The questions about a run, each answered in a few plain sentences."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from evaluation.estimates.families import AT_RAW, CLEAN, PAPER_FAMILIES, RAW
from evaluation.estimates.metrics import PAPER_DESCRIPTORS
from evaluation.plan.address import MechanismLevel
from evaluation.reporting.amounts import (
    PERCENT,
    bare_percent,
    listed,
    percent,
    round_percent,
    sentence_case,
)
from evaluation.reporting.bounds import gap_text
from evaluation.reporting.headline import Headline, HeadlineColumn
from evaluation.reporting.lookups import MAIN_LEVELS, find_family
from evaluation.reporting.names import (
    adding_phrase,
    attack_name,
    descriptor_name,
    is_built_in_robot,
    robot_subject,
    task_phrase,
)
from evaluation.reporting.patrol_words import patrol_sentence
from evaluation.reporting.recommendation import share_answer, share_details
from evaluation.reporting.return_words import (
    QUESTION,
    TOPIC,
    return_details,
    return_sentence,
)
from evaluation.reporting.rows import Results
from evaluation.verdict import rules
from evaluation.verdict.number_text import people_amount
from isac_track.intervals import Estimate

_MATTERS: Final = 0.05  # Difference between the adding rules that a sentence mentions.
_LEADS: Final = (rules.DOES_NOT, rules.TRACKS, rules.BETWEEN, rules.NOT_TESTABLE)
"""Decisions of the items on descriptors: the first that any item has is the answer."""

_RULE_NOISE: Final = {
    "linear": "noise as in the paper",
    "independent": "independent noise",
}
"""By adding rule: the words in brackets."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A question about a run, and its answer."""

    question: str
    topic: str  # The question in a word.
    # The text of the first screen: shares in % with half of their 95 % interval.
    sentence: str
    details: tuple[str, ...] = ()  # Further sentences, for the page and `--verbose`.


@dataclass(frozen=True, slots=True)
class LosingRobot:
    """A robot that misses more conflicts than if it expected people to stand still."""

    name: str
    n_lost: int  # Levels at which it loses.
    n_levels: int


def answers(
    run: Results, table: Headline | None = None, *, names_level: bool = True
) -> tuple[Answer, ...]:
    """Return the five answers of a run in their order, and of people who come back.

    A run without scenes has that last answer alone. `table` is the first table of the
    run, if it is at hand. Without `names_level` the first three answers do not name
    their level: it is `reference_level(table)`.
    """
    returning = _returning_answers(run)
    if not run.has_scenes:
        return returning
    table = run.headline if table is None else table
    where, items = reference_level(table), run.verdict.get("items", ())
    robot = lead_robot(table, best=best_robot(run))
    losing = losing_robots(table, run.verdict.get("robots", ()))
    start = f"With {table.phrase(where)}, " if names_level else ""
    on_patrol = patrol_sentence(run)
    patrols = (f"On patrol: {on_patrol}",) if on_patrol else ()
    return (
        Answer(
            question="What does the robot lose?",
            topic="Robot",
            sentence=_robot_sentence(table, where, robot, losing, start=start),
            details=_robot_details(table, where, robot),
        ),
        Answer(
            question="What still leaks?",
            topic="Leak",
            sentence=_leak_sentence(table, where, start=start),
            details=_leak_details(table, where),
        ),
        Answer(
            question="Can people be linked?",
            topic="Links",
            sentence=_links_sentence(table, where, start=start),
            details=_links_details(table, where),
        ),
        Answer(
            question="Do the descriptors tell?",
            topic="Descriptors",
            sentence=_descriptors_sentence(items),
            details=_descriptors_details(items, table, where),
        ),
        Answer(
            question="What should I share?",
            topic="Share",
            sentence=share_answer(run),
            details=(*patrols, *share_details(run)),
        ),
        *returning,
    )


def _returning_answers(run: Results) -> tuple[Answer, ...]:
    """Return the answer about people who come back; empty without any."""
    sentence = return_sentence(run)
    if not sentence:
        return ()
    return (Answer(QUESTION, TOPIC, sentence, return_details(run)),)


def reference_level(table: Headline) -> MechanismLevel:
    """Return the level of the answers: strictest FID, else the costliest, else raw."""
    levels = [
        where for where in table.levels if table.families[where.mechanism].is_added
    ]
    if named := [where for where in MAIN_LEVELS if where in levels]:
        return named[0]
    costs = {
        where: cost.value if (cost := table.cost(where)) else -1.0 for where in levels
    }
    if costs:
        return max(costs, key=costs.__getitem__)
    raw = [where for where in table.levels if where.mechanism == RAW]
    return next(iter([*raw, *table.levels]), AT_RAW)


def best_robot(run: Results) -> str:
    """Return the robot by which levels are chosen, or the first of several; or ""."""
    return next(iter(run.recommendation().robots), "")


def lead_robot(table: Headline, *, best: str = "") -> HeadlineColumn | None:
    """Return the robot of the first screen, by future conflicts if the table has them.

    A user's own predictor comes first, then the `best` of the run, then the first.
    """
    robots = table.future or list(table.robots)
    own = [robot for robot in robots if not is_built_in_robot(robot.measure.consumer)]
    usual = [robot for robot in robots if robot.measure.consumer == best]
    return next(iter([*own, *usual, *robots]), None)


def _robot_sentence(
    table: Headline,
    where: MechanismLevel,
    robot: HeadlineColumn | None,
    losing: Sequence[LosingRobot],
    *,
    start: str,
) -> str:
    """Return the conflicts that a robot misses, and a robot that loses, if any."""
    missed = table.at(where, robot) if robot else None
    if robot is None or missed is None:
        return "Not tested: the run has no predictor."
    consumer = robot.measure.consumer
    conflicts = "future conflicts" if robot.is_later else "conflicts"
    raw = _raw_beside(table, where, robot)
    sentences = [
        sentence_case(
            f"{start}{robot_subject(consumer)} misses {percent(missed)} of"
            f" {conflicts}{raw}."
        ),
        *_other_rule(table, where, [robot]),
    ]
    if losing:
        # The robot of the sentence comes first, then the first that loses.
        same = [loser for loser in losing if loser.name == consumer]
        loser = next(iter([*same, *losing]))
        sentences.append(
            f"At {loser.n_lost} of {loser.n_levels} levels, expecting people to stand"
            f" beats {robot_subject(loser.name)}."
        )
    return " ".join(sentences)


def losing_robots(
    table: Headline, records: Sequence[Mapping[str, Any]]
) -> list[LosingRobot]:
    """Return the shown robots that lose to the prediction that people stand still.

    `records` are the verdict's: for each robot and horizon the levels where it loses.
    """
    names = [robot.measure.consumer for robot in table.robots]
    worst: dict[str, LosingRobot] = {}
    for record in sorted(records, key=lambda record: -len(record["loses"])):
        name, n_lost = record["robot"], len(record["loses"])
        if n_lost and name in names:
            worst.setdefault(name, LosingRobot(name, n_lost, record["levels"]))
    return sorted(worst.values(), key=lambda loser: names.index(loser.name))


def _robot_details(
    table: Headline, where: MechanismLevel, robot: HeadlineColumn | None
) -> tuple[str, ...]:
    """Return what the other robots miss, each at both horizons."""
    sentences = []
    for column in (*table.future, *table.robots):
        missed = table.at(where, column)
        if missed is None or column == robot:
            continue
        conflicts = "all conflicts"
        if column.is_later:
            conflicts = f"future conflicts within {table.horizon_s:g} s"
        subject = sentence_case(robot_subject(column.measure.consumer))
        raw = _raw_beside(table, where, column)
        sentences.append(f"{subject} misses {percent(missed)} of {conflicts}{raw}.")
    return tuple(sentences)


def _leak_sentence(table: Headline, where: MechanismLevel, *, start: str) -> str:
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
    other = _other_rule(table, where, [table.shared, table.attacked])
    return " ".join([f"{known}, {percent(attacked)} after an attack.", *other])


def _leak_details(table: Headline, where: MechanismLevel) -> tuple[str, ...]:
    """Return the name of the attack, and the numbers under other assumptions."""
    column = table.attacked
    if column is None or table.at(where, column) is None:
        return ()
    family = table.families.get(where.mechanism)
    is_headline = family is None or family.family in (*PAPER_FAMILIES, CLEAN)
    reader = column.measure.reader
    attack = f"the {attack_name(reader.consumer)} ({reader.label})"
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


def _links_sentence(table: Headline, where: MechanismLevel, *, start: str) -> str:
    """Return the share of re-identified people in the first two tasks of the table."""
    numbers = _linked_numbers(table, where)[:2]
    if not numbers:
        return "Not tested: the run has no linkage task with a linkage attack."
    (lead, rank1), *further = numbers
    phrase = task_phrase(lead.measure.reader.task)
    sentence = f"{start}{phrase} {percent(rank1)} of people are re-identified"
    for column, share in further:
        phrase = task_phrase(column.measure.reader.task).removesuffix(" of silence")
        sentence += f", {phrase} {bare_percent(share)}"
    other = _other_rule(table, where, [column for column, _ in numbers])
    return " ".join([sentence_case(f"{sentence}."), *other])


def _links_details(table: Headline, where: MechanismLevel) -> tuple[str, ...]:
    """Return each task with its attack, its chance and the size of its gallery."""
    sentences = []
    for column, rank1 in _linked_numbers(table, where):
        reader = column.measure.reader
        phrase = sentence_case(task_phrase(reader.task))
        joint = " It matches all people at once." if column.is_joint else ""
        sentences.append(
            f"{phrase}, the strongest attack is {reader.without_task.label} with"
            f" {percent(rank1)}.{joint}"
        )
        if math.isfinite(column.candidates):
            chance = round_percent(PERCENT * column.chance)
            sentences.append(
                f"Guessing among {column.candidates:.0f} people finds {chance} %."
            )
    return tuple(sentences)


def _linked_numbers(
    table: Headline, where: MechanismLevel
) -> list[tuple[HeadlineColumn, Estimate]]:
    """Return the columns of linkage tasks that have a number at a level, with it."""
    numbers = [(column, table.at(where, column)) for column in table.linked]
    return [(column, rank1) for column, rank1 in numbers if rank1 is not None]


def _descriptor_items(items: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the items of the verdict on the descriptors of the paper."""
    validity = [item for item in items if item["section"] == rules.VALIDITY]
    return [item for item in validity if item["descriptor"] in PAPER_DESCRIPTORS]


def _leading_item(items: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the leading item: by its decision, then by the lower end of its spread."""
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
    tested_rules = list(dict.fromkeys(item["adding"] for item in own))
    same_rules = list(dict.fromkeys(item["adding"] for item in same))
    # Where the adding rules disagree, the sentence says under which the decision holds.
    is_split = len(same_rules) < len(tested_rules)
    noise = f" ({_RULE_NOISE[same_rules[0]]})" if is_split else ""
    return _decision_sentence(lead, names, noise=noise)


def _decision_sentence(
    item: Mapping[str, Any], names: Sequence[str], *, noise: str
) -> str:
    """Return the decision of an item in words, with the difference of linkage.

    `noise` is the adding rule in brackets, or empty.
    """
    low = round_percent(PERCENT * (item["spread_low"] or 0.0))
    high = round_percent(PERCENT * (item["spread_high"] or 0.0))
    several = len(names) > 1
    subject = f"The {listed(names)}"
    if len(names) == len(PAPER_DESCRIPTORS):
        subject = "The paper's three descriptors"
    says_not = "do not say" if several else "does not say"
    says = "say" if several else "says"
    head = descriptor_name(item["descriptor"])
    match item["decision"]:
        # A flat descriptor: no difference at equal values is needed to show a miss.
        case decision if rules.is_flat_miss(decision, item["spread_low"]):
            return (
                f"{subject} {says_not} how linkable people are: linkage falls where the"
                f" {head} hardly changes{noise}."
            )
        case rules.DOES_NOT:
            return (
                f"{subject} {says_not} how linkable people are: at equal values,"
                f" linkage differs by at least {low} points{noise}."
            )
        case rules.TRACKS:
            return (
                f"{subject} {says} how linkable people are: at equal values, linkage"
                f" differs by {low} to {high} points{noise}."
            )
        case rules.BETWEEN:
            needed = item.get("n_needed")
            more = f" {people_needed(needed)}" if needed else ""
            return (
                f"The run cannot say whether the {head} tells how linkable people are."
                f" At equal values, linkage differs by {low} to {high}"
                f" points{noise}.{more}"
            )
    # The reason in short: the details have it in full.
    why = item["why"].partition(": ")[0].partition(", not surely")[0]
    return f"The run cannot test the descriptors: {why}."


def people_needed(n: float) -> str:
    """Return how many people would decide an item that is open now."""
    return f"{sentence_case(people_amount(n))} people would decide it."


def _descriptors_details(
    items: Sequence[Mapping[str, Any]], table: Headline, where: MechanismLevel
) -> tuple[str, ...]:
    """Return the source of the answer, its evidence, and the count of all decisions."""
    own = _descriptor_items(items)
    if not own:
        return ()
    lead = _leading_item(own)
    head = descriptor_name(lead["descriptor"])
    how = f"{task_phrase(lead['task'])}, with {adding_phrase(lead['adding'])}"
    spread = round_percent(PERCENT * (lead["spread"] or 0.0))
    sentences = [f"The widest spread is {spread} of 100 people at equal {head}, {how}."]
    if lead["decision"] == rules.NOT_TESTABLE:
        sentences = [f"Not testable {how}: {lead['why']}."]
    if rules.SHOWN in lead["evidence"]:
        sentences.append("An attack that links more people shows it.")
    if rules.ATTACKS in lead["evidence"]:
        sentences.append(
            "It holds as far as these attacks go; a stronger attack may change it."
        )
        if gap := gap_text(table.gaps, where, lead["task"]):
            sentences.append(gap)
    counts = Counter(item["decision"] for item in own)
    decided = listed([f"{n} {decision!r}" for decision, n in counts.items()])
    sentences.append(f"Decisions on all {len(own)} items: {decided}.".replace("'", '"'))
    return tuple(sentences)


def _raw_beside(table: Headline, where: MechanismLevel, column: HeadlineColumn) -> str:
    """Return the number of raw positions in brackets; empty at raw itself."""
    raw = table.at(AT_RAW, column) if where.mechanism != RAW else None
    return f" (raw positions: {bare_percent(raw)})" if raw else ""


def _other_rule(
    table: Headline, where: MechanismLevel, columns: Sequence[HeadlineColumn]
) -> list[str]:
    """Return a sentence on the other adding rule, if any number clearly differs there.

    A number clearly differs if the intervals are apart and the values differ by at
    least five points.
    """
    own = find_family(table.families, where.mechanism)
    for twin in table.families.values():
        if twin.name != own.name or twin.adding in ("", own.adding):
            continue
        pairs = [
            (
                table.at(where, column),
                table.at(MechanismLevel(twin.mechanism, where.level), column),
            )
            for column in columns
        ]
        known = [(value, other) for value, other in pairs if value and other]
        differs = any(_clearly_differ(value, other) for value, other in known)
        if differs and len(known) == len(pairs):
            shares = listed([percent(other) for _, other in known])
            return [f"With {adding_phrase(twin.adding)}: {shares}."]
    return []


def _clearly_differ(value: Estimate, other: Estimate) -> bool:
    """Return whether the intervals are apart and the values differ enough."""
    apart = max(other.ci_low - value.ci_high, value.ci_low - other.ci_high)
    return apart > 0 and abs(other.value - value.value) >= _MATTERS
