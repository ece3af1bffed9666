"""The weak-attack detector: attacks too weak for their numbers to mean privacy.

A weak attack makes a mechanism look private; `_ABOUT` describes the three signs of a
weak attack. An attack is simpler than another if it comes earlier in `SIMPLER`. An
attack that is not in that list is compared with all of it; `averaging` over
re-releases, which does not smooth, is compared with the control only. Noise is the RMSE
as shared. Comparisons that no attack could win are left out, and fewer than 20
effective clusters decide nothing. The control, which reproduces the shared positions,
is never flagged.
"""

import json
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.bounds import ClosestAttack
from evaluation.estimates.families import CLEAN, RAW
from evaluation.estimates.keys import EstimatesByAddress, where_text
from evaluation.estimates.metrics import PLR, RANK1
from evaluation.plan.address import (
    AS_SHARED,
    Address,
    MechanismLevel,
    parse_consumer,
    plugin_name,
)
from evaluation.plan.constants import BOUND
from evaluation.plan.presets import IDENTITY
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate, difference
from isac_track.protocols import ADVERSARIES

Levels = Mapping[MechanismLevel, Mapping[Address, Estimate]]
SIMPLER = (IDENTITY, "moving_average", "savgol", "kalman_rts")  # The simplest first.
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

_COMPARED_WITH = {"averaging": (IDENTITY,)}
_LEAST_RISE = 1.1
_ROUNDING = 1e-9
_ABOUT = {
    BEATEN: (
        "PLR of `by`, the same attack with less knowledge or a simpler attack with no"
        " more, is higher than that of `attack`. `difference`: PLR of `by` minus PLR of"
        " `attack`. `compared`: levels at which the two were compared."
    ),
    DOES_NOT_FALL: (
        "PLR after the attack does not fall from the least noisy level (raw included)"
        " to the noisiest, which is named. `difference`: PLR at the noisiest minus PLR"
        " at the least noisy. `compared`: mechanisms for which this was asked."
    ),
    FAR: (
        "In a world of the fitted motion the closest attack is more than five points"
        " below the optimum. `difference`: what it lacks. `compared`: levels at which"
        " the optimum is known."
    ),
}
_LARGEST_GAP: Final = 0.05


class _Pair(NamedTuple):
    """Two estimates to compare: an attack's, and that which should not be above it."""

    kind: str
    mechanism_level: MechanismLevel
    attack: Address
    by: Address  # The rival that beats it; without a name if there is none.
    attack_plr: Estimate
    rival_plr: Estimate  # Or the attack's own, where the noise is strongest.
    text: str


def flags(
    estimates: EstimatesByAddress, *, slow: Collection[str] = frozenset()
) -> tuple[pd.DataFrame, dict[str, dict[str, int]]]:
    """Return the flags of a run, a row each (`COLUMNS`), and the extent of the search.

    The latter is `comparisons`, the number of intervals by kind, and `left_out`, the
    number of comparisons left out by reason. `slow` are the attacks that saw only one
    release of each source track: no other attack saw the same.
    """
    levels: dict[MechanismLevel, dict[Address, Estimate]] = {}
    for key, estimate in estimates.items():
        if key.metric == PLR and key.adversary:
            levels.setdefault(key.mechanism_level, {})[key.reader] = estimate
    left_out: Counter[str] = Counter()
    pairs = [*_beaten_pairs(levels, estimates, slow, left_out)]
    pairs += _falling_pairs(levels, estimates, left_out)
    enough = [
        pair
        for pair in pairs
        if min(pair.attack_plr.n_effective, pair.rival_plr.n_effective)
        >= FEWEST_EFFECTIVE
    ]
    if len(enough) < len(pairs):
        left_out[f"fewer than {FEWEST_EFFECTIVE} clusters"] = len(pairs) - len(enough)
    compared = Counter((pair.kind, pair.attack, pair.by) for pair in enough)
    rows = []
    for pair in enough:
        kind, attack, by = pair.kind, pair.attack, pair.by
        gap = difference(pair.rival_plr, pair.attack_plr)
        if not (gap.ci_low > _ROUNDING if kind == BEATEN else gap.ci_high > -_ROUNDING):
            continue
        interval = gap.value, gap.ci_low, gap.ci_high
        mechanism, level = pair.mechanism_level
        about = (
            kind,
            mechanism,
            np.nan if level is None else level,
            attack.consumer,
            attack.adversary,
            by.consumer,
            by.adversary,
            PLR,
        )
        sentence = f"{attack.label} {pair.text}, {_points(*interval, sign='+')} points"
        rows.append((*about, *interval, compared[kind, attack, by], sentence))
    counted = Counter(pair.kind for pair in enough)
    extent = {
        "comparisons": {kind: counted[kind] for kind in _ABOUT},
        "left_out": dict(left_out),
    }
    return pd.DataFrame(rows, columns=COLUMNS), extent


def far_from_optimum(gaps: Sequence[ClosestAttack]) -> pd.DataFrame:
    """Return the flags of levels where the closest attack is far from the optimum."""
    exact = [gap for gap in gaps if gap.is_exact]
    rows = []
    for gap in exact:
        if not gap.gap.ci_low > _LARGEST_GAP:
            continue
        interval = gap.gap.value, gap.gap.ci_low, gap.gap.ci_high
        mechanism, level = gap.mechanism_level
        sentence = (
            f"{gap.attack.label} is the closest to the optimum at"
            f" {where_text(mechanism, level)} in the model world, and"
            f" {_points(*interval)} points below"
        )
        about = FAR, mechanism, np.nan if level is None else level
        names = gap.attack.consumer, gap.attack.adversary
        metric = RANK1 if gap.attack.task else PLR
        rows.append(
            (*about, *names, BOUND, "", metric, *interval, len(exact), sentence)
        )
    return pd.DataFrame(rows, columns=COLUMNS)


def slow_attacks(manifest: Mapping[str, Any]) -> set[str]:
    """Return the attacks of a run that saw only one release of each source track."""
    return {
        entry.address.consumer for entry in manifest.get("cells", ()) if entry.is_slow
    }


def to_json(rows: pd.DataFrame, extent: Mapping[str, Any]) -> bytes:
    """Return the content of `flags.json`, from what `flags` returns."""
    known = rows.astype(object)
    content = {
        "about": "Attacks that may be too weak for their numbers to mean privacy.",
        "kinds": _ABOUT,
        "simpler": {
            "order": SIMPLER,
            "others": "held against all of these",
            **_COMPARED_WITH,
        },
        "intervals": (
            "95 %, of the paired difference over bootstrap draws of whole clusters; not"
            " adjusted for the number of comparisons: of two equally good attacks one"
            " is flagged at about one level in 40"
        ),
        **extent,
        "columns": COLUMNS,
        "flags": known.where(known.notna(), None).to_dict("records"),
    }
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


def lines(rows: pd.DataFrame) -> list[str]:
    """Return the flags in short: a line for each kind, attack, adversary and rival."""
    return [
        _line(str(kind), group)
        for (kind, *_), group in rows.groupby(
            ["kind", "attack", "knowledge", "by"], sort=False
        )
    ]


def _line(kind: str, rows: pd.DataFrame) -> str:
    """Return the line of flags that share kind, attack, adversary and rival."""
    worst = rows.sort_values("difference").iloc[-1]
    interval = worst["difference"], worst["ci_low"], worst["ci_high"]
    share = f"{len(rows)} of {worst['compared']}"
    if kind == BEATEN:
        n_levels = len(rows[["mechanism", "level"]].drop_duplicates())
        text = (
            f"is beaten by {worst['by']} ({', '.join(rows['by_knowledge'].unique())})"
            f" at {n_levels} of {rows['compared'].max()} levels, by up to"
            f" {_points(*interval)}"
        )
    elif kind == FAR:
        text = (
            f"is closest to the optimum at {share} levels of model worlds, and below it"
            f" by up to {_points(*interval)}"
        )
    else:
        text = (
            f"does not fall with the noise in {share} mechanisms"
            f" ({', '.join(rows['mechanism'])}), by {_points(*interval, sign='+')}"
        )
    attack = parse_consumer(worst["attack"], worst["knowledge"]).label
    return f"flag: {attack} {text} points: flags.json"


def _beaten_pairs(
    levels: Levels,
    estimates: EstimatesByAddress,
    slow: Collection[str],
    left_out: Counter[str],
) -> Iterator[_Pair]:
    for where, plr in levels.items():
        shared = estimates.get(AS_SHARED.at(*where, PLR))
        nothing_to_gain = shared is not None and shared.value >= 1.0
        for attack, by in ((a, b) for a in plr for b in plr if _should_win(a, b)):
            attack_plr, rival_plr = plr[attack], plr[by]
            if (attack.consumer in slow) != (by.consumer in slow):
                left_out["a slow attack, without the others on the same tracks"] += 1
            elif nothing_to_gain:
                left_out["all that is shared leaks already"] += 1
            else:
                text = (
                    f"is beaten by {by.label} at {where_text(*where)}: PLR"
                    f" {100 * attack_plr.value:.1f} % against {100 * rival_plr.value:.1f} %"
                )
                yield _Pair(BEATEN, where, attack, by, attack_plr, rival_plr, text)


def _falling_pairs(
    levels: Levels, estimates: EstimatesByAddress, left_out: Counter[str]
) -> Iterator[_Pair]:
    rmse, exposed = AS_SHARED.measured("rmse"), AS_SHARED.measured(PLR)
    mechanisms = (name for name, _ in levels if name not in (RAW, CLEAN))
    for mechanism in dict.fromkeys(mechanisms):
        # In the order of the actual noise, whichever way the level counts.
        noise = {
            where: estimates[rmse.at(*where)].value
            for where in levels
            if where.mechanism in (mechanism, RAW) and rmse.at(*where) in estimates
        }
        in_order = sorted(noise, key=noise.__getitem__)
        if len(in_order) < 2 or in_order[-1][0] != mechanism:  # noqa: PLR2004 - a fall has two ends
            continue
        least, most = in_order[0], in_order[-1]
        attacks = [
            attack
            for attack in levels[most]
            if attack in levels[least] and plugin_name(attack.plugin) != IDENTITY
        ]
        quiet, noisy = (estimates.get(exposed.at(*where)) for where in (least, most))
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
                at_least, at_most = levels[least][attack], levels[most][attack]
                text = (
                    f"does not fall with the noise: PLR {100 * at_least.value:.1f} % at"
                    f" {where_text(*least)}, {100 * at_most.value:.1f} % at"
                    f" {where_text(*most)}"
                )
                yield _Pair(
                    DOES_NOT_FALL, most, attack, Address(), at_least, at_most, text
                )


def _should_win(attack: Address, by: Address) -> bool:
    """Whether the first attack should do no worse than the second.

    Adversaries are compared by their sets of knowledge, which are no chain.
    """
    knows, by_knows = ADVERSARIES[attack.adversary], ADVERSARIES[by.adversary]
    base, by_base = plugin_name(attack.plugin), plugin_name(by.plugin)
    if base == IDENTITY:
        return False
    if attack.consumer == by.consumer:
        return by_knows < knows
    if base in SIMPLER:
        simpler = SIMPLER[: SIMPLER.index(base)]
    else:
        simpler = _COMPARED_WITH.get(base, SIMPLER)
    return by_base in simpler and by_knows <= knows


def _points(value: float, low: float, high: float, *, sign: str = "-") -> str:
    """Return a difference of two shares in points, with its interval."""
    # Show enough digits to see that a small interval lies on one side of zero.
    digits = 1 if min(abs(low), abs(high)) >= 0.001 else 2  # noqa: PLR2004 - a tenth of a point
    shown = [f"{100 * number:{sign}.{digits}f}" for number in (value, low, high)]
    return f"{shown[0]} [{shown[1]}, {shown[2]}]"
