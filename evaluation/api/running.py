"""A run from settings to data frames and files: plan, execute, report."""

import contextlib
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.api.run_results import build, limit_threads
from evaluation.api.stronger import try_stronger
from evaluation.plan.constants import BLOCK_SCENES, MOST_SCENES
from evaluation.plan.plan import Plan, make_plan
from evaluation.plan.settings import NO_TRACKS, Settings
from evaluation.pool.execute import execute
from evaluation.pool.memory import release_memory_after
from evaluation.pool.workers import start_workers_early
from evaluation.reporting.announcements import plan_lines
from evaluation.reporting.finished import load
from evaluation.reporting.progress import progress_bar
from evaluation.reporting.rows import Results
from evaluation.store import folder
from evaluation.store.lock import locked
from evaluation.store.manifest import read_manifest
from isac_track.config import StageSettings
from isac_track.errors import DataError, SettingsError


def run(
    settings: Settings | None = None,
    *,
    preset: str | None = None,
    dataset: Any = None,  # noqa: ANN401 - frames of any library
    mechanisms: Sequence[Any] | None = None,
    predictors: Sequence[Any] | None = None,
    attacks: Sequence[Any] | None = None,
    tasks: Sequence[str] | None = None,
    policies: Sequence[Any] | None = None,
    adversaries: Sequence[str] | None = None,
    scenes: int | None = None,
    utility_scenes: int | None = None,
    precision: float | None = None,
    pilot_half_width: float | None = None,
    seed: int | None = None,
    stages: StageSettings | Mapping[str, Any] | None = None,
    out: Path | str | None = None,
    fresh: bool | None = None,
    jobs: int | None = None,
    cell_timeout_s: float | None = None,
    executor: str | None = None,
    scheduler: str | None = None,
    keep_scores: bool | None = None,
    keep_ids: bool | None = None,
    format: str | None = None,  # noqa: A002 - the name of the option
    fps: float | None = None,
    unit: str | None = None,
    columns: str | Mapping[str, str] | None = None,
    on_duplicate: str | None = None,
    crs: str | None = None,
    drop_frozen: float | None = None,
    sessions: Sequence[Path | str] | None = None,
    confirming: str | None = None,
    persistent_ids: bool | None = None,
    progress: bool | Callable[[int, int, str], None] = True,
    plan: Plan | None = None,
    pictures: bool = True,
    walks: bool = True,
    **unknown: Any,  # noqa: ANN401 - refused, with the option that may have been meant
) -> Results:
    """Run the matrix and return its results as data frames.

    Every option but the last four is one of `Settings`; None leaves it as `settings`
    has it, which by default are those of preset `quick`.

    Parameters
    ----------
    settings : Settings, optional
        Settings that the other options are put over.
    preset : str, optional
        Axes that a name stands for: `smoke`, `paper` and others; `--list` names all.
    dataset : str, Path or DataFrame, optional
        A known name, a file, a folder of sessions, or a frame with the columns t (s),
        id, x, y (m).
    mechanisms, predictors, attacks : sequence of SPECs or plug-in objects, optional
        They replace the preset's. `"+SPEC"` adds to them, and so do objects after a
        `"+"`: `attacks=["+", MyAttack()]`. An empty list is none.
    tasks : sequence of str, optional
        What is to be linked, as above.
    policies : sequence of SPECs or plug-in objects, optional
        What answers to robots on patrol disclose, as above.
    adversaries : sequence of str, optional
        Adversaries beside blind, informed and oracle.
    scenes : int, optional
        All scenes, which are all attacked.
    utility_scenes : int, optional
        All scenes; the attacked scenes stay the preset's first.
    precision : float, optional
        Half-width of the missed-conflict rates' intervals: finds the number of scenes.
    pilot_half_width : float, optional
        Half-width in the pilot that has found it; filled in by a run with `precision`.
    seed : int, optional
        Base seed of every random stream.
    stages : mapping, optional
        Stage settings: `{"privacy.epsilon_m": 0.5}`.
    out : Path or str, optional
        Run folder, by default `runs/DATASET-PRESET-SEED`.
    fresh : bool, optional
        Whether to replace the run in the folder, not to continue it.
    jobs : int, optional
        Worker processes.
    cell_timeout_s : float, optional
        Seconds after which a cell is given up.
    executor : str, optional
        `local` or `dask`.
    scheduler : str, optional
        Address of the Dask cluster's scheduler.
    keep_scores : bool, optional
        Whether to keep the raw scores of all linkers.
    keep_ids : bool, optional
        Whether to keep the recording's own ids.
    format, fps, unit, columns, on_duplicate, crs, drop_frozen : optional
        How to read a user's file, as `isac_track.datasets.load` takes them.
    sessions : sequence of paths, optional
        Files that are sessions of one recording.
    confirming : str, optional
        Session that is left aside, to confirm a link of people who come back.
    persistent_ids : bool, optional
        Whether ids are the same people in all sessions.
    progress : bool or callable
        Whether to show the data and the progress of the run, or a function of cells
        finished, cells to do, and the cell under way.
    plan : Plan, optional
        A plan of `evaluation.plan.plan.make_plan`, instead of all settings.
    pictures : bool
        Whether to draw figures and `report.html`; `evaluation.report` draws them later.
    walks : bool
        Whether to keep a few true walks to be drawn.

    Raises
    ------
    IsacTrackError
        For anything that a user can mend; finished cells stay.

    Examples
    --------
    >>> evaluation.run(preset="smoke", attacks=["+my_attack"])  # doctest: +SKIP
    """
    given = locals()  # before any other name: the options as they were given
    options = {
        option.name: given[option.name]
        for option in fields(Settings)
        if given[option.name] is not None
    }
    options |= unknown
    if "ready" in options:
        warnings.warn("say plan= for ready=", FutureWarning, stacklevel=2)
        plan = options.pop("ready")
    report = progress if callable(progress) else lambda *_: None
    if plan is None:
        asked = (settings or Settings()).changed(**options)
        plan = make_plan(sized(asked, progress=report))
    elif settings is not None or options:
        raise SettingsError("a plan has its settings already: leave out all others")
    folder.check_folder(plan.out)
    shown: AbstractContextManager[Callable[[int, int, str], None]] = (
        contextlib.nullcontext(report)
    )
    if progress is True:
        shown = progress_bar([], heading=[*plan_lines(plan)])
    with shown as update:
        return _carry_out(plan, update, pictures=pictures, walks=walks)


def _carry_out(
    plan: Plan, update: Callable[[int, int, str], None], *, pictures: bool, walks: bool
) -> Results:
    """Compute the cells of a plan; write and return its results."""
    numeric = np.errstate(all="warn", under="ignore")  # whatever a plug-in's module set
    with release_memory_after(), locked(plan.out), limit_threads(), numeric:
        with start_workers_early():
            execute(plan, update, keeps_walks=walks)
            try_stronger(plan, update)
        # Use a fresh worker: those of cells hold too much memory, and have run users'
        # plug-ins.
        with start_workers_early(int(plan.jobs > 1), (build.__module__,)):
            return build(plan.out, pictures=pictures)


def sized(settings: Settings, *, progress: Callable[[int, int, str], None]) -> Settings:
    """Return settings with the number of scenes that their precision takes.

    A pilot of 250 scenes, in a folder beside the run's, shows the half-width h of the
    widest interval of a missed-conflict rate: 250 (h / precision)^2 scenes, rounded up
    to whole blocks. Raises SettingsError if that is more than a run takes, or no
    predictor reads.
    """
    if settings.precision is None or settings.utility_scenes is not None:
        return settings
    usual = make_plan(settings)
    if not usual.axes.scenes.predictors:
        raise SettingsError(
            "--precision is about missed conflicts: add --predictor NAME"
        )
    out = usual.out.with_name(f"{usual.out.name}-pilot")
    pilot_settings = settings.changed(
        precision=None,
        scenes=BLOCK_SCENES,
        attacks=(),
        tasks=(),
        policies=(),
        adversaries=(),
        confirming=None,
        stages=settings.stages.changed({"conflict.horizons_s": (), **NO_TRACKS}),
        out=out,
    )
    plan = make_plan(pilot_settings)
    done = None if settings.fresh else load_finished(plan)
    pilot = done or run(plan=plan, progress=progress, pictures=False)
    missed = pilot.measured[pilot.measured["metric"] == "missed_conflict_rate"]
    half = float((missed["ci_high"] - missed["ci_low"]).max()) / 2.0
    if not half > 0.0:
        raise DataError(
            "250 scenes show no interval of a missed-conflict rate: name --scenes"
        )
    n_scenes = BLOCK_SCENES * max(math.ceil((half / settings.precision) ** 2), 1)
    if n_scenes > MOST_SCENES:
        raise SettingsError(
            f"--precision {settings.precision:g} takes {n_scenes:,} scenes (+-"
            f" {half:.3f} after {BLOCK_SCENES}); a run has at most {MOST_SCENES:,}"
        )
    return settings.changed(utility_scenes=n_scenes, pilot_half_width=half)


def load_finished(plan: Plan) -> Results | None:
    """Return the results of a plan that the same code has finished; else None."""
    try:
        manifest = read_manifest(plan.out)
        is_same = (
            manifest["identity"] == plan.identity and manifest["code"] == plan.code_hash
        )
        is_finished = manifest.get("state") == "finished"
        if is_same and is_finished and not manifest.get("failed"):
            return load(plan.out)
    except DataError:
        pass
    return None
