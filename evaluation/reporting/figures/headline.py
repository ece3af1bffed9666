"""The headline: what the descriptor says, and what an adversary gets, over the level."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from evaluation.analysis.metrics import EXPOSURE
from evaluation.experiment.presets import SHARED
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import Look
from evaluation.reporting.schemes import rules_of, schemes
from evaluation.reporting.texts import shortened

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from evaluation.analysis.keys import Source
    from evaluation.reporting.run_results import Results

_PERCENT = 100.0
_LOOKS = (Look("#000000", "o", "-"), Look("#0072B2", "s", "--"), Look("#D55E00", "^", "-."))
_MOST_SINGLE = 2
"""Panels that fit into one column of a journal."""


def drawings(run: Results) -> list[Drawing]:
    """Return the figure of the first screen."""
    return [
        Drawing(
            name="headline",
            section="answer",
            title="What the descriptor says, and what an adversary gets",
            caption="If the descriptor told linkability, the lines would fall together.",
            draw=partial(headline_figure, run),
            words=partial(_words, run),
        )
    ]


def headline_figure(run: Results) -> Figure | None:
    """Return PLR as shared, after the strongest attack, and the strongest link, over the level.

    One panel for each way of adding error, under the paper's adding rule if it was run. None
    without levels.
    """
    lines = headline_lines(run)
    shared = next(iter(lines.values()))
    known = schemes(run.ours)
    rule = next(iter(rules_of(known)), "")
    known = [scheme for scheme in known if not scheme.of(shared, rule).empty]
    if not known:
        return None
    is_wide = len(known) > _MOST_SINGLE
    figure = figure_style.placed_figure(
        width_in=figure_style.DOUBLE_COLUMN_IN if is_wide else figure_style.SINGLE_COLUMN_IN,
        height_in=2.65,
    )
    panels = figure_style.placed(
        figure, rows=1, columns=len(known), left_in=0.5, right_in=0.08, top_in=0.42,
        bottom_in=0.62 + 0.15 * len(lines), gap_in=0.22, sharey=True,
    )[0]  # fmt: skip
    for scheme, ax in zip(known, panels, strict=True):
        ax.set_title(scheme.title)
        ax.set_xlabel(scheme.label)
        for look, rows in zip(_LOOKS, lines.values(), strict=False):
            found = scheme.of(rows, rule)
            x = found["level"].to_numpy()
            y, low, high = (
                _PERCENT * found[end].to_numpy() for end in ("value", "ci_low", "ci_high")
            )
            ax.plot(x, y, color=look.colour, marker=look.marker, linestyle=look.dashes)
            figure_style.band(ax, x=x, low=low, high=high, look=look)
            at_edge = (0.93, 1.0) if scheme.log else (0.0, 0.07)
            for value in rows.loc[rows["mechanism"] == "raw", "value"]:
                ax.plot(
                    at_edge,
                    [_PERCENT * value] * 2,
                    transform=ax.get_yaxis_transform(),
                    color=look.colour,
                    linestyle=":",
                )
        figure_style.level_axis(ax, log=scheme.log)
    panels[0].set_ylim(0.0, 103.0)
    panels[0].set_ylabel("%")
    figure_style.legend_in_rows(
        figure,
        [
            *(figure_style.line_handle(*one) for one in zip(lines, _LOOKS, strict=False)),
            figure_style.black_handle("raw (at its edge); bands: 95 % intervals", dashes=":"),
        ],
        columns=1,
    )
    figure_style.title(figure, dataset=run.dataset, what=f"{rule} adding", one_line=True)
    return figure


def headline_lines(run: Results) -> dict[str, pd.DataFrame]:
    """Return rows (mechanism, level, value, interval) of the headline's lines by their label."""
    plr = run.ours[(run.ours["metric"] == EXPOSURE) & np.isfinite(run.ours["value"])]
    lines = {"PLR as shared: the descriptor": plr[plr["consumer"] == SHARED]}
    attack = run.strongest.get("")
    if attack is not None:
        rows = plr[(plr["consumer"] == attack.consumer) & (plr["knowledge"] == attack.knowledge)]
        lines[f"PLR after {_short(attack)}"] = rows
    # A walk that was shared twice, or whatever was linked first.
    for task in sorted(run.tasks, key=lambda one: one.name != "rerelease")[:1]:
        source = run.link_of(task)
        lines[f"found again ({task.name}, rank 1): {_short(source)}"] = pd.DataFrame(
            [
                [mechanism, np.nan if level is None else level]
                + [block[source][key] for key in ("rank1", "ci_low", "ci_high")]
                for (mechanism, level), block in task.cells.items()
                if source in block and np.isfinite(block[source]["rank1"])
            ],
            columns=["mechanism", "level", "value", "ci_low", "ci_high"],
        )
    return lines


def _words(run: Results) -> str:
    known = schemes(run.ours)
    rule = next(iter(rules_of(known)), "")
    parts = []
    for scheme in known:
        said = [
            f"{label} {ends}"
            for label, rows in headline_lines(run).items()
            if (ends := scheme.ends(rows, rule, EXPOSURE))
        ]
        if said:
            parts.append(f"{scheme.title}: {'; '.join(said)}.")
    return f"Lines over the level, {rule} adding. {' '.join(parts)}"


def _short(source: Source) -> str:
    return shortened(source.label, room=figure_style.NAME_LENGTH)
