"""How much more does a linker find than the others? ``python -m benchmarks.paired_linkers OUT``.

Of a finished run, task by task and level by level: rank 1 among 100 of
`likelihood_ratio` (or another linker, the second argument) less that of the strongest
other one under the same knowledge, whatever options that has, in points, paired by
person, 95 % intervals; then, as ``python -m benchmarks.paired_linkers OUT LINKER
rank1``, of all candidates.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from evaluation.estimates.keys import Key, level_text
from evaluation.estimates.linkability import cards
from evaluation.estimates.metrics import SUCCESS_OF_100
from evaluation.estimates.summary import linkage_estimates
from evaluation.store.manifest import read_manifest
from isac_track.intervals import Estimate, difference


def paired(out: Path, linker: str, metric: str) -> Iterator[tuple[Key, Key, Estimate]]:
    """Yield where a linker links, the strongest other one there, and the difference."""
    read = cards(out, read_manifest(out), drawn=(metric,))
    found = {
        key: one
        for key, one in linkage_estimates(read).items()
        if key.metric == metric and key.knowledge  # controls know nothing
    }
    for key, mine in found.items():
        task, _, name = key.consumer.partition("/")
        others = [
            one
            for one in found
            if one.where == key.where
            and one.knowledge == key.knowledge
            and one.consumer.startswith(f"{task}/")
            and one.consumer.partition("/")[2].partition(":")[0]
            != linker.partition(":")[0]
        ]
        if name == linker and others:
            best = max(others, key=lambda one: found[one].value)
            yield key, best, difference(mine, found[best])


def main(arguments: Sequence[str]) -> None:
    """Print a line each."""
    out, linker, metric = (
        *arguments,
        *("likelihood_ratio", SUCCESS_OF_100)[len(arguments) - 1 :],
    )
    for key, best, one in paired(Path(out), linker, metric):
        value, low, high = (
            100.0 * each for each in (one.value, one.ci_low, one.ci_high)
        )
        where = (
            f"{key.consumer} {key.knowledge}, {key.mechanism} {level_text(key.level)}"
        )
        print(
            f"{where:66} {value:+6.1f} [{low:+.1f}, {high:+.1f}]  less {best.consumer}"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
