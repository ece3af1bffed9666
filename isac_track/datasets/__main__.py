"""``python -m isac_track.datasets``: list, show and fetch data sets."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from isac_track import datasets
from isac_track.command_line import DONE, WRONG, Parser, exit_code
from isac_track.config import StageSettings
from isac_track.datasets import people, registry
from isac_track.datasets.recording import listed
from isac_track.datasets.registry import KNOWN, shown
from isac_track.errors import IsacTrackError

if TYPE_CHECKING:
    from argparse import Namespace

    import pandas as pd

_USUAL: Final = StageSettings()
_LONG_S: Final = (_USUAL.linkage.window_s, _USUAL.resample.min_duration_s)
"""Durations of interest: of a linked release, and of the tracks in scenes."""
_FROZEN = f"{datasets.FROZEN_SHARE:.0%}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return 0, 2 for wrong usage or data, 130 if interrupted."""

    def run() -> int:
        arguments = _parser().parse_args(argv)
        command = {"show": _show, "fetch": _fetch}.get(arguments.command, _list)
        return command(arguments)

    return exit_code(run)


def _parser() -> Parser:
    parser = Parser(
        prog="python -m isac_track.datasets",
        description="List the known data sets, show one, or fetch one.",
    )
    commands = parser.add_subparsers(dest="command", title="commands")
    commands.add_parser("list", help="what is known and what is here (default)")
    show = commands.add_parser(
        "show", help="statistics and repairs of one data set or file"
    )
    show.add_argument(
        "name", metavar="NAME|PATH", help="a known name, or a file of your own"
    )
    show.add_argument("--format", help="format of a file: see docs/how-to/data.md")
    show.add_argument(
        "--fps", type=float, help="frames per second, if the format counts frames"
    )
    show.add_argument("--unit", help="of its lengths: m (default), cm or mm")
    show.add_argument(
        "--columns", help="of a table: t=time[ms],id=ped_id,x=pos_x[cm],y=pos_y[cm]"
    )
    show.add_argument(
        "--on-duplicate",
        default="error",
        help="of an id twice at one time: error, first or mean",
    )
    show.add_argument("--crs", help="degrees: x is longitude, y is latitude")
    show.add_argument(
        "--drop-frozen", type=float, metavar="S", help="drop stretches at one place"
    )
    fetch = commands.add_parser("fetch", help="download known data sets into the cache")
    fetch.add_argument(
        "name", metavar="NAME", nargs="+", help=f"one of {', '.join(KNOWN)}"
    )
    return parser


def _aligned(table: Mapping[str, Sequence[str]], title: str, *columns: str) -> str:
    """Return labelled rows under a header: labels to the left, numbers to the right."""
    import pandas as pd  # noqa: PLC0415 - `--help` stays quick

    frame = pd.DataFrame(table.values(), index=list(table), columns=list(columns))
    return frame.rename_axis(columns=title).to_string()


def _attendance(dataset: datasets.Dataset) -> str:
    """Return how many people come back; empty if neither sessions nor labels tell."""
    has_labels = any(note.kind == people.KIND for note in dataset.repairs)
    if dataset.tracks.session is None and not has_labels:
        return ""
    return str(people.count_attendance(dataset.tracks))


def _list(_: Namespace) -> int:
    rows, notes, status = {}, [], DONE
    attendances: list[str] = []
    for name, data_set in KNOWN.items():
        rows[name] = ["-"] * 7
        where = f"not here; `python -m isac_track.datasets fetch {name}`"
        try:
            if not registry.locate(data_set)[1]:
                dataset = datasets.load(name, download=False)
                summary = datasets.summarise(dataset.tracks)
                where = dataset.path
                if attendance := _attendance(dataset):
                    attendances.append(f"{name}: {attendance}")
                n_long = [
                    datasets.n_lasting(summary, duration_s) for duration_s in _LONG_S
                ]
                rows[name] = [
                    f"{len(summary)}",
                    f"{n_long[0]}",
                    f"{n_long[1]}",
                    f"{summary.duration_s.median():.1f}",
                    f"{summary.speed_mean_mps.median():.2f}",
                    f"{datasets.still_share(summary):.1%}",
                    f"{summary.frozen.sum()}",
                ]
        except IsacTrackError as error:
            where, status = f"error: {error}", WRONG
        notes.append(f"{name}: {data_set.about}; {where}")
    long = (f">={duration_s:g} s" for duration_s in _LONG_S)
    columns = ("tracks", *long, "median s", "m/s", "zero", "frozen")
    print(
        _aligned(rows, "data set", *columns),
        "",
        *notes,
        *attendances,
        registry.describe_lookup(),
        sep="\n",
    )
    print(
        "m/s: median of the tracks' mean speeds. zero: share of steps of exactly no\n"
        f"length. frozen: tracks with at least {_FROZEN} such steps."
    )
    return status


def _show(arguments: Namespace) -> int:
    option_names = (
        "format",
        "fps",
        "unit",
        "columns",
        "on_duplicate",
        "crs",
        "drop_frozen",
    )
    options = {name: getattr(arguments, name) for name in option_names}
    dataset = datasets.load(arguments.name, **options)
    tracks, summary = dataset.tracks, datasets.summarise(dataset.tracks)
    frozen = [tracks.source[row] for row in np.flatnonzero(summary.frozen)]
    lasting = (
        f"{datasets.n_lasting(summary, duration_s)} of at least {duration_s:g} s"
        for duration_s in _LONG_S
    )
    facts = {
        "name": dataset.name + (" (simulated)" if dataset.simulated else ""),
        "path": dataset.path,
        "format": dataset.format,
        "sha256": dataset.sha256,
        "tracks": (
            f"{len(tracks)} in {len(set(tracks.group))} groups, {tracks.t.size} samples"
        ),
        "people": _attendance(dataset),
        "long tracks": ", ".join(lasting),
        "zero steps": (
            f"{datasets.still_share(summary):.1%} of all steps have exactly no length"
        ),
        "frozen": (
            f"{len(frozen)} tracks with at least {_FROZEN} steps of no length"
            + (f": {listed(frozen)}" if frozen else "")
        ),
        "repairs": (
            f"{len(dataset.repairs)} kind(s), see below" if dataset.repairs else "none"
        ),
        "credit": dataset.citation,
        "licence": dataset.licence,
    }
    rows = _quantile_rows(summary)
    lines = [f"{label:<12} {fact}" for label, fact in facts.items() if fact]
    lines += ["", _aligned(rows, "per track", "min", "5%", "median", "95%", "max")]
    if dataset.repairs:
        lines.append("")
    lines += [
        f"{repair.count:>6} {repair.kind:<14} {repair.detail}"
        for repair in dataset.repairs
    ]
    print(*lines, sep="\n")
    return DONE


def _quantile_rows(summary: pd.DataFrame) -> dict[str, list[str]]:
    """Return quantiles over the tracks as texts, from the least to the largest."""
    rows = {}
    for label, column, form in (
        ("duration, s", "duration_s", ".2f"),
        ("mean speed, m/s", "speed_mean_mps", ".2f"),
        ("sd of step speed, m/s", "speed_sd_mps", ".2f"),
        (f"steps below {datasets.SLOW_MPS:g} m/s", "slow_share", ".1%"),
        ("steps of no length", "still_share", ".1%"),
    ):
        quantiles = summary[column].quantile([0.0, 0.05, 0.5, 0.95, 1.0])
        rows[label] = [format(quantile, form) for quantile in quantiles]
    return rows


def _fetch(arguments: Namespace) -> int:
    for name in arguments.name:
        data_set = registry.known(name)
        if data_set.session is not None:
            print(f"{name} is bundled: nothing to fetch")
            continue
        files, downloaded = registry.fetch(data_set)
        done = "fetched" if downloaded else "already here"
        for path in files.values():
            print(f"{name}: {done}: {shown(path)}")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
