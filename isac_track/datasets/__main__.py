"""``python -m isac_track.datasets``: what data sets are here, what is in them, and get more."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from isac_track.command_line import DONE, WRONG, Parser, exit_code
from isac_track.datasets import load
from isac_track.datasets.registry import KNOWN, complete, known, locate, searched, shown
from isac_track.datasets.rows import listed
from isac_track.datasets.summary import FROZEN_SHARE, LONG_S, SLOW_MPS, summarise
from isac_track.errors import IsacTrackError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from rich.console import Console
    from rich.table import Table

    from isac_track.datasets import Dataset
    from isac_track.datasets.summary import Summary


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return 0, 2 for wrong usage or data, 130 if interrupted."""
    return exit_code(lambda: _run(_parser().parse_args(argv)))


def _run(arguments: argparse.Namespace) -> int:
    if arguments.command == "show":
        _show(arguments.name, format_name=arguments.format, fps=arguments.fps)
    elif arguments.command == "fetch":
        for name in arguments.name:
            _fetch(name)
    else:
        return _list()
    return DONE


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m isac_track.datasets",
        description="List the known data sets, show one, or fetch one.",
    )
    commands = parser.add_subparsers(dest="command", title="commands")
    commands.add_parser("list", help="what is known and what is here (default)")
    show = commands.add_parser("show", help="statistics and repairs of one data set or file")
    show.add_argument("name", metavar="NAME|PATH", help="a known name, or a file of your own")
    show.add_argument("--format", help="format of a file: see docs/data.md")
    show.add_argument("--fps", type=float, help="frames per second, if the format counts frames")
    fetch = commands.add_parser("fetch", help="download known data sets into the cache")
    fetch.add_argument("name", metavar="NAME", nargs="+", help=f"one of {', '.join(KNOWN)}")
    return parser


def _console() -> Console:
    from rich.console import Console  # noqa: PLC0415 - `--help` stays quick

    # No guessing at numbers and paths: the text is data, not markup.
    return Console(highlight=False, markup=False, emoji=False)


def _table(label: str, *columns: str) -> Table:
    from rich.box import SIMPLE_HEAD  # noqa: PLC0415 - `--help` stays quick
    from rich.table import Table  # noqa: PLC0415 - `--help` stays quick

    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.add_column(label, no_wrap=True)
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _list() -> int:
    table = _table(
        "data set", "tracks", *(f">={s:g} s" for s in LONG_S), "median s", "m/s", "zero", "frozen"
    )
    notes = []
    status = DONE
    for data_set in KNOWN.values():
        found: Dataset | None = None
        where = f"not here; `python -m isac_track.datasets fetch {data_set.name}`"
        try:
            if data_set.simulated or complete(data_set, locate(data_set)):
                found = load(data_set.name, download=False)
                where = found.path
        except IsacTrackError as error:
            where = f"error: {error}"
            status = WRONG
        table.add_row(data_set.name, *(_cells(found) if found else ["-"] * 7))
        notes.append(f"{data_set.name}: {data_set.about}; {where}")
    console = _console()
    console.print(table)
    console.print()
    for note in (*notes, searched()):
        console.print(note, soft_wrap=True)  # whole, to be copied
    console.print(
        f"m/s: median of the tracks' mean speeds. zero: share of steps of exactly no "
        f"length. frozen: tracks with at least {FROZEN_SHARE:.0%} such steps."
    )
    return status


def _cells(found: Dataset) -> list[str]:
    summary = summarise(found.tracks)
    return [
        f"{len(summary)}",
        *(f"{summary.n_lasting(duration_s)}" for duration_s in LONG_S),
        f"{np.median(summary.duration_s):.1f}",
        f"{np.nanmedian(summary.speed_mean_mps):.2f}",
        f"{summary.total_still_share:.1%}",
        f"{summary.frozen.sum()}",
    ]


def _show(name: str, *, format_name: str | None, fps: float | None) -> None:
    found = load(name, format=format_name, fps=fps)
    summary = summarise(found.tracks)
    facts = {
        "name": found.name + (" (simulated)" if found.simulated else ""),
        "path": found.path,
        "format": found.format,
        "sha256": found.sha256,
        "tracks": f"{len(summary)} in {summary.n_groups} groups, {summary.samples.sum()} samples",
        "long tracks": ", ".join(
            f"{summary.n_lasting(duration_s)} of at least {duration_s:g} s" for duration_s in LONG_S
        ),
        "zero steps": f"{summary.total_still_share:.1%} of all steps have exactly no length",
        "frozen": _frozen(found, summary),
        "repairs": f"{len(found.repairs)} kind(s), see below" if found.repairs else "none",
        "credit": found.citation,
        "licence": found.licence,
    }
    table = _table("per track", "min", "5%", "median", "95%", "max")
    for label, values in (
        ("duration, s", summary.duration_s),
        ("mean speed, m/s", summary.speed_mean_mps),
        ("sd of step speed, m/s", summary.speed_sd_mps),
        (f"steps below {SLOW_MPS:g} m/s", summary.slow_share),
        ("steps of no length", summary.still_share),
    ):
        quantiles = np.nanquantile(values, [0.0, 0.05, 0.5, 0.95, 1.0])
        is_share = "steps" in label.split()[0]
        table.add_row(label, *(f"{q:.1%}" if is_share else f"{q:.2f}" for q in quantiles))
    console = _console()
    for label, fact in facts.items():
        if fact:
            console.print(f"{label:<12} {fact}", soft_wrap=True)
    console.print()
    console.print(table)
    if found.repairs:
        console.print()
    for repair in found.repairs:
        console.print(f"{repair.count:>6} {repair.kind:<14} {repair.detail}", soft_wrap=True)


def _frozen(found: Dataset, summary: Summary) -> str:
    names = [found.tracks.source[row] for row in np.flatnonzero(summary.frozen)]
    which = f": {listed(names)}" if names else ""
    return f"{len(names)} tracks with at least {FROZEN_SHARE:.0%} steps of no length{which}"


def _fetch(name: str) -> None:
    from isac_track.datasets.download import fetch  # noqa: PLC0415 - `--help` stays quick

    data_set = known(name)
    console = _console()
    if data_set.simulated:
        console.print(f"{name} is bundled: nothing to fetch", soft_wrap=True)
        return
    files, downloaded = fetch(data_set)
    done = "fetched" if downloaded else "already here"
    for path in files.values():
        console.print(f"{name}: {done}: {shown(path)}", soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
