"""Lines of text about a run: its plan, its notices, and the command that repeats it.

Nothing heavy is imported at the top, so that `--list` answers at once.
"""

from __future__ import annotations

import contextlib
import re
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from evaluation.plan.presets import DEFAULT, PRESETS, Preset
from evaluation.plan.settings import AXES, OPTIONS
from evaluation.reporting.notices import SlowAttack, plan_notices
from isac_track.config import StageSettings

if TYPE_CHECKING:
    from evaluation.plan.plan import Plan
    from isac_track.plugins import Kind

WIDTH: Final = 80  # Columns of the first screen.
_INSIDE_NUMBER: Final = re.compile(
    r" (?=[%±])|(?<=\beta) (?=\d)|(?<=\d) (?=(?:m|s|Hz)\b)"
)
"""Spaces at which no line may break."""
_COMMANDS = ("matrix.py", "isac-track", "__main__.py")
_KINDS: tuple[Kind, ...] = ("mechanisms", "predictors", "attacks")


def short_path(path: Path) -> Path:
    """Return a path relative to the working folder, if it lies in that folder."""
    with contextlib.suppress(ValueError, OSError):
        return path.absolute().relative_to(Path.cwd())
    return path


def wrap_lines(text: str, *, width: int = WIDTH, indent: str = "  ") -> list[str]:
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


def condense_notices(
    notices: Sequence[str], *, most: int | None, where: str
) -> list[str]:
    """Return notices in at most `most` lines.

    If that cuts any, the last line says that `where` has them in full.
    """
    lines = [line for notice in notices for line in wrap_lines(notice)]
    if most is None or len(lines) <= most:
        return lines
    return [*lines[: most - 1], f"  ... {len(notices)} notices in full: {where}"]


def scenes_text(identity: Mapping[str, Any]) -> str:
    """Return how many scenes a run has, and how many of them are attacked."""
    attacked = identity["scenes"]
    total = identity.get("scenes_utility", attacked)
    text = f"{total:,} scenes"
    return text if total == attacked else f"{text}, {attacked:,} of them attacked"


def plan_lines(plan: Plan) -> Iterator[str]:
    """Yield what a plan will do, what it leaves out, and what slow attacks cost."""
    from evaluation.pool.pieces import (  # noqa: PLC0415 - names alone need none
        n_finished,
    )
    from evaluation.store.files import CHECKSUMS  # noqa: PLC0415 - names alone need none
    from evaluation.store.folder import (  # noqa: PLC0415 - names alone need none
        check_folder,
        usable,
    )

    # Cells are counted and not read, which would take seconds. The run reads them and
    # names the damaged files.
    check_folder(plan.out)
    with usable(plan.out):
        finished = n_finished(plan)
    if plan.settings.fresh:
        finished = 0
    so_far = f", {finished} of them finished by {CHECKSUMS}" if finished else ""
    size = (
        f"{len(plan.scene_tracks)} of {len(plan.dataset.tracks)} tracks used,"
        f" {scenes_text(plan.identity)}"
    )
    if plan.axes.scenes.why_left_out and plan.passages is not None:
        size = f"{len(plan.passages)} of {len(plan.dataset.tracks)} passages used"
    yield (
        f"{plan.dataset.name}: {size}; {plan.n_cells} cells{so_far},"
        f" in {short_path(plan.out)}"
    )
    slow = [consumer for consumer in plan.axes.scenes.consumers if consumer.is_slow]
    n_levels = len(plan.axes.mechanisms)
    slow_attacks: list[SlowAttack] = []
    for spec in dict.fromkeys(consumer.spec for consumer in slow):
        from evaluation.compute.reconstruction import (  # noqa: PLC0415 - seldom needed
            slow_cost_s,
        )

        same = [consumer for consumer in slow if consumer.spec == spec]
        cost_s = slow_cost_s(same, tracks=plan.scene_tracks, n_levels=n_levels)
        slow_attacks.append(SlowAttack(spec, len(same), cost_s))
    yield from plan_notices(plan, slow=slow_attacks)


def changed_settings(manifest: Mapping[str, Any]) -> list[str]:
    """Return the stage settings that are not as usual, as they are typed."""
    settings = manifest["settings"]
    preset = PRESETS.get(settings["preset"], PRESETS[DEFAULT])
    usual = StageSettings().flat() | {
        "patrol.fleets": preset.fleets,
        "patrol.segment_s": preset.patrol_segment_s,
    }
    stages = settings.get("stages", {}).items()
    return [
        f"{name}={value}" for name, value in stages if usual.get(name, value) != value
    ]


def rerun_command(manifest: Mapping[str, Any]) -> str:
    """Return the command that makes the run again.

    It is the command that was given. For a run from Python it has all options that are
    not usual.
    """
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
    """Return the values that the user named on each axis; `+NAME` adds to the preset's.

    The manifest of an earlier version has the outcome alone: all of it is named where
    it differs from the preset.
    """
    if "named" in settings:
        named: Mapping[str, Sequence[str]] = settings["named"]
        return named
    outcome: dict[str, Sequence[str]] = {}
    for axis in AXES:
        if axis == "policies" and axis not in settings:
            continue  # a version without patrols
        values, usual_values = settings.get(axis, []), set(getattr(usual, axis))
        # A run of one session leaves out the task `cross_session` by itself.
        if set(values) not in (usual_values, usual_values - {"cross_session"}):
            outcome[axis] = values
    return outcome


def _same_run(manifest: Mapping[str, Any]) -> list[str]:
    """Return the options that give the identity and the axes of a run again."""
    from isac_track.datasets.registry import (  # noqa: PLC0415 - names alone need none
        KNOWN,
    )

    identity, settings = manifest["identity"], manifest["settings"]
    dataset, preset = manifest["dataset"], settings["preset"]
    usual = PRESETS.get(preset, PRESETS[DEFAULT])
    is_known = dataset["name"] in KNOWN
    scenes = identity["scenes"]
    total = identity.get("scenes_utility", scenes)
    is_usual = (scenes, total) == (usual.scenes, usual.utility_scenes)
    is_named = preset in PRESETS and preset != DEFAULT
    options = [("preset", preset if is_named else None)]
    sessions = [("session", path) for path in dataset.get("sessions", ())]
    source = dataset["name"] if is_known else dataset["path"]
    options += sessions or [("dataset", source)]
    if not is_known:
        options.append(("format", dataset["format"] or None))
        options += [
            (name, identity.get(name)) for name in ("fps", "unit", "columns", "crs")
        ]
    options += [
        (name.replace("_", "-"), identity.get(name))
        for name in ("on_duplicate", "drop_frozen")
    ]
    options += [
        ("scenes", None if is_usual else scenes),
        ("seed", identity["seed"] or None),
    ]
    for axis, values in _named(settings, usual).items():
        options += [(OPTIONS[axis], value) for value in values or ["none"]]
    options += [("set", setting) for setting in changed_settings(manifest)]
    options.append(("confirming", settings.get("confirming")))
    words = ["--persistent-ids"] if identity.get("persistent_ids") else []
    for name, value in options:
        if value is not None:
            words += [f"--{name}", f"{value}"]
    return words
