"""The items of the verdict as `verdict.json` has them: keys, and their order.

docs/explanation/verdict.md says what the keys mean. An unknown number is null.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from evaluation.estimates.json_numbers import json_interval, json_number
from evaluation.verdict import rules
from evaluation.verdict.items import (
    BandItem,
    ClaimDetails,
    Contrast,
    DescriptorTrial,
    Details,
    InflationDetails,
    Item,
    PositiveControl,
    PredictionError,
    SpreadAnswer,
    Topic,
    ValidityItem,
    Verdict,
    WithinDetails,
)
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE, Estimate

OTHER_HALF = "rank 1 of the other half of the people"
"""Descriptor of the positive control: no other could tell more about linkability."""


def to_bytes(verdict: Mapping[str, Any]) -> bytes:
    """Return the content of `verdict.json`."""
    text = json.dumps(verdict, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """Return the decisions of a run."""
    return {
        "dataset": verdict.dataset,
        "simulated": verdict.is_simulated,
        "seed": verdict.seed,
        "preset": verdict.preset,
        "scenes": verdict.n_scenes,
        "rules": _rules_json(),
        "counts": {
            section: _count_decisions(verdict.items, section)
            for section in rules.SECTIONS
        },
        "items": [item_json(item) for item in verdict.items],
        "controls": [control_json(control) for control in verdict.controls],
        "on_trial": [trial_json(trial) for trial in verdict.trials],
    }


def item_json(item: Item) -> dict[str, Any]:
    """Return an item of any section."""
    if isinstance(item, ValidityItem):
        return _validity_item_json(item)
    return _band_item_json(item)


def control_json(control: PositiveControl) -> dict[str, Any]:
    """Return a positive control."""
    return {
        "adding": control.adding,
        "task": control.task,
        "descriptor": OTHER_HALF,
        **_answer_json(control.answer),
        "n": control.n,
    }


def trial_json(trial: DescriptorTrial) -> dict[str, Any]:
    """Return a descriptor on trial."""
    return {
        "adding": trial.adding,
        "task": trial.task,
        "descriptor": trial.descriptor,
        **_error_json(trial.error),
        "surely_lowest": trial.surely_lowest,
    }


def _band_item_json(item: BandItem) -> dict[str, Any]:
    content = {
        **_topic_json(item.topic),
        "decision": item.decision,
        "sign": rules.SIGN[item.decision],
        **_effect_json(item.effect),
        "band_low": json_number(item.band_low),
        "band_high": json_number(item.band_high),
        "unit": item.unit,
        "n": item.effect.n,
        "sentence": item.sentence,
        "why": item.why,
        **_details_json(item.topic, item.details),
    }
    if item.scored_by:
        content["scored"] = list(item.scored_by)
    return content


def _validity_item_json(item: ValidityItem) -> dict[str, Any]:
    answer = item.answer
    return {
        **_topic_json(item.topic),
        **_answer_json(answer),
        "sign": rules.SIGN[answer.decision],
        "effect": answer.spread,
        "ci_low": answer.low,
        "ci_high": answer.high,
        "unit": "fraction",
        "metric": item.metric,
        **_error_json(item.error),
        "evidence": list(item.evidence),
        "power": dict(item.power),
        "power_if": {truth: dict(table) for truth, table in item.power_if.items()},
        "n": item.n,
        "n_needed": item.n_needed,
        "why": item.why,
        "contrasts": [_contrast_json(contrast) for contrast in item.contrasts],
        "sentence": item.sentence,
    }


def _topic_json(topic: Topic) -> dict[str, Any]:
    return {
        "id": topic.item_id,
        "section": topic.section,
        "adding": topic.adding,
        "descriptor": topic.descriptor,
        "task": topic.task,
        "subject": topic.attack,
        "criterion": topic.criterion,
    }


def _details_json(topic: Topic, details: Details) -> dict[str, Any]:
    """Return the keys that only the items of a section have."""
    match details:
        case ClaimDetails():
            return _claim_json(topic, details)
        case WithinDetails():
            return {
                "levels": details.n_levels,
                "linked": json_number(details.linked),
            }
        case InflationDetails():
            return {"of": topic.mechanism, "levels": details.n_levels}
    return {}


def _claim_json(topic: Topic, details: ClaimDetails) -> dict[str, Any]:
    """Return the keys of a claim; some stand only where they say something."""
    gaps = details.gaps
    content: dict[str, Any] = {"of": topic.compared}
    if details.metric:
        content["metric"] = details.metric
    content |= {
        "relative": json_number(details.relative),
        "range": [gaps[0].rise, gaps[-1].rise] if gaps else None,
        "unreached": list(details.unreached),
        "points": [{"at": gap.rise, **_effect_json(gap.gap)} for gap in gaps],
    }
    if topic.mechanism:
        content["mechanism"] = topic.mechanism
    if topic.horizon_s is not None:
        content["horizon_s"] = topic.horizon_s
    return content


def _contrast_json(contrast: Contrast) -> dict[str, Any]:
    return {
        "mechanism": contrast.mechanism,
        "level": contrast.level,
        "quartile": contrast.quartile,
        "subject": contrast.linker,
        **_effect_json(contrast.gap),
        "unit": "fraction",
        "n": contrast.gap.n,
        "reading": contrast.reading,
        "evidence": contrast.evidence,
        "only": contrast.only,
        "in_panel": contrast.in_panel,
    }


def _answer_json(answer: SpreadAnswer) -> dict[str, Any]:
    return {
        "decision": answer.decision,
        "spread": answer.spread,
        "spread_low": answer.low,
        "spread_high": answer.high,
    }


def _error_json(error: PredictionError | None) -> dict[str, float | None]:
    return {
        "prediction_error": error.value if error else None,
        "prediction_error_low": error.low if error else None,
        "prediction_error_high": error.high if error else None,
        "prediction_error_null": error.null if error else None,
    }


def _effect_json(effect: Estimate) -> dict[str, float | None]:
    return json_interval("effect", effect, ends="ci")


def _count_decisions(items: Iterable[Item], section: str) -> dict[str, int]:
    return dict(
        Counter(item.decision for item in items if item.topic.section == section)
    )


def _rules_json() -> dict[str, Any]:
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
