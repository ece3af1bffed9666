"""The settings of a variant's run: one assumption changed, and the attacks that matter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from attacks.tasks.build import sessions_of
from attacks.tasks.task_list import TASKS
from evaluation.experiment.settings import Settings
from evaluation.experiment.variants import stages_of
from isac_track import datasets, plugins
from isac_track.datasets.registry import KNOWN
from isac_track.errors import DataError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from evaluation.experiment.variants import Variant
    from isac_track.config import StageSettings
    from isac_track.plugins import Kind
    from isac_track.types import Tracks


def settings_of(
    variant: Variant,
    *,
    manifest: Mapping[str, Any],
    attacks: Mapping[str, frozenset[str]],
    out: Path,
    scenes: int | None = None,
    jobs: int | None = None,
    trust: Sequence[str] = (),
) -> tuple[Settings, tuple[str, ...]]:
    """Return the settings of a variant's run, and the tasks that are left out, each with why.

    Parameters
    ----------
    variant : Variant
    manifest : mapping
        Of the run.
    attacks : mapping
        SPECs of the attacks to run, each with its tasks; a reconstruction has the task "".
    out : Path
        Folder of the variant.
    scenes, jobs : int, optional
        Instead of the run's scenes and of the default number of workers.
    trust : sequence of str
        SPECs of classes of one's own that may be imported although a file names them.

    Raises
    ------
    IsacTrackError
        If its recording is not at hand, or a setting is unknown.
    """
    ran = manifest["settings"]
    stages = stages_of(manifest).changed(variant.stages)
    name, own = manifest["dataset"]["name"], {"format": None, "fps": None}
    source = variant.recording or name
    if not variant.recording and name not in KNOWN:
        source = manifest["dataset"]["path"]
        own = {"format": manifest["dataset"]["format"], "fps": manifest["identity"]["fps"]}
    # Nobody waits for a network here: a data set that is missing fails with how to get it.
    data = datasets.load(source, download=False, **own)
    if not variant.recording and data.sha256 != manifest["dataset"]["sha256"]:
        raise DataError(f"{data.path} is no longer the recording that was run; run it again")
    asked = {task for tasks in attacks.values() for task in tasks} - {""}
    left_out = _too_small(asked, tracks=data.tracks, stages=stages, seed=ran["seed"])
    predictors = () if variant.predictor else tuple(ran["predictors"][:1])
    _refuse_own_classes("mechanisms", ran["mechanisms"], trust=trust)
    _refuse_own_classes("predictors", predictors, trust=trust)
    _refuse_own_classes("attacks", attacks, trust=trust)
    run = (asked - left_out.keys()) | {""}
    return (
        Settings(
            preset=ran["preset"],
            dataset=source,
            format=own["format"],
            fps=own["fps"],
            scenes=ran["scenes"] if scenes is None else scenes,
            seed=ran["seed"],
            mechanisms=tuple(ran["mechanisms"]),
            predictors=(variant.predictor,) if variant.predictor else predictors,
            attacks=tuple(spec for spec, tasks in sorted(attacks.items()) if tasks & run),
            tasks=tuple(task for task in ran["tasks"] if task in run),
            stages=stages,
            jobs=jobs,
            out=out,
        ),
        tuple(left_out.values()),
    )


def _refuse_own_classes(kind: Kind, specs: Iterable[str], *, trust: Sequence[str]) -> None:
    """Let only the user's own command line decide what is imported, never a file."""
    for spec in (one for whole in specs for one in whole.split("@")):
        if plugins.is_own_class(kind, spec) and spec not in trust:
            raise SettingsError(
                f"the run's files name {spec!r}, a class that is not built in; "
                f"if it is yours, say so: --trust {spec}"
            )


def _too_small(
    tasks: Iterable[str], *, tracks: Tracks, stages: StageSettings, seed: int
) -> dict[str, str]:
    """Return the tasks that a recording has too few people for, each with why."""
    found = {}
    for name in sorted(tasks):
        try:
            sessions_of(TASKS[name], tracks=tracks, stages=stages, seed=seed)
        except DataError as error:
            found[name] = str(error)
    return found
