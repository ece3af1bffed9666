"""Figures of a run, drawn, and what every one must keep to."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection

from evaluation.reporting.figures.drawing import figures_of, style


def draw(run, name, *, whole=False):
    """Draw a figure of a run by its name, with `whole` to its last line; None without one."""
    found = [one for one in figures_of(run) if one.name == name]
    with style():
        figure = found[0].draw(run) if found else None
        if whole and figure is not None:
            figure.draw_without_rendering()
    return figure


def assert_is_readable(figure):
    """Text lies within the figure and is readable; the legend is below the panels."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    room = figure.bbox
    legend = figure.legends[0].get_window_extent(renderer)
    title = figure._suptitle.get_window_extent(renderer)
    for box in (legend, title):
        assert room.x0 <= box.x0 <= box.x1 <= room.x1
    for ax in figure.axes:
        panel = ax.get_tightbbox(renderer)
        assert legend.y1 <= panel.y0 <= panel.y1 <= title.y0
        assert room.x0 <= panel.x0 <= panel.x1 <= room.x1
    assert figure.get_figwidth() in (3.5, 7.16)
    texts = figure.findobj(lambda one: hasattr(one, "get_fontsize"))
    assert min(text.get_fontsize() for text in texts) >= 7


def named(figure):
    """Return the words of a figure's legend."""
    return [text.get_text() for text in figure.legends[0].get_texts()]


def described(figure):
    """What a figure shows, in lines: title, panels with their lines and data, and legend."""
    lines = [figure._suptitle.get_text()]
    for ax in figure.axes:
        axes = [f"{get()}" for get in (ax.get_xlabel, ax.get_xscale, ax.get_ylabel, ax.get_yscale)]
        lines.append(f"panel {ax.get_title(loc='left')!r}: {axes}")
        glyphs = [line for line in ax.lines if not isinstance(line.get_marker(), str)]
        lines += [
            f"  {sum(len(one.get_label()) * len(one.get_xdata()) for one in glyphs)} characters"
        ] * bool(glyphs)
        for line in ax.lines:
            if line not in glyphs:
                look = f"{line.get_color()} {line.get_marker()} {line.get_linestyle()}"
                look += " hollow" * (line.get_markerfacecolor() == "white")
                data = " ".join(f"({x:.4g}, {y:.4g})" for x, y in line.get_xydata())
                lines.append(f"  {look}: {data}")
        for one in ax.collections:
            ends = one.get_datalim(ax.transData).extents
            kind = "bars" if isinstance(one, LineCollection) else "band"
            lines.append(f"  {kind}: {' '.join(f'{end:.4g}' for end in ends)}")
        lines += [f"  text {text.get_text()!r}" for text in ax.texts]
        for image in ax.images:
            lines.append(f"  heads {[text.get_text() for text in ax.get_xticklabels()]}")
            rows = zip(ax.get_yticklabels(), image.get_array().tolist(), strict=True)
            lines += [f"  {name.get_text()}: {[f'{v:.3g}' for v in of]}" for name, of in rows]
    return "\n".join([*lines, f"legend {named(figure)}", ""])
