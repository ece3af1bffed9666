"""Refit the free constants of the sensing model: `python scripts/calibrate.py`."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from functools import partial

from calibration import FITTED, Calibration, calibrate, ridge

from evaluation.estimates.metrics import METRICS
from evaluation.estimates.paper import PUBLISHED
from evaluation.reporting import table as make
from evaluation.reporting import terminal
from isac_track import datasets
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import SettingsError

_ABOUT_CONSTANTS = (
    "rates and PLR in %, lengths in s; fitted: raw PLR, raw MEL and the PLR of"
    " fid:1000; the others (linear adding) were not fitted, but seen"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/calibrate.py",
        description=(
            "Refit the free constants of the sensing model to the paper's numbers."
        ),
    )
    add = command.add_argument
    add(
        "--dataset",
        metavar="NAME|PATH",
        default="students03",
        help="default: that of the paper",
    )
    help_text = "scenes for the missed rates (default: 5000, half a minute)"
    add("--scenes", metavar="N", type=int, default=5000, help=help_text)
    add(
        "--seed",
        metavar="N",
        type=int,
        default=0,
        help="base seed of all draws (default: 0)",
    )
    help_text = "also fit with other caps and beam fluctuations (takes minutes)"
    add("--ridge", action="store_true", help=help_text)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    if options.scenes < 2 or options.seed < 0:  # noqa: PLR2004 - one scene of each label
        raise SettingsError("--scenes must be at least 2 and --seed not negative")
    recorded = datasets.load(options.dataset).tracks
    cases = {"as committed": dict[str, float]()} | (ridge() if options.ridge else {})
    asked = {"n_scenes": options.scenes, "seed": options.seed}
    fits = {
        name: calibrate(recorded, changes=changes, **asked)
        for name, changes in cases.items()
    }
    show_constants(fits)
    return DONE


def show_constants(fits: Mapping[str, Calibration]) -> None:
    """Print constants and their predictions beside the paper's numbers, by case."""
    records = []
    for name in FITTED:
        row = {"constant or number": make.text_cell(name)}
        for case, (settings, _) in fits.items():
            row[case] = make.number_cell(getattr(settings, name), digits=2)
        records.append(row)
    for mechanism, level, metric, published in PUBLISHED:
        spec = mechanism if level is None else f"{mechanism}:{level:g}"
        scale, digits = METRICS[metric].scale, 1 if METRICS[metric].is_share else 2
        number = partial(make.number_cell, scale=scale, digits=digits)
        row = {
            "constant or number": make.text_cell(f"{spec} {metric}"),
            "paper": number(published),
        }
        row |= {case: number(ours[spec, metric]) for case, (_, ours) in fits.items()}
        records.append(row)
    columns = [make.cell_column("constant or number", align="left")]
    columns += [make.cell_column(name) for name in ("paper", *fits)]
    title = "paper, and what each set of constants gives"
    table = make.build_table(
        "calibration", title, records, columns, notes=[_ABOUT_CONSTANTS]
    )
    terminal.show([table])


if __name__ == "__main__":
    sys.exit(main())
