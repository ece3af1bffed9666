"""Figures over the level: what is shared and missed, and what attacks leave."""

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import attrgetter

import numpy as np
import pandas as pd

from evaluation.analysis.families import FID, FIXED, RAW
from evaluation.analysis.keys import AS_SHARED, ORACLE, is_attack
from evaluation.analysis.metrics import EXPOSURE, METRICS, MISSED_RATE
from evaluation.analysis.paper import DATASET, PREDICTOR, PUBLISHED
from evaluation.analysis.strongest import most_knowing
from evaluation.experiment.presets import IDENTITY, SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting.charts import LOOKS, Axis, Curve, Look, curves_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.result_tables import after_attack, sources_of

_FILES = {FID: "fid_threshold", FIXED: "fixed_error"}
_MOST_CHARACTERS = 80  # Of a file's name.
_SHARED_LOOKS = {EXPOSURE: Look(5), "ael": Look(4, hollow=True), "mel": Look(5, hollow=True)}
_PAPER_LOOK = Look(LOOKS - 1)
_PANELS = {
    "missed conflicts (%)": (MISSED_RATE,),
    "PLR, shared (%)": (EXPOSURE,),
    "exposure, shared (s)": ("ael", "mel"),
}


def figures(run: picked.Results) -> Iterator[Figure]:
    """Yield that after attack, and one of each swept mechanism."""
    yield from _attacked(run)
    names: list[str] = []
    for swept, of in groupby(picked.schemes(run.ours), key=attrgetter("name")):
        known = list(of)
        plain = f"sweep-{re.sub(r'[^A-Za-z0-9=.-]+', '_', swept)[:_MOST_CHARACTERS]}"
        name = _FILES.get(swept, plain)
        names.append(f"{name}-{known[0].place}" if name in names else name)
        yield from _sweep(run, known, name=names[-1])


def curve(
    rows: pd.DataFrame, scheme: picked.Scheme, *, label: str, look: Look, metric: str
) -> list[Curve]:
    """Return the curve of a metric over the levels of a scheme, named by its ends; none without."""
    shown, of = METRICS[metric], scheme.of(rows)
    of = of[np.isfinite(of["value"])]
    if of.empty:
        return []
    y = shown.scale * of[picked.ENDS].to_numpy(dtype=np.float64).T
    ends = [
        f"{value:.{shown.digits}f} {shown.unit} at {scheme.at(level)}"
        for value, level in zip(y[0], of["level"], strict=True)
    ]
    told = " to ".join(dict.fromkeys([ends[0], ends[-1]]))
    return [Curve(look, f"{label}: {told}", of["level"].to_numpy(dtype=np.float64), y)]


def alone(rows: pd.DataFrame, mechanism: str, metric: str) -> list[float]:
    """Return a metric where a mechanism has no level, as it is shown."""
    found = rows.loc[rows["mechanism"] == mechanism, "value"]
    return [METRICS[metric].scale * one for one in found if np.isfinite(one)]


def _sweep(run: picked.Results, known: Sequence[picked.Scheme], *, name: str) -> Iterator[Figure]:
    """Yield the figure of a swept mechanism: a column for each adding rule, a row for each axis."""
    ours = run.ours[~is_attack(run.ours)]
    predictors = ours.loc[ours["metric"] == MISSED_RATE, "consumer"].unique()[: LOOKS - 2]
    looks = {(one, MISSED_RATE): Look(place) for place, one in enumerate(predictors)}
    looks |= {(SHARED, metric): look for metric, look in _SHARED_LOOKS.items()}
    panels, key = [], dict[str, Look]()
    for label, metrics in _PANELS.items():
        for scheme in known:
            curves, across, marked = list[Curve](), list[tuple[str, float]](), []
            for (consumer, metric), look in looks.items():
                if metric not in metrics:
                    continue
                rows = ours[(ours["consumer"] == consumer) & (ours["metric"] == metric)]
                head = METRICS[metric].head if consumer == SHARED else consumer
                found = curve(rows, scheme, label=head, look=look, metric=metric)
                curves += found
                across += [(f"k{look.place}", one) for one in alone(rows, RAW, metric)]
                key |= {head: look} if found else {}
                if run.dataset == DATASET and consumer in (SHARED, PREDICTOR):
                    marked += _papers(metric, scheme)
            if curves:
                x, y = Axis(scheme.label, scheme.log), Axis(label, label.endswith("(s)"))
                chart = curves_chart(curves, x=x, y=y, across=across, marked=marked)
                panels.append((f"{scheme.title}, {scheme.rule_text}", chart))
                key |= {"paper (raw at the edge)": _PAPER_LOOK} if marked else {}
    title = f"Missed conflicts, PLR and exposure over the level: {known[0].title}"
    said = "Dashed: raw."
    yield Figure(name, "figures", title, panels, len(known), key, said)


def _papers(metric: str, scheme: picked.Scheme) -> list[tuple[Look, float, float, str]]:
    """Return the paper's numbers; raw, which has no level, goes to the edge next to it."""
    if scheme.name not in _FILES or "linear" not in scheme.rules:
        return []
    edge = np.inf if scheme.log else 0.0
    shown = METRICS[metric]
    return [
        (
            _PAPER_LOOK,
            edge if at is None else at,
            value * shown.scale,
            f"paper: {shown.head} {value * shown.scale:.4g} {shown.unit} at "
            + ("raw" if at is None else scheme.at(at)),
        )
        for mechanism, at, of, value in PUBLISHED
        if of == metric and mechanism in (RAW, scheme.name)
    ]


def _attacked(run: picked.Results) -> Iterator[Figure]:
    """Yield PLR over the level, as shared and after each attack; none without attacks or levels.

    Of each attack the adversary is drawn that knows most short of the oracle; an attack that only
    the oracle can run is hollow. The control, which repeats what was shared, is left out, and so is
    what lies beyond the looks that there are.
    """
    rows = after_attack(run.ours)
    rows = rows[rows["metric"] == EXPOSURE]
    chosen = [source for source in most_knowing(sources_of(rows)) if source.consumer != IDENTITY]
    oracle = [source for source in chosen if source.knowledge == ORACLE]
    others = [source for source in chosen if source.knowledge and source not in oracle]
    looks = {AS_SHARED: Look(LOOKS - 1)} if AS_SHARED in chosen else {}
    looks |= {of: Look(place) for place, of in enumerate(others[: LOOKS - 1])}
    looks |= {of: Look(place, hollow=True) for place, of in enumerate(oracle[: LOOKS - 1])}
    if not looks.keys() - {AS_SHARED}:
        return
    of = {source: picked.of_source(rows, source) for source in looks}
    panels, key = [], dict[str, Look]()
    for scheme in picked.schemes(rows):
        curves = []
        for source, look in looks.items():
            label = "as shared" if source == AS_SHARED else source.label
            found = curve(of[source], scheme, label=label, look=look, metric=EXPOSURE)
            curves += found
            key |= {label: look} if found else {}
        if curves:
            raw = alone(of.get(AS_SHARED, rows[:0]), RAW, EXPOSURE)
            x, y = Axis(scheme.label, scheme.log), Axis("PLR, shared or attacked (%)")
            chart = curves_chart(curves, x=x, y=y, across=[("k6", one) for one in raw])
            panels.append((f"{scheme.title}, {scheme.rule_text}", chart))
    title = "PLR as shared and after each attack, over the level"
    said = "Dashed: raw as shared. Hollow: the oracle, a reference."
    yield Figure("after_attack", "after", title, panels, 2, key, said)
