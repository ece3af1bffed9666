"""The command that makes a run again."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isac_track.config import StageSettings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_COMMANDS = ("matrix.py", "isac-track", "__main__.py")


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
