"""What a run says of itself in lines; nothing heavy is imported: `--list` answers at once."""

from __future__ import annotations

import contextlib
import re
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from evaluation.plan.presets import DEFAULT, PRESETS, Preset
from evaluation.plan.settings import AXES
from evaluation.reporting.notices import plan_notices
from isac_track.config import StageSettings

if TYPE_CHECKING:
    from evaluation.plan.plan import Plan
    from isac_track.plugins import Kind

WIDTH: Final = 80  # Columns of the first screen.
_INSIDE_NUMBER: Final = re.compile(
    r" (?=[%±])|(?<=\beta) (?=\d)|(?<=\d) (?=(?:m|s|Hz)\b)"
)
"""Spaces at which no line is broken."""
_COMMANDS = ("matrix.py", "isac-track", "__main__.py")
_KINDS: tuple[Kind, ...] = ("mechanisms", "predictors", "attacks")


def near(path: Path) -> Path:
    """Return a path as it is shortest to type from here: relative below the working folder."""
    with contextlib.suppress(ValueError, OSError):
        return path.absolute().relative_to(Path.cwd())
    return path


def wrapped(text: str, *, width: int = WIDTH, indent: str = "  ") -> list[str]:
    """Return a text in lines; a number and its unit stay together."""
    joined = _INSIDE_NUMBER.sub("\0", text)
    lines = textwrap.wrap(
        joined,
        width,
        subsequent_indent=indent,
        break_on_hyphens=False,
        break_long_words=False,
    )
    return [line.replace("\0", " ") for line in lines]


def condensed(notices: Sequence[str], *, most: int | None, where: str) -> list[str]:
    """Return notices in lines, at most so many; the last then says where they can be read."""
    lines = [line for one in notices for line in wrapped(one)]
    if most is None or len(lines) <= most:
        return lines
    return [*lines[: most - 1], f"  ... {len(notices)} notices in full: {where}"]


def scenes_text(identity: Mapping[str, Any]) -> str:
    """Return how many scenes a run has, and how many of them are attacked."""
    attacked = identity["scenes"]
    every = identity.get("scenes_utility", attacked)
    return f"{every:,} scenes" + (
        f", {attacked:,} of them attacked" if every != attacked else ""
    )


def plan_lines(ready: Plan) -> Iterator[str]:
    """Yield what a plan is about to do, what it leaves out, and what slow attacks cost."""
    from evaluation.pool.pieces import (  # noqa: PLC0415 - names alone need none
        n_finished,
    )
    from evaluation.store.files import CHECKSUMS  # noqa: PLC0415 - names alone need none
    from evaluation.store.folder import (  # noqa: PLC0415 - names alone need none
        check_folder,
        usable,
    )

    # Reading all of them would take seconds here; the run does, and says which are
    # damaged.
    check_folder(ready.out)
    with usable(ready.out):
        finished = n_finished(ready) * (not ready.settings.fresh)
    so_far = f", {finished} of them finished by {CHECKSUMS}" if finished else ""
    yield (
        f"{ready.dataset.name}: {len(ready.tracks)} of {len(ready.dataset.tracks)}"
        f" tracks used, {scenes_text(ready.identity)}; {ready.n_cells} cells{so_far},"
        f" in {near(ready.out)}"
    )
    slow = [one for one in ready.axes.consumers if one.is_slow]
    n_levels, costs = len(ready.axes.mechanisms), list[tuple[str, int, float]]()
    for spec in dict.fromkeys(one.spec for one in slow):
        from evaluation.compute.reconstruction import (  # noqa: PLC0415 - seldom needed
            slow_cost_s,
        )

        rows = [one for one in slow if one.spec == spec]
        costs.append(
            (spec, len(rows), slow_cost_s(rows, tracks=ready.tracks, n_levels=n_levels))
        )
    yield from plan_notices(ready, slow_costs=costs)


def changed_settings(manifest: Mapping[str, Any]) -> list[str]:
    """Return the settings of a run's stages that are not the usual ones, as they are typed."""
    usual = StageSettings().flat()
    stages = manifest["settings"].get("stages", {}).items()
    return [f"{key}={at}" for key, at in stages if usual.get(key, at) != at]


def command(manifest: Mapping[str, Any]) -> str:
    """Return the command that makes the run again: as given, or from Python what is not usual."""
    given = [str(word) for word in manifest["environment"].get("command", ())]
    if given and Path(given[0]).name in _COMMANDS:
        options = [word for word in given[1:] if word != "matrix"]
    else:
        options = _same_run(manifest)
    named = {word.partition("=")[0] for word in options}
    if not named & {"--dataset", "--session"}:
        options += ["--dataset", manifest["dataset"]["name"]]
    if "--seed" not in named:
        options += ["--seed", str(manifest["settings"]["seed"])]
    return shlex.join(["python", "-m", "evaluation.matrix", *options])


def _named(settings: Mapping[str, Any], usual: Preset) -> Mapping[str, Sequence[str]]:
    """Return the values that were named on each axis: `+NAME` adds to those of the preset.

    The manifest of an earlier version has the outcome alone: all of it is named where
    it differs.
    """
    if "named" in settings:
        named: Mapping[str, Sequence[str]] = settings["named"]
        return named
    outcome: dict[str, Sequence[str]] = {}
    for axis in AXES:
        used, usually = settings.get(axis, []), set(getattr(usual, axis))
        # Of one session a run leaves the task of those who come back out by itself.
        if set(used) not in (usually, usually - {"cross_session"}):
            outcome[axis] = used
    return outcome


def _same_run(manifest: Mapping[str, Any]) -> list[str]:
    """Return the options that give the identity and the axes of a run again."""
    from isac_track.datasets.registry import (  # noqa: PLC0415 - names alone need none
        KNOWN,
    )

    identity, settings, dataset = (
        manifest[key] for key in ("identity", "settings", "dataset")
    )
    name = settings["preset"]
    usual = PRESETS.get(name, PRESETS[DEFAULT])
    known = dataset["name"] in KNOWN
    scenes = identity["scenes"]
    every = identity.get("scenes_utility", scenes)
    is_usual = (scenes, every) == (usual.scenes, usual.utility_scenes)
    options = [("preset", name if name in PRESETS and name != DEFAULT else None)]
    sessions = [("session", path) for path in dataset.get("sessions", ())]
    options += sessions or [("dataset", dataset["name"] if known else dataset["path"])]
    if not known:
        options.append(("format", dataset["format"] or None))
        options += [
            (option, identity.get(option))
            for option in ("fps", "unit", "columns", "crs")
        ]
    options += [
        (name.replace("_", "-"), identity.get(name))
        for name in ("on_duplicate", "drop_frozen")
    ]
    options += [
        ("scenes", None if is_usual else scenes),
        ("seed", identity["seed"] or None),
    ]
    for axis, named in _named(settings, usual).items():
        options += [(axis.removesuffix("s"), value) for value in named or ["none"]]
    options += [("set", setting) for setting in changed_settings(manifest)]
    words = ["--persistent-ids"] * bool(identity.get("persistent_ids"))
    return words + [
        word for key, at in options if at is not None for word in (f"--{key}", f"{at}")
    ]
