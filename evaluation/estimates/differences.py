"""What differs between two runs: settings, code, and every number that both have.

Nothing is computed anew: the estimates and their replicates come from the finished
cells.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtri, stdtr

from evaluation.estimates.families import families_in
from evaluation.estimates.keys import Found, Key, horizons_in, keys_of
from evaluation.estimates.linkability import cards
from evaluation.estimates.metrics import (
    EXPOSURE,
    METRICS,
    MISSED_FUTURE,
    MISSED_RATE,
    SUCCESS,
    SUCCESS_OF_100,
)
from evaluation.estimates.strongest import strongest
from evaluation.estimates.summary import estimates, linkage_estimates
from evaluation.plan.constants import horizon_world
from evaluation.plan.presets import PRESETS
from evaluation.store.files import made_of
from evaluation.store.manifest import read_manifest
from isac_track.errors import DataError
from isac_track.intervals import CONFIDENCE, Estimate, percentile_interval
from isac_track.linkability.significance import holm
from isac_track.types import Floats

Manifest = Mapping[str, Any]
Apart = dict[str, tuple[Any, Any]]

IDENTICAL, DIFFERS, BETWEEN, UNTESTED = (
    "identical",
    "differs",
    "between",
    "untested",
)  # Findings.
SIGNIFICANCE: Final = 0.05  # Of a family, after Holm.
DRAWS, PEOPLE, NONE = "people and draws", "people", "none"  # Pairing of a row.
_VERDICT = "verdict.json"  # Compares over galleries of any size.
_MOST_NAMED, _MOST_LEVELS = 4, 5
_ABOUT_DATA = frozenset(
    {"dataset", "sha256", "format", "fps", "unit", "tracks", "tracks_used"}
)
_ABOUT_CODE = ("code version", "isac_track", "git_commit", "python", "machine")
_DECIDED = ("conflict.decision", "conflict.probability_threshold")
_KEEP_DRAWS = ("dataset", "privacy.", "sensing.", *_DECIDED)
_CHANGE_DRAWS = ("sensing.n_paths", "sensing.law")
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
]
"""`world` is as in `dataset` behind the name: a further horizon; empty for the run's own."""


class _Number(NamedTuple):
    """A number of a run: at which horizon (empty: the run's own), and what it is about."""

    world: str
    key: Key


class Difference(NamedTuple):
    """B - A of one number."""

    difference: float
    ci_low: float = math.nan
    ci_high: float = math.nan
    t: float = (
        math.nan
    )  # Difference over its standard error, which has n - 1 degrees of freedom.
    p_value: float = math.nan  # Two-sided; NaN where there is no interval.


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """Two runs side by side."""

    a: dict[str, Any]  # About run A: `out`, `dataset`, `scenes`, `seed`, `preset`.
    b: dict[str, Any]
    changed: dict[str, Apart]
    """Under data, settings and code: what to its value in A and in B; None where it is unknown."""
    only: Apart  # By axis: what only A has, and what only B has.
    only_numbers: tuple[int, int]  # Numbers that only A has, and only B.
    rows: pd.DataFrame
    """A row for each number that both have, the surest difference first; columns `COLUMNS`."""
    lead: pd.DataFrame
    """Its rows of missed conflicts, at further horizons of those to come, of PLR after A's
    strongest attack and of rank 1, at a few levels."""
    verdicts: (
        dict[str, Any] | None
    )  # Decisions that changed; None unless both runs have a verdict.

    @property
    def headline(self) -> pd.DataFrame:
        """The rows that are tested as one family; all the others are another."""
        return self.rows[self.rows["headline"]]

    def has_changed(self) -> bool:
        """Return whether a headline number differs.

        Raises DataError if nothing could tell: no number that changed has an interval.
        """
        findings = set(self.headline["finding"])
        if UNTESTED in findings and findings <= {UNTESTED, IDENTICAL}:
            # A gate that nothing can shut is none.
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
        # A run's draws depend on its seed and on its list of groups: both take one.
        same = {"groups": sorted({*first["groups"], *second["groups"]})}
        seed = {"seed": first["identity"]["seed"]}
        runs = [
            (out, one | same | {"identity": one["identity"] | seed})
            for out, one in runs
        ]
    numbers = [_numbers(out, manifest) for out, manifest in runs]
    in_a, in_b = numbers[0], numbers[-1]
    both = [number for number in in_a if number in in_b]
    if not both:
        has_a, has_b = (
            short_list([*families_in(one["cells"])]) for one in (first, second)
        )
        raise DataError(
            f"{out_a} and {out_b} share no number: A has {has_a}, B has {has_b};"
            " compare runs with a common mechanism, level and consumer"
        )
    rows = _rows(
        {number: (in_a[number], in_b[number]) for number in both}, first, second
    )
    own = {number.key: in_a[number] for number in both if not number.world}
    return Comparison(
        a=about(out_a, first),
        b=about(out_b, second),
        changed=changed(first, second),
        only=only_in(first, second),
        only_numbers=(len(in_a) - len(both), len(in_b) - len(both)),
        rows=rows,
        lead=_lead(rows, own, first["cells"]),
        verdicts=verdicts(out_a, out_b),
    )


def _numbers(out: Path, manifest: Manifest) -> dict[_Number, Estimate]:
    """Return every number of a run, those of robots at further horizons among them."""
    own = {**estimates(out, manifest)[0], **linkage_estimates(cards(out, manifest))}
    numbers = {_Number("", key): estimate for key, estimate in own.items()}
    for horizon_s in horizons_in(manifest["cells"]):
        world = horizon_world(horizon_s)
        ahead = estimates(out, manifest, world=world)[0]
        numbers |= {_Number(world, key): estimate for key, estimate in ahead.items()}
    return numbers


def difference(a: Estimate, b: Estimate, *, paired: bool, metric: str) -> Difference:
    """Return B - A with its 95 % interval and a two-sided p-value.

    `paired` says whether row k of both replicates is the same draw of people. Then the
    interval is that of their differences; where one of them has no spread (a share of
    exactly 0 or 1), or nothing is paired, both intervals are combined as of independent
    estimates (Newcombe 1998; Zou and Donner 2008). The p-value is of Student's t with a
    degree of freedom less than the smaller number of clusters: replicates alone tell
    none below 0.002, and Holm needs smaller ones. Of less than two clusters, or without
    replicates, there is neither.
    """
    value, n_clusters = b.value - a.value, min(a.n, b.n)
    n_rows = min(a.replicates.size, b.replicates.size)
    both = [one.replicates[:n_rows].astype(np.float64) for one in (a, b)]
    drawn: Floats = both[1] - both[0]
    if n_clusters <= 1 or math.isnan(value) or np.isnan(drawn).all():
        return Difference(value)
    if paired and all(np.nanmin(one) < np.nanmax(one) for one in both):
        low, high = percentile_interval(drawn)
        if METRICS[metric].is_biased:
            low, high = 2.0 * value - high, 2.0 * value - low
        error = float(np.nanstd(drawn, ddof=1))
    else:
        low = value - math.hypot(b.value - b.ci_low, a.ci_high - a.value)
        high = value + math.hypot(b.ci_high - b.value, a.value - a.ci_low)
        # What counts is the side of no difference.
        to_nothing = value - low if value > 0.0 else high - value
        error = to_nothing / float(ndtri(0.5 + CONFIDENCE / 2.0))
    if math.isnan(error):
        return Difference(value)
    if value == 0.0:
        return Difference(value, low, high, 0.0, 1.0)
    ratio = value / error if error > 0.0 else math.copysign(math.inf, value)
    p_value = float(2.0 * stdtr(n_clusters - 1, -abs(ratio)))
    return Difference(value, low, high, ratio, p_value)


def counts(rows: pd.DataFrame) -> dict[str, int]:
    """Return how many rows there are of each finding."""
    found = [*rows["finding"]]
    return {name: found.count(name) for name in (IDENTICAL, DIFFERS, BETWEEN, UNTESTED)}


def _rows(
    pairs: Mapping[_Number, tuple[Estimate, Estimate]],
    first: Manifest,
    second: Manifest,
) -> pd.DataFrame:
    """Return a row for each pair with what Holm says of either family, the surest first."""
    consumers = {number.key.consumer for number in pairs}
    paired_by = {name: pairing(first, second, consumer=name) for name in consumers}
    # Plain rank 1 depends on how many candidates there are.
    same_size = {
        number.key._replace(metric=SUCCESS)
        for number, (a, b) in pairs.items()
        if number.key.metric == "chance" and a.value == b.value
    }
    rows = []
    for (world, key), (a, b) in pairs.items():
        if math.isnan(a.value) and math.isnan(b.value):
            continue
        metric, paired = METRICS[key.metric], paired_by[key.consumer] != NONE
        same = a.value == b.value and (
            not paired or np.array_equal(a.replicates, b.replicates, equal_nan=True)
        )
        if metric.name == SUCCESS and key not in same_size:
            found = Difference(math.nan)  # galleries of two sizes do not compare
        elif same and paired:
            found = Difference(0.0, 0.0, 0.0, 0.0, 1.0)
        else:
            found = difference(a, b, paired=paired, metric=metric.name)
        rows.append(
            {
                "mechanism": key.mechanism,
                "level": math.nan if key.level is None else key.level,
                **key.measure._asdict(),
                "headline": _is_headline(world, key),
                "a": a.value,
                "b": b.value,
                **found._asdict(),
                "unit": metric.summary_unit,
                "n": min(a.n, b.n),
                "pairing": paired_by[key.consumer],
                "finding": IDENTICAL if same else UNTESTED,
                "world": world,
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
    # Of p-values too small to tell apart, the larger t is the surer.
    order = pd.DataFrame({"p": table["p_value"], "t": -table["t"].abs()})
    return table.loc[order.sort_values(["p", "t"], kind="stable").index].reset_index(
        drop=True
    )


def _is_headline(world: str, key: Key) -> bool:
    """Whether a number is of the headline: at further horizons conflicts still to come alone."""
    if world:
        return key.metric == MISSED_FUTURE
    # A control says nothing of an adversary.
    return METRICS[key.metric].is_headline and "/control-" not in key.consumer


def _lead(rows: pd.DataFrame, found: Found, cells: Sequence[Manifest]) -> pd.DataFrame:
    """Return the rows that tell most, at the levels of the smoke preset, else at the first ones."""
    best = strongest(found, families_in(cells))
    known = dict.fromkeys(
        key.measure for key, one in found.items() if np.isfinite(one.value)
    )
    wanted = [measure for measure in known if measure.metric == MISSED_RATE][:1]
    wanted += [best[""].measure(EXPOSURE)] if "" in best else []
    for linker in [best[task] for task in best if task][:1]:
        of_100 = linker.measure(SUCCESS_OF_100)
        wanted.append(of_100 if of_100 in known else linker.measure(SUCCESS))
    there = {key.where for key in found}
    every = ((one["spec"], (one["mechanism"], one["level"])) for one in cells)
    at = {spec: where for spec, where in every if where in there}
    levels = [at[spec] for spec in PRESETS["smoke"].mechanisms if spec in at]
    levels = levels or list(dict.fromkeys(at.values()))[:_MOST_LEVELS]
    place = dict(
        zip(zip(rows["world"], keys_of(rows), strict=True), rows.index, strict=True)
    )
    asked = [("", measure.at(*where)) for measure in wanted for where in levels]
    # Behind the misses of the run's own horizon those of conflicts that are still to
    # come.
    worlds = [world for world in dict.fromkeys(rows["world"]) if world]
    missed = [measure for measure in wanted if measure.metric == MISSED_RATE]
    robots = [measure._replace(metric=MISSED_FUTURE) for measure in missed]
    ahead = [
        (world, robot.at(*at)) for world in worlds for robot in robots for at in levels
    ]
    behind = len(missed) * len(levels)
    asked[behind:behind] = ahead
    lead = rows.loc[[place[number] for number in asked if number in place]]
    return lead[(lead["metric"] != SUCCESS) | lead["difference"].notna()]


def short_list(names: Sequence[str]) -> str:
    """Return the first few names, and how many more there are."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def pairing(first: Manifest, second: Manifest, *, consumer: str) -> str:
    """Return how a consumer's numbers in two runs are paired.

    Replicates of linkage were drawn with the cell: nobody can draw the same people
    later.
    """
    moved = _unequal(first["identity"], second["identity"])
    task, is_linked, _ = consumer.partition("/")
    is_apart, aside = "sha256" in moved, ("linkage.", "crowd")
    if is_linked:
        known = [one["linkage"]["tasks"].get(task) for one in (first, second)]
        same_people = known[0] is not None and known[0] == known[1]
        of_others = any(name.startswith(("sha256", "seed", *aside)) for name in moved)
        is_apart = of_others or not same_people or first["groups"] != second["groups"]
        aside = ("scenes", "conflict.")
    if is_apart:
        return NONE
    # Whether the same people's random numbers are the same, too.
    keep = (*_KEEP_DRAWS, *aside)
    other = any(
        name.startswith(_CHANGE_DRAWS) or not name.startswith(keep) for name in moved
    )
    return PEOPLE if other else DRAWS


def _unequal(a: Manifest, b: Manifest) -> Apart:
    both = {name: (a.get(name), b.get(name)) for name in (*a, *b)}
    return {name: pair for name, pair in both.items() if pair[0] != pair[1]}


def about(out: Path, manifest: Manifest) -> dict[str, Any]:
    """Return what a run is."""
    wanted = ("scenes", "scenes_utility", "seed")
    return {
        "out": str(out),
        "dataset": manifest["dataset"]["name"],
        "people": len(manifest["groups"]),
        **{name: of for name, of in manifest["identity"].items() if name in wanted},
        "preset": manifest["settings"]["preset"],
    }


def changed(first: Manifest, second: Manifest) -> dict[str, Apart]:
    """Return what differs under data, settings and code."""
    described, code = [], []
    for one in (first, second):
        tracks = {name: one["dataset"][name] for name in ("tracks", "tracks_used")}
        described.append(
            one["identity"] | tracks | {"preset": one["settings"]["preset"]}
        )
        by = {"code version": one["code"], **one["environment"]}
        code.append({name: by[name] for name in _ABOUT_CODE} | by["libraries"])
    settings = _unequal(*described)
    data = {name: settings.pop(name) for name in [*settings] if name in _ABOUT_DATA}
    return {"data": data, "settings": settings, "code": _unequal(*code)}


def only_in(first: Manifest, second: Manifest) -> Apart:
    """Return by axis what only the first of the runs has, and what only the second."""
    a, b = _axes(first), _axes(second)
    apart = {axis: (_beside(a[axis], b[axis]), _beside(b[axis], a[axis])) for axis in a}
    return {axis: both for axis, both in apart.items() if any(both)}


def _beside(names: Iterable[str], others: Iterable[str]) -> list[str]:
    return [name for name in dict.fromkeys(names) if name not in others]


def _axes(manifest: Manifest) -> dict[str, list[str]]:
    """Return what a run has cells of, in its order."""
    cells = manifest["cells"]

    def of(*kinds: str) -> list[str]:
        return [
            cell["consumer"] for kind in kinds for cell in cells if cell["kind"] == kind
        ]

    return {
        "mechanisms": [cell["spec"] for cell in cells],
        "predictors": of("predictor"),
        "attacks": of("attack") + [name.partition("/")[2] for name in of("linkage")],
        "tasks": [name.partition("/")[0] for name in of("linkage", "control")],
    }


def verdicts(out_a: Path, out_b: Path) -> dict[str, Any] | None:
    """Return the decisions that changed; None unless both runs have a verdict."""
    runs = out_a, out_b
    if not all((out / _VERDICT).is_file() for out in runs):
        return None
    a, b = (
        {one["id"]: one["decision"] for one in verdict_of(out)["items"]} for out in runs
    )
    both = [name for name in a if name in b]
    return {
        "in_both": len(both),
        "only_a": _beside(a, b),
        "only_b": _beside(b, a),
        "changed": [
            {"id": one, "a": a[one], "b": b[one]} for one in both if a[one] != b[one]
        ],
    }


def verdict_of(out: Path) -> dict[str, Any]:
    """Return the verdict of a run folder; each of its items has an id and a decision.

    Raises DataError if there is none or it cannot be read.
    """
    said: dict[str, Any] = made_of(out, _VERDICT)
    try:
        list(map(itemgetter("id", "decision"), said["items"]))
    except (KeyError, TypeError):
        raise DataError(
            f"{out / _VERDICT} cannot be read: it is no verdict of a run"
        ) from None
    return said
