"""The simulated plaza beside real crowds: ``python -m benchmarks.crowd_table``.

Prints the table of ``docs/plaza.md``. Real recordings take part where they are found in
``ISAC_TRACK_DATA`` or the cache; nothing is downloaded.
"""

from __future__ import annotations

from isac_track.datasets import load, registry
from isac_track.datasets.crowd.stats import statistics

COLUMNS = ("plaza", "plaza-session2", "students03", "zara01")


def main() -> None:
    """Print one row a statistic and one column a crowd that is here."""
    columns = {}
    for name in COLUMNS:
        known = registry.known(name)
        if known.simulated or registry.complete(known, registry.locate(known)):
            columns[name] = statistics(load(name).tracks)
        else:
            print(f"{name}: not found, left out")
    print("| statistic |", " | ".join(columns), "|")
    print("|---|" + "---:|" * len(columns))
    for key in columns["plaza"]:
        values = (cells[key] for cells in columns.values())
        print(f"| {key} |", " | ".join(f"{value:.4g}" for value in values), "|")


if __name__ == "__main__":
    main()
