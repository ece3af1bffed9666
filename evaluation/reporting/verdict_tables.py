"""Tables of the verdict: each section in short, all of its items, and the contrasts behind them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from evaluation.analysis.matching import AT_EQUAL_ALARMS, MISSED
from evaluation.analysis.metrics import METRICS
from evaluation.reporting.paper_tables import CRITERIA, effect
from evaluation.reporting.table import (
    Cell,
    Column,
    decision,
    level,
    number,
    table,
    word,
    words,
)
from evaluation.verdict.rules import (
    DEFLATED,
    DOES_NOT,
    HOLDS,
    INFLATED,
    REVERSED,
    TRACKS,
    UNDECIDED,
    WEAKLY,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.reporting.table import Table


@dataclass(frozen=True, slots=True)
class Section:
    """A question of the verdict."""

    question: str
    about: str


SECTIONS: Final = {
    "validity": Section(
        "Do the descriptors tell how linkable a person is?",
        "Across mechanisms, controls among them: where the descriptor is equal, is linkability?",
    ),
    "within": Section(
        "And whether this very person is linked?",
        "Within a level, among tracks alike in length, speed and noise: is who leaks more linked?",
    ),
    "claim": Section(
        "Is FID-controlled noise better than fixed noise?",
        "Where both cost the same, or show the same PLR; negative effects are in favour of FID.",
    ),
    "inflation": Section(
        "How much more is left than the descriptor says?",
        "The descriptor after attack, how many times the same as shared.",
    ),
}
"""By the name of a section in `verdict.json`."""
SHORT: Final = {
    TRACKS: "tracks",
    WEAKLY: "weakly",
    DOES_NOT: "does not",
    HOLDS: "lower",
    REVERSED: "higher",
    UNDECIDED: "?",
}
_CRITERIA: Final = {MISSED: "", AT_EQUAL_ALARMS: " and alarms"}
_OF: Final = {"as-shared": "as shared", "after-attack": "after attack", "linkage": "linked"}


def section_of(name: str) -> Section:
    """Return a section; of one that is not known its name."""
    return SECTIONS.get(name, Section(name, ""))


def short_tables(said: Mapping[str, Any]) -> list[Table]:
    """Return a table for each section that has items: decisions by what they are about."""
    found = []
    for name, items in _by_section(said["items"]).items():
        cells: dict[tuple[str, str], dict[str, Cell]] = {}
        columns: dict[str, None] = {}
        for one in items:
            row, column = _place(one)
            columns[column] = None
            cells.setdefault(row, {})[column] = _short(one)
        found.append(
            table(
                f"short-{name}",
                section_of(name).question,
                [*words("positions" if name == "claim" else "adding", "of"), *map(Column, columns)],
                [
                    [*map(word, row), *(known.get(column, Cell("")) for column in columns)]
                    for row, known in cells.items()
                ],
                notes=[section_of(name).about],
                n_keys=2,
            )
        )
    return found


def item_tables(items: Sequence[Mapping[str, Any]]) -> dict[str, Table]:
    """Return the items of the verdict, a table for each section."""
    found = {}
    for section, of in _by_section(items).items():
        optional = [key for key in ("descriptor", "task", "criterion") if any(i[key] for i in of)]
        rows = [
            [
                decision(item["decision"]),
                word(_sentence(item)),
                effect(item, signed=True),
                word(item["adding"]),
                *(_aspect(key, item[key]) for key in optional),
                word(item["subject"]),
                number(item["n"], digits=0),
            ]
            for item in of
        ]
        columns = [
            *words("decision", "what it says"),
            Column("effect"),
            *words("adding", *optional, "about"),
            Column("people"),
        ]
        found[section] = table(f"verdict-{section}", section.capitalize(), columns, rows)
    return found


def contrast_table(items: Sequence[Mapping[str, Any]]) -> Table:
    """Return the contrasts with the dissociation controls that validity rests on."""
    rows = [
        [
            word(item["adding"]),
            _aspect("descriptor", item["descriptor"]),
            word(item["task"]),
            word(contrast.get("subject") or item["subject"]),
            word(contrast["mechanism"]),
            level(contrast["level"]),
            decision(contrast["reading"]),
            effect({**contrast, "unit": item["unit"]}, signed=True),
        ]
        for item in items
        for contrast in item.get("contrasts") or ()
    ]
    columns = [
        *words("adding", "descriptor", "task", "attack", "against"),
        Column("level"),
        *words("reading"),
        Column("effect"),
    ]
    title = (
        "The contrasts behind it: FID and the controls against fixed noise where the descriptor "
        "is equal"
    )
    return table("contrasts", title, columns, rows, n_keys=6)


def _by_section(items: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the items by section: those that are known first, in their order."""
    names = dict.fromkeys([*SECTIONS, *(str(item["section"]) for item in items)])
    sections = {name: [one for one in items if one["section"] == name] for name in names}
    return {name: of for name, of in sections.items() if of}


def _place(one: Mapping[str, Any]) -> tuple[tuple[str, str], str]:
    """Return row and column of an item."""
    name = METRICS[one["descriptor"]].head if one["descriptor"] else ""
    if one["section"] == "claim":
        return (_OF[one["of"]], name or one["task"]), one["adding"] + _CRITERIA[one["criterion"]]
    if one["section"] == "inflation":
        return (one["adding"], one["of"]), name
    return (one["adding"], name), one["task"]


def _short(one: Mapping[str, Any]) -> Cell:
    if one["decision"] in (INFLATED, DEFLATED):
        return number(one["effect"])
    return Cell(SHORT.get(one["decision"], one["decision"]))


def _sentence(item: Mapping[str, Any]) -> str:
    why = item.get("why_undecided")
    return f"{item['sentence']} Undecided: {why.rstrip('.')}." if why else str(item["sentence"])


def _aspect(key: str, value: str) -> Cell:
    if key == "criterion":
        return word(CRITERIA.get(value, value))
    return word(METRICS[value].head if key == "descriptor" and value in METRICS else value)
