"""The heat map of a task: who links at which mechanism level."""

from __future__ import annotations

import functools
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Patch, Rectangle
from matplotlib.textpath import TextPath, text_to_path
from matplotlib.transforms import Affine2D

from evaluation.analysis.families import ADDING_RULES, FID
from evaluation.analysis.keys import level_text
from evaluation.analysis.linkability import INVALID
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import Look
from evaluation.reporting.rows import family_of, parameters_text, rank_of
from evaluation.reporting.schemes import schemes
from evaluation.reporting.texts import shortened

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.path import Path

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Source, Where
    from evaluation.analysis.linkability import LinkedTask
    from evaluation.reporting.run_results import Results
    from isac_track.types import Floats

_PERCENT = 100.0
# The page turns pure black and white over in the dark; what stands on a colour must stay.
_ON_DARK, _ON_BRIGHT = "#fefefe", "#010101"
_CELL_IN = 0.155
_CELL_POINTS = 6.2
_ROOM_IN = 0.06
_MECHANISMS_IN = 0.43
"""How far above the numbers the mechanisms stand."""
_POINTS_PER_IN = 72.0
_MARK_TOO_WEAK, _MARK_NOTHING = "?", "~"
_BRIGHT = 0.46
"""Share of the colour scale above which text is dark."""


def drawings(run: Results) -> list[Drawing]:
    """Return a figure for each task."""
    return [
        Drawing(
            name=f"heat_map-{task.name}",
            section="linkability",
            title=f"{task.name}: who links at which level",
            caption="? attack too weak: it fails even without any error, so its silence is no "
            "privacy. ~ no link detected. Crossed out: invalid, a shortcut tells people apart.",
            draw=partial(heat_figure, task, run.families, titles=_titles(run)),
            words=partial(_words, task),
            task=task.name,
        )
        for task in run.tasks
    ]


def heat_figure(
    task: LinkedTask, known: Mapping[str, Family], *, titles: Mapping[str, list[str]]
) -> Figure:
    """Return rank 1 of every attack and adversary at every level of a task, one block a rule.

    Columns run from no error to the controls. `~`: no link detected, `?`: the attack is too
    weak, crossed out: a shortcut leaks. `titles`: names of what is swept, longest first.
    """
    cells = task.cells
    sources = _by_attack(cells)
    ordered = _in_order(cells, known)
    rules = {name: family_of(known, name).adding for name, _ in cells}
    blocks = {
        rule: [where for where in ordered if rules[where[0]] in (rule, "")]
        for rule in ADDING_RULES
        if rule in rules.values()
    } or {"": ordered}
    names = [shortened(source.label, room=figure_style.NAME_LENGTH) for source in sources]
    left_in = max(_width_in(name) for name in names) + 0.12
    n_columns = max(map(len, blocks.values()))
    cell_in = min(2 * _CELL_IN, (figure_style.DOUBLE_COLUMN_IN - left_in - _ROOM_IN) / n_columns)
    # Above the numbers stand the levels, then the mechanisms that they are of.
    heads = {where: _head(where, known, titles) for where in cells}
    head_in = 0.2 + max(0.5, *map(_width_in, heads.values()))
    top_in, block_in = 0.22, _CELL_IN * len(sources)
    height_in = top_in + len(blocks) * (head_in + block_in) + 0.42
    figure = figure_style.placed_figure(width_in=figure_style.DOUBLE_COLUMN_IN, height_in=height_in)
    for place, (rule, columns) in enumerate(blocks.items()):
        y_in = height_in - top_in - (place + 1) * (head_in + block_in)
        ax = figure.add_axes(
            (
                left_in / figure.get_figwidth(),
                y_in / height_in,
                cell_in * len(columns) / figure.get_figwidth(),
                block_in / height_in,
            )
        )
        _draw_heat(ax, cells, sources=sources, columns=columns, cell_in=cell_in)
        ax.set_yticks(np.arange(len(sources)), names)
        ax.xaxis.tick_top()
        ax.set_xticks(np.arange(len(columns)), [heads[where] for where in columns], rotation=90)
        _name_swept(ax, columns, titles, block_in=block_in, cell_in=cell_in)
        if rule:
            # In the corner above the names.
            figure.text(0.01, (y_in + block_in + _MECHANISMS_IN) / height_in, f"{rule} adding")
    _heat_legend(figure, cells)
    of = next(iter(next(iter(cells.values())).values()))["dataset"]
    figure_style.title(figure, dataset=str(of), what=f"{task.name}, rank 1 in %", one_line=True)
    return figure


def _by_attack(cells: Mapping[Where, Mapping[Source, Any]]) -> list[Source]:
    """Return who links, the adversaries of one attack together, as in the run."""
    found = dict.fromkeys(source for block in cells.values() for source in block)
    attacks = list(dict.fromkeys(source.consumer for source in found))
    return sorted(found, key=lambda source: attacks.index(source.consumer))


def _in_order(cells: Mapping[Where, Any], known: Mapping[str, Family]) -> list[Where]:
    """Return the columns: no error first, FID with less and less, fixed, then the controls."""
    names = list(dict.fromkeys(name for name, _ in cells))

    def key(where: Where) -> tuple[int, int, float]:
        one, at = family_of(known, where[0]), where[1] or 0.0
        return rank_of(one), names.index(where[0]), -at if one.family == FID else at

    return sorted(cells, key=key)


def _draw_heat(
    ax: Axes,
    cells: Mapping[Where, Mapping[Source, Any]],
    *,
    sources: Sequence[Source],
    columns: Sequence[Where],
    cell_in: float,
) -> None:
    values = np.full((len(sources), len(columns)), np.nan)
    texts: dict[tuple[int, int], str] = {}
    crossed = []
    for x, where in enumerate(columns):
        for y, source in enumerate(sources):
            row = cells[where].get(source)
            if row is None or not np.isfinite(row["rank1"]):
                continue
            values[y, x] = _PERCENT * row["rank1"]
            texts[y, x] = _cell_text(row)
            if row["invalid"]:
                crossed += [[(x - 0.5, y - 0.5), (x + 0.5, y + 0.5)]]
                crossed += [[(x - 0.5, y + 0.5), (x + 0.5, y - 0.5)]]
    ax.imshow(
        values, aspect="auto", cmap="cividis", vmin=0.0, vmax=_PERCENT, interpolation="nearest"
    )
    ax.add_collection(LineCollection(crossed, colors="#ff2222", linewidths=0.7))
    _draw_texts(ax, texts, values, cell_in=cell_in)
    # Gaps in the colour of the page hide where the pixels of the image end.
    lines = [[(x - 0.5, -0.5), (x - 0.5, len(sources) - 0.5)] for x in range(len(columns) + 1)]
    lines += [[(-0.5, y - 0.5), (len(columns) - 0.5, y - 0.5)] for y in range(len(sources) + 1)]
    ax.add_collection(LineCollection(lines, colors="white", linewidths=0.5))
    ax.grid(visible=False)
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0, pad=2)


def _cell_text(row: Mapping[str, Any]) -> str:
    if row["outcome"] == "attack too weak":
        return _MARK_TOO_WEAK
    mark = _MARK_NOTHING if row["outcome"] == "no link detected" else ""
    return f"{mark}{_PERCENT * row['rank1']:.0f}"


def _draw_texts(
    ax: Axes,
    texts: Mapping[tuple[int, int], str],
    values: Floats,
    *,
    cell_in: float,
) -> None:
    """Print the numbers as markers, one artist for each character: texts would take seconds."""
    width = {
        one: _text_width(one, points=_CELL_POINTS) for text in set(texts.values()) for one in text
    }
    places: dict[tuple[str, str], list[tuple[float, float]]] = {}
    per_cell = cell_in * _POINTS_PER_IN
    for (y, x), text in texts.items():
        colour = _ON_BRIGHT if values[y, x] > _BRIGHT * _PERCENT else _ON_DARK
        start = x - 0.5 * sum(width[one] for one in text) / per_cell
        for one in text:
            middle = start + 0.5 * width[one] / per_cell
            places.setdefault((one, colour), []).append((middle, y))
            start += width[one] / per_cell
    for (one, colour), at in places.items():
        # In the middle by the height of a digit, whatever the character.
        to_middle = Affine2D().translate(-0.5 * width[one], -0.365 * _CELL_POINTS)
        path: Path = TextPath((0, 0), one, size=_CELL_POINTS).transformed(to_middle)
        ax.plot(
            *np.array(at).T,
            linestyle="",
            marker=path,
            markersize=2.0 * float(np.abs(path.vertices).max()),
            color=colour,
            markeredgewidth=0,
        )


@functools.cache
def _text_width(text: str, *, points: float) -> float:
    """Return how wide a text is set, in points."""
    font = FontProperties(family="DejaVu Sans", size=points)
    # Far quicker than the extent of the text's outline.
    width, _, _ = text_to_path.get_text_width_height_descent(text, font, ismath=False)
    return float(width)


def _width_in(text: str) -> float:
    return _text_width(text, points=7.0) / _POINTS_PER_IN


def _name_swept(
    ax: Axes,
    columns: Sequence[Where],
    titles: Mapping[str, list[str]],
    *,
    block_in: float,
    cell_in: float,
) -> None:
    """Write the swept mechanisms above their levels."""
    swept: dict[str, list[int]] = {}
    for place, (mechanism, _) in enumerate(columns):
        if mechanism in titles:
            swept.setdefault(mechanism, []).append(place)
    transform = ax.get_xaxis_transform()
    line = 1.0 + (_MECHANISMS_IN - 0.03) / block_in
    for mechanism, places in swept.items():
        ends = places[0] - 0.4, places[-1] + 0.4
        ax.plot(
            ends, [line, line], transform=transform, color="black", linewidth=0.5, clip_on=False
        )
        room_in = cell_in * (len(places) - 0.3)
        short = shortened(
            titles[mechanism][-1], room=max(4, int(room_in * figure_style.CHARACTERS_PER_IN))
        )
        name = next((one for one in titles[mechanism] if _width_in(one) <= room_in), short)
        ax.text(ends[0], 1.0 + _MECHANISMS_IN / block_in, name, transform=transform)


def _titles(run: Results) -> dict[str, list[str]]:
    """Return names of what is swept by mechanism, longest first."""
    return {
        mechanism: [scheme.label, scheme.name, run.families[mechanism].family]
        for scheme in schemes(run.summary)
        for mechanism in scheme.mechanisms.values()
    }


def _head(where: Where, known: Mapping[str, Family], titles: Mapping[str, list[str]]) -> str:
    """Return the head of a column: its level, and what it is unless that stands above it."""
    mechanism, level = where
    at = "" if level is None else figure_style.number(level)
    if mechanism in titles:
        return at
    one = family_of(known, mechanism)
    return " ".join(filter(None, [one.family, at, parameters_text(one)]))


def _words(task: LinkedTask) -> str:
    rows = [row for block in task.cells.values() for row in block.values()]
    best = max(rows, key=lambda row: row["rank1"] if np.isfinite(row["rank1"]) else -1.0)
    counts = [
        f"{sum(row['outcome'] == outcome for row in rows)} {outcome}"
        for outcome in ("links", "no link detected", "attack too weak")
    ]
    where = f"{best['mechanism']} {level_text(best['level'])}".rstrip()
    return (
        f"{task.about}. Rank 1 in per cent, a row for each attack and adversary, a column for each "
        f"mechanism level. Of {len(rows)} cells: {', '.join(counts)}; "
        f"{sum(bool(row['invalid']) for row in rows)} invalid. "
        f"Highest: {_PERCENT * best['rank1']:.0f} % at {where}."
    )


def _heat_legend(figure: Figure, cells: Mapping[Where, Mapping[Source, Any]]) -> None:
    rows = [row for block in cells.values() for row in block.values()]
    handles: list[Any] = [Patch(color="#00224e", label="0 %"), Patch(color="#7d7c78", label="50 %")]
    handles.append(Patch(color="#fee838", label="100 %"))
    chance = {f"{_PERCENT * row['chance']:.1f}" for row in rows if np.isfinite(row["chance"])}
    if len(chance) == 1:
        handles.append(Rectangle((0, 0), 0, 0, alpha=0, label=f"chance: {chance.pop()} %"))
    outcomes = {row["outcome"] for row in rows}
    for outcome, mark in (("no link detected", "~"), ("attack too weak", "?")):
        if outcome in outcomes:
            handles.append(Rectangle((0, 0), 0, 0, alpha=0, label=f"{mark}  {outcome}"))
    if any(row[INVALID] for row in rows):
        handles.append(
            figure_style.line_handle("crossed out: a shortcut leaks", Look("#ff2222", "x", ""))
        )
    figure_style.legend_in_rows(figure, handles, columns=len(handles))
