"""The answer of `evaluation.design` in words, and the command that looks closer."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

from evaluation.analysis.levels import SHOWN, level_text
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.experiment.presets import PRESETS
from isac_track.config import StageSettings
from isac_track.datasets.registry import KNOWN

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from evaluation.design import Limits, Scheme
    from evaluation.verdict.design_levels import Level

_LEVEL_NAMES = {"fid": "eta", "fixed": "d_sigma"}


def choice(
    family: str, chosen: Level | None, stricter: Level | None, *, why: str, is_saturated: bool
) -> str:
    """Return how the level was chosen, and why not a stricter one."""
    symbol = _LEVEL_NAMES[family]
    extreme, opposite = ("smallest", "largest") if family == "fid" else ("largest", "smallest")
    failed = "" if stricter is None else f"{_at(family, stricter)} does not ({why})"
    if chosen is None:
        return f"no {symbol} of the run meets the targets, not even the {opposite}: {failed}"
    if failed:
        return f"{_at(family, chosen)} is the {extreme} that meets the targets; {failed}"
    same = " (stricter ones would share the same: every sample has the full error)" * is_saturated
    return f"{_at(family, chosen)} meets the targets and is the {extreme} of the run{same}"


def chance(family: str, also: Sequence[float]) -> str:
    """Return why levels that meet the targets were not chosen."""
    named = ", ".join(map(level_text, also))
    why = "would meet the targets, but a less strict level does not: not chosen, it may be chance"
    return f"{_LEVEL_NAMES[family]} = {named} {why}"


def _at(family: str, level: Level) -> str:
    return f"{_LEVEL_NAMES[family]} = {level_text(level.level)}"


def sentence(fid: Sequence[Scheme], *, limits: Limits) -> str:
    """Return the plain answer."""
    if not all(scheme.met for scheme in fid):
        # What fails comes first.
        return f"No: {'; '.join(map(_said, sorted(fid, key=lambda scheme: scheme.met)))}."
    rates = {
        name: f"{100.0 * limit:.4g} %"
        for name, limit in limits.given("missed", "false_alarm").items()
    }
    target = f"at most {rates['missed']} of the conflicts are missed"
    if "false_alarm" in rates:
        target += f" at no more than {rates['false_alarm']} false alarms"
    is_limited = limits.given(*DESCRIPTORS, "rank1")
    kept = ", and every privacy limit holds" if is_limited else "; no privacy limit was given"
    return f"Yes: with {' and '.join(map(_name, fid))} {target}{kept}."


def _said(scheme: Scheme) -> str:
    """Return what a scheme comes to where not all schemes meet everything."""
    if scheme.chosen is None:
        return f"no eta of the run meets the targets with {scheme.adding} adding"
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
    words = [SHOWN[name].head for name in names if "/" not in name]
    tasks = [name.partition("/")[2] for name in names if "/" in name]
    ranks = [f"rank 1 in {', '.join(tasks)}"] if tasks else []
    return " and ".join([*([", ".join(words)] if words else []), *ranks])


def _name(scheme: Scheme) -> str:
    level = "" if scheme.chosen is None else _at(scheme.family, scheme.chosen)
    return f"{scheme.family} {level} ({scheme.adding})"


def notes(
    dataset: Mapping[str, Any],
    schemes: Sequence[Scheme],
    *,
    raw_misses: Sequence[str],
    crowds: Sequence[str],
) -> list[str]:
    """Return what else is to be known of the run and of the question.

    `raw_misses` is why raw itself misses the targets; `crowds` are tasks of simulated people that
    a limit of rank 1 might be thought to be about.
    """
    said = []
    if dataset["simulated"]:
        said.append(dataset.get("notice") or "the tracks are simulated")
    has_fixed = {scheme.adding for scheme in schemes if scheme.family == "fixed"}
    missing = dict.fromkeys(one.adding for one in schemes if one.adding not in has_fixed)
    if missing:
        said.append(f"the run has no level of fixed with {' or '.join(missing)} adding")
    if raw_misses and any(scheme.chosen is None for scheme in schemes):
        said.append(
            f"raw positions, without any added error, miss the targets themselves "
            f"({'; '.join(raw_misses)}): no level can be expected to meet them"
        )
    if crowds:
        said.append(f"--max-rank1 does not limit {', '.join(crowds)}: simulated people")
    return said


def closer(
    out: Path,
    manifest: Mapping[str, Any],
    schemes: Sequence[Scheme],
    *,
    hopeless: bool,
    is_current: bool,
) -> str | None:
    """Return the command that adds levels where the answer turns; None if none would help.

    `hopeless`: raw misses the targets itself. A run of another version of the code (not
    `is_current`) is left alone; its new folder needs what the levels are compared with.
    """
    ends = [_ends(scheme, hopeless=hopeless) for scheme in schemes]
    if not any(ends):
        return None
    words = ["python", "-m", "evaluation.matrix", *_same_run(manifest)]
    words += [] if is_current else ["--mechanism", "raw"]
    for scheme, at in zip(schemes, ends, strict=True):
        one = scheme.chosen or scheme.stricter
        if at:
            words += ["--mechanism", spec(scheme.family, at, scheme.adding)]
        elif not is_current and one is not None:
            words += ["--mechanism", spec(scheme.family, f"{one.level:.12g}", scheme.adding)]
    folder = out if is_current else out.with_name(f"{out.resolve().name}-closer")
    return shlex.join([*words, "--out", str(folder)])


def spec(family: str, levels: str, adding: str) -> str:
    """Return a mechanism as the matrix takes it."""
    return f"{family}:{levels}" + f",adding={adding}" * bool(ADDING_SUFFIX[adding])


def _ends(scheme: Scheme, *, hopeless: bool) -> str:
    """Return where to look closer, as LOW..HIGH/COUNT; empty: nowhere."""
    chosen = scheme.chosen.level if scheme.chosen else None
    stricter = scheme.stricter.level if scheme.stricter else None
    is_fid = scheme.family == "fid"
    if chosen is not None and stricter is not None:
        low, high = sorted((chosen, stricter))
    elif stricter is not None and not hopeless:  # all are too strict
        low, high = (stricter, 100 * stricter) if is_fid else (stricter / 10, stricter)
    elif chosen is not None and not scheme.is_saturated:  # none is too strict
        low, high = (chosen / 100, chosen) if is_fid else (chosen, 2 * chosen)
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
