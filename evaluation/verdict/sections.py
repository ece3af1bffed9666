"""The verdict: do PLR, AEL and MEL track real linkability? `verdict.json`.

Four sections, each under both adding rules: *validity* across mechanisms, validity *within* a
level, the paper's *claim* at equal missed rate, and the *inflation* of the descriptors by an
attack. What decides is in `rules`, in words in docs/verdict.md.
"""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any

from evaluation.analysis.families import ADDING_RULES, FID
from evaluation.analysis.metrics import EXPOSURE, SUCCESS
from evaluation.analysis.strongest import strongest
from evaluation.verdict.answer import answer
from evaluation.verdict.claim import claims
from evaluation.verdict.inflation import inflation
from evaluation.verdict.items import to_json
from evaluation.verdict.rules import (
    ALPHA,
    LEAST_CLUSTERS,
    LEAST_CORRELATION,
    LEAST_SPAN,
    SECTION_ALPHA,
    SECTIONS,
    SUCCESS_MARGIN,
    WEAK_MARGIN,
    decide,
)
from evaluation.verdict.validity import validity
from evaluation.verdict.within_level import within
from isac_track.intervals import CONFIDENCE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from evaluation.analysis.keys import Source
    from evaluation.analysis.matching import Comparison
    from evaluation.analysis.sweeps import Sweeps
    from evaluation.verdict.within_level import LevelTracks


def verdict(
    sweeps: Sweeps,
    compared: Iterable[Comparison],
    levels: Mapping[str, Sequence[LevelTracks]],
    *,
    manifest: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the verdict of a run as in `verdict.json`.

    Parameters
    ----------
    sweeps : Sweeps
        Of every metric of the run.
    compared : iterable of Comparison
        With fixed noise; the claim is read with the first predictor of the run.
    levels : mapping
        By task: who is linked at each level by its strongest linker.
    manifest : mapping
        As in `manifest.json`.
    """
    values = {key: one.value for key, one in sweeps.found.items()}
    success = strongest(values, sweeps.known, metric=SUCCESS)
    attack = strongest(values, sweeps.known, metric=EXPOSURE).get("")
    drafts = (
        *validity(sweeps, success=success, chance=_chances(sweeps, success)),
        *within(levels, sweeps, success=success),
        *claims(_of_reference(compared, manifest), sweeps.known, success=success, attack=attack),
        *inflation(sweeps, attack=attack),
    )
    items: list[dict[str, Any]] = []
    for section in SECTIONS:
        mine = [draft for draft in drafts if draft.section == section]
        decided = decide([draft.options for draft in mine])
        items += [
            to_json(draft, decision=decision, p_value=p_value, p_adjusted=p_adjusted)
            for draft, (decision, p_value, p_adjusted) in zip(mine, decided, strict=True)
        ]
    dataset = manifest["dataset"]
    fid = {sweeps.named(FID, adding=adding) for adding in ADDING_RULES}
    return {
        "answer": answer(items, dataset=dataset["name"], fid=fid),
        "dataset": dataset["name"],
        "simulated": bool(dataset.get("simulated", False)),
        "seed": manifest["identity"]["seed"],
        "preset": manifest["settings"]["preset"],
        "scenes": manifest["settings"]["scenes"],
        "rules": rules(),
        "counts": {
            section: dict(Counter(one["decision"] for one in items if one["section"] == section))
            for section in SECTIONS
        },
        "items": items,
    }


def rules() -> dict[str, Any]:
    """Return the rules of decision, as numbers and in a sentence."""
    return {
        "confidence": CONFIDENCE,
        "alpha": ALPHA,
        "section_alpha": SECTION_ALPHA,
        "margins": {
            "success": SUCCESS_MARGIN,
            "success_weak": WEAK_MARGIN,
            "correlation": LEAST_CORRELATION,
            "span": LEAST_SPAN,
            "clusters": LEAST_CLUSTERS,
        },
        "text": "Decided is what passes its test after Holm's adjustment over the section, each "
        f"section at {100 * SECTION_ALPHA:g} %; all else is undecided, which is no statement "
        "either way. Intervals are at 95 % and not adjusted.",
    }


def to_bytes(said: Mapping[str, Any]) -> bytes:
    """Return the content of `verdict.json`."""
    text = json.dumps(said, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()


def _chances(sweeps: Sweeps, success: Mapping[str, Source]) -> dict[str, float]:
    """Return by task what guessing achieves, the most over all levels."""
    wanted = {linker.measure("chance"): task for task, linker in success.items()}
    chances = dict.fromkeys(success, 0.0)
    for key, one in sweeps.found.items():
        if key.measure in wanted:
            task = wanted[key.measure]
            chances[task] = max(chances[task], one.value)
    return chances


def _of_reference(compared: Iterable[Comparison], manifest: Mapping[str, Any]) -> list[Comparison]:
    """Return the comparisons by the first predictor of the run."""
    every = [one for one in compared if one.predictor]
    predictors = manifest["settings"].get("predictors") or [one.predictor for one in every]
    return [one for one in every if one.predictor in predictors[:1]]
