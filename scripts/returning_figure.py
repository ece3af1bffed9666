"""Draw rank 1 over error from tables of examples/returning_people.py.

python scripts/returning_figure.py TABLE.csv [TABLE.csv ...] --out FIGURE.svg
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's colours, with a marker each.
STYLES = {
    "gait": ("#0072B2", "o"),
    "behaviour": ("#E69F00", "s"),
    "likelihood_ratio": ("#009E73", "^"),
    "fusion": ("#000000", "D"),
}


def draw_recording(axes: Axes, table: pd.DataFrame, *, title: str) -> None:
    """Draw the linkers of a recording, the control and chance over its errors."""
    errors = list(dict.fromkeys(table.error))
    place = np.arange(len(errors))
    for step, (linker, (colour, marker)) in enumerate(STYLES.items()):
        part = table[table.linker == linker].set_index("error").loc[errors]
        value = 100 * part.rank1.to_numpy()
        low, high = 100 * part.rank1_low.to_numpy(), 100 * part.rank1_high.to_numpy()
        axes.errorbar(
            place + 0.12 * (step - 1.5),
            value,
            yerr=[value - low, high - value],
            color=colour,
            marker=marker,
            markersize=4,
            linewidth=1,
            elinewidth=0.8,
            label=linker,
        )
    fusion = table[table.linker == "fusion"]
    axes.plot(
        place, 100 * fusion.control, color="#CC79A7", linestyle="--", label="control"
    )
    axes.plot(
        place, 100 * fusion.chance, color="#666666", linestyle=":", label="chance"
    )
    axes.set_xticks(place, [str(error) for error in errors])
    axes.set_xlabel("error per axis (m), and raw sensing")
    axes.set_title(f"{title}, n = {int(fusion.n.iloc[0])}", fontsize=10)
    axes.set_ylim(0, 100)


def main() -> None:
    """Draw all tables side by side."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tables", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    tables = [pd.read_csv(path, dtype={"error": str}) for path in options.tables]
    parts = [
        (str(name), part[part.enrolled == "all"])
        for table in tables
        for name, part in table.groupby("dataset", sort=False)
    ]
    mpl.rcParams["svg.hashsalt"] = "isac-track"
    figure = Figure(figsize=(4.2 * len(parts), 3.4), layout="constrained")
    every = figure.subplots(1, len(parts), sharey=True, squeeze=False)[0]
    for axes, (name, part) in zip(every, parts, strict=True):
        draw_recording(axes, part, title=name)
    every[0].set_ylabel("rank 1 (%)")
    figure.legend(
        *every[0].get_legend_handles_labels(), loc="outside lower center", ncols=6
    )
    figure.savefig(
        options.out, metadata={"Date": None} if options.out.suffix == ".svg" else None
    )


if __name__ == "__main__":
    main()
