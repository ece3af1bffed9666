"""Does gait link two windows of a single walk? Rank 1 over levels of error.

    python scripts/gait_in_halves.py --dataset hermes-uo-180-180-070 --out rows.csv

Every walk that is long enough gives two windows, a second apart, without frame or clock.
The first is taken for a session, the second for another, and the protocol of people who
come back links them, by `gait` alone. Company and speed are the same in both windows, so
that this is no answer to whether a walk lasts from run to run: it shows which error
hides gait.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from attacks.linkage.gait import Gait
from attacks.tasks.passage_releases import share_passages
from attacks.tasks.passages import find_passages
from attacks.tasks.return_study import study_returns
from isac_track import datasets
from isac_track.rng import stream
from isac_track.types import Tracks

ERRORS = ("0", "0.02", "0.05", "0.1", "0.2", "raw")
_GAP_S = 1.0


def halves(tracks: Tracks, *, window_s: float, most_people: int, seed: int) -> Tracks:
    """Return two windows of each of at most `most_people` walks, as two sessions."""
    start_s, end_s = tracks.t[tracks.offsets[:-1]], tracks.t[tracks.offsets[1:] - 1]
    lasting = np.flatnonzero(end_s - start_s >= 2.0 * window_s + _GAP_S)
    drawn = np.sort(stream(seed, "halves").permutation(lasting)[:most_people])
    parts = []
    for row in drawn.tolist():
        walk = slice(tracks.offsets[row], tracks.offsets[row + 1])
        t, xy = tracks.t[walk], tracks.xy[walk]
        for session, begin_s in enumerate((t[0], t[0] + window_s + _GAP_S)):
            inside = (t >= begin_s) & (t <= begin_s + window_s)
            parts.append((tracks.source[row], session, t[inside], xy[inside]))
    people = tuple(part[0] for part in parts)
    return Tracks(
        t=np.concatenate([part[2] for part in parts]),
        xy=np.concatenate([part[3] for part in parts]),
        offsets=np.append(0, np.cumsum([part[2].size for part in parts])),
        source=tuple(f"{name}:{session}" for name, session, _, _ in parts),
        group=people,
        person=people,
        session=tuple(f"half {session}" for _, session, _, _ in parts),
    )


def link_halves(
    tracks: Tracks, *, errors: Sequence[str], seed: int
) -> list[dict[str, object]]:
    """Return rank 1 of gait at each level of error."""
    walks, rows = find_passages(tracks), []
    for error in errors:
        release = share_passages(walks, error=error, seed=seed)
        study = study_returns(
            walks, release, linkers={"gait": Gait()}, enrolled=(None,), seed=seed
        )
        cell = study.cells["gait", None]
        rows.append(
            {
                "error": error,
                "n": cell.rank1.n,
                "rank1": cell.rank1.value,
                "ci_low": cell.rank1.ci_low,
                "ci_high": cell.rank1.ci_high,
                "chance": cell.chance,
            }
        )
    return rows


def main(argv: Sequence[str] | None = None) -> None:
    """Print the rows, and write them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--dataset", required=True)
    parser.add_argument("--window", type=float, default=10.0, help="s")
    parser.add_argument("--people", type=int, default=60, help="at most")
    parser.add_argument("--error", default=",".join(ERRORS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(argv)
    recorded = datasets.load(options.dataset).tracks
    tracks = halves(
        recorded,
        window_s=options.window,
        most_people=options.people,
        seed=options.seed,
    )
    rows = link_halves(tracks, errors=options.error.split(","), seed=options.seed)
    table = pd.DataFrame(rows)
    table.insert(0, "dataset", options.dataset)
    print(table.round(3).to_string(index=False))
    if options.out:
        table.to_csv(options.out, index=False)


if __name__ == "__main__":
    main()
