"""Print the tables of tracks: `python scripts/tracking_tables.py TITLE=DIR ...`.

Each folder is that of a run with `--set tracking.method=...`. Its table has a row for
each tracker, mechanism, and order of noise and tracking. Robots look 3 s ahead.
"""

import argparse
import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import SettingsError

Row: TypeAlias = Mapping[str, str]
_HORIZON: Final = ":horizon=3s"
_ROBOT: Final = "kalman_cv"
_COLUMNS: Final = (
    ("purity, %", "tracker", "purity"),
    ("switches a min", "tracker", "id_switches"),
    ("GOSPA, m", "tracker", "gospa"),
    ("OSPA, m", "tracker", "ospa"),
    ("known, %", "log", "known_share"),
    ("followed, s", "log", "followed_s"),
    ("followed 10 s, %", "log", "followed_10s"),
    ("rejoined, %", "log", "rejoined_share"),
    ("confused after, s", "log", "time_to_confusion_s"),
    ("robot misses, %", _ROBOT, "missed_future_rate"),
    ("... at equal false alarms", _ROBOT, "missed_future_at_equal_false_alarms"),
    ("false alarms a min", _ROBOT, "false_alarms_per_min"),
)
_DIGITS: Final = {"id_switches": 0, "followed_s": 1, "time_to_confusion_s": 1}
"""Decimals of numbers that are no share; 2 for others."""
_TRACKERS: Final = ("oracle", "genie", "gnn", "jpda")
_MECHANISMS: Final = ("raw", "fid", "fixed", "ou")


@dataclass(frozen=True, slots=True)
class Place:
    """A row of a table: a tracker, a mechanism, and the order of noise and tracking."""

    tracker: str
    family: str
    level: str
    order: str


class Numbers:
    """Numbers of a run's tracks, by tracker, mechanism, order, consumer and metric."""

    def __init__(self, rows: Sequence[Row]) -> None:
        """Index the rows of `summary.csv`."""
        self._rows: dict[tuple[Place, str, str], Row] = {}
        for row in rows:
            kind, _, release = row["policy"].partition(":")
            is_ahead = row["dataset"].endswith(_HORIZON)
            if kind == "tracks" and (row["consumer"] == _ROBOT) == is_ahead:
                tracker, _, noise = release.partition(",noise=")
                order = "" if row["family"] == "raw" else noise or "after"
                place = Place(tracker, row["family"], _level(row), order)
                self._rows[place, row["consumer"], row["metric"]] = row

    def places(self) -> list[Place]:
        """Return trackers, mechanisms and orders, in the order of the table."""
        return sorted({place for place, *_ in self._rows}, key=_rank)

    def text(self, place: Place, consumer: str, metric: str) -> str:
        """Return a number with its interval; empty if it was not computed."""
        row = self._rows.get((place, consumer, metric))
        return "" if row is None or not row["value"] else _interval(row)


def _level(row: Row) -> str:
    return f"{float(row['level']):g}" if row["level"] else ""


def _rank(place: Place) -> tuple[int, int, str, str]:
    return (
        _index(_TRACKERS, place.tracker),
        _index(_MECHANISMS, place.family),
        place.level,
        place.order,
    )


def _index(names: Sequence[str], name: str) -> int:
    return names.index(name) if name in names else len(names)


def _interval(row: Row) -> str:
    """Return a number and its ends, shares in %."""
    is_share = row["unit"] == "fraction"
    scale = 100.0 if is_share else 1.0
    digits = 0 if is_share else _DIGITS.get(row["metric"], 2)
    value, *ends = (
        f"{scale * float(row[name]):.{digits}f}" if row[name] else ""
        for name in ("value", "ci_low", "ci_high")
    )
    # By construction, as a switch of the oracle: no interval.
    varies = all(ends) and float(row["ci_low"]) < float(row["ci_high"])
    return f"{value} [{', '.join(ends)}]" if varies else value


def table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of a table, from the rows of `summary.csv`."""
    numbers = Numbers(rows)
    heads = ["tracker", "noise", "added", *(head for head, *_ in _COLUMNS)]
    yield f"| {' | '.join(heads)} |"
    yield f"|{':--|' * 3}{'--:|' * len(_COLUMNS)}"
    for place in numbers.places():
        mechanism = f"{place.family}:{place.level}" if place.level else place.family
        texts = [
            numbers.text(place, consumer, metric) for _, consumer, metric in _COLUMNS
        ]
        cells = [f"`{place.tracker}`", mechanism, place.order, *texts]
        yield f"| {' | '.join(cells)} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/tracking_tables.py",
        description="Print the tables of tracks of runs.",
    )
    command.add_argument("runs", metavar="TITLE=DIR", nargs="+")
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    for run in options.runs:
        title, separator, folder = run.partition("=")
        path = Path(folder) / "summary.csv"
        if not separator or not path.is_file():
            raise SettingsError(f"{run!r} is no TITLE=DIR of a run with summary.csv")
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        sys.stdout.write("\n".join([f"## {title}", "", *table(rows), "", ""]))
    return DONE


if __name__ == "__main__":
    sys.exit(main())
