"""Pooled answers of several runs: questions, each a number with its interval.

Runs of one recording and law under several seeds attack the same people: their numbers
are averaged first. The interval of the mean does not shrink as it would with further
people, and widens with the differences between seeds. Recordings are pooled only if
`FEWEST` or more of them are real.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtri, stdtrit

from evaluation.estimates.families import ADDING_RULES, FID, RAW, entry_families
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.linkability import linkage_outcomes
from evaluation.estimates.metrics import (
    CHANCE,
    MISSED_FUTURE,
    MISSED_RATE,
    PLR,
    RANK1,
    RANK1_AMONG_100,
)
from evaluation.estimates.seeds import by_intervals
from evaluation.estimates.strongest import strongest_by_task
from evaluation.estimates.summary import linkage_estimates, scene_numbers
from evaluation.estimates.sweeps import FUTURE, Sweeps
from evaluation.plan.address import AS_SHARED, Address, MechanismLevel
from evaluation.plan.world import World
from evaluation.store.entries import horizons_in
from isac_track.config import StageSettings
from isac_track.intervals import CONFIDENCE, LEAST_CLUSTERS, Estimate, difference

FEWEST: Final = 5  # Real recordings: fewer do not show how much recordings differ.
POOLED, FURTHER = "pooled", "further"
"""Names in the column of recordings: all that are real, and the next, predicted."""
LINKED_IN: Final = "rerelease"
_ENDS: Final = ("value", "ci_low", "ci_high")
COLUMNS = [
    "question",
    "recording",
    "adding",
    "law",
    "seed",
    *_ENDS,
    "n",
    "tau2",
    "settings",
    "distance_m",
]
"""The last two: settings that are not the default, and the people's median distance to
the station, m, by which recordings and geometries compare."""
_LAW: Final = "sensing.law"  # It has a column of its own.
# Horizon at which robots are judged by the conflicts that are still to come.
HORIZON_S: Final = 3.0
OWN_GALLERY: Final = "_own_gallery"
"""End of a question about too few people for a gallery of 100: it compares with no
other recording."""
QUESTIONS: Final = {  # In the order of the first screen; all in fractions.
    "robot_loses": (
        "What the robot loses: missed conflicts with FID noise, eta 1, less raw"
    ),
    "robot_loses_future": (
        f"What the robot loses {HORIZON_S:g} s ahead: missed future conflicts, FID"
        " less raw"
    ),
    "left_after_attack": (
        "What an attack wins back: PLR after it less PLR as shared, FID noise"
    ),
    "people_linked": (
        "Can people be linked: rank 1 among 100 in a re-release, less chance"
    ),
    f"people_linked{OWN_GALLERY}": (
        "Small recordings: rank 1 among their people, less chance"
    ),
    "descriptors_tell": (
        "Do the descriptors tell: how far rank 1 among 100 differs at equal PLR"
    ),
    f"descriptors_tell{OWN_GALLERY}": (
        "Small recordings: how far their rank 1 differs at equal PLR"
    ),
    "fid_against_fixed": (
        "FID against fixed noise at equal missed conflicts: PLR after attack"
    ),
    "fid_against_fixed_future": (
        f"The same at equal missed future conflicts, {HORIZON_S:g} s ahead: PLR after"
        " attack"
    ),
}
_TAIL: Final = 0.5 + CONFIDENCE / 2.0
_NORMAL: Final = float(ndtri(_TAIL))
_WIDTH: Final = 2.0 * _NORMAL  # Of an interval, in standard errors.
_STRICT: Final = 1.0  # Threshold of FID in the questions.
_CLAIM: Final = {"section": "claim", "criterion": "missed", "of": "after-attack"}
_VERDICT_ITEMS: Final[dict[str, dict[str, Any]]] = {
    "descriptors_tell": {
        "section": "validity",
        "descriptor": PLR,
        "task": LINKED_IN,
    },
    "fid_against_fixed": {**_CLAIM, "descriptor": PLR},
    "fid_against_fixed_future": {
        **_CLAIM,
        "descriptor": PLR,
        "criterion": FUTURE,
        "horizon_s": HORIZON_S,
    },
}


def run_answers(
    out: Path, manifest: Mapping[str, Any], verdict: Mapping[str, Any], *, law: str
) -> list[dict[str, Any]]:
    """Return a finished run's answers to the questions by adding rule; as `COLUMNS`.

    Differences are paired: both numbers are of the same people in the same draws. A
    question without an answer has no row. Raises DataError if a cell cannot be read.
    """
    families = entry_families(manifest["cells"])
    outcomes = linkage_outcomes(out, manifest, drawn=(RANK1, RANK1_AMONG_100))
    scenes = scene_numbers(out, manifest).estimates
    sweeps = Sweeps({**scenes, **linkage_estimates(outcomes)}, families)
    best = strongest_by_task(sweeps.estimates, families)
    ahead = _ahead(out, manifest)
    items = verdict.get("items", [])
    about = {
        "recording": manifest["dataset"]["name"],
        "law": law,
        "seed": str(manifest["identity"]["seed"]),
        "tau2": math.nan,
        "settings": settings_text(manifest["settings"]["stages"]),
        "distance_m": manifest.get("geometry", {}).get("distance_m", math.nan),
    }
    rows = []
    for adding in ADDING_RULES:
        strict = MechanismLevel(sweeps.named(FID, adding=adding), _STRICT)
        answers = {
            **_at(sweeps.estimates, strict, best),
            **_lost_ahead(ahead, strict),
            **_from_verdict(items, adding=adding),
        }
        for question in QUESTIONS:
            answer = answers.get(question)
            if answer is None or not math.isfinite(answer.value):
                continue
            # As everywhere, fewer clusters have no interval.
            has_ends = answer.n_effective >= LEAST_CLUSTERS
            row = {
                **about,
                "question": question,
                "adding": adding,
                "value": answer.value,
                "ci_low": answer.ci_low if has_ends else math.nan,
                "ci_high": answer.ci_high if has_ends else math.nan,
                "n": answer.n,
            }
            rows.append({name: row[name] for name in COLUMNS})
    return rows


def _from_verdict(
    items: Sequence[Mapping[str, Any]], *, adding: str
) -> dict[str, Estimate]:
    """Return the answers that are items of the verdict, under an adding rule."""
    answers = {}
    for question, wanted in _VERDICT_ITEMS.items():
        for item in items:
            # Only the items of FID name no mechanism.
            is_fid = not item.get("mechanism", "")
            if is_fid and {**wanted, "adding": adding}.items() <= item.items():
                value, low, high = (
                    math.nan if item[name] is None else float(item[name])
                    for name in ("effect", "ci_low", "ci_high")
                )
                own = OWN_GALLERY if item.get("metric") == RANK1 else ""
                n = int(item["n"] or 0)
                answers[question + own] = Estimate(value, low, high, n=n)
    return answers


def _at(
    numbers: EstimatesByAddress, where: MechanismLevel, best: Mapping[str, Address]
) -> dict[str, Estimate]:
    """Return the answers that are read at one level."""
    pairs = {}
    missed = next((key.measure for key in numbers if key.metric == MISSED_RATE), None)
    if missed:
        pairs["robot_loses"] = missed.at(*where), missed.at(RAW, None)
    if "" in best:
        attacked, shared = (reader.at(*where, PLR) for reader in (best[""], AS_SHARED))
        pairs["left_after_attack"] = attacked, shared
    answers = {
        name: difference(numbers[a], numbers[b])
        for name, (a, b) in pairs.items()
        if {a, b} <= numbers.keys()
    }
    if LINKED_IN in best:
        linker, names = best[LINKED_IN], (RANK1_AMONG_100, RANK1, CHANCE)
        among_100, own, chance = (
            numbers.get(linker.at(*where, name)) for name in names
        )
        if among_100 and math.isfinite(among_100.value):
            answers["people_linked"] = _less(among_100, 0.01)
        elif own and chance and math.isfinite(own.value):
            answers[f"people_linked{OWN_GALLERY}"] = _less(own, chance.value)
    return answers


def _ahead(out: Path, manifest: Mapping[str, Any]) -> EstimatesByAddress:
    """Return the estimates of robots at `HORIZON_S`; empty without that horizon."""
    if HORIZON_S not in horizons_in(manifest["cells"]):
        return {}
    world = World(horizon_s=HORIZON_S)
    return scene_numbers(out, manifest, world=world).estimates


def _lost_ahead(
    ahead: EstimatesByAddress, where: MechanismLevel
) -> dict[str, Estimate]:
    """Return how many more future conflicts the first robot misses than under raw."""
    missed = next((key.measure for key in ahead if key.metric == MISSED_FUTURE), None)
    if missed is None or not {missed.at(*where), missed.at(RAW, None)} <= ahead.keys():
        return {}
    lost = difference(ahead[missed.at(*where)], ahead[missed.at(RAW, None)])
    return {"robot_loses_future": lost}


def settings_text(stages: Mapping[str, Any]) -> str:
    """Return the settings that are not the default, as typed, without the error law."""
    usual = StageSettings().flat()
    changed = {
        name: value for name, value in stages.items() if usual.get(name) != value
    }
    return " ".join(
        f"{name}={value}"
        for name, value in changed.items()
        if name != _LAW and not name.startswith(("patrol.", "tracking."))
    )


def _less(estimate: Estimate, known: float) -> Estimate:
    """Return an estimate less a number that has no error."""
    value, low, high = estimate.value, estimate.ci_low, estimate.ci_high
    return Estimate(
        value - known,
        low - known,
        high - known,
        n=estimate.n,
        effective=estimate.effective,
    )


class Pooled(NamedTuple):
    """Several recordings, answered together."""

    value: float
    ci_low: float
    ci_high: float
    predicted_low: float
    predicted_high: float  # Ends of the interval of a further recording.
    tau2: float  # Variance between recordings.


def pool(values: Sequence[float], errors: Sequence[float]) -> Pooled:
    """Return the random-effects mean of K recordings with standard errors, (K,) each.

    The variance between them is after Paule and Mandel (1982), the interval after
    Hartung and Knapp (2001), and never narrower than that of a fixed effect. Raises
    ValueError for fewer than three, or an error that is not positive.
    """
    # Import here: the module is heavy, and few studies pool.
    from statsmodels.stats.meta_analysis import (  # noqa: PLC0415 - heavy
        combine_effects,
    )

    effects = np.array(values, dtype=float)
    variances = np.array(errors, dtype=float) ** 2
    k = effects.size
    if k < 3 or not (variances > 0.0).all():  # noqa: PLR2004 - a prediction has k - 2 degrees
        raise ValueError(
            f"pooling takes three recordings with errors above 0, got {errors}"
        )
    fitted = combine_effects(effects, variances, method_re="iterated", use_t=True)
    tau2 = max(0.0, float(fitted.tau2))
    weights = 1.0 / (variances + tau2)
    value = float(effects @ weights / weights.sum())
    error = math.sqrt(
        float(weights @ (effects - value) ** 2) / ((k - 1) * float(weights.sum()))
    )
    fixed = 1.0 / math.sqrt(float((1.0 / variances).sum()))
    half = max(float(stdtrit(k - 1, _TAIL)) * error, _NORMAL * fixed)
    spread = math.sqrt(tau2 + max(error, fixed) ** 2)
    ahead = max(half, float(stdtrit(k - 2, _TAIL)) * spread)
    return Pooled(value, value - half, value + half, value - ahead, value + ahead, tau2)


@dataclass(frozen=True, slots=True)
class Answered:
    """A question under an adding rule and law: all recordings, and a pooled answer."""

    question: str
    adding: str
    law: str
    rows: Sequence[Mapping[str, Any]]  # Averages over seeds, simulated recordings last.
    real: int  # Number of rows of real people.
    pooled: Pooled | None
    n_pooled: int  # Real recordings that have an interval, and so are pooled.

    @property
    def sentence(self) -> str:
        """Signs, least and largest of the real recordings."""
        real = list(self.rows)[: self.real]
        if not real:
            return "No real recording has enough people for this."
        if self.question.endswith(OWN_GALLERY):
            return "Neither compared nor pooled: the galleries differ in size."
        values = [row["value"] for row in real]
        has_sign = self.question != "descriptors_tell"  # A spread is 0 where PLR tells.
        is_sure = has_sign and all(
            row["ci_low"] > 0 or row["ci_high"] < 0 for row in real
        )
        if len(real) == 1:
            sure = "; significant at 5 %" if is_sure else ""
            return (
                f"One real recording, {real[0]['recording']}: {100 * values[0]:+.1f}"
                f" points{sure}."
            )
        same = max(
            sum(value > 0 for value in values), sum(value < 0 for value in values)
        )
        text = f"Same sign in {same} of {len(real)} real recordings"
        if not has_sign:
            text = "0 where PLR tells, and never below"
        elif is_sure and same == len(real):
            text += "; each is significant at 5 %"
        least, most = (pick(real, key=itemgetter("value")) for pick in (min, max))
        text += f"; least {100 * least['value']:+.1f} points ({least['recording']})"
        text += f", largest {100 * most['value']:+.1f} ({most['recording']})"
        if self.pooled:
            value, *ends = (100 * number for number in self.pooled[:5])
            low, high, further_low, further_high = ends
            without = self.real - self.n_pooled
            over = f" without {without} that have no interval" if without else ""
            text += (
                f"; pooled{over} {value:+.1f} [{low:.1f}, {high:.1f}], of a further recording"
                f" [{further_low:.1f}, {further_high:.1f}]"
            )
        return f"{text}."


def answered(
    rows: Sequence[Mapping[str, Any]], *, simulated: frozenset[str]
) -> list[Answered]:
    """Return the answers: seeds averaged, then real recordings pooled.

    The interval of a mean over seeds is `seeds.by_intervals`, with the variance between
    them. `rows` are those of `run_answers`, of all runs; `simulated` recordings are
    never pooled.
    """
    order = [*QUESTIONS]
    identity = itemgetter("question", "law", "adding")
    in_order = sorted(
        rows, key=lambda row: (order.index(row["question"]), *identity(row))
    )
    answers = []
    for (question, law, adding), group in groupby(in_order, key=identity):
        seeds: dict[str, list[Mapping[str, Any]]] = {}
        for row in group:
            seeds.setdefault(row["recording"], []).append(row)
        recordings = sorted(seeds, key=simulated.__contains__)
        averages = [_mean_of_seeds(seeds[name]) for name in recordings]
        real = [row for row in averages if row["recording"] not in simulated]
        # A recording of too few people has no interval, and so no weight.
        weighed = [row for row in real if row["ci_high"] > row["ci_low"]]
        pooled = None
        if len(weighed) >= FEWEST and not question.endswith(OWN_GALLERY):
            values = [row["value"] for row in weighed]
            errors = [(row["ci_high"] - row["ci_low"]) / _WIDTH for row in weighed]
            pooled = pool(values, errors)
        answers.append(
            Answered(
                question,
                adding,
                law,
                averages,
                len(real),
                pooled,
                n_pooled=len(weighed),
            )
        )
    return answers


def _mean_of_seeds(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the row of a recording: the mean over its seeds, with its interval."""
    runs = [
        Estimate(row["value"], row["ci_low"], row["ci_high"], row["n"]) for row in rows
    ]
    mean = by_intervals(runs)
    numbers = {name: getattr(mean, name) for name in (*_ENDS, "n")}
    return {**rows[0], "seed": "mean", **numbers}


def to_frame(
    rows: Sequence[Mapping[str, Any]], answers: Sequence[Answered]
) -> pd.DataFrame:
    """Return `study.csv`: every run, averages over seeds, and pooled: `COLUMNS`."""
    table = list(rows)
    for answer in answers:
        table += answer.rows
        if answer.pooled is not None:
            value, *ends, tau2 = answer.pooled
            for name, (low, high) in ((POOLED, ends[:2]), (FURTHER, ends[2:])):
                numbers = {"value": value, "ci_low": low, "ci_high": high, "tau2": tau2}
                about = {
                    "recording": name,
                    "n": answer.n_pooled,
                    "distance_m": math.nan,
                }
                table.append({**answer.rows[0], **about, **numbers})
    return pd.DataFrame(table, columns=COLUMNS)
