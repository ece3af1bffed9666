"""Planted crowds of people who come back: sway and steps that we know.

People walk in single file through a corridor, several times in each session. A person
has habits of gait, and so has a place in the queue: whoever walks there is disturbed in
its way. Both have the same form, so that no feature tells them apart.

    python scripts/returning_crowds.py --worlds 0:20 --out worlds.jsonl
    python scripts/returning_crowds.py --summary worlds.jsonl

counts what the rule for people who come back answers in such crowds. Three runs are
judged; a fourth confirms.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from attacks.tasks.passage_releases import share_passages
from attacks.tasks.passages import find_passages
from attacks.tasks.return_study import study_returns
from isac_track.intervals import exact_binomial
from isac_track.rng import stream
from isac_track.types import Floats, Tracks

STRENGTHS = {"none": 0.0, "weak": 1.0, "strong": 3.0}
"""Spread of habits; 1 is about that of people: 8 % of cadence, 25 % of amplitudes."""
SESSIONS = ((14, 5, 3.6), (21, 5, 5.8), (30, 3, 12.0))
"""People, passages of each, and median length of a passage in s, as in `returners`."""
_RATE_HZ = 25.0
_WAY_M = 4.0


CONFIRMING = (25, 4, 4.5)
CONDITIONS = (
    ("none", False),
    ("none", True),
    ("strong", False),
    ("weak", False),
    ("strong", True),
)
"""Strength of the habits, and whether the queue keeps its order over runs."""


def returning_crowd(
    seed: int,
    *,
    traits: float,
    is_order_kept: bool,
    sessions: Sequence[tuple[int, int, float]] = SESSIONS,
    place_effect: float = 0.7,
    n_people: int = 41,
) -> Tracks:
    """Tracks of `n_people` people, of whom about half walk in two sessions or more.

    `traits` is the spread of a person's habits (`STRENGTHS`), `place_effect` that of
    the places. With `is_order_kept` people keep their order over sessions.
    """
    rng = stream(seed, "planted", "returns")
    habits = traits * rng.standard_normal((n_people, 6))
    places = place_effect * rng.standard_normal((n_people, 6))
    order = rng.permutation(n_people)
    parts = []
    for number, (size, laps, median_s) in enumerate(sessions):
        present = np.sort(rng.choice(n_people, size, replace=False))
        queue = order[present] if is_order_kept else rng.permutation(order[present])
        headway_s = 2.0 * median_s / np.sqrt(size)
        for lap in range(laps):
            for slot, person in enumerate(queue.tolist()):
                at = np.flatnonzero(order == person)[0] if is_order_kept else slot
                start_s = (lap * size + slot) * headway_s + rng.uniform(0, 0.3)
                length_s = max(3.1, median_s * np.exp(0.15 * rng.standard_normal()))
                t, xy = passage(rng, habits[person] + places[at], length_s)
                parts.append((number, f"p{person:02d}", start_s + t, xy))
    return Tracks(
        t=np.concatenate([part[2] for part in parts]),
        xy=np.concatenate([part[3] for part in parts]),
        offsets=np.append(0, np.cumsum([part[2].size for part in parts])),
        source=tuple(f"{part[0]}:{row}" for row, part in enumerate(parts)),
        group=tuple(part[1] for part in parts),
        person=tuple(part[1] for part in parts),
        session=tuple(f"run {part[0]}" for part in parts),
    )


def passage(
    rng: np.random.Generator, habit: Floats, length_s: float
) -> tuple[Floats, Floats]:
    """Return times, s, and positions, m, of a passage with six habits."""
    t = np.arange(0.0, length_s, 1.0 / _RATE_HZ)
    speed = _WAY_M / length_s
    mood = 0.5 * rng.standard_normal(6)
    cadence, sway, surge, second, phase, skew = habit + mood
    step_hz = 1.9 * np.sqrt(min(speed, 1.4) / 1.3) * np.exp(0.08 * cadence)
    stride = np.pi * step_hz * t + rng.uniform(0, 2 * np.pi)
    stride += 0.1 * np.cumsum(rng.standard_normal(t.size)) / np.sqrt(_RATE_HZ)
    side_m = 0.03 * np.exp(0.25 * sway)
    lateral = side_m * (
        np.sin(stride) + 0.2 * np.exp(0.3 * second) * np.sin(3 * stride)
    )
    ahead = 0.012 * np.exp(0.25 * surge) * np.sin(2 * stride + 0.6 * phase)
    ahead += 0.006 * np.exp(0.3 * skew) * np.sin(stride + 1.0)
    drift = 0.02 * np.cumsum(rng.standard_normal((2, t.size)), axis=1) / _RATE_HZ**0.5
    x = speed * t + ahead + 0.5 * drift[0]
    return t, np.column_stack([x, lateral + 0.3 * drift[1]])


def judge(seed: int, *, traits: str, is_order_kept: bool) -> dict[str, object]:
    """Return what the rule answers in a crowd."""
    tracks = returning_crowd(
        seed,
        traits=STRENGTHS[traits],
        is_order_kept=is_order_kept,
        sessions=(*SESSIONS, CONFIRMING),
    )
    walks = find_passages(tracks)
    release = share_passages(walks, error="0")
    confirming = f"run {len(SESSIONS)}"
    study = study_returns(walks, release, enrolled=(None,), confirming=confirming)
    cell = study.primary
    return {
        "seed": seed,
        "traits": traits,
        "kept": is_order_kept,
        "decision": study.decision.decision,
        "why": study.decision.why,
        "p": study.regression.p_value,
        "rank1": cell.rank1.value,
        "rank1_ci": [cell.rank1.ci_low, cell.rank1.ci_high],
        "control": cell.control.value,
        "gain": [cell.gain.value, cell.gain.ci_low, cell.gain.ci_high],
        "n": cell.gain.n,
    }


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Return how often the rule says yes and no in each condition, with intervals."""
    lines = []
    for (traits, is_kept), part in rows.groupby(["traits", "kept"]):
        line: dict[str, object] = {
            "traits": traits,
            "order": "kept" if is_kept else "not kept",
            "worlds": len(part),
            "rank1": part.rank1.mean(),
            "control": part.control.mean(),
            "p_below_1pct": (part.p < 0.01).mean(),  # noqa: PLR2004 - the rule's
        }
        for answer in ("yes", "no"):
            hits = int((part.decision == answer).sum())
            low, high = exact_binomial(hits=hits, n=len(part))
            line[answer] = f"{hits} [{100 * low:.0f}, {100 * high:.0f}] %"
        lines.append(line)
    return pd.DataFrame(lines)


def main() -> None:
    """Judge worlds, or count the answers in files of worlds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--worlds", default="0:20", help="first and last seed")
    parser.add_argument(
        "--traits", default=",".join(STRENGTHS), help="strengths, with commas"
    )
    parser.add_argument("--out", type=Path, help="file that grows by a line a world")
    parser.add_argument("--summary", type=Path, nargs="+", help="such files")
    options = parser.parse_args()
    if options.summary:
        rows = [pd.read_json(path, lines=True) for path in options.summary]
        print(summary(pd.concat(rows)).to_string(index=False))
        return
    first, last = map(int, options.worlds.split(":"))
    wanted = options.traits.split(",")
    conditions = [condition for condition in CONDITIONS if condition[0] in wanted]
    for seed in range(first, last):
        for traits, is_kept in conditions:
            line = json.dumps(judge(seed, traits=traits, is_order_kept=is_kept))
            print(line)
            if options.out:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(line + "\n")


if __name__ == "__main__":
    main()
