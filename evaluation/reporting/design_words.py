"""The answer of `evaluation.design` in words and as JSON, and the command that looks closer."""

from __future__ import annotations

import math
import shlex
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

from evaluation.analysis.families import FID, FIXED
from evaluation.analysis.keys import level_text
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, SUCCESS
from evaluation.reporting.announcements import same_run
from evaluation.reporting.table import estimated
from evaluation.verdict.choose_level import ASKED, METRIC_OF, TARGETS
from isac_track.intervals import Estimate

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from evaluation.analysis.families import Family
    from evaluation.verdict.choose_level import Check, Choice, Level, Scheme

_ANSWERED = ("met", "chosen", "stricter", "also_meets", "is_saturated")
_CHECKED = ("name", "limit", "measured", "status")
_UNMET = {"not met": "exceeds the limits of", "cannot say": "cannot be judged by"}
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
        "raw": _plain(choice.raw),
        "schemes": [
            {
                "adding": one.adding,
                "family": one.name,
                **{name: _plain(getattr(one, name)) for name in _ANSWERED},
                "checks": [
                    _plain({name: getattr(check, name) for name in _CHECKED})
                    | {"reason": reason(check)}
                    for check in one.checks
                ],
                "reasons": reasons(one),
            }
            for one in choice.schemes
        ],
        "refine": closer(choice),
        "notes": notes(choice),
    }


def _plain(value: Any) -> Any:  # noqa: ANN401 - what JSON has
    """Return a level, or what it holds, as plain values; what is unknown is None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if isinstance(value, Estimate):
        value = {name: getattr(value, name) for name in ("value", "ci_low", "ci_high")}
    if is_dataclass(value):
        held = {one.name: getattr(value, one.name) for one in fields(value)}
        value = {}
        for name, of in held.items():
            value |= of if name == "numbers" else {name: of}
    return {name: _plain(of) for name, of in value.items()} if isinstance(value, dict) else value


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
    extreme, opposite = ("smallest", "largest") if scheme.falls else ("largest", "smallest")
    symbol, chosen, failed = _symbol(scheme), _at(scheme, scheme.chosen), ""
    if scheme.stricter is not None:
        failed = f"{_at(scheme, scheme.stricter)} does not ({'; '.join(_reasons(scheme.missed))})"
    if scheme.chosen is None:
        found = f"no {symbol} of the run meets the targets, not even the {opposite}: {failed}"
    elif failed:
        found = f"{chosen} is the {extreme} that meets the targets; {failed}"
    else:
        found = f"{chosen} meets the targets and is the {extreme} of the run"
        same = " (stricter ones would share the same: every sample has the full error)"
        found += same * scheme.is_saturated
    also = (
        f"{symbol} = {', '.join(map(level_text, scheme.also_meets))} would meet the targets, but a "
        "less strict level does not: not chosen, it may be chance"
    )
    return [found, *[also] * bool(scheme.also_meets), *_reasons(scheme.checks)]


def _reasons(checks: Iterable[Check]) -> list[str]:
    return [reason(check) for check in checks if check.status != "met"]


def _symbol(scheme: Scheme) -> str:
    """Return what the level of a mechanism is called."""
    return _LEVEL_NAMES.get(scheme.family.family, "level")


def _at(scheme: Scheme, level: Level | None) -> str:
    return f"{_symbol(scheme)} = {level_text(level.level) or 'none'}" if level else ""


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
        f"{text} {_listed(names)}"
        for status, text in _UNMET.items()
        if (names := [check.name for check in scheme.checks if check.status == status])
    ]
    return f"{_name(scheme)} meets the targets but {' and '.join(what)}"


def _listed(names: Sequence[str]) -> str:
    """Return limits by name, in words: PLR, MEL and rank 1 in split, rerelease."""
    heads = ", ".join(METRICS[METRIC_OF[name]].head for name in names if "/" not in name)
    tasks = ", ".join(name.partition("/")[2] for name in names if "/" in name)
    return " and ".join(filter(None, [heads, tasks and f"rank 1 in {tasks}"]))


def _name(scheme: Scheme) -> str:
    return f"{scheme.name} {_at(scheme, scheme.chosen)} ({scheme.adding})"


def notes(choice: Choice) -> list[str]:
    """Return what else is to be known of the run and of the question."""
    dataset, schemes = choice.manifest["dataset"], choice.schemes
    has_fixed = {scheme.adding for scheme in schemes if scheme.name == FIXED}
    missing = " or ".join(rule for rule in choice.adding if rule not in has_fixed)
    undeclared = ", ".join(dict.fromkeys(one.name for one in schemes if not one.family.adding))
    raw_misses = "; ".join(_reasons(choice.raw_checks))
    crowds = ", ".join(one.task for one in choice.tasks if not one.limited)
    found = {
        dataset.get("notice") or "the tracks are simulated": dataset["simulated"],
        f"the run has no level of fixed with {missing} adding": missing,
        f"{undeclared}: declares no adding rule, so that it is judged under both": undeclared,
        f"raw positions, without any added error, miss the targets themselves ({raw_misses}): no "
        "level can be expected to meet them": raw_misses
        and any(scheme.chosen is None for scheme in schemes),
        f"--max-rank1 does not limit {crowds}: simulated people": crowds
        and SUCCESS in choice.limits.given,
        "the run is of another version of the code, which would drop its finished cells; the "
        "command below fills a new folder": not choice.is_current and closer(choice),
    }
    return [text for text, is_so in found.items() if is_so]


def closer(choice: Choice) -> str | None:
    """Return the command that adds levels where the answer turns; None if none would help.

    A run of another version of the code is left alone; its new folder needs what the levels are
    compared with.
    """
    hopeless = any(check.status != "met" for check in choice.raw_checks)
    ends = [_ends(scheme, hopeless=hopeless) for scheme in choice.schemes]
    if not any(ends):
        return None
    words = ["python", "-m", "evaluation.matrix", *same_run(choice.manifest)]
    words += [] if choice.is_current else ["--mechanism", "raw"]
    for scheme, at in zip(choice.schemes, ends, strict=True):
        one = scheme.chosen or scheme.stricter
        if at or not (choice.is_current or one is None):
            alone = "" if one is None or one.level is None else f"{one.level:.12g}"
            words += ["--mechanism", _spec(scheme.family, at or alone)]
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
