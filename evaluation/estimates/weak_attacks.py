"""The weak-attack detector: attacks whose numbers say less than they seem to.

A weak attack makes a mechanism look private: `_ABOUT` tells the three signs of one.
Simpler is what comes earlier in `SIMPLER`; an attack that is not in that list is held
against all of it, and `averaging` over re-releases, which does not smooth, against the
control alone. Noise is the RMSE as shared. What no attack could help is left out, and
fewer than 20 clusters decide nothing. The control is never flagged; it reproduces what
is shared, which is not held against attacks itself.
"""

import json
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.bounds import Gap
from evaluation.estimates.families import CLEAN, RAW
from evaluation.estimates.keys import AS_SHARED, Found, Source, Where, where_text
from evaluation.estimates.metrics import EXPOSURE, SUCCESS
from evaluation.plan.constants import BOUND
from evaluation.plan.presets import IDENTITY
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate, difference
from isac_track.protocols import ADVERSARIES

Levels = Mapping[Where, Mapping[Source, Estimate]]
SIMPLER = (IDENTITY, "moving_average", "savgol", "kalman_rts")  # From the simplest on.
BEATEN, DOES_NOT_FALL, FAR = "beaten", "does_not_fall", "far_from_optimum"
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
    BEATEN: (
        "PLR of `by`, the same attack with less knowledge or a simpler one with no"
        " more, is higher than that of `attack`. `difference`: PLR of `by` minus PLR of"
        " `attack`. `compared`: levels at which the two were compared."
    ),
    DOES_NOT_FALL: (
        "PLR after the attack does not fall from the least noisy level (raw included)"
        " to the noisiest, the one named. `difference`: PLR at the noisiest minus PLR"
        " at the least noisy. `compared`: mechanisms for which this was asked."
    ),
    FAR: (
        "In a world of the fitted motion the closest attack is more than five points"
        " below the optimum. `difference`: what it lacks. `compared`: levels at which"
        " the optimum is known."
    ),
}
_FAR: Final = 0.05


class _Pair(NamedTuple):
    """Two estimates to compare: an attack's, and what should not be above it."""

    kind: str
    where: Where
    attack: Source
    by: Source  # What beats it; of no name if nothing does.
    minus: Estimate
    plus: Estimate
    said: str


def flags(
    found: Found, *, slow: Collection[str] = frozenset()
) -> tuple[pd.DataFrame, dict[str, dict[str, int]]]:
    """Return the flags of a run, a row each (`COLUMNS`), and how much was looked at.

    The latter is `comparisons`, intervals by kind, and `left_out`, comparisons by why
    they were. `slow` are the attacks that saw one release of each source track only: no
    other saw the same.
    """
    levels: dict[Where, dict[Source, Estimate]] = {}
    for key, one in found.items():
        if key.metric == EXPOSURE and key.knowledge:
            levels.setdefault(key.where, {})[key.measure.source] = one
    left_out: Counter[str] = Counter()
    pairs = [*_beaten_pairs(levels, found, slow, left_out)]
    pairs += _falling_pairs(levels, found, left_out)
    enough = [
        pair for pair in pairs if min(pair.minus.n, pair.plus.n) >= FEWEST_EFFECTIVE
    ]
    if len(enough) < len(pairs):
        left_out["fewer than 20 clusters"] = len(pairs) - len(enough)
    compared = Counter((pair.kind, pair.attack, pair.by) for pair in enough)
    rows = []
    for kind, where, attack, by, minus, plus, said in enough:
        gap = difference(plus, minus)
        if not (gap.ci_low > _ROUNDING if kind == BEATEN else gap.ci_high > -_ROUNDING):
            continue
        interval = gap.value, gap.ci_low, gap.ci_high
        about = (
            kind,
            where[0],
            np.nan if where[1] is None else where[1],
            *attack,
            *by,
            EXPOSURE,
        )
        sentence = f"{attack.label} {said}, {_points(*interval, sign='+')} points"
        rows.append((*about, *interval, compared[kind, attack, by], sentence))
    looked = Counter(pair.kind for pair in enough)
    about_it = {
        "comparisons": {kind: looked[kind] for kind in _ABOUT},
        "left_out": dict(left_out),
    }
    return pd.DataFrame(rows, columns=COLUMNS), about_it


def far_from_optimum(known: Sequence[Gap]) -> pd.DataFrame:
    """Return the flags of levels at which even the closest attack is far below the optimum."""
    exact = [one for one in known if one.is_exact]
    far = [one for one in exact if one.gap.ci_low > _FAR]
    rows = []
    for one in far:
        interval = one.gap.value, one.gap.ci_low, one.gap.ci_high
        said = (
            f"is the closest to the optimum at {where_text(*one.where)} in the model"
            " world"
        )
        sentence = f"{one.attack.label} {said}, and {_points(*interval)} points below"
        about = FAR, one.where[0], np.nan if one.where[1] is None else one.where[1]
        metric = SUCCESS if one.attack.task else EXPOSURE
        rows.append(
            (*about, *one.attack, BOUND, "", metric, *interval, len(exact), sentence)
        )
    return pd.DataFrame(rows, columns=COLUMNS)


def slow_attacks(manifest: Mapping[str, Any]) -> set[str]:
    """Return the attacks of a run that saw one release of each source track only."""
    return {
        entry["consumer"]
        for entry in manifest.get("cells", ())
        if entry.get("slow", False)
    }


def to_json(rows: pd.DataFrame, looked: Mapping[str, Any]) -> bytes:
    """Return the content of `flags.json`, from what `flags` returns."""
    known = rows.astype(object)
    content = {
        "about": "Attacks that may be too weak for their numbers to mean privacy.",
        "kinds": _ABOUT,
        "simpler": {"order": SIMPLER, "others": "held against all of these", **_ALONE},
        "intervals": (
            "95 %, of the paired difference over bootstrap draws of whole clusters; not"
            " adjusted for the number of comparisons: of two equally good attacks one"
            " is flagged at about one level in 40"
        ),
        **looked,
        "columns": COLUMNS,
        "flags": known.where(known.notna(), None).to_dict("records"),
    }
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


def lines(rows: pd.DataFrame) -> list[str]:
    """Return the flags in short: a line for each kind, attack, adversary and what beat it."""
    found = []
    for (kind, *_), part in rows.groupby(
        ["kind", "attack", "knowledge", "by"], sort=False
    ):
        worst = part.sort_values("difference").iloc[-1]
        interval = worst["difference"], worst["ci_low"], worst["ci_high"]
        where = f"{len(part)} of {worst['compared']}"
        if kind == BEATEN:
            n_levels = len(part[["mechanism", "level"]].drop_duplicates())
            said = (
                f"is beaten by {worst['by']}"
                f" ({', '.join(part['by_knowledge'].unique())}) at "
            )
            said += (
                f"{n_levels} of {part['compared'].max()} levels, by up to"
                f" {_points(*interval)}"
            )
        elif kind == FAR:
            said = (
                f"is closest to the optimum at {where} levels of model worlds, and"
                " below it by "
            )
            said += f"up to {_points(*interval)}"
        else:
            said = f"does not fall with the noise in {where} mechanisms "
            said += (
                f"({', '.join(part['mechanism'])}), by {_points(*interval, sign='+')}"
            )
        who = f"{worst['attack']} ({worst['knowledge']})"
        found.append(f"flag: {who} {said} points: flags.json")
    return found


def _beaten_pairs(
    levels: Levels, found: Found, slow: Collection[str], left_out: Counter[str]
) -> Iterator[_Pair]:
    for where, plr in levels.items():
        shared = found.get(AS_SHARED.measure(EXPOSURE).at(*where))
        nothing_to_gain = shared is not None and shared.value >= 1.0
        for attack, by in ((a, b) for a in plr for b in plr if _should_win(a, b)):
            minus, plus = plr[attack], plr[by]
            if (attack.consumer in slow) != (by.consumer in slow):
                left_out["a slow attack, without the others on the same tracks"] += 1
            elif nothing_to_gain:
                left_out["all that is shared leaks already"] += 1
            else:
                said = f"is beaten by {by.label} at {where_text(*where)}: PLR "
                said += f"{100 * minus.value:.1f} % against {100 * plus.value:.1f} %"
                yield _Pair(BEATEN, where, attack, by, minus, plus, said)


def _falling_pairs(
    levels: Levels, found: Found, left_out: Counter[str]
) -> Iterator[_Pair]:
    rmse, exposed = AS_SHARED.measure("rmse"), AS_SHARED.measure(EXPOSURE)
    for mechanism in dict.fromkeys(
        name for name, _ in levels if name not in (RAW, CLEAN)
    ):
        # By the noise that there is, whichever way the level counts.
        noise = {
            where: found[rmse.at(*where)].value
            for where in levels
            if where[0] in (mechanism, RAW) and rmse.at(*where) in found
        }
        in_order = sorted(noise, key=noise.__getitem__)
        if len(in_order) < 2 or in_order[-1][0] != mechanism:  # noqa: PLR2004 - a fall has two ends
            continue
        least, most = in_order[0], in_order[-1]
        both = (attack for attack in levels[most] if attack in levels[least])
        attacks = [
            attack for attack in both if attack.consumer.partition(":")[0] != IDENTITY
        ]
        quiet, noisy = (found.get(exposed.at(*where)) for where in (least, most))
        if noise[most] < _LEAST_RISE * noise[least]:
            left_out["the noise hardly rises"] += len(attacks)
        elif (
            quiet is not None
            and noisy is not None
            and difference(noisy, quiet).ci_high >= 0
        ):
            left_out["PLR as shared does not fall either"] += len(attacks)
        else:
            for attack in attacks:
                minus, plus = levels[least][attack], levels[most][attack]
                said = (
                    f"does not fall with the noise: PLR {100 * minus.value:.1f} % at "
                )
                said += (
                    f"{where_text(*least)}, {100 * plus.value:.1f} % at"
                    f" {where_text(*most)}"
                )
                yield _Pair(DOES_NOT_FALL, most, attack, Source(""), minus, plus, said)


def _should_win(attack: Source, by: Source) -> bool:
    """Whether the first attack has no excuse to do worse than the second."""
    base, by_base = (one.consumer.partition(":")[0] for one in (attack, by))
    if base == IDENTITY:
        return False
    if attack.consumer == by.consumer:
        return _RANK[by.knowledge] < _RANK[attack.knowledge]
    order = (
        SIMPLER[: SIMPLER.index(base)] if base in SIMPLER else _ALONE.get(base, SIMPLER)
    )
    return by_base in order and _RANK[by.knowledge] <= _RANK[attack.knowledge]


def _points(value: float, low: float, high: float, *, sign: str = "-") -> str:
    """Return a difference of two shares in points, with its interval."""
    # Small ones with enough digits to see that the interval lies on one side of zero.
    digits = 1 if min(abs(low), abs(high)) >= 0.001 else 2  # noqa: PLR2004 - a tenth of a point
    shown = [f"{100 * one:{sign}.{digits}f}" for one in (value, low, high)]
    return f"{shown[0]} [{shown[1]}, {shown[2]}]"
