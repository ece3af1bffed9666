"""Run folders that hold `levels.csv` alone, with numbers that a question is easy to
answer.
"""

import json
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from evaluation.estimates.best_robot import BEST
from evaluation.estimates.levels import COLUMNS
from evaluation.estimates.strongest_table import SINGLE_RELEASE
from evaluation.plan.presets import PRESETS
from evaluation.plan.source_digest import code_hash
from evaluation.store.csv_files import from_csv, to_csv
from evaluation.store.manifest import read_manifest, write_manifest
from evaluation.verdict.level_checks import SceneCounts
from evaluation.verdict.question import Question
from evaluation.verdict.what_to_share import recommend
from isac_track.config import StageSettings

WALKS = "walks"
IND = ":adding=independent"
HALF = 0.02
"""Half an interval of every number."""
FUTURE, ALL = "missed_future_at_equal_false_alarms", "missed_at_equal_false_alarms"
ROBOT, OTHER_ROBOT = "kalman_cv", "least_squares"
HANDOVER = "handover-1s"


@dataclass(frozen=True)
class Level:
    """Planted numbers of a level; the defaults keep within all usual limits."""

    mechanism: str
    level: float | None = None
    family: str = ""
    adding: str = "independent"
    protects: bool = True
    # To come within 3 s at raw's false alarms, of the better robot.
    missed: float = 0.20
    plr: float = 0.30
    wide: float = 0.40
    median: float = 0.5
    share: float = 0.40
    rank1: float = 0.30
    task: str = HANDOVER
    outcome: str = "links"
    invalid: str = ""
    beyond: dict = field(default_factory=lambda: {"repeats": 0.40, "anchor": 0.35})
    """PLR after adversaries who know more; at 4/3 epsilon it is 0.05 more."""
    half: float = HALF
    is_attacked: bool = True
    chosen: tuple[str, str] = (ROBOT, ROBOT)
    extra: float = 0.0  # Missed by the cross-fitted best robot beyond the better one.

    def rows(self):
        """Rows of `levels.csv`."""
        robots = [(name, "", "", f"{WALKS}:horizon=3s", missed) for name, missed in (
            (ROBOT, self.missed), (OTHER_ROBOT, self.missed + 0.2)
        )]  # fmt: skip
        for consumer, _, _, dataset, missed in robots:
            yield self._row(dataset, "", consumer, "", FUTURE, missed)
            yield self._row(dataset, "", consumer, "", "false_alarm_rate", 0.1)
            yield self._row(WALKS, "", consumer, "", ALL, missed / 2)
            yield self._row(WALKS, "", consumer, "", "false_alarm_rate", 0.05)
        chosen = dict(zip(("first_choice", "second_choice"), self.chosen, strict=True))
        for metric, best in BEST.items() if self.chosen[0] else ():
            for dataset, missed, alarms in (
                (f"{WALKS}:horizon=3s", self.missed, 0.1), (WALKS, self.missed / 2, 0.05)
            ):  # fmt: skip
                yield (
                    self._row(dataset, "", best, "", metric, missed + self.extra)
                    | chosen
                )
                yield (
                    self._row(dataset, "", best, "", "false_alarm_rate", alarms)
                    | chosen
                )
        for metric, value in (("plr", 0.2), ("plr_wide", 0.25), ("median_error", 0.8)):
            yield self._row(WALKS, "", "shared", "", metric, value)
        sides = [(SINGLE_RELEASE, "informed", self.plr, self.wide)] * self.is_attacked
        sides += [(name, name, plr, plr + 0.05) for name, plr in self.beyond.items()]
        for adversary, knowledge, plr, wide in sides:
            numbers = {
                "plr": plr,
                "plr_wide": wide,
                "median_error": self.median,
                "ael": 1.0,
            }
            for metric, value in numbers.items():
                yield self._row(WALKS, adversary, "ou_rts", knowledge, metric, value)
        linker = f"{self.task}/kinematic"
        numbers = {"rank1": self.rank1, "chance": 0.025, "linkage_share": self.share}
        for metric, value in numbers.items() if self.task else ():
            yield self._row(WALKS, SINGLE_RELEASE, linker, "blind", metric, value)
        simulated = "plaza-two-sessions", SINGLE_RELEASE, "new_traversal/shape", "blind"
        yield self._row(*simulated, "rank1", 0.99)

    def _row(self, dataset, adversary, consumer, knowledge, metric, value):
        level = np.nan if self.level is None else self.level
        linked = "/" in consumer
        return {
            "dataset": dataset, "mechanism": self.mechanism, "level": level,
            "family": self.family or self.mechanism.partition(":")[0], "adding": self.adding,
            "protects": self.protects, "adversary": adversary, "consumer": consumer,
            "knowledge": knowledge, "metric": metric, "value": value,
            "ci_low": value - self.half, "ci_high": value + self.half, "n": 55,
            "outcome": self.outcome if linked else "", "invalid": self.invalid if linked else "",
        }  # fmt: skip


RAW = Level("raw", None, "raw", "", False, 0.05, 0.9, 0.95, 0.1, 1.0, 0.8, beyond={})
GOOD = Level("ou", 0.4)
BAD = Level("fixed:adding=independent", 1.0, missed=0.1, plr=0.8, wide=0.9, share=0.9)
SHIFTED = Level(
    "offset", 0.3, adding="", protects=False, missed=0.05, plr=0.1, wide=0.1, share=0.1
)
"""A control that would win on every count."""
USUAL = (RAW, GOOD, BAD, SHIFTED)


def table(levels=USUAL):
    """As `levels.csv`."""
    rows = [row for level in levels for row in level.rows()]
    return from_csv(to_csv(pd.DataFrame(rows, columns=COLUMNS)))


def asked(levels=USUAL, *, scenes=(500, 2000), **question):
    """What is recommended of some levels."""
    result = Question(**{"adding": ("independent",)} | question)
    return recommend(table(levels), result, dataset=WALKS, scenes=SceneCounts(*scenes))


def names(offers):
    """Mechanism and level of offers."""
    return [offer.mechanism_level for offer in offers]


def changed(base=GOOD, /, **values):
    """A level with other values."""
    return replace(base, **values)


def write_run(out, levels=USUAL, *, options=(), **dataset):
    """A run folder with a manifest, levels.csv, and options on patrol."""
    (out / "cells").mkdir(parents=True)
    stages = StageSettings().flat()
    content = {
        "identity": {
            "scenes": 500,
            "scenes_utility": 2000,
            "seed": 0,
            "fps": None,
            **stages,
        },
        "cells": [],
        "history": {"points": 366.0, "interval_s": 0.0836},
        "code": code_hash(),
        "settings": {
            "preset": "paper",
            "predictors": [OTHER_ROBOT, ROBOT],
            "attacks": list(PRESETS["paper"].attacks),
            "tasks": list(PRESETS["paper"].tasks),
            "stages": stages,
        },
        "dataset": (
            {"name": WALKS, "path": "my walks.csv", "format": "csv"}
            | {"simulated": False, "notice": None}
            | dataset
        ),
    }
    write_manifest(out, content)
    (out / "levels.csv").write_bytes(to_csv(table(levels)))
    verdict = {"patrols": {"options": list(options)}} if options else {}
    (out / "verdict.json").write_text(json.dumps(verdict))
    return out


def change_first_cell(manifest, **fields):
    """Give the first entry of a manifest's cells other fields."""
    first, *others = manifest["cells"]
    manifest["cells"] = [replace(first, **fields), *others]


def patrol_option(policy, missed, known, *, mechanism="raw", followed=0.05, half=0.01):
    """An option on patrol as `verdict.json` has it; its raw case misses 30 %.

    Without `half` it has no interval.
    """

    def ends(name, value):
        low, high = (None, None) if half is None else (value - half, value + half)
        return {name: value, f"{name}_low": low, f"{name}_high": high}

    return {
        "robot": ROBOT, "horizon_s": 3.0, "mechanism": mechanism, "level": None,
        "policy": policy, "may_be_proposed": True, **ends("missed", missed),
        **ends("lost", missed - 0.3), **ends("known", known),
        **ends("followed", followed), "n": 40,
    }  # fmt: skip


PATROLS = (
    patrol_option("everything", 0.30, 0.95, followed=0.95),
    patrol_option("state:2", 0.33, 0.20),
    patrol_option("near:3.5", 0.55, 0.10, followed=0.01),
)


def edit_manifest(out, change):
    """Change the manifest of a run, in place, as if it had been written so."""
    manifest = read_manifest(out)
    change(manifest)
    write_manifest(out, manifest)
