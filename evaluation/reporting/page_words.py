"""What the figures of the page are called, and what they show, in words and numbers."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.levels import SHOWN, is_attack, level_text
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.experiment.presets import SHARED
from evaluation.reporting.figures.page_figures import (
    compared_levels,
    dissociation_points,
    headline_lines,
    headline_rule,
    is_control,
    strongest_link,
    strongest_reconstruction,
)
from evaluation.reporting.figures.sweeps import FID, FIXED, RATE
from evaluation.reporting.figures.track_gallery import leak_shares
from isac_track.config import StageSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    import pandas as pd

    from evaluation.analysis.levels import LinkedTask
    from evaluation.reporting.figures.sweeps import Scheme

_PERCENT = 100.0
_COMMANDS = ("matrix.py", "isac-track", "__main__.py")


@dataclass(frozen=True, slots=True)
class Words:
    """Title of a figure, and its text alternative."""

    title: str
    text: str


def words(
    name: str,
    *,
    summary: pd.DataFrame,
    tasks: Sequence[LinkedTask],
    gallery: pd.DataFrame | None,
    dataset: str,
) -> Words:
    """Return the words of a figure by its file name.

    Parameters
    ----------
    name : str
        Of the file, without its ending.
    summary : DataFrame
        As in `summary.csv`.
    tasks : sequence of LinkedTask
        As `page_figures.tasks_of` returns them.
    gallery : DataFrame or None
        As `page_gallery.read_gallery` returns it.
    dataset : str
        Of the run.
    """
    said: dict[str, Callable[[], tuple[str, str]]] = {
        "headline": lambda: (
            "What the descriptor says, and what an adversary gets",
            _headline(summary, tasks, dataset=dataset),
        ),
        "fid_threshold": lambda: (
            f"Missed conflicts, PLR and exposure over the level: {FID.title}",
            _sweep(summary, FID, dataset=dataset),
        ),
        "fixed_error": lambda: (
            f"Missed conflicts, PLR and exposure over the level: {FIXED.title}",
            _sweep(summary, FIXED, dataset=dataset),
        ),
        "operating_points": lambda: (
            "Operating points: each descriptor as shared against missed conflicts",
            _plane(summary, dataset=dataset),
        ),
        "after_attack": lambda: (
            "PLR as shared and after each attack, over the level",
            _after(summary, dataset=dataset),
        ),
        "linkability": lambda: (
            "Rank 1 of the strongest attacks over the level, task by task",
            _linked(tasks),
        ),
        "false_alarms": lambda: (
            "Missed conflicts against false alarms",
            _curves(summary, dataset=dataset),
        ),
    }
    if gallery is not None:
        said["track_gallery"] = lambda: ("Tracks: true, shared and rebuilt", _gallery(gallery))
    kind, _, of = name.partition("-")
    task = next((one for one in tasks if one.name == of), None)
    if task is not None and kind == "heat_map":
        return Words(f"{of}: who links at which level", _heat(task))
    if task is not None and kind == "dissociation":
        return Words(
            f"{of}: rank 1 over each descriptor, controls marked",
            _dissociation(summary, task, dataset=dataset),
        )
    return Words(*said[name]()) if name in said else Words(name, "")


def command(manifest: Mapping[str, Any]) -> str:
    """Return the command that makes the run again.

    The one that was given, with the data set and the seed named in any case; of a run that was
    started from Python one that names all of its axes.
    """
    given = [str(word) for word in manifest["environment"].get("command", ())]
    if given and Path(given[0]).name in _COMMANDS:
        options = [word for word in given[1:] if word != "matrix"]
    else:
        options = _all_options(manifest)
    dataset, settings = manifest["dataset"], manifest["settings"]
    if not _has(options, "--dataset"):
        options += ["--dataset", str(dataset["name"])]
    if not _has(options, "--seed"):
        options += ["--seed", str(settings["seed"])]
    return shlex.join(["python", "-m", "evaluation.matrix", *options])


def _has(options: Iterable[str], name: str) -> bool:
    return any(word == name or word.startswith(f"{name}=") for word in options)


def _all_options(manifest: Mapping[str, Any]) -> list[str]:
    settings = manifest["settings"]
    options = ["--preset", str(settings["preset"]), "--scenes", str(settings["scenes"])]
    for axis, name in (
        ("mechanisms", "--mechanism"),
        ("predictors", "--predictor"),
        ("attacks", "--attack"),
        ("tasks", "--task"),
    ):
        for spec in settings[axis] or (["none"] if axis != "mechanisms" else []):
            options += [name, str(spec)]
    usual = StageSettings().flat()
    for key, value in settings["stages"].items():
        if usual.get(key) != value:
            options += ["--set", f"{key}={value}"]
    return options


def _headline(summary: pd.DataFrame, tasks: Sequence[LinkedTask], *, dataset: str) -> str:
    rule = headline_rule(summary)
    if rule is None:
        return ""
    parts = []
    for scheme in (FID, FIXED):
        said = [
            f"{label} {span}"
            for label, rows in headline_lines(summary, tasks, dataset=dataset).values()
            if (span := _span(rows, f"{scheme.name}{ADDING_SUFFIX[rule]}", scheme, "plr"))
        ]
        if said:
            parts.append(f"{scheme.title}: {'; '.join(said)}.")
    return f"Three lines over the level, {rule} adding. {' '.join(parts)}"


def _span(rows: pd.DataFrame, mechanism: str, scheme: Scheme, metric: str) -> str:
    """Return the ends of a line: `18.7 % at 1, 51.9 % at 1e+06`."""
    of = rows[(rows["mechanism"] == mechanism) & rows["level"].notna()].sort_values("level")
    of = of[np.isfinite(of["value"])]
    if of.empty:
        return ""
    shown = SHOWN[metric]
    symbol, unit = ("η = ", "") if scheme.log else ("", " m")
    ends = of.iloc[[0, -1]] if len(of) > 1 else of
    return " to ".join(
        f"{shown.scale * row['value']:.{shown.digits}f} {shown.unit} at "
        f"{symbol}{level_text(row['level'])}{unit}"
        for row in ends.to_dict("records")
    )


def _ours(summary: pd.DataFrame, dataset: str) -> pd.DataFrame:
    return summary[summary["dataset"] == dataset]


def _sweep(summary: pd.DataFrame, scheme: Scheme, *, dataset: str) -> str:
    of = _ours(summary, dataset)
    of = of[~is_attack(of)]
    parts = []
    for rule, suffix in ADDING_SUFFIX.items():
        said = []
        for metric in (RATE, *DESCRIPTORS):
            rows = of[of["metric"] == metric]
            consumer = SHARED if metric != RATE else next(iter(rows["consumer"]), "")
            rows = rows[rows["consumer"] == consumer]
            name = f"missed conflicts of {consumer}" if metric == RATE else SHOWN[metric].head
            span = _span(rows, f"{scheme.name}{suffix}", scheme, metric)
            said += [f"{name} from {span}"] if span else []
        parts += [f"{rule} adding: {'; '.join(said)}."] if said else []
    return f"Panels over the level, with 95 % bands. {' '.join(parts)}"


def _plane(summary: pd.DataFrame, *, dataset: str) -> str:
    of = _ours(summary, dataset)
    raw = of[(of["mechanism"] == "raw") & ~is_attack(of)].drop_duplicates(["consumer", "metric"])
    said = [
        f"{SHOWN[metric].head} {SHOWN[metric].scale * value:.{SHOWN[metric].digits}f} "
        f"{SHOWN[metric].unit}"
        for metric in (RATE, *DESCRIPTORS)
        for value in raw.loc[raw["metric"] == metric, "value"].head(1)
    ]
    return (
        "PLR, AEL and MEL over the missed-conflict rate, one curve for FID-controlled and one for "
        f"fixed noise, both ending at raw ({', '.join(said)}). Lower and further left is better. "
        "The table of matched points has the differences."
    )


def _after(summary: pd.DataFrame, *, dataset: str) -> str:
    of = _ours(summary, dataset)
    of = of[of["metric"] == "plr"]
    attack = strongest_reconstruction(summary, dataset=dataset)
    if attack is None:
        return ""
    after = of[(of["consumer"] == attack.consumer) & (of["knowledge"] == attack.knowledge)]
    parts = []
    for scheme in (FID, FIXED):
        for rule, suffix in ADDING_SUFFIX.items():
            name = f"{scheme.name}{suffix}"
            before = _span(of[of["consumer"] == SHARED], name, scheme, "plr")
            if before:
                parts.append(
                    f"{scheme.title}, {rule} adding: as shared {before}; after {attack.label} "
                    f"{_span(after, name, scheme, 'plr')}."
                )
    return f"Lines of PLR over the level. {' '.join(parts)}"


def _linked(tasks: Sequence[LinkedTask]) -> str:
    parts = []
    for task in tasks:
        source = strongest_link(task)
        levels = {
            where: block[source]
            for where, block in task.cells.items()
            if source in block and np.isfinite(block[source]["rank1"])
        }
        if not levels:
            continue
        said = [
            f"{_PERCENT * row['rank1']:.0f} % at {name}"
            for (name, level), row in levels.items()
            if level is None
        ]
        noisy = [_PERCENT * row["rank1"] for (_, level), row in levels.items() if level is not None]
        if noisy:
            said.append(f"{min(noisy):.0f} to {max(noisy):.0f} % with noise")
        chance = _PERCENT * next(iter(levels.values()))["chance"]
        parts.append(f"{task.name}: {source.label} {', '.join(said)}; chance {chance:.1f} %.")
    return f"Lines of rank 1, a row for each task. {' '.join(parts)}"


def _heat(task: LinkedTask) -> str:
    rows = [row for block in task.cells.values() for row in block.values()]
    best = max(rows, key=lambda row: row["rank1"] if np.isfinite(row["rank1"]) else -1.0)
    counts = [
        f"{sum(row['outcome'] == outcome for row in rows)} {outcome}"
        for outcome in ("links", "no link detected", "attack too weak")
    ]
    where = f"{best['mechanism']} {level_text(best['level'])}".rstrip()
    return (
        f"{task.about}. Rank 1 in per cent, a row for each attack and adversary, a column for each "
        f"mechanism level. Of {len(rows)} cells: {', '.join(counts)}; "
        f"{sum(bool(row['invalid']) for row in rows)} invalid. "
        f"Highest: {_PERCENT * best['rank1']:.0f} % at {where}."
    )


def _dissociation(summary: pd.DataFrame, task: LinkedTask, *, dataset: str) -> str:
    points = dissociation_points(summary, task, dataset=dataset)
    marked = points["mechanism"].map(is_control).astype(bool) | (points["mechanism"] == "raw")
    said = [
        f"{row['mechanism']} {level_text(row['level'])}".rstrip()
        + f": PLR {_PERCENT * row['plr']:.0f} %, rank 1 {_PERCENT * row['rank1']:.0f} %"
        for row in points[marked].to_dict("records")
    ]
    lines = points[points["level"].notna() & ~marked]
    return (
        f"Rank 1 of {strongest_link(task).label} over PLR, AEL and MEL as shared. FID and fixed "
        f"noise are lines from rank 1 of {_PERCENT * lines['rank1'].min():.0f} to "
        f"{_PERCENT * lines['rank1'].max():.0f} %. Did a descriptor tell linkability by itself, "
        f"the controls would lie on the lines. {'; '.join(said)}."
    )


def _curves(summary: pd.DataFrame, *, dataset: str) -> str:
    of = _ours(summary, dataset)
    parts = []
    for mechanism, level in compared_levels(summary, dataset=dataset):
        same = of["level"].isna() if level is None else np.isclose(of["level"], level)
        rows = of[(of["mechanism"] == mechanism) & same & ~is_attack(of)]
        said = []
        for consumer in rows.loc[rows["metric"] == RATE, "consumer"].unique():
            value = rows[rows["consumer"] == consumer].set_index("metric")["value"]
            said.append(
                f"{consumer} misses {_PERCENT * value[RATE]:.0f} % at "
                f"{_PERCENT * value.get('false_alarm_rate', np.nan):.0f} % false alarms"
            )
        parts.append(f"{mechanism} {level_text(level)}".strip() + f": {', '.join(said)}.")
    return f"Curves of misses over false alarms, closer to the corner is better. {' '.join(parts)}"


def _gallery(rows: pd.DataFrame) -> str:
    said = [
        f"{mechanism}: {_PERCENT * share['leaked_shared']:.0f} % of the shared samples leak, "
        f"{_PERCENT * share['leaked_rec']:.0f} % of the rebuilt ones"
        for mechanism, share in leak_shares(rows).iterrows()
    ]
    return (
        f"Walks of {rows['track'].nunique()} people, seen from above, under each mechanism; the "
        f"rebuilt line follows the true one. {'; '.join(said)}."
    )
