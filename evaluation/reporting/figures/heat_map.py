"""The heat map of a task: who links at which mechanism level."""

from __future__ import annotations

from collections import Counter
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Patch, Rectangle
from matplotlib.textpath import TextPath, text_to_path

from evaluation.analysis.families import ADDING_RULES, CLEAN, FID, FIXED, RAW, Family
from evaluation.analysis.keys import Where, level_text
from evaluation.analysis.linkability import INVALID, LinkedTask
from evaluation.reporting.figures import drawing
from evaluation.reporting.figures.drawing import PERCENT, Drawing, Look
from evaluation.reporting.rows import Results, family_of, is_control, parameters_text, schemes
from evaluation.reporting.table import shortened

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.path import Path

# The page turns pure black and white over in the dark; what stands on a colour must stay.
_ON_DARK, _ON_BRIGHT = "#fefefe", "#010101"
_ORDER = (CLEAN, RAW, FID, FIXED)
_CELL_IN = 0.155
_CELL_POINTS = 6.2
_ROOM_IN = 0.06
_MECHANISMS_IN = 0.43
"""How far above the numbers the mechanisms stand."""
_POINTS_PER_IN = 72.0
_MARKS = {"no link detected": "~", "attack too weak": "^"}
_BRIGHT = 0.46
"""Share of the colour scale above which text is dark."""


def drawings(run: Results) -> list[Drawing]:
    """Return a figure for each task."""
    caption = (
        "^ attack too weak: it fails even without any error, so its silence is no privacy. ~ no "
        "link detected. Crossed out: invalid, a shortcut tells people apart."
    )
    return [
        Drawing(
            *(f"heat_map-{task.name}", "linkability", f"{task.name}: who links at which level"),
            *(partial(_heat_figure, task=task), partial(_words, task=task)),
            caption=caption,
            task=task.name,
        )
        for task in run.tasks
    ]


def _heat_figure(run: Results, *, task: LinkedTask) -> Figure:
    """Return rank 1 of every attack and adversary at every level of a task, one block a rule."""
    cells, known = task.cells, run.families
    # Names of what is swept, longest first.
    titles = {
        one.mechanism: [one.label, one.name, known[one.mechanism].family]
        for one in schemes(run.summary)
    }
    sources = list(dict.fromkeys(source for block in cells.values() for source in block))
    # The adversaries of one attack together, attacks as in the run.
    attacks = [source.consumer for source in sources]
    sources.sort(key=lambda source: attacks.index(source.consumer))
    ordered = _in_order(cells, known)
    rules = {name: family_of(known, name).adding for name, _ in cells}
    blocks = {
        rule: [where for where in ordered if rules[where[0]] in (rule, "")]
        for rule in ADDING_RULES
        if rule in rules.values()
    } or {"": ordered}
    names = [drawing.short(source) for source in sources]
    left_in = max(_width_in(name) for name in names) + 0.12
    n_columns = max(map(len, blocks.values()))
    cell_in = min(2 * _CELL_IN, (drawing.DOUBLE_COLUMN_IN - left_in - _ROOM_IN) / n_columns)
    # Above the numbers stand the levels, then the mechanisms that they are of.
    heads = {}
    for mechanism, level in cells:
        one, at = family_of(known, mechanism), "" if level is None else drawing.number(level)
        parts = [at] if mechanism in titles else [one.family, at, parameters_text(one)]
        heads[mechanism, level] = " ".join(filter(None, parts))
    head_in = 0.2 + max(0.5, *map(_width_in, heads.values()))
    top_in, block_in = 0.22, _CELL_IN * len(sources)
    width_in = drawing.DOUBLE_COLUMN_IN
    height_in = top_in + len(blocks) * (head_in + block_in) + 0.42
    figure = Figure(figsize=(width_in, height_in), dpi=drawing.IMAGE_DPI)
    for place, (rule, columns) in enumerate(blocks.items(), start=1):
        bottom = (height_in - top_in - place * (head_in + block_in)) / height_in
        size = cell_in * len(columns) / width_in, block_in / height_in
        ax = figure.add_axes((left_in / width_in, bottom, *size))
        _draw_heat(ax, [[cells[where].get(one) for where in columns] for one in sources])
        ax.set_yticks(np.arange(len(sources)), names)
        ax.xaxis.tick_top()
        ax.set_xticks(np.arange(len(columns)), [heads[where] for where in columns], rotation=90)
        _name_swept(ax, columns, titles, (cell_in, block_in))
        if rule:
            # In the corner above the names.
            y = bottom + (block_in + _MECHANISMS_IN) / height_in
            figure.text(0.01, y, f"{rule} adding")
    rows = [row for block in cells.values() for row in block.values()]
    handles, what = _handles(rows), f"{task.name}, rank 1 in %"
    return drawing.finish(
        figure, handles, dataset=str(rows[0]["dataset"]), what=what, columns=len(handles)
    )


def _in_order(cells: Iterable[Where], known: Mapping[str, Family]) -> list[Where]:
    """Return the columns: no error, FID with less and less, fixed, strangers', then controls."""
    names = list(dict.fromkeys(name for name, _ in cells))

    def key(where: Where) -> tuple[int, int, float]:
        one, at = family_of(known, where[0]), where[1] or 0.0
        order = [*_ORDER, "" if is_control(one) else one.family]
        place = order.index(one.family) if one.family in order else len(order)
        return place, names.index(where[0]), -at if one.family == FID else at

    return sorted(cells, key=key)


def _draw_heat(ax: Axes, rows: Sequence[Sequence[Mapping[str, Any] | None]]) -> None:
    """Draw the cells of a block: colours, numbers, crosses, and gaps between them."""
    values = np.full((len(rows), len(rows[0])), np.nan)
    places: dict[tuple[str, str], list[tuple[int, int]]] = {}
    crossed = []
    for y, x in np.ndindex(values.shape):
        row = rows[y][x]
        if row is None or not np.isfinite(row["rank1"]):
            continue
        values[y, x] = PERCENT * row["rank1"]
        mark = _MARKS.get(row["outcome"], "")
        text = mark if mark == "^" else f"{mark}{values[y, x]:.0f}"
        colour = _ON_BRIGHT if values[y, x] > _BRIGHT * PERCENT else _ON_DARK
        places.setdefault((text, colour), []).append((x, y))
        if row[INVALID]:
            crossed += [[(x - 0.5, y + end), (x + 0.5, y - end)] for end in (-0.5, 0.5)]
    look: dict[str, Any] = {"aspect": "auto", "cmap": "cividis", "interpolation": "nearest"}
    ax.imshow(values, vmin=0.0, vmax=PERCENT, **look)
    ax.add_collection(LineCollection(crossed, colors="#ff2222", linewidths=0.7))
    # Equal numbers as the markers of one artist: texts would take seconds.
    for (text, colour), at in places.items():
        # In the middle by the height of a digit, whatever the character.
        middle = 0.5 * _POINTS_PER_IN * _width_in(text, size=_CELL_POINTS), 0.365 * _CELL_POINTS
        path: Path = TextPath((-middle[0], -middle[1]), text, size=_CELL_POINTS)
        size = 2.0 * float(np.abs(path.vertices).max())
        look = {"linestyle": "", "color": colour, "markeredgewidth": 0, "label": text}
        ax.plot(*np.array(at).T, marker=path, markersize=size, **look)
    # Gaps in the colour of the page hide where the pixels of the image end.
    bottom, right = np.array(values.shape) - 0.5
    lines = [[(x - 0.5, -0.5), (x - 0.5, bottom)] for x in range(len(rows[0]) + 1)]
    lines += [[(-0.5, y - 0.5), (right, y - 0.5)] for y in range(len(rows) + 1)]
    ax.add_collection(LineCollection(lines, colors="white", linewidths=0.5))
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0, pad=2)


@cache
def _width_in(text: str, *, size: float = 7.0) -> float:
    """Return how wide a text of so many points is set."""
    font = FontProperties(family="DejaVu Sans", size=size)
    # Far quicker than the extent of the text's outline.
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return float(width) / _POINTS_PER_IN


def _name_swept(
    ax: Axes,
    columns: Sequence[Where],
    titles: Mapping[str, list[str]],
    sizes_in: tuple[float, float],
) -> None:
    """Write the swept mechanisms above their levels."""
    cell_in, block_in = sizes_in
    where: dict[str, Any] = {"transform": ax.get_xaxis_transform()}
    line = 1.0 + (_MECHANISMS_IN - 0.03) / block_in
    for mechanism in dict.fromkeys(name for name, _ in columns if name in titles):
        places = [place for place, (name, _) in enumerate(columns) if name == mechanism]
        ends = places[0] - 0.4, places[-1] + 0.4
        ax.plot(ends, [line, line], color="black", linewidth=0.5, clip_on=False, **where)
        room_in = cell_in * (len(places) - 0.3)
        room = max(4, int(room_in * drawing.CHARACTERS_PER_IN))
        fitting = (one for one in titles[mechanism] if _width_in(one) <= room_in)
        name = next(fitting, shortened(titles[mechanism][-1], room=room))
        ax.text(ends[0], 1.0 + _MECHANISMS_IN / block_in, name, **where)


def _words(_: Results, *, task: LinkedTask) -> str:
    rows = [row for block in task.cells.values() for row in block.values()]
    best = max(rows, key=lambda row: row["rank1"] if np.isfinite(row["rank1"]) else -1.0)
    outcomes = Counter(row["outcome"] for row in rows)
    counts = [f"{outcomes[outcome]} {outcome}" for outcome in ("links", *_MARKS)]
    where = f"{best['mechanism']} {level_text(best['level'])}".rstrip()
    return (
        f"{task.about}. Rank 1 in per cent, a row for each attack and adversary, a column for each "
        f"mechanism level. Of {len(rows)} cells: {', '.join(counts)}; "
        f"{sum(bool(row['invalid']) for row in rows)} invalid. "
        f"Highest: {PERCENT * best['rank1']:.0f} % at {where}."
    )


def _handles(rows: Sequence[Mapping[str, Any]]) -> list[Any]:
    """Return what stands in the legend."""
    shades = {"0 %": "#00224e", "50 %": "#7d7c78", "100 %": "#fee838"}
    handles: list[Any] = [Patch(color=colour, label=text) for text, colour in shades.items()]
    chance = {f"{PERCENT * row['chance']:.1f}" for row in rows if np.isfinite(row["chance"])}
    said = [f"chance: {one} %" for one in chance if len(chance) == 1]
    outcomes = {row["outcome"] for row in rows}
    said += [f"{mark}  {outcome}" for outcome, mark in _MARKS.items() if outcome in outcomes]
    handles += [Rectangle((0, 0), 0, 0, alpha=0, label=text) for text in said]
    if any(row[INVALID] for row in rows):
        leaks = drawing.handle("crossed out: a shortcut leaks", Look("#ff2222", "x", ""))
        handles.append(leaks)
    return handles
