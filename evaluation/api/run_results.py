"""Tables, figures and page of a run folder, from its finished cells."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_limits

from evaluation.api.run_estimates import (
    AttackComparison,
    SceneEstimates,
    compare_attacks,
    level_table,
    link_estimates,
    scene_estimates,
)
from evaluation.estimates import (
    conflict_times,
    paper,
    standing_still,
    summary,
    weak_attacks,
)
from evaluation.estimates.bounds import gaps
from evaluation.estimates.by_speed import by_speed
from evaluation.estimates.families import Family, entry_families
from evaluation.estimates.frontier import frontier
from evaluation.estimates.galleries import galleries
from evaluation.estimates.keys import judged_at
from evaluation.estimates.linked_people import Choices, read_probes
from evaluation.estimates.matching import matched
from evaluation.estimates.own_plugins import RunNumbers, plugin_records
from evaluation.estimates.patrols import PatrolNumber, patrol_frame, patrol_numbers
from evaluation.estimates.returns import ReturnNumbers, return_numbers
from evaluation.estimates.strongest_table import strongest_table
from evaluation.estimates.sweeps import FUTURE, Sweeps
from evaluation.estimates.tracking import track_numbers
from evaluation.plan.address import Address
from evaluation.plan.environment import check_drawing
from evaluation.plan.world import World
from evaluation.pool.workers import run_in_idle_worker
from evaluation.reporting import page
from evaluation.reporting.answers import answers
from evaluation.reporting.figures import figure
from evaluation.reporting.first_screen import first_table
from evaluation.reporting.rows import Results
from evaluation.reporting.tables import write_tex, write_text
from evaluation.store import folder
from evaluation.store.checksums import check_sound
from evaluation.store.csv_files import to_csv
from evaluation.store.entries import FAILED_COLUMNS
from evaluation.store.files import FRAMES, write_whole
from evaluation.store.lock import locked
from evaluation.store.manifest import file_names, read_manifest
from evaluation.store.sample_tracks import read_sample_tracks
from evaluation.verdict.items import LinkedPeopleSections
from evaluation.verdict.level_rows import leading_handover
from evaluation.verdict.patrol_json import patrols_json
from evaluation.verdict.returns import return_answer, return_json
from evaluation.verdict.sections import build_verdict, linked_people_sections
from evaluation.verdict.verdict_json import to_bytes, verdict_json

limit_threads = partial(threadpool_limits, limits=1, user_api="blas")
"""Keep linear algebra to this thread: for small matrices others would only spin."""


def rebuild(out: Path | str, *, pdf: bool = False) -> Results:
    """Write tables, figures and page of a run folder anew, with `pdf` also as PDF.

    Raises IsacTrackError if the folder holds no run, or a cell is missing or has
    changed.
    """
    out = Path(out)
    if pdf:
        check_drawing()
    manifest = read_manifest(out)
    with locked(out), limit_threads():
        check_sound(out, file_names(manifest), sizes=manifest.get("sizes", ()))
        return build(out, pdf=pdf)


def build(out: Path, *, pictures: bool = True, pdf: bool = False) -> Results:
    """Write summary, tables and figures of a run folder, and return them.

    Otherwise as `rebuild`, which locks the folder and checks its cells first.
    """
    results, search_extent = _compute_results(out)
    results = replace(results, make_first_table=first_table)
    frames = [getattr(results, name) for name in FRAMES]
    with run_in_idle_worker(partial(_to_csv_files, frames)) as wait_for_csv:
        write_whole(
            out / "flags.json", weak_attacks.to_json(results.flags, search_extent)
        )
        write_whole(out / "verdict.json", to_bytes(results.verdict))
        write_tex(results, folder=out / "tables")
        write_text(results)
        for name, content in zip(FRAMES.values(), wait_for_csv(), strict=True):
            write_whole(out / name, content)
    folder.remove_figures(out)  # figures of an earlier report show other results
    if pictures:
        _draw(results, pdf=pdf)
    return results


def _compute_results(out: Path) -> tuple[Results, dict[str, Any]]:
    """Return the results of a run's cells, and the extent of the search for flags."""
    manifest = read_manifest(out)
    dataset = manifest["dataset"]["name"]
    families = entry_families(manifest["cells"])
    with run_in_idle_worker(partial(link_estimates, out, manifest)) as wait_for_links:
        scenes = scene_estimates(out, manifest)
        links = wait_for_links()
    compared = compare_attacks(scenes, links, families)
    sweeps, best = compared.sweeps, compared.strongest_by_task
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
        returns = return_numbers(out, manifest)
        tracked = track_numbers(out, manifest)
        flags, search_extent = _flags(manifest, scenes, tidy)
        speeds = by_speed(out, manifest, sweeps.estimates, families=families, best=best)
        gallery_table, linked_people = wait_for_people()
    verdict_parts = _verdict(manifest, scenes, compared, linked_people)
    verdict_parts |= _further_verdicts(manifest, on_patrol, returns, families)
    results = Results(
        out=out,
        manifest=manifest,
        summary=_whole_summary(
            tidy, [*on_patrol, *tracked], returns, families=families, dataset=dataset
        ),
        paper_table=paper.paper_table(sweeps, dataset=dataset),
        claims=paper.claims(
            sweeps, matches, dataset=dataset, history=manifest["history"]
        ),
        matched=matches,
        frontier=frontiers,
        levels=level_table(manifest, scenes, links, attacks=compared.by_mechanism),
        attacked=strongest_table(
            compared.by_mechanism, sweeps.estimates, dataset=dataset
        ),
        decisions=scenes.decided,
        curves=scenes.curves,
        flags=flags,
        linkability=links.table,
        galleries=gallery_table,
        speeds=speeds,
        verdict=verdict_parts,
        failed=_failed_frame(manifest),
        strongest={task: reader.without_task for task, reader in best.items()},
        conflict_times=conflict_times.conflict_times(out, manifest),
        gallery=read_sample_tracks(out),
    )
    sentences = [answer.sentence for answer in answers(results)]
    with_answer = {"answer": sentences, **verdict_parts}
    return replace(results, verdict=with_answer), search_extent


def _whole_summary(
    tidy: pd.DataFrame,
    on_patrol: Sequence[PatrolNumber],
    returns: ReturnNumbers,
    *,
    families: Mapping[str, Family],
    dataset: str,
) -> pd.DataFrame:
    """Return the tidy summary; behind it returning people, then patrols and tracks."""
    patrols = patrol_frame(
        on_patrol, families=families, dataset=dataset, columns=summary.COLUMNS
    )
    returning = summary.to_frame(
        returns.estimates, worlds={}, families=families, dataset=dataset
    )
    parts = [part for part in (tidy, returning, patrols) if len(part)]
    if not parts:
        return tidy
    return pd.concat(parts, ignore_index=True) if len(parts) > 1 else parts[0]


def _further_verdicts(
    manifest: Mapping[str, Any],
    on_patrol: Sequence[PatrolNumber],
    returns: ReturnNumbers,
    families: Mapping[str, Family],
) -> dict[str, Any]:
    """Return the answers on patrols and people who come back, where a run has any."""
    answered: dict[str, Any] = {}
    if on_patrol:
        answered["patrols"] = patrols_json(on_patrol, families=families)
    confirming = manifest["settings"].get("confirming")
    if returning := return_answer(returns, confirming=confirming):
        answered["returns"] = return_json(returning)
    return answered


def _flags(
    manifest: Mapping[str, Any], scenes: SceneEstimates, tidy: pd.DataFrame
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Return the flags of attacks that may be too weak, and the extent of the search.

    `tidy` is the run's summary.
    """
    flagged, search_extent = weak_attacks.flags(
        scenes.estimates, slow=weak_attacks.slow_attacks(manifest)
    )
    far = weak_attacks.far_from_optimum(gaps(tidy))
    if len(far):
        flagged = pd.concat([flagged, far], ignore_index=True)
    return flagged, search_extent


def _failed_frame(manifest: Mapping[str, Any]) -> pd.DataFrame:
    """Return `failed.csv`: the cells that could not be computed, with reasons."""
    rows = [entry.fields() for entry in manifest.get("failed", [])]
    return pd.DataFrame(rows, columns=list(FAILED_COLUMNS))


def _frontiers_and_matches(
    manifest: Mapping[str, Any], scenes: SceneEstimates, compared: AttackComparison
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return `frontier.csv` and `matched.csv`: at the run's horizon, then at others."""
    dataset = manifest["dataset"]["name"]
    predictors = manifest["settings"]["predictors"]
    sweeps, attacks = compared.sweeps, compared.by_mechanism
    matches = [matched(sweeps, predictors=predictors, dataset=dataset)]
    frontiers = [
        frontier(sweeps, predictors=predictors, dataset=dataset, attacks=attacks)
    ]
    for horizon_s, robots in scenes.further_horizons.items():
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
    scenes: SceneEstimates,
    compared: AttackComparison,
    linked_people: LinkedPeopleSections,
) -> dict[str, Any]:
    """Return the verdict as in `verdict.json`, with a user's own plug-ins."""
    judged = compared.judged_sweeps()
    further = {
        horizon_s: Sweeps(
            judged_at(judged.estimates, robots.all_estimates), compared.families
        )
        for horizon_s, robots in scenes.further_horizons.items()
    }
    decided = build_verdict(
        judged,
        linked_people,
        strongest=compared.strongest_by_task,
        scored={
            task: crossed.choices
            for task, crossed in compared.cross_fitted_by_task.items()
        },
        later=further,
        manifest=manifest,
    )
    parts = verdict_json(decided)
    if own_plugins := manifest.get("own_plugins"):
        estimates = RunNumbers(
            own=compared.sweeps.estimates,
            later=scenes.further_estimates,
            sums=compared.sums,
            families=compared.families,
            attacks=compared.by_mechanism,
            leading=leading_handover(compared.strongest_by_task),
        )
        parts["plugins"] = plugin_records(own_plugins, estimates)
    parts["robots"] = standing_still.beaten_by_standing_still(
        scenes.estimates, scenes.further_estimates
    )
    return parts


def _people_tables(
    out: Path,
    manifest: Mapping[str, Any],
    sweeps: Sweeps,
    strongest: Mapping[str, Address],
    choices: Mapping[tuple[str, str], Choices],
) -> tuple[pd.DataFrame, LinkedPeopleSections]:
    """Return `gallery.csv`, and the parts of the verdict about linked people."""
    probes = read_probes(out, manifest, sweeps, strongest=strongest, choices=choices)
    dataset, seed = manifest["dataset"]["name"], manifest["identity"]["seed"]
    gallery_table = galleries(probes, sweeps.estimates, dataset=dataset, seed=seed)
    return gallery_table, linked_people_sections(
        probes, sweeps, strongest=strongest, manifest=manifest
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
