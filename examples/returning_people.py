"""Is a walk a fingerprint? Link people who come back, over levels of error.

    python examples/returning_people.py --dataset returners
    python examples/returning_people.py --dataset returners --error 0,0.05,raw
    python examples/returning_people.py --dataset singlefile --out sweep.csv

A recording needs people and sessions (docs/how-to/data.md). The script prints rank 1 of
every linker, of the control, and their difference, the nested permutation test, and the
answer by the rule of docs/explanation/returning-people.md. Only the row without error
decides; the others are exploratory.
"""

# ruff: noqa: T201 - results are printed

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from attacks.tasks.passage_releases import share_passages
from attacks.tasks.passages import Passages, find_passages
from attacks.tasks.return_study import FUSION, ReturnStudy, crossing, study_returns
from isac_track import datasets
from isac_track.errors import IsacTrackError
from isac_track.intervals import Estimate

ERRORS = ("0", "0.01", "0.02", "0.05", "0.1", "0.2", "raw")


def table_rows(
    study: ReturnStudy, *, dataset: str, error: str
) -> list[dict[str, object]]:
    """Return a row for each linker and number of enrolled passages."""
    rows = []
    for (linker, most), cell in study.cells.items():
        row: dict[str, object] = {
            "dataset": dataset,
            "error": error,
            "linker": linker,
            "enrolled": "all" if most is None else most,
            "n": cell.gain.n,
            "chance": cell.chance,
            "auc": cell.auc,
            "eer": cell.eer,
            "controls": "; ".join(f"{name} {k}" for name, k in cell.chosen.items()),
            "nested_p": study.regression.p_value if linker == FUSION else np.nan,
        }
        for name in ("rank1", "control", "gain"):
            estimate: Estimate = getattr(cell, name)
            row |= {
                name: estimate.value,
                f"{name}_low": estimate.ci_low,
                f"{name}_high": estimate.ci_high,
            }
        rows.append(row)
    return rows


def sweep(
    passages: Passages,
    *,
    dataset: str,
    errors: Sequence[str],
    seed: int,
    enrolled: Sequence[int | None],
) -> tuple[pd.DataFrame, dict[str, ReturnStudy]]:
    """Return the rows and the study of every error."""
    rows, studies = [], {}
    for error in errors:
        release = share_passages(passages, error=error, seed=seed)
        studies[error] = study_returns(passages, release, enrolled=enrolled, seed=seed)
        rows += table_rows(studies[error], dataset=dataset, error=error)
    return pd.DataFrame(rows), studies


def percent(estimate: Estimate) -> str:
    """Return an estimate with its interval in percent."""
    ends = (estimate.value, estimate.ci_low, estimate.ci_high)
    value, low, high = (100.0 * end for end in ends)
    return f"{value:5.1f} [{low:.0f}, {high:.0f}]"


def print_study(error: str, study: ReturnStudy) -> None:
    """Print the cells of an error, the test and, without error, the answer."""
    print(f"\nerror {error}{'' if error == 'raw' else ' m per axis'}")
    print(f"{'linker':18} {'enrolled':8} {'rank 1 (%)':>18} {'control':>18} gain")
    for (linker, most), cell in study.cells.items():
        texts = [percent(part) for part in (cell.rank1, cell.control, cell.gain)]
        print(
            f"{linker:18} {most or 'all':<8} {texts[0]:>18} {texts[1]:>18} {texts[2]}"
        )
    primary, test = study.primary, study.regression
    print(
        f"chance {100 * primary.chance:.1f} %, n = {primary.gain.n}, EER of the fusion"
        f" {100 * primary.eer:.0f} %, nested p = {test.p_value:.3f}"
    )
    if (same_session := study.same_session) is not None:
        print(
            f"within a run (a control): fusion {percent(same_session.rank1)}, strongest"
            f" circumstance {percent(same_session.control)}"
        )
    if error == "0":
        answer = study.decision
        print(f"Is the walk a fingerprint? {answer.decision}: {answer.why}.")


def print_crossing(table: pd.DataFrame) -> None:
    """Print at which error each linker's interval first includes chance for good."""
    numbers = table[(table.error != "raw") & (table.enrolled == "all")]
    for linker, part in numbers.groupby("linker", sort=False):
        cells = [
            Estimate(row.rank1, row.rank1_low, row.rank1_high)
            for row in part.itertuples()
        ]
        errors = part.error.astype(float).to_numpy()
        error_m = crossing(errors, cells, part.chance.to_numpy())
        print(f"{linker}: above chance below {error_m:g} m")


def read_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """Return the options."""
    first_line = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(description=first_line)
    parser.add_argument("--dataset", default="returners")
    parser.add_argument(
        "--error", default=",".join(ERRORS), help="m per axis, or raw; with commas"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--all-passages", action="store_true", help="no k of 1 and 3")
    parser.add_argument("--out", type=Path, help="file of all rows, CSV")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the sweep and print it; 2 for wrong data or options."""
    options = read_arguments(argv)
    errors = options.error.split(",")
    try:
        passages = find_passages(datasets.load(options.dataset).tracks)
        table, studies = sweep(
            passages,
            dataset=options.dataset,
            errors=errors,
            seed=options.seed,
            enrolled=(None,) if options.all_passages else (1, 3, None),
        )
    except IsacTrackError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for error_text, study in studies.items():
        print_study(error_text, study)
    print_crossing(table)
    if options.out:
        table.to_csv(options.out, index=False)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
