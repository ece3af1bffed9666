"""The figures of a run: a file in this folder with a function `drawings` makes some."""

from __future__ import annotations

import contextlib
from collections import deque
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from evaluation.cells.work import Failed
from evaluation.reporting.figures.style import rendered, style
from evaluation.runs.files import write_whole
from evaluation.runs.workers import spread
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from matplotlib.figure import Figure

    from evaluation.reporting.rows import Results


@dataclass(frozen=True, eq=False, slots=True)
class Drawing:
    """A figure of a run: how it is called, where it stands, and how it is drawn and told."""

    name: str
    """Of its files."""
    section: str
    """Of the page."""
    title: str
    draw: Callable[[Results], Figure | None]
    """None where the run has nothing to draw."""
    words: Callable[[Results], str]
    """What it shows, in numbers, for whoever does not see it."""
    caption: str = ""
    task: str = ""
    """The only linkage task that it is of."""


def figures_of(run: Results) -> list[Drawing]:
    """Return the figures of a run, of every file of this folder that has any."""
    folder = __name__.rpartition(".")[0]
    names = [one.name for one in iter_modules(import_module(folder).__path__)]
    modules = [import_module(f"{folder}.{name}") for name in names]
    return [
        one for module in modules if hasattr(module, "drawings") for one in module.drawings(run)
    ]


def draw_all(run: Results, *, folder: Path, jobs: int = 1, pdf: bool = False) -> list[Path]:
    """Draw every figure that the results allow, as SVG, and return the files written.

    `jobs` workers draw, whose number changes nothing; with `pdf` each is written as PDF, too.
    Raises DataError if the folder cannot be written.
    """
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, bytes] = {}
    draw = partial(_drawn, run=run, step=jobs, pdf=pdf)
    for _, found in spread(draw, deque(range(jobs)), jobs=jobs, limit_s=None):
        for one in found:
            if isinstance(one, Failed):
                raise DataError(f"cannot draw the figures: {one.why}; run evaluation.report again")
            files |= one
    for name in sorted(files):
        write_whole(folder / name, files[name])
    return [folder / name for name in sorted(files)]


def _drawn(first: int, *, run: Results, step: int, pdf: bool) -> Iterator[dict[str, bytes]]:
    """Yield the files of every so many-th figure by name; one that is empty has none."""
    with style():
        for one in figures_of(run)[first::step]:  # one at a time is in memory
            figure = one.draw(run)
            if figure is not None:
                files = rendered(figure, pdf=pdf)
                yield {f"{one.name}.{kind}": of for kind, of in files.items()}
