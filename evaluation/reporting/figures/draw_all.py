"""All figures of a run, as SVG and PDF."""

from __future__ import annotations

import contextlib
from collections import deque
from functools import partial
from typing import TYPE_CHECKING

from evaluation.cells.progress import Failed
from evaluation.reporting.figures.drawing import figures_of
from evaluation.reporting.figures.style import rendered, style
from evaluation.runs.files import write_whole
from evaluation.runs.workers import spread
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from evaluation.reporting.run_results import Results


def draw_all(run: Results, *, folder: Path, jobs: int = 1) -> list[Path]:
    """Draw every figure that the results allow and return the files written.

    Parameters
    ----------
    run : Results
    folder : Path
        Made if it is missing.
    jobs : int
        Worker processes; what they draw does not depend on their number.

    Raises
    ------
    DataError
        If the folder cannot be written.
    """
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    drawn: dict[str, dict[str, bytes]] = {}
    draw = partial(_drawn, run=run, step=jobs)
    for _, found in spread(draw, deque(range(jobs)), jobs=jobs, limit_s=None):
        for one in found:
            if isinstance(one, Failed):
                raise DataError(f"cannot draw the figures: {one.why}; run evaluation.report again")
            drawn[one[0]] = one[1]
    written = []
    for name in sorted(drawn):
        for kind, content in drawn[name].items():
            written.append(folder / f"{name}.{kind}")
            write_whole(written[-1], content)
    return written


def _drawn(first: int, *, run: Results, step: int) -> Iterator[tuple[str, dict[str, bytes]]]:
    """Yield name and files, by kind, of every so many-th figure; one that is empty has none."""
    with style():
        for one in figures_of(run)[first::step]:  # one at a time is in memory
            figure = one.draw()
            if figure is not None:
                yield one.name, rendered(figure)
