"""The section *validity*: whether equal descriptor values mean equal linkage.

Over the levels of a single mechanism, descriptor and linkability always fall together.
A measure of linkability must hold for every mechanism: at the same descriptor value,
fixed noise, FID and the dissociation controls must let equally many people be linked.
The numbers are in `validity_drafts`, the decision in `spread`, the sentences in
`validity_words`; the items are here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from evaluation.estimates.families import Family
from evaluation.estimates.linked_people import TaskSums
from evaluation.estimates.metrics import RANK1, RANK1_AMONG_100
from evaluation.verdict import power, rules, spread
from evaluation.verdict.contrasts import Contrasts
from evaluation.verdict.curves import NEITHER, ONLY_FEWER, ONLY_MORE, QUARTER_POINTS
from evaluation.verdict.items import (
    Contrast,
    DescriptorTrial,
    PositiveControl,
    SpreadAnswer,
    Topic,
    ValidityItem,
    ValiditySection,
)
from evaluation.verdict.panel import Panel
from evaluation.verdict.spread import IntervalWidths
from evaluation.verdict.validity_drafts import (
    PanelDrafts,
    ValidityDraft,
    draft_validity,
    fewest_clusters,
)
from evaluation.verdict.validity_words import item_sentence, why_undecided
from isac_track.intervals import Estimate
from isac_track.types import Floats

_ONLY: Final = {ONLY_MORE: "more", ONLY_FEWER: "fewer"}


def validity(
    tasks: Sequence[TaskSums],
    *,
    families: Mapping[str, Family],
    preset: str,
    dataset: str,
    seed: int,
) -> ValiditySection:
    """Return the items of validity, positive controls, and descriptors on trial.

    `families` are by mechanism.
    """
    panels = [
        *draft_validity(
            tasks, families=families, preset=preset, dataset=dataset, seed=seed
        )
    ]
    drafts = [draft for panel in panels for draft in panel.drafts]
    deviation = spread.largest_deviation([draft.contrasts for draft in drafts])
    control_deviation = spread.largest_deviation([panel.control for panel in panels])
    return ValiditySection(
        items=tuple(_item(draft, deviation) for draft in drafts),
        controls=tuple(_control(panel, control_deviation) for panel in panels),
        trials=tuple(trial for panel in panels for trial in _trials(panel)),
    )


def _item(draft: ValidityDraft, deviation: Floats) -> ValidityItem:
    """Return the item of a draft; `deviation`, (B,), is the section's largest."""
    panel, own = draft.panel, draft.contrasts
    widths = spread.interval_widths(own, deviation)
    answer = _answer(own, widths, span=own.fixed.span[:1])
    compared = _contrasts(panel, panel.compared, own, widths)
    beside: list[Contrast] = []
    if draft.beside is not None:
        beside_widths = spread.interval_widths(draft.beside, deviation)
        beside = _contrasts(panel, panel.beside, draft.beside, beside_widths)
    is_flat = rules.is_flat_miss(answer.decision, answer.low)
    families = [panel.family_names[place] for place in panel.compared]
    answers = power.answer_probabilities(own, widths, families)
    needed = None if is_flat else power.clusters_needed(own, widths, draft.n)
    item = ValidityItem(
        topic=Topic(
            rules.VALIDITY,
            panel.adding,
            descriptor=draft.descriptor,
            task=panel.task.task,
            attack=panel.task.levels[panel.fixed[-1]].linker.without_task.label,
        ),
        answer=answer,
        metric=RANK1 if panel.task.gallery is None else RANK1_AMONG_100,
        error=None if draft.errors is None else draft.errors.numbers,
        evidence=_evidence(answer, compared),
        power=power.decision_power(answers),
        power_if=answers,
        n=draft.n,
        n_needed=needed,
        why=why_undecided(draft, widths, answer),
        contrasts=(*compared, *beside),
        sentence="",
    )
    return replace(item, sentence=item_sentence(draft, item))


def _answer(own: Contrasts, widths: IntervalWidths, *, span: Floats) -> SpreadAnswer:
    """Return the decision and the spread; `span`, (1,), is that of fixed noise."""
    decisions = spread.decide(
        own, widths, gaps=own.gaps[:1], fall=own.fixed.fall[:1], span=span
    )
    return SpreadAnswer(
        decision=spread.ANSWERS[decisions.codes[0]],
        spread=spread.median_unbiased_spread(own),
        low=float(decisions.low[0]),
        high=float(decisions.high[0]),
    )


def _evidence(answer: SpreadAnswer, compared: Sequence[Contrast]) -> tuple[str, ...]:
    """Return the kinds of evidence on which a decision rests; empty without any."""
    if answer.decision not in (rules.DOES_NOT, rules.TRACKS):
        return ()
    sure = {
        contrast.evidence for contrast in compared if contrast.reading == rules.DIFFERS
    }
    # Equality, and a miss by a flat descriptor, hold as far as these attacks go.
    if not sure or rules.is_flat_miss(answer.decision, answer.low):
        return (rules.ATTACKS,)
    # A difference by construction decided nothing.
    return tuple(sorted(sure - {rules.CONSTRUCTION}))


def _contrasts(
    panel: Panel, places: Sequence[int], own: Contrasts, widths: IntervalWidths
) -> list[Contrast]:
    """Return the contrasts of levels, each with its own, unadjusted interval."""
    low, high = (end[0] for end in spread.gap_size_ends(own, widths, own.gaps[:1]))
    ci_low, ci_high = spread.gap_intervals(own)
    contrasts = []
    for k, (place, gap) in enumerate(zip(places, own.gaps[0].tolist(), strict=True)):
        level, is_fid = panel.task.levels[place], place in panel.fid
        readings = {
            rules.NOT_TESTABLE: own.side[k] == NEITHER,
            rules.DIFFERS: low[k] > rules.SUCCESS_MARGIN,
            rules.EQUAL: high[k] < rules.SUCCESS_MARGIN,
        }
        shown = rules.SHOWN if gap > 0 else rules.ATTACKS
        is_known = np.isfinite(own.errors[k])
        contrasts.append(
            Contrast(
                mechanism=level.mechanism,
                level=None if is_fid else level.level,
                quartile=QUARTER_POINTS[k] if is_fid else None,
                linker=level.linker.without_task.label,
                gap=Estimate(
                    gap if is_known else np.nan,
                    float(ci_low[k]),
                    float(ci_high[k]),
                    int(own.people[k]),
                ),
                reading=next(
                    (name for name, is_so in readings.items() if is_so), rules.BETWEEN
                ),
                evidence=rules.CONSTRUCTION if panel.is_hidden(place) else shown,
                only=_ONLY.get(int(own.side[k]), ""),
                in_panel=place not in panel.beside,
            )
        )
    return contrasts


def _control(drafts: PanelDrafts, deviation: Floats) -> PositiveControl:
    """Return the positive control of a panel, which must not fail."""
    own = drafts.control
    widths = spread.interval_widths(own, deviation)
    # Linkage itself as the descriptor: any span will do.
    answer = _answer(own, widths, span=np.full(1, np.inf))
    panel = drafts.panel
    return PositiveControl(panel.adding, panel.task.task, answer, fewest_clusters(own))


def _trials(drafts: PanelDrafts) -> list[DescriptorTrial]:
    """Return each descriptor's prediction error, and whether it is surely lowest."""
    known_errors = {
        name: errors for name, errors in drafts.errors.items() if errors is not None
    }
    return [
        DescriptorTrial(
            adding=drafts.panel.adding,
            task=drafts.panel.task.task,
            descriptor=name,
            error=errors.numbers,
            surely_lowest=len(known_errors) > 1
            and all(
                rival.own.less(errors.own).ends[0] > 0
                for rival_name, rival in known_errors.items()
                if rival_name != name
            ),
        )
        for name, errors in known_errors.items()
    ]
