"""The figures of the paper's results section, as SVG and PDF."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from evaluation.store import write_whole

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd


def draw_all(
    summary: pd.DataFrame,
    matched: pd.DataFrame,
    *,
    folder: Path,
    dataset: str,
    linkability: pd.DataFrame | None = None,
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
    linkability : DataFrame, optional
        As in `linkability.csv`.

    Raises
    ------
    DataError
        If the folder cannot be written.
    """
    # matplotlib is slow to import, and only needed to draw.
    from evaluation.attack_figure import attack_figure  # noqa: PLC0415
    from evaluation.drawing import FID, FIXED, operating_figure, sweep_figure  # noqa: PLC0415
    from evaluation.figure_style import rendered, style  # noqa: PLC0415
    from evaluation.linkage_figure import linkage_figure  # noqa: PLC0415

    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with style():
        for name, figure in (
            ("fid_threshold", sweep_figure(summary, scheme=FID, dataset=dataset)),
            ("fixed_error", sweep_figure(summary, scheme=FIXED, dataset=dataset)),
            ("operating_points", operating_figure(summary, matched, dataset=dataset)),
            ("after_attack", attack_figure(summary, dataset=dataset)),
            (
                "linkability",
                None if linkability is None else linkage_figure(linkability, dataset=dataset),
            ),
        ):
            if figure is None:
                continue
            for kind, content in rendered(figure).items():
                paths.append(folder / f"{name}.{kind}")
                write_whole(paths[-1], content)
    return paths
