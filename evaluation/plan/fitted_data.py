"""Fit a run to its data: leave out the parts for which there are too few people."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from attacks.tasks.build import make_task_windows
from attacks.tasks.passages import MOST_SCORES, Passages, find_passages
from attacks.tasks.task_list import FUSED, RETURNS
from attacks.tasks.windows import TaskWindows
from evaluation.plan.axes import Axes
from evaluation.plan.presets import PRESETS
from evaluation.plan.settings import Settings
from isac_track.datasets import Dataset
from isac_track.errors import DataError, SettingsError, did_you_mean
from isac_track.place import placed
from isac_track.scenes import FEW_PEOPLE, Cut, cut, no_tracks, with_horizons
from isac_track.types import Tracks

_SCENE_AXES = ("predictors", "attacks", "tasks", "policies")
"""Axes whose values need scenes or windows of long tracks, but for the task returns."""


@dataclass(frozen=True, eq=False, slots=True)
class FittedData:
    """The data of a run as its parts read them, and the axes that the data allow."""

    axes: Axes
    recorded: Tracks  # All tracks, placed where the network senses them.
    scene_tracks: Cut  # Those long enough for scenes, split into history and future.
    task_windows: tuple[TaskWindows, ...]  # Of each linkage task.
    model_task_windows: tuple[TaskWindows, ...]  # The same for walks of a model.
    passages: Passages | None  # Of people who come back, if any are linked.


def fit_to_data(run_axes: Axes, settings: Settings, dataset: Dataset) -> FittedData:
    """Return the data of a run, and its axes without parts of too few people.

    DataError if a user has named such a part; `_fit_returns` says when --confirming
    raises.
    """
    recorded = placed(dataset.tracks, settings=settings.stages)
    run_axes, passages = _fit_returns(run_axes, settings, recorded)
    run_axes, scene_tracks = _fit_scenes(run_axes, settings, recorded)
    if run_axes.horizons_s:
        # Horizons for which the recording has too few long tracks are left out.
        scene_tracks = with_horizons(scene_tracks, recorded, settings=settings.stages)
        run_axes = replace(run_axes, horizons_s=tuple(scene_tracks.further))
    run_axes, task_windows = _fit_tasks(run_axes, settings, recorded)
    return FittedData(
        axes=run_axes,
        recorded=recorded,
        scene_tracks=scene_tracks,
        task_windows=task_windows,
        model_task_windows=_model_task_windows(
            run_axes, settings, task_windows, recorded
        ),
        passages=passages,
    )


def _fit_returns(
    run_axes: Axes, settings: Settings, recorded: Tracks
) -> tuple[Axes, Passages | None]:
    """Return the axes, and the passages of people who come back if there are any.

    SettingsError if --confirming is given without the task, or names no session;
    DataError if the user has named the task or a session and nobody comes back.
    """
    is_named = RETURNS.name in settings.choice("tasks").named
    if not run_axes.linkage.has_returns:
        if settings.confirming is not None:
            raise SettingsError(
                "--confirming is about the task returns, which the run leaves out; add"
                " --task +returns"
            )
        return run_axes, None
    try:
        passages = find_passages(recorded, most_scores=MOST_SCORES, seed=settings.seed)
    except DataError as error:
        if is_named or settings.confirming is not None:
            raise DataError(f"task {RETURNS.name}: {error}") from None
        skipped = {}
        if recorded.session is not None:  # Of a single session: no notice.
            skipped[RETURNS.name] = f"task {RETURNS.name}: {error}"
        linkage = run_axes.linkage.without_returns().with_skipped(skipped)
        return replace(run_axes, linkage=linkage), None
    _check_confirming(settings.confirming, passages)
    if not passages.not_drawn:
        return run_axes, passages
    name = f"{passages.not_drawn:,} people of task {RETURNS.name}"
    why = f"linking all takes over {MOST_SCORES:,} scores at a level"
    linkage = run_axes.linkage.with_skipped({name: f"{name}: {why}"})
    return replace(run_axes, linkage=linkage), passages


def _check_confirming(name: str | None, passages: Passages) -> None:
    """Raise SettingsError if no session has this name.

    DataError if nobody walks in two of the others: these alone decide.
    """
    if name is None:
        return
    if name not in passages.sessions:
        hint = did_you_mean(name, passages.sessions, quote="'")
        raise SettingsError(
            f"--confirming: no session is called {name!r}"
            f"{hint or '; sessions: ' + ', '.join(passages.sessions)}"
        )
    others = passages.session != passages.sessions.index(name)
    pairs = np.unique(np.stack([passages.person, passages.session])[:, others], axis=1)
    if not (np.bincount(pairs[0]) > 1).any():
        raise DataError(
            f"without session {name} nobody walks in two: --confirming takes a session"
            " beside at least two others"
        )


def _fit_scenes(
    run_axes: Axes, settings: Settings, recorded: Tracks
) -> tuple[Axes, Cut]:
    """Return the axes and the tracks of scenes.

    With fewer than `FEW_PEOPLE` tracks, which decide nothing, a run links people who
    come back alone. If nobody does, or the user has named anything that needs scenes,
    it has scenes all the same; DataError if there are fewer tracks than a scene needs.
    """
    needs_scenes = not run_axes.linkage.has_returns or _names_scenes(settings)
    try:
        tracks = cut(recorded, settings=settings.stages, seed=settings.seed)
    except DataError:
        if needs_scenes:
            raise
    else:
        if needs_scenes or len(tracks) >= FEW_PEOPLE:
            return run_axes, tracks
    empty_cut = no_tracks(recorded, settings=settings.stages)
    return run_axes.without_scenes(_why_no_scenes(empty_cut, settings)), empty_cut


def _names_scenes(settings: Settings) -> bool:
    """Whether the user has named anything that needs scenes, or their number."""
    named = {axis: settings.choice(axis).named for axis in _SCENE_AXES}
    # These run in the task of people who come back.
    for axis, run_there in (("tasks", (RETURNS.name,)), ("attacks", FUSED)):
        named[axis] = tuple(name for name in named[axis] if name not in run_there)
    sizes = (settings.scenes, settings.utility_scenes)
    return any(named.values()) or sizes != (None, None)


def _why_no_scenes(empty_cut: Cut, settings: Settings) -> str:
    """Return how many tracks are long enough, in short, from the cut of no track."""
    # `no_tracks` counts every long track under `no_future`.
    n_long = empty_cut.no_future
    n_recorded = n_long + empty_cut.too_short
    least_s = settings.stages.resample.min_duration_s
    if n_long >= FEW_PEOPLE:
        return f"too few of {n_long:,} tracks of {least_s:g} s cover the horizon"
    return f"{n_long:,} of {n_recorded:,} tracks last {least_s:g} s"


def _fit_tasks(
    run_axes: Axes, settings: Settings, recorded: Tracks
) -> tuple[Axes, tuple[TaskWindows, ...]]:
    """Return the axes without tasks of too few people, and the windows of all others.

    Raises DataError if a user has named such a task.
    """
    task_windows, skipped = [], dict[str, str]()
    for task in run_axes.linkage.tasks:
        try:
            task_windows.append(
                make_task_windows(
                    task, tracks=recorded, stages=settings.stages, seed=settings.seed
                )
            )
        except DataError as error:
            if task.name in settings.choice("tasks").named:
                raise
            if task.links_returning_people and recorded.session is None:
                continue  # A recording of a single session: no notice.
            skipped[task.name] = str(error)
    tasks = [windows.task for windows in task_windows]
    return run_axes.limited_to(tasks, skipped=skipped), tuple(task_windows)


def _model_task_windows(
    run_axes: Axes,
    settings: Settings,
    task_windows: Iterable[TaskWindows],
    recorded: Tracks,
) -> tuple[TaskWindows, ...]:
    """Return the windows of tasks that are linked in model worlds: fewer people."""
    if not any(run_axes.linkage.mechanisms_by_world.values()):
        return ()
    most = min(
        PRESETS[settings.preset].model_people, settings.stages.linkage.most_people
    )
    stages = settings.stages.changed({"linkage.most_people": most})
    return tuple(
        make_task_windows(
            windows.task, tracks=recorded, stages=stages, seed=settings.seed
        )
        for windows in task_windows
        if windows.task in run_axes.linkage.model_tasks
    )
