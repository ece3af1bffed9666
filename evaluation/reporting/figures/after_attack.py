"""PLR over the level: as shared, after each attack, and the headline beside who is found again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.keys import AS_SHARED, ORACLE, Source
from evaluation.analysis.metrics import EXPOSURE
from evaluation.analysis.strongest import most_knowing
from evaluation.experiment.presets import IDENTITY
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import LOOKS, Line, Look
from evaluation.reporting.rows import of_source, rank1_rows, rules_of, schemes
from evaluation.reporting.summary_tables import after_attack, sources_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from evaluation.reporting.rows import Results

# The oracle is set apart: grey, thin and hollow.
_ORACLE: dict[str, Any] = {"linewidth": 0.8, "markerfacecolor": "white"}
_ORACLE_LOOKS = Look("#777777", "D", (0, (2, 1.5))), Look("#999999", "v", (0, (4, 1.5)))
_SHARED_LOOK = Look("#000000", "o", "-")
_LOOKS = _SHARED_LOOK, Look("#0072B2", "s", "--"), Look("#D55E00", "^", "-.")
_MOST_SINGLE = 2
"""Panels that fit into one column of a journal."""


def drawings(_: Results) -> list[Drawing]:
    """Return the figures of the first screen, and of what is left after attack."""
    about = "What the descriptor says, and what an adversary gets"
    caption = "If the descriptor told linkability, the lines would fall together."
    every = "PLR as shared and after each attack, over the level"
    return [
        Drawing("after_attack", "after", every, attack_figure, _words),
        Drawing("headline", "answer", about, headline_figure, _headline_words, caption),
    ]


def attack_figure(run: Results) -> Figure | None:
    """Return PLR over the level, as shared and after each attack; None without attacks or levels.

    One column for each adding rule, one row for each way of adding error. Of each attack the
    adversary is drawn that knows most short of the oracle; an attack that only the oracle can
    run is drawn as a reference. The control, which repeats what was shared, is left out, and so
    is what lies beyond the looks that there are.
    """
    rows = _exposure(after_attack(run.ours))
    known = schemes(rows)
    every = _lines(rows).items()
    lines = {of: line for of, line in every if any(one.rules_in(line.rows) for one in known)}
    if not lines.keys() - {AS_SHARED}:
        return None
    known = [one for one in known if one.rules_in(*(line.rows for line in lines.values()))]
    columns, height_in = rules_of(known), 2.0 * len(known) + 0.9
    figure, panels = figure_style.panels(
        len(known), len(columns), height_in=height_in, sharex="row", sharey=True
    )
    for scheme, axes in zip(known, panels, strict=True):
        for rule, ax in zip(columns, axes, strict=True):
            if rule not in scheme.mechanisms:
                ax.set_axis_off()
                continue
            ax.set_title(f"{scheme.title}, {scheme.rule_text(rule)}")
            ax.set_xlabel(scheme.label)
            for line in lines.values():
                line.draw(ax, scheme, rule)
        figure_style.level_axis(axes[0], log=scheme.log)
        axes[0].set_ylabel("PLR, shared or attacked (%)")
    # A share: the whole axis, with a little room for markers at its ends.
    panels[0, 0].set_ylim(-3.0, 103.0)
    handles: list[Any] = [line.handle for line in lines.values()]
    if any(line.raw is not None for line in lines.values()):
        handles.append(figure_style.black_handle("raw (attacks: at its edge)", dashes=":"))
    handles.append(figure_style.band_handle("95 % interval"))
    what = "what an adversary who filters gets back"
    return figure_style.finish(figure, handles, dataset=run.dataset, what=what)


def _words(run: Results) -> str:
    strongest, rows = run.strongest.get(""), _exposure(after_attack(run.ours))
    if strongest is None:
        return ""
    shared, after = of_source(rows, AS_SHARED), of_source(rows, strongest)
    parts = [
        f"{scheme.title}, {scheme.rule_text(rule)}: as shared {before}; after {strongest.label} "
        f"{scheme.ends(after, rule, EXPOSURE)}."
        for scheme in schemes(run.ours)
        for rule in scheme.rules
        if (before := scheme.ends(shared, rule, EXPOSURE))
    ]
    return f"Lines of PLR over the level. {' '.join(parts)}"


def _exposure(rows: pd.DataFrame) -> pd.DataFrame:
    found: pd.DataFrame = rows[(rows["metric"] == EXPOSURE) & np.isfinite(rows["value"])]
    return found


def _lines(rows: pd.DataFrame) -> dict[Source, Line]:
    """Return what is drawn, with its looks."""
    chosen = [source for source in most_knowing(sources_of(rows)) if source.consumer != IDENTITY]
    oracle = [source for source in chosen if source.knowledge == ORACLE]
    others = [source for source in chosen if source.knowledge and source not in oracle]
    looks = {AS_SHARED: _SHARED_LOOK} if AS_SHARED in chosen else {}
    looks |= dict(zip(others, LOOKS, strict=False))
    references = dict(zip(oracle, _ORACLE_LOOKS, strict=False))
    # Raw after attacks would crowd each other.
    return {
        of: Line(
            "as shared" if of == AS_SHARED else of.label,
            look,
            of_source(rows, of),
            is_raw_across=of == AS_SHARED,
        )
        for of, look in looks.items()
    } | {
        of: Line(f"{of.label}, a reference", look, of_source(rows, of), apart=_ORACLE)
        for of, look in references.items()
    }


def headline_figure(run: Results) -> Figure | None:
    """Return PLR as shared, after the strongest attack, and the strongest link, over the level.

    One panel for each way of adding error, under the paper's adding rule if it was run. None
    without levels.
    """
    lines, known = headline_lines(run), schemes(run.ours)
    rule = next(iter(rules_of(known)), "")
    known = [scheme for scheme in known if not scheme.of(lines[0].rows, rule).empty]
    if not known:
        return None
    widths = figure_style.SINGLE_COLUMN_IN, figure_style.DOUBLE_COLUMN_IN
    figure, ((*panels,),) = figure_style.panels(
        *(1, len(known)),
        width_in=widths[len(known) > _MOST_SINGLE],
        height_in=2.65,
        margins_in=(0.5, 0.08, 0.42, 0.62 + 0.15 * len(lines)),
        gaps_in=(0.22, 0.0),
        sharey=True,
    )
    for scheme, ax in zip(known, panels, strict=True):
        ax.set_title(scheme.title)
        ax.set_xlabel(scheme.label)
        for line in lines:
            line.draw(ax, scheme, rule)
        figure_style.level_axis(ax, log=scheme.log)
    panels[0].set_ylim(0.0, 103.0)
    panels[0].set_ylabel("%")
    raw = figure_style.black_handle("raw (at its edge); bands: 95 % intervals", dashes=":")
    handles = [*(line.handle for line in lines), raw]
    what = f"{rule} adding"
    return figure_style.finish(figure, handles, dataset=run.dataset, what=what, columns=1)


def headline_lines(run: Results) -> list[Line]:
    """Return the lines of the headline, those as shared first."""
    plr = _exposure(run.ours)
    rows = {"PLR as shared: the descriptor": of_source(plr, AS_SHARED)}
    attack = run.strongest.get("")
    if attack is not None:
        rows[f"PLR after {figure_style.short(attack)}"] = of_source(plr, attack)
    # A walk that was shared twice, or whatever was linked first.
    for task in sorted(run.tasks, key=lambda one: one.name != "rerelease")[:1]:
        source = run.link_of(task)
        label = f"found again ({task.name}, rank 1): {figure_style.short(source)}"
        rows[label] = rank1_rows(task, source)
    return [Line(label, look, of) for (label, of), look in zip(rows.items(), _LOOKS, strict=False)]


def _headline_words(run: Results) -> str:
    known, lines = schemes(run.ours), headline_lines(run)
    rule = next(iter(rules_of(known)), "")
    parts = []
    for scheme in known:
        ends = {line.label: scheme.ends(line.rows, rule, EXPOSURE) for line in lines}
        said = [f"{label} {text}" for label, text in ends.items() if text]
        parts += [f"{scheme.title}: {'; '.join(said)}."] if said else []
    return f"Lines over the level, {rule} adding. {' '.join(parts)}"
