"""Write the tables of patrols: `python scripts/patrol_tables.py docs/results`.

It reads `need-to-know.csv` and `need-to-know-matched.csv` of a folder, which
`scripts/patrol_estimates.py` wrote, and writes a page of tables for each recording, one
for fleets and one for policies against noise.
"""

import argparse
import csv
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, TypeAlias

from patrol_names import MATCHED, MECHANISMS, NUMBERS, RECORDINGS, ROBOTS

from isac_track.command_line import DONE, Parser, exit_code
from isac_track.policies.compared import COMPARED_POLICIES

Row: TypeAlias = Mapping[str, str]
_SHORT: Final = {"fixed:0.7,adding=independent": "fixed:0.7, independent"}
_MISSES: Final = (
    ("missed future", "missed_future_rate"),
    ("... at equal alarms", "missed_future_at_equal_false_alarms"),
    ("missed encounters", "missed_encounter_rate"),
    ("withheld", "withheld_share"),
    ("false alarms / min", "false_alarms_per_min"),
)
_LOG: Final = (
    ("disclosed", "oracle", "disclosed_share"),
    ("people seen", "oracle", "people_seen"),
    ("known: true identities", "oracle", "known_share"),
    ("... worst tenth", "oracle", "known_worst_tenth"),
    ("known: own chains", "blind", "known_share"),
    ("followed, s", "blind", "followed_s"),
    ("... for 10 s", "blind", "followed_10s"),
    ("... for 30 s", "blind", "followed_30s"),
    ("time to confusion, s", "blind", "time_to_confusion_s"),
)
_KEY: Final = (
    "mechanism",
    "policy",
    "consumer",
    "knowledge",
    "horizon_s",
    "metric",
)
_FLEETS: Final = (1, 3, 10)
_OF_FLEET: Final = (
    ("known", "oracle", "known_share"),
    ("chains", "blind", "known_share"),
    ("followed, s", "blind", "followed_s"),
)
_NO_SHARES: Final = ("false_alarms_per_min", "followed_s", "time_to_confusion_s")
_CRITERIA: Final = {
    "missed_future_rate": "0.9 m",
    "missed_future_at_equal_false_alarms": "equal alarms",
}
_MATCHED_HEADS: Final = (
    "robot",
    "warns at",
    "known by",
    "may miss",
    "choice",
    "against",
    "misses",
    "... more",
    "known",
    "... less",
)
_TEXTS: Final = frozenset(
    {"mechanism", "policy", *_MATCHED_HEADS[:3], "choice", "against"}
)
"""Columns of words, on the left; the others hold numbers."""


class Numbers:
    """Rows of the table of numbers, by recording, robots of a fleet and more."""

    def __init__(self, rows: Iterable[Row]) -> None:
        """Index the rows."""
        self._rows = {
            (row["dataset"], int(row["robots"]), *(row[name] for name in _KEY)): row
            for row in rows
        }
        self._places = {key[:5] for key in self._rows}
        self.horizons_s = sorted({key[6] for key in self._rows} - {""}, reverse=True)

    def metrics(self, horizon_s: str) -> set[str]:
        """Return the metrics of robots at a horizon."""
        return {key[7] for key in self._rows if key[6] == horizon_s}

    def cells(
        self, name: str, robots: Sequence[int], consumers: Sequence[str]
    ) -> Iterator[tuple[str, str]]:
        """Yield the mechanisms and policies of a recording, in the tables' order."""
        for mechanism in MECHANISMS:
            for policy in COMPARED_POLICIES:
                places = {
                    (name, count, mechanism, policy, consumer)
                    for count in robots
                    for consumer in consumers
                }
                if places & self._places:
                    yield mechanism, policy

    def row(self, *key: str | int) -> Row | None:
        """Return the row of a key, if it was computed."""
        return self._rows.get(key)

    def text(self, *key: str | int) -> str:
        """Return a number with its interval; empty if it was not computed."""
        row = self.row(*key)
        if row is None or not row["value"]:
            return ""
        is_share = row["metric"] not in _NO_SHARES
        text = _interval(row, "value", "ci_low", "ci_high", is_share=is_share)
        return "0 (c)" if row["note"] == "by construction" else text


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/patrol_tables.py",
        description="Write the tables of patrols from their numbers.",
    )
    command.add_argument("folder", metavar="DIR", type=Path)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    for name, lines in pages(options.folder).items():
        (options.folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return DONE


def pages(folder: Path) -> dict[str, list[str]]:
    """Return the lines of each page, by the name of its file."""
    numbers = Numbers(_read(folder / NUMBERS))
    by_recording = {
        f"need-to-know-{name}.md": list(_recording_page(numbers, name))
        for name in RECORDINGS
        if any(numbers.cells(name, [1], ["log"]))
    }
    made = by_recording | {
        "need-to-know-noise.md": list(_noise_page(_read(folder / MATCHED)))
    }
    if any(any(numbers.cells(name, _FLEETS[1:], ["log"])) for name in RECORDINGS):
        made["need-to-know-fleets.md"] = list(_fleet_page(numbers))
    return made


def _read(path: Path) -> list[Row]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _recording_page(numbers: Numbers, name: str) -> Iterator[str]:
    place = (name, 1, "raw", "everything", "log", "oracle", "")
    known = numbers.row(*place, "known_share")
    n = known["n"] if known else "?"
    yield f"# Tables of: need to know, {RECORDINGS[name]}"
    yield ""
    yield "They belong to [Need to know](../explanation/need-to-know.md), which explains"
    yield "the columns. [Need to know: the tables](../explanation/need-to-know-tables.md)"
    yield "says how they were made. Shares are in %, intervals 95 % over people and"
    yield f"routes: {n} clusters of people, 20 routes."
    yield ""
    yield "## What the log of one robot tells"
    yield ""
    by_map = numbers.text(*place, "known_by_map")
    yield f"Shares of person-time. Without a log the map knows {by_map} %."
    yield "*Own chains*: no identities, fresh pseudonyms; empty where not computed."
    yield ""
    yield from _table(
        ["mechanism", "policy", *(head for head, *_ in _LOG)],
        (
            [
                *_names(cell),
                *(
                    numbers.text(name, 1, *cell, "log", knowledge, "", metric)
                    for _, knowledge, metric in _LOG
                ),
            ]
            for cell in numbers.cells(name, [1], ["log"])
        ),
    )
    for horizon_s in numbers.horizons_s:
        yield ""
        yield f"## What robots miss within {float(horizon_s):.2g} s"
        yield ""
        yield "(c): by construction."
        yield ""
        yield from _robot_table(numbers, name, horizon_s)


def _robot_table(numbers: Numbers, name: str, horizon_s: str) -> Iterator[str]:
    columns = [
        (robot, head, metric)
        for robot in ROBOTS
        for head, metric in _MISSES
        if metric in numbers.metrics(horizon_s)
    ]
    heads = [f"{ROBOTS[robot]}: {head}" for robot, head, _ in columns]
    rows = (
        [
            *_names(cell),
            *(
                numbers.text(name, 1, *cell, robot, "", horizon_s, metric)
                for robot, _, metric in columns
            ),
        ]
        for cell in numbers.cells(name, [1], list(ROBOTS))
    )
    yield from _table(["mechanism", "policy", *heads], rows)


def _fleet_page(numbers: Numbers) -> Iterator[str]:
    yield "# Tables of: need to know, fleets"
    yield ""
    yield "They belong to [Need to know](../explanation/need-to-know.md). 20 fleets of 1,"
    yield "3 or 10 robots that pool their answers. In % of person-time, with 95 %"
    yield "intervals. *Known*: with true identities. *Chains*: without identities; empty"
    yield "where not computed."
    for name, title in RECORDINGS.items():
        cells = list(numbers.cells(name, _FLEETS[1:], ["log"]))
        if not cells:
            continue
        yield ""
        yield f"## {title}"
        yield ""
        yield from _table(
            [
                "mechanism",
                "policy",
                *(f"{robots}: {head}" for robots in _FLEETS for head, *_ in _OF_FLEET),
            ],
            (
                [
                    *_names(cell),
                    *(
                        numbers.text(name, robots, *cell, "log", knowledge, "", metric)
                        for robots in _FLEETS
                        for _, knowledge, metric in _OF_FLEET
                    ),
                ]
                for cell in cells
            ),
        )


def _noise_page(matched: Sequence[Row]) -> Iterator[str]:
    yield "# Tables of: need to know, policies against noise"
    yield ""
    yield "They belong to [Need to know](../explanation/need-to-know.md#policies-against-noise)."
    yield "One robot, conflicts within 3 s, in % and points. *Warns at*: 0.9 m, or the"
    yield "distance at which the robot has as many false alarms as with everything raw."
    yield "*Against* raw: at no level of noise does the robot miss as few."
    for name, title in RECORDINGS.items():
        mine = [row for row in matched if row["dataset"] == name]
        for question in dict.fromkeys(row["question"] for row in mine):
            yield ""
            yield f"## {title}: {question}"
            yield ""
            rows = (_matched_row(row) for row in mine if row["question"] == question)
            yield from _table(_MATCHED_HEADS, rows)


def _matched_row(row: Row) -> list[str]:
    slack = f"+{100 * float(row['slack']):.0f}" if row["slack"] else ""
    return [
        ROBOTS[row["robot"]].removesuffix(" robot"),
        _CRITERIA[row["criterion"]],
        row["known_by"],
        slack,
        f"`{row['choice']}`",
        f"`{row['against']}`",
        *(
            _interval(row, name, f"{name}_low", f"{name}_high")
            for name in ("missed", "missed_more", "known", "known_less")
        ),
    ]


def _names(cell: tuple[str, str]) -> list[str]:
    mechanism, policy = cell
    return [_SHORT.get(mechanism, mechanism), f"`{policy}`"]


def _interval(
    row: Row, value: str, low: str, high: str, *, is_share: bool = True
) -> str:
    """Return a number and its ends, shares in %."""
    scale, digits = (100.0, 1) if is_share else (1.0, 2)
    number, *ends = (
        f"{scale * float(row[name]):.{digits}f}" if row[name] else ""
        for name in (value, low, high)
    )
    return f"{number} [{', '.join(ends)}]" if all(ends) else number


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(heads)} |"
    yield f"|{''.join(':--|' if head in _TEXTS else '--:|' for head in heads)}"
    for row in rows:
        yield f"| {' | '.join(row)} |"


if __name__ == "__main__":
    sys.exit(main())
