"""The weak-attack detector: attacks whose numbers say less than they seem to.

A weak attack makes a mechanism look private. Two signs of one, both read off PLR:

- *beaten*: at a mechanism level another attack that should do no better has a higher PLR, beyond
  the 95 % interval of the paired difference. Such are the same attack with less knowledge, and a
  simpler attack with the same or less knowledge. Simpler is what comes earlier in `SIMPLER`; an
  attack that is not in that list is held against all of it. `averaging` over re-releases does not
  smooth: it is held against the control alone.
- *does_not_fall*: from the least noisy level of a mechanism to the noisiest, by the RMSE as shared
  and with raw as one of the levels, PLR after the attack does not fall beyond its paired interval.

What no attack could help is left out: a level where all that is shared leaks already, as with
`clean`; ends whose RMSE differs by less than a tenth; and ends between which PLR as shared does
not fall either. The control is never flagged. That an attack beats the shared positions is not
asked separately, since the control reproduces them.

The intervals are not adjusted for the number of comparisons: of two attacks that are equally
good one is flagged at about one level in forty. Fewer than 20 clusters decide nothing.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from evaluation.analysis.families import CLEAN, RAW
from evaluation.analysis.keys import AS_SHARED, Key, Source, level_text
from evaluation.analysis.metrics import EXPOSURE
from evaluation.analysis.paper import MIN_CLUSTERS
from evaluation.analysis.summary import clusters, weights_of
from evaluation.experiment.presets import IDENTITY
from evaluation.runs.cell_files import read_rows
from isac_track.intervals import cluster_sums, difference, ratio_estimate
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from collections.abc import Set as AbstractSet
    from pathlib import Path

    from evaluation.analysis.keys import Where
    from isac_track.intervals import Estimate

SIMPLER = (IDENTITY, "moving_average", "savgol", "kalman_rts")
"""From the simplest on."""
BEATEN, DOES_NOT_FALL = "beaten", "does_not_fall"
COLUMNS = [
    "kind",
    "mechanism",
    "level",
    "attack",
    "knowledge",
    "by",
    "by_knowledge",
    "metric",
    "difference",
    "ci_low",
    "ci_high",
    "compared",
    "sentence",
]

_ALONE = {"averaging": (IDENTITY,)}
_LEAST_RISE = 1.1
_ROUNDING = 1e-9
_RANK = {adversary: rank for rank, adversary in enumerate(ADVERSARIES)}
_ABOUT = {
    BEATEN: "PLR of `by`, the same attack with less knowledge or a simpler one with no more, is "
    "higher than that of `attack`. `difference`: PLR of `by` minus PLR of `attack`. `compared`: "
    "levels at which the two were compared.",
    DOES_NOT_FALL: "PLR after the attack does not fall from the least noisy level (raw included) "
    "to the noisiest, the one named. `difference`: PLR at the noisiest minus PLR at the least "
    "noisy. `compared`: mechanisms for which this was asked.",
}
_INTERVALS = (
    "95 %, of the paired difference over bootstrap draws of whole clusters; not adjusted for the "
    "number of comparisons: of two equally good attacks one is flagged at about one level in 40"
)


@dataclass(frozen=True, eq=False, slots=True)
class Flags:
    """What the detector found, and how much it looked at."""

    rows: pd.DataFrame
    """`COLUMNS`; a row is one flag."""
    comparisons: dict[str, int]
    """Kind to the number of intervals looked at."""
    left_out: dict[str, int]
    """Why comparisons were left out, and how many."""


@dataclass(frozen=True, eq=False, slots=True)
class _Pair:
    """Two estimates to compare, and what a flag would say."""

    kind: str
    where: Where
    attack: Source
    by: Source
    minus: Estimate
    plus: Estimate
    least: Where | None = None
    """The least noisy level of a mechanism."""


def flags(
    found: Mapping[Key, Estimate],
    *,
    slow: AbstractSet[str] = frozenset(),
    once: Mapping[Key, Estimate] | None = None,
) -> Flags:
    """Return the flags of a run.

    Parameters
    ----------
    found : mapping
        As `summary.estimates` returns it.
    slow : set of str
        Attacks that saw one release of each source track only.
    once : mapping, optional
        PLR of all attacks on those releases, from `on_first_releases`; without it slow attacks
        are not compared with others.
    """
    levels: dict[Where, dict[Source, Estimate]] = {}
    for key, estimate in found.items():
        if key.metric == EXPOSURE and key.knowledge:
            levels.setdefault(key.where, {})[key.measure.source] = estimate
    left_out: dict[str, int] = {}
    pairs = [
        *_beaten_pairs(levels, found, slow=slow, once=once or {}, left_out=left_out),
        *_falling_pairs(levels, found, left_out=left_out),
    ]
    enough = [pair for pair in pairs if min(pair.minus.n, pair.plus.n) >= MIN_CLUSTERS]
    if len(enough) < len(pairs):
        left_out["fewer than 20 clusters"] = len(pairs) - len(enough)
    compared: dict[tuple[str, Source, Source], int] = {}
    for pair in enough:
        name = pair.kind, pair.attack, pair.by
        compared[name] = compared.get(name, 0) + 1
    gaps = [(pair, difference(pair.plus, pair.minus)) for pair in enough]
    rows = [
        _row(pair, gap, compared=compared[pair.kind, pair.attack, pair.by])
        for pair, gap in gaps
        if (gap.ci_low > _ROUNDING if pair.kind == BEATEN else gap.ci_high > -_ROUNDING)
    ]
    return Flags(
        rows=pd.DataFrame(rows, columns=COLUMNS),
        comparisons={
            kind: sum(pair.kind == kind for pair in enough) for kind in (BEATEN, DOES_NOT_FALL)
        },
        left_out=left_out,
    )


def slow_attacks(manifest: Mapping[str, Any]) -> set[str]:
    """Return the attacks of a run that saw one release of each source track only."""
    return {entry["consumer"] for entry in manifest.get("cells", ()) if entry.get("slow", False)}


def on_first_releases(out: Path, manifest: Mapping[str, Any]) -> dict[Key, Estimate]:
    """Return PLR of the attacks on the releases that the slow ones saw; empty without slow ones.

    Raises
    ------
    DataError
        If a cell cannot be read.
    """
    slow = [entry for entry in manifest["cells"] if entry.get("slow", False)]
    seen = {}
    for entry in slow:
        table = read_rows(out, entry, columns=["scene", "agent"])
        seen[entry["spec"]] = _names(table)
    weights = weights_of(manifest) if slow else np.zeros((0, 0))
    found = {}
    for entry in manifest["cells"]:
        if entry["kind"] != "attack" or entry["spec"] not in seen:
            continue
        if not (entry.get("slow", False) or _base(entry["consumer"]) in SIMPLER):
            continue  # nobody is held against it
        table = read_rows(out, entry, columns=["scene", "agent", "group", "plr"])
        table = table.filter(np.isin(_names(table), seen[entry["spec"]]))
        cluster = clusters(table, manifest)
        plr = table["plr"].to_numpy()
        sums, counts = (
            cluster_sums(values=values, cluster=cluster, n_clusters=weights.shape[1])
            for values in (plr, np.ones_like(plr))
        )
        key = Key(
            entry["mechanism"], entry["level"], entry["consumer"], EXPOSURE, entry["knowledge"]
        )
        found[key] = ratio_estimate(
            numerator=sums, denominator=counts, weights=weights, is_share=True
        )
    return found


def to_json(found: Flags) -> bytes:
    """Return the content of `flags.json`."""
    rows = found.rows.to_dict("records")
    for row in rows:
        row["level"] = None if np.isnan(row["level"]) else row["level"]
    content = {
        "about": "Attacks that may be too weak for their numbers to mean privacy.",
        "kinds": _ABOUT,
        "simpler": {"order": SIMPLER, "others": "held against all of these", **_ALONE},
        "intervals": _INTERVALS,
        "comparisons": found.comparisons,
        "left_out": found.left_out,
        "flags": rows,
    }
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


def lines(rows: pd.DataFrame) -> list[str]:
    """Return the flags in short: a line for each kind, attack, adversary and what beat it."""
    return [
        _beaten_line(part) if kind == BEATEN else _falling_line(part)
        for (kind, *_), part in rows.groupby(["kind", "attack", "knowledge", "by"], sort=False)
    ]


def _beaten_pairs(
    levels: Mapping[Where, Mapping[Source, Estimate]],
    found: Mapping[Key, Estimate],
    *,
    slow: AbstractSet[str],
    once: Mapping[Key, Estimate],
    left_out: dict[str, int],
) -> Iterator[_Pair]:
    for where, plr in levels.items():
        shared = found.get(_key(where, AS_SHARED))
        nothing_to_gain = shared is not None and shared.value >= 1.0
        for attack, by in ((a, b) for a in plr for b in plr if _should_win(a, b)):
            minus, plus = plr[attack], plr[by]
            if (attack.consumer in slow) != (by.consumer in slow):
                keys = [_key(where, source) for source in (attack, by)]
                if not all(key in once for key in keys):
                    _count(left_out, "a slow attack, without the others on the same tracks")
                    continue
                minus, plus = (once[key] for key in keys)
            if nothing_to_gain:
                _count(left_out, "all that is shared leaks already")
                continue
            yield _Pair(BEATEN, where, attack, by, minus, plus)


def _falling_pairs(
    levels: Mapping[Where, Mapping[Source, Estimate]],
    found: Mapping[Key, Estimate],
    *,
    left_out: dict[str, int],
) -> Iterator[_Pair]:
    for mechanism in dict.fromkeys(name for name, _ in levels if name not in (RAW, CLEAN)):
        # By the noise that there is, whichever way the level counts.
        noise = {
            where: found[_key(where, AS_SHARED, "rmse")].value
            for where in levels
            if where[0] in (mechanism, RAW) and _key(where, AS_SHARED, "rmse") in found
        }
        in_order = sorted(noise, key=noise.__getitem__)
        if len(in_order) < 2 or in_order[-1][0] != mechanism:  # noqa: PLR2004 - a fall has two ends
            continue
        least, most = in_order[0], in_order[-1]
        attacks = [
            attack
            for attack in levels[most]
            if attack in levels[least] and _base(attack.consumer) != IDENTITY
        ]
        if noise[most] < _LEAST_RISE * noise[least]:
            _count(left_out, "the noise hardly rises", len(attacks))
            continue
        quiet, noisy = (found.get(_key(where, AS_SHARED)) for where in (least, most))
        if quiet is not None and noisy is not None and difference(noisy, quiet).ci_high >= 0:
            _count(left_out, "PLR as shared does not fall either", len(attacks))
            continue
        for attack in attacks:
            ends = levels[least][attack], levels[most][attack]
            yield _Pair(DOES_NOT_FALL, most, attack, Source(""), *ends, least=least)


def _key(where: Where, source: Source, metric: str = EXPOSURE) -> Key:
    return Key(*where, source.consumer, metric, source.knowledge)


def _should_win(attack: Source, by: Source) -> bool:
    """Whether the first attack has no excuse to do worse than the second."""
    base, by_base = _base(attack.consumer), _base(by.consumer)
    if base == IDENTITY:
        return False
    if attack.consumer == by.consumer:
        return _RANK[by.knowledge] < _RANK[attack.knowledge]
    order = SIMPLER[: SIMPLER.index(base)] if base in SIMPLER else _ALONE.get(base, SIMPLER)
    return by_base in order and _RANK[by.knowledge] <= _RANK[attack.knowledge]


def _base(spec: str) -> str:
    """Return the name of an attack without its parameters."""
    return spec.partition(":")[0]


def _row(pair: _Pair, gap: Estimate, *, compared: int) -> dict[str, Any]:
    change = f"{_points(gap.value, gap.ci_low, gap.ci_high, sign='+')} points"
    before, after = (f"{100 * one.value:.1f} %" for one in (pair.minus, pair.plus))
    if pair.kind == BEATEN:
        sentence = (
            f"{pair.attack.label} is beaten by {pair.by.label} at {_place(pair.where)}: "
            f"PLR {before} against {after}, {change}"
        )
    else:
        assert pair.least is not None
        sentence = (
            f"{pair.attack.label} does not fall with the noise: PLR {before} at "
            f"{_place(pair.least)}, {after} at {_place(pair.where)}, {change}"
        )
    mechanism, level = pair.where
    return {
        "kind": pair.kind,
        "mechanism": mechanism,
        "level": np.nan if level is None else level,
        "attack": pair.attack.consumer,
        "knowledge": pair.attack.knowledge,
        "by": pair.by.consumer,
        "by_knowledge": pair.by.knowledge,
        "metric": EXPOSURE,
        "difference": gap.value,
        "ci_low": gap.ci_low,
        "ci_high": gap.ci_high,
        "compared": compared,
        "sentence": sentence,
    }


def _beaten_line(part: pd.DataFrame) -> str:
    worst = part.sort_values("difference").iloc[-1]
    by = f"{worst['by']} ({', '.join(part['by_knowledge'].unique())})"
    n_levels = len(part[["mechanism", "level"]].drop_duplicates())
    return (
        f"flag: {worst['attack']} ({worst['knowledge']}) is beaten by {by} at {n_levels} of "
        f"{part['compared'].max()} levels, by up to {_amount(worst)} points: flags.json"
    )


def _falling_line(part: pd.DataFrame) -> str:
    worst = part.sort_values("difference").iloc[-1]
    return (
        f"flag: {worst['attack']} ({worst['knowledge']}) does not fall with the noise in "
        f"{len(part)} of {worst['compared']} mechanisms ({', '.join(part['mechanism'])}), by "
        f"{_amount(worst, sign='+')} points: flags.json"
    )


def _amount(row: pd.Series[Any], *, sign: str = "-") -> str:
    return _points(row["difference"], row["ci_low"], row["ci_high"], sign=sign)


def _points(value: float, low: float, high: float, *, sign: str = "-") -> str:
    """Return a difference of two shares in points, with its interval."""
    # Small ones with enough digits to see that the interval lies on one side of zero.
    digits = 1 if min(abs(low), abs(high)) >= 0.001 else 2  # noqa: PLR2004 - a tenth of a point
    shown = [f"{100 * one:{sign}.{digits}f}" for one in (value, low, high)]
    return f"{shown[0]} [{shown[1]}, {shown[2]}]"


def _place(where: Where) -> str:
    mechanism, level = where
    return f"{mechanism} {level_text(level)}".rstrip()


def _names(table: Any) -> Any:  # noqa: ANN401 - pyarrow has no types
    """Return a number for each row's track: its scene and its agent."""
    return table["scene"].to_numpy() * 2**16 + table["agent"].to_numpy()


def _count(counts: dict[str, int], what: str, n: int = 1) -> None:
    counts[what] = counts.get(what, 0) + n
