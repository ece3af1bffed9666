"""The answer of `evaluation.design` in words and as JSON, and the command that looks closer."""

from __future__ import annotations

import math
import shlex
from typing import TYPE_CHECKING, Any

from evaluation.analysis.families import FID, FIXED
from evaluation.analysis.keys import level_text
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, SUCCESS
from evaluation.experiment.presets import PRESETS
from evaluation.reporting.table import estimated
from evaluation.verdict.choose_level import ASKED, METRIC_OF, TARGETS
from isac_track.config import StageSettings
from isac_track.datasets.registry import KNOWN

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from evaluation.analysis.families import Family
    from evaluation.verdict.choose_level import Check, Choice, Level, Scheme
    from isac_track.intervals import Estimate

_LEVEL_NAMES = {FID: "eta", FIXED: "d_sigma"}


def to_json(choice: Choice) -> dict[str, Any]:
    """Return the answer as plain values; what is unknown is None."""
    identity, dataset = choice.manifest["identity"], choice.manifest["dataset"]
    limits: dict[str, Any] = {name: choice.limits.given.get(name) for name in ASKED}
    return {
        "met": choice.met,
        "answer": sentence(choice),
        "out": str(choice.out),
        "dataset": dataset["name"],
        "simulated": bool(dataset["simulated"]),
        "scenes": identity["scenes"],
        "seed": identity["seed"],
        "predictor": choice.predictor,
        "adding": list(choice.adding),
        "limits": limits | {"after_attack": choice.limits.after_attack},
        "raw": _level_json(choice.raw),
        "schemes": [
            {
                "adding": one.adding,
                "family": one.name,
                "met": one.met,
                "chosen": _level_json(one.chosen),
                "stricter": _level_json(one.stricter),
                "also_meets": list(one.also_meets),
                "is_saturated": one.is_saturated,
                "checks": [_check_json(check) for check in one.checks],
                "reasons": reasons(one),
            }
            for one in choice.schemes
        ],
        "refine": closer(choice),
        "notes": notes(choice),
    }


def _plain(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def _number(one: Estimate) -> dict[str, float | None]:
    return {name: _plain(getattr(one, name)) for name in ("value", "ci_low", "ci_high")}


def _level_json(level: Level | None) -> dict[str, Any] | None:
    if level is None:
        return None
    after = level.after_attack
    return {
        "mechanism": level.mechanism,
        "level": level.level,
        **{name: _number(one) for name, one in level.numbers.items()},
        "after_attack": after
        and {
            "attack": after.attack,
            "knowledge": after.knowledge,
            **{name: _number(one) for name, one in after.numbers.items()},
        },
        "tasks": [
            {
                "task": one.task,
                "dataset": one.dataset,
                "limited": one.limited,
                "attack": one.attack,
                "knowledge": one.knowledge,
                SUCCESS: _number(one.rank1),
                "chance": _plain(one.chance),
                "outcome": one.outcome,
                "invalid": one.invalid,
            }
            for one in level.tasks
        ],
    }


def _check_json(check: Check) -> dict[str, Any]:
    return {
        "name": check.name,
        "limit": check.limit,
        "measured": _number(check.measured),
        "status": check.status,
        "reason": reason(check),
    }


def reason(check: Check) -> str:
    """Return why a target or limit is not met; empty if it is."""
    if check.status == "met":
        return ""
    metric = METRIC_OF.get(check.name, SUCCESS)
    shown = METRICS[metric]
    what = f"{shown.head} {check.whose}".strip()
    if check.why_unknown:
        return f"{what}: cannot say, {check.why_unknown}"
    text = estimated(metric, check.measured)
    excess = (check.measured.ci_high - check.limit) * shown.scale
    return (
        f"{what} {text.text} {shown.unit} {text.interval}: the upper end is "
        f"{excess:.2g} {'points' if shown.unit == '%' else shown.unit} too high"
    )


def reasons(scheme: Scheme) -> list[str]:
    """Return how the level was chosen, why not a stricter one, and which limits do not hold."""
    found = [_choice(scheme)]
    if scheme.also_meets:
        named = ", ".join(map(level_text, scheme.also_meets))
        found.append(
            f"{_symbol(scheme)} = {named} would meet the targets, but a less strict "
            "level does not: not chosen, it may be chance"
        )
    return [*found, *_reasons(scheme.checks)]


def _reasons(checks: Iterable[Check]) -> list[str]:
    return [reason(check) for check in checks if check.status != "met"]


def _choice(scheme: Scheme) -> str:
    extreme, opposite = ("smallest", "largest") if scheme.falls else ("largest", "smallest")
    failed = ""
    if scheme.stricter is not None:
        why = "; ".join(_reasons(scheme.missed))
        failed = f"{_at(scheme, scheme.stricter)} does not ({why})"
    if scheme.chosen is None:
        none = f"no {_symbol(scheme)} of the run meets the targets"
        return f"{none}, not even the {opposite}: {failed}"
    chosen = _at(scheme, scheme.chosen)
    if failed:
        return f"{chosen} is the {extreme} that meets the targets; {failed}"
    same = " (stricter ones would share the same: every sample has the full error)"
    same *= scheme.is_saturated
    return f"{chosen} meets the targets and is the {extreme} of the run{same}"


def _symbol(scheme: Scheme) -> str:
    """Return what the level of a mechanism is called."""
    return _LEVEL_NAMES.get(scheme.family.family, "level")


def _at(scheme: Scheme, level: Level) -> str:
    return f"{_symbol(scheme)} = {level_text(level.level) or 'none'}"


def sentence(choice: Choice) -> str:
    """Return the plain answer."""
    asked, limits = choice.asked, choice.limits
    if not choice.met:
        # What fails comes first.
        return f"No: {'; '.join(map(_said, sorted(asked, key=lambda scheme: scheme.met)))}."
    rates = {name: f"{100.0 * limit:.4g} %" for name, limit in limits.of(*TARGETS).items()}
    target = f"at most {rates['missed']} of the conflicts are missed"
    if "false_alarm" in rates:
        target += f" at no more than {rates['false_alarm']} false alarms"
    is_limited = limits.of(*DESCRIPTORS, SUCCESS)
    privacy = ", and every privacy limit holds" if is_limited else "; no privacy limit was given"
    return f"Yes: with {' and '.join(map(_name, asked))} {target}{privacy}."


def _said(scheme: Scheme) -> str:
    """Return what a scheme comes to where not all schemes meet everything."""
    if scheme.chosen is None:
        name = _LEVEL_NAMES.get(scheme.name, f"level of {scheme.name}")
        return f"no {name} of the run meets the targets with {scheme.adding} adding"
    if scheme.met:
        return f"{_name(scheme)} meets everything"
    what = [
        f"{words} {_listed(names)}"
        for status, words in (
            ("not met", "exceeds the limits of"),
            ("cannot say", "cannot be judged by"),
        )
        if (names := [check.name for check in scheme.checks if check.status == status])
    ]
    return f"{_name(scheme)} meets the targets but {' and '.join(what)}"


def _listed(names: Sequence[str]) -> str:
    """Return limits by name, in words: PLR, MEL and rank 1 in split, rerelease."""
    words = [METRICS[METRIC_OF[name]].head for name in names if "/" not in name]
    tasks = [name.partition("/")[2] for name in names if "/" in name]
    ranks = [f"rank 1 in {', '.join(tasks)}"] if tasks else []
    return " and ".join([*([", ".join(words)] if words else []), *ranks])


def _name(scheme: Scheme) -> str:
    level = "" if scheme.chosen is None else _at(scheme, scheme.chosen)
    return f"{scheme.name} {level} ({scheme.adding})"


def notes(choice: Choice) -> list[str]:
    """Return what else is to be known of the run and of the question."""
    dataset, schemes = choice.manifest["dataset"], choice.schemes
    found = []
    if dataset["simulated"]:
        found.append(dataset.get("notice") or "the tracks are simulated")
    has_fixed = {scheme.adding for scheme in schemes if scheme.name == FIXED}
    missing = [rule for rule in choice.adding if rule not in has_fixed]
    if missing:
        found.append(f"the run has no level of fixed with {' or '.join(missing)} adding")
    undeclared = dict.fromkeys(one.name for one in schemes if not one.family.adding)
    if undeclared:
        found.append(
            f"{', '.join(undeclared)}: declares no adding rule, so that it is judged under both"
        )
    raw_misses = _reasons(choice.raw_checks)
    if raw_misses and any(scheme.chosen is None for scheme in schemes):
        found.append(
            f"raw positions, without any added error, miss the targets themselves "
            f"({'; '.join(raw_misses)}): no level can be expected to meet them"
        )
    crowds = [one.task for one in choice.tasks if not one.limited]
    if crowds and SUCCESS in choice.limits.given:
        found.append(f"--max-rank1 does not limit {', '.join(crowds)}: simulated people")
    if not choice.is_current and closer(choice):
        found.append(
            "the run is of another version of the code, which would drop its finished cells; "
            "the command below fills a new folder"
        )
    return found


def closer(choice: Choice) -> str | None:
    """Return the command that adds levels where the answer turns; None if none would help.

    A run of another version of the code is left alone; its new folder needs what the levels are
    compared with.
    """
    hopeless = any(check.status != "met" for check in choice.raw_checks)
    ends = [_ends(scheme, hopeless=hopeless) for scheme in choice.schemes]
    if not any(ends):
        return None
    words = ["python", "-m", "evaluation.matrix", *_same_run(choice.manifest)]
    words += [] if choice.is_current else ["--mechanism", "raw"]
    for scheme, at in zip(choice.schemes, ends, strict=True):
        one = scheme.chosen or scheme.stricter
        if at:
            words += ["--mechanism", _spec(scheme.family, at)]
        elif not choice.is_current and one is not None:
            level = "" if one.level is None else f"{one.level:.12g}"
            words += ["--mechanism", _spec(scheme.family, level)]
    out = choice.out
    folder = out if choice.is_current else out.with_name(f"{out.resolve().name}-closer")
    return shlex.join([*words, "--out", str(folder)])


def _spec(family: Family, levels: str) -> str:
    """Return a mechanism at some levels as the matrix takes it."""
    if not levels:
        return family.mechanism
    parameters = family.mechanism.removeprefix(family.family).removeprefix(":")
    return f"{family.family}:{levels}" + f",{parameters}" * bool(parameters)


def _ends(scheme: Scheme, *, hopeless: bool) -> str:
    """Return where to look closer, as LOW..HIGH/COUNT; empty: nowhere."""
    chosen = scheme.chosen.level if scheme.chosen else None
    stricter = scheme.stricter.level if scheme.stricter else None
    if chosen is not None and stricter is not None:
        low, high = sorted((chosen, stricter))
    elif scheme.family.family not in _LEVEL_NAMES:  # nobody knows where its levels end
        return ""
    elif stricter is not None and not hopeless:  # all are too strict
        low, high = (stricter, 100 * stricter) if scheme.falls else (stricter / 10, stricter)
    elif chosen is not None and not scheme.is_saturated:  # none is too strict
        low, high = (chosen / 100, chosen) if scheme.falls else (chosen, 2 * chosen)
    else:
        return ""
    return f"{low:.12g}..{high:.12g}/10"


def _same_run(manifest: Mapping[str, Any]) -> list[str]:
    """Return the options that give the identity and the consumers of a run again."""
    identity, settings, dataset = (manifest[key] for key in ("identity", "settings", "dataset"))
    name, usual_stages = settings["preset"], StageSettings().flat()
    usual = PRESETS.get(name, PRESETS["paper"])
    words = ["--preset", name] if name in PRESETS and name != "paper" else []
    if dataset["name"] in KNOWN:
        words += ["--dataset", dataset["name"]]
    else:
        words += ["--dataset", dataset["path"], "--format", dataset["format"]]
        words += [] if identity.get("fps") is None else ["--fps", str(identity["fps"])]
    words += [] if identity["scenes"] == usual.scenes else ["--scenes", str(identity["scenes"])]
    words += ["--seed", str(identity["seed"])] if identity["seed"] else []
    for option, default in (
        ("predictor", usual.predictors),
        ("attack", usual.attacks),
        ("task", usual.tasks),
    ):
        used = settings.get(f"{option}s", [])
        if set(used) != set(default):
            for value in used or ["none"]:
                words += [f"--{option}", value]
    for key, value in settings.get("stages", {}).items():
        if usual_stages.get(key, value) != value:
            words += ["--set", f"{key}={value}"]
    return words
