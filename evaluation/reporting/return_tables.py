"""Tables about people who come back: linkers by level, and all controls."""

from collections.abc import Mapping
from functools import partial
from typing import Final

from attacks.tasks.task_list import RETURNS
from evaluation.compute.return_columns import GAIN, NESTED_P, STRONGEST
from evaluation.estimates.families import CLEAN, Family
from evaluation.estimates.metrics import RANK1
from evaluation.plan.address import Address, MechanismLevel, control_name
from evaluation.plan.consumer import FUSION
from evaluation.reporting import table as make
from evaluation.reporting.amounts import fine_interval, fine_share
from evaluation.reporting.grid import Group, grid_lines
from evaluation.reporting.lookups import estimates, find_family
from evaluation.reporting.names import mechanism_name, short_mechanism_name
from evaluation.reporting.return_words import (
    CONTROL_PHRASES,
    control_text,
)
from evaluation.reporting.rows import Results
from evaluation.reporting.table import Column, Table, shorten_name
from evaluation.verdict.returns import read_return
from isac_track.intervals import Estimate

_CORNER: Final = ("[95 % interval]", "what is shared")
_LABEL_WIDTH: Final = 26
_ON_SCREEN: Final = {FUSION: "fusion", "gait": "gait", STRONGEST: "control"}
"""Columns of the first screen: rank 1 of each."""
_CHANCE: Final = "chance"


def return_numbers(run: Results) -> dict[Address, Estimate]:
    """Return the numbers of people who come back, without recording and adversary."""
    return {
        Address(
            mechanism=key.mechanism,
            level=key.level,
            task=RETURNS.name,
            plugin=key.plugin,
            metric=key.metric,
        ): number
        for key, number in estimates(run.returns).items()
    }


def find_number(
    numbers: Mapping[Address, Estimate], where: MechanismLevel, plugin: str, metric: str
) -> Estimate | None:
    """Return a number of a linker or control at a level; None if it is not there."""
    reader = Address(task=RETURNS.name, plugin=plugin)
    return numbers.get(reader.at(*where, metric))


def return_levels(numbers: Mapping[Address, Estimate]) -> list[MechanismLevel]:
    """Return the levels of a run, in its order: the first has no error."""
    return list(dict.fromkeys(key.mechanism_level for key in numbers))


def linkers(numbers: Mapping[Address, Estimate]) -> list[str]:
    """Return the linkers of a run: the fusion first."""
    names = dict.fromkeys(key.plugin for key in numbers if not key.control)
    return [FUSION, *(name for name in names if name != FUSION)]


def return_tables(run: Results) -> list[Table]:
    """Return both tables; empty without people who come back."""
    numbers = return_numbers(run)
    if not numbers:
        return []
    return [_level_table(run, numbers), _control_table(run, numbers)]


def _level_table(run: Results, numbers: Mapping[Address, Estimate]) -> Table:
    """Return rank 1 of each linker and of the control, a row for each level."""
    pick = partial(find_number, numbers)

    def column(title: str, plugin: str, metric: str, unit: str = "%") -> Column:
        return Column(
            title,
            lambda where: make.estimate_cell(metric, pick(where, plugin, metric)),
            unit,
        )

    families = run.families
    columns = [
        make.text_column("what is shared", partial(_level_name, families)),
        *(column(name, name, RANK1) for name in linkers(numbers)),
        column("strongest control", STRONGEST, RANK1),
        column("guessing", FUSION, _CHANCE),
        column("fusion less control", FUSION, GAIN, "points"),
        column("nested p", FUSION, NESTED_P, ""),
    ]
    return make.build_table(
        "returns",
        "People who come back: rank 1 in another run; 95 % intervals over people",
        return_levels(numbers),
        columns,
        notes=[
            (
                "Only passages without any error decide; all other rows are exploratory,"
                " and many: a single interval above guessing is no result."
            ),
            (
                "Without any error: as recorded, at the times of the recording. All other"
                " rows: at the times of the network."
            ),
        ],
    )


def _control_table(run: Results, numbers: Mapping[Address, Estimate]) -> Table:
    """Return rank 1 of every control, of passages without any error."""
    answer = read_return(run.verdict)
    chosen = answer.controls if answer else {}
    where = MechanismLevel(CLEAN)
    names = [
        name
        for name in CONTROL_PHRASES
        if find_number(numbers, where, control_name(name), RANK1)
    ]

    def rank1(name: str) -> make.Cell:
        number = find_number(numbers, where, control_name(name), RANK1)
        return make.estimate_cell(RANK1, number)

    columns = [
        make.text_column("control", control_text),
        Column("rank 1", rank1, "%"),
        make.text_column("chosen for people", lambda name: chosen.get(name, "")),
    ]
    return make.build_table(
        "returns-controls",
        "People who come back: what controls link, which do not see the walk",
        names,
        columns,
        notes=[
            "The control of each person is the strongest among the other people.",
            "Within a run the queue identifies people: that is no result.",
        ],
    )


def screen_table(run: Results, *, most: int) -> tuple[list[str], list[str]]:
    """Return rank 1 at `most` levels for a first screen: labels, and lines of text."""
    numbers = return_numbers(run)
    rows = []
    for where in return_levels(numbers)[:most]:
        name = short_mechanism_name(
            find_family(run.families, where.mechanism), where.level
        )
        cells = [
            _screen_cell(find_number(numbers, where, plugin, RANK1))
            for plugin in _ON_SCREEN
        ]
        chance = find_number(numbers, where, FUSION, _CHANCE)
        guessing = fine_share(chance.value) if chance else ""
        rows.append([shorten_name(name, room=_LABEL_WIDTH), *cells, guessing])
    heads = (*_ON_SCREEN.values(), "guessing")
    lines = grid_lines(rows, [Group("named first, %", heads)], corner=_CORNER)
    return [row[0] for row in rows], lines


def _screen_cell(number: Estimate | None) -> str:
    if number is None:
        return "-"
    return fine_interval(number.value, number.ci_low, number.ci_high, unit="")


def _level_name(families: Mapping[str, Family], where: MechanismLevel) -> str:
    return mechanism_name(find_family(families, where.mechanism), where.level)
