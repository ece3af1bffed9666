"""Run folders that hold tables alone, with numbers that a question about them is easy to answer."""

import numpy as np
import pandas as pd

from evaluation.analysis import linkability, summary
from evaluation.experiment.fingerprint import code_hash
from evaluation.experiment.presets import PRESETS
from evaluation.runs.manifest import read_manifest, write_manifest
from evaluation.verdict.choose_level import ASKED, Limits, choose
from isac_track.config import StageSettings

IND = ":adding=independent"
HALF = 0.02
"""Half an interval of a rate."""
FID = {1.0: 0.30, 10.0: 0.25, 100.0: 0.20, 1000.0: 0.15}
"""Missed rate by eta."""
FIXED = {0.1: 0.14, 0.5: 0.19, 1.0: 0.30}
USUAL = {
    "fid": FID,
    "fixed": FIXED,
    f"fid{IND}": {eta: missed - 0.03 for eta, missed in FID.items()},
    f"fixed{IND}": {d_sigma: missed - 0.03 for d_sigma, missed in FIXED.items()},
}
LINKS = {"outcome": "links", "invalid": ""}
ATTACKS = {
    ("rerelease", "control-random", ""): {"rank1": 0.97},
    ("rerelease", "shape", "blind"): {"rank1": 0.20},
    ("rerelease", "shape", "informed"): {"rank1": 0.40},
    ("rerelease", "dtw", "informed"): {"rank1": 0.30},
    ("rerelease", "dtw", "oracle"): {"rank1": 0.95},
    ("new_traversal", "shape", "blind"): {"rank1": 0.80},
}


def leak(mechanism, level):
    """PLR as shared: the less is added, the more is left."""
    order = np.log10(level) / 10 if mechanism.startswith("fid") else (1 - level) / 4
    return 0.2 + float(order)


def numbers(mechanism, level, missed, *, half=HALF):
    """Rows of the summary at one level: consumer, adversary, metric, value, half interval."""
    plr = 0.5 if level is None else leak(mechanism, level)
    return [
        ("shared", "", "plr", plr, 0.01),
        ("shared", "", "ael", plr / 2, 0.01),
        ("shared", "", "mel", 2 * plr, 0.1),
        ("shared", "", "rmse", 1.0, 0.1),
        ("least_squares", "", "missed_conflict_rate", missed, half),
        ("least_squares", "", "false_alarm_rate", missed / 2, half),
        ("kalman_cv", "", "missed_conflict_rate", missed / 2, half),
        ("kalman_cv", "", "false_alarm_rate", missed / 4, half),
        ("kalman_rts", "blind", "plr", plr + 0.10, 0.01),
        ("kalman_rts", "informed", "plr", plr + 0.20, 0.01),
        ("kalman_rts", "informed", "ael", 9.0, 0.1),
        ("kalman_rts", "informed", "mel", 9.9, 0.1),
        ("radial_rts", "informed", "plr", plr + 0.30, 0.01),
        ("radial_rts", "informed", "ael", 2.0, 0.1),
        ("radial_rts", "informed", "mel", 4.0, 0.1),
        ("averaging", "oracle", "plr", 0.99, 0.005),
    ]


def declared(mechanism):
    """Family and adding rule of a mechanism: of a stranger's, none."""
    family = mechanism.partition(":")[0]
    rule = "independent" if mechanism.endswith(IND) else "linear"
    return {"family": family, "adding": rule if family in ("fid", "fixed") else ""}


def summary_frame(rates, *, half=HALF):
    """`rates`: mechanism -> level -> missed rate."""
    levels = [("raw", None, 0.12)]
    levels += [(name, at, missed) for name, of in rates.items() for at, missed in of.items()]
    frame = pd.DataFrame(
        [
            {"mechanism": mechanism, "level": level, **declared(mechanism)}
            | dict(zip(("consumer", "knowledge", "metric", "value", "half"), row, strict=True))
            for mechanism, level, missed in levels
            for row in numbers(mechanism, level, missed, half=half)
        ]
    ).assign(dataset="walks", n=55, unit="")
    frame["ci_low"], frame["ci_high"] = (frame["value"] + sign * frame["half"] for sign in (-1, 1))
    return frame[summary.COLUMNS]


def linked_frame(rates, cells):
    """`cells`: (task, attack, adversary) -> rank 1 and what else a row says, at every level."""
    levels = [("raw", np.nan), *[(name, at) for name, of in rates.items() for at in of]]
    rows = []
    for mechanism, level in levels:
        for (task, attack, knowledge), row in cells.items():
            value, consumer = row["rank1"], f"{task}/{attack}"
            cell = {"mechanism": mechanism, "level": level, "consumer": consumer}
            cell |= {"dataset": linkability.dataset_of(consumer, dataset="walks")}
            cell |= {"knowledge": knowledge, "chance": 0.01}
            cell |= LINKS | {"ci_low": value - 0.05, "ci_high": value + 0.05} | row
            # Walking groups left out it links more, but that is another question.
            others = {"cohort": "without_groups", "rank1": 0.98, "outcome": np.nan}
            rows += [cell | others, cell | {"cohort": "all"}]
    return pd.DataFrame(rows, columns=linkability.COLUMNS)


def write_run(out, rates=USUAL, *, half=HALF, cells=ATTACKS, **dataset):
    """A run folder with manifest, summary.csv and linkability.csv."""
    (out / "cells").mkdir(parents=True)
    stages = StageSettings().flat()
    content = {
        "identity": {"scenes": 500, "scenes_utility": 2000, "seed": 0, "fps": None, **stages},
        "cells": [],
        "history": {"points": 366.0, "interval_s": 0.0836},
        "code": code_hash(),
        "settings": {
            "preset": "paper",
            "predictors": ["least_squares", "kalman_cv"],
            "attacks": list(PRESETS["paper"].attacks),
            "tasks": list(PRESETS["paper"].tasks),
            "stages": stages,
        },
        "dataset": {"name": "walks", "path": "my walks.csv", "format": "csv"}
        | {"simulated": False, "notice": None}
        | dataset,
    }
    write_manifest(out, content)
    summary_frame(rates, half=half).to_csv(out / "summary.csv", index=False)
    if cells is not None:
        linked_frame(rates, cells).to_csv(out / "linkability.csv", index=False)
    return out


def edited(out, name, change):
    """Change a table of a run."""
    frame = pd.read_csv(out / name, keep_default_na=False, dtype=str)
    change(frame).to_csv(out / name, index=False)


def edit_manifest(out, change):
    """Change the manifest of a run, in place, as if it had been written so."""
    manifest = read_manifest(out)
    change(manifest)
    write_manifest(out, manifest)


def asked(out, *, as_shared=False, **question):
    """The choice of a level under some limits, each by its name."""
    limits = Limits({name: question.pop(name) for name in ASKED if name in question}, as_shared)
    return choose(out, limits=limits, **question)


def scheme(choice, family="fid", adding="linear"):
    """The one answer for a mechanism under an adding rule."""
    (one,) = [one for one in choice.schemes if (one.name, one.adding) == (family, adding)]
    return one


def statuses(one):
    """What became of every target and limit."""
    return {check.name: check.status for check in one.checks}
