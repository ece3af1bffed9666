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
from evaluation.estimates.families import CLEAN, RAW, Family, entry_families
from evaluation.estimates.frontier import frontier
from evaluation.estimates.galleries import TPR, galleries
from evaluation.estimates.keys import judged_at
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
from evaluation.estimates.patrols import patrol_frame, patrol_numbers
from evaluation.estimates.pooled import Answered, answered, run_answers, to_frame
from evaluation.estimates.strongest import (
    HEADLINE,
    CrossFitted,
    cross_fitted,
    strongest,
)
from evaluation.estimates.strongest_table import (
    Strongest,
    strongest_on_each,
    strongest_table,
)
from evaluation.plan.address import Address
from evaluation.plan.constants import BLOCK_SCENES, MOST_SCENES
from evaluation.plan.plan import Plan, plan, plan_stronger
from evaluation.plan.settings import Settings, check_drawing
from evaluation.plan.world import OWN_WORLD, WORLDS, World
from evaluation.pool.execute import execute, execute_stronger
from evaluation.pool.memory import release_memory_after
from evaluation.pool.workers import run_in_idle_worker, start_workers_early
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
from evaluation.store.cell_files import read_gallery
from evaluation.store.entries import FAILED_COLUMNS, Entry, horizons_in
from evaluation.store.files import FRAMES, check_sound, locked, to_csv, write_whole
from evaluation.store.linkage_outcomes import ClusterSums
from evaluation.store.manifest import file_names, read_manifest
from evaluation.verdict import sections as verdict
from evaluation.verdict.patrols import built_in, recommend_policy
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
_limit_threads = partial(threadpool_limits, limits=1, user_api="blas")
"""Keep linear algebra to this thread: for small matrices others would only spin."""
_DRAWN: Final = (*ACHIEVED, ASSIGNED, SUCCESS_OF_100)
"""Metrics of linkers that are compared, and so have replicates."""
_PEOPLE_METRICS: Final = (EXPOSURE, SUCCESS, ASSIGNED, TPR)
"""Metrics of the tables about linked people."""


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
    policies : sequence of SPECs or plug-in objects, optional
        What answers to robots on patrol disclose, as above.
    adversaries : sequence of str, optional
        Adversaries beside blind, informed and oracle.
    scenes : int, optional
        All scenes, which are all attacked.
    utility_scenes : int, optional
        All scenes; the attacked ones stay the preset's first.
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
    persistent_ids : bool, optional
        Whether ids are the same people in all sessions.
    progress : bool or callable
        Whether to show the data and the progress of the run, or a function of cells
        finished, cells to do, and the cell under way.
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
        option.name: given[option.name]
        for option in fields(Settings)
        if given[option.name] is not None
    }
    options |= unknown
    report = progress if callable(progress) else lambda *_: None
    if ready is None:
        asked = (settings or Settings()).changed(**options)
        ready = plan(sized(asked, progress=report))
    elif settings is not None or options:
        raise SettingsError(
            "a ready plan has its settings already: leave out all others"
        )
    folder.check_folder(ready.out)
    shown: AbstractContextManager[Callable[[int, int, str], None]] = (
        contextlib.nullcontext(report)
    )
    if progress is True:
        shown = progress_bar([], heading=[*plan_lines(ready)])
    with shown as update:
        return _carry_out(ready, update, pictures=pictures, walks=walks)


def _carry_out(
    ready: Plan, update: Callable[[int, int, str], None], *, pictures: bool, walks: bool
) -> Results:
    """Compute the cells of a plan; write and return its results."""
    numeric = np.errstate(all="warn", under="ignore")  # whatever a plug-in's module set
    with release_memory_after(), locked(ready.out), _limit_threads(), numeric:
        with start_workers_early():
            execute(ready, update, keeps_walks=walks)
            _try_stronger(ready, update)
        # Use a fresh worker: those of cells hold too much memory, and have run users'
        # plug-ins.
        with start_workers_early(int(ready.jobs > 1), (__name__,)):
            return build(ready.out, pictures=pictures)


def sized(settings: Settings, *, progress: Callable[[int, int, str], None]) -> Settings:
    """Return settings with the number of scenes that their precision takes; see docs.

    A pilot of 250 scenes, in a folder beside the run's, shows the half-width h of the
    widest interval of a missed-conflict rate: 250 (h / precision)^2 scenes, rounded up
    to whole blocks. Raises SettingsError if that is more than a run takes, or no
    predictor reads.
    """
    if settings.precision is None or settings.utility_scenes is not None:
        return settings
    usual = plan(settings)
    if not usual.axes.predictors:
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
        stages=settings.stages.changed({"conflict.horizons_s": ()}),
        out=out,
    )
    ready = plan(pilot_settings)
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
    """Write tables, figures and page of a run folder anew, with `pdf` also as PDF.

    Raises IsacTrackError if the folder holds no run, or a cell is missing or has
    changed.
    """
    out = Path(out)
    if pdf:
        check_drawing()
    manifest = read_manifest(out)
    with locked(out), _limit_threads():
        check_sound(out, file_names(manifest), sizes=manifest.get("sizes", ()))
        return build(out, pdf=pdf)


def build(out: Path, *, pictures: bool = True, pdf: bool = False) -> Results:
    """Write summary, tables and figures of a run folder, and return them.

    Otherwise as `rebuild`, which locks the folder and checks its cells first.
    """
    results, searched = _results(out)
    results = replace(results, make_first_table=first_table)
    frames = [getattr(results, name) for name in FRAMES]
    with run_in_idle_worker(partial(_to_csv_files, frames)) as wait_for_csv:
        write_whole(out / "flags.json", weak_attacks.to_json(results.flags, searched))
        write_whole(out / "verdict.json", verdict.to_bytes(results.verdict))
        write_tex(results, folder=out / "tables")
        write_text(results)
        for name, content in zip(FRAMES.values(), wait_for_csv(), strict=True):
            write_whole(out / name, content)
    folder.remove_figures(out)  # figures of an earlier report show other results
    if pictures:
        _draw(results, pdf=pdf)
    return results


@dataclass(frozen=True, eq=False, slots=True)
class _LinkEstimates:
    """Estimates from the cells of linkage."""

    estimates: dict[Address, Estimate]
    sums: dict[Address, ClusterSums]
    table: pd.DataFrame  # `linkability.csv`


def _link_estimates(out: Path, manifest: Mapping[str, Any]) -> _LinkEstimates:
    cards = linkability.cards(out, manifest, drawn=_DRAWN)
    return _LinkEstimates(
        estimates=summary.linkage_estimates(cards),
        sums=summary.linkage_sums(cards),
        table=linkability.linkability(cards, dataset=manifest["dataset"]["name"]),
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Judged:
    """Robots judged at a horizon: their metrics, and misses against false alarms."""

    estimates: Mapping[Address, Estimate]
    at_raw_alarms: Mapping[Address, Estimate]
    best: BestRobots  # Over the levels that a site may choose, and raw.
    curves: pd.DataFrame
    decided: pd.DataFrame

    @property
    def all_estimates(self) -> dict[Address, Estimate]:
        """All estimates, those at raw's false-alarm rate among them."""
        return {**self.estimates, **self.at_raw_alarms}


@dataclass(frozen=True, eq=False, slots=True)
class _SceneEstimates:
    """Estimates from the cells of scenes."""

    estimates: Mapping[Address, Estimate]
    attacked: dict[Address, ClusterSums]
    worlds: Mapping[
        World, Mapping[Address, Estimate]
    ]  # Others, further horizons among them.
    own: _Judged  # At the run's own horizon.
    later: Mapping[float, _Judged]  # At further horizons, s, ascending.

    @property
    def estimates_later(self) -> dict[float, Mapping[Address, Estimate]]:
        """The metrics at further horizons."""
        return {horizon_s: robots.estimates for horizon_s, robots in self.later.items()}

    @property
    def judged(self) -> list[_Judged]:
        """Robots at every horizon, the run's own first."""
        return [self.own, *self.later.values()]


def _scene_estimates(out: Path, manifest: Mapping[str, Any]) -> _SceneEstimates:
    estimates, scored, attacked = summary.estimates(out, manifest)
    dataset = manifest["dataset"]["name"]
    own = _judged(scored, manifest, estimates, dataset=dataset)
    later = dict[float, _Judged]()
    worlds: dict[World, Mapping[Address, Estimate]] = {}
    for horizon_s in horizons_in(manifest["cells"]):
        world = World(horizon_s=horizon_s)
        worlds[world], scored, _ = summary.estimates(out, manifest, world=world)
        name = Address(recording=dataset, world=world).dataset
        later[horizon_s] = _judged(scored, manifest, worlds[world], dataset=name)
    for world in WORLDS:
        cards = linkability.cards(out, manifest, drawn=_DRAWN, world=world)
        in_world = summary.estimates(out, manifest, world=world)[0]
        in_world |= linked_gaps(summary.linkage_estimates(cards))
        # Without replicates, as large as a run's own: no comparison pairs with them.
        worlds[world] = {
            key: replace(estimate, replicates=np.zeros(0))
            for key, estimate in in_world.items()
        }
    return _SceneEstimates(estimates, attacked, worlds, own, later)


def _judged(
    scored: Sequence[summary.Scored],
    manifest: Mapping[str, Any],
    estimates: Mapping[Address, Estimate],
    *,
    dataset: str,
) -> _Judged:
    curves, decided, at_raw_alarms = decisions(
        scored, manifest, estimates, dataset=dataset
    )
    candidates = {
        name
        for name, family in entry_families(manifest["cells"]).items()
        if family.protects or family.family == RAW
    }
    best = best_robots(
        scored, manifest, {**estimates, **at_raw_alarms}, among=candidates
    )
    return _Judged(estimates, at_raw_alarms, best, curves, decided)


@dataclass(frozen=True, eq=False, slots=True)
class _Compared:
    """All estimates of a run, and the strongest attacks among them."""

    sweeps: Sweeps
    families: Mapping[str, Family]  # The mechanisms of the run, by name.
    sums: Mapping[Address, ClusterSums]  # Of attacks.
    best: Mapping[str, Address]  # The strongest linker by task; a reconstruction as "".
    crossed: Mapping[str, CrossFitted]  # Their success without the bias of the choice.
    by_mechanism: tuple[Strongest, ...]

    @property
    def choices(self) -> dict[tuple[str, str], Choices]:
        """Choices of the strongest linkers, by task and mechanism; "": of all."""
        choices: dict[tuple[str, str], Choices] = {
            (task, ""): crossed.choices
            for task, crossed in self.crossed.items()
            if task
        }
        for attack in self.by_mechanism:
            if attack.source.task and attack.among == HEADLINE:
                key = attack.source.task, attack.mechanism
                choices[key] = attack.crossed.choices
        return choices

    def people_sweeps(self) -> Sweeps:
        """Return the sweeps of the metrics that linked people are described by."""
        estimates = {
            key: estimate
            for key, estimate in self.sweeps.estimates.items()
            if key.metric in _PEOPLE_METRICS
        }
        return Sweeps(estimates, self.families)

    def judged_sweeps(self) -> Sweeps:
        """Return all sweeps, with cross-fitted estimates of the strongest attacks."""
        estimates = {**self.sweeps.estimates}
        for crossed in self.crossed.values():
            estimates |= crossed.estimates
        return Sweeps(estimates, self.families)


def _compare_attacks(
    scenes: _SceneEstimates, links: _LinkEstimates, families: Mapping[str, Family]
) -> _Compared:
    """Find the strongest attacks of a run, at all levels and against each mechanism."""
    sums = links.sums | scenes.attacked
    estimates = {
        **scenes.estimates,
        **scenes.own.at_raw_alarms,
        **links.estimates,
    }
    sweeps = Sweeps(estimates, families)
    best = strongest(sweeps.estimates, families)
    crossed = {
        task: cross_fitted(sums, families, source, by=SUCCESS if task else EXPOSURE)
        for task, source in best.items()
    }
    by_mechanism = strongest_on_each(sweeps.estimates, sums, families)
    return _Compared(sweeps, families, sums, best, crossed, by_mechanism)


def _results(out: Path) -> tuple[Results, dict[str, Any]]:
    """Return the results of a run's cells, and the extent of the search for flags."""
    manifest = read_manifest(out)
    dataset = manifest["dataset"]["name"]
    families = entry_families(manifest["cells"])
    with run_in_idle_worker(partial(_link_estimates, out, manifest)) as wait_for_links:
        scenes = _scene_estimates(out, manifest)
        links = wait_for_links()
    flagged, searched = weak_attacks.flags(
        scenes.estimates, slow=weak_attacks.slow_attacks(manifest)
    )
    compared = _compare_attacks(scenes, links, families)
    sweeps, best = compared.sweeps, compared.best
    describe_people = partial(
        _people_tables, out, manifest, compared.people_sweeps(), best, compared.choices
    )
    with run_in_idle_worker(describe_people) as wait_for_people:
        frontiers, matches = _frontiers_and_matches(manifest, scenes, compared)
        tidy = summary.to_frame(
            {**scenes.estimates, **links.estimates},
            worlds=scenes.worlds,
            families=families,
            dataset=dataset,
        )
        on_patrol = patrol_numbers(out, manifest)
        patrols = patrol_frame(
            on_patrol,
            families=families,
            dataset=dataset,
            columns=summary.COLUMNS,
        )
        far = weak_attacks.far_from_optimum(gaps(tidy))
        speeds = by_speed(out, manifest, sweeps.estimates, families=families, best=best)
        gallery_table, validity = wait_for_people()
    answered_verdict = _verdict(manifest, scenes, compared, validity)
    if on_patrol:
        answered_verdict["patrols"] = {
            "recommended": recommend_policy(on_patrol),
            "by_construction": built_in(on_patrol),
        }
    results = Results(
        out=out,
        manifest=manifest,
        summary=pd.concat([tidy, patrols], ignore_index=True) if len(patrols) else tidy,
        paper_table=paper.paper_table(sweeps, dataset=dataset),
        claims=paper.claims(
            sweeps, matches, dataset=dataset, history=manifest["history"]
        ),
        matched=matches,
        frontier=frontiers,
        levels=_level_table(manifest, scenes, links, attacks=compared.by_mechanism),
        attacked=strongest_table(
            compared.by_mechanism, sweeps.estimates, dataset=dataset
        ),
        decisions=pd.concat(
            [robots.decided for robots in scenes.judged], ignore_index=True
        ),
        curves=pd.concat(
            [robots.curves for robots in scenes.judged], ignore_index=True
        ),
        flags=pd.concat([flagged, far], ignore_index=True) if len(far) else flagged,
        linkability=links.table,
        galleries=gallery_table,
        speeds=speeds,
        verdict=answered_verdict,
        failed=_failed_frame(manifest),
        strongest={task: source.without_task for task, source in best.items()},
        conflict_times=horizons.conflict_times(out, manifest),
        gallery=read_gallery(out),
    )
    sentences = [answer.sentence for answer in answers(results)]
    with_answer = {"answer": sentences, **answered_verdict}
    return replace(results, verdict=with_answer), searched


def _failed_frame(manifest: Mapping[str, Any]) -> pd.DataFrame:
    """Return `failed.csv`: the cells that could not be computed, with reasons."""
    rows = [entry.fields() for entry in manifest.get("failed", [])]
    return pd.DataFrame(rows, columns=list(FAILED_COLUMNS))


def _frontiers_and_matches(
    manifest: Mapping[str, Any], scenes: _SceneEstimates, compared: _Compared
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return `frontier.csv` and `matched.csv`: at the run's horizon, then at others."""
    dataset = manifest["dataset"]["name"]
    predictors = manifest["settings"]["predictors"]
    sweeps, attacks = compared.sweeps, compared.by_mechanism
    matches = [matched(sweeps, predictors=predictors, dataset=dataset)]
    frontiers = [
        frontier(sweeps, predictors=predictors, dataset=dataset, attacks=attacks)
    ]
    for horizon_s, robots in scenes.later.items():
        at_horizon = Sweeps(
            judged_at(sweeps.estimates, robots.all_estimates), compared.families
        )
        world = World(horizon_s=horizon_s)
        frontiers.append(
            frontier(
                at_horizon,
                predictors=predictors,
                attacks=attacks,
                dataset=dataset,
                world=world,
            )
        )
        matches.append(
            matched(
                at_horizon,
                predictors=predictors[:1],
                criteria=(FUTURE,),
                dataset=dataset,
                world=world,
            )
        )
    return (
        pd.concat(frontiers, ignore_index=True),
        pd.concat(matches, ignore_index=True),
    )


def _verdict(
    manifest: Mapping[str, Any],
    scenes: _SceneEstimates,
    compared: _Compared,
    validity: dict[str, list[dict[str, Any]]],
) -> dict[str, Any]:
    """Return the verdict of a run, with records of a user's own plug-ins."""
    judged = compared.judged_sweeps()
    later = {
        horizon_s: Sweeps(
            judged_at(judged.estimates, robots.all_estimates), compared.families
        )
        for horizon_s, robots in scenes.later.items()
    }
    parts = verdict.verdict(
        judged,
        validity,
        strongest=compared.best,
        scored={task: crossed.choices for task, crossed in compared.crossed.items()},
        later=later,
        manifest=manifest,
    )
    if own_plugins := manifest.get("own_plugins"):
        estimates = Estimates(
            compared.sweeps.estimates,
            scenes.estimates_later,
            compared.sums,
            compared.families,
            compared.by_mechanism,
            leading_handover(compared.best),
        )
        parts["plugins"] = plugin_records(own_plugins, estimates)
    parts["robots"] = horizons.beaten_by_standing_still(
        scenes.estimates, scenes.estimates_later
    )
    return parts


def _try_stronger(ready: Plan, update: Callable[[int, int, str], None]) -> None:
    """Let stronger adversaries attack the levels that would be proposed."""
    all_specs = [plugin.spec for plugin in ready.axes.mechanisms]
    if not plan_stronger(ready, specs=all_specs).units:
        return
    manifest = read_manifest(ready.out)
    entries = _proposal_entries(manifest["cells"])
    proposed = _proposed_levels(ready.out, manifest | {"cells": entries})
    specs = [entry.spec for entry in entries if entry.address.where in proposed]
    # All cells of the run are finished: these few are not counted among them.
    n_cells = ready.n_cells

    def report(_done: int, _total: int, cell: str) -> None:
        update(n_cells, n_cells, f"levels to propose: {cell}")

    execute_stronger(plan_stronger(ready, specs=specs), report)


def _proposal_entries(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries that proposed levels rest on.

    They are of protections, raw and clean, at all horizons; of the linkage tasks only
    the leading handover.
    """
    names = {
        name
        for name, family in entry_families(entries).items()
        if family.protects or family.family in (RAW, CLEAN)
    }
    leading = leading_handover({entry.address.task for entry in entries})

    def is_wanted(address: Address) -> bool:
        in_world = not (address.world.law or address.world.is_model)
        return address.mechanism in names and address.task in ("", leading) and in_world

    return [entry for entry in entries if is_wanted(entry.address)]


def _proposed_levels(out: Path, manifest: Mapping[str, Any]) -> set[Any]:
    """Return mechanism and level of each level that would be proposed now."""
    families = entry_families(manifest["cells"])
    scenes, links = _scene_estimates(out, manifest), _link_estimates(out, manifest)
    attacks = strongest_on_each(
        {**scenes.estimates, **links.estimates}, links.sums | scenes.attacked, families
    )
    table = _level_table(manifest, scenes, links, attacks=attacks)
    dataset, question = manifest["dataset"]["name"], default_question(families)
    offers = recommend(table, question, dataset=dataset).candidates
    return {offer.where for offer in offers}


def _level_table(
    manifest: Mapping[str, Any],
    scenes: _SceneEstimates,
    links: _LinkEstimates,
    *,
    attacks: Sequence[Strongest],
) -> pd.DataFrame:
    """Return privacy and utility of a site at each level: `levels.csv`."""
    later = {
        World(horizon_s=horizon_s): robots for horizon_s, robots in scenes.later.items()
    }
    return levels(
        {**scenes.estimates, **scenes.own.at_raw_alarms, **links.estimates},
        attacks=attacks,
        horizons={world: robots.all_estimates for world, robots in later.items()},
        best={OWN_WORLD: scenes.own.best}
        | {world: robots.best for world, robots in later.items()},
        linked=links.table,
        families=entry_families(manifest["cells"]),
        dataset=manifest["dataset"]["name"],
    )


def _people_tables(
    out: Path,
    manifest: Mapping[str, Any],
    sweeps: Sweeps,
    best: Mapping[str, Address],
    choices: Mapping[tuple[str, str], Choices],
) -> tuple[pd.DataFrame, dict[str, list[dict[str, Any]]]]:
    """Return `gallery.csv`, and the parts of the verdict about linked people."""
    probes = read_probes(out, manifest, sweeps, strongest=best, choices=choices)
    dataset, seed = manifest["dataset"]["name"], manifest["identity"]["seed"]
    gallery_table = galleries(probes, sweeps.estimates, dataset=dataset, seed=seed)
    return gallery_table, verdict.validity_sections(
        probes, sweeps, strongest=best, manifest=manifest
    )


def _to_csv_files(frames: Sequence[pd.DataFrame]) -> list[bytes]:
    return [to_csv(frame) for frame in frames]


def _draw(results: Results, *, pdf: bool) -> None:
    figures = figure.make_figures(results)
    folder.record_figures(results.out, [drawing.name for drawing in figures])
    figure.write(
        figures, folder=results.out / "figures", dataset=results.dataset, pdf=pdf
    )
    page.write(results, figures=figures)


def study(
    asked: Sequence[tuple[str, Settings]], *, out: Path
) -> tuple[list[Answered], int]:
    """Do the unfinished runs, answer all as one, write `study.csv` and `study.html`.

    `asked` are the error law and the settings of each run, whose folder is in `out`.
    Returns the answers, and the number of failed cells. Raises IsacTrackError for
    anything that a user can mend.
    """
    plans, datasets = list[tuple[str, Plan]](), dict[str | None, Dataset]()
    # All are checked before the first run, and each recording is read once.
    for law, settings in asked:
        ready = plan(settings, dataset=datasets.get(settings.dataset))
        plans.append((law, ready))
        datasets[settings.dataset] = ready.dataset
    _refuse_copies([ready for _, ready in plans])
    rows, simulated, n_failed = [], frozenset[str](), 0
    for law, ready in plans:
        if results := _finished(ready):
            sys.stderr.write(f"{ready.out}: finished before\n")
        else:
            results = run(ready=ready)
        rows += run_answers(results.out, results.manifest, results.verdict, law=law)
        n_failed += len(results.failed)
        if results.manifest["dataset"].get("simulated"):
            simulated |= {results.dataset}
    pooled = answered(rows, simulated=simulated)
    write_whole(out / "study.csv", to_csv(to_frame(rows, pooled)))
    html = study_page.render(
        pooled, simulated=simulated, runs=[ready.out.name for _, ready in plans]
    )
    write_whole(out / "study.html", html.encode())
    return pooled, n_failed


def _refuse_copies(plans: Sequence[Plan]) -> None:
    """Raise SettingsError if two recordings of a study are the same bytes."""
    name_by_digest: dict[str, str] = {}
    for ready in plans:
        name = str(ready.settings.dataset)
        first = name_by_digest.setdefault(ready.dataset.sha256, name)
        if first != name:
            raise SettingsError(
                f"{first} and {name} hold the same bytes: one recording twice is not"
                " two; leave out one, or give --seed twice for further draws of one"
                " recording"
            )


def _finished(ready: Plan) -> Results | None:
    """Return the results of a plan that the same code has finished; else None."""
    try:
        manifest = read_manifest(ready.out)
        is_same = (
            manifest["identity"] == ready.identity and manifest["code"] == ready.code
        )
        is_finished = manifest.get("state") == "finished"
        if is_same and is_finished and not manifest.get("failed"):
            return load(ready.out)
    except DataError:
        pass
    return None
