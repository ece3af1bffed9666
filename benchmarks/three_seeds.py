"""Results over several seeds: `python -m benchmarks.three_seeds OUT OUT OUT`.

Of finished runs that differ in their seed alone: each number of the README's table as
its mean over the seeds with a 95 % interval (people clustered, the variance between
seeds included), and the runs behind it, with levels of both adding rules; and each item
of the verdict with its mean effect, its error of prediction, its contrasts, and what
the runs decide.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from evaluation.estimates.families import CLEAN, PAPER_FAMILIES
from evaluation.estimates.keys import row_worlds
from evaluation.estimates.metrics import METRICS, PLR, RANK1
from evaluation.estimates.seeds import by_intervals, over_seeds, read_sums, stacked_sums
from evaluation.estimates.strongest import by_task, strongest_by_mechanism
from evaluation.plan.world import OWN_WORLD
from evaluation.reporting.headline import (
    Headline,
    HeadlineColumn,
    choose_levels,
    headline,
)
from evaluation.reporting.lookups import estimates
from evaluation.store.manifest import read_manifest
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import DataError
from isac_track.intervals import Estimate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from evaluation.plan.address import Address, MechanismLevel
    from evaluation.store.entries import Entry


@dataclass(frozen=True, eq=False, slots=True)
class Run:
    """A finished run: its first table, and the strongest attack on each mechanism."""

    out: Path
    table: Headline
    entries: Mapping[Address, Entry]  # Of the cells.
    # By task, "" for reconstruction, and mechanism.
    strongest: Mapping[tuple[str, str], Address]

    @property
    def columns(self) -> list[HeadlineColumn]:
        """The columns of the first table, and that of the worst-off tenth."""
        return [*self.table.columns, *filter(None, [self.table.worst])]

    def entry(self, where: MechanismLevel, column: HeadlineColumn) -> Entry | None:
        """Return the manifest's cell behind a number of the first table."""
        reader = column.measure.reader
        is_attack = bool(reader.adversary)
        if is_attack and self.table.families[where.mechanism].family not in (
            *PAPER_FAMILIES,
            CLEAN,
        ):
            reader = self.strongest.get((reader.task, where.mechanism), reader)
        return self.entries.get(reader.at(*where))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables; return the exit code."""
    command = Parser(prog="python -m benchmarks.three_seeds", description=__doc__)
    command.add_argument(
        "out", nargs="+", type=Path, metavar="OUT", help="folder of a run"
    )
    return exit_code(lambda: _show(command.parse_args(arguments).out))


def read(out: Path) -> Run:
    """Return a finished run; DataError if its manifest or its tables cannot be read."""
    manifest, summary = read_manifest(out), pd.read_csv(out / "summary.csv")
    results = estimates(summary[row_worlds(summary) == OWN_WORLD])
    strongest = {
        (task, mechanism): reader
        for metric in (PLR, RANK1)
        for task, levels in by_task(results, metric=metric).items()
        for mechanism, reader in strongest_by_mechanism(levels).items()
    }
    epsilon_m = float(manifest["settings"]["stages"]["privacy.epsilon_m"])
    entries = {
        cell.address: cell for cell in manifest["cells"] if not cell.address.world
    }
    return Run(out, headline(summary, epsilon_m=epsilon_m), entries, strongest)


def check_seed_alone(outs: Sequence[Path]) -> None:
    """Raise DataError if runs differ in more than their seeds."""
    identities = [
        {
            name: value
            for name, value in read_manifest(out)["identity"].items()
            if name != "seed"
        }
        for out in outs
    ]
    for out, other in zip(outs[1:], identities[1:], strict=True):
        if other != identities[0]:
            keys = sorted(
                key
                for key in other.keys() | identities[0]
                if other.get(key) != identities[0].get(key)
            )
            raise DataError(
                f"{out} and {outs[0]} differ in {', '.join(keys)}, not in the seed"
                " alone"
            )


def pooled(
    runs: Sequence[Run], where: MechanismLevel, number: int
) -> tuple[Estimate, list[float]] | None:
    """Return the mean of a column at a level over all runs, and each run's value."""
    columns = [run.columns[number] for run in runs]
    known = [
        run.table.at(where, column) for run, column in zip(runs, columns, strict=True)
    ]
    own = [estimate for estimate in known if estimate is not None]
    if len(own) < len(runs):
        return None
    sums = []
    for run, column in zip(runs, columns, strict=True):
        # A matching names mates for all probes at once: use the runs' own intervals.
        entry = None if column.is_joint else run.entry(where, column)
        sums.append(read_sums(run.out, entry, column.measure.metric) if entry else None)
    counted = [run_sums for run_sums in sums if run_sums is not None]
    is_share = METRICS[columns[0].measure.metric].is_share
    if len(counted) == len(runs):
        mean = over_seeds(stacked_sums(counted), is_share=is_share)
    else:
        mean = by_intervals(own)
    return mean, [estimate.value for estimate in own]


def _show(outs: Sequence[Path]) -> int:
    check_seed_alone(outs)
    runs = [read(out) for out in outs]
    first = runs[0].table
    # The levels of the first table, under both adding rules.
    tabled = {
        (first.families[name].name, level) for name, level in choose_levels(first)
    }
    for where in first.levels:
        if (first.families[where.mechanism].name, where.level) not in tabled:
            continue
        for number, column in enumerate(runs[0].columns):
            if results := pooled(runs, where, number):
                name = f"{column.above}, {column.name}"
                print(f"{first.name(where):24} {name:34} {_text(*results)}")
    for name, numbers in _items(outs).items():
        decided = ", ".join(sorted({number.decision for number in numbers}))
        effects = [number.effect for number in numbers]
        shown = _text(by_intervals(effects), [effect.value for effect in effects])
        print(f"{name:76} {shown} {decided}")
    return DONE


@dataclass(frozen=True, slots=True)
class Decided:
    """A number of a run's verdict, and the decision by it."""

    name: str
    effect: Estimate
    decision: str = ""


def _items(outs: Sequence[Path]) -> dict[str, list[Decided]]:
    """Return the numbers of the verdicts by name: of items and of their contrasts."""
    results: dict[str, list[Decided]] = {}
    for out in outs:
        for item in json.loads((out / "verdict.json").read_text())["items"]:
            if item["section"] != "inflation":  # its unit is another
                for number in _decided(item):
                    if math.isfinite(number.effect.value):
                        results.setdefault(number.name, []).append(number)
    return results


def _decided(item: Mapping[str, Any]) -> Iterator[Decided]:
    """Yield the effect or spread of an item, its prediction error and contrasts."""
    name, n = str(item["id"]), int(item["n"] or 0)
    has_spread = item.get("spread") is not None
    effect = _number(item, "spread" if has_spread else "effect", n=n)
    yield Decided(name, effect, str(item["decision"]))
    if item.get("prediction_error") is not None:
        yield Decided(
            f"{name}, prediction error", _number(item, "prediction_error", n=n)
        )
    for contrast in item.get("contrasts", ()):
        levels = (contrast.get("level"), contrast.get("quartile"))
        place = " ".join(f"{level:g}" for level in levels if level is not None)
        label = f"{name}, {contrast['mechanism']} {place}"
        yield Decided(label, _number(contrast, "effect", n=int(contrast["n"])))


def _number(record: Mapping[str, Any], name: str, *, n: int) -> Estimate:
    """Return a number of the verdict with its interval; NaN where there is none."""
    prefix = "ci" if name == "effect" else name
    names = (name, f"{prefix}_low", f"{prefix}_high")
    value, low, high = (
        math.nan if record.get(key) is None else float(record[key]) for key in names
    )
    return Estimate(value, low, high, n)


def _text(mean: Estimate, values: Sequence[float]) -> str:
    """Return a share in %, its interval, and the runs' own values."""
    value, low, high = (
        100.0 * number for number in (mean.value, mean.ci_low, mean.ci_high)
    )
    ends = f"[{low:.1f}, {high:.1f}]" if math.isfinite(low) else "(no interval)"
    own = ", ".join(f"{100.0 * other:.1f}" for other in values)
    return f"{value:6.1f} {ends:14} of {own}"


if __name__ == "__main__":
    sys.exit(main())
