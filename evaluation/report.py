"""Redraw everything from a run folder: `python -m evaluation.report OUT`.

Nothing is computed anew; summary, tables and figures follow from the finished cells.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from evaluation import figures, flags, linkability, page, paper, store, summary, tables, verdict
from evaluation.cell_files import check_sound
from evaluation.decisions import decisions
from evaluation.failures import COLUMNS as FAILED_COLUMNS
from evaluation.grid import SHARED
from evaluation.matching import MISSED, comparisons, matched
from evaluation.page_gallery import read_gallery
from evaluation.run_lock import locked
from evaluation.strongest import strongest_linkers
from evaluation.within_level import read_levels
from isac_track.command_line import DONE, FAILED_CELLS, Parser, exit_code
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, eq=False, slots=True)
class Results:
    """A finished run as data frames; the columns are those of the files in `out`."""

    out: Path
    manifest: dict[str, Any]
    summary: pd.DataFrame
    paper_table: pd.DataFrame
    claims: pd.DataFrame
    matched: pd.DataFrame
    decisions: pd.DataFrame
    curves: pd.DataFrame
    flags: pd.DataFrame
    linkability: pd.DataFrame
    verdict: dict[str, Any]
    """As in `verdict.json`."""
    failed: pd.DataFrame
    """Cells that could not be computed, and why; no other table holds their levels."""


def build(out: Path, *, pictures: bool = True, jobs: int = 1) -> Results:
    """Write summary, tables and figures of a run folder and return them.

    Parameters
    ----------
    out : Path
    pictures : bool
        Without them there are neither figures nor `report.html`.
    jobs : int
        Worker processes that draw.

    Raises
    ------
    IsacTrackError
        If the folder holds no run, or a cell is missing or broken.
    """
    manifest = store.read_manifest(out)
    dataset = manifest["dataset"]["name"]
    found, scored = summary.estimates(out, manifest)
    predictors = manifest["settings"]["predictors"]
    curves, decided, at_raw_alarms = decisions(scored, manifest, found)
    flagged = flags.flags(
        found,
        slow=flags.slow_attacks(manifest),
        once=flags.on_first_releases(out, manifest),
    )
    read = linkability.cards(out, manifest)
    linked = summary.linkage_estimates(read)
    everything = {**found, **at_raw_alarms, **linked}
    compared = tuple(comparisons(everything, predictors=predictors))
    at_equal = matched(compared, dataset=dataset)
    said = verdict.verdict(
        everything,
        compared,
        read_levels(out, manifest, success=strongest_linkers(everything)),
        manifest=manifest,
    )
    results = Results(
        out=out,
        manifest=manifest,
        summary=summary.to_frame({**found, **linked}, dataset=dataset),
        paper_table=paper.paper_table(found, dataset=dataset),
        claims=paper.claims(
            found,
            at_equal,
            dataset=dataset,
            history_points=manifest["history"]["points"],
            history_interval_s=manifest["history"]["interval_s"],
        ),
        matched=at_equal,
        decisions=decided,
        curves=curves,
        flags=flagged.rows,
        linkability=linkability.linkability(read, dataset=dataset),
        verdict=said,
        failed=pd.DataFrame(manifest.get("failed", []), columns=list(FAILED_COLUMNS)),
    )
    for frame, name in (
        (results.summary, "summary.csv"),
        (results.paper_table, "paper_table.csv"),
        (results.claims, "paper_claims.csv"),
        (results.matched, "matched.csv"),
        (results.decisions, "decisions.csv"),
        (results.curves, "curves.csv"),
        (results.linkability, "linkability.csv"),
        (results.failed, "failed.csv"),
    ):
        store.write_whole(out / name, frame.to_csv(index=False).encode())
    store.write_whole(out / "flags.json", flags.to_json(flagged))
    store.write_whole(out / "verdict.json", verdict.to_bytes(said))
    tables.write_tex(
        results.summary,
        results.paper_table,
        folder=out / "tables",
        linkability=results.linkability,
        said=said,
    )
    _remove_pictures(out)  # those of an earlier report tell of other results
    if pictures:
        _draw(results, jobs=jobs)
    return results


def _remove_pictures(out: Path) -> None:
    for path in (out / page.PAGE, *figures.paths(out / "figures")):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise DataError(
                f"cannot replace {path}: {error.strerror}; finished cells are kept"
            ) from None


def _draw(results: Results, *, jobs: int) -> None:
    at_equal = results.matched
    drawn = figures.draw_all(
        results.summary,
        at_equal[(at_equal["criterion"] == MISSED) & (at_equal["consumer"] == SHARED)],
        folder=results.out / "figures",
        dataset=results.manifest["dataset"]["name"],
        linkability=results.linkability,
        curves=results.curves,
        gallery=read_gallery(results.out),
        jobs=jobs,
    )
    page.write(results, drawn=drawn, verdict=results.verdict)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = Parser(
        prog="python -m evaluation.report",
        description="Redraw summary, tables and figures of a run folder from its finished cells.",
    )
    parser.add_argument("out", type=Path, help="folder of a run, as given to the matrix by --out")
    return exit_code(lambda: _redraw(parser.parse_args(arguments).out))


def _redraw(out: Path) -> int:
    manifest = store.read_manifest(out)
    with locked(out):
        check_sound(out, (name for entry in manifest["cells"] for name in entry["files"]))
        results = build(out)
    tables.show(
        results.summary,
        results.paper_table,
        results.claims,
        manifest=results.manifest,
        linkability=results.linkability,
    )
    tables.show_verdict(results.verdict)
    tables.show_flags(results.flags)
    tables.show_failed(results.failed)
    return FAILED_CELLS if len(results.failed) else DONE


if __name__ == "__main__":
    sys.exit(main())
