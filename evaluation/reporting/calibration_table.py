"""The constants of the sensing model and what they predict, beside the paper's numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluation.analysis.calibration import FITTED
from evaluation.analysis.metrics import METRICS
from evaluation.analysis.paper import PUBLISHED
from evaluation.reporting import terminal
from evaluation.reporting.table import Column, Table, number, word, words

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evaluation.analysis.calibration import Calibration

_ABOUT = (
    "rates and PLR in %, lengths in s; fitted: raw PLR, raw MEL and the PLR of fid:1000; all "
    "others (linear adding) are predictions"
)


def show(found: Mapping[str, Calibration]) -> None:
    """Print constants and numbers by what was fixed beforehand."""
    rows = [
        [word(name), number(None)]
        + [number(getattr(fit, name), digits=2) for fit, _ in found.values()]
        for name in FITTED
    ]
    for mechanism, level, metric, published in PUBLISHED:
        spec = mechanism if level is None else f"{mechanism}:{level:g}"
        numbers = [published, *(ours[spec, metric] for _, ours in found.values())]
        scale, digits = METRICS[metric].scale, 1 if METRICS[metric].is_share else 2
        cells = [number(value, scale=scale, digits=digits) for value in numbers]
        rows.append([word(f"{spec} {metric}"), *cells])
    columns = [*words("constant or number"), Column("paper"), *map(Column, found)]
    title = "paper, and what each set of constants gives"
    terminal.show([Table("calibration", title, columns, rows, notes=[_ABOUT])])
