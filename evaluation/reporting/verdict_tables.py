"""Tables of the verdict: each section in short, all of its items, and the contrasts behind them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from evaluation.analysis.matching import AT_EQUAL_ALARMS, MISSED
from evaluation.analysis.metrics import METRICS
from evaluation.reporting.paper_tables import CRITERIA, effect
from evaluation.reporting.table import (
    Cell,
    Column,
    built,
    counted,
    decided,
    level,
    number,
    said,
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
_EFFECT: Final = Column("effect"), partial(effect, signed=True)
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
    return {
        section: built(
            f"verdict-{section}",
            section.capitalize(),
            of,
            [
                decided("decision"),
                said("what it says", _sentence),
                _EFFECT,
                said("adding"),
                *(
                    said(key, partial(_aspect, key))
                    for key in ("descriptor", "task", "criterion")
                    if any(one[key] for one in of)
                ),
                said("about", "subject"),
                counted("people", "", "n", digits=0),
            ],
        )
        for section, of in _by_section(items).items()
    }


def contrast_table(items: Sequence[Mapping[str, Any]]) -> Table:
    """Return the contrasts with the dissociation controls that validity rests on."""
    return built(
        "contrasts",
        "The contrasts behind it: FID and the controls against fixed noise where the descriptor "
        "is equal",
        [
            {**item, **contrast, "subject": contrast.get("subject") or item["subject"]}
            for item in items
            for contrast in item.get("contrasts") or ()
        ],
        [
            said("adding"),
            said("descriptor", partial(_aspect, "descriptor")),
            said("task"),
            said("attack", "subject"),
            said("against", "mechanism"),
            (Column("level"), lambda row: level(row["level"])),
            decided("reading"),
            _EFFECT,
        ],
        n_keys=6,
    )


def _by_section(items: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the items by section: those that are known first, in their order."""
    names = dict.fromkeys([*SECTIONS, *(str(item["section"]) for item in items)])
    sections = {name: [one for one in items if one["section"] == name] for name in names}
    return {name: of for name, of in sections.items() if of}


def _place(one: Mapping[str, Any]) -> tuple[tuple[str, str], str]:
    """Return row and column of an item."""
    name = METRICS[one["descriptor"]].head if one["descriptor"] else ""
    if one["section"] == "claim":
        # Of FID, unless it says of which other mechanism.
        of = ", ".join([*([one["mechanism"]] if "mechanism" in one else ()), _OF[one["of"]]])
        return (of, name or one["task"]), one["adding"] + _CRITERIA[one["criterion"]]
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


def _aspect(key: str, item: Mapping[str, Any]) -> str:
    value: str = item[key]
    if key == "criterion":
        return CRITERIA.get(value, value)
    return METRICS[value].head if key == "descriptor" and value in METRICS else value
