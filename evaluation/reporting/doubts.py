"""The reasons to doubt the numbers of a run."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

from scipy.special import bdtrc

from evaluation.estimates import weak_attacks
from evaluation.reporting.amounts import counted, listed
from evaluation.reporting.my_plugin import plugin_doubts
from evaluation.reporting.names import shortcut_name
from evaluation.reporting.notices import notices, too_few_people, used_are_slower
from evaluation.reporting.result_tables import control_tests
from evaluation.reporting.rows import Results
from evaluation.verdict.rules import DOES_NOT
from isac_track.linkability import LEVEL

# Relative difference of mean speed, used tracks to all tracks, that raises a doubt.
_MUCH: Final = 0.2


def doubts(run: Results) -> list[str]:
    """Return the reasons to doubt the numbers, the gravest first.

    `docs/explanation/sources-of-error.md` explains each.
    """
    return [text for doubt in _DOUBTS for text in doubt(run)]


def _failed_cells(run: Results) -> list[str]:
    """Return how many cells failed, and why the first did."""
    reasons = list(run.failed["why"])
    return [f"{counted(len(reasons), 'cell')} FAILED ({reasons[0]})"] if reasons else []


def _few_people(run: Results) -> list[str]:
    """Return that the recording has too few people to decide anything."""
    return _if_any(too_few_people(run.manifest["dataset"]))


def _untried_proposal(run: Results) -> list[str]:
    """Return that no further adversary was tried on the proposal."""
    proposals = run.recommendation().proposals
    if not proposals:
        return []
    is_tried = any(side.reader is not None for side in proposals[0].beyond)
    return [] if is_tried else ["the proposal was tried against one release only"]


def _doubtful_units(run: Results) -> list[str]:
    """Return that the recording may be in another unit."""
    repairs = run.manifest["dataset"]["repairs"]
    is_doubtful = any(repair["kind"] == "doubt" for repair in repairs)
    return ["units of the recording may be wrong"] if is_doubtful else []


def _missing_intervals(run: Results) -> list[str]:
    """Return which numbers have no interval at any level."""
    table, subjects = run.headline, dict[str, None]()  # A set that keeps its order.
    for column in table.columns:
        numbers = [table.at(where, column) for where in table.levels]
        known = [number for number in numbers if number is not None]
        if known and not any(math.isfinite(number.ci_low) for number in known):
            subjects[column.subject] = None
    return [f"no intervals on {listed([*subjects])} (few people)"] if subjects else []


def _failed_positive_controls(run: Results) -> list[str]:
    """Return how many positive controls of the descriptors failed."""
    controls = run.verdict.get("controls", ())
    n_failed = sum(item["decision"] == DOES_NOT for item in controls)
    if not n_failed:
        return []
    return [f"{counted(n_failed, 'positive control')} of the descriptors failed"]


def _weak_attacks(run: Results) -> list[str]:
    """Return how many signs there are that an attack is weak."""
    n_weak = len(weak_attacks.lines(run.flags))
    return [f"{counted(n_weak, 'sign')} of a weak attack"] if n_weak else []


def _invalid_results(run: Results) -> list[str]:
    """Return how many linkage results measure a shortcut instead of the attack."""
    texts = (
        run.linkability[["cohort", "knowledge", "invalid"]].astype(object).fillna("")
    )
    is_linked = (texts["cohort"] == "all") & (texts["knowledge"] != "")
    invalid = texts.loc[is_linked, "invalid"]
    shortcuts = sorted({name for text in invalid if text for name in text.split(", ")})
    if not shortcuts:
        return []
    names = listed([shortcut_name(name) for name in shortcuts])
    n_invalid = int((invalid != "").sum())
    return [f"{n_invalid} of {len(invalid)} linkage results invalid ({names})"]


def _linking_controls(run: Results) -> list[str]:
    """Return how many controls link people, if more than chance explains.

    Each test of a control that links nobody rejects in 5 % of runs. The doubt appears
    if so many rejections are as rare, by the one-sided binomial tail. The tail takes
    the tests as independent. They share their people, so that several reject together
    more often than it says.
    """
    tests = [
        is_linked
        for task in run.tasks
        for control in control_tests(task).values()
        for is_linked in control
    ]
    n_linked, n_tests = sum(tests), len(tests)
    # P(n_linked or more of n_tests); bdtrc(k, n, p) is P(more than k).
    if n_linked == 0 or bdtrc(n_linked - 1, n_tests, LEVEL) > LEVEL:
        return []
    expected = f"{LEVEL * n_tests:.1f} expected"
    return [f"{n_linked} of {n_tests} controls link people ({expected})"]


def _skipped_tasks(run: Results) -> list[str]:
    """Return the linkage tasks that are left out."""
    skipped = list(_linkage(run).get("skipped", ()))
    return [f"not linked: {listed(skipped)}"] if skipped else []


def _frozen_tracks(run: Results) -> list[str]:
    """Return how many tracks of a linkage task hardly move."""
    tasks = _linkage(run).get("tasks", {})
    n_frozen = max((task.get("frozen", 0) for task in tasks.values()), default=0)
    return [f"{counted(n_frozen, 'track')} nearly frozen"] if n_frozen else []


def _slow_people(run: Results) -> list[str]:
    """Return that the used tracks have another speed than all tracks."""
    return _if_any(used_are_slower(run.manifest, least=_MUCH))


def _further_notices(run: Results) -> list[str]:
    """Return how many notices the run has."""
    texts = notices(run.manifest)
    return [counted(len(texts), "notice")] if texts else []


def _linkage(run: Results) -> Mapping[str, Any]:
    """Return what the manifest says of linkage."""
    return run.manifest.get("linkage") or {}


def _if_any(text: str) -> list[str]:
    return [text] if text else []


_DOUBTS: Final[tuple[Callable[[Results], list[str]], ...]] = (
    _failed_cells,
    plugin_doubts,
    _few_people,
    _untried_proposal,
    _doubtful_units,
    _missing_intervals,
    _failed_positive_controls,
    _weak_attacks,
    _invalid_results,
    _linking_controls,
    _skipped_tasks,
    _frozen_tracks,
    _slow_people,
    _further_notices,
)
"""Doubts, the gravest first: the first screen has room for a few."""
