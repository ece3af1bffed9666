"""The first screen of a run, at most 24 lines of 80 columns; all else is in `tables.txt`."""

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

from evaluation.estimates import weak_attacks
from evaluation.estimates.families import CLEAN
from evaluation.estimates.keys import Where
from evaluation.reporting import table as make
from evaluation.reporting.amounts import PERCENT, counted, listed, percent_cell, whole
from evaluation.reporting.announcements import WIDTH, near, wrapped
from evaluation.reporting.answers import (
    answers,
    best_robot,
    headline_of,
    lead_robot,
    level_phrase,
    reference,
)
from evaluation.reporting.grid import Group, grid_lines
from evaluation.reporting.headline import Headline, Shown, levels_of
from evaluation.reporting.lookups import HEADLINE, family_of
from evaluation.reporting.my_plugin import plugin_doubts, plugin_lines
from evaluation.reporting.names import (
    INDEPENDENT_MARK,
    dataset_title,
    mechanism_name,
    robot_name,
    short_mechanism_name,
    shortcut_name,
)
from evaluation.reporting.notices import (
    cost_text,
    few_people,
    notices,
    unusual_geometry,
    used_are_slower,
)
from evaluation.reporting.paper_hint import paper_hint
from evaluation.reporting.recommendation import recommended_levels
from evaluation.reporting.result_tables import control_tests
from evaluation.reporting.rows import Results
from evaluation.reporting.table import Column, Table, printable, shortened
from evaluation.store.files import PAGE
from evaluation.verdict.rules import DOES_NOT
from isac_track.linkability import LEVEL

LINES: Final = 24
TABLES: Final = "tables.txt"
_MOST_ROWS: Final = 8
_LEAST_ROWS: Final = 5
_SHORTEST: Final = 2  # A topic and a sentence.
_LABEL_WIDTH: Final = 27
_CORNER: Final = ("± half of a 95 % interval", "what is shared")
_ROBOT_WIDTH: Final = 8  # Characters of a name over a column.
_MOST_LINKED: Final = 2  # Tasks that have a column.
# Of the mean speed of all tracks: by so much those used differ worth a doubt.
_MUCH: Final = 0.2
# Of missed conflicts, above what raw costs: what the next question allows.
_SLACK: Final = 0.05
_CUTS: Final = ("split", "jump", "clock", "id-reuse")
"""Repairs that make several tracks of one person."""


def first_screen(run: Results, *, before: int = 0) -> list[str]:
    """Return the lines of the first screen.

    `before` lines were printed already: they leave the table less room, but at least a
    few rows.
    """
    table = headline_of(run)
    top = [*wrapped(data_line(run.manifest)), *unusual_geometry(run.manifest)]
    last = [*_doubt_lines(doubts(run, table)), *_page_lines(run), *_next_lines(run)]
    texts = [
        f"{answer.topic}: {answer.sentence}"
        for answer in answers(run, table, names_level=False)
    ]
    least = _table_lines(run, table, room=0)
    most = LINES - len([*top, *least, *last])
    own = [line for text in plugin_lines(run) for line in wrapped(text)]
    said = [*fitting_lines([_level_line(table), *texts], most=most - len(own)), *own]
    room = LINES - before - len([*top, *said, *last])
    grid = _table_lines(run, table, room=room)
    # Empty lines around the table, where there is room for both.
    blank = [""] * (bool(grid) and room > len(grid) + 1)
    return [*top, *blank, *grid, *blank, *said, *last]


def data_line(manifest: Mapping[str, Any]) -> str:
    """Return what was recorded, and how much of it is used; simulated people are named first."""
    dataset, identity = manifest["dataset"], manifest["identity"]
    is_cut = any(repair["kind"] in _CUTS for repair in dataset["repairs"])
    noun, plural = ("track", "tracks") if is_cut else ("person", "people")
    title = (
        f"{dataset_title(dataset['name'])}: {counted(dataset['tracks'], noun, plural)}"
        " recorded"
    )
    if dataset.get("simulated"):
        title = (
            f"Simulated crowd {dataset['name']}:"
            f" {counted(dataset['tracks'], noun, plural)}"
        )
    scenes = identity.get("scenes_utility", identity["scenes"])
    return (
        f"{title}, {dataset['tracks_used']:,} long enough to use;"
        f" {counted(scenes, 'test scene')}"
    )


def fitting_lines(texts: Sequence[str], *, most: int) -> list[str]:
    """Return texts in at most `most` lines, if that takes no more than their last sentences.

    The last sentence of the longest text goes first: the details of an answer are in
    its table.
    """
    shown = [re.split(r"(?<=[.:]) (?=[A-Z])", text) for text in texts]
    lines = [wrapped(" ".join(sentences)) for sentences in shown]
    while sum(map(len, lines)) > most:
        # A topic and its first sentence stay.
        longest = max(
            range(len(shown)), key=lambda n: (len(shown[n]) > _SHORTEST, len(lines[n]))
        )
        if len(shown[longest]) <= _SHORTEST:
            break
        shown[longest].pop()
        lines[longest] = wrapped(" ".join(shown[longest]))
    return [line for some in lines for line in some]


def _table_lines(run: Results, table: Headline, *, room: int) -> list[str]:
    """Return the first table in lines: heads, levels, chance, and what its marks mean."""
    robot = lead_robot(table, best=best_robot(run))
    pairs = screen_columns(table, robot)
    groups = [group for group, _ in pairs]
    columns = [column for _, some in pairs for column in some]
    known = [
        where
        for where in table.wheres
        if table.known[where[0]].family != CLEAN
        and any(table.at(where, column) for column in columns)
    ]
    chance, named = _chance_row(columns), [reference(table), *recommended_levels(run)]
    for most in range(_MOST_ROWS - len(chance), _LEAST_ROWS - 1, -1):
        levels = screen_levels(table, known, most=most, named=named)
        rows = [
            [
                _label(table, where),
                *(percent_cell(table.at(where, column)) for column in columns),
            ]
            for where in levels
        ]
        grid = grid_lines([*rows, *chance], groups, corner=_CORNER)
        lines = [*grid, *_legend([row[0] for row in rows])]
        if len(lines) <= room:
            break
    return lines if levels else []


def first_table(run: Results) -> Table:
    """Return the table of the first screen with all its columns, for a notebook."""
    table = headline_of(run)
    pairs = screen_columns(table, lead_robot(table, best=best_robot(run)))
    columns = [column for _, some in pairs for column in some]
    known = [
        where for where in table.wheres if any(table.at(where, one) for one in columns)
    ]
    named = [reference(table), *recommended_levels(run)]
    levels = screen_levels(table, known, most=_MOST_ROWS, named=named)
    heads = [
        Column(column.title, partial(_estimated, table, column), "%")
        for column in columns
    ]
    heads.insert(0, make.said("what is shared", table.name))
    return make.built("first", "", levels, heads)


def short_table(table: Headline) -> Table:
    """Return the first table for the README: shares in % with half of their 95 % interval.

    It has no run at hand: its robot is the one that misses least.
    """
    robot = min(
        table.future or table.robots, key=lambda shown: _mean_missed(table, shown)
    )
    columns = [column for _, some in screen_columns(table, robot) for column in some]
    known = [
        where for where in table.wheres if any(table.at(where, one) for one in columns)
    ]
    levels = screen_levels(table, known, most=_MOST_ROWS, named=[reference(table)])
    heads = [
        f"{robot_name(robot.measure.consumer)} misses (%)",
        "known as sent (%)",
        "attacked (%)",
    ]
    linked = [
        f"{column.name.removeprefix('after ')} (%)" for column in columns[len(heads) :]
    ]
    heads += [f"linked, {head}" if n == 0 else head for n, head in enumerate(linked)]
    cells = [
        Column(head, partial(_short_cell, table, column))
        for head, column in zip(heads, columns, strict=True)
    ]
    names = make.said(
        "shared",
        lambda where: mechanism_name(family_of(table.known, where[0]), where[1]),
    )
    return make.built("screen", "", levels, [names, *cells])


def _short_cell(table: Headline, column: Shown, where: Where) -> make.Cell:
    return make.word(percent_cell(table.at(where, column)))


def _mean_missed(table: Headline, robot: Shown) -> float:
    missed = [table.at(where, robot) for where in table.wheres]
    values = [rate.value for rate in missed if rate is not None]
    return sum(values) / len(values) if values else math.inf


def _estimated(table: Headline, column: Shown, where: Where) -> make.Cell:
    return make.estimated(column.measure.metric, table.at(where, column))


def _label(table: Headline, where: Where) -> str:
    name = short_mechanism_name(family_of(table.known, where[0]), where[1])
    return shortened(name, room=_LABEL_WIDTH)


def _legend(labels: Sequence[str]) -> list[str]:
    """Return what the mark of a label means, in a line; none without a mark."""
    is_marked = any(label.endswith(INDEPENDENT_MARK) for label in labels)
    mark = INDEPENDENT_MARK.strip()
    return [f"{mark} noise independent of the sensing error"] if is_marked else []


def _level_line(table: Headline) -> str:
    """Return which level the sentences are about, with what its abbreviation stands for."""
    where = reference(table)
    meaning = " (Fisher information density)" if "fid" in where[0] else ""
    return f"With {level_phrase(table, where)}{meaning}:"


def screen_columns(
    table: Headline, robot: Shown | None
) -> list[tuple[Group, list[Shown]]]:
    """Return the columns of the first screen: one robot, known positions, two linkage tasks."""
    groups = []
    if robot is not None:
        head = "future, %" if robot.is_later else "all, %"
        name = robot_name(robot.measure.consumer)
        subject = name if len(name) <= _ROBOT_WIDTH else "robot"
        groups.append((Group(f"{subject} misses", (head,)), [robot]))
    known = [column for column in (table.shared, table.attacked) if column is not None]
    heads = tuple(column.name for column in known)
    groups.append((Group(f"{table.shared.above}, %", heads), known))
    if linked := list(table.linked[:_MOST_LINKED]):
        # What both heads start with is said once.
        first, *others = [column.name for column in linked]
        heads = (first, *(name.removeprefix("after ") for name in others))
        groups.append((Group(f"{linked[0].above}, %", heads), linked))
    return groups


def screen_levels(
    table: Headline, known: Sequence[Where], *, most: int, named: Sequence[Where]
) -> list[Where]:
    """Return at most `most` levels, in the order of the run.

    Raw positions and the `named` levels come first, then one level of each mechanism of
    the paper, one of each other mechanism, and the further levels that the paper gives
    numbers for. Noise that is independent of the sensing error comes last where the
    same noise stands without it.
    """
    without_level = [where for where in known if where[1] is None]
    lead: dict[str, Where] = {}
    for where in known:
        if (table.known[where[0]].name, where[1]) in HEADLINE:
            lead.setdefault(where[0], where)
    others, _ = levels_of(table)
    every = dict.fromkeys([*without_level, *named, *lead.values(), *others])
    wanted = [where for where in every if where in known]
    first = {
        (table.known[where[0]].name, where[1]): where for where in reversed(wanted)
    }
    always = [*without_level, *named]
    # Sorting keeps the order of equals.
    wanted.sort(
        key=lambda where: (
            where not in always and first[table.known[where[0]].name, where[1]] != where
        )
    )
    return sorted(wanted[:most], key=lambda where: _order(table, where))


def _order(table: Headline, where: Where) -> tuple[int, str, float, str]:
    """Return where a level stands in the table: families as in the run, both rules together."""
    families = list(dict.fromkeys(family.family for family in table.known.values()))
    family = table.known[where[0]]
    level = -math.inf if where[1] is None else where[1]
    return families.index(family.family), family.name, level, family.mechanism


def _chance_row(columns: Sequence[Shown]) -> list[list[str]]:
    """Return the row of guessing; none where nobody is linked."""
    sizes = [
        column.candidates for column in columns if math.isfinite(column.candidates)
    ]
    if not any(math.isfinite(column.chance) for column in columns):
        return []
    among = f" among {min(sizes):.0f}" if sizes else ""
    if len({round(size) for size in sizes}) > 1:
        among += f" to {max(sizes):.0f}"
    chances = [
        whole(PERCENT * column.chance) if math.isfinite(column.chance) else ""
        for column in columns
    ]
    return [[f"guessing{among}", *chances]]


def doubts(run: Results, table: Headline) -> list[str]:
    """Return what speaks against believing the numbers, the gravest first."""
    manifest = run.manifest
    linked = manifest.get("linkage") or {}
    skipped = [*linked.get("skipped", ())]
    n_units = sum(
        repair["kind"] == "doubt" for repair in manifest["dataset"]["repairs"]
    )
    n_controls = sum(
        item["decision"] == DOES_NOT for item in run.verdict.get("controls", ())
    )
    n_weak = len(weak_attacks.lines(run.flags))
    n_frozen = max(
        (task.get("frozen", 0) for task in linked.get("tasks", {}).values()), default=0
    )
    failed = [*run.failed["why"]]
    texts = [
        f"{counted(len(failed), 'cell')} FAILED ({failed[0]})" if failed else "",
        *plugin_doubts(run),
        few_people(manifest["dataset"]).partition(" (")[0],
        _untried_text(run),
        "units of the recording may be wrong" if n_units else "",
        _no_interval_text(table),
        (
            f"{counted(n_controls, 'positive control')} of the descriptors failed"
            if n_controls
            else ""
        ),
        f"{counted(n_weak, 'sign')} that an attack is too weak" if n_weak else "",
        _invalid_text(run),
        _control_text(run),
        f"not linked: {listed(skipped)}" if skipped else "",
        f"{counted(n_frozen, 'track')} nearly frozen" if n_frozen else "",
        used_are_slower(manifest, least=_MUCH),
        counted(len(notices(manifest)), "notice") if notices(manifest) else "",
    ]
    return [text for text in texts if text]


def _untried_text(run: Results) -> str:
    """Return that no adversary that knows more was tried on the level that is proposed."""
    proposals = run.recommendation().proposals[:1]
    is_untried = any(
        all(side.source is None for side in offer.beyond) for offer in proposals
    )
    return "the proposal was tried against one release only" if is_untried else ""


def _no_interval_text(table: Headline) -> str:
    """Return which numbers have no interval at any level; empty if all have one."""
    bare = []
    for column in table.columns:
        numbers = [table.at(where, column) for where in table.wheres]
        known = [number for number in numbers if number is not None]
        if known and not any(math.isfinite(number.ci_low) for number in known):
            bare.append(column.above.partition(",")[0])
    subjects = listed(list(dict.fromkeys(bare)))
    return f"no intervals on {subjects} (few people)" if bare else ""


def _invalid_text(run: Results) -> str:
    """Return how many linkage results measure a shortcut instead of the attack."""
    texts = (
        run.linkability[["cohort", "knowledge", "invalid"]].astype(object).fillna("")
    )
    is_linked = (texts["cohort"] == "all") & (texts["knowledge"] != "")
    invalid = texts.loc[is_linked, "invalid"]
    shortcuts = sorted({name for text in invalid if text for name in text.split(", ")})
    if not shortcuts:
        return ""
    names = listed([shortcut_name(name) for name in shortcuts])
    n_invalid = int((invalid != "").sum())
    return f"{n_invalid} of {len(invalid)} linkage results invalid ({names})"


def _control_text(run: Results) -> str:
    """Return how many controls link people, where more do than by chance."""
    tests = [
        is_linked
        for task in run.tasks
        for control in control_tests(task).values()
        for is_linked in control
    ]
    expected = LEVEL * len(tests)
    if not sum(tests) > expected:
        return ""
    return (
        f"{sum(tests)} of {len(tests)} controls link people ({expected:.0f} expected)"
    )


def _doubt_lines(texts: Sequence[str]) -> list[str]:
    """Return the doubts in one line, or more for a first one that is long."""
    if not texts:
        return ["Doubts: none."]
    for n in range(len(texts), 0, -1):
        rest = len(texts) - n
        more = f"; {rest} more: {TABLES}" if rest else ""
        lines = wrapped(f"Doubts: {'; '.join(texts[:n])}{more}.")
        if len(lines) == 1:
            return lines
    return lines


def _page_lines(run: Results) -> list[str]:
    """Return where to read on: no path is broken, since it is there to be copied."""
    page, tables = run.out / PAGE, near(run.out / TABLES)
    if not page.exists():
        return [printable(f"Tables: {tables}")]
    line = printable(f"Page: {near(page)}; all numbers: {TABLES}")
    return [line] if len(line) <= WIDTH else [printable(f"Page: {near(page)}")]


def _next_lines(run: Results) -> list[str]:
    """Return the next commands: which noise a site may choose, and of `quick` the whole sweep."""
    out, answer = shlex.quote(str(near(run.out))), run.recommendation()
    if not (answer.raw and math.isfinite(answer.raw.cost.ci_high)):
        return command_lines("Next", "python -m evaluation.report --verbose", out)
    missed = min(1.0, math.ceil(20.0 * (answer.raw.cost.ci_high + _SLACK)) / 20.0)
    rules = answer.question.adding
    # By default both must hold, and a run of one has no answer.
    rest = f"--adding {rules[0]} {out}" if len(rules) == 1 else out
    design = f"python -m evaluation.design --max-missed {missed:.2f}"
    return [*command_lines("Next", design, rest), *_paper_lines(run.manifest)]


def command_lines(label: str, command: str, rest: str) -> list[str]:
    """Return a command in a line, or in two that a shell joins."""
    line = f"{label}: {command} {rest}"
    return [line] if len(line) <= WIDTH else [f"{label}: {command} \\", f"  {rest}"]


def _paper_lines(manifest: Mapping[str, Any]) -> list[str]:
    """Return the command of the whole sweep of the paper and its time, of a run of `quick`."""
    hint = paper_hint(manifest)
    if hint is None:
        return []
    label = f"Sweep, {cost_text(hint.seconds).removeprefix('about ')}"
    line = f"{label}: {hint.command}"
    return [line] if len(line) <= WIDTH else [f"{label}:", f"  {hint.command}"]
