"""Do labels name one person in several runs? `python scripts/labels_over_runs.py NAME`.

A queue keeps its order within a run. If labels were dealt out anew for each run, the
neighbours of a label in one run would say nothing about its neighbours in another.
People who stay with their company share neighbours over runs. Nothing of this reaches
an attack: it is evidence about the labels alone.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.random import Generator

from isac_track.command_line import DONE, Parser, exit_code
from isac_track.datasets import load
from isac_track.datasets.people import is_labelled
from isac_track.errors import DataError
from isac_track.rng import stream
from isac_track.types import Tracks

N_DRAWS = 20_000

Pairs = frozenset[frozenset[str]]


@dataclass(frozen=True, slots=True)
class SharedNeighbours:
    """Pairs of neighbours in both of two runs, and the chance of as many."""

    n_people: int  # People who are in both runs.
    pairs: Pairs
    expected: float  # Mean number of pairs if the labels of a run are permuted.
    p: float  # Share of permutations with as many pairs.


def queue(tracks: Tracks, session: str) -> list[str]:
    """Return the people of a session in the order of their passages."""
    start = tracks.t[tracks.offsets[:-1]]
    assert tracks.session is not None
    assert tracks.person is not None
    return [
        tracks.person[row]
        for row in np.argsort(start, kind="stable").tolist()
        if tracks.session[row] == session
    ]


def successors(people: Sequence[str]) -> dict[str, Counter[str]]:
    """Return how often each person is followed by which other."""
    counts: dict[str, Counter[str]] = {}
    for ahead, behind in pairwise(people):
        counts.setdefault(ahead, Counter())[behind] += 1
    return counts


def neighbours(people: Sequence[str]) -> Pairs:
    """Return the pairs of labelled people who mostly follow each other."""
    pairs = set()
    for ahead, counts in successors(people).items():
        behind = counts.most_common(1)[0][0]
        if is_labelled(ahead) and is_labelled(behind):
            pairs.add(frozenset((ahead, behind)))
    return frozenset(pairs)


def compare(
    first: Pairs, second: Pairs, *, rng: Generator, n_draws: int = N_DRAWS
) -> SharedNeighbours:
    """Return the pairs that two runs share, against permuted labels of the second."""
    labels = sorted(frozenset().union(*second))
    counts = np.empty(n_draws)
    for draw in range(n_draws):
        other = dict(zip(labels, rng.permutation(labels).tolist(), strict=True))
        renamed = {frozenset(other[name] for name in pair) for pair in second}
        counts[draw] = len(renamed & first)
    n_shared = len(first & second)
    return SharedNeighbours(
        n_people=len(frozenset().union(*first) & set(labels)),
        pairs=first & second,
        expected=float(counts.mean()),
        p=float((1 + (counts >= n_shared).sum()) / (1 + n_draws)),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/labels_over_runs.py",
        description="Compare the neighbours of labelled people over runs.",
    )
    command.add_argument("name", metavar="NAME|PATH", help="sessions with labels")
    return exit_code(lambda: _report(command.parse_args(arguments)))


def _report(options: argparse.Namespace) -> int:
    tracks = load(options.name, download=False).tracks
    if tracks.session is None or tracks.person is None:
        raise DataError(f"{options.name}: no sessions with labelled people")
    queues: Mapping[str, list[str]] = {
        session: queue(tracks, session) for session in dict.fromkeys(tracks.session)
    }
    for session, people in queues.items():
        counts = successors(people).values()
        usual = sum(count.most_common(1)[0][1] for count in counts)
        total = sum(count.total() for count in counts)
        print(f"{session}: {usual} of {total} passages lead the usual successor")
    for first, second in combinations(queues, 2):
        shared = compare(
            neighbours(queues[first]),
            neighbours(queues[second]),
            rng=stream(0, "labels-over-runs", f"{first} {second}"),
        )
        names = ", ".join(
            "-".join(sorted(pair)) for pair in sorted(shared.pairs, key=sorted)
        )
        print(
            f"{first}, {second}: {shared.n_people} people in both,"
            f" {len(shared.pairs)} pairs of neighbours in both ({names or 'none'});"
            f" {shared.expected:.2f} expected if labels meant nothing, p ="
            f" {shared.p:.2g}"
        )
    return DONE


if __name__ == "__main__":
    sys.exit(main())
