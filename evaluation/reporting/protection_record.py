"""The box for a data-protection record: a run in the words of the regulators of the EU.

The three risks are those of the Article 29 Working Party, Opinion 05/2014 on
anonymisation techniques (WP 216), section 2.2.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from attacks.tasks.task_list import ALL_TASKS, RETURNS
from evaluation.estimates.families import AT_RAW
from evaluation.plan.address import MechanismLevel
from evaluation.reporting.amounts import (
    counted,
    listed,
    precise_percent,
    sentence_case,
    tenth_percent,
)
from evaluation.reporting.answers import reference_level
from evaluation.reporting.headline import Headline, HeadlineColumn
from evaluation.reporting.names import adversary_name, family_name, task_phrase
from evaluation.reporting.rows import Results

OPINION: Final = (
    "Article 29 Working Party, Opinion 05/2014 on anonymisation techniques (WP 216)"
)
# Tasks whose second log isolates a known walk.
_SAME_STEPS: Final = ("rerelease", "rerelease-framed")
_MOST_NAMED: Final = 6


@dataclass(frozen=True, slots=True)
class Entry:
    """A heading of the record and its sentences."""

    topic: str
    sentences: tuple[str, ...]
    quotation: str = ""  # How the opinion defines the risk.


def protection_record(run: Results, table: Headline) -> list[Entry]:
    """Return the entries of the record of a run.

    Numbers are those of the level that the answers are about; raw positions stand
    beside them.
    """
    where = reference_level(table)
    singled = [task for task in table.linked if task.measure.reader.task in _SAME_STEPS]
    linked = [task for task in table.linked if task not in singled]
    return [
        Entry("What is processed", _processed(run, table)),
        Entry("Recipients who may link", _recipients(run)),
        Entry(
            "Singling out",
            (
                "Not prevented: each released track is the record of a single person.",
                *_reidentified(table, where, singled),
            ),
            "the possibility to isolate some or all records which identify an"
            " individual",
        ),
        Entry(
            "Linkability",
            _reidentified(table, where, linked) or ("Not tested in this run.",),
            "the ability to link, at least, two records concerning the same data"
            " subject",
        ),
        Entry(
            "Inference",
            _inferred(table, where),
            "the possibility to deduce, with significant probability, the value of an"
            " attribute",
        ),
        Entry("Limits", _limits(run)),
        Entry("Not tested", _untested(run)),
    ]


def _processed(run: Results, table: Headline) -> tuple[str, ...]:
    """Return the recorded data and the contents of a release."""
    data = run.manifest["dataset"]
    people = "simulated people" if data.get("simulated") else "people"
    added = [family for family in table.families.values() if family.is_added]
    names = list(dict.fromkeys(family_name(family) for family in added))
    rest = len(names) - _MOST_NAMED
    shown = [*names[:_MOST_NAMED], f"{rest} more"] if rest > 0 else names
    mechanisms = f"Mechanisms compared: {listed(shown)}." if names else ""
    sentences = (
        (
            f"Positions and times on {data['tracks_used']:,} of {data['tracks']:,}"
            f" tracks of {people}."
        ),
        "A release holds positions, times and a fresh pseudonym for each track.",
        mechanisms,
    )
    return tuple(filter(None, sentences))


def _recipients(run: Results) -> tuple[str, ...]:
    """Return the recipients of a release, and the adversaries that were tried."""
    known = [name for name in run.without_policy["knowledge"].dropna().unique() if name]
    if not known:
        return (
            "Every recipient of a release, robots among them.",
            "No attack was run.",
        )
    tried = listed([adversary_name(name) for name in known])
    return ("Every recipient of a release, robots among them.", f"Tried: {tried}.")


def _reidentified(
    table: Headline, where: MechanismLevel, tasks: list[HeadlineColumn]
) -> tuple[str, ...]:
    """Return the share of people that the strongest attack links in each task."""
    sentences = []
    for task in tasks:
        linked, raw = table.at(where, task), table.at(AT_RAW, task)
        if linked is None:
            continue
        phrase = task_phrase(task.measure.reader.task)
        among = f" among {task.candidates:.0f}" if np.isfinite(task.candidates) else ""
        text = (
            f"{table.name(where)}: {precise_percent(linked)} of people linked"
            f" {phrase}{among}"
        )
        beside = (
            f"; raw positions {precise_percent(raw)}" if raw and where != AT_RAW else ""
        )
        sentences.append(
            f"{sentence_case(text)}{beside}. {_against_chance(task, linked.ci_low)}"
        )
    return tuple(sentence.strip() for sentence in sentences)


def _against_chance(task: HeadlineColumn, low: float) -> str:
    """Compare the lower end of an interval with chance; empty if either is unknown."""
    if not (np.isfinite(low) and np.isfinite(task.chance)):
        return ""
    chance = f"chance, {tenth_percent(task.chance)}"
    if low > task.chance:
        return f"The risk is not ruled out: this is above {chance}."
    return f"The run does not show more than {chance}."


def _inferred(table: Headline, where: MechanismLevel) -> tuple[str, ...]:
    """Return the share of positions known as sent and after the strongest attack."""
    sent = table.at(where, table.shared)
    attacked = table.at(where, table.attacked) if table.attacked else None
    name, distance = table.name(where), f"{table.epsilon_m:g} m"
    sentences = []
    if sent:
        sentences.append(
            f"{sentence_case(name)}: {precise_percent(sent)} of positions are sent within"
            f" {distance}."
        )
    if attacked:
        sentences.append(
            f"The strongest attack infers {precise_percent(attacked)} to {distance}."
        )
    return (*sentences, "Names, homes and habits of people are not inferred here.")


def _limits(run: Results) -> tuple[str, ...]:
    """Return the assumptions behind the numbers."""
    law = run.manifest["settings"]["stages"]["sensing.law"]
    simulated = run.manifest["dataset"].get("simulated")
    return (
        "Each number is a lower bound: a better attack may reach more.",
        (
            f"Position errors are assumed {law.replace('_', ' ')}; brackets are 95 %"
            " intervals."
        ),
        (
            "Simulated people say nothing about real people."
            if simulated
            else "Other places and crowds may differ."
        ),
    )


def _untested(run: Results) -> tuple[str, ...]:
    """Return the data, adversaries and tasks that the numbers do not cover."""
    ran = {task.name for task in run.tasks}
    if len(run.returns):
        ran.add(RETURNS.name)
    left_out = [task_phrase(name) for name in ALL_TASKS if name not in ran]
    skipped = f"Linkage {listed(left_out, 'or')}." if left_out else ""
    failed = len(run.failed)
    sentences = (
        "Other data on the same people, such as cameras, phones or timetables.",
        "Intrusion into the network, and data before sharing.",
        skipped,
        f"{counted(failed, 'cell')} could not be computed." if failed else "",
    )
    return tuple(filter(None, sentences))
