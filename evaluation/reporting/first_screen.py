"""The first screen of a run: at most 24 lines of 80 columns; the rest: `tables.txt`."""

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

from evaluation.estimates import weak_attacks
from evaluation.estimates.families import CLEAN
from evaluation.plan.address import Where
from evaluation.reporting import table as make
from evaluation.reporting.amounts import (
    PERCENT,
    counted,
    listed,
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
from evaluation.reporting.error_sources import DOCS_PAGE
from evaluation.reporting.grid import Group, grid_lines
from evaluation.reporting.headline import Headline, HeadlineColumn, choose_levels
from evaluation.reporting.lookups import MAIN_LEVELS
from evaluation.reporting.my_plugin import plugin_doubts, plugin_lines
from evaluation.reporting.names import (
    INDEPENDENT_MARK,
    dataset_title,
    robot_name,
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
from evaluation.reporting.patrol_words import patrol_sentence
from evaluation.reporting.recommendation import named_levels
from evaluation.reporting.result_tables import control_tests
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
from evaluation.verdict.rules import DOES_NOT
from isac_track.linkability import LEVEL

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
# Relative difference of mean speed, used tracks to all tracks, that raises a doubt.
_MUCH: Final = 0.2
# Missed conflicts above those of raw positions that the next command allows.
_SLACK: Final = 0.05
_CUTS: Final = ("split", "jump", "clock", "id-reuse")
"""Repairs that make several tracks of one person."""


def first_screen(run: Results, *, before: int = 0) -> list[str]:
    """Return the lines of the first screen.

    `before` lines were printed already: they leave the table less room, but at least a
    few rows.
    """
    if not run.has_scenes:
        return _returning_screen(run, before=before)
    table = run.headline
    top = [*wrap_lines(data_line(run.manifest)), *unusual_geometry(run.manifest)]
    end = [*_doubt_lines(doubts(run, table)), *_page_lines(run)]
    texts = [_level_line(table)]
    shown = answers(run, table, names_level=False)
    texts += [f"{answer.topic}: {answer.sentence}" for answer in shown]
    patrols = _patrol_lines(run)
    own = [line for text in plugin_lines(run) for line in wrap_lines(text)]
    fixed = [*top, *_table_lines(run, table, room=0), *own, *end]
    # People who come back take the place of patrols, then of the sweep's command; the
    # page has both.
    for further, names_sweep in ((patrols, True), ([], True), ([], False)):
        following = _next_lines(run, names_sweep=names_sweep)
        most = LINES - len([*fixed, *following])
        sentences = fitting_lines([*texts, *further], most=most)
        if len(sentences) <= most or shown[-1].topic != TOPIC:
            break
    last = [*end, *following]
    sentences += own
    room = LINES - before - len([*top, *sentences, *last])
    grid = _table_lines(run, table, room=room)
    if grid and room > len(grid) + 1:
        grid = ["", *grid, ""]
    return [*top, *grid, *sentences, *last]


def _returning_screen(run: Results, *, before: int) -> list[str]:
    """Return the lines of a run about people who come back alone: it has no scenes."""
    manifest = run.manifest
    texts = [f"{answer.topic}: {answer.sentence}" for answer in answers(run)]
    texts += [detail for answer in answers(run) for detail in answer.details[:1]]
    top = wrap_lines(data_line(manifest))
    last = [
        *(line for text in texts for line in wrap_lines(text)),
        *wrap_lines(no_scenes_line(manifest)),
        *_doubt_lines(doubts(run, run.headline)),
        *_page_lines(run),
        *_next_lines(run),
    ]
    room = LINES - before - len([*top, *last])
    for most in range(_MOST_RETURN_ROWS, _LEAST_ROWS - 1, -1):
        labels, grid = screen_table(run, most=most)
        grid += _legend(labels)
        if len(grid) <= room:
            break
    if room > len(grid) + 1:
        grid = ["", *grid, ""]
    return [*top, *grid, *last]


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


def _table_lines(run: Results, table: Headline, *, room: int) -> list[str]:
    """Return the first table in lines, with as many levels as fit into `room` lines.

    It has heads, levels, chance, and the meaning of its marks.
    """
    pairs = screen_columns(table, lead_robot(table, best=best_robot(run)))
    groups = [group for group, _ in pairs]
    columns = _flat_columns(pairs)
    known = [
        where
        for where in _known_levels(table, columns)
        if table.families[where.mechanism].family != CLEAN
    ]
    chance = _chance_row(columns)
    named = [reference_level(table), *named_levels(run)]
    for most in range(_MOST_ROWS - len(chance), _LEAST_ROWS - 1, -1):
        levels = screen_levels(table, known, most=most, named=named)
        rows = []
        for where in levels:
            cells = [percent_cell(table.at(where, column)) for column in columns]
            rows.append([_label(table, where), *cells])
        grid = grid_lines([*rows, *chance], groups, corner=_CORNER)
        lines = [*grid, *_legend([row[0] for row in rows])]
        if len(lines) <= room:
            break
    return lines if levels else []


def _flat_columns(
    pairs: Sequence[tuple[Group, Sequence[HeadlineColumn]]],
) -> list[HeadlineColumn]:
    """Return the columns of all groups."""
    return [column for _, columns in pairs for column in columns]


def _known_levels(table: Headline, columns: Sequence[HeadlineColumn]) -> list[Where]:
    """Return the levels that have a number in any of the columns."""
    return [
        where
        for where in table.wheres
        if any(table.at(where, column) for column in columns)
    ]


def first_table(run: Results) -> Table:
    """Return the table of the first screen with all its columns, for a notebook."""
    if not run.has_scenes:
        return next(iter(return_tables(run)), make.build_table("first", "", [], []))
    table = run.headline
    robot = lead_robot(table, best=best_robot(run))
    columns = _flat_columns(screen_columns(table, robot))
    named = [reference_level(table), *named_levels(run)]
    levels = screen_levels(
        table, _known_levels(table, columns), most=_MOST_ROWS, named=named
    )
    cells = [
        Column(column.title, partial(_estimated, table, column), "%")
        for column in columns
    ]
    name = make.text_column("what is shared", table.name)
    return make.build_table("first", "", levels, [name, *cells])


def short_table(table: Headline) -> Table:
    """Return the first table for the README: `34 ±4`, shares and half-widths in %.

    Without the run at hand, its robot is that which misses least.
    """
    robot = min(table.future or table.robots, key=partial(_mean_missed, table))
    columns = _flat_columns(screen_columns(table, robot))
    levels = screen_levels(
        table,
        _known_levels(table, columns),
        most=_MOST_ROWS,
        named=[reference_level(table)],
    )
    heads = [
        f"{robot_name(robot.measure.consumer)} misses (%)",
        "known as sent (%)",
        "attacked (%)",
    ]
    tasks = [column.name.removeprefix("after ") for column in columns[len(heads) :]]
    for n, task in enumerate(tasks):
        heads.append(f"linked, {task} (%)" if n == 0 else f"{task} (%)")
    cells = [
        Column(head, partial(_short_cell, table, column))
        for head, column in zip(heads, columns, strict=True)
    ]
    names = make.text_column("shared", table.name)
    return make.build_table("screen", "", levels, [names, *cells])


def _short_cell(table: Headline, column: HeadlineColumn, where: Where) -> make.Cell:
    """Return a share with half of its interval as a cell of text."""
    return make.text_cell(percent_cell(table.at(where, column)))


def _mean_missed(table: Headline, robot: HeadlineColumn) -> float:
    """Return the mean missed rate of a robot over all levels; infinite if unknown."""
    missed = [table.at(where, robot) for where in table.wheres]
    values = [rate.value for rate in missed if rate is not None]
    return sum(values) / len(values) if values else math.inf


def _estimated(table: Headline, column: HeadlineColumn, where: Where) -> make.Cell:
    """Return the cell of a level in a column, with its interval."""
    return make.estimate_cell(column.measure.metric, table.at(where, column))


def _label(table: Headline, where: Where) -> str:
    """Return the name of a level in the first column."""
    return shorten_name(table.short_name(where), room=_LABEL_WIDTH)


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
    table: Headline, known: Sequence[Where], *, most: int, named: Sequence[Where]
) -> list[Where]:
    """Return at most `most` levels, in the order of the run.

    Raw positions and the `named` levels come first. Then follow one level of each
    mechanism of the paper, one of each other mechanism, and the further levels that the
    paper gives numbers for. Independent noise comes last if the same noise has a row
    under the other adding rule.
    """
    without_level = [where for where in known if where.level is None]
    lead: dict[str, Where] = {}
    for where in known:
        if (table.families[where.mechanism].name, where.level) in MAIN_LEVELS:
            lead.setdefault(where.mechanism, where)
    candidates = dict.fromkeys(
        [*without_level, *named, *lead.values(), *choose_levels(table)]
    )
    wanted = [where for where in candidates if where in known]
    always = [*without_level, *named]
    first = {
        (table.families[where.mechanism].name, where.level): where
        for where in reversed(wanted)
    }

    def repeats_noise(where: Where) -> bool:
        same_noise = table.families[where.mechanism].name, where.level
        return where not in always and first[same_noise] != where

    wanted.sort(key=repeats_noise)  # Sorting keeps the order of equals.
    return sorted(wanted[:most], key=lambda where: _order(table, where))


def _order(table: Headline, where: Where) -> tuple[int, str, float, str]:
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


def doubts(run: Results, table: Headline) -> list[str]:
    """Return the reasons to doubt the numbers, the gravest first."""
    manifest = run.manifest
    linkage = manifest.get("linkage") or {}
    skipped = list(linkage.get("skipped", ()))
    n_units = sum(
        repair["kind"] == "doubt" for repair in manifest["dataset"]["repairs"]
    )
    n_controls = sum(
        item["decision"] == DOES_NOT for item in run.verdict.get("controls", ())
    )
    n_weak = len(weak_attacks.lines(run.flags))
    n_frozen = max(
        (task.get("frozen", 0) for task in linkage.get("tasks", {}).values()), default=0
    )
    failures = list(run.failed["why"])
    controls = f"{counted(n_controls, 'positive control')} of the descriptors failed"
    texts = [
        f"{counted(len(failures), 'cell')} FAILED ({failures[0]})" if failures else "",
        *plugin_doubts(run),
        few_people(manifest["dataset"]).partition(" (")[0],
        _untried_text(run),
        "units of the recording may be wrong" if n_units else "",
        _no_interval_text(table),
        controls if n_controls else "",
        f"{counted(n_weak, 'sign')} of a weak attack" if n_weak else "",
        _invalid_text(run),
        _control_text(run),
        f"not linked: {listed(skipped)}" if skipped else "",
        f"{counted(n_frozen, 'track')} nearly frozen" if n_frozen else "",
        used_are_slower(manifest, least=_MUCH),
        counted(len(notices(manifest)), "notice") if notices(manifest) else "",
    ]
    return [text for text in texts if text]


def _untried_text(run: Results) -> str:
    """Return that no further adversary was tried on the proposal; empty if any was."""
    proposals = run.recommendation().proposals[:1]
    is_untried = any(
        all(side.source is None for side in offer.beyond) for offer in proposals
    )
    return "the proposal was tried against one release only" if is_untried else ""


def _no_interval_text(table: Headline) -> str:
    """Return which numbers have no interval at any level; empty if all have."""
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
    """Return how many controls link people; empty if no more than chance explains."""
    tests = [
        is_linked
        for task in run.tasks
        for control in control_tests(task).values()
        for is_linked in control
    ]
    n_linked, expected = sum(tests), LEVEL * len(tests)
    if not n_linked > expected:
        return ""
    return f"{n_linked} of {len(tests)} controls link people ({expected:.0f} expected)"


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
