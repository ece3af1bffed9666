"""The paper's own numbers and claims, and how ours compare."""

from collections.abc import Iterator, Mapping
from itertools import chain, pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import ADDING_RULES, AT_RAW, FID, FIXED, RAW
from evaluation.estimates.interpolation import MIN_DEFINED
from evaluation.estimates.metrics import (
    METRICS,
    MISSED_FUTURE,
    MISSED_RATE,
    PAPER_DESCRIPTORS,
)
from evaluation.estimates.sweeps import FUTURE, MISSED, Sweeps
from evaluation.plan.address import Address, MechanismLevel, parse_dataset
from evaluation.plan.presets import SHARED
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate, difference

DATASET = "students03"  # The recording that the paper used.
PREDICTOR = "least_squares"


class Published(NamedTuple):
    """A number of the paper."""

    mechanism: str
    level: float | None
    metric: str
    value: float


PUBLISHED: tuple[Published, ...] = tuple(
    Published(mechanism, level, metric, value)
    for mechanism, level, numbers in (
        (
            "raw",
            None,
            {"missed_conflict_rate": 0.105, "plr": 0.526, "ael": 2.93, "mel": 5.12},
        ),
        ("fid", 1.0, {"missed_conflict_rate": 0.305, "plr": 0.184, "mel": 0.28}),
        ("fid", 1000.0, {"missed_conflict_rate": 0.152, "plr": 0.240, "mel": 0.35}),
        ("fixed", 0.7, {"missed_conflict_rate": 0.276}),
        ("fixed", 1.0, {"missed_conflict_rate": 0.371, "plr": 0.150, "mel": 0.25}),
    )
    for metric, value in numbers.items()
)
"""From section Simulation Results (500 scenes)."""
FITTED = (("raw", None, "plr"), ("raw", None, "mel"), ("fid", 1000.0, "plr"))
"""Numbers to which the free constants are fitted, under linear adding. The others were
not fitted, but seen: the error law, the adding rule and other readings were chosen
because they fit them."""
# Scenes behind a missed-conflict rate of the paper: half of its 500.
CONFLICTS = 250
ETAS = (1.0, 1000.0)  # Ends of the paper's sweep.
# The paper's missed-conflict rate under FID, 'approximately', at an eta not given.
FID_MISSED_RATE = 0.27

PAPER_COLUMNS = [
    "mechanism",
    "level",
    "metric",
    "paper",
    "ours",
    "ci_low",
    "ci_high",
    "within",
]
CLAIM_COLUMNS = [
    "adding",
    "claim",
    "answer",
    "effect",
    "ci_low",
    "ci_high",
    "unit",
    "evidence",
]

_NORMAL_975 = 1.959964
CLOSE_TO_RAW = 0.04  # Margin: the tolerance on a missed-conflict rate, set beforehand.


def tolerance(mechanism: str, metric: str, published: float) -> float:
    """Return the goal for the difference from the paper, in the metric's unit.

    It holds for 5,000 scenes.
    """
    if metric == MISSED_RATE:
        return 0.04
    if metric == "plr":
        return 0.015
    if mechanism != "raw":
        return 0.05
    return (0.3 if metric == "ael" else 0.15) * published


def monte_carlo_error(metric: str, published: float) -> float:
    """Return the standard error of a missed rate of the paper; else NaN."""
    if metric != MISSED_RATE:
        return np.nan
    return float(np.sqrt(published * (1.0 - published) / CONFLICTS))


def differs(row: Mapping[Any, Any]) -> bool:
    """Tell whether our number differs from the paper's at 5 %, by the errors of both.

    `row` is a row of `paper_table`, tested by itself: nothing is corrected for the
    other rows.
    """
    paper_error = np.nan_to_num(monte_carlo_error(row["metric"], row["paper"]))
    our_error = (row["ci_high"] - row["ci_low"]) / (2.0 * _NORMAL_975)
    error = np.hypot(our_error, paper_error)
    return bool(abs(row["ours"] - row["paper"]) > _NORMAL_975 * error)


def is_fitted(row: Mapping[Any, Any]) -> bool:
    """Tell whether the constants are fitted to a row of `paper_table`."""
    level = None if np.isnan(row["level"]) else row["level"]
    return (row["mechanism"], level, row["metric"]) in FITTED


def paper_table(sweeps: Sweeps, *, dataset: str) -> pd.DataFrame:
    """Return the paper's numbers beside ours, for both adding rules.

    `within` tells whether the paper's value lies in our interval; it is empty on data
    that the paper did not use.
    """
    rows = []
    for adding in ADDING_RULES:
        for family, level, metric, published in PUBLISHED:
            name = RAW if family == RAW else sweeps.named(family, adding=adding)
            ours = sweeps.estimates.get(_measure(metric).at(name, level))
            # Raw has no adding rule: it has one row.
            if ours is None or (family == RAW and adding != ADDING_RULES[0]):
                continue
            within = (
                bool(ours.ci_low <= published <= ours.ci_high)
                if dataset == DATASET
                else None
            )
            rows.append(
                {
                    "mechanism": name,
                    "level": np.nan if level is None else level,
                    "metric": metric,
                    "paper": published,
                    "ours": ours.value,
                    "ci_low": ours.ci_low,
                    "ci_high": ours.ci_high,
                    "within": within,
                }
            )
    return pd.DataFrame(rows, columns=PAPER_COLUMNS)


class _Claim(NamedTuple):
    """A claim and our answer to it: columns of `CLAIM_COLUMNS`."""

    claim: str
    answer: str  # `holds`, `does not hold`, `between` or `not testable`.
    effect: float
    ci_low: float
    ci_high: float
    unit: str
    evidence: str


def claims(
    sweeps: Sweeps, matched: pd.DataFrame, *, dataset: str, history: Mapping[str, float]
) -> pd.DataFrame:
    """Return the paper's claims: `holds`, `does not hold`, `between` or `not testable`.

    The rules, set beforehand, with 95 % intervals of paired differences; fewer than 20
    effective clusters decide nothing (not testable):

    - *close to raw*: the rise of the missed-conflict rate over raw at 0.1 and 0.2 m of
      fixed error; holds if its interval lies below 4 points, does not if it lies above.
    - *monotone in eta*, 1 to 1000: holds if the ends differ in the claimed direction
      and no step between neighbours goes the other way beyond its interval; does not
      hold if a step or the ends do.
    - *FID is better at every matched rate*: FID minus fixed where the missed-conflict
      rate of both is above that of raw by the same amount, for all amounts that at
      least 97.5 % of the replicates reach. Holds if every pointwise interval lies below
      zero, does not hold if one lies above. The same is asked for conflicts that are
      still to come, at the run's own horizon and at longer, where false alarms
      are held at raw's rate; the paper has neither.
    - *FID raises the rate to approximately 27 %*, at an eta that is not given: the
      nearest of ours; does not hold if from 1 to 1000 all intervals lie on one side; of
      the paper's recording only.
    - *history*: 366 points within 4, at 0.083 to 0.084 s; of the paper's recording
      only.
    """
    # Attacks are no part of the claims, and may be known for fewer people.
    plain = (key for key in sweeps.estimates if not (key.adversary or key.task))
    n_clusters = min((sweeps.estimates[key].n_effective for key in plain), default=0.0)
    rows: list[dict[str, Any]] = []
    for adding in ADDING_RULES:
        fixed, fid = (sweeps.named(family, adding=adding) for family in (FIXED, FID))
        better = chain.from_iterable(
            _better_at_every_rate(at_rate, n=n_clusters, rate=rate)
            for rate, at_rate in _by_rate(matched, adding=adding, fid=fid)
        )
        raised = _raised_by_fid(sweeps, fid) if dataset == DATASET else ()
        parts = (
            _close_to_raw(sweeps, fixed),
            raised,
            _monotone_in_eta(sweeps, fid),
            better,
        )
        rows += [
            {"adding": adding, **claim._asdict()}
            for claim in chain.from_iterable(parts)
        ]
    if dataset == DATASET:
        rows.append({"adding": "", **_history(history)._asdict()})
    table = pd.DataFrame(rows, columns=CLAIM_COLUMNS)
    # An effect that is known and not testable is one of too few people.
    is_few = (table["answer"] == "not testable") & table["effect"].notna()
    table.loc[is_few, "evidence"] = (
        f"fewer than {FEWEST_EFFECTIVE} people; " + table["evidence"]
    )
    return table


def _history(history: Mapping[str, float]) -> _Claim:
    points, interval_s = history["points"], history["interval_s"]
    # Within 4 of 366, and 0.083 to 0.084 s: stated with the rules.
    is_so = abs(points - 366) <= 4 and 0.083 <= round(interval_s, 4) <= 0.084  # noqa: PLR2004 - as said above
    return _Claim(
        claim="history of about 366 points at 0.083 s",
        answer="holds" if is_so else "does not hold",
        effect=points,
        ci_low=np.nan,
        ci_high=np.nan,
        unit="points",
        evidence=f"{points:.1f} points at {interval_s:.4f} s",
    )


def _measure(metric: str) -> Address:
    return Address(plugin=PREDICTOR if metric == MISSED_RATE else SHARED, metric=metric)


def _close_to_raw(sweeps: Sweeps, fixed: str) -> Iterator[_Claim]:
    missed = _measure(MISSED_RATE)
    for level in (0.1, 0.2):
        raw, ours = (
            sweeps.estimates.get(missed.at(*where))
            for where in (AT_RAW, MechanismLevel(fixed, level))
        )
        if raw is None or ours is None:
            continue
        rise = difference(ours, raw)
        is_close, is_far = rise.ci_high < CLOSE_TO_RAW, rise.ci_low > CLOSE_TO_RAW
        yield _Claim(
            claim=f"fixed error {level:g} m: missed-conflict rate close to raw",
            answer=_answer(
                holds=is_close,
                fails=is_far,
                n=min(ours.n_effective, raw.n_effective),
            ),
            effect=rise.value,
            ci_low=rise.ci_low,
            ci_high=rise.ci_high,
            unit=METRICS[MISSED_RATE].summary_unit,
            evidence=f"rise over raw, margin {CLOSE_TO_RAW:g}",
        )


def _swept(sweeps: Sweeps, fid: str, metric: str) -> dict[float, Estimate]:
    """Return a metric over the paper's range of eta, by level."""
    keys = (_measure(metric).at(fid, level) for level in sweeps.levels(fid))
    return {
        key.level or 0.0: sweeps.estimates[key]
        for key in keys
        if key in sweeps.estimates and ETAS[0] <= (key.level or 0.0) <= ETAS[1]
    }


def _raised_by_fid(sweeps: Sweeps, fid: str) -> Iterator[_Claim]:
    by_eta = _swept(sweeps, fid, MISSED_RATE)
    if not by_eta:
        return
    published, rates = FID_MISSED_RATE, by_eta.values()
    is_above = all(rate.ci_low > published for rate in rates)
    is_apart = is_above or all(rate.ci_high < published for rate in rates)
    nearest, rate = min(by_eta.items(), key=lambda item: abs(item[1].value - published))
    shown = [
        f"{100.0 * by_eta[level].value:.1f} % at eta = {level:g}" for level in by_eta
    ]
    yield _Claim(
        claim=(
            "FID raises the missed-conflict rate to approximately"
            f" {100.0 * published:g} %"
        ),
        answer=_answer(holds=not is_apart, fails=is_apart, n=rate.n_effective),
        effect=rate.value - published,
        ci_low=rate.ci_low - published,
        ci_high=rate.ci_high - published,
        unit=METRICS[MISSED_RATE].summary_unit,
        evidence=(
            f"ours less that, nearest at eta = {nearest:g}; {shown[0]}, {shown[-1]}"
        ),
    )


def _monotone_in_eta(sweeps: Sweeps, fid: str) -> Iterator[_Claim]:
    for metric, sign in ((MISSED_RATE, -1.0), ("plr", 1.0), ("mel", 1.0)):
        by_eta = _swept(sweeps, fid, metric)
        points = [*by_eta.values()]
        if not {*ETAS} <= by_eta.keys():
            continue
        # Turned so that the claimed change is a rise.
        change, *steps = (
            difference(after, before) if sign > 0 else difference(before, after)
            for before, after in ((points[0], points[-1]), *pairwise(points))
        )
        against = sum(step.value < 0 for step in steps)
        wrong = sum(step.ci_high < 0 for step in steps)
        is_sure = change.ci_low > 0 and not wrong
        is_wrong = change.ci_high < 0 or wrong > 0
        low, high = sorted((sign * change.ci_low, sign * change.ci_high))
        word = "falls" if sign < 0 else "rises"
        evidence = (
            f"change between the ends; of {len(steps)} steps {against} go the other"
            " way, "
        )
        n = min(point.n_effective for point in points)
        yield _Claim(
            claim=f"eta 1 to 1000: {METRICS[metric].text} {word} monotonically",
            answer=_answer(holds=is_sure, fails=is_wrong, n=n),
            effect=points[-1].value - points[0].value,
            ci_low=low,
            ci_high=high,
            unit=METRICS[metric].summary_unit,
            evidence=f"{evidence}{wrong} beyond their interval",
        )


def _by_rate(
    matched: pd.DataFrame, *, adding: str, fid: str
) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield each rate for matching FID with fixed noise as shared, and its rows."""
    wanted = {
        "adding": adding,
        "mechanism": fid,
        "consumer": SHARED,
        "predictor": PREDICTOR,
    }
    is_wanted = (matched[[*wanted]] == [*wanted.values()]).all(axis=1)
    rows = matched[is_wanted & matched["metric"].isin(PAPER_DESCRIPTORS)]
    yield METRICS[MISSED_RATE].text, rows[rows["criterion"] == MISSED]
    to_come = rows[rows["criterion"] == FUTURE]
    for dataset, at_horizon in to_come.groupby("dataset", sort=False):
        horizon_s = parse_dataset(str(dataset)).world.horizon_s
        ahead = "" if horizon_s is None else f" {horizon_s:g} s ahead"
        yield f"{METRICS[MISSED_FUTURE].text}{ahead}", at_horizon


def _better_at_every_rate(
    matched: pd.DataFrame, *, n: float, rate: str
) -> Iterator[_Claim]:
    for name, rows in matched.groupby("metric", sort=False):
        metric = METRICS[str(name)]
        claim = f"at every matched {rate}: FID has lower {metric.text}"
        reached = rows[rows["defined"] >= MIN_DEFINED]
        left_out = len(rows) - len(reached)
        if reached.empty:
            yield _Claim(
                claim=claim,
                answer="not testable",
                effect=np.nan,
                ci_low=np.nan,
                ci_high=np.nan,
                unit=metric.summary_unit,
                evidence=f"none of {left_out} rates is reached by enough replicates",
            )
            continue
        better = int((reached["ci_high"] < 0).sum())
        worse = int((reached["ci_low"] > 0).sum())
        # Show the rate that speaks most against the claim.
        end = "ci_low" if worse else "ci_high"
        worst = reached.iloc[int(reached[end].to_numpy().argmax())]
        evidence = (
            "FID minus fixed where it speaks most against, at a rate of"
            f" {worst['missed_conflict_rate']:.3f}; of {len(reached)} rates {better}"
            f" better, {worse} worse beyond the interval; {left_out} more are not"
            " reached by enough replicates"
        )
        yield _Claim(
            claim=claim,
            answer=_answer(holds=better == len(reached), fails=worse > 0, n=n),
            effect=float(worst["difference"]),
            ci_low=float(worst["ci_low"]),
            ci_high=float(worst["ci_high"]),
            unit=metric.summary_unit,
            evidence=evidence,
        )


def _answer(*, holds: bool, fails: bool, n: float) -> str:
    """Return the answer of `n` effective clusters."""
    if n < FEWEST_EFFECTIVE:
        return "not testable"
    if fails:
        return "does not hold"
    return "holds" if holds else "between"
