"""One answer of several runs: the five questions, each a number with its interval, and pooled.

Runs of one recording and law under several seeds attack the same people: their numbers are averaged
first, and so are the ends of their intervals, which do not shrink as if the people were others.
Recordings are pooled only if `FEWEST` or more of them are real, by random effects: the variance
between them after Paule and Mandel (1982), the interval after Hartung and Knapp (2001), and never
narrower than that of a fixed effect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtri, stdtrit

from evaluation.analysis.families import ADDING_RULES, RAW, families_in
from evaluation.analysis.keys import AS_SHARED, Measure, Source
from evaluation.analysis.linkability import cards
from evaluation.analysis.metrics import EXPOSURE, MISSED_RATE, SUCCESS, SUCCESS_OF_100
from evaluation.analysis.strongest import strongest
from evaluation.analysis.summary import estimates, linkage_estimates
from isac_track.intervals import CONFIDENCE, LEAST_CLUSTERS, Estimate, difference

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from evaluation.analysis.keys import Key

FEWEST: Final = 5
"""Real recordings below which nothing is pooled: of fewer, nobody knows how much they differ."""
MEAN: Final = "mean"
"""In the column of seeds: the average over them."""
POOLED: Final = "pooled"
LINKED_IN: Final = "rerelease"
COLUMNS = [
    *("question", "recording", "adding", "law", "seed"),
    *("value", "ci_low", "ci_high", "n", "tau2"),
]
QUESTIONS: Final = {
    "robot_loses": "What the robot loses: missed conflicts at fid:1 less those at raw",
    "left_after_attack": "What an attack wins back: PLR at fid:1 after it, less PLR as shared",
    "people_linked": "Can people be linked: rank 1 at fid:1 in a re-release, less chance",
    "descriptors_tell": "Do the descriptors tell: how far linkage differs at equal PLR",
    "fid_against_fixed": "FID against fixed noise at equal missed conflicts: PLR after attack",
}
"""In the order of the first screen; all in fractions."""
_STRICT: Final = 1.0  # Threshold of FID at which is asked.
_OF_VERDICT: Final = {
    "descriptors_tell": {"section": "validity", "descriptor": EXPOSURE, "task": LINKED_IN},
    "fid_against_fixed": {
        "section": "claim",
        "descriptor": EXPOSURE,
        "criterion": "missed",
        "of": "after-attack",
    },
}


def answers_of(
    out: Path, manifest: Mapping[str, Any], verdict: Mapping[str, Any], *, law: str
) -> list[dict[str, Any]]:
    """Return what a finished run says to each question under each adding rule; as `COLUMNS`.

    Differences are paired: both numbers are of the same people, drawn alike. What the run does not
    tell has no row.

    Raises DataError if a cell cannot be read.
    """
    known = families_in(manifest["cells"])
    found = {
        **estimates(out, manifest)[0],
        **linkage_estimates(cards(out, manifest, drawn=(SUCCESS, SUCCESS_OF_100))),
    }
    best = strongest(found, known)

    def enough(one: Estimate) -> bool:
        return one.n >= LEAST_CLUSTERS  # as everywhere: of fewer there is no interval

    rows = []
    for adding in ADDING_RULES:
        strict = next(
            (
                key.where
                for key in found
                if key.level == _STRICT
                and known[key.mechanism].name == "fid"
                and known[key.mechanism].adding == adding
            ),
            None,
        )
        told = {} if strict is None else _at(found, strict, best)
        items = verdict.get("items", [])
        for question, wanted in _OF_VERDICT.items():
            of = {**wanted, "adding": adding}
            for item in items:
                if all(item.get(name) == value for name, value in of.items()):
                    value, low, high = (
                        math.nan if item[one] is None else float(item[one]) for one in _ENDS
                    )
                    told[question] = Estimate(value, low, high, n=int(item["n"] or 0))
        rows += [
            {
                "question": question,
                "recording": manifest["dataset"]["name"],
                "adding": adding,
                "law": law,
                "seed": str(manifest["identity"]["seed"]),
                "value": told[question].value,
                "ci_low": told[question].ci_low if enough(told[question]) else math.nan,
                "ci_high": told[question].ci_high if enough(told[question]) else math.nan,
                "n": told[question].n,
                "tau2": math.nan,
            }
            for question in QUESTIONS
            if question in told and math.isfinite(told[question].value)
        ]
    return rows


_ENDS: Final = ("effect", "ci_low", "ci_high")


def _at(
    found: Mapping[Key, Estimate], where: tuple[str, float | None], best: Mapping[str, Source]
) -> dict[str, Estimate]:
    """Return the answers that are read at one level."""
    told = {}
    robots = [key.consumer for key in found if key.metric == MISSED_RATE]
    if robots and (raw := found.get(Measure(robots[0], MISSED_RATE).at(RAW, None))):
        told["robot_loses"] = difference(found[Measure(robots[0], MISSED_RATE).at(*where)], raw)
    if "" in best:
        both = (found.get(one.measure(EXPOSURE).at(*where)) for one in (best[""], AS_SHARED))
        attacked, shared = both
        if attacked and shared:
            told["left_after_attack"] = difference(attacked, shared)
    if LINKED_IN in best:
        for metric in (SUCCESS, SUCCESS_OF_100):  # the latter, where galleries are large enough
            one = found.get(best[LINKED_IN].measure(metric).at(*where))
            chance = found.get(best[LINKED_IN].measure("chance").at(*where))
            if one and chance and math.isfinite(one.value):
                guess = 0.01 if metric == SUCCESS_OF_100 else chance.value
                value, low, high = (end - guess for end in (one.value, one.ci_low, one.ci_high))
                told["people_linked"] = Estimate(value, low, high, n=one.n)
    return told


class Pooled(NamedTuple):
    """Several recordings as one."""

    value: float
    ci_low: float
    ci_high: float
    predicted_low: float
    predicted_high: float
    """Ends of the interval of a further recording."""
    tau2: float
    """Variance between recordings."""


def pool(values: Sequence[float], errors: Sequence[float]) -> Pooled:
    """Return the random-effects mean of some recordings with their standard errors, (K,) each.

    Raises ValueError for fewer than three, or an error that is not positive.
    """
    # Heavy, and few studies pool.
    from statsmodels.stats.meta_analysis import combine_effects  # noqa: PLC0415 - as said

    effects, variances = np.array(values, dtype=float), np.array(errors, dtype=float) ** 2
    k = effects.size
    if k < 3 or not (variances > 0.0).all():  # noqa: PLR2004 - a prediction has k - 2 degrees
        raise ValueError(f"pooling takes three recordings with errors above 0, got {errors}")
    fitted = combine_effects(effects, variances, method_re="iterated", use_t=True)
    tau2 = max(0.0, float(fitted.tau2))
    weights = 1.0 / (variances + tau2)
    value = float(effects @ weights / weights.sum())
    error = math.sqrt(float(weights @ (effects - value) ** 2) / ((k - 1) * float(weights.sum())))
    tail = 0.5 + CONFIDENCE / 2.0
    fixed = float(ndtri(tail)) / math.sqrt(float((1.0 / variances).sum()))
    half = max(float(stdtrit(k - 1, tail)) * error, fixed)
    spread = math.sqrt(tau2 + max(error, fixed / float(ndtri(tail))) ** 2)
    ahead = max(half, float(stdtrit(k - 2, tail)) * spread)
    return Pooled(value, value - half, value + half, value - ahead, value + ahead, tau2)


@dataclass(frozen=True, slots=True)
class Answered:
    """A question under one adding rule and law: every recording, and what they say together."""

    question: str
    adding: str
    law: str
    rows: Sequence[Mapping[str, Any]]
    """Averages over seeds, simulated recordings last."""
    real: int  # So many of them are of real people.
    pooled: Pooled | None

    @property
    def sentence(self) -> str:
        """Signs, least and largest of the real recordings."""
        of = list(self.rows)[: self.real]
        if not of:
            return "No real recording tells."
        k, values = len(of), [one["value"] for one in of]
        same = max(sum(one > 0 for one in values), sum(one < 0 for one in values))
        least, most = min(of, key=_value), max(of, key=_value)
        told = f"same sign in {same} of {k}"
        if self.question == "descriptors_tell":  # a spread has no sign
            told, same = "0 where PLR tells, and never below", 0
        sure = [one["ci_low"] > 0 or one["ci_high"] < 0 for one in of]
        if same == k and all(sure):
            told += f"; in all {k}, each significant at 5 %"
        told += f"; least {100 * least['value']:+.1f} points ({least['recording']})"
        return f"{told}, largest {100 * most['value']:+.1f} ({most['recording']})."


def _value(row: Mapping[str, Any]) -> float:
    return float(row["value"])


def answered(rows: Sequence[Mapping[str, Any]], *, simulated: frozenset[str]) -> list[Answered]:
    """Return each question, adding rule and law: seeds averaged, real recordings pooled.

    `rows` are those of `answers_of`, of all runs; `simulated` recordings are never pooled.
    """
    order = {name: place for place, name in enumerate(QUESTIONS)}

    def group(row: Mapping[str, Any]) -> tuple[int, str, str]:
        return order[row["question"]], row["law"], row["adding"]

    found = []
    for (place, law, adding), of in groupby(sorted(rows, key=group), key=group):
        mine = list(of)
        averages = []
        for name in dict.fromkeys(row["recording"] for row in mine):
            seeds = [row for row in mine if row["recording"] == name]
            ends = ("value", "ci_low", "ci_high")
            mean = {one: float(np.mean([row[one] for row in seeds])) for one in ends}
            n = min(row["n"] for row in seeds)
            averages.append({**seeds[0], **mean, "seed": MEAN, "n": n})
        averages.sort(key=lambda row: row["recording"] in simulated)
        real = [row for row in averages if row["recording"] not in simulated]
        half = float(ndtri(0.5 + CONFIDENCE / 2.0))
        errors = [(row["ci_high"] - row["ci_low"]) / (2.0 * half) for row in real]
        able = len(real) >= FEWEST and all(one > 0.0 for one in errors)
        pooled = pool([row["value"] for row in real], errors) if able else None
        question = list(QUESTIONS)[place]
        found.append(Answered(question, adding, law, averages, len(real), pooled))
    return found


def to_frame(rows: Sequence[Mapping[str, Any]], of: Sequence[Answered]) -> pd.DataFrame:
    """Return `study.csv`: every run, averages over seeds, and what is pooled; as `COLUMNS`."""
    every = list(rows)
    for one in of:
        every += one.rows
        if one.pooled is not None:
            about = dict(one.rows[0]) | {"recording": POOLED, "n": one.real}
            kept = ("value", "ci_low", "ci_high", "tau2")
            every.append(about | {name: getattr(one.pooled, name) for name in kept})
    return pd.DataFrame(every, columns=COLUMNS)
