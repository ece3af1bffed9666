"""Differences between two runs: settings, code, and every number that both have.

Nothing is simulated again: the estimates and their replicates come from the finished
cells.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtri, stdtr

from evaluation.estimates.families import entry_families
from evaluation.estimates.keys import EstimatesByAddress, row_dicts
from evaluation.estimates.linkability import linkage_outcomes
from evaluation.estimates.metrics import (
    CHANCE,
    METRICS,
    MISSED_FUTURE,
    MISSED_RATE,
    PLR,
    RANK1,
    RANK1_AMONG_100,
)
from evaluation.estimates.patrols import patrol_numbers
from evaluation.estimates.returns import return_numbers
from evaluation.estimates.run_settings import (
    NONE,
    Apart,
    Manifest,
    about,
    changed,
    names_beside,
    only_in,
    pairing,
)
from evaluation.estimates.strongest import strongest_by_task
from evaluation.estimates.summary import linkage_estimates, scene_numbers
from evaluation.estimates.tracking import track_numbers
from evaluation.plan.address import Address, MechanismLevel, parse_row
from evaluation.plan.presets import PRESETS
from evaluation.plan.world import World, parse_world
from evaluation.store.entries import Entry, horizons_in
from evaluation.store.manifest import read_manifest
from evaluation.store.verdict_file import VERDICT, load_verdict
from isac_track.errors import DataError
from isac_track.intervals import CONFIDENCE, Estimate, percentile_interval
from isac_track.linkability.significance import holm
from isac_track.types import Floats

# Findings of a row.
IDENTICAL: Final = "identical"
DIFFERS: Final = "differs"
BETWEEN: Final = "between"
UNTESTED: Final = "untested"
SIGNIFICANCE: Final = 0.05  # Of a family of tests, after Holm.
_MOST_NAMED, _MOST_LEVELS = 4, 5
COLUMNS = [
    "mechanism",
    "level",
    "consumer",
    "knowledge",
    "metric",
    "headline",
    "a",
    "b",
    "difference",
    "ci_low",
    "ci_high",
    "unit",
    "n",
    "pairing",
    "t",
    "p_value",
    "p_holm",
    "finding",
    "world",
    "policy",
]
"""`world` is a further horizon, as in data sets' names; empty for the run's own.
`policy` says which queries are answered, or names release and tracker; empty in scenes
and in linkage."""


class Difference(NamedTuple):
    """B - A of one number."""

    difference: float
    ci_low: float = math.nan
    ci_high: float = math.nan
    # Difference over its standard error, which has n - 1 degrees of freedom.
    t: float = math.nan
    p_value: float = math.nan  # Two-sided; NaN where there is no interval.


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """Two runs side by side."""

    a: dict[str, Any]  # About run A: `out`, `dataset`, `scenes`, `seed`, `preset`.
    b: dict[str, Any]
    changed: dict[str, Apart]
    """Under data, settings and code: values in A and B by name, None if unknown."""
    only: Apart  # By axis: the names that only A has, and those that only B has.
    only_numbers: tuple[int, int]  # Count of numbers that only A has, and only B.
    rows: pd.DataFrame
    """A row for each number that both have, the surest difference first: `COLUMNS`."""
    lead: pd.DataFrame
    """The leading rows, at a few levels: missed conflicts, missed future conflicts at
    further horizons, PLR after A's strongest attack, and rank 1."""
    # Decisions that changed; None unless both runs have a verdict.
    verdicts: dict[str, Any] | None

    @property
    def headline(self) -> pd.DataFrame:
        """Rows tested as one family; all other rows are another family."""
        return self.rows[self.rows["headline"]]

    def has_changed(self) -> bool:
        """Return whether a headline number differs.

        Raises DataError if no number that changed has an interval.
        """
        findings = set(self.headline["finding"])
        if UNTESTED in findings and findings <= {UNTESTED, IDENTICAL}:
            # Without an interval the check could never fail: refuse it.
            raise DataError(
                "--fail-on-change: no headline number that changed has an interval"
            )
        return DIFFERS in findings


def compare(out_a: Path, out_b: Path) -> Comparison:
    """Return two runs side by side; their folders may be the same.

    Raises DataError for a folder without a run, a cell missing or broken, or no number
    in common.
    """
    first = read_manifest(out_a)
    second = first if out_a.resolve() == out_b.resolve() else read_manifest(out_b)
    runs = [(out_a, first), (out_b, second)]
    if first is second:
        runs = runs[:1]
    elif first["identity"]["sha256"] == second["identity"]["sha256"]:
        # A run's draws depend on its seed and its list of groups: use the same draws.
        groups = sorted({*first["groups"], *second["groups"]})
        seed = first["identity"]["seed"]
        runs = [(out, _redrawn(run, groups, seed)) for out, run in runs]
    numbers = [_numbers(out, manifest) for out, manifest in runs]
    in_a, in_b = numbers[0], numbers[-1]
    shared = [number for number in in_a if number in in_b]
    if not shared:
        has_a, has_b = (
            short_list([*entry_families(run["cells"])]) for run in (first, second)
        )
        raise DataError(
            f"{out_a} and {out_b} share no number: A has {has_a}, B has {has_b};"
            " compare runs with a common mechanism, level and consumer"
        )
    rows = _rows(
        {number: (in_a[number], in_b[number]) for number in shared}, first, second
    )
    own = {
        address: in_a[address]
        for address in shared
        if not address.world and not address.policy
    }
    return Comparison(
        a=about(out_a, first),
        b=about(out_b, second),
        changed=changed(first, second),
        only=only_in(first, second),
        only_numbers=(len(in_a) - len(shared), len(in_b) - len(shared)),
        rows=rows,
        lead=_lead(rows, own, first["cells"]),
        verdicts=verdicts(out_a, out_b),
    )


def _redrawn(manifest: Manifest, groups: Sequence[str], seed: int) -> dict[str, Any]:
    """Return a manifest with other groups and another seed for its draws."""
    identity = {**manifest["identity"], "seed": seed}
    return {**manifest, "groups": groups, "identity": identity}


def _numbers(out: Path, manifest: Manifest) -> dict[Address, Estimate]:
    """Return every number of a run: of scenes at all horizons, linkage, whole walks."""
    numbers = {
        **scene_numbers(out, manifest).estimates,
        **linkage_estimates(linkage_outcomes(out, manifest)),
        **return_numbers(out, manifest).estimates,
    }
    walked_through = [*patrol_numbers(out, manifest), *track_numbers(out, manifest)]
    numbers |= {number.address: number.estimate for number in walked_through}
    for horizon_s in horizons_in(manifest["cells"]):
        world = World(horizon_s=horizon_s)
        ahead = scene_numbers(out, manifest, world=world).estimates
        numbers |= {
            replace(key, world=world): estimate for key, estimate in ahead.items()
        }
    return numbers


def run_difference(
    a: Estimate, b: Estimate, *, paired: bool, metric: str
) -> Difference:
    """Return B - A with its 95 % interval and a two-sided p-value.

    `paired` tells whether row k of both replicates is the same draw of people. If so,
    the interval is that of the replicates' differences. If not, or if an estimate has
    no spread (a share of exactly 0 or 1), both intervals are combined as of independent
    estimates (Newcombe 1998; Zou and Donner 2008). The p-value is Student's, with one
    degree of freedom less than the smaller number of clusters: replicates alone give
    none below 0.002, and Holm needs smaller p-values.
    With fewer than two clusters, or
    without an interval of either, there is neither interval nor p-value. Numbers of
    people who come back have intervals of a jackknife, and no replicates.
    """
    value, n_clusters = b.value - a.value, min(a.n, b.n)
    if n_clusters <= 1 or math.isnan(value):
        return Difference(value)
    if a.replicates.size == b.replicates.size == 0:
        return _independent_difference(a, b)
    n_rows = min(a.replicates.size, b.replicates.size)
    drawn_a, drawn_b = (run.replicates[:n_rows].astype(np.float64) for run in (a, b))
    drawn: Floats = drawn_b - drawn_a
    if np.isnan(drawn).all():
        return Difference(value)
    has_spread = all(np.nanmin(rows) < np.nanmax(rows) for rows in (drawn_a, drawn_b))
    if not (paired and has_spread):
        return _independent_difference(a, b)
    low, high = percentile_interval(drawn)
    if METRICS[metric].is_biased:
        low, high = 2.0 * value - high, 2.0 * value - low
    error = float(np.nanstd(drawn, ddof=1))
    return _tested_difference(value, low, high, error=error, n_clusters=n_clusters)


def _independent_difference(a: Estimate, b: Estimate) -> Difference:
    """Return B - A of independent estimates, from their two intervals."""
    value = b.value - a.value
    low = value - math.hypot(b.value - b.ci_low, a.ci_high - a.value)
    high = value + math.hypot(b.ci_high - b.value, a.value - a.ci_low)
    # The standard error on the side of no difference counts.
    half = value - low if value > 0.0 else high - value
    error = half / float(ndtri(0.5 + CONFIDENCE / 2.0))
    return _tested_difference(value, low, high, error=error, n_clusters=min(a.n, b.n))


def _tested_difference(
    value: float, low: float, high: float, *, error: float, n_clusters: int
) -> Difference:
    """Return a difference with its interval and Student's p-value."""
    if math.isnan(error):
        return Difference(value)
    if value == 0.0:
        return Difference(value, low, high, 0.0, 1.0)
    ratio = value / error if error > 0.0 else math.copysign(math.inf, value)
    p_value = float(2.0 * stdtr(n_clusters - 1, -abs(ratio)))
    return Difference(value, low, high, ratio, p_value)


def counts(rows: pd.DataFrame) -> dict[str, int]:
    """Return the number of rows with each finding."""
    findings = [*rows["finding"]]
    return {
        name: findings.count(name) for name in (IDENTICAL, DIFFERS, BETWEEN, UNTESTED)
    }


def _rows(
    pairs: Mapping[Address, tuple[Estimate, Estimate]],
    first: Manifest,
    second: Manifest,
) -> pd.DataFrame:
    """Return a row for each pair, tested by Holm in either family, the surest first."""
    readers = {(key.consumer, key.policy) for key in pairs}
    paired_by = {
        (consumer, policy): pairing(first, second, consumer=consumer, policy=policy)
        for consumer, policy in readers
    }
    # Plain rank 1 depends on how many candidates there are.
    same_size = {
        key.measured(RANK1)
        for key, (a, b) in pairs.items()
        if key.metric == CHANCE and a.value == b.value
    }
    rows = []
    for key, (a, b) in pairs.items():
        if math.isnan(a.value) and math.isnan(b.value):
            continue
        how_paired = paired_by[key.consumer, key.policy]
        metric, paired = METRICS[key.metric], how_paired != NONE
        same = a.value == b.value and (
            not paired or np.array_equal(a.replicates, b.replicates, equal_nan=True)
        )
        if metric.name == RANK1 and key not in same_size:
            # Galleries of two sizes do not compare.
            change = Difference(math.nan)
        elif same and paired:
            change = Difference(0.0, 0.0, 0.0, 0.0, 1.0)
        else:
            change = run_difference(a, b, paired=paired, metric=metric.name)
        rows.append(
            {
                **key.to_columns(),
                "headline": _is_headline(key),
                "a": a.value,
                "b": b.value,
                **change._asdict(),
                "unit": metric.summary_unit,
                "n": min(a.n, b.n),
                "pairing": how_paired,
                "finding": IDENTICAL if same else UNTESTED,
                "world": key.world.text,
                "policy": key.policy,
            }
        )
    table = pd.DataFrame(rows, columns=COLUMNS)
    table["headline"] = table["headline"].astype(bool)
    table["p_holm"] = table.groupby("headline")["p_value"].transform(
        lambda family: holm(family.to_numpy(dtype=np.float64))
    )
    tested = (table["finding"] != IDENTICAL) & table["p_holm"].notna()
    differs = np.where(table["p_holm"] <= SIGNIFICANCE, DIFFERS, BETWEEN)
    table["finding"] = table["finding"].where(~tested, differs)
    # Where p-values are too small to be distinguished, the larger t is the surer.
    order = pd.DataFrame({"p": table["p_value"], "t": -table["t"].abs()})
    return table.loc[order.sort_values(["p", "t"], kind="stable").index].reset_index(
        drop=True
    )


def _is_headline(key: Address) -> bool:
    """Whether a number is in the headline: none of a policy or of tracks.

    At further horizons only future misses are.
    """
    if key.policy:
        return False
    if key.world:
        return key.metric == MISSED_FUTURE
    # A control tells nothing about an adversary.
    return METRICS[key.metric].is_headline and not key.control


def _lead(
    rows: pd.DataFrame, estimates: EstimatesByAddress, cells: Sequence[Entry]
) -> pd.DataFrame:
    """Return the leading rows, at the levels of the smoke preset, or the first."""
    best = strongest_by_task(estimates, entry_families(cells))
    known = dict.fromkeys(
        key.measure for key, number in estimates.items() if np.isfinite(number.value)
    )
    missed = [measure for measure in known if measure.metric == MISSED_RATE][:1]
    measures = [*missed]
    if "" in best:
        measures.append(best[""].measured(PLR))
    for linker in [best[task] for task in best if task][:1]:
        among_100 = linker.measured(RANK1_AMONG_100)
        measures.append(among_100 if among_100 in known else linker.measured(RANK1))
    levels = _lead_levels({key.mechanism_level for key in estimates}, cells)
    # After the misses at the run's own horizon, the future misses at further horizons.
    ahead = [world for world in map(parse_world, rows["world"].unique()) if world]
    robots = [measure.measured(MISSED_FUTURE) for measure in missed]
    wanted = [
        *(measure.at(*where) for measure in missed for where in levels),
        *(
            replace(robot.at(*where), world=world)
            for world in ahead
            for robot in robots
            for where in levels
        ),
        *(
            measure.at(*where)
            for measure in measures[len(missed) :]
            for where in levels
        ),
    ]
    numbers = [parse_row(row) for row in row_dicts(rows)]
    index_by_number = dict(zip(numbers, rows.index, strict=True))
    lead = rows.loc[
        [index_by_number[number] for number in wanted if number in index_by_number]
    ]
    return lead[(lead["metric"] != RANK1) | lead["difference"].notna()]


def _lead_levels(
    known: Collection[MechanismLevel], cells: Sequence[Entry]
) -> list[MechanismLevel]:
    """Return the levels of the smoke preset that a run has, else its first levels."""
    where_by_spec = {
        cell.spec: cell.address.mechanism_level
        for cell in cells
        if cell.address.mechanism_level in known
    }
    smoke = [
        where_by_spec[spec]
        for spec in PRESETS["smoke"].mechanisms
        if spec in where_by_spec
    ]
    return smoke or list(dict.fromkeys(where_by_spec.values()))[:_MOST_LEVELS]


def short_list(names: Sequence[str]) -> str:
    """Return the first few names, and the count of the others."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def verdicts(out_a: Path, out_b: Path) -> dict[str, Any] | None:
    """Return the decisions that changed; None unless both runs have a verdict."""
    runs = out_a, out_b
    if not all((out / VERDICT).is_file() for out in runs):
        return None
    a, b = (_decisions(load_verdict(out)) for out in runs)
    shared = [name for name in a if name in b]
    return {
        "in_both": len(shared),
        "only_a": names_beside(a, b),
        "only_b": names_beside(b, a),
        "changed": [
            {"id": name, "a": a[name], "b": b[name]}
            for name in shared
            if a[name] != b[name]
        ],
    }


def _decisions(verdict: Mapping[str, Any]) -> dict[str, str]:
    """Return the decision on each item of a verdict, and on people who come back."""
    decisions = {item["id"]: item["decision"] for item in verdict["items"]}
    if verdict.get("returns"):
        decisions["returns"] = verdict["returns"]["decision"]
    return decisions
