"""The verdict: do PLR, AEL and MEL track real linkability? `verdict.json`.

There are four sections, each under both adding rules: *validity* across mechanisms,
validity *within* a level, the paper's *claim* that FID has the advantage over fixed
noise at equal missed rate, and *inflation*: how much higher each descriptor is after
the strongest attack than as shared. The rules of decision are in `rules`, and in words
in docs/explanation/verdict.md.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from evaluation.estimates.linked_people import LinkedProbes, sum_by_cluster
from evaluation.estimates.metrics import PLR
from evaluation.estimates.sweeps import FUTURE, Sweeps
from evaluation.plan.address import Address
from evaluation.verdict import claim, inflation, rules
from evaluation.verdict.items import Draft, decided_items
from evaluation.verdict.validity import validity
from evaluation.verdict.within_level import within_level_items
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE


def validity_sections(
    levels: Mapping[str, Sequence[LinkedProbes]],
    sweeps: Sweeps,
    *,
    strongest: Mapping[str, Address],
    manifest: Mapping[str, Any],
) -> dict[str, list[dict[str, Any]]]:
    """Return the sections that rest on linked people: validity and within.

    `levels` has the linked probes of each level by task; `strongest` names the
    strongest linker of each task. Only the levels of `sweeps` are used, no estimate.
    """
    success = {task: linker for task, linker in strongest.items() if task}
    seed = manifest["identity"]["seed"]
    sections = validity(
        sum_by_cluster(levels),
        families=sweeps.families,
        preset=manifest["settings"]["preset"],
        dataset=manifest["dataset"]["name"],
        seed=seed,
    )
    sections["items"] += decided_items(
        rules.WITHIN, within_level_items(levels, sweeps, success=success, seed=seed)
    )
    return sections


def verdict(
    sweeps: Sweeps,
    across: Mapping[str, Sequence[dict[str, Any]]],
    *,
    strongest: Mapping[str, Address],
    scored: Mapping[str, Mapping[str, Sequence[Address]]] | None = None,
    later: Mapping[float, Sweeps] | None = None,
    manifest: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the verdict of a run as in `verdict.json`.

    The claim is read with the first predictor of the run. `across` is the result of
    `validity_sections`; `strongest` gives the strongest linker by task, and under ""
    the strongest reconstruction. `scored` gives the attacks that either half of the
    people chose, by task and ranking metric: they score the numbers in `sweeps` under
    the strongest's name. `later` are the same with robots judged at further horizons,
    s: there the claim is read with conflicts that are still to come.
    """
    attacks = [attack for task, attack in strongest.items() if not task]
    dataset = manifest["dataset"]
    claims: list[Draft] = []
    for predictor in manifest["settings"]["predictors"][:1]:
        claims += claim.claims(sweeps, strongest, predictor=predictor)
        for horizon_s, at_horizon in (later or {}).items():
            claims += claim.claims(
                at_horizon,
                strongest,
                predictor=predictor,
                criteria=(FUTURE,),
                horizon_s=horizon_s,
            )
    items = [
        *across["items"],
        *decided_items(rules.CLAIM, claims),
        *decided_items(rules.INFLATION, inflation.inflation(sweeps, attacks)),
    ]
    for item in items:
        if labels := _scoring_attacks(item, scored or {}):
            item["scored"] = labels
    return {
        "dataset": dataset["name"],
        "simulated": bool(dataset.get("simulated", False)),
        "seed": manifest["identity"]["seed"],
        "preset": manifest["settings"]["preset"],
        "scenes": manifest["settings"]["scenes"],
        "rules": _rules(),
        "counts": {name: _count_decisions(items, name) for name in rules.SECTIONS},
        "items": items,
        "controls": across["controls"],
        "on_trial": across["on_trial"],
    }


def _scoring_attacks(
    item: Mapping[str, Any],
    scored: Mapping[str, Mapping[str, Sequence[Address]]],
) -> list[str]:
    """Return the attacks that score an item; empty if they are the item's subject."""
    is_after = (
        item["section"] == rules.INFLATION or item.get("of") == claim.AFTER_ATTACK
    )
    if not is_after and item.get("of") != claim.LINKED:
        return []
    ranked = PLR if is_after else str(item.get("metric"))
    choices = scored.get(item["task"], {}).get(ranked, ())
    labels = [choice.without_task.label for choice in choices]
    return labels if {*labels} - {item["subject"]} else []


def _count_decisions(
    items: Sequence[Mapping[str, Any]], section: str
) -> dict[str, int]:
    return dict(
        Counter(item["decision"] for item in items if item["section"] == section)
    )


def _rules() -> dict[str, Any]:
    """Return the rules of the decisions: numbers, and a text."""
    margin = 100 * rules.SUCCESS_MARGIN
    return {
        "confidence": CONFIDENCE,
        "band_coverage": rules.BAND_COVERAGE,
        "margins": {
            "success": rules.SUCCESS_MARGIN,
            "fall": rules.LEAST_FALL,
            "correlation": rules.LEAST_CORRELATION,
            "span": rules.LEAST_SPAN,
            "clusters": FEWEST_EFFECTIVE,
        },
        "text": (
            "A descriptor does not track if the lower end of the spread is above"
            f" {margin:g} of 100 people; that errs on 2.5 % of pages. It tracks if"
            f" the upper end is below {margin:g}; that errs in 2.5 % of items. The"
            " three other"
            " sections are decided by bands. All bands of a section hold at once"
            f" in {100 * rules.BAND_COVERAGE:g} % of studies, and an item is"
            " decided if its band lies on one side. Each 95 % interval stands by"
            " itself."
        ),
    }


def to_bytes(verdict: Mapping[str, Any]) -> bytes:
    """Return the content of `verdict.json`."""
    text = json.dumps(verdict, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()
