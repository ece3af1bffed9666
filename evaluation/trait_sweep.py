"""How `new_traversal` depends on the traits that were planted: `python -m evaluation.trait_sweep`.

Nobody recorded the same people on two days: the crowd of that task is simulated, and how well its
people are linked says as much about how different they were made as about the attack. At strength
0 everybody is alike, and a link would be a leak of the simulation; the bundled crowd is at 1.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from evaluation.grid import Settings
from evaluation.store import write_whole
from evaluation.terminal import aligned, say, standard_output
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import SettingsError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

TASK = "new_traversal"
STRENGTHS = (0.0, 0.5, 1.0, 2.0, 3.0)
MECHANISMS = ("raw", "fid:1", "fid:1,adding=independent")
ATTACKS = (
    "shape@radial_rts",
    "profile@radial_rts",
    "dtw",
    "behaviour",
    "behaviour@radial_rts",
    "histogram",
    "histogram@radial_rts",
)
FILE = "trait_sweep.csv"


def sweep(
    out: Path, *, strengths: Sequence[float] = STRENGTHS, settings: Settings | None = None
) -> pd.DataFrame:
    """Run the task at several trait strengths, each in a folder of its own below `out`.

    Parameters
    ----------
    out : Path
    strengths : sequence of float
        Not negative.
    settings : Settings, optional
        Mechanisms, attacks, seed and jobs; the task is always the simulated one.

    Returns
    -------
    DataFrame
        As `trait_sweep.csv`: the rows of `linkability.csv` over the whole cohort, with
        `trait_strength` in front and the AUC with its interval behind.

    Raises
    ------
    IsacTrackError
        For anything that a user can mend.
    """
    from evaluation.runner import run  # noqa: PLC0415 - --help answers at once

    given = settings or Settings(mechanisms=MECHANISMS, attacks=ATTACKS)
    frames = []
    for strength in strengths:
        stages = given.stages.changed({"linkage.trait_strength": strength})
        results = run(
            replace(
                given,
                preset="smoke",
                scenes=2,
                predictors=(),
                tasks=(TASK,),
                stages=stages,
                out=out / f"strength-{strength:g}",
            )
        )
        rows = results.linkability[results.linkability["cohort"] == "all"]
        key = ["mechanism", "level", "consumer", "knowledge"]
        auc = results.summary[results.summary["metric"] == "auc"]
        auc = auc[[*key, "value", "ci_low", "ci_high"]].rename(
            columns={"value": "auc", "ci_low": "auc_low", "ci_high": "auc_high"}
        )
        rows = rows.merge(auc, on=key, how="left", validate="one_to_one")
        frames.append(rows.assign(trait_strength=strength))
    found = pd.concat(frames, ignore_index=True)
    found = found[["trait_strength", *(name for name in found if name != "trait_strength")]]
    write_whole(out / FILE, found.to_csv(index=False).encode())
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = Parser(
        prog="python -m evaluation.trait_sweep",
        description="Link the simulated crowd of new_traversal at several trait strengths.",
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="folder for the runs and the table")
    parser.add_argument(
        "--strength",
        type=float,
        action="append",
        metavar="S",
        help=f"repeatable (default: {', '.join(f'{one:g}' for one in STRENGTHS)})",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--jobs", type=int, metavar="N", help="worker processes")
    return exit_code(
        lambda: _run(parser.parse_args(arguments)),
        interrupted="interrupted; finished cells are kept",
    )


def _run(options: argparse.Namespace) -> int:
    if options.seed < 0:
        raise SettingsError(f"--seed must not be negative, got {options.seed}")
    settings = Settings(
        mechanisms=MECHANISMS, attacks=ATTACKS, seed=options.seed, jobs=options.jobs
    )
    found = sweep(options.out, strengths=options.strength or STRENGTHS, settings=settings)
    _show(found)
    print(f"\nresults in {options.out}: {FILE}")
    return DONE


def _show(found: pd.DataFrame) -> None:
    """Print rank 1 of every attack, a column for each strength, level by level."""
    console = standard_output()
    attacks = found[found["knowledge"].isin(["informed"])]
    strengths = sorted(attacks["trait_strength"].unique())
    chance = attacks["chance"].iloc[0]
    say(
        console,
        f"{TASK}: rank 1 in % (informed) with 95 % interval, by trait strength; "
        f"chance {100 * chance:.2f} %; . no link detected, ! attack too weak",
        "bold",
        wrap=True,
    )
    marks = {"no link detected": ".", "attack too weak": "!"}
    levels = attacks[["mechanism", "level"]].drop_duplicates()
    for mechanism, level in levels.itertuples(index=False, name=None):
        same = attacks["level"].isna() if pd.isna(level) else attacks["level"] == level
        block = attacks[(attacks["mechanism"] == mechanism) & same]
        rows = [["", *(f"{strength:g}" for strength in strengths)]]
        for consumer, of in block.groupby("consumer", sort=False):
            by_strength = of.set_index("trait_strength")
            rows.append(
                [
                    str(consumer).partition("/")[2],
                    *(_cell(by_strength.loc[strength], marks) for strength in strengths),
                ]
            )
        say(console, f"{mechanism} {'' if pd.isna(level) else f'{level:g}'}".rstrip(), "bold cyan")
        for line in aligned(rows, left={0}):
            say(console, line)


def _cell(row: pd.Series, marks: dict[str, str]) -> str:
    interval = f"[{100 * row['ci_low']:.1f}, {100 * row['ci_high']:.1f}]"
    return f"{100 * row['rank1']:.1f}{marks.get(row['outcome'], '')} {interval}"


if __name__ == "__main__":
    sys.exit(main())
