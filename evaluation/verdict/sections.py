"""The verdict: do PLR, AEL and MEL track real linkability? `verdict.json`.

Four sections, each under both adding rules: *validity* across mechanisms, validity *within* a
level, the paper's *claim* that FID has the advantage over fixed noise at equal missed rate, and
*inflation*: how much higher each descriptor is after the strongest attack than as shared. What
decides is in `rules`, in words in docs/verdict.md.
"""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any, Final

from evaluation.analysis.families import ADDING_RULES, FID
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.verdict import claim, inflation, rules
from evaluation.verdict.items import decided
from evaluation.verdict.rules import DOES_NOT, NAME, TRACKS, UNDECIDED, WEAKLY, listed
from evaluation.verdict.validity import validity
from evaluation.verdict.within_level import within
from isac_track.intervals import CONFIDENCE

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from evaluation.analysis.keys import Source
    from evaluation.analysis.linked_people import LinkedProbes
    from evaluation.analysis.matching import Sweeps

    Items = Sequence[dict[str, Any]]

_PLURAL: Final = {
    DOES_NOT: ("does not track", "do not track"),
    WEAKLY: ("tracks weakly", "track weakly"),
    TRACKS: ("tracks", "track"),
}
"""From the worst: that is said of a descriptor that fares differently in different tasks."""


def verdict(
    sweeps: Sweeps,
    levels: Mapping[str, Sequence[LinkedProbes]],
    *,
    strongest: Mapping[str, Source],
    scored: Sequence[Source] = (),
    manifest: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the verdict of a run as in `verdict.json`.

    The claim is read with the first predictor of the run. `levels` are by task who is linked at
    each level by its strongest linker, which `strongest` names; under "" that is the strongest
    reconstruction. `scored` are those that its descriptors in `sweeps` come from, if they are
    others: what either half of the people chose.
    """
    success = {task: linker for task, linker in strongest.items() if task}
    attacks = [attack for task, attack in strongest.items() if not task]
    seed = manifest["identity"]["seed"]
    claims = (
        draft
        for predictor in manifest["settings"]["predictors"][:1]
        for draft in claim.claims(sweeps, strongest, predictor=predictor)
    )
    items = [
        *_of_validity([*validity(sweeps, success=success)]),
        *decided(rules.WITHIN, within(levels, sweeps, success=success, seed=seed)),
        *decided(rules.CLAIM, claims),
        *decided(rules.INFLATION, inflation.inflation(sweeps, attacks)),
    ]
    for one in items:
        if scored and (one["section"] == rules.INFLATION or one.get("of") == claim.AFTER):
            one["scored"] = [source.label for source in scored]
    dataset = manifest["dataset"]
    of = {name: [one for one in items if one["section"] == name] for name in rules.SECTIONS}
    fid = {sweeps.named(FID, adding=adding) for adding in ADDING_RULES}
    return {
        "answer": [
            _tracking(of[rules.VALIDITY], dataset=dataset["name"], fid=fid),
            claim.answer(of[rules.CLAIM]),
            inflation.answer(of[rules.INFLATION]),
        ],
        "dataset": dataset["name"],
        "simulated": bool(dataset.get("simulated", False)),
        "seed": manifest["identity"]["seed"],
        "preset": manifest["settings"]["preset"],
        "scenes": manifest["settings"]["scenes"],
        "rules": {
            "confidence": CONFIDENCE,
            "alpha": rules.ALPHA,
            "section_alpha": rules.SECTION_ALPHA,
            "band_coverage": rules.BAND_COVERAGE,
            "margins": {
                "success": rules.SUCCESS_MARGIN,
                "success_weak": rules.WEAK_MARGIN,
                "correlation": rules.LEAST_CORRELATION,
                "span": rules.LEAST_SPAN,
                "clusters": rules.FEWEST_EFFECTIVE,
            },
            "text": "Within, claim and inflation are decided by bands that hold for all items of a "
            f"section at once in {100 * rules.BAND_COVERAGE:g} % of studies: an item is decided if "
            "its band lies on one side. Intervals are at 95 %, each by itself.",
        },
        "counts": {
            name: dict(Counter(one["decision"] for one in mine)) for name, mine in of.items()
        },
        "items": items,
    }


def _of_validity(drafts: Sequence[rules.Draft]) -> Iterator[dict[str, Any]]:
    about = ("adding", "descriptor", "task", "subject", "criterion")
    options = rules.decide([draft.options for draft in drafts])
    for draft, (decision, p_value, p_adjusted) in zip(drafts, options, strict=True):
        yield {
            "id": "/".join([rules.VALIDITY, *draft.names]),
            "section": rules.VALIDITY,
            **{name: getattr(draft, name) for name in about},
            "decision": decision,
            "sign": rules.SIGN[decision],
            **rules.numbers(draft.effect),
            "unit": draft.unit,
            "n": draft.effect.n,
            "p_value": p_value,
            "p_adjusted": p_adjusted,
            "sentence": draft.sentences.get(decision, draft.sentences[UNDECIDED]),
            "why": draft.why_undecided if decision == UNDECIDED else "",
            **draft.details,
        }


def to_bytes(said: Mapping[str, Any]) -> bytes:
    """Return the content of `verdict.json`."""
    text = json.dumps(said, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()


def _tracking(items: Items, *, dataset: str, fid: Collection[str]) -> str:
    """Return what is said of the descriptors; `fid` is FID under either rule, by name."""
    if not items:
        return (
            f"Whether PLR, AEL and MEL track linkability in {dataset} was not tested: the run "
            "has no sweep of fixed noise, or nobody links."
        )
    named: dict[str, list[str]] = {decision: [] for decision in (*_PLURAL, UNDECIDED)}
    for descriptor in DESCRIPTORS:
        found = {one["decision"] for one in items if one["descriptor"] == descriptor}
        worst = next((decision for decision in _PLURAL if decision in found), UNDECIDED)
        named[worst].append(NAME[descriptor])
    open_ones = named.pop(UNDECIDED)
    parts = [
        f"{listed(names)} {_PLURAL[decision][len(names) > 1]} how linkable people are"
        for decision, names in named.items()
        if names
    ]
    if open_ones and parts:
        parts.append(f"for {listed(open_ones)} that is undecided")
    elif open_ones:
        parts = [f"whether {listed(open_ones)} track how linkable people are is undecided"]
    against = [one for one in items if one["decision"] == DOES_NOT]
    why = f": {_evidence(against, fid=fid)}" if against else ""
    return f"In {dataset}, {'; '.join(parts)}{why}."


def _evidence(against: Items, *, fid: Collection[str]) -> str:
    """Return what speaks most against a descriptor: the largest differences either way."""
    differing = [
        {gap["effect"]: gap for gap in reversed(one["contrasts"]) if gap["reading"] == "differs"}
        for one in against
    ]
    furthest = [max(map(abs, effects), default=0.0) for effects in differing]
    if not any(furthest):
        return f"they fall with the noise, success in {against[0]['task']} hardly does"
    place = furthest.index(max(furthest))
    surest, effects, words = against[place], differing[place], []
    for effect, word in ((max(effects), "more"), (min(effects), "fewer")):
        if (effect > 0) == (word == "more"):
            name, level = effects[effect]["mechanism"], effects[effect]["level"]
            where = name if level is None else f"{name} {level:g}"
            words.append(f"{where} lets {100 * abs(effect):.0f} of 100 people {word} be linked")
    alike = any(
        gap["mechanism"] in fid and gap["reading"] == "equal" for gap in surest["contrasts"]
    )
    margin = f"{100 * rules.SUCCESS_MARGIN:.0f} of 100"
    return (
        f"at equal {NAME[surest['descriptor']]}, {listed(words)} than fixed noise "
        f"({surest['task']}, {surest['adding']} adding"
        + (f"; FID and fixed noise alone are alike to within {margin})" if alike else ")")
    )
