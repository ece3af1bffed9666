"""Choose a level for a site: `python -m evaluation.design --max-missed 0.20 OUT`.

The targets of utility choose a level of the run, the limits of privacy are judged there. A target
or limit is met only if the upper end of the interval meets it; where that cannot be said, it is
not met. Nothing is interpolated, and everything is read from the files of the run.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from evaluation.analysis.levels import SHOWN, number
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.experiment.fingerprint import code_hash
from evaluation.reporting.design_tables import show, to_json
from evaluation.reporting.design_words import chance, choice, closer, notes, sentence, spec
from evaluation.runs.folder import read_manifest
from evaluation.verdict.design_levels import (
    METRIC_OF,
    WEAK,
    Attacked,
    Level,
    Linked,
    Measured,
    read_levels,
)
from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code
from isac_track.errors import DataError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.analysis.keys import Where

Status: TypeAlias = Literal["met", "not met", "cannot say"]

_FAMILIES = ("fid", "fixed")
_TARGETS = ("missed", "false_alarm")
_LIMITS = {
    "missed": ("X", "missed conflicts, a fraction of all conflicts"),
    "false_alarm": ("X", "false alarms, a fraction of the scenes without a conflict"),
    "plr": ("X", "PLR, a fraction"),
    "ael": ("S", "AEL, in s"),
    "mel": ("S", "MEL, in s"),
    "rank1": (
        "X",
        "rank 1 of the strongest attack, a fraction: in every task but those of simulated people",
    ),
}
_EPILOG = """\
The smallest eta of the run (for fixed noise the largest d_sigma) that meets --max-missed, and
--max-false-alarm if given, is chosen, provided that every larger eta of the run meets them as
well. The other limits are judged at that level. All are met only if the upper end of the 95 %
interval is at or below them. No level is interpolated.

exit codes: 0 FID meets everything under every adding rule asked for; 1 it does not, or it cannot
be said; 2 wrong usage or data. Fixed noise is shown beside it and does not change the exit code.

examples:
  python -m evaluation.design --max-missed 0.20 runs/students03-paper-0
  python -m evaluation.design --max-missed 0.20 --max-plr 0.5 --after-attack \\
      --adding independent runs/students03-paper-0
  python -m evaluation.design --max-missed 0.25 --max-rank1 0.1 --json OUT | jq .met
"""


@dataclass(frozen=True, slots=True)
class Limits:
    """What is asked for; None: not limited.

    Raises
    ------
    SettingsError
        For a fraction beyond 0..1, a time that is negative or not finite, or `after_attack`
        without a limit that it is about.
    """

    missed: float
    """Fraction of the conflicts; with `false_alarm` it chooses the level."""
    false_alarm: float | None = None
    """Fraction of the scenes without a conflict."""
    plr: float | None = None
    """Fraction."""
    ael: float | None = None
    """s"""
    mel: float | None = None
    """s"""
    rank1: float | None = None
    """Fraction, for the strongest attack of every task of the recording."""
    after_attack: bool = False
    """Whether `plr`, `ael` and `mel` hold after the best reconstruction, not as shared."""

    def __post_init__(self) -> None:
        for name, limit in self.given(*_LIMITS).items():
            option = f"--max-{name.replace('_', '-')}"
            if name in ("ael", "mel"):
                if not 0.0 <= limit < math.inf:
                    raise SettingsError(f"{option} is a time in s, 0 or more, got {limit:g}")
            elif not 0.0 <= limit <= 1.0:
                raise SettingsError(
                    f"{option} is a fraction from 0 to 1 (0.2 for 20 %), got {limit:g}"
                )
        if self.after_attack and not self.given(*DESCRIPTORS):
            raise SettingsError(
                "--after-attack says where --max-plr, --max-ael and --max-mel hold; give one"
            )

    def given(self, *names: str) -> dict[str, float]:
        """Return those of some limits that are given."""
        limits = {name: getattr(self, name) for name in names}
        return {name: limit for name, limit in limits.items() if limit is not None}


@dataclass(frozen=True, slots=True)
class Check:
    """One target or limit at one level."""

    name: str
    """`missed`, `false_alarm`, `plr`, `ael`, `mel` or `rank1/TASK`."""
    limit: float
    measured: Measured
    status: Status
    reason: str
    """Why it is not met; empty if it is."""


@dataclass(frozen=True, slots=True)
class Scheme:
    """The answer for one mechanism under one adding rule."""

    adding: str
    family: str
    met: bool
    """Whether there is a level that meets the targets, and every limit holds there."""
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
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Answer:
    """What the command says: the keys of its JSON."""

    met: bool
    """Whether FID meets everything under every adding rule asked for."""
    answer: str
    out: str
    dataset: str
    simulated: bool
    scenes: int
    seed: int
    predictor: str
    adding: tuple[str, ...]
    limits: Limits
    raw: Level | None
    schemes: tuple[Scheme, ...]
    refine: str | None
    """Command that adds levels between those chosen and their stricter neighbours."""
    notes: tuple[str, ...]


def design(
    out: Path,
    *,
    limits: Limits,
    adding: Sequence[str] = tuple(ADDING_SUFFIX),
    predictor: str | None = None,
) -> Answer:
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
    if not all(isinstance(manifest.get(part), dict) for part in ("dataset", "settings")):
        raise DataError(f"{out} holds a run that never started; run the matrix again")
    identity, dataset = manifest["identity"], manifest["dataset"]
    name = _predictor(out, manifest, predictor)
    levels = read_levels(out, dataset=dataset["name"], predictor=name)
    _refuse_missing(out, levels, limits=limits, adding=adding, predictor=name)
    schemes = tuple(
        _scheme(found, family=family, adding=rule, limits=limits)
        for rule in adding
        for family in _FAMILIES
        if (found := _levels(levels, family + ADDING_SUFFIX[rule]))
    )
    raw = levels.get(("raw", None))
    raw_misses = [] if raw is None else _reasons(_targets(raw, limits))
    is_current = manifest.get("code") == code_hash()
    refine = closer(out, manifest, schemes, hopeless=bool(raw_misses), is_current=is_current)
    crowds = [one.task for one in next(iter(levels.values())).tasks if not one.limited]
    crowds = [] if limits.rank1 is None else crowds
    said = notes(dataset, schemes, raw_misses=raw_misses, crowds=crowds)
    if refine and not is_current:
        said.append(
            "the run is of another version of the code, which would drop its finished cells; "
            "the command below fills a new folder"
        )
    fid = [scheme for scheme in schemes if scheme.family == "fid"]
    return Answer(
        met=all(scheme.met for scheme in fid),
        answer=sentence(fid, limits=limits),
        out=str(out),
        dataset=dataset["name"],
        simulated=bool(dataset["simulated"]),
        scenes=identity["scenes"],
        seed=identity["seed"],
        predictor=name,
        adding=tuple(adding),
        limits=limits,
        raw=raw,
        schemes=schemes,
        refine=refine,
        notes=tuple(said),
    )


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


def _refuse_missing(
    out: Path,
    levels: Mapping[Where, Level],
    *,
    limits: Limits,
    adding: Sequence[str],
    predictor: str,
) -> None:
    """Refuse a question that no level of the run could answer."""
    have = [rule for rule, suffix in ADDING_SUFFIX.items() if _levels(levels, f"fid{suffix}")]
    for rule in adding:
        if rule not in have:
            narrower = f", or ask for --adding {have[0]} alone" if have else ""
            raise SettingsError(
                f"{out} has no level of fid with {rule} adding for {predictor}; add some with the "
                f"command of the run and --mechanism {spec('fid', '1..1000/10', rule)}{narrower}"
            )
    if limits.after_attack and not any(one.after_attack for one in levels.values()):
        raise SettingsError(
            f"--after-attack: {out} has no reconstruction attack; add one with the command of the "
            "run and --attack radial_rts, or leave it out"
        )
    tasks = next(iter(levels.values())).tasks
    if limits.rank1 is not None and not any(one.limited for one in tasks):
        raise SettingsError(
            f"--max-rank1: {out} links nobody{' of its recording' * bool(tasks)}; add a task with "
            "the command of the run, --task rerelease and --attack shape@radial_rts, or leave it "
            "out"
        )


def _levels(levels: Mapping[Where, Level], mechanism: str) -> list[Level]:
    """Return the levels of a mechanism, the least strict first: large eta, small errors."""
    found = {at: one for (name, at), one in levels.items() if name == mechanism and at is not None}
    return [found[at] for at in sorted(found, reverse=mechanism.startswith("fid"))]


def _targets(level: Level, limits: Limits) -> list[Check]:
    """Return the checks that choose a level."""
    return [
        _check(name, limit, getattr(level, name)) for name, limit in limits.given(*_TARGETS).items()
    ]


def _privacy(level: Level, limits: Limits) -> list[Check]:
    """Return the checks at the chosen level."""
    source: Level | Attacked | None = level
    whose, why = "as shared", ""
    if limits.after_attack:
        source = attacked = level.after_attack
        if attacked is None:
            why = "no reconstruction attack was run at this level"
        else:
            whose = f"after {attacked.attack} ({attacked.knowledge})"
    checks = [
        _check(name, limit, getattr(source, name, Measured()), of=whose, why=why)
        for name, limit in limits.given(*DESCRIPTORS).items()
    ]
    for one in level.tasks:
        if limits.rank1 is not None and one.limited:
            by = f"in {one.task} by {one.attack} ({one.knowledge})" if one.attack else one.task
            name = f"rank1/{one.task}"
            checks.append(_check(name, limits.rank1, one.rank1, of=by, why=_why_unknown(one)))
    return checks


def _why_unknown(one: Linked) -> str:
    """Return why a task confirms no limit; empty if it may."""
    if not one.attack:
        return "no informed or blind attack was run at this level"
    if one.invalid:
        return f"a shortcut ({one.invalid}) gives people away: no measure of the attack"
    if one.outcome == WEAK:
        return "every attack is too weak: it fails without any error, too"
    return ""


def _check(name: str, limit: float, found: Measured, *, of: str = "", why: str = "") -> Check:
    metric = METRIC_OF.get(name, "rank1")
    shown = SHOWN[metric]
    what = f"{shown.head} {of}".strip()
    if not why and not math.isfinite(found.ci_high):
        why = "the value or its interval is unknown"
    if why:
        return Check(name, limit, found, "cannot say", f"{what}: cannot say, {why}")
    if found.ci_high <= limit:
        return Check(name, limit, found, "met", "")
    text = number(metric, *astuple(found))
    excess = (found.ci_high - limit) * shown.scale
    reason = (
        f"{what} {text.value} {shown.unit} [{text.low}, {text.high}]: the upper end is "
        f"{excess:.2g} {'points' if shown.unit == '%' else shown.unit} too high"
    )
    return Check(name, limit, found, "not met", reason)


def _reasons(checks: Sequence[Check]) -> list[str]:
    return [check.reason for check in checks if check.reason]


def _scheme(levels: Sequence[Level], *, family: str, adding: str, limits: Limits) -> Scheme:
    """Return the answer for the levels of a mechanism, the least strict first."""
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
    strictest = [(one.plr, one.ael, one.mel) for one in levels[-2:]]
    is_saturated = len(strictest) > 1 and strictest[0] == strictest[1]
    checks = [] if chosen is None else [*_targets(chosen, limits), *_privacy(chosen, limits)]
    why = [] if stricter is None else _reasons(_targets(stricter, limits))
    return Scheme(
        adding=adding,
        family=family,
        met=bool(checks) and all(check.status == "met" for check in checks),
        chosen=chosen,
        stricter=stricter,
        also_meets=tuple(also),
        is_saturated=is_saturated,
        checks=tuple(checks),
        reasons=(
            choice(family, chosen, stricter, why="; ".join(why), is_saturated=is_saturated),
            *[chance(family, also)] * bool(also),
            *_reasons(checks),
        ),
    )


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    command = Parser(
        prog="python -m evaluation.design",
        description="Choose a level for a site: the smallest eta of a run that meets a target of "
        "utility, what is left of privacy there, and a plain yes or no.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = command.add_argument
    add("out", type=Path, metavar="OUT", help="folder of a run")
    for name, (unit, about) in _LIMITS.items():
        option = f"--max-{name.replace('_', '-')}"
        add(option, type=float, required=name == "missed", metavar=unit, help=about)
    add("--predictor", metavar="NAME", help="the robot's predictor (default: the run's first)")
    add(
        "--after-attack",
        action="store_true",
        help="hold PLR, AEL and MEL against the best reconstruction (highest PLR), not against "
        "what was shared",
    )
    add(
        "--adding",
        choices=[*ADDING_SUFFIX, "both"],
        default="both",
        help="adding rule to answer for (default: both, which must both hold); a network could "
        "implement only the independent one",
    )
    add("--json", action="store_true", help="print one JSON object and nothing else")
    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return exit_code(lambda: _run(parser().parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    given = {name: getattr(options, f"max_{name}") for name in _LIMITS}
    answer = design(
        options.out,
        limits=Limits(**given, after_attack=options.after_attack),
        adding=tuple(ADDING_SUFFIX) if options.adding == "both" else (options.adding,),
        predictor=options.predictor,
    )
    if options.json:
        sys.stdout.write(f"{to_json(answer)}\n")
    else:
        show(answer)
    return DONE if answer.met else LIMIT_NOT_MET


if __name__ == "__main__":
    sys.exit(main())
