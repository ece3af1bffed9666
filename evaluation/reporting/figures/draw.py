"""All figures of a run, as SVG and PDF."""

from __future__ import annotations

import contextlib
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any

from evaluation.cells.progress import Failed
from evaluation.runs.files import write_whole
from evaluation.runs.folder import DISSOCIATION, FIGURES, HEAT_MAP
from evaluation.runs.workers import spread
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    import pandas as pd
    from matplotlib.figure import Figure

_DISSOCIATED = ("rerelease", "handover")


def draw_all(
    summary: pd.DataFrame,
    matched: pd.DataFrame,
    *,
    folder: Path,
    dataset: str,
    linkability: pd.DataFrame | None = None,
    curves: pd.DataFrame | None = None,
    gallery: pd.DataFrame | None = None,
    jobs: int = 1,
) -> list[Path]:
    """Draw every figure that the results allow and return the files written.

    Parameters
    ----------
    summary, matched : DataFrame
        As in `summary.csv` and `matched.csv`.
    folder : Path
        Made if it is missing.
    dataset : str
        Rows of other data sets are left out, except those of tasks that have their own.
    linkability, curves : DataFrame, optional
        As in `linkability.csv` and `curves.csv`.
    gallery : DataFrame, optional
        As `page_gallery.read_gallery` returns it.
    jobs : int
        Worker processes; what they draw does not depend on their number.

    Raises
    ------
    DataError
        If the folder cannot be written.
    """
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {
        "summary": summary,
        "matched": matched,
        "dataset": dataset,
        "linkability": linkability,
        "curves": curves,
        "gallery": gallery,
    }
    drawn: dict[str, dict[str, bytes]] = {}
    draw = partial(_drawn, step=jobs, **results)
    for _, found in spread(draw, deque(range(jobs)), jobs=jobs, limit_s=None):
        for one in found:
            if isinstance(one, Failed):
                raise DataError(f"cannot draw the figures: {one.why}; run evaluation.report again")
            drawn[one[0]] = one[1]
    written = []
    for name in sorted(drawn, key=FIGURES.index):
        for kind, content in drawn[name].items():
            written.append(folder / f"{name}.{kind}")
            write_whole(written[-1], content)
    return written


def _drawn(
    first: int,
    *,
    step: int,
    **results: Any,  # noqa: ANN401 - handed on to _figures
) -> Iterator[tuple[str, dict[str, bytes]]]:
    """Yield name and files, by kind, of every so many-th figure; one that is empty has none."""
    # matplotlib is slow to import, and only needed to draw.
    from evaluation.reporting.figures.style import rendered, style  # noqa: PLC0415

    with style():
        for name, draw in list(_figures(**results).items())[first::step]:
            figure = draw()
            if figure is not None:
                yield name, rendered(figure)


def _figures(
    *,
    summary: pd.DataFrame,
    matched: pd.DataFrame,
    dataset: str,
    linkability: pd.DataFrame | None,
    curves: pd.DataFrame | None,
    gallery: pd.DataFrame | None,
) -> Mapping[str, Callable[[], Figure | None]]:
    """Return how to draw each figure, in the order of `FIGURES`; one at a time is in memory."""
    from evaluation.reporting.figures import page_figures  # noqa: PLC0415 - as above
    from evaluation.reporting.figures.attack import attack_figure  # noqa: PLC0415
    from evaluation.reporting.figures.heat import heat_figure  # noqa: PLC0415
    from evaluation.reporting.figures.linkage import linkage_figure  # noqa: PLC0415
    from evaluation.reporting.figures.sweeps import FID, FIXED, operating_figure, sweep_figure  # noqa: PLC0415
    from evaluation.reporting.figures.track_gallery import gallery_figure  # noqa: PLC0415

    found: dict[str, Callable[[], Figure | None]] = {
        "fid_threshold": lambda: sweep_figure(summary, scheme=FID, dataset=dataset),
        "fixed_error": lambda: sweep_figure(summary, scheme=FIXED, dataset=dataset),
        "operating_points": lambda: operating_figure(summary, matched, dataset=dataset),
        "after_attack": lambda: attack_figure(summary, dataset=dataset),
    }
    if curves is not None:
        found["false_alarms"] = lambda: page_figures.curves_figure(curves, summary, dataset=dataset)
    if gallery is not None:
        found["track_gallery"] = lambda: gallery_figure(gallery)
    if linkability is None:
        return found
    tasks = {task.name: task for task in page_figures.tasks_of(linkability, dataset=dataset)}
    found["headline"] = lambda: page_figures.headline_figure(
        summary, list(tasks.values()), dataset=dataset
    )
    found["linkability"] = lambda: linkage_figure(linkability, dataset=dataset)
    for name, task in tasks.items():
        found[f"{HEAT_MAP}-{name}"] = partial(heat_figure, task)
        if name.startswith(_DISSOCIATED):
            found[f"{DISSOCIATION}-{name}"] = partial(
                page_figures.dissociation_figure, summary, task, dataset=dataset
            )
    return found
