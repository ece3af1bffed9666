"""The sections of the verdict, put together to a record of the whole run."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from evaluation.estimates.linked_people import LinkedProbes, sum_by_cluster
from evaluation.estimates.metrics import PLR
from evaluation.estimates.sweeps import FUTURE, Sweeps
from evaluation.plan.address import Address
from evaluation.verdict import claim, rules
from evaluation.verdict.bands import Draft, decide_section
from evaluation.verdict.inflation import draft_inflation
from evaluation.verdict.items import (
    BandItem,
    ClaimDetails,
    LinkedPeopleSections,
    Verdict,
)
from evaluation.verdict.validity import validity
from evaluation.verdict.within_level import draft_within


def linked_people_sections(
    levels: Mapping[str, Sequence[LinkedProbes]],
    sweeps: Sweeps,
    *,
    strongest: Mapping[str, Address],
    manifest: Mapping[str, Any],
) -> LinkedPeopleSections:
    """Return the sections that rest on linked people: validity and within.

    `levels` has the linked probes of each level by task; `strongest` names the
    strongest linker of each task. Only the levels of `sweeps` are used, no estimate.
    """
    linkers = {task: linker for task, linker in strongest.items() if task}
    seed = manifest["identity"]["seed"]
    across_mechanisms = validity(
        sum_by_cluster(levels),
        families=sweeps.families,
        preset=manifest["settings"]["preset"],
        dataset=manifest["dataset"]["name"],
        seed=seed,
    )
    within = decide_section(draft_within(levels, sweeps, success=linkers, seed=seed))
    return LinkedPeopleSections(across_mechanisms, tuple(within))


def build_verdict(
    sweeps: Sweeps,
    linked_people: LinkedPeopleSections,
    *,
    strongest: Mapping[str, Address],
    scored: Mapping[str, Mapping[str, Sequence[Address]]] | None = None,
    later: Mapping[float, Sweeps] | None = None,
    manifest: Mapping[str, Any],
) -> Verdict:
    """Return the verdict of a run.

    `linked_people` is the result of `linked_people_sections`; `strongest` gives the
    strongest linker by task, and under "" the strongest reconstruction. `scored` gives
    the attacks that either half of the people chose, by task and ranking metric: they
    score the numbers in `sweeps` under the strongest's name. `later` are the same with
    robots judged at further horizons, s: there the claim is read with conflicts that
    are still to come.
    """
    attacks = [attack for task, attack in strongest.items() if not task]
    predictors = manifest["settings"]["predictors"]
    claims = _draft_all_claims(sweeps, strongest, predictors, later or {})
    decided = [
        *decide_section(claims),
        *decide_section(draft_inflation(sweeps, attacks)),
    ]
    scored_items = [
        replace(item, scored_by=_scoring_attacks(item, scored or {}))
        for item in decided
    ]
    dataset, across_mechanisms = manifest["dataset"], linked_people.validity
    return Verdict(
        dataset=dataset["name"],
        is_simulated=bool(dataset.get("simulated", False)),
        seed=manifest["identity"]["seed"],
        preset=manifest["settings"]["preset"],
        n_scenes=manifest["settings"]["scenes"],
        items=(*across_mechanisms.items, *linked_people.within, *scored_items),
        controls=across_mechanisms.controls,
        trials=across_mechanisms.trials,
    )


def _draft_all_claims(
    sweeps: Sweeps,
    strongest: Mapping[str, Address],
    predictors: Sequence[str],
    later: Mapping[float, Sweeps],
) -> list[Draft]:
    """Return the claims of the first predictor, at the run's horizon and at others."""
    claims: list[Draft] = []
    for predictor in predictors[:1]:
        claims += claim.draft_claims(sweeps, strongest, predictor=predictor)
        for horizon_s, at_horizon in later.items():
            claims += claim.draft_claims(
                at_horizon,
                strongest,
                predictor=predictor,
                criteria=(FUTURE,),
                horizon_s=horizon_s,
            )
    return claims


def _scoring_attacks(
    item: BandItem, scored: Mapping[str, Mapping[str, Sequence[Address]]]
) -> tuple[str, ...]:
    """Return the attacks that score an item; empty if they are those of its topic."""
    topic, details = item.topic, item.details
    is_after = topic.section == rules.INFLATION or topic.compared == claim.AFTER_ATTACK
    if is_after:
        ranked_by = PLR
    elif isinstance(details, ClaimDetails) and topic.compared == claim.LINKED:
        ranked_by = details.metric
    else:
        return ()
    choices = scored.get(topic.task, {}).get(ranked_by, ())
    labels = tuple(choice.without_task.label for choice in choices)
    return labels if {*labels} - {topic.attack} else ()
