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
from evaluation.verdict import rules
from evaluation.verdict.answer import answer
from evaluation.verdict.claim import claims, inflation
from evaluation.verdict.items import numbers
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
    strongest: Mapping[str, Source],
    manifest: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the verdict of a run as in `verdict.json`.

    `compared` is with fixed noise: the claim is read with the first predictor of the run. `levels`
    are by task who is linked at each level by its strongest linker, which `strongest` names; under
    "" that is the strongest reconstruction.
    """
    success = {task: linker for task, linker in strongest.items() if task}
    attack = strongest.get("")
    by_predictor = [one for one in compared if one.predictor]
    predictors = manifest["settings"].get("predictors") or [one.predictor for one in by_predictor]
    of_first = [one for one in by_predictor if one.predictor in predictors[:1]]
    drafts = (
        *validity(sweeps, success=success),
        *within(levels, sweeps, success=success),
        *claims(of_first, sweeps, success=success, attack=attack),
        *inflation(sweeps, attack=attack),
    )
    items: list[dict[str, Any]] = []
    for section in rules.SECTIONS:
        mine = [draft for draft in drafts if draft.section == section]
        decided = rules.decide([draft.options for draft in mine])
        for draft, (decision, p_value, p_adjusted) in zip(mine, decided, strict=True):
            is_open = decision == rules.UNDECIDED
            about = ("section", "adding", "descriptor", "task", "subject", "criterion")
            items.append(
                {
                    "id": draft.name,
                    **{name: getattr(draft, name) for name in about},
                    "decision": decision,
                    "sign": rules.SIGN[decision],
                    **numbers(draft.effect),
                    "unit": draft.unit,
                    "n": draft.effect.n,
                    "p_value": p_value,
                    "p_adjusted": p_adjusted,
                    "sentence": draft.sentences.get(decision, draft.sentences[rules.UNDECIDED]),
                    "why_undecided": draft.why_undecided if is_open else "",
                    **draft.details,
                }
            )
    dataset = manifest["dataset"]
    fid = {sweeps.named(FID, adding=adding) for adding in ADDING_RULES}
    return {
        "answer": answer(items, dataset=dataset["name"], fid=fid),
        "dataset": dataset["name"],
        "simulated": bool(dataset.get("simulated", False)),
        "seed": manifest["identity"]["seed"],
        "preset": manifest["settings"]["preset"],
        "scenes": manifest["settings"]["scenes"],
        "rules": {
            "confidence": CONFIDENCE,
            "alpha": rules.ALPHA,
            "section_alpha": rules.SECTION_ALPHA,
            "margins": {
                "success": rules.SUCCESS_MARGIN,
                "success_weak": rules.WEAK_MARGIN,
                "correlation": rules.LEAST_CORRELATION,
                "span": rules.LEAST_SPAN,
                "clusters": rules.LEAST_CLUSTERS,
            },
            "text": "Decided is what passes its test after Holm's adjustment over the section, "
            f"each section at {100 * rules.SECTION_ALPHA:g} %; all else is undecided, which is no "
            "statement either way. Intervals are at 95 % and not adjusted.",
        },
        "counts": {
            section: dict(Counter(one["decision"] for one in items if one["section"] == section))
            for section in rules.SECTIONS
        },
        "items": items,
    }


def to_bytes(said: Mapping[str, Any]) -> bytes:
    """Return the content of `verdict.json`."""
    text = json.dumps(said, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()
