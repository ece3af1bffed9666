"""The first screen of a run, at most 40 lines of 80 columns; all else is in `tables.txt`."""

import math
import shlex
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any, Final

from evaluation.analysis import weak_attacks
from evaluation.analysis.keys import Where
from evaluation.reporting.announcements import (
    WIDTH,
    geometry,
    near,
    notices,
    scenes_text,
    used_are_slower,
    wrapped,
)
from evaluation.reporting.answers import answers, headline_of
from evaluation.reporting.headline import MOST_LEVELS, Headline, levels_of, screen_table
from evaluation.reporting.markup import paragraphs
from evaluation.reporting.my_plugin import plugin_doubts, plugin_lines
from evaluation.reporting.recommendation import recommended_levels
from evaluation.reporting.result_tables import control_tests
from evaluation.reporting.rows import Results
from evaluation.reporting.table import Table, printable, shortened
from evaluation.reporting.terminal import aligned
from evaluation.runs.files import PAGE
from evaluation.verdict.rules import DOES_NOT
from isac_track.intervals import LEAST_CLUSTERS
from isac_track.linkability import LEVEL

LINES: Final = 40
_CORNER: Final = "in %; ind. = independent"
TABLES: Final = "tables.txt"
_LEAST_LEVELS: Final = 5
_MANY: Final = 99  # Mechanisms: room for their number.
_LABEL, _HEADS = 28, (16, 12, 8)  # Characters of a level; over a column, the widest that fits.
_MUCH: Final = 0.2  # Of the mean speed of all tracks: by so much those used differ worth a doubt.
_SLACK: Final = 0.05  # Of missed conflicts, above what raw costs: what the next question allows.


def first_screen(run: Results, *, before: int = 5) -> list[str]:
    """Return the lines; `before` of them were printed already, which leaves levels less room."""
    of = headline_of(run)
    said = [f"{n} {one.topic}: {one.sentence}" for n, one in enumerate(answers(run, of), start=1)]
    said += plugin_lines(run)
    said.append(f"Doubts: {', '.join([*plugin_doubts(run), *_doubts(run, of)]) or 'none'}.")
    lines = [line for text in said for line in wrapped(text)]
    data = [data_line(run.manifest), *geometry(run.manifest, only_unusual=True)]
    top, last = [line for text in data for line in wrapped(text)], _next(run)
    # Heads; chance and widths; where to read on.
    fixed = len([*top, *lines, *last, *_read_on(run, _MANY)]) + 2 + 2
    most = max(_LEAST_LEVELS, min(MOST_LEVELS, LINES - before - fixed))
    levels, n_left_out = levels_of(of, most=most, named=recommended_levels(run))
    grid = _fitting(of, levels) if levels else []
    return [*top, *grid, *lines, *_read_on(run, n_left_out), *last]


def first_table(run: Results) -> Table:
    """Return the table of the first screen, whatever its width; without rows if there is none."""
    of = headline_of(run)
    levels, _ = levels_of(of, most=MOST_LEVELS, named=recommended_levels(run))
    return screen_table(of, levels, next(of.column_choices))


def _read_on(run: Results, n_left_out: int) -> list[str]:
    """Return where to read on: no path is broken, since it is there to be copied."""
    page, tables = run.out / PAGE, near(run.out / TABLES)
    more = f"{n_left_out} more mechanisms: " if n_left_out else "tables: "
    if not page.exists():
        return [printable(f"{more}{tables}")]
    line = printable(f"Page: {near(page)}; {more}{TABLES}")
    return [line] if len(line) <= WIDTH else [printable(f"Page: {near(page)}"), f"{more}{TABLES}"]


def data_line(manifest: Mapping[str, Any]) -> str:
    """Return what was recorded, and how much of it is used; simulated people are named first."""
    dataset, identity = manifest["dataset"], manifest["identity"]
    crowd = "SIMULATED crowd " if dataset.get("simulated") else ""
    return (
        f"{crowd}{dataset['name']}: {dataset['tracks_used']} of {dataset['tracks']} tracks used, "
        f"{scenes_text(identity)}, seed {identity['seed']}"
    )


def _fitting(of: Headline, levels: Sequence[Where]) -> list[str]:
    """Return the first table in lines, with as many of its columns as there is room for."""
    grids = (_grid(screen_table(of, levels, shown)) for shown in of.column_choices)
    narrow = (grid for grid in grids if max(map(len, grid)) <= WIDTH)
    return next(narrow, None) or _grid(screen_table(of, levels, [*of.column_choices][-1]))


def _grid(table: Table, rooms: Sequence[int] = _HEADS) -> list[str]:
    """Return a table in lines, what is above several columns once; heads as wide as fits."""
    heads = [shortened(one.name, room=rooms[0]) for one in table.columns]
    rows = [
        [shortened(row[0].text, room=_LABEL), *(one.text or "-" for one in row[1:])]
        for row in table.rows
    ]
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    above = " " * max(widths[0], len(_CORNER))
    for name, of in groupby(range(1, len(heads)), key=lambda place: table.columns[place].above):
        places = list(of)
        room = sum(widths[place] + 2 for place in places)
        # A heading wider than its columns makes the first of them wider.
        heads[places[0]] = heads[places[0]].rjust(widths[places[0]] + len(name) + 2 - room)
        above += name.rjust(max(room, len(name) + 2))
    lines = [above, *aligned([[_CORNER, *heads[1:]], *rows], left={0})]
    return lines if max(map(len, lines)) <= WIDTH or not rooms[1:] else _grid(table, rooms[1:])


def _doubts(run: Results, of: Headline) -> list[str]:
    """Return what speaks against believing the numbers, in numbers."""
    bare = [
        one.above
        for one in of.columns
        if (found := [value for where in of.wheres if (value := of.at(where, one))])
        and not any(math.isfinite(value.ci_low) for value in found)
    ]
    is_linked = (run.linkability["cohort"] == "all") & (run.linkability["knowledge"] != "")
    linked = run.linkability.loc[is_linked, "invalid"].fillna("")
    linkage = run.manifest.get("linkage") or {}
    tasks = linkage.get("tasks", {}).values()
    return paragraphs(
        "run.doubts",
        failed=[*run.failed["why"]],
        bare=list(dict.fromkeys(bare)),
        least=f"{LEAST_CLUSTERS:.0f}",
        n_flags=len(weak_attacks.lines(run.flags)),
        n_linked=len(linked),
        n_invalid=int((linked != "").sum()),
        shortcuts=sorted({name for one in linked if one for name in one.split(", ")}),
        tests=[one for task in run.tasks for some in control_tests(task).values() for one in some],
        level=LEVEL,
        n_controls=sum(one["decision"] == DOES_NOT for one in run.verdict.get("controls", ())),
        n_frozen=max((one.get("frozen", 0) for one in tasks), default=0),
        slower=used_are_slower(run.manifest, least=_MUCH),
        skipped=[*linkage.get("skipped", ())],
        n_units=sum(one["kind"] == "doubt" for one in run.manifest["dataset"]["repairs"]),
        n_notices=len(notices(run.manifest)),
    )


def _next(run: Results) -> list[str]:
    """Return the next question: what may be shared if a robot may miss a little more than now."""
    out, answer = shlex.quote(str(near(run.out))), run.recommendation()
    if not (answer.raw and math.isfinite(answer.raw.cost.ci_high)):
        return [f"Next: python -m evaluation.report --verbose {out}"]
    missed = min(1.0, math.ceil(20.0 * (answer.raw.cost.ci_high + _SLACK)) / 20.0)
    rules = answer.question.adding
    # By default both must hold, and a run of one has no answer.
    rest = f"--adding {rules[0]} {out}" if len(rules) == 1 else out
    line = f"Next: python -m evaluation.design --max-missed {missed:.2f}"
    return [f"{line} {rest}"] if len(f"{line} {rest}") <= WIDTH else [f"{line} \\", f"  {rest}"]
