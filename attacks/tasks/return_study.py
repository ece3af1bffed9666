"""Are people who come back re-identified? All numbers of the task `returns`.

The study scores all pairs of passages by each linker (`attacks.tasks.passage_scores`),
fuses the scores, ranks people, and compares with controls. Then it tests and decides by
the rule of `isac_track.linkability.return_rule`.

A *cell* is a linker, the fusion or a control, with a number of enrolled passages: rank
1 and its gain over the control. A person is *enrolled* by passages in the gallery.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from attacks.linkage.behaviour import Behaviour
from attacks.linkage.gait import Gait
from attacks.linkage.likelihood_ratio import LikelihoodRatio
from attacks.tasks.passage_scores import score_passages
from attacks.tasks.passages import Passages, returning_people
from attacks.tasks.task_list import FUSED
from isac_track.intervals import Estimate
from isac_track.linkability.mrqap import Regression, nested_permutation
from isac_track.linkability.return_rule import (
    ReturnDecision,
    ReturnEvidence,
    awaits_confirmation,
    decide_return,
)
from isac_track.linkability.returns import (
    NodeScores,
    OpenSet,
    PersonScores,
    Probe,
    ReturnCell,
    Returning,
    enrolment,
    fuse,
    fusion_laws,
    node_scores,
    open_set,
    return_cell,
)
from isac_track.protocols import LinkageAttack
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Ints, Release

LINKERS: Final[Mapping[str, LinkageAttack]] = dict(
    zip(FUSED, (Gait(), Behaviour(), LikelihoodRatio()), strict=True)
)
"""The linkers that are fused."""
FUSION: Final = "fusion"
TOGETHER: Final = "all circumstances"
ENROLLED: Final[tuple[int | None, ...]] = (1, 3, None)
"""Passages of each person in the gallery; None: all."""
_Key: TypeAlias = tuple[str, int | None]
"""Name of a linker or of the fusion, and the number of enrolled passages."""


@dataclass(frozen=True, eq=False, slots=True)
class ReturnStudy:
    """All numbers of a recording of people who come back, at a level of error.

    Attributes
    ----------
    cells : Mapping
        Cell of each linker and number of enrolled passages, closed set, another
        session.
    controls : Mapping
        The same of each circumstance and of all together, all passages enrolled.
    same_session : ReturnCell or None
        The fusion within a session, all passages enrolled: a control. None where nobody
        walks twice in a session.
    opened : OpenSet
        The fusion, all passages enrolled, open set.
    regression : Regression
        Being the same person, beyond all circumstances.
    decision : ReturnDecision
        By the rule, from the primary cell and the regression.
    confirming : ReturnEvidence or None
        The primary cell with the probes of the session left aside alone; None without
        it, or where it cannot change the decision.
    """

    cells: Mapping[_Key, ReturnCell]
    controls: Mapping[str, ReturnCell]
    same_session: ReturnCell | None
    opened: OpenSet
    regression: Regression
    decision: ReturnDecision
    confirming: ReturnEvidence | None

    @property
    def primary(self) -> ReturnCell:
        """The cell that decides."""
        return self.cells[FUSION, None]


@dataclass(frozen=True, eq=False, slots=True)
class _Scored:
    """Scores of N passages by L linkers and C circumstances, and how to fuse them."""

    returning: Returning  # K people come back.
    # By linker and circumstance: (K + 1, N, N), or (1, N, N) if it is not trained.
    scores: Mapping[str, Floats]
    linkers: tuple[str, ...]
    circumstances: tuple[str, ...]
    # Of `FUSION`, (K + 1, L + 1), and of `TOGETHER`, (K + 1, C + 1).
    laws: Mapping[str, Floats]

    def members(self, name: str) -> tuple[str, ...]:
        """Return the linkers or circumstances that a name stands for."""
        if name == FUSION:
            return self.linkers
        return self.circumstances if name == TOGETHER else (name,)

    def law(self, name: str) -> Floats:
        """Return how scores are fused; a single score stays as it is."""
        single = np.tile([1.0, 0.0], (self.returning.people.size + 1, 1))
        return self.laws.get(name, single)

    def person_scores(self, name: str, weights: Floats) -> PersonScores:
        """Return the scores of a linker, a circumstance or a fusion against people."""
        scores = [self.scores[member] for member in self.members(name)]
        return fuse(scores, self.law(name), self.returning, weights)

    def node_scores(self, name: str) -> NodeScores:
        """Return the same scores between nodes: people in sessions."""
        scores = [self.scores[member] for member in self.members(name)]
        return node_scores(scores, self.law(name), self.returning)


def study_returns(
    passages: Passages,
    release: Release,
    *,
    linkers: Mapping[str, LinkageAttack] = LINKERS,
    enrolled: Sequence[int | None] = ENROLLED,
    confirming: str | None = None,
    seed: int = 0,
    n_permutations: int = 999,
) -> ReturnStudy:
    """Return the study of a release of the passages, without frame or clock.

    `confirming` names a session that is left aside: nothing but the confirming evidence
    sees it, and that is computed only where it can change the decision. ValueError if
    no such session exists.
    """
    if confirming is not None and confirming not in passages.sessions:
        raise ValueError(f"no session is called {confirming!r}")
    aside = -1 if confirming is None else passages.sessions.index(confirming)
    scored = _score(passages, release, passages.session != aside, linkers, seed)
    cells = {
        (name, most): cell
        for most in enrolled
        for name, cell in _closed_cells(
            scored, (*scored.linkers, FUSION), most=most, seed=seed
        ).items()
    }
    regression = _regress(scored, seed, n_permutations)
    evidence = ReturnEvidence(cells[FUSION, None].gain, regression.p_value)
    decision, second = decide_return(evidence), None
    if confirming is not None and awaits_confirmation(evidence):
        everything = np.ones(len(passages), dtype=bool)
        scored_all = _score(passages, release, everything, linkers, seed)
        second = _confirming_evidence(scored_all, aside, seed, n_permutations)
        decision = decide_return(evidence, confirming=second)
    return ReturnStudy(
        cells=cells,
        controls=_closed_cells(scored, (*scored.circumstances, TOGETHER), seed=seed),
        same_session=_same_session_cell(scored, seed),
        opened=_open_set(scored, seed),
        regression=regression,
        decision=decision,
        confirming=second,
    )


def _score(
    passages: Passages,
    release: Release,
    chosen: Bools,
    linkers: Mapping[str, LinkageAttack],
    seed: int,
) -> _Scored:
    """Score the chosen passages, (N,) true where chosen, by every linker."""
    rows = np.flatnonzero(chosen)
    returning = _returning(passages.person[rows], passages.session[rows])
    part = release if rows.size == len(release) else release.tracks(rows)
    scores = {
        name: score_passages(attack, part, returning, seed=seed)
        for name, attack in linkers.items()
    }
    for name, closeness in passages.closeness.items():
        scores[name] = closeness[None, rows[:, None], rows]
    weights = enrolment(returning, seed=seed)
    groups = {FUSION: tuple(linkers), TOGETHER: tuple(passages.closeness)}
    laws = {
        name: fusion_laws([scores[member] for member in members], returning, weights)
        for name, members in groups.items()
    }
    return _Scored(returning, scores, groups[FUSION], groups[TOGETHER], laws)


def _returning(person: Ints, session: Ints) -> Returning:
    """Return who walks in which passage, with people numbered anew from 0."""
    names, number = np.unique(person, return_inverse=True)
    number = number.astype(np.int64)
    people = returning_people(number, session, n_people=names.size)
    return Returning(number, session, people)


def _closed_cells(
    scored: _Scored,
    names: Sequence[str],
    *,
    most: int | None = None,
    probe: Probe = "another session",
    session: int | None = None,
    seed: int,
) -> dict[str, ReturnCell]:
    """Return the cell of each name, in a closed set: every probe has a mate.

    At most `most` passages of each person are enrolled; None: all. With `session` only
    its passages are probes.
    """
    returning = scored.returning
    weights = enrolment(returning, most=most, probe=probe, seed=seed)
    rows = np.arange(returning.person.size)
    if session is not None:
        rows = np.flatnonzero(returning.session == session)
    controls = {
        name: scored.person_scores(name, weights)
        for name in (*scored.circumstances, TOGETHER)
    }
    return {
        name: return_cell(
            scored.person_scores(name, weights), controls, returning, rows=rows
        )
        for name in names
    }


def _same_session_cell(scored: _Scored, seed: int) -> ReturnCell | None:
    """Return the control within a session, or None where nobody walks twice in it."""
    pairs = np.stack([scored.returning.session, scored.returning.person])
    if np.unique(pairs, axis=1).shape[1] == pairs.shape[1]:
        return None
    return _closed_cells(scored, [FUSION], probe="same session", seed=seed)[FUSION]


def _confirming_evidence(
    scored: _Scored, session: int, seed: int, n_permutations: int
) -> ReturnEvidence:
    """Return the evidence of the primary cell with the probes of one session alone."""
    cell = _closed_cells(scored, [FUSION], session=session, seed=seed)[FUSION]
    regression = _regress(scored, seed, n_permutations, session=session)
    return ReturnEvidence(cell.gain, regression.p_value)


def _regress(
    scored: _Scored, seed: int, n_permutations: int, *, session: int | None = None
) -> Regression:
    """Return the test whether being the same person explains the scores of the fusion.

    It is beyond all circumstances. With `session` only its passages are probes.
    """
    nodes = scored.node_scores(FUSION)
    controls = [scored.node_scores(name).values for name in scored.circumstances]
    counts = nodes.session[:, None] != nodes.session
    if session is not None:
        counts &= (nodes.session == session)[:, None]
    return nested_permutation(
        nodes.values,
        (nodes.person[:, None] == nodes.person).astype(float),
        np.stack(controls),
        counts=counts,
        block=nodes.session,
        rng=stream(seed, "returns", "permutations"),
        n_permutations=n_permutations,
    )


def _open_set(scored: _Scored, seed: int) -> OpenSet:
    """Return the fusion in an open set: some probes are of nobody enrolled."""
    weights = enrolment(scored.returning, seed=seed)
    return open_set(scored.person_scores(FUSION, weights), scored.returning)


def crossing(
    errors_m: Floats, cells: Sequence[Estimate], chance: Ints | Floats
) -> float:
    """Return the least error from which on the interval includes chance, m.

    `errors_m`, (E,), ascend; infinity if the last interval is still above chance. An
    interval that is not known counts as including it.
    """
    above = np.array(
        [bool(cell.ci_low > level) for cell, level in zip(cells, chance, strict=True)]
    )
    last = np.flatnonzero(above)
    if not last.size:
        return float(errors_m[0])
    return float(errors_m[last[-1] + 1]) if last[-1] + 1 < errors_m.size else np.inf
