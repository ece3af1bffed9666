"""Which level of a run a site may use: targets of utility choose it, limits of privacy hold there.

A target or limit is met only if the upper end of the interval meets it; where that cannot be said,
it is not met. Nothing is interpolated, and everything is read from the files of the run.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.analysis import linkability
from evaluation.analysis.families import ADDING_RULES, FID, FIXED, RAW, Family, families_in
from evaluation.analysis.keys import AS_SHARED, Key, Source, Where, keys_of
from evaluation.analysis.metrics import (
    DESCRIPTORS,
    EXPOSURE,
    METRICS,
    MISSED_RATE,
    SUCCESS,
    SUCCESS_OF_100,
)
from evaluation.analysis.strongest import GROUPS, by_task, strongest_of
from evaluation.analysis.summary import COLUMNS
from evaluation.experiment.constants import SHARED
from evaluation.runs.files import made_of
from evaluation.runs.manifest import read_manifest
from isac_track.errors import SettingsError, did_you_mean
from isac_track.intervals import LEAST_CLUSTERS, Estimate
from isac_track.linkability import GALLERY

TARGETS: Final = ("missed", "false_alarm")  # What chooses a level.
METRIC_OF: Final = {  # By name in question and answer; rank 1 is asked for by task.
    "missed": MISSED_RATE,
    "false_alarm": "false_alarm_rate",
    **dict(zip(DESCRIPTORS, DESCRIPTORS, strict=True)),
}
ASKED: Final = METRIC_OF | {SUCCESS: SUCCESS}  # What may be limited.
UNKNOWN: Final = Estimate(math.nan)
WEAK: Final = "attack too weak"
MOST_TIMES: Final = 10.0  # So many times the scenes of a run still bring people who were in none.
_SWEEPS: Final = {FID: "fid:1..1000/10", FIXED: "fixed:0.1..1/10"}
_ENDS = ("ci_low", "ci_high")


@dataclass(frozen=True, slots=True)
class Attacked:
    """The descriptors after the strongest reconstruction."""

    attack: str
    knowledge: str
    numbers: Mapping[str, Estimate]


@dataclass(frozen=True, slots=True)
class Linked:
    """The strongest attack in a linkage task: the strongest valid one if there is one."""

    task: str
    dataset: str
    limited: bool  # Whether a limit of rank 1 is about it: it links people of the recording.
    attack: str = ""  # Empty: the task was not run at this level.
    knowledge: str = ""
    rank1: Estimate = UNKNOWN
    chance: float = math.nan
    outcome: str = ""
    invalid: str = ""  # Shortcuts that give people away here; empty: none.

    @property
    def missing(self) -> str:
        """Why there is no number to judge; empty if there may be one."""
        if not self.attack:
            return "no attack was run at this level"
        if self.invalid:
            return f"a shortcut ({self.invalid}) gives people away: no measure of the attack"
        too_weak = "every attack is too weak: it fails without any error, too"
        return too_weak if self.outcome == WEAK else ""


@dataclass(frozen=True, slots=True)
class Level:
    """What one level of the run comes to."""

    mechanism: str
    level: float | None
    scenes: int  # That descriptors were measured on, and attacked.
    scenes_utility: int  # That the robot's predictor was measured on.
    numbers: Mapping[str, Estimate]  # By name of `METRIC_OF`.
    after_attack: Attacked | None
    tasks: tuple[Linked, ...]
    costs: Mapping[str, Estimate]  # Missed conflicts of every robot of the run.
    beyond: tuple[Attacked, ...]  # After the strongest of who knows more than limits are about.


@dataclass(frozen=True, slots=True)
class Limits:
    """What is asked for; SettingsError for a fraction beyond 0..1, or no finite time from 0 on."""

    given: Mapping[str, float]
    """By name of `ASKED`, a fraction or s; `rank1` is of the strongest attack of every task of the
    recording. `missed` is always given; with `false_alarm` it chooses the level."""
    as_shared: bool = False  # Descriptors are limited as shared, not as reconstructed.

    def __post_init__(self) -> None:
        for name, limit in self.given.items():
            is_share = METRICS[ASKED[name]].is_share
            if not 0.0 <= limit <= (1.0 if is_share else sys.float_info.max):
                what = "fraction from 0 to 1 (0.2 for 20 %)" if is_share else "time in s, 0 or more"
                option = f"--max-{name.replace('_', '-')}"
                raise SettingsError(f"{option} is a {what}, got {limit:g}")

    def of(self, *names: str) -> dict[str, float]:
        """Return those of some limits that are given."""
        return {name: self.given[name] for name in names if name in self.given}


@dataclass(frozen=True, slots=True)
class Check:
    """One target or limit at one level."""

    name: str  # As in `Limits`; of rank 1 `rank1/TASK`.
    limit: float
    measured: Estimate
    scenes: int = 0  # That it was measured on; 0: it is not about scenes.
    whose: str = ""  # Whose positions or which attack it is of.
    missing: str = ""  # Why there is no number to judge; empty if there may be one.

    @property
    def why_unknown(self) -> str:
        """Why it cannot be said; empty if it can."""
        if self.missing or math.isfinite(self.measured.ci_high):
            return self.missing
        if math.isnan(self.measured.value):
            return "the value is unknown"
        return f"so few people have no interval; {LEAST_CLUSTERS:g} groups have"

    @property
    def status(self) -> str:
        """Whether the upper end is at or below the limit: met, not met, or cannot say."""
        if self.why_unknown:
            return "cannot say"
        return "met" if self.measured.ci_high <= self.limit else "not met"

    @property
    def times_more(self) -> float:
        """How many times the data would tell the value from its limit; NaN unless that is within.

        An interval narrows with the root of it.
        """
        value, low, high = self.measured.value, self.measured.ci_low, self.measured.ci_high
        if self.status != "not met" or not low < self.limit:
            return math.nan
        side = high - value if value <= self.limit else value - low
        return (side / gap) ** 2 if (gap := abs(self.limit - value)) > 0.0 else math.inf

    @property
    def asks(self) -> str:
        """Of what more would tell: ever more scenes of the same people would not."""
        return "scenes" if self.scenes and self.times_more <= MOST_TIMES else "people"


@dataclass(frozen=True, slots=True)
class Scheme:
    """The answer for one mechanism under one adding rule."""

    adding: str  # The rule that it is judged under.
    family: Family
    falls: bool  # Whether smaller levels are stricter, as with FID.
    chosen: Level | None  # The strictest level that meets the targets as all less strict ones do.
    stricter: Level | None  # The next level, which misses a target; else the least strict.
    also_meets: tuple[float, ...]  # Levels beyond that one that meet the targets all the same.
    is_saturated: bool  # The strictest levels share the same: stricter ones would, too.
    checks: tuple[Check, ...]  # At the chosen level.
    missed: tuple[Check, ...]  # Targets at the stricter level.

    @property
    def name(self) -> str:
        """Family and parameters, without the adding rule."""
        return self.family.name

    @property
    def met(self) -> bool:
        """Whether there is a level that meets the targets, and every limit holds there."""
        return bool(self.checks) and all(check.status == "met" for check in self.checks)


@dataclass(frozen=True, slots=True)
class Choice:
    """The answer for all mechanisms of a run."""

    out: Path
    manifest: Mapping[str, Any]
    predictor: str
    adding: tuple[str, ...]
    limits: Limits
    raw: Level | None
    raw_checks: tuple[Check, ...]  # Whether raw itself meets the targets.
    schemes: tuple[Scheme, ...]  # Of all families that were asked for.
    tasks: tuple[Linked, ...]  # Of the run, without numbers.

    @property
    def answers(self) -> dict[str, list[Scheme]]:
        """The schemes by mechanism, of those that have a level under every rule asked for."""
        found: dict[str, list[Scheme]] = {}
        for scheme in self.schemes:
            found.setdefault(scheme.name, []).append(scheme)
        n = len(self.adding)
        return {name: of for name, of in found.items() if len(of) == n or of[0].family.has_one_rule}

    @property
    def met(self) -> bool:
        """Whether some mechanism meets everything under every adding rule asked for."""
        return any(all(scheme.met for scheme in of) for of in self.answers.values())


def choose(
    out: Path,
    *,
    limits: Limits,
    adding: Sequence[str] = ADDING_RULES,
    predictor: str | None = None,
    only: Sequence[str] = (),
) -> Choice:
    """Return the strictest levels of a run that meet the targets, and whether the limits hold.

    `adding` names the rules to answer for; `predictor` is by default the first of the run; `only`
    names families, by default all. Raises DataError if there is no run, or a file of it is missing
    or broken, and SettingsError if it lacks what is asked for: with the option and the way out.
    """
    manifest = read_manifest(out)
    cells = [one["consumer"] for one in manifest["cells"] if one["kind"] == "predictor"]
    robots = list(dict.fromkeys([*manifest["settings"]["predictors"], *cells]))
    if not robots:
        raise SettingsError(
            f"{out} has no predictor, so that nothing is known of --max-missed; add one with "
            "the command of the run and --predictor least_squares"
        )
    robot = robots[0] if predictor is None else predictor
    if robot not in robots:
        raise SettingsError(
            f"--predictor {robot}: {out} has {', '.join(robots)}; name one of these or add it "
            "with the command of the run"
        )
    summary, linked = made_of(out, "summary.csv", columns=COLUMNS), []
    if (out / "linkability.csv").exists():
        table = made_of(out, "linkability.csv", columns=linkability.COLUMNS)
        linked = linkability.linked_tasks(table)
    levels = _levels(summary, linked, [robot, *(one for one in robots if one != robot)], manifest)
    raw = next((one for one in levels if one.mechanism == RAW), None)
    added = [one for one in families_in(summary).values() if one.is_added]
    # FID is shown first, then fixed noise, all others as they were run.
    families = sorted(added, key=lambda one: {FID: 0, FIXED: 1}.get(one.name, 2))
    known = dict.fromkeys(text for one in families for text in (one.family, one.name))
    for name in only:
        if name not in known:
            hint = did_you_mean(name, known, quote="'") or f"; it has {', '.join(known)}"
            raise SettingsError(f"--family {name}: {out} has no such family{hint}")
    every = [
        _scheme(found, family, rule, limits)
        for rule in ADDING_RULES
        for family in families
        if rule in family.rules and (not only or {family.family, family.name} & {*only})
        if (found := [one for one in levels if one.mechanism == family.mechanism])
    ]
    choice = Choice(
        out=out,
        manifest=manifest,
        predictor=robot,
        adding=tuple(adding),
        limits=limits,
        raw=raw,
        raw_checks=_targets(raw, limits),
        schemes=tuple(one for rule in adding for one in every if one.adding == rule),
        tasks=next((one.tasks for one in levels), ()),
    )
    have = {one.adding: one.family.family for one in every}
    _refuse_missing(choice, have, is_attacked=any(one.after_attack for one in levels))
    return choice


def _levels(
    summary: pd.DataFrame,
    tasks: Sequence[linkability.LinkedTask],
    robots: Sequence[str],
    manifest: Mapping[str, Any],
) -> list[Level]:
    """Return raw, and the levels that the first robot was shown, each with all of its tasks."""
    robot = Source(robots[0])
    dataset, identity = manifest["dataset"]["name"], manifest["identity"]
    own = (one for one in manifest["cells"] if not one.get("world"))
    n_files = {one["consumer"]: len(one["files"]) for one in own}
    is_in_all = n_files.get(robot.consumer, 0) != n_files.get(SHARED)
    attacked = identity["scenes"]
    scenes = attacked, identity.get("scenes_utility", attacked) if is_in_all else attacked
    # What holds under other assumptions, another error law say, has a data set of its own.
    summary = summary[~summary["dataset"].str.startswith(f"{dataset}:")]
    numbers_of = (summary[name] for name in ("value", *_ENDS))
    found = dict(zip(keys_of(summary), map(Estimate, *numbers_of), strict=True))

    def numbers(where: Where, source: Source, names: Sequence[str]) -> dict[str, Estimate]:
        measures = {name: source.measure(METRIC_OF[name]) for name in names}
        return {name: found.get(one.at(*where), UNKNOWN) for name, one in measures.items()}

    levels = []
    for where, exposed in by_task(found, metric=EXPOSURE).get("", {}).items():
        is_foreseen = where[0] == RAW or robot.measure(MISSED_RATE).at(*where) in found
        if AS_SHARED in exposed and is_foreseen:
            known = numbers(where, robot, TARGETS) | numbers(where, AS_SHARED, DESCRIPTORS)
            every = (strongest_of([exposed], among=group) for group in GROUPS)
            of = [one and Attacked(*one, numbers(where, one, DESCRIPTORS)) for one in every]
            linked = tuple(_strongest(task, where, dataset, found) for task in tasks)
            costs = {name: numbers(where, Source(name), TARGETS)["missed"] for name in robots}
            beyond = tuple(one for one in of[1:] if one)
            levels.append(Level(*where, *scenes, known, of[0], linked, costs, beyond))
    return levels


def _strongest(
    task: linkability.LinkedTask, where: Where, dataset: str, found: Mapping[Key, Estimate]
) -> Linked:
    """Return the strongest linker at a level, of the valid ones if there are any.

    Told is rank 1 of 100 where so many are candidates: a limit holds for any recording.
    """
    own, rows = linkability.dataset_of(task.name, dataset=dataset), task.cells.get(where, {})
    rank1 = {source: row[SUCCESS] for source, row in rows.items()}
    poor = {source for source, row in rows.items() if row["outcome"] == WEAK or row["invalid"]}
    valid = {source: value for source, value in rank1.items() if source not in poor}
    best = strongest_of([valid]) or strongest_of([rank1])
    if best is None:
        return Linked(task.name, own, own == dataset)
    achieved = Estimate(*(rows[best][name] for name in (SUCCESS, *_ENDS)))
    chance, *judged = (rows[best][name] for name in ("chance", "outcome", "invalid"))
    linker = Source(f"{task.name}/{best.consumer}", best.knowledge)
    of_100 = found.get(linker.measure(SUCCESS_OF_100).at(*where), UNKNOWN)
    if np.isfinite(of_100.value):
        achieved, chance = of_100, 1.0 / GALLERY
    return Linked(task.name, own, own == dataset, *best, achieved, chance, *judged)


def _refuse_missing(choice: Choice, have: Mapping[str, str], *, is_attacked: bool) -> None:
    """Refuse a question that no level of the run could answer; it has a family by adding rule."""
    out = choice.out
    if not choice.answers:
        rule = next((one for one in choice.adding if one not in have), choice.adding[-1])
        family = next(iter(have.values()), FID)
        own = f",adding={rule}" * (rule != ADDING_RULES[0])
        spec = _SWEEPS.get(family, f"{family}:LEVEL") + own
        narrower = f", or ask for --adding {next(iter(have))} alone" if have else ""
        raise SettingsError(
            f"{out} has no level of {family} with {rule} adding for {choice.predictor}; add some "
            f"with the command of the run and --mechanism {spec}{narrower}"
        )
    if choice.limits.of(*DESCRIPTORS) and not choice.limits.as_shared and not is_attacked:
        raise SettingsError(
            f"{out} has no reconstruction attack to judge privacy after; add one with the command "
            "of the run and --attack radial_rts, or ask for --as-shared"
        )
    if SUCCESS in choice.limits.given and not any(one.limited for one in choice.tasks):
        whose = " of its recording" * bool(choice.tasks)
        raise SettingsError(
            f"--max-rank1: {out} links nobody{whose}; add a task with the command of the run, "
            "--task rerelease and --attack shape@radial_rts, or leave it out"
        )


def _targets(level: Level | None, limits: Limits) -> tuple[Check, ...]:
    """Return the checks that choose a level."""
    return tuple(
        Check(name, limit, level.numbers[name], level.scenes_utility)
        for name, limit in limits.of(*TARGETS).items()
        if level
    )


def _privacy(level: Level, limits: Limits) -> list[Check]:
    """Return the checks at the chosen level."""
    numbers, whose, missing = level.numbers, "as shared", ""
    if not limits.as_shared and (attacked := level.after_attack):
        numbers = attacked.numbers
        whose = f"after {Source(attacked.attack, attacked.knowledge).label}"
    elif not limits.as_shared:
        numbers, whose, missing = {}, "", "no reconstruction attack was run at this level"
    checks = [
        Check(name, limit, numbers.get(name, UNKNOWN), level.scenes, whose, missing)
        for name, limit in limits.of(*DESCRIPTORS).items()
    ]
    for one in level.tasks if SUCCESS in limits.given else ():
        if one.limited:
            by = f"in {one.task} by {Source(one.attack, one.knowledge).label}"
            name, whose = f"{SUCCESS}/{one.task}", by if one.attack else one.task
            limit = limits.given[SUCCESS]
            checks.append(Check(name, limit, one.rank1, whose=whose, missing=one.missing))
    return checks


def _scheme(found: Sequence[Level], family: Family, adding: str, limits: Limits) -> Scheme:
    """Return the answer for the levels of a mechanism."""
    levels = sorted(found, key=lambda one: one.level or 0.0)
    # A large eta adds little, a large error much; of anybody else's, what leaks less is stricter.
    leak = [levels[place].numbers[EXPOSURE].value for place in (0, -1)]
    falls = {FID: True, FIXED: False}.get(family.family, leak[0] < leak[1])
    if falls:
        levels.reverse()  # the least strict first
    meets = [all(one.status == "met" for one in _targets(level, limits)) for level in levels]
    # Noise of the estimate may let one strict level pass: all less strict ones must pass as well.
    # Tests in a fixed order that stop at the first failure need no correction for their number.
    n_met = meets.index(False) if False in meets else len(meets)
    chosen = levels[n_met - 1] if n_met else None
    stricter = levels[n_met] if n_met < len(levels) else None
    beyond = [one.level for one, fine in zip(levels, meets, strict=True) if fine][n_met:]
    shown = [
        [(one.value, one.ci_low, one.ci_high) for one in map(level.numbers.get, DESCRIPTORS) if one]
        for level in levels[-2:]
    ]
    return Scheme(
        adding=adding,
        family=family,
        falls=falls,
        chosen=chosen,
        stricter=stricter,
        also_meets=tuple(level for level in beyond if level is not None),
        is_saturated=len(shown) > 1 and shown[0] == shown[1],
        checks=() if chosen is None else (*_targets(chosen, limits), *_privacy(chosen, limits)),
        missed=_targets(stricter, limits),
    )
