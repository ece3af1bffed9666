"""What a figure of a run is: a file in this folder with a function `drawings` makes some."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

    from evaluation.reporting.run_results import Results


@dataclass(frozen=True, eq=False, slots=True)
class Drawing:
    """A figure of a run: how it is called, where it stands, and how it is drawn and told."""

    name: str
    """Of its files."""
    section: str
    """Of the page."""
    title: str
    draw: Callable[[], Figure | None]
    """None where the run has nothing to draw."""
    words: Callable[[], str]
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
