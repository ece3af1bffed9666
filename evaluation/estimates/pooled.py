"""One answer of several runs: the five questions, each a number with its interval, and pooled.

Runs of one recording and law under several seeds attack the same people: their numbers
are averaged first. The interval of the mean does not shrink as if the people were
others, and widens by how much the seeds differ. Recordings are pooled only if `FEWEST`
or more of them are real.
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

from evaluation.estimates.families import ADDING_RULES, FID, RAW, families_in
from evaluation.estimates.keys import AS_SHARED, Found, Source, Where, horizons_in
from evaluation.estimates.linkability import cards
from evaluation.estimates.matching import FUTURE, Sweeps
from evaluation.estimates.metrics import (
    EXPOSURE,
    MISSED_FUTURE,
    MISSED_RATE,
    SUCCESS,
    SUCCESS_OF_100,
)
from evaluation.estimates.seeds import by_intervals
from evaluation.estimates.strongest import strongest
from evaluation.estimates.summary import estimates, linkage_estimates
from evaluation.plan.constants import horizon_world
from isac_track.config import StageSettings
from isac_track.intervals import CONFIDENCE, LEAST_CLUSTERS, Estimate, difference

FEWEST: Final = 5  # Real recordings: of fewer, nobody knows how much they differ.
POOLED, FURTHER = "pooled", "further"
"""In the column of recordings: all real ones, and where a further one is expected."""
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
"""The last two: settings that are not the usual ones, and the people's median distance to the
station, m, by which recordings and geometries compare."""
_LAW: Final = "sensing.law"  # It has a column of its own.
# At which robots are asked about conflicts that are still to come.
HORIZON_S: Final = 3.0
OWN_GALLERY: Final = "_own_gallery"
"""Ends a question about people too few for a gallery of 100: the measure of no other recording."""
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
_STRICT: Final = 1.0  # Threshold of FID at which is asked.
_CLAIM: Final = {"section": "claim", "criterion": "missed", "of": "after-attack"}
_OF_VERDICT: Final[dict[str, dict[str, Any]]] = {
    "descriptors_tell": {
        "section": "validity",
        "descriptor": EXPOSURE,
        "task": LINKED_IN,
    },
    "fid_against_fixed": {**_CLAIM, "descriptor": EXPOSURE},
    "fid_against_fixed_future": {
        **_CLAIM,
        "descriptor": EXPOSURE,
        "criterion": FUTURE,
        "horizon_s": HORIZON_S,
    },
}


def answers_of(
    out: Path, manifest: Mapping[str, Any], verdict: Mapping[str, Any], *, law: str
) -> list[dict[str, Any]]:
    """Return what a finished run says to each question under each adding rule; as `COLUMNS`.

    Differences are paired: both numbers are of the same people, drawn alike. What the
    run does not tell has no row. Raises DataError if a cell cannot be read.
    """
    known = families_in(manifest["cells"])
    read = cards(out, manifest, drawn=(SUCCESS, SUCCESS_OF_100))
    sweeps = Sweeps({**estimates(out, manifest)[0], **linkage_estimates(read)}, known)
    best = strongest(sweeps.found, known)
    recording, seed = manifest["dataset"]["name"], str(manifest["identity"]["seed"])
    ahead = _ahead(out, manifest)
    settings = settings_text(manifest["settings"]["stages"])
    distance_m = manifest.get("geometry", {}).get("distance_m", math.nan)
    rows = []
    for adding in ADDING_RULES:
        strict = sweeps.named(FID, adding=adding), _STRICT
        told = _at(sweeps.found, strict, best) | _lost_ahead(ahead, strict)
        for question, wanted in _OF_VERDICT.items():
            for item in verdict.get("items", []):
                # What else is held against fixed noise says which mechanism; FID's
                # items do not.
                is_other = item.get("mechanism", "")
                if (
                    not is_other
                    and {**wanted, "adding": adding}.items() <= item.items()
                ):
                    ends = (item[name] for name in ("effect", *_ENDS[1:]))
                    value, low, high = (
                        math.nan if one is None else float(one) for one in ends
                    )
                    own = OWN_GALLERY if item.get("metric") == SUCCESS else ""
                    told[question + own] = Estimate(
                        value, low, high, n=int(item["n"] or 0)
                    )
        for question in QUESTIONS:
            one = told.get(question)
            if one is not None and math.isfinite(one.value):
                # As everywhere: of fewer there is no interval.
                has_ends = one.n >= LEAST_CLUSTERS
                low, high = (
                    (one.ci_low, one.ci_high) if has_ends else (math.nan, math.nan)
                )
                about = question, recording, adding, law, seed
                row = (
                    *about,
                    one.value,
                    low,
                    high,
                    one.n,
                    math.nan,
                    settings,
                    distance_m,
                )
                rows.append(dict(zip(COLUMNS, row, strict=True)))
    return rows


def _at(found: Found, where: Where, best: Mapping[str, Source]) -> dict[str, Estimate]:
    """Return the answers that are read at one level."""
    pairs = {}
    if missed := next(
        (key.measure for key in found if key.metric == MISSED_RATE), None
    ):
        pairs["robot_loses"] = missed.at(*where), missed.at(RAW, None)
    if "" in best:
        attacked, shared = (
            one.measure(EXPOSURE).at(*where) for one in (best[""], AS_SHARED)
        )
        pairs["left_after_attack"] = attacked, shared
    known = {name: pair for name, pair in pairs.items() if {*pair} <= found.keys()}
    told = {name: difference(found[a], found[b]) for name, (a, b) in known.items()}
    if LINKED_IN in best:
        linker, names = best[LINKED_IN], (SUCCESS_OF_100, SUCCESS, "chance")
        of_100, own, chance = (
            found.get(linker.measure(name).at(*where)) for name in names
        )
        if of_100 and math.isfinite(of_100.value):
            told["people_linked"] = _less(of_100, 0.01)
        elif own and chance and math.isfinite(own.value):
            told[f"people_linked{OWN_GALLERY}"] = _less(own, chance.value)
    return told


def _ahead(out: Path, manifest: Mapping[str, Any]) -> Found:
    """Return the estimates of robots judged at `HORIZON_S`; empty if the run does not judge so."""
    if HORIZON_S not in horizons_in(manifest["cells"]):
        return {}
    return estimates(out, manifest, world=horizon_world(HORIZON_S))[0]


def _lost_ahead(ahead: Found, where: Where) -> dict[str, Estimate]:
    """Return what the first robot loses of the conflicts that are still to come."""
    missed = next((key.measure for key in ahead if key.metric == MISSED_FUTURE), None)
    if missed is None or not {missed.at(*where), missed.at(RAW, None)} <= ahead.keys():
        return {}
    lost = difference(ahead[missed.at(*where)], ahead[missed.at(RAW, None)])
    return {"robot_loses_future": lost}


def settings_text(stages: Mapping[str, Any]) -> str:
    """Return the settings that are not the usual ones, as they are typed; the error law aside."""
    usual = StageSettings().flat()
    changed = {
        name: value for name, value in stages.items() if usual.get(name) != value
    }
    return " ".join(
        f"{name}={value}" for name, value in changed.items() if name != _LAW
    )


def _less(one: Estimate, known: float) -> Estimate:
    """Return an estimate less a number that has no error."""
    return Estimate(one.value - known, one.ci_low - known, one.ci_high - known, n=one.n)


class Pooled(NamedTuple):
    """Several recordings as one."""

    value: float
    ci_low: float
    ci_high: float
    predicted_low: float
    predicted_high: float  # Ends of the interval of a further recording.
    tau2: float  # Variance between recordings.


def pool(values: Sequence[float], errors: Sequence[float]) -> Pooled:
    """Return the random-effects mean of some recordings with their standard errors, (K,) each.

    The variance between them is after Paule and Mandel (1982), the interval after
    Hartung and Knapp (2001), and never narrower than that of a fixed effect. Raises
    ValueError for fewer than three, or an error that is not positive.
    """
    # Heavy, and few studies pool.
    from statsmodels.stats.meta_analysis import (  # noqa: PLC0415 - as said
        combine_effects,
    )

    effects, variances = (
        np.array(values, dtype=float),
        np.array(errors, dtype=float) ** 2,
    )
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
    """A question under one adding rule and law: every recording, and what they say together."""

    question: str
    adding: str
    law: str
    rows: Sequence[Mapping[str, Any]]  # Averages over seeds, simulated recordings last.
    real: int  # So many of them are of real people.
    pooled: Pooled | None

    @property
    def sentence(self) -> str:
        """Signs, least and largest of the real recordings."""
        of = list(self.rows)[: self.real]
        if not of:
            return "No real recording has enough people for this."
        if self.question.endswith(OWN_GALLERY):
            return "Neither compared nor pooled: the galleries differ in size."
        values = [row["value"] for row in of]
        has_sign = self.question != "descriptors_tell"  # A spread is 0 where PLR tells.
        is_sure = has_sign and all(
            row["ci_low"] > 0 or row["ci_high"] < 0 for row in of
        )
        if len(of) == 1:
            sure = "; significant at 5 %" if is_sure else ""
            return (
                f"One real recording, {of[0]['recording']}: {100 * values[0]:+.1f}"
                f" points{sure}."
            )
        same = max(
            sum(value > 0 for value in values), sum(value < 0 for value in values)
        )
        told = f"Same sign in {same} of {len(of)} real recordings"
        if not has_sign:
            told = "0 where PLR tells, and never below"
        elif is_sure and same == len(of):
            told += "; each is significant at 5 %"
        least, most = (pick(of, key=itemgetter("value")) for pick in (min, max))
        told += f"; least {100 * least['value']:+.1f} points ({least['recording']})"
        told += f", largest {100 * most['value']:+.1f} ({most['recording']})"
        if self.pooled:
            text = (
                "; pooled {:+.1f} [{:.1f}, {:.1f}], of a further recording [{:.1f},"
                " {:.1f}]"
            )
            told += text.format(*(100 * one for one in self.pooled[:5]))
        return f"{told}."


def answered(
    rows: Sequence[Mapping[str, Any]], *, simulated: frozenset[str]
) -> list[Answered]:
    """Return each question, adding rule and law: seeds averaged, real recordings pooled.

    The interval of a mean over seeds is `seeds.by_intervals`, with the variance between
    them.

    `rows` are those of `answers_of`, of all runs; `simulated` recordings are never
    pooled.
    """
    found, order = [], [*QUESTIONS]
    by = itemgetter("question", "law", "adding")
    every = sorted(rows, key=lambda row: (order.index(row["question"]), *by(row)))
    for (question, law, adding), of in groupby(every, key=by):
        seeds: dict[str, list[Mapping[str, Any]]] = {}
        for row in of:
            seeds.setdefault(row["recording"], []).append(row)
        in_order = sorted(seeds, key=simulated.__contains__)
        averages = [_mean_of_seeds(seeds[name]) for name in in_order]
        real = [row for row in averages if row["recording"] not in simulated]
        errors = [(row["ci_high"] - row["ci_low"]) / (2.0 * _NORMAL) for row in real]
        is_alike = len(real) >= FEWEST and not question.endswith(OWN_GALLERY)
        able = is_alike and all(one > 0.0 for one in errors)
        pooled = pool([row["value"] for row in real], errors) if able else None
        found.append(Answered(question, adding, law, averages, len(real), pooled))
    return found


def _mean_of_seeds(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the row of a recording: the mean over its seeds, with the interval of that."""
    runs = [
        Estimate(row["value"], row["ci_low"], row["ci_high"], row["n"]) for row in rows
    ]
    mean = by_intervals(runs)
    numbers = {name: getattr(mean, name) for name in (*_ENDS, "n")}
    return {**rows[0], "seed": "mean", **numbers}


def to_frame(rows: Sequence[Mapping[str, Any]], of: Sequence[Answered]) -> pd.DataFrame:
    """Return `study.csv`: every run, averages over seeds, and what is pooled; as `COLUMNS`."""
    every = list(rows)
    for one in of:
        every += one.rows
        if one.pooled is not None:
            value, *ends, tau2 = one.pooled
            for name, (low, high) in ((POOLED, ends[:2]), (FURTHER, ends[2:])):
                numbers = {"value": value, "ci_low": low, "ci_high": high, "tau2": tau2}
                about = {"recording": name, "n": one.real, "distance_m": math.nan}
                every.append({**one.rows[0], **about, **numbers})
    return pd.DataFrame(every, columns=COLUMNS)
