"""The hint after a run of preset `quick`: command and time of preset `paper`."""

import shlex
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from evaluation.plan.presets import DEFAULT, PRESETS
from evaluation.plan.workers import usual_jobs
from evaluation.pool.duration import wall_s
from evaluation.reporting.announcements import rerun_command

PAPER: Final = "paper"
_SCENES_S: Final = 27.9  # For each million samples in the scenes.
_RERELEASE_S: Final = 703.0  # For each million pairs of the task `rerelease`.
_HANDOVER_S: Final = 1650.0  # For each million pairs of the task `handover-1s`.
# The people of the simulated sessions are the same in every run.
_TRAVERSAL_S: Final = 7.5
_PATROLS_S: Final = 433.0  # For each million seconds of people, times fleets.
"""CPU seconds of the cells of `paper`, by their sizes.

To lay out these cells would take seconds. The factors give the estimate of `--dry-run`
to a twentieth on Students03, Zara01 and plaza.
"""
_WITH_VALUE: Final = ("--preset", "--out")
_FLAGS: Final = ("--fresh",)
_USUAL_SEED: Final = " --seed 0"


class PaperHint(NamedTuple):
    """The command of the same run with preset `paper`, and its estimated time."""

    command: str
    seconds: float


def paper_hint(manifest: Mapping[str, Any]) -> PaperHint | None:
    """Return how to run preset `paper` on the same data; None after another preset.

    The time holds for idle cores, with as many workers as the run had. It goes by the
    sizes of the run: samples in its scenes, and pairs that it linked. Plug-ins of a
    user's own cost more.
    """
    if manifest["settings"]["preset"] != DEFAULT:
        return None
    again = rerun_command(manifest).removesuffix(_USUAL_SEED)
    words = iter(shlex.split(again))
    options = []
    for word in words:
        option, equals, _ = word.partition("=")
        if option in _WITH_VALUE:
            if not equals:
                next(words, None)
        elif option not in _FLAGS:
            options.append(word)
    seconds = wall_s(_cells_cpu_s(manifest), jobs=_workers(options))
    return PaperHint(shlex.join([*options, "--preset", PAPER]), seconds)


def _cells_cpu_s(manifest: Mapping[str, Any]) -> float:
    """Estimate the CPU seconds of the cells of preset `paper` on the data of a run."""
    identity = manifest["identity"]
    scenes = identity.get("scenes_utility", identity["scenes"])
    samples = float(scenes * identity["scenes.agents"] * manifest["history"]["points"])
    tasks = (manifest.get("linkage") or {}).get("tasks", {})
    cpu_s = _SCENES_S * samples / 1e6 + (_TRAVERSAL_S if tasks else 0.0)
    costs = {"rerelease": _RERELEASE_S, "handover-1s": _HANDOVER_S}
    for task, million_pairs_s in costs.items():
        sizes = tasks.get(task, {}).get("candidates", {}).values()
        cpu_s += million_pairs_s * sum(size**2 for size in sizes) / 1e6
    person_s = float(manifest["dataset"].get("person_s", 0.0))
    cpu_s += _PATROLS_S * person_s * PRESETS[PAPER].fleets / 1e6
    return cpu_s


def _workers(options: Sequence[str]) -> int:
    """Return the number of workers of a command: by its option, else one a core."""
    words = [word for option in options for word in option.split("=", 1)]
    if "--jobs" in words[:-1]:
        return int(words[words.index("--jobs") + 1])
    return usual_jobs()
