"""Figures of a run, drawn, and what every one must keep to."""

from matplotlib.backends.backend_agg import FigureCanvasAgg

from evaluation.reporting.figures.drawing import figures_of
from evaluation.reporting.figures.style import style


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
