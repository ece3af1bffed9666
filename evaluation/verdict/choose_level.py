"""Which level of a run a site may use: targets of utility choose it, limits of privacy hold there.

A target or limit is met only if the upper end of the interval meets it; where that cannot be said,
it is not met. Nothing is interpolated, and everything is read from the files of the run.
"""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import pandas as pd

from evaluation.analysis.families import ADDING_RULES, FID, FIXED, families_in
from evaluation.analysis.keys import AS_SHARED, Source
from evaluation.analysis.linkability import dataset_of, linked_tasks
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS, MISSED_RATE, SUCCESS
from evaluation.analysis.strongest import strongest_of
from evaluation.experiment.fingerprint import code_hash
from evaluation.runs.manifest import read_manifest
from isac_track.errors import DataError, SettingsError
from isac_track.intervals import Estimate

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Where
    from evaluation.analysis.linkability import LinkedTask

Status: TypeAlias = Literal["met", "not met", "cannot say"]

TARGETS: Final = ("missed", "false_alarm")
"""What chooses a level."""
METRIC_OF: Final = {
    "missed": MISSED_RATE,
    "false_alarm": "false_alarm_rate",
    **dict(zip(DESCRIPTORS, DESCRIPTORS, strict=True)),
}
"""By what it is called in the question and in the answer; rank 1 is asked for by task."""
ASKED: Final = METRIC_OF | {SUCCESS: SUCCESS}
"""What may be limited."""
UNKNOWN: Final = Estimate(math.nan)
WEAK: Final = "attack too weak"
_TEXTS = ("mechanism", "consumer", "knowledge", "metric", "family", "adding")
_NUMBERS = ("level", "value", "ci_low", "ci_high")
_LINKED_TEXTS = ("mechanism", "consumer", "knowledge", "cohort", "outcome", "invalid")
_LINKED_NUMBERS = ("level", "rank1", "ci_low", "ci_high", "chance")


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
    limited: bool
    """Whether a limit of rank 1 is about it: it links people of the recording."""
    attack: str = ""
    """Empty: the task was not run at this level."""
    knowledge: str = ""
    rank1: Estimate = UNKNOWN
    chance: float = math.nan
    outcome: str = ""
    invalid: str = ""
    """Shortcuts that give people away here; empty: none."""

    @property
    def why_unknown(self) -> str:
        """Why it confirms no limit; empty if it may."""
        if not self.attack:
            return "no attack was run at this level"
        if self.invalid:
            return f"a shortcut ({self.invalid}) gives people away: no measure of the attack"
        if self.outcome == WEAK:
            return "every attack is too weak: it fails without any error, too"
        return ""


@dataclass(frozen=True, slots=True)
class Level:
    """What one level of the run comes to."""

    mechanism: str
    level: float | None
    numbers: Mapping[str, Estimate]
    """By name of `METRIC_OF`."""
    after_attack: Attacked | None
    tasks: tuple[Linked, ...]


@dataclass(frozen=True, slots=True)
class Limits:
    """What is asked for.

    Raises
    ------
    SettingsError
        For a fraction beyond 0..1, a time that is negative or not finite, or `after_attack`
        without a limit that it is about.
    """

    given: Mapping[str, float]
    """By name of `ASKED`, a fraction or s; `rank1` is of the strongest attack of every task of the
    recording. `missed` is always given; with `false_alarm` it chooses the level."""
    after_attack: bool = False
    """Whether descriptors are limited after the best reconstruction, not as shared."""

    def __post_init__(self) -> None:
        for name, limit in self.given.items():
            option = f"--max-{name.replace('_', '-')}"
            if not METRICS[ASKED[name]].is_share:
                if not 0.0 <= limit < math.inf:
                    raise SettingsError(f"{option} is a time in s, 0 or more, got {limit:g}")
            elif not 0.0 <= limit <= 1.0:
                raise SettingsError(
                    f"{option} is a fraction from 0 to 1 (0.2 for 20 %), got {limit:g}"
                )
        if self.after_attack and not self.of(*DESCRIPTORS):
            options = [f"--max-{name}" for name in DESCRIPTORS]
            raise SettingsError(
                f"--after-attack says where {', '.join(options[:-1])} and {options[-1]} hold; "
                "give one"
            )

    def of(self, *names: str) -> dict[str, float]:
        """Return those of some limits that are given."""
        return {name: self.given[name] for name in names if name in self.given}


@dataclass(frozen=True, slots=True)
class Check:
    """One target or limit at one level."""

    name: str
    """As in `Limits`; of rank 1 `rank1/TASK`."""
    limit: float
    measured: Estimate
    whose: str = ""
    """Whose positions or which attack it is of."""
    why_unknown: str = ""
    """Why it cannot be said; empty if it can."""

    @property
    def status(self) -> Status:
        """Whether the upper end is at or below the limit."""
        if self.why_unknown:
            return "cannot say"
        return "met" if self.measured.ci_high <= self.limit else "not met"


@dataclass(frozen=True, slots=True)
class Scheme:
    """The answer for one mechanism under one adding rule."""

    adding: str
    """The rule that it is judged under."""
    family: Family
    falls: bool
    """Whether smaller levels are stricter, as with FID."""
    chosen: Level | None
    """The strictest level that meets the targets as all less strict ones do."""
    stricter: Level | None
    """The next stricter level, which misses a target; without `chosen` the least strict one."""
    also_meets: tuple[float, ...]
    """Levels beyond that one that meet the targets all the same."""
    is_saturated: bool
    """Whether the strictest levels share the same, so that stricter ones would as well."""
    checks: tuple[Check, ...]
    """At the chosen level."""
    missed: tuple[Check, ...]
    """Targets at the stricter level."""

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
    raw_checks: tuple[Check, ...]
    """Whether raw itself meets the targets."""
    schemes: tuple[Scheme, ...]
    tasks: tuple[Linked, ...]
    """Of the run, without numbers."""
    is_current: bool
    """Whether the run is of this version of the code."""

    @property
    def asked(self) -> list[Scheme]:
        """The schemes that the answer is about: those of FID, or of all but fixed noise."""
        fid = [scheme for scheme in self.schemes if scheme.name == FID]
        return fid or [scheme for scheme in self.schemes if scheme.family.family != FIXED]

    @property
    def met(self) -> bool:
        """Whether they meet everything under every adding rule asked for."""
        return all(scheme.met for scheme in self.asked)


def choose(
    out: Path,
    *,
    limits: Limits,
    adding: Sequence[str] = ADDING_RULES,
    predictor: str | None = None,
) -> Choice:
    """Return the strictest levels of a run that meet the targets, and whether the limits hold.

    `adding` names the rules to answer for; `predictor` is by default the first of the run.

    Raises
    ------
    DataError
        If the folder holds no run, or a file of it is missing or broken.
    SettingsError
        If the run lacks what is asked for; the message names the option and the way out.
    """
    manifest = read_manifest(out)
    if not all(isinstance(manifest.get(name), dict) for name in ("dataset", "settings")):
        raise DataError(f"{out} holds a run that never started; run the matrix again")
    name = _predictor(out, manifest, predictor)
    known, levels = read_levels(out, dataset=manifest["dataset"]["name"], predictor=name)
    raw = levels.get(("raw", None))
    every = Choice(
        out=out,
        manifest=manifest,
        predictor=name,
        adding=ADDING_RULES,
        limits=limits,
        raw=raw,
        raw_checks=() if raw is None else tuple(_targets(raw, limits)),
        schemes=tuple(
            _scheme(found, family=family, adding=rule, limits=limits)
            for rule in ADDING_RULES
            for family in sorted(known.values(), key=_place)
            if family.is_added and rule in family.rules
            if (found := [one for one in levels.values() if one.mechanism == family.mechanism])
        ),
        tasks=next((one.tasks for one in levels.values()), ()),
        is_current=manifest.get("code") == code_hash(),
    )
    is_attacked = any(one.after_attack for one in levels.values())
    _refuse_missing(every, adding=adding, is_attacked=is_attacked)
    schemes = tuple(one for rule in adding for one in every.schemes if one.adding == rule)
    return replace(every, adding=tuple(adding), schemes=schemes)


def _place(family: Family) -> int:
    """Return where a family is shown: FID, then fixed noise, all others as they were run."""
    return [FID, FIXED, family.name].index(family.name)


def read_levels(
    out: Path, *, dataset: str, predictor: str
) -> tuple[dict[str, Family], dict[Where, Level]]:
    """Return the mechanisms of a run, and what each level that a predictor was run on comes to.

    `dataset` is the recording of the run. Every level has all tasks of the run; raw needs no
    predictor.

    Raises
    ------
    DataError
        If a file of the run is missing or broken.
    """
    again = f"python -m evaluation.report {shlex.quote(str(out))} writes it anew"
    summary = _table(out / "summary.csv", texts=_TEXTS, numbers=_NUMBERS, way_out=again)
    if summary is None:
        raise DataError(f"{out / 'summary.csv'} is missing; {again} if the run has finished")
    blocks: dict[Where, dict[Source, dict[str, Estimate]]] = {}
    wanted = summary[summary["metric"].isin(METRIC_OF.values())]
    for row in wanted.itertuples(index=False, name=None):
        mechanism, consumer, knowledge, metric, _, _, level, *found = row
        where = mechanism, None if math.isnan(level) else level
        of = blocks.setdefault(where, {}).setdefault(Source(consumer, knowledge), {})
        of[metric] = Estimate(*found)
    linkability = _table(
        out / "linkability.csv", texts=_LINKED_TEXTS, numbers=_LINKED_NUMBERS, way_out=again
    )
    tasks = [] if linkability is None else linked_tasks(linkability)
    return families_in(summary), {
        where: Level(
            mechanism=where[0],
            level=where[1],
            numbers=_named(block.get(Source(predictor), {}), TARGETS)
            | _named(block[AS_SHARED], DESCRIPTORS),
            after_attack=_best_reconstruction(block),
            tasks=tuple(_strongest(task, where, dataset=dataset) for task in tasks),
        )
        for where, block in blocks.items()
        if AS_SHARED in block and (where[0] == "raw" or Source(predictor) in block)
    }


def _table(
    path: Path, *, texts: Sequence[str], numbers: Sequence[str], way_out: str
) -> pd.DataFrame | None:
    """Return some columns of a table, texts first; None if there is no such file."""
    columns = [*texts, *numbers]
    try:
        # A name may be "NA": only an empty number is unknown.
        return pd.read_csv(
            path,
            usecols=columns,
            dtype=dict.fromkeys(texts, str) | dict.fromkeys(numbers, float),
            keep_default_na=False,
            na_values={name: [""] for name in numbers},
        )[columns]
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(f"{path} cannot be read ({reason}); {way_out}") from None


def _best_reconstruction(block: Mapping[Source, Mapping[str, Estimate]]) -> Attacked | None:
    """Return the strongest reconstruction at a level."""
    best = strongest_of([{one: block[one].get(EXPOSURE, UNKNOWN).value for one in block}])
    if best is None:
        return None
    return Attacked(best.consumer, best.knowledge, _named(block[best], DESCRIPTORS))


def _strongest(task: LinkedTask, where: Where, *, dataset: str) -> Linked:
    """Return the strongest linker at a level, of the valid ones if there are any."""
    own = dataset_of(task.name, dataset=dataset)
    rows = task.cells.get(where, {})
    rank1 = {source: row[SUCCESS] for source, row in rows.items()}
    valid = {
        source: value
        for source, value in rank1.items()
        if rows[source]["outcome"] != WEAK and not rows[source]["invalid"]
    }
    best = strongest_of([valid]) or strongest_of([rank1])
    if best is None:
        return Linked(task.name, own, own == dataset)
    row = rows[best]
    return Linked(
        *(task.name, own, own == dataset, best.consumer, best.knowledge),
        rank1=Estimate(row[SUCCESS], row["ci_low"], row["ci_high"]),
        **{name: row[name] for name in ("chance", "outcome", "invalid")},
    )


def _named(found: Mapping[str, Estimate], names: Iterable[str]) -> dict[str, Estimate]:
    return {name: found.get(METRIC_OF[name], UNKNOWN) for name in names}


def _predictor(out: Path, manifest: Mapping[str, Any], asked: str | None) -> str:
    cells = [one["consumer"] for one in manifest["cells"] if one["kind"] == "predictor"]
    known = list(dict.fromkeys([*manifest["settings"]["predictors"], *cells]))
    if not known:
        raise SettingsError(
            f"{out} has no predictor, so that nothing is known of --max-missed; add one with "
            "the command of the run and --predictor least_squares"
        )
    if asked is not None and asked not in known:
        raise SettingsError(
            f"--predictor {asked}: {out} has {', '.join(known)}; name one of these or add it "
            "with the command of the run"
        )
    return known[0] if asked is None else asked


def _refuse_missing(choice: Choice, *, adding: Sequence[str], is_attacked: bool) -> None:
    """Refuse a question that no level of the run could answer."""
    out, have = choice.out, [scheme.adding for scheme in choice.asked]
    for rule in adding:
        if rule not in have:
            narrower = f", or ask for --adding {have[0]} alone" if have else ""
            option = f",adding={rule}" * (rule != ADDING_RULES[0])
            raise SettingsError(
                f"{out} has no level of fid with {rule} adding for {choice.predictor}; add some "
                f"with the command of the run and --mechanism fid:1..1000/10{option}{narrower}"
            )
    if choice.limits.after_attack and not is_attacked:
        raise SettingsError(
            f"--after-attack: {out} has no reconstruction attack; add one with the command of the "
            "run and --attack radial_rts, or leave it out"
        )
    if SUCCESS in choice.limits.given and not any(one.limited for one in choice.tasks):
        whose = " of its recording" * bool(choice.tasks)
        raise SettingsError(
            f"--max-rank1: {out} links nobody{whose}; add a task with the command of the run, "
            "--task rerelease and --attack shape@radial_rts, or leave it out"
        )


def _targets(level: Level, limits: Limits) -> list[Check]:
    """Return the checks that choose a level."""
    return [_check(name, limit, level.numbers[name]) for name, limit in limits.of(*TARGETS).items()]


def _privacy(level: Level, limits: Limits) -> list[Check]:
    """Return the checks at the chosen level."""
    source: Level | Attacked | None = level
    whose, why = "as shared", ""
    if limits.after_attack:
        source = attacked = level.after_attack
        if attacked is None:
            whose, why = "", "no reconstruction attack was run at this level"
        else:
            whose = f"after {attacked.attack} ({attacked.knowledge})"
    numbers = {} if source is None else source.numbers
    checks = [
        _check(name, limit, numbers.get(name, UNKNOWN), whose=whose, why=why)
        for name, limit in limits.of(*DESCRIPTORS).items()
    ]
    for one in level.tasks:
        for limit in limits.of(SUCCESS).values() if one.limited else ():
            whose = f"in {one.task} by {one.attack} ({one.knowledge})" if one.attack else one.task
            name = f"{SUCCESS}/{one.task}"
            checks.append(_check(name, limit, one.rank1, whose=whose, why=one.why_unknown))
    return checks


def _check(name: str, limit: float, found: Estimate, *, whose: str = "", why: str = "") -> Check:
    if not why and not math.isfinite(found.ci_high):
        why = "the value or its interval is unknown"
    return Check(name, limit, found, whose, why)


def _descriptors(level: Level) -> list[Estimate]:
    return [level.numbers[name] for name in DESCRIPTORS]


def _scheme(found: Iterable[Level], *, family: Family, adding: str, limits: Limits) -> Scheme:
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
    also = [
        level.level
        for level, fine in zip(levels[n_met:], meets[n_met:], strict=True)
        if fine and level.level is not None
    ]
    strictest = [
        [(one.value, one.ci_low, one.ci_high) for one in _descriptors(level)]
        for level in levels[-2:]
    ]
    return Scheme(
        adding=adding,
        family=family,
        falls=falls,
        chosen=chosen,
        stricter=stricter,
        also_meets=tuple(also),
        is_saturated=len(strictest) > 1 and strictest[0] == strictest[1],
        checks=() if chosen is None else (*_targets(chosen, limits), *_privacy(chosen, limits)),
        missed=() if stricter is None else tuple(_targets(stricter, limits)),
    )
