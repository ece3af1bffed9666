"""Frames of a finished run, made up: what tables, figures and page are shown from."""

import copy
from pathlib import Path

import numpy as np
import pandas as pd

from evaluation.analysis import decisions, linkability, matching, paper, summary
from evaluation.analysis import weak_attacks as flags
from evaluation.analysis.keys import Source
from evaluation.reporting.rows import Results
from evaluation.runs.manifest import FAILED_COLUMNS
from isac_track.config import StageSettings

INDEPENDENT = ":adding=independent"
BOTH_RULES = ("", INDEPENDENT)
SWEPT = (("fid", (1.0, 1000.0)), ("fixed", (0.4, 0.7, 1.0)))
NO_RULE = ("raw", "clean", "offset", "thin", "ou")
"""Mechanisms that declare no adding rule; `ou` is a stranger's."""
CONTROLS = [
    ("offset", 0.4),
    ("correlated", 0.5),
    (f"correlated{INDEPENDENT}", 0.5),
    ("thin:d_sigma=0.75", 4.0),
]
UNITS = {
    "missed_conflict_rate": "fraction",
    "false_alarm_rate": "fraction",
    "distance_mae": "m",
    "plr": "fraction",
    "ael": "s",
    "mel": "s",
    "rmse": "m",
}
RATIOS = {"rmse_over_benchmark": "ratio", "plr_over_benchmark": "ratio"}
ATTACKS = (
    ("identity", "blind"),
    *((name, who) for name in ("moving_average", "savgol") for who in ("blind", "informed")),
    *(("kalman_rts", who) for who in ("blind", "informed", "oracle")),
    *(("radial_rts", who) for who in ("blind", "informed")),
    ("averaging", "oracle"),
)
LINKERS = {"shape": 0.4, "shape@radial_rts": 0.6}
COHORTS = {"without_groups": 0.0206, "without_frozen": 0.0073}
"""Chance without a confounder."""
CHANCE = 0.0072
STRONGEST = {
    "": Source("radial_rts", "informed"),
    "rerelease": Source("shape@radial_rts", "informed"),
}


def levels(*, swept=SWEPT, rules=BOTH_RULES, others=CONTROLS):
    """No error, what is swept under each rule, and others."""
    return [
        ("clean", np.nan),
        ("raw", np.nan),
        *((f"{name}{rule}", at) for rule in rules for name, ats in swept for at in ats),
        *others,
    ]


def described(mechanism):
    """Family and adding rule of a mechanism."""
    family = mechanism.partition(":")[0]
    rule = "independent" if INDEPENDENT[1:] in mechanism else "linear"
    bare = mechanism in NO_RULE
    return {"family": family, "adding": "" if bare or family in NO_RULE[:3] else rule}


def value_of(place, metric):
    """The value of a metric at the so many-th level, each another; misses rise, the others fall."""
    if metric in ("missed_conflict_rate", "false_alarm_rate"):
        return 0.1 + 0.02 * place
    return 0.9 / (1.37 + place + list(UNITS).index(metric))


def make_summary(at=None, *, dataset="students03", predictors=("least_squares",), attacks=ATTACKS):
    """As `summary.csv`: shared, predictors, and attacks that lift what was shared."""
    rows = []
    for place, (mechanism, level) in enumerate(levels() if at is None else at):
        where = {"dataset": dataset, "mechanism": mechanism, "level": level, "n": 55}
        where |= described(mechanism)
        cells = [("shared", "", metric, 1.0) for metric in list(UNITS)[3:]]
        cells += [(name, "", metric, 1.0) for name in predictors for metric in list(UNITS)[:3]]
        for n, (name, knowledge) in enumerate(attacks):
            lift = 1.0 if name == "identity" else 1.0 + 0.02 * n
            cells += [(name, knowledge, metric, lift) for metric in list(UNITS)[3:]]
            cells += [(name, knowledge, metric, 0.0) for metric in RATIOS]
        for consumer, knowledge, metric, lift in cells:
            value = lift * value_of(place, metric) if lift else 1.0
            ends = {"value": value, "ci_low": 0.9 * value, "ci_high": 1.1 * value}
            ends |= {"consumer": consumer, "knowledge": knowledge, "metric": metric}
            rows.append(where | ends | {"unit": (UNITS | RATIOS)[metric]})
    return pd.DataFrame(rows, columns=summary.COLUMNS)


def make_linkability(
    at=None, *, tasks=("rerelease",), linkers=LINKERS, dataset="students03", cohorts=COHORTS
):
    """As `linkability.csv`: three adversaries of each linker, controls, and the cohorts.

    `tasks` may say which linkers each has.
    """
    per_task = tasks if isinstance(tasks, dict) else dict.fromkeys(tasks, linkers)
    rows = []
    for task, strengths in per_task.items():
        for place, (mechanism, level) in enumerate(levels() if at is None else at):
            where = {
                "dataset": linkability.dataset_of(f"{task}/x", dataset=dataset),
                "mechanism": mechanism, "level": level, "invalid": "", "outcome": "links",
                "chance": CHANCE, "cohort": "all", "n_probes": 276, "n_mated": 276,
                "n_clusters": 175, "gallery_min": 138, "gallery_mean": 138.0, "gallery_max": 138,
            }  # fmt: skip
            for name in ("random", "duration", "noise_level"):
                control = {"consumer": f"{task}/control-{name}", "knowledge": "", "p_value": 0.4}
                rows.append(where | control | {"outcome": "at chance", "rank1": CHANCE})
            for linker, strength in strengths.items():
                for knowledge, share in (("blind", 0.8), ("informed", 1.0), ("oracle", 1.1)):
                    rank1 = share * strength / (1.0 + 0.1 * place)
                    row = {"consumer": f"{task}/{linker}", "knowledge": knowledge, "rank1": rank1}
                    row |= {"ci_low": 0.9 * rank1, "ci_high": 1.1 * rank1, "p_value": 0.001}
                    rows.append(where | row)
                    for cohort, chance in cohorts.items():
                        rows.append(where | row | {"cohort": cohort, "chance": chance})
    return pd.DataFrame(rows, columns=linkability.COLUMNS)


def make_matched(*, dataset="students03", predictors=("least_squares",)):
    """As `matched.csv`, at three rates each."""
    rows = [
        {
            "dataset": dataset, "criterion": "missed", "adding": adding, "predictor": predictor,
            "consumer": "shared", "knowledge": "", "metric": metric, "at": rate,
            "missed_conflict_rate": 0.1 + rate, "fid": 0.2, "fid_low": 0.1, "fid_high": 0.3,
            "fixed": 0.4, "fixed_low": 0.3, "fixed_high": 0.5, "difference": -rate,
            "ci_low": -rate - 0.01, "ci_high": -rate + 0.01, "defined": 1.0, "n": 50,
            "mechanism": f"fid{INDEPENDENT * (adding == 'independent')}", "family": "fid",
        }
        for predictor in predictors
        for adding in ("linear", "independent")
        for metric in ("plr", "ael", "mel")
        for rate in (0.12, 0.02, 0.08)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=matching.COLUMNS)


def make_curves(at=None, *, dataset="students03"):
    """As `curves.csv`: two scores of one predictor."""
    rows = [
        [dataset, mechanism, level, "least_squares", score, x, 1.0 - x]
        for mechanism, level in (levels() if at is None else at)
        for score in ("separation", "probability")
        for x in (0.0, 0.5, 1.0)
    ]
    return pd.DataFrame(rows, columns=decisions.CURVE_COLUMNS)


def make_gallery():
    """As `gallery.parquet`: four straight walks, every other shared sample leaks."""
    t = np.arange(8.0)
    return pd.concat(
        pd.DataFrame(
            {
                "track": track, "source": f"p{track}", "mechanism": mechanism,
                "attack": "radial_rts", "epsilon_m": 0.3, "t": t, "x_true": t, "y_true": track,
                "x_shared": t + 0.1, "y_shared": track + 0.2, "x_rec": t, "y_rec": track + 0.1,
                "leaked_shared": t % 2 == 0, "leaked_rec": t > 1,
            }
        )
        for track in range(4)
        for mechanism in ("raw", "fid:1", "fixed:0.8")
    )  # fmt: skip


def make_paper_table():
    """As `paper_table.csv`."""
    return pd.DataFrame(
        [
            ["raw", np.nan, "ael", 2.93, 3.5, 3.2, 3.8, False],
            ["fid", 1.0, "missed_conflict_rate", 0.305, 0.26, 0.205, 0.322, True],
            ["fid", 1.0, "plr", 0.184, 0.187, 0.184, 0.191, True],
            [f"fixed{INDEPENDENT}", 1.0, "mel", 0.25, 0.31, np.nan, np.nan, None],
        ],
        columns=paper.PAPER_COLUMNS,
    )


def make_claims():
    """As `paper_claims.csv`."""
    odd = "eta: it falls [red]monotonically[/red] " * 3
    return pd.DataFrame(
        [
            ["linear", odd, "holds", -0.088, -0.122, -0.055, "fraction", "why"],
            ["linear", "at every rate", "does not hold", 0.0123, 0.001, 0.02, "s", "why"],
            ["", "about 366 history points", "undecided", 368.79, np.nan, np.nan, "points", "e"],
        ],
        columns=paper.CLAIM_COLUMNS,
    )


def make_flags(**changes):
    """As the rows of `flags.json`: one attack that is beaten."""
    row = {
        "kind": "beaten", "mechanism": "raw", "level": np.nan, "attack": "radial_rts",
        "knowledge": "informed", "by": "radial_rts", "by_knowledge": "blind", "metric": "plr",
        "difference": 0.003, "ci_low": 0.001, "ci_high": 0.005, "compared": 47, "sentence": "",
    }  # fmt: skip
    return pd.DataFrame([row | changes], columns=flags.COLUMNS)


ITEM = {
    "id": "validity/linear/plr/rerelease", "section": "validity", "adding": "linear",
    "descriptor": "plr", "task": "rerelease", "subject": "shape (informed)", "criterion": "",
    "decision": "does not track", "sign": -1, "effect": -0.481, "ci_low": -0.548,
    "ci_high": -0.417, "unit": "fraction", "n": 175, "p_value": 1e-9, "p_adjusted": 1e-8,
    "sentence": "At equal PLR people are linked less.", "why_undecided": "",
    "contrasts": [
        {"mechanism": "correlated", "level": 0.5, "effect": -0.48, "ci_low": -0.55,
         "ci_high": -0.42, "reading": "differs"},
        {"mechanism": "fid", "level": None, "effect": 0.01, "ci_low": -0.01, "ci_high": 0.04,
         "reading": "equal"},
    ],
}  # fmt: skip
_INFLATED = {"section": "inflation", "task": "", "of": "fid", "unit": "ratio", "contrasts": None}
VERDICT = {
    "dataset": "students03", "simulated": False, "seed": 0, "preset": "paper", "scenes": 500,
    "answer": ["The first sentence.", "The second one.", "And the third."],
    "rules": {"confidence": 0.95, "text": "How it is decided."},
    "counts": {"validity": {"does not track": 1}, "inflation": {"inflated": 1, "undecided": 1}},
    "items": [
        ITEM,
        ITEM | _INFLATED | {"id": "b", "decision": "inflated", "effect": 3.29, "ci_low": 3.17,
                            "ci_high": 3.44},
        ITEM | _INFLATED | {"id": "c", "of": "fixed", "decision": "undecided", "effect": None,
                            "ci_low": None, "ci_high": None, "n": None,
                            "why_undecided": "too few people"},
    ],
}  # fmt: skip
MANIFEST = {
    "identity": {"scenes": 500, "seed": 3},
    "cells": [],
    "settings": {
        "preset": "paper", "scenes": 500, "seed": 3, "mechanisms": ["raw", "fid:1"],
        "predictors": ["least_squares"], "attacks": [], "tasks": ["rerelease"],
        "stages": StageSettings().flat(),
    },
    "dataset": {
        "name": "students03", "sha256": "d9fd", "simulated": False, "notice": None, "tracks": 428,
        "tracks_used": 106,
    },
    "environment": {
        "isac_track": "0.1.0", "python": "3.11.7", "machine": "Linux x86_64",
        "libraries": {"numpy": "2.4.6"}, "git_commit": "abc123",
        "command": ["/somewhere/matrix.py", "--out", "a run"],
    },
    "linkage": {
        "skipped": {"split": "too few [red]people[/red]"},
        "tasks": {"rerelease": {"about": "one walk twice", "people": 275,
                                "candidates": {"half 1": 138, "half 2": 137}}},
    },
    "wall_time_s": 97.8,
}  # fmt: skip


def make_run(out=Path(), dataset="students03", *, at=None, **changes):
    """A finished run at some levels; any of its frames may be another."""
    manifest = copy.deepcopy(MANIFEST)
    manifest["dataset"]["name"] = dataset
    parts = {
        "manifest": manifest,
        "summary": make_summary(at, dataset=dataset),
        "paper_table": make_paper_table(),
        "claims": make_claims(),
        "matched": make_matched(dataset=dataset),
        "decisions": pd.DataFrame(columns=decisions.DECISION_COLUMNS, dtype=float),
        "curves": make_curves(at, dataset=dataset),
        "flags": make_flags().head(0),
        "linkability": make_linkability(at, dataset=dataset),
        "verdict": VERDICT,
        "failed": pd.DataFrame(columns=list(FAILED_COLUMNS)),
        "strongest": STRONGEST,
    }
    return Results(out=out, **(parts | changes))


def rows_where(frame, **values):
    """Which rows of a frame hold these values."""
    of = pd.Series(True, index=frame.index)
    for name, value in values.items():
        of &= frame[name] == value
    return of


def emptied(run):
    """All frames of a run without rows."""
    names = ("summary", "paper_table", "claims", "matched", "decisions", "curves", "flags",
             "linkability")  # fmt: skip
    return {name: getattr(run, name).head(0) for name in names}
