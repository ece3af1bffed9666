"""A linker beside the strongest other: ``python -m benchmarks.paired_linkers OUT``.

For each task and level of a finished run: rank 1 among 100 of `likelihood_ratio` (or
another linker, the second argument) less that of the strongest other linker with the
same knowledge, whatever its options. Differences are in points, paired by person, with
95 % intervals. ``python -m benchmarks.paired_linkers OUT LINKER rank1`` compares among
all candidates.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from evaluation.estimates.keys import level_text
from evaluation.estimates.linkability import linkage_outcomes
from evaluation.estimates.metrics import RANK1_AMONG_100
from evaluation.estimates.summary import linkage_estimates
from evaluation.plan.address import Address, plugin_name
from evaluation.store.manifest import read_manifest
from isac_track.intervals import Estimate, difference


def paired(
    out: Path, linker: str, metric: str
) -> Iterator[tuple[Address, Address, Estimate]]:
    """Yield keys of a linker and of the strongest other, and their difference."""
    read = linkage_outcomes(out, read_manifest(out), drawn=(metric,))
    by_key = {
        key: estimate
        for key, estimate in linkage_estimates(read).items()
        if key.metric == metric and key.adversary  # controls know nothing
    }
    for key, estimate in by_key.items():
        others = [
            other
            for other in by_key
            if other.mechanism_level == key.mechanism_level
            and other.adversary == key.adversary
            and other.task == key.task
            and plugin_name(other.plugin) != plugin_name(linker)
        ]
        if key.attack_spec == linker and others:
            best = max(others, key=lambda other: by_key[other].value)
            yield key, best, difference(estimate, by_key[best])


def main(arguments: Sequence[str]) -> None:
    """Print a line for each task and level."""
    defaults = ("likelihood_ratio", RANK1_AMONG_100)
    out, linker, metric = (*arguments, *defaults[len(arguments) - 1 :])
    for key, best, gain in paired(Path(out), linker, metric):
        value, low, high = (
            100.0 * end for end in (gain.value, gain.ci_low, gain.ci_high)
        )
        level = f"{key.mechanism} {level_text(key.level)}"
        place = f"{key.consumer} {key.adversary}, {level}"
        print(
            f"{place:66} {value:+6.1f} [{low:+.1f}, {high:+.1f}]  less {best.consumer}"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
