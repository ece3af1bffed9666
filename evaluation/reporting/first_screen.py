"""The first screen of a run: at most 24 lines of 80 columns; the rest: `tables.txt`."""

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, NamedTuple

from evaluation.estimates.families import CLEAN
from evaluation.plan.address import MechanismLevel
from evaluation.reporting import table as make
from evaluation.reporting.amounts import (
    PERCENT,
    counted,
    percent_cell,
    round_percent,
)
from evaluation.reporting.announcements import WIDTH, short_path, wrap_lines
from evaluation.reporting.answers import (
    answers,
    best_robot,
    lead_robot,
    reference_level,
)
from evaluation.reporting.doubts import doubts
from evaluation.reporting.error_sources import DOCS_PAGE
from evaluation.reporting.grid import Group, grid_lines
from evaluation.reporting.headline import Headline, HeadlineColumn, choose_levels
from evaluation.reporting.lookups import MAIN_LEVELS
from evaluation.reporting.my_plugin import plugin_lines
from evaluation.reporting.names import (
    INDEPENDENT_MARK,
    dataset_title,
    robot_name,
)
from evaluation.reporting.notices import (
    cost_text,
    unusual_geometry,
)
from evaluation.reporting.paper_hint import paper_hint
from evaluation.reporting.patrol_words import patrol_sentence
from evaluation.reporting.recommendation import named_levels
from evaluation.reporting.return_tables import return_tables, screen_table
from evaluation.reporting.return_words import (
    TOPIC,
    no_scenes_line,
    returning_line,
)
from evaluation.reporting.rows import Results
from evaluation.reporting.table import Column, Table, printable, shorten_name
from evaluation.reporting.tracking_table import tracking_sentence
from evaluation.store.files import PAGE

LINES: Final = 24
TABLES: Final = "tables.txt"
_MOST_ROWS: Final = 8
_MOST_RETURN_ROWS: Final = 12  # Where a run has no other table.
_LEAST_ROWS: Final = 5
_SHORTEST: Final = 2  # A topic and a sentence.
_LABEL_WIDTH: Final = 27
_CORNER: Final = ("± half of a 95 % interval", "what is shared")
_ROBOT_WIDTH: Final = 8  # Characters of a name over a column.
_MOST_LINKED: Final = 2  # Tasks that have a column.
# Missed conflicts above those of raw positions that the next command allows.
_SLACK: Final = 0.05
_CUTS: Final = ("split", "jump", "clock", "id-reuse")
"""Repairs that make several tracks of one person."""


@dataclass(frozen=True, eq=False, slots=True)
class ScreenParts:
    """The lines of a first screen without its table, in their order."""

    top: Sequence[str]  # The data, and an unusual geometry.
    sentences: Sequence[str]  # The answers, and patrols or tracks.
    plugins: Sequence[str]  # The user's own plug-ins.
    end: Sequence[str]  # Doubts and the page.
    following: Sequence[str]  # The next commands.

    @property
    def n_lines(self) -> int:
        """Number of lines."""
        return len(self.lines_around([]))

    def lines_around(self, grid: Sequence[str]) -> list[str]:
        """Return the lines of the screen with its table."""
        texts = [*self.sentences, *self.plugins]
        return [*self.top, *grid, *texts, *self.end, *self.following]


class _Extras(NamedTuple):
    """What a first screen has beside its answers."""

    patrols: bool
    sweep: bool  # The command of the paper's sweep.


_EXTRAS: Final = (
    _Extras(patrols=True, sweep=True),
    _Extras(patrols=False, sweep=True),
    _Extras(patrols=False, sweep=False),
)
"""People who come back take the place of patrols, then of the sweep; the page has both.
"""


def first_screen(run: Results, *, before: int = 0) -> list[str]:
    """Return the lines of the first screen.

    `before` lines were printed already: they leave the table less room, but at least a
    few rows.
    """
    if not run.has_scenes:
        return _returning_screen(run, before=before)
    screen = _run_table(run)
    parts = _fitting_parts(run, n_grid=len(_table_lines(screen, room=0)))
    room = LINES - before - parts.n_lines
    grid = _table_lines(screen, room=room)
    return parts.lines_around(_with_margins(grid, room=room))


def _fitting_parts(run: Results, *, n_grid: int) -> ScreenParts:
    """Return the parts of a screen that fit beside a table of `n_grid` lines."""
    shown = answers(run, run.headline, names_level=False)
    answered = [f"{answer.topic}: {answer.sentence}" for answer in shown]
    texts, patrols = [_level_line(run.headline), *answered], _patrol_lines(run)
    has_returns = shown[-1].topic == TOPIC
    bare = ScreenParts(
        top=[*wrap_lines(data_line(run.manifest)), *unusual_geometry(run.manifest)],
        sentences=[],
        plugins=[line for text in plugin_lines(run) for line in wrap_lines(text)],
        end=[*_doubt_lines(doubts(run)), *_page_lines(run)],
        following=[],
    )
    for extras in _EXTRAS:
        further = patrols if extras.patrols else []
        parts = replace(bare, following=_next_lines(run, names_sweep=extras.sweep))
        most = LINES - n_grid - parts.n_lines
        sentences = fitting_lines([*texts, *further], most=most)
        if len(sentences) <= most or not has_returns:
            break
    return replace(parts, sentences=sentences)


def _with_margins(grid: Sequence[str], *, room: int) -> list[str]:
    """Return a table between empty lines, if there is room for them."""
    return ["", *grid, ""] if grid and room > len(grid) + 1 else list(grid)


def _returning_screen(run: Results, *, before: int) -> list[str]:
    """Return the lines of a run about people who come back alone: it has no scenes."""
    manifest = run.manifest
    texts = [f"{answer.topic}: {answer.sentence}" for answer in answers(run)]
    texts += [detail for answer in answers(run) for detail in answer.details[:1]]
    parts = ScreenParts(
        top=wrap_lines(data_line(manifest)),
        sentences=[line for text in texts for line in wrap_lines(text)],
        plugins=[],
        end=[
            *wrap_lines(no_scenes_line(manifest)),
            *_doubt_lines(doubts(run)),
            *_page_lines(run),
        ],
        following=_next_lines(run),
    )
    room = LINES - before - parts.n_lines
    for most in range(_MOST_RETURN_ROWS, _LEAST_ROWS - 1, -1):
        labels, grid = screen_table(run, most=most)
        grid += _legend(labels)
        if len(grid) <= room:
            break
    return parts.lines_around(_with_margins(grid, room=room))


def _patrol_lines(run: Results) -> list[str]:
    """Return the line on patrols, or with a tracker that on tracks in its place.

    Tables and page have both.
    """
    if sentence := tracking_sentence(run):
        return [f"Tracking: {sentence}"]
    if sentence := patrol_sentence(run):
        return [f"On patrol: {sentence}"]
    return []


def data_line(manifest: Mapping[str, Any]) -> str:
    """Return what was recorded or simulated, and how much of it is used."""
    dataset, identity = manifest["dataset"], manifest["identity"]
    is_cut = any(repair["kind"] in _CUTS for repair in dataset["repairs"])
    noun, plural = ("track", "tracks") if is_cut else ("person", "people")
    if dataset.get("returning"):  # Several of each person.
        noun, plural = "passage", "passages"
    tracks = counted(dataset["tracks"], noun, plural)
    title = f"{dataset_title(dataset['name'])}: {tracks} recorded"
    if dataset.get("simulated"):
        title = f"Simulated crowd {dataset['name']}: {tracks}"
    if manifest.get("no_scenes"):
        return f"{title}; {returning_line(manifest)}"
    scenes = identity.get("scenes_utility", identity["scenes"])
    return (
        f"{title}, {dataset['tracks_used']:,} long enough to use;"
        f" {counted(scenes, 'test scene')}"
    )


def fitting_lines(texts: Sequence[str], *, most: int) -> list[str]:
    """Return texts in at most `most` lines, without their last sentences if needed.

    The last sentence of the longest text goes first: the details of an answer are in
    its table. The first sentence of a text always stays.
    """
    shown = [re.split(r"(?<=[.:]) (?=[A-Z])", text) for text in texts]
    lines = [wrap_lines(" ".join(sentences)) for sentences in shown]
    while sum(map(len, lines)) > most:
        # A topic and its first sentence stay.
        longest = max(
            range(len(shown)), key=lambda n: (len(shown[n]) > _SHORTEST, len(lines[n]))
        )
        if len(shown[longest]) <= _SHORTEST:
            break
        shown[longest].pop()
        lines[longest] = wrap_lines(" ".join(shown[longest]))
    return [line for text_lines in lines for line in text_lines]


@dataclass(frozen=True, eq=False, slots=True)
class ScreenTable:
    """The first table as the first screen has it: few columns, few levels."""

    table: Headline
    groups: Sequence[Group]
    columns: Sequence[HeadlineColumn]  # Of all groups.
    named: Sequence[MechanismLevel]  # Levels that come first.

    def levels(self, *, most: int, has_clean: bool = True) -> list[MechanismLevel]:
        """Return at most `most` levels that have a number in any column."""
        table = self.table
        numbered = [
            where
            for where in table.levels
            if any(table.at(where, column) for column in self.columns)
        ]
        if not has_clean:
            families = table.families
            numbered = [
                where for where in numbered if families[where.mechanism].family != CLEAN
            ]
        return screen_levels(table, numbered, most=most, named=self.named)

    def row(self, where: MechanismLevel) -> list[str]:
        """Return the texts of a level: its name, then a share in each column."""
        name = shorten_name(self.table.short_name(where), room=_LABEL_WIDTH)
        shares = [self.table.at(where, column) for column in self.columns]
        return [name, *map(percent_cell, shares)]


def _make_screen_table(
    table: Headline,
    robot: HeadlineColumn | None,
    *,
    named: Sequence[MechanismLevel] = (),
) -> ScreenTable:
    """Return the table of a screen with a robot; the level of the answers has a row."""
    pairs = screen_columns(table, robot)
    return ScreenTable(
        table,
        groups=[group for group, _ in pairs],
        columns=[column for _, columns in pairs for column in columns],
        named=[reference_level(table), *named],
    )


def _run_table(run: Results) -> ScreenTable:
    """Return the table of the first screen of a run."""
    robot = lead_robot(run.headline, best=best_robot(run))
    return _make_screen_table(run.headline, robot, named=named_levels(run))


def _table_lines(screen: ScreenTable, *, room: int) -> list[str]:
    """Return the first table in lines, with as many levels as fit into `room` lines.

    It has heads, levels, chance, and the meaning of its marks.
    """
    chance = _chance_row(screen.columns)
    for most in range(_MOST_ROWS - len(chance), _LEAST_ROWS - 1, -1):
        rows = [
            screen.row(where) for where in screen.levels(most=most, has_clean=False)
        ]
        grid = grid_lines([*rows, *chance], screen.groups, corner=_CORNER)
        lines = [*grid, *_legend([row[0] for row in rows])]
        if len(lines) <= room:
            break
    return lines if rows else []


def first_table(run: Results) -> Table:
    """Return the table of the first screen with all its columns, for a notebook."""
    if not run.has_scenes:
        return next(iter(return_tables(run)), make.build_table("first", "", [], []))
    screen = _run_table(run)
    cells = [
        Column(column.title, partial(_estimated, run.headline, column), "%")
        for column in screen.columns
    ]
    name = make.text_column("what is shared", run.headline.name)
    levels = screen.levels(most=_MOST_ROWS)
    return make.build_table("first", "", levels, [name, *cells])


def short_table(table: Headline) -> Table:
    """Return the first table for the README: `34 ±4`, shares and half-widths in %.

    Without the run at hand, its robot is that which misses least.
    """
    robot = min(table.future or table.robots, key=partial(_mean_missed, table))
    screen = _make_screen_table(table, robot)
    heads = [
        f"{robot_name(robot.measure.consumer)} misses (%)",
        "known as sent (%)",
        "attacked (%)",
    ]
    linked = screen.columns[len(heads) :]
    tasks = [column.name.removeprefix("after ") for column in linked]
    for n, task in enumerate(tasks):
        heads.append(f"linked, {task} (%)" if n == 0 else f"{task} (%)")
    cells = [
        Column(head, partial(_short_cell, table, column))
        for head, column in zip(heads, screen.columns, strict=True)
    ]
    names = make.text_column("shared", table.name)
    levels = screen.levels(most=_MOST_ROWS)
    return make.build_table("screen", "", levels, [names, *cells])


def _short_cell(
    table: Headline, column: HeadlineColumn, where: MechanismLevel
) -> make.Cell:
    """Return a share with half of its interval as a cell of text."""
    return make.text_cell(percent_cell(table.at(where, column)))


def _mean_missed(table: Headline, robot: HeadlineColumn) -> float:
    """Return the mean missed rate of a robot over all levels; infinite if unknown."""
    missed = [table.at(where, robot) for where in table.levels]
    values = [rate.value for rate in missed if rate is not None]
    return sum(values) / len(values) if values else math.inf


def _estimated(
    table: Headline, column: HeadlineColumn, where: MechanismLevel
) -> make.Cell:
    """Return the cell of a level in a column, with its interval."""
    return make.estimate_cell(column.measure.metric, table.at(where, column))


def _legend(labels: Sequence[str]) -> list[str]:
    """Return the meaning of the mark of a label in a line; no line without a mark."""
    is_marked = any(label.endswith(INDEPENDENT_MARK) for label in labels)
    mark = INDEPENDENT_MARK.strip()
    return [f"{mark} noise independent of the sensing error"] if is_marked else []


def _level_line(table: Headline) -> str:
    """Return the level of the sentences, with the meaning of its abbreviation."""
    where = reference_level(table)
    meaning = " (Fisher information density)" if "fid" in where.mechanism else ""
    return f"With {table.phrase(where)}{meaning}:"


def screen_columns(
    table: Headline, robot: HeadlineColumn | None
) -> list[tuple[Group, list[HeadlineColumn]]]:
    """Return the columns in groups: one robot, known positions, two linkage tasks."""
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
        # Both heads start with `after`: only the first of them says so.
        first, *others = [column.name for column in linked]
        heads = (first, *(name.removeprefix("after ") for name in others))
        groups.append((Group(f"{linked[0].above}, %", heads), linked))
    return groups


def screen_levels(
    table: Headline,
    known: Sequence[MechanismLevel],
    *,
    most: int,
    named: Sequence[MechanismLevel],
) -> list[MechanismLevel]:
    """Return at most `most` levels, in the order of the run.

    Raw positions and the `named` levels come first. Then follow one level of each
    mechanism of the paper, one of each other mechanism, and the further levels that the
    paper gives numbers for. Independent noise comes last if the same noise has a row
    under the other adding rule.
    """
    without_level = [where for where in known if where.level is None]
    lead: dict[str, MechanismLevel] = {}
    for where in known:
        if (table.families[where.mechanism].name, where.level) in MAIN_LEVELS:
            lead.setdefault(where.mechanism, where)
    candidates = dict.fromkeys(
        [*without_level, *named, *lead.values(), *choose_levels(table)]
    )
    wanted = [where for where in candidates if where in known]
    repeated = _repeated_noises(table, wanted) - {*without_level, *named}
    wanted.sort(key=lambda where: where in repeated)  # Equals keep their order.
    return sorted(wanted[:most], key=lambda where: _order(table, where))


def _repeated_noises(
    table: Headline, levels: Sequence[MechanismLevel]
) -> set[MechanismLevel]:
    """Return the levels whose noise stands before them under the other adding rule."""
    noises, repeated = set[tuple[str, float | None]](), set[MechanismLevel]()
    for where in levels:
        noise = table.families[where.mechanism].name, where.level
        if noise in noises:
            repeated.add(where)
        noises.add(noise)
    return repeated


def _order(table: Headline, where: MechanismLevel) -> tuple[int, str, float, str]:
    """Return the sort key of a level: families as in the run, both rules together."""
    families = list(dict.fromkeys(family.family for family in table.families.values()))
    family = table.families[where.mechanism]
    level = -math.inf if where.level is None else where.level
    return families.index(family.family), family.name, level, family.mechanism


def _chance_row(columns: Sequence[HeadlineColumn]) -> list[list[str]]:
    """Return the row of guessing; an empty list without a linkage task."""
    sizes = [
        column.candidates for column in columns if math.isfinite(column.candidates)
    ]
    if not any(math.isfinite(column.chance) for column in columns):
        return []
    among = f" among {min(sizes):.0f}" if sizes else ""
    if len({round(size) for size in sizes}) > 1:
        among += f" to {max(sizes):.0f}"
    chances = [
        round_percent(PERCENT * column.chance) if math.isfinite(column.chance) else ""
        for column in columns
    ]
    return [[f"guessing{among}", *chances]]


def _doubt_lines(texts: Sequence[str]) -> list[str]:
    """Return as many doubts as fit into one line, but at least the first.

    The page of the documentation that explains them is named in any case.
    """
    if not texts:
        return [f"Doubts: none but those of every run: {DOCS_PAGE}."]
    for n in range(len(texts), 0, -1):
        n_rest = len(texts) - n
        more = f"; {n_rest} more in {TABLES}" if n_rest else ""
        lines = wrap_lines(f"Doubts: {'; '.join(texts[:n])}{more}. See {DOCS_PAGE}.")
        if len(lines) == 1:
            return lines
    return lines


def _page_lines(run: Results) -> list[str]:
    """Return a line on the page and the tables; a path is never broken."""
    page, tables = run.out / PAGE, short_path(run.out / TABLES)
    if not page.exists():
        return [printable(f"Tables: {tables}")]
    line = printable(f"Page: {short_path(page)}; all numbers: {TABLES}")
    return [line] if len(line) <= WIDTH else [printable(f"Page: {short_path(page)}")]


def _next_lines(run: Results, *, names_sweep: bool = True) -> list[str]:
    """Return the next commands: `design`, and after `quick` the sweep of the paper."""
    out, answer = shlex.quote(str(short_path(run.out))), run.recommendation()
    if not (answer.raw and math.isfinite(answer.raw.cost.ci_high)):
        return command_lines("Next", "python -m evaluation.report --verbose", out)
    missed = min(1.0, math.ceil(20.0 * (answer.raw.cost.ci_high + _SLACK)) / 20.0)
    rules = answer.question.adding
    # Both adding rules must hold by default: a run of one rule must name it.
    rest = f"--adding {rules[0]} {out}" if len(rules) == 1 else out
    design = f"python -m evaluation.design --max-missed {missed:.2f}"
    sweep = _paper_lines(run.manifest) if names_sweep else []
    return [*command_lines("Next", design, rest), *sweep]


def command_lines(label: str, command: str, rest: str) -> list[str]:
    """Return a command in one line, or in two lines that a shell joins."""
    line = f"{label}: {command} {rest}"
    return [line] if len(line) <= WIDTH else [f"{label}: {command} \\", f"  {rest}"]


def _paper_lines(manifest: Mapping[str, Any]) -> list[str]:
    """Return the command and the time of the paper's sweep, after a run of `quick`."""
    hint = paper_hint(manifest)
    if hint is None:
        return []
    label = f"Sweep, {cost_text(hint.seconds).removeprefix('about ')}"
    line = f"{label}: {hint.command}"
    return [line] if len(line) <= WIDTH else [f"{label}:", f"  {hint.command}"]
