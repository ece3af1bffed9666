"""A run from settings to data frames and files: plan, execute, report."""

import contextlib
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from evaluation.estimates import horizons, linkability, paper, summary, weak_attacks
from evaluation.estimates.best_robot import BestRobots, best_robots
from evaluation.estimates.bounds import gaps, linked_gaps
from evaluation.estimates.by_speed import by_speed
from evaluation.estimates.decisions import decisions
from evaluation.estimates.families import CLEAN, RAW, families_in
from evaluation.estimates.frontier import frontier
from evaluation.estimates.galleries import TPR, galleries
from evaluation.estimates.keys import Key, Source, horizons_in, judged_at
from evaluation.estimates.levels import levels
from evaluation.estimates.linked_people import Choices, read_probes
from evaluation.estimates.matching import FUTURE, Sweeps, matched
from evaluation.estimates.metrics import (
    ACHIEVED,
    ASSIGNED,
    EXPOSURE,
    SUCCESS,
    SUCCESS_OF_100,
)
from evaluation.estimates.own_plugins import Estimates, plugin_records
from evaluation.estimates.pooled import Answered, answered, answers_of, to_frame
from evaluation.estimates.strongest import HEADLINE, cross_fitted, strongest
from evaluation.estimates.strongest_table import (
    Strongest,
    strongest_on_each,
    strongest_table,
)
from evaluation.plan.constants import (
    BLOCK_SCENES,
    MOST_SCENES,
    WORLDS,
    horizon_of,
    horizon_world,
)
from evaluation.plan.plan import Plan, plan, trial
from evaluation.plan.settings import Settings, check_drawing
from evaluation.pool.execute import execute, execute_trial
from evaluation.pool.workers import ahead, aside, given_back
from evaluation.reporting import page, study_page
from evaluation.reporting.announcements import plan_lines
from evaluation.reporting.answers import answers
from evaluation.reporting.figures import figure
from evaluation.reporting.finished import load
from evaluation.reporting.first_screen import first_table
from evaluation.reporting.progress import progress_bar
from evaluation.reporting.rows import Results
from evaluation.reporting.tables import write_tex, write_text
from evaluation.store import folder
from evaluation.store.cell_files import Summed, read_gallery
from evaluation.store.files import FRAMES, check_sound, locked, to_csv, write_whole
from evaluation.store.manifest import FAILED_COLUMNS, read_manifest
from evaluation.verdict import sections as verdict
from evaluation.verdict.what_to_share import (
    default_question,
    leading_handover,
    recommend,
)
from isac_track.config import StageSettings
from isac_track.datasets import Dataset
from isac_track.errors import DataError, SettingsError
from isac_track.intervals import Estimate

__all__ = ["Results", "build", "load", "rebuild", "run", "sized", "study"]
_one_thread = partial(threadpool_limits, limits=1, user_api="blas")
"""Keep linear algebra to this thread: its matrices are small, and others would only spin."""
_DRAWN: Final = (*ACHIEVED, ASSIGNED, SUCCESS_OF_100)
"""What is compared of linkers, and has replicates."""
_OF_PEOPLE: Final = (
    EXPOSURE,
    SUCCESS,
    ASSIGNED,
    TPR,
)  # What is asked of who is linked.


def run(
    settings: Settings | None = None,
    *,
    preset: str | None = None,
    dataset: Any = None,  # noqa: ANN401 - frames of any library
    mechanisms: Sequence[Any] | None = None,
    predictors: Sequence[Any] | None = None,
    attacks: Sequence[Any] | None = None,
    tasks: Sequence[str] | None = None,
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
    persistent_ids: bool | None = None,
    progress: bool | Callable[[int, int, str], None] = True,
    ready: Plan | None = None,
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
    adversaries : sequence of str, optional
        Adversaries beside blind, informed and oracle.
    scenes, utility_scenes : int, optional
        Scenes that are attacked, and all scenes.
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
    executor, scheduler : str, optional
        `dask`, and the address of its scheduler.
    keep_scores, keep_ids : bool, optional
        Whether to keep the raw scores of all linkers, and the recording's own ids.
    format, fps, unit, columns, on_duplicate, crs, drop_frozen : optional
        How a file of one's own is read, as `isac_track.datasets.load` takes them.
    sessions, persistent_ids : optional
        Files that are sessions of one recording, and whether ids are the same people in
        all.
    progress : bool or callable
        Whether to show the data and how far the run is, or what is called with cells
        finished, cells to do, and what is under way.
    ready : Plan, optional
        A plan of `plan`, instead of all settings.
    pictures : bool
        Whether to draw figures and `report.html`; `evaluation.report` draws them later.
    walks : bool
        Whether to keep a few true walks to be drawn.

    Raises
    ------
    IsacTrackError
        For anything that a user can mend; finished cells are kept.

    Examples
    --------
    >>> evaluation.run(preset="smoke", attacks=["+my_attack"])  # doctest: +SKIP
    """
    given = locals()  # before any other name: the options as they were given
    options = {
        one.name: given[one.name]
        for one in fields(Settings)
        if given[one.name] is not None
    }
    options |= unknown
    told = progress if callable(progress) else lambda *_: None
    if ready is None:
        ready = plan(sized((settings or Settings()).changed(**options), progress=told))
    elif settings is not None or options:
        raise SettingsError(
            "a ready plan has its settings already: leave out all others"
        )
    folder.check_folder(ready.out)
    shown: AbstractContextManager[Callable[[int, int, str], None]] = (
        contextlib.nullcontext(told)
    )
    if progress is True:
        shown = progress_bar([], heading=[*plan_lines(ready)])
    with shown as update:
        return _carried_out(ready, update, pictures=pictures, walks=walks)


def _carried_out(
    ready: Plan, update: Callable[[int, int, str], None], *, pictures: bool, walks: bool
) -> Results:
    """Compute the cells of a plan, and write and return what they tell."""
    numeric = np.errstate(all="warn", under="ignore")  # whatever a plug-in's module set
    with given_back(), locked(ready.out), _one_thread(), numeric:
        with ahead():
            execute(ready, update, keeps_walks=walks)
            _try_candidates(ready, update)
        # One helps that is new: those of cells hold much, and strangers' plug-ins ran
        # in them.
        with ahead(int(ready.jobs > 1), (__name__,)):
            return build(ready.out, pictures=pictures)


def sized(settings: Settings, *, progress: Callable[[int, int, str], None]) -> Settings:
    """Return settings with as many scenes as the precision that they ask for takes; see docs.

    A pilot of 250 scenes, in a folder beside the run's, shows the half-width h of the
    widest interval of a missed-conflict rate: 250 (h / precision)^2 scenes, rounded up
    to whole blocks. Raises SettingsError if that is more than a run takes, or nobody
    foresees conflicts.
    """
    if settings.precision is None or settings.utility_scenes is not None:
        return settings
    usual = plan(settings)
    if not usual.axes.predictors:
        raise SettingsError(
            "--precision is about missed conflicts: add --predictor NAME"
        )
    out = usual.out.with_name(f"{usual.out.name}-pilot")
    alone: dict[str, Any] = {
        "precision": None,
        "scenes": BLOCK_SCENES,
        "attacks": (),
        "tasks": (),
    }
    alone["stages"] = settings.stages.changed({"conflict.horizons_s": ()})
    ready = plan(settings.changed(**alone, out=out))
    done = None if settings.fresh else _finished(ready)
    pilot = done or run(ready=ready, progress=progress, pictures=False)
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


def rebuild(out: Path | str, *, pdf: bool = False) -> Results:
    """Write tables, figures and page of a run folder anew, with `pdf` figures as PDF, too.

    Raises IsacTrackError if the folder holds no run, or a cell is missing or not as it
    was written.
    """
    out = Path(out)
    if pdf:
        check_drawing()
    manifest = read_manifest(out)
    with locked(out), _one_thread():
        check_sound(
            out, (name for entry in manifest["cells"] for name in entry["files"])
        )
        return build(out, pdf=pdf)


def build(out: Path, *, pictures: bool = True, pdf: bool = False) -> Results:
    """Write summary, tables and figures of a run folder, and return them.

    Otherwise as `rebuild`, which locks the folder and checks its cells first.
    """
    results, looked = _results(out)
    results = replace(results, first_table_of=first_table)
    with aside(partial(_as_csv, [getattr(results, of) for of in FRAMES])) as tables:
        write_whole(out / "flags.json", weak_attacks.to_json(results.flags, looked))
        write_whole(out / "verdict.json", verdict.to_bytes(results.verdict))
        write_tex(results, folder=out / "tables")
        write_text(results)
        for name, content in zip(FRAMES.values(), tables(), strict=True):
            write_whole(out / name, content)
    folder.remove_figures(out)  # those of an earlier report tell of other results
    if pictures:
        _draw(results, pdf=pdf)
    return results


def _results(out: Path) -> tuple[Results, dict[str, Any]]:
    """Return all that the cells of a run tell, and how much was looked at for flags."""
    manifest = read_manifest(out)
    dataset = manifest["dataset"]["name"]
    predictors, known = (
        manifest["settings"]["predictors"],
        families_in(manifest["cells"]),
    )
    with aside(partial(_of_links, out, manifest)) as of_links:
        scenes = _of_scenes(out, manifest)
        links = of_links()
    linked, sums = links.estimates, links.sums | scenes.attacked
    found = scenes.estimates
    flagged, looked = weak_attacks.flags(
        found, slow=weak_attacks.slow_attacks(manifest)
    )
    sweeps = Sweeps({**found, **scenes.own.at_raw_alarms, **linked}, known)
    best = strongest(sweeps.found, known)
    few = {key: one for key, one in sweeps.found.items() if key.metric in _OF_PEOPLE}
    crossed = {
        task: cross_fitted(sums, known, source, by=SUCCESS if task else EXPOSURE)
        for task, source in best.items()
    }
    on_each = strongest_on_each(sweeps.found, sums, known)
    choices = {(task, ""): of.choices for task, of in crossed.items() if task}
    choices |= {
        (one.source.task, one.mechanism): one.crossed.choices
        for one in on_each
        if one.source.task and one.among == HEADLINE
    }
    of_run = out, manifest, Sweeps(few, known), best, choices
    with aside(partial(_of_people, *of_run)) as of_people:
        at_equal = [matched(sweeps, predictors=predictors, dataset=dataset)]
        frontiers = [
            frontier(sweeps, predictors=predictors, dataset=dataset, attacks=on_each)
        ]
        for horizon_s, robots in scenes.later.items():
            at_horizon = Sweeps(judged_at(sweeps.found, robots.every), known)
            about: dict[str, Any] = {
                "dataset": dataset,
                "world": horizon_world(horizon_s),
            }
            frontiers.append(
                frontier(at_horizon, predictors=predictors, attacks=on_each, **about)
            )
            at_equal.append(
                matched(
                    at_horizon, predictors=predictors[:1], criteria=(FUTURE,), **about
                )
            )
        tidy = summary.to_frame(
            {**found, **linked}, worlds=scenes.worlds, known=known, dataset=dataset
        )
        far = weak_attacks.far_from_optimum(gaps(tidy))
        speeds = by_speed(out, manifest, sweeps.found, known=known, best=best)
        in_galleries, across = of_people()
    estimates = {
        key: one for of in crossed.values() for key, one in of.estimates.items()
    }
    judged = Sweeps({**sweeps.found, **estimates}, known)
    later = {
        horizon_s: Sweeps(judged_at(judged.found, robots.every), known)
        for horizon_s, robots in scenes.later.items()
    }
    said = verdict.verdict(
        judged,
        across,
        strongest=best,
        scored={task: of.choices for task, of in crossed.items()},
        later=later,
        manifest=manifest,
    )
    if own := manifest.get("own_plugins"):
        leading = leading_handover(best)
        beside = Estimates(
            sweeps.found, scenes.estimates_later, sums, known, on_each, leading
        )
        said["plugins"] = plugin_records(own, beside)
    said["robots"] = horizons.beaten_by_standing_still(found, scenes.estimates_later)
    every_match = pd.concat(at_equal, ignore_index=True)
    results = Results(
        out=out,
        manifest=manifest,
        summary=tidy,
        paper_table=paper.paper_table(sweeps, dataset=dataset),
        claims=paper.claims(
            sweeps, every_match, dataset=dataset, history=manifest["history"]
        ),
        matched=every_match,
        frontier=pd.concat(frontiers, ignore_index=True),
        levels=_levels_of(manifest, scenes, links, attacks=on_each),
        attacked=strongest_table(on_each, sweeps.found, dataset=dataset),
        decisions=pd.concat(
            [robots.decided for robots in scenes.judged], ignore_index=True
        ),
        curves=pd.concat(
            [robots.curves for robots in scenes.judged], ignore_index=True
        ),
        flags=pd.concat([flagged, far], ignore_index=True) if len(far) else flagged,
        linkability=links.table,
        galleries=in_galleries,
        speeds=speeds,
        verdict=said,
        failed=pd.DataFrame(manifest.get("failed", []), columns=list(FAILED_COLUMNS)),
        strongest={task: source.attack for task, source in best.items()},
        conflict_times=horizons.conflict_times(out, manifest),
        gallery=read_gallery(out),
    )
    told = [one.sentence for one in answers(results)]
    return replace(results, verdict={"answer": told, **said}), looked


@dataclass(frozen=True, eq=False, slots=True)
class _Links:
    """What the cells of linkage tell."""

    estimates: dict[Key, Estimate]
    sums: dict[Key, Summed]
    table: pd.DataFrame  # `linkability.csv`


def _of_links(out: Path, manifest: Mapping[str, Any]) -> _Links:
    read = linkability.cards(out, manifest, drawn=_DRAWN)
    table = linkability.linkability(read, dataset=manifest["dataset"]["name"])
    return _Links(summary.linkage_estimates(read), summary.linkage_sums(read), table)


@dataclass(frozen=True, eq=False, slots=True)
class _Judged:
    """Robots judged at a horizon: what each metric is, and how misses trade for false alarms."""

    estimates: Mapping[Key, Estimate]
    at_raw_alarms: Mapping[Key, Estimate]
    best: BestRobots  # Over the levels that a site may choose, and raw.
    curves: pd.DataFrame
    decided: pd.DataFrame

    @property
    def every(self) -> dict[Key, Estimate]:
        """All estimates, those at raw's false-alarm rate among them."""
        return {**self.estimates, **self.at_raw_alarms}


@dataclass(frozen=True, eq=False, slots=True)
class _Scenes:
    """What the cells of scenes tell."""

    estimates: Mapping[Key, Estimate]
    attacked: dict[Key, Summed]
    worlds: Mapping[str, Mapping[Key, Estimate]]  # Others, further horizons among them.
    own: _Judged  # At the run's own horizon.
    later: Mapping[float, _Judged]  # At further ones, s, ascending.

    @property
    def estimates_later(self) -> dict[float, Mapping[Key, Estimate]]:
        """The metrics at further horizons."""
        return {horizon_s: robots.estimates for horizon_s, robots in self.later.items()}

    @property
    def judged(self) -> list[_Judged]:
        """Robots at every horizon, the run's own first."""
        return [self.own, *self.later.values()]


def _of_scenes(out: Path, manifest: Mapping[str, Any]) -> _Scenes:
    found, scored, attacked = summary.estimates(out, manifest)
    dataset = manifest["dataset"]["name"]
    own, later = (
        _judged(scored, manifest, found, dataset=dataset),
        dict[float, _Judged](),
    )
    worlds: dict[str, Mapping[Key, Estimate]] = {}
    for horizon_s in horizons_in(manifest["cells"]):
        world = horizon_world(horizon_s)
        worlds[world], scored, _ = summary.estimates(out, manifest, world=world)
        name = f"{dataset}:{world}"
        later[horizon_s] = _judged(scored, manifest, worlds[world], dataset=name)
    for world in WORLDS:
        card = linkability.cards(out, manifest, drawn=_DRAWN, world=world)
        of = summary.estimates(out, manifest, world=world)[0]
        of |= linked_gaps(summary.linkage_estimates(card))
        # Nothing is paired with them: their replicates are as large as a run's own.
        worlds[world] = {
            key: replace(one, replicates=np.zeros(0)) for key, one in of.items()
        }
    return _Scenes(found, attacked, worlds, own, later)


def _judged(
    scored: Sequence[summary.Scored],
    manifest: Mapping[str, Any],
    estimates: Mapping[Key, Estimate],
    *,
    dataset: str,
) -> _Judged:
    curves, decided, at_raw_alarms = decisions(
        scored, manifest, estimates, dataset=dataset
    )
    among = {
        name
        for name, family in families_in(manifest["cells"]).items()
        if family.protects or family.family == RAW
    }
    best = best_robots(scored, manifest, {**estimates, **at_raw_alarms}, among=among)
    return _Judged(estimates, at_raw_alarms, best, curves, decided)


def _try_candidates(ready: Plan, update: Callable[[int, int, str], None]) -> None:
    """Let adversaries who know more attack the levels that would be proposed without them."""
    if not trial(ready, specs=[plugin.spec for plugin in ready.axes.mechanisms]).units:
        return
    manifest = read_manifest(ready.out)
    entries = manifest["cells"]
    # What those levels rest on; of all that is linked the leading handover.
    known = families_in(entries)
    names = {
        name
        for name, family in known.items()
        if family.protects or family.family in (RAW, CLEAN)
    }
    leading = leading_handover({Source(entry["consumer"]).task for entry in entries})
    needed = [
        entry
        for entry in entries
        if entry["mechanism"] in names
        and Source(entry["consumer"]).task in ("", leading)
        and (not entry.get("world") or horizon_of(entry["world"]) is not None)
    ]
    few = manifest | {"cells": needed}
    scenes, links = _of_scenes(ready.out, few), _of_links(ready.out, few)
    estimates = {**scenes.estimates, **links.estimates}
    attacks = strongest_on_each(
        estimates, links.sums | scenes.attacked, families_in(needed)
    )
    table = _levels_of(few, scenes, links, attacks=attacks)
    dataset, question = (
        manifest["dataset"]["name"],
        default_question(families_in(needed)),
    )
    offers = recommend(table, question, dataset=dataset).candidates
    wheres = {offer.where for offer in offers}
    specs = [
        entry["spec"]
        for entry in needed
        if (entry["mechanism"], entry["level"]) in wheres
    ]
    n_cells = (
        ready.n_cells
    )  # All are finished: these are few, and not told as a part of them.
    report = partial(_tell_trial, update, n_cells)
    execute_trial(trial(ready, specs=specs), report)


def _tell_trial(
    update: Callable[[int, int, str], None],
    n_cells: int,
    _done: int,
    _total: int,
    text: str,
) -> None:
    update(n_cells, n_cells, f"levels to propose: {text}")


def _levels_of(
    manifest: Mapping[str, Any],
    scenes: _Scenes,
    links: _Links,
    *,
    attacks: Sequence[Strongest],
) -> pd.DataFrame:
    """Return what a site gets and pays at each level."""
    return levels(
        {**scenes.estimates, **scenes.own.at_raw_alarms, **links.estimates},
        attacks=attacks,
        horizons={
            horizon_world(at): robots.every for at, robots in scenes.later.items()
        },
        best={"": scenes.own.best}
        | {horizon_world(at): robots.best for at, robots in scenes.later.items()},
        linked=links.table,
        known=families_in(manifest["cells"]),
        dataset=manifest["dataset"]["name"],
    )


def _of_people(
    out: Path,
    manifest: Mapping[str, Any],
    sweeps: Sweeps,
    best: Mapping[str, Source],
    choices: Mapping[tuple[str, str], Choices],
) -> tuple[pd.DataFrame, dict[str, list[dict[str, Any]]]]:
    """Return what rests on who is linked: over the gallery's size, and the verdict's parts."""
    probes = read_probes(out, manifest, sweeps, strongest=best, choices=choices)
    dataset, seed = manifest["dataset"]["name"], manifest["identity"]["seed"]
    in_galleries = galleries(probes, sweeps.found, dataset=dataset, seed=seed)
    return in_galleries, verdict.of_people(
        probes, sweeps, strongest=best, manifest=manifest
    )


def _as_csv(frames: Sequence[pd.DataFrame]) -> list[bytes]:
    return [to_csv(one) for one in frames]


def _draw(results: Results, *, pdf: bool) -> None:
    figures = figure.figures_of(results)
    folder.note_figures(results.out, [one.name for one in figures])
    figure.write(
        figures, folder=results.out / "figures", dataset=results.dataset, pdf=pdf
    )
    page.write(results, figures=figures)


def study(
    asked: Sequence[tuple[str, Settings]], *, out: Path
) -> tuple[list[Answered], int]:
    """Run what is not finished, answer all runs as one, and write `study.csv` and `study.html`.

    `asked` are the error law and the settings of each run, whose folder is in `out`.
    Returns the answers, and how many cells failed. Raises IsacTrackError for anything
    that a user can mend.
    """
    plans, known = list[tuple[str, Plan]](), dict[str | None, Dataset]()
    for (
        law,
        settings,
    ) in asked:  # all are checked first, and each recording is read once
        plans.append((law, plan(settings, dataset=known.get(settings.dataset))))
        known[settings.dataset] = plans[-1][1].dataset
    _refuse_copies(plans)
    rows, simulated, n_failed = [], frozenset[str](), 0
    for law, ready in plans:
        if results := _finished(ready):
            sys.stderr.write(f"{ready.out}: finished before\n")
        else:
            results = run(ready=ready)
        rows += answers_of(results.out, results.manifest, results.verdict, law=law)
        n_failed += len(results.failed)
        if results.manifest["dataset"].get("simulated"):
            simulated |= {results.dataset}
    of = answered(rows, simulated=simulated)
    write_whole(out / "study.csv", to_csv(to_frame(rows, of)))
    shown = study_page.render(
        of, simulated=simulated, runs=[one.out.name for _, one in plans]
    )
    write_whole(out / "study.html", shown.encode())
    return of, n_failed


def _refuse_copies(plans: Sequence[tuple[str, Plan]]) -> None:
    """Raise SettingsError if two recordings of a study are the same bytes: they count as one."""
    first_of: dict[str, str] = {}
    for _, ready in plans:
        name = str(ready.settings.dataset)
        first = first_of.setdefault(ready.dataset.sha256, name)
        if first != name:
            raise SettingsError(
                f"{first} and {name} hold the same bytes: one recording twice is not"
                " two; leave out one, or give --seed twice for further draws of one"
                " recording"
            )


def _finished(ready: Plan) -> Results | None:
    """Return the results of a plan that was carried out before by the same code, or None."""
    try:
        manifest = read_manifest(ready.out)
        same = manifest["identity"] == ready.identity and manifest["code"] == ready.code
        is_done = (
            same and manifest.get("state") == "finished" and not manifest.get("failed")
        )
        return load(ready.out) if is_done else None
    except DataError:
        return None
