"""Print the tables of tracks: `python scripts/tracking_tables.py TITLE=DIR ...`.

Each folder is that of a run with `--set tracking.method=...`. Its table has a row for
each tracker, mechanism, and order of noise and tracking. Robots look 3 s ahead. Policies
that answer from tracks, and linkers of tracks, have tables of their own.
"""

import argparse
import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from evaluation.plan.address import parse_policy
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
_POLICY_COLUMNS: Final = (
    ("disclosed, %", "shared", "disclosed_share"),
    ("known, %", "log", "known_share"),
    ("robot misses, %", _ROBOT, "missed_future_rate"),
    ("... at equal false alarms", _ROBOT, "missed_future_at_equal_false_alarms"),
    ("false alarms a min", _ROBOT, "false_alarms_per_min"),
)
_CONTROL: Final = "control-random"
_LINK_COLUMNS: Final = (
    ("linkable, %", _CONTROL, "linkable_share"),
    ("`kinematic`, %", "kinematic informed", "rank1"),
    ("`kinematic@radial_rts`, %", "kinematic@radial_rts informed", "rank1"),
    ("random scores, %", _CONTROL, "rank1"),
    ("shuffled mates, %", "control-shuffled", "rank1"),
    ("chance, %", _CONTROL, "chance"),
)
_RELEASES: Final = ("tracks", "detections")
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
    policy: str = ""  # That answers from the tracks; empty: all are shared.

    @property
    def mechanism(self) -> str:
        """SPEC of the mechanism."""
        return f"{self.family}:{self.level}" if self.level else self.family


class Numbers:
    """Numbers of a run's tracks, by place, consumer and metric."""

    def __init__(self, rows: Sequence[Row]) -> None:
        """Index the rows of `summary.csv`."""
        self._rows: dict[tuple[Place, str, str], Row] = {}
        for row in rows:
            release, policy = parse_policy(row["policy"])
            kind, _, release = release.partition(":")
            is_ahead = row["dataset"].endswith(_HORIZON)
            if kind in _RELEASES and (row["consumer"] == _ROBOT) == is_ahead:
                tracker, _, noise = release.partition(",noise=")
                order = "" if row["family"] == "raw" else noise or "after"
                if kind == "detections":
                    order = kind
                place = Place(tracker, row["family"], _level(row), order, policy)
                consumer = row["consumer"]
                if "/" in consumer and row["knowledge"]:
                    consumer = f"{consumer} {row['knowledge']}"
                self._rows[place, consumer, row["metric"]] = row

    def places(self) -> list[Place]:
        """Return trackers, mechanisms and orders, in the order of the table."""
        return sorted({place for place, *_ in self._rows}, key=_rank)

    def tasks(self) -> list[str]:
        """Return the tasks in which tracks are linked."""
        consumers = {consumer for _, consumer, _ in self._rows if "/" in consumer}
        return sorted({consumer.partition("/")[0] for consumer in consumers})

    def text(self, place: Place, consumer: str, metric: str) -> str:
        """Return a number with its interval; empty if it was not computed."""
        row = self._rows.get((place, consumer, metric))
        return "" if row is None or not row["value"] else _interval(row)


def _level(row: Row) -> str:
    return f"{float(row['level']):g}" if row["level"] else ""


def _rank(place: Place) -> tuple[int, str, int, str, str]:
    return (
        _index(_TRACKERS, place.tracker),
        place.policy,
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
    """Yield the lines of a table of tracks, from the rows of `summary.csv`."""
    numbers = Numbers(rows)
    places = [place for place in numbers.places() if not place.policy]
    keys = ("tracker", "noise", "added")
    lines = [
        (f"`{place.tracker}`", place.mechanism, place.order, *_texts(numbers, place))
        for place in places
    ]
    yield from _table(keys, [head for head, *_ in _COLUMNS], lines)


def policy_table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of a table of policies that answer from tracks."""
    numbers = Numbers(rows)
    places = [place for place in numbers.places() if place.policy]
    lines = [
        (
            f"`{place.tracker}`",
            f"`{place.policy}`",
            place.mechanism,
            place.order,
            *_texts(numbers, place, _POLICY_COLUMNS),
        )
        for place in places
    ]
    keys = ("tracker", "policy", "noise", "added")
    yield from _table(keys, [head for head, *_ in _POLICY_COLUMNS], lines)


def link_table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of a table of linkers of tracks."""
    numbers = Numbers(rows)
    lines = [
        (
            f"`{place.tracker}`",
            place.mechanism,
            place.order,
            task,
            *(
                numbers.text(place, f"{task}/{consumer}", metric)
                for _, consumer, metric in _LINK_COLUMNS
            ),
        )
        for place in numbers.places()
        for task in numbers.tasks()
        if numbers.text(place, f"{task}/{_CONTROL}", "rank1")
    ]
    keys = ("tracker", "noise", "added", "task")
    yield from _table(keys, [head for head, *_ in _LINK_COLUMNS], lines)


def _texts(
    numbers: Numbers,
    place: Place,
    columns: Sequence[tuple[str, str, str]] = _COLUMNS,
) -> list[str]:
    return [numbers.text(place, consumer, metric) for _, consumer, metric in columns]


def _table(
    keys: Sequence[str], heads: Sequence[str], lines: Sequence[Sequence[str]]
) -> Iterator[str]:
    """Yield the lines of a table; none without rows."""
    if lines:
        yield f"| {' | '.join([*keys, *heads])} |"
        yield f"|{':--|' * len(keys)}{'--:|' * len(heads)}"
    for cells in lines:
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
        sys.stdout.write(f"## {title}\n\n")
        for lines in (table(rows), policy_table(rows), link_table(rows)):
            if texts := list(lines):
                sys.stdout.write("\n".join([*texts, "", ""]))
    return DONE


if __name__ == "__main__":
    sys.exit(main())
