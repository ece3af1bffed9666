"""The verdict: do PLR, AEL and MEL track real linkability? `verdict.json`.

Four sections, each under both adding rules: *validity* across mechanisms, validity
*within* a level, the paper's *claim* that FID has the advantage over fixed noise at
equal missed rate, and *inflation*: how much higher each descriptor is after the
strongest attack than as shared. What decides is in `rules`, in words in
docs/verdict.md.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from evaluation.estimates.keys import Measure, Source
from evaluation.estimates.linked_people import LinkedProbes, by_cluster
from evaluation.estimates.matching import FUTURE, Sweeps
from evaluation.estimates.metrics import EXPOSURE
from evaluation.verdict import claim, inflation, rules
from evaluation.verdict.items import Draft, decided
from evaluation.verdict.validity import validity
from evaluation.verdict.within_level import within
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE


def of_people(
    levels: Mapping[str, Sequence[LinkedProbes]],
    sweeps: Sweeps,
    *,
    strongest: Mapping[str, Source],
    manifest: Mapping[str, Any],
) -> dict[str, list[dict[str, Any]]]:
    """Return the parts of a verdict that rest on who is linked: both of validity.

    `levels` are by task who is linked at each level by its strongest linker, which
    `strongest` names. Of `sweeps` the levels are asked for, no estimate.
    """
    success = {task: linker for task, linker in strongest.items() if task}
    seed = manifest["identity"]["seed"]
    found = validity(
        by_cluster(levels),
        families=sweeps.known,
        preset=manifest["settings"]["preset"],
        dataset=manifest["dataset"]["name"],
        seed=seed,
    )
    found["items"] += decided(
        rules.WITHIN, within(levels, sweeps, success=success, seed=seed)
    )
    return found


def verdict(
    sweeps: Sweeps,
    across: Mapping[str, Sequence[dict[str, Any]]],
    *,
    strongest: Mapping[str, Source],
    scored: Mapping[str, Mapping[str, Sequence[Measure]]] | None = None,
    later: Mapping[float, Sweeps] | None = None,
    manifest: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the verdict of a run as in `verdict.json`.

    The claim is read with the first predictor of the run. `across` is what `of_people`
    returns; `strongest` is by task its strongest linker, under "" the strongest
    reconstruction. `scored` are by task and by the metric that ranks whom either half
    of the people chose: from these come the numbers in `sweeps` that bear the
    strongest's name. `later` are the same with robots judged at further horizons, s:
    there the claim is read with conflicts that are still to come.
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
        *decided(rules.CLAIM, claims),
        *decided(rules.INFLATION, inflation.inflation(sweeps, attacks)),
    ]
    for item in items:
        is_after = item["section"] == rules.INFLATION or item.get("of") == claim.AFTER
        if is_after or item.get("of") == claim.LINKED:
            choices = (scored or {}).get(item["task"], {})
            ranked = EXPOSURE if is_after else str(item.get("metric"))
            labels = [
                choice.label.removeprefix(f"{item['task']}/")
                for choice in choices.get(ranked, ())
            ]
            if {*labels} - {item["subject"]}:
                item["scored"] = labels
    return {
        "dataset": dataset["name"],
        "simulated": bool(dataset.get("simulated", False)),
        "seed": manifest["identity"]["seed"],
        "preset": manifest["settings"]["preset"],
        "scenes": manifest["settings"]["scenes"],
        "rules": {
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
                "A descriptor does not track if the lower end of the spread is above 5"
                " of 100 people; that errs on 2.5 % of pages. It tracks if the upper"
                " end is below 5; that errs in 2.5 % of items. The three other"
                " sections are decided by bands. All bands of a section hold at once"
                f" in {100 * rules.BAND_COVERAGE:g} % of studies, and an item is"
                " decided if its band lies on one side. Each 95 % interval stands by"
                " itself."
            ),
        },
        "counts": {
            name: dict(
                Counter(one["decision"] for one in items if one["section"] == name)
            )
            for name in rules.SECTIONS
        },
        "items": items,
        "controls": across["controls"],
        "on_trial": across["on_trial"],
    }


def to_bytes(said: Mapping[str, Any]) -> bytes:
    """Return the content of `verdict.json`."""
    text = json.dumps(said, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()
