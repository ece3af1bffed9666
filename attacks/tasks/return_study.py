"""Are people who come back re-identified? Cells, controls, test and decision."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from attacks.linkage.behaviour import Behaviour
from attacks.linkage.gait import Gait
from attacks.linkage.likelihood_ratio import LikelihoodRatio
from attacks.tasks.returns import Passages, hide, score_passages
from attacks.tasks.task_list import FUSED
from isac_track.config import StageSettings
from isac_track.errors import SettingsError
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
from isac_track.resample import sampling_times
from isac_track.rng import stream
from isac_track.sensing import (
    draw_walk_channel,
    recorded_walk,
    sense,
    walked_within,
)
from isac_track.types import Bools, Floats, Ints, Release, Sensed

LINKERS: Final[Mapping[str, LinkageAttack]] = dict(
    zip(FUSED, (Gait(), Behaviour(), LikelihoodRatio()), strict=True)
)
"""The linkers that are fused."""
STAGES: Final = StageSettings()
FUSION: Final = "fusion"
TOGETHER: Final = "all circumstances"
ENROLLED: Final[tuple[int | None, ...]] = (1, 3, None)
"""Passages of each person in the gallery; None: all."""
_Key: TypeAlias = tuple[str, int | None]


@dataclass(frozen=True, eq=False, slots=True)
class ReturnStudy:
    """All numbers of a recording of people who come back, at a level of error.

    Attributes
    ----------
    cells : Mapping
        Cell of each linker and number of enrolled passages, closed set, another run.
    controls : Mapping
        The same of each circumstance and of all together, all passages enrolled.
    same_run : ReturnCell or None
        The fusion within a run, all passages enrolled: a control. None where nobody
        walks twice in a run.
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
    same_run: ReturnCell | None
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
    """Scores of linkers and circumstances, and how to fuse them."""

    returning: Returning
    scores: Mapping[str, Floats]  # (K + 1 or 1, N, N), linkers, then circumstances
    linkers: tuple[str, ...]
    circumstances: tuple[str, ...]
    laws: Mapping[str, Floats]  # (K + 1, L + 1), of `FUSION` and `TOGETHER`

    def members(self, name: str) -> tuple[str, ...]:
        """Return the linkers or circumstances that a name stands for."""
        if name == FUSION:
            return self.linkers
        return self.circumstances if name == TOGETHER else (name,)

    def law(self, name: str) -> Floats:
        """Return how scores are fused; a single score stays as it is."""
        single = np.tile([1.0, 0.0], (self.returning.people.size + 1, 1))
        return self.laws.get(name, single)

    def fused(self, name: str, weights: Floats) -> PersonScores:
        """Return the scores of a linker, a circumstance or a fusion."""
        scores = [self.scores[member] for member in self.members(name)]
        return fuse(scores, self.law(name), self.returning, weights)

    def nodes(self, name: str) -> NodeScores:
        """Return its scores between people in runs."""
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
    cells = _cells(scored, seed, enrolled)
    primary = _primary(scored, cells[FUSION, None], seed, n_permutations, None)
    decision, second = decide_return(primary.evidence), None
    if confirming is not None and awaits_confirmation(primary.evidence):
        everything = np.ones(len(passages), dtype=bool)
        again = _score(passages, release, everything, linkers, seed)
        cell = _closed(again, [FUSION], session=aside, seed=seed)[FUSION]
        second = _primary(again, cell, seed, n_permutations, aside).evidence
        decision = decide_return(primary.evidence, confirming=second)
    return ReturnStudy(
        cells=cells,
        controls=_closed(scored, (*scored.circumstances, TOGETHER), seed=seed),
        same_run=_same_run(scored, seed),
        opened=primary.opened,
        regression=primary.regression,
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
    person, session = passages.person[rows], passages.session[rows]
    names, person = np.unique(person, return_inverse=True)
    person = person.astype(np.int64)
    pairs = np.unique(np.stack([person, session]), axis=1)
    people = np.flatnonzero(np.bincount(pairs[0], minlength=names.size) > 1)
    returning = Returning(person, session, people.astype(np.int64))
    part = release if rows.size == len(release) else release.tracks(rows)
    values = {
        name: score_passages(
            attack,
            part,
            person=person,
            session=session,
            returning=returning.people,
            seed=seed,
        ).values
        for name, attack in linkers.items()
    }
    for name, closeness in passages.closeness.items():
        values[name] = closeness[None, rows[:, None], rows]
    everything = enrolment(returning, seed=seed)
    groups = {FUSION: tuple(linkers), TOGETHER: tuple(passages.closeness)}
    laws = {
        name: fusion_laws([values[member] for member in members], returning, everything)
        for name, members in groups.items()
    }
    return _Scored(returning, values, groups[FUSION], groups[TOGETHER], laws)


def _cells(
    scored: _Scored, seed: int, enrolled: Sequence[int | None]
) -> dict[_Key, ReturnCell]:
    """Return the closed cells of another run."""
    return {
        (name, most): cell
        for most in enrolled
        for name, cell in _closed(
            scored, (*scored.linkers, FUSION), most=most, seed=seed
        ).items()
    }


def _closed(
    scored: _Scored,
    names: Sequence[str],
    *,
    most: int | None = None,
    probe: Probe = "another run",
    session: int | None = None,
    seed: int,
) -> dict[str, ReturnCell]:
    """Return cells of one gallery; with `session` only its passages are probes."""
    returning = scored.returning
    weights = enrolment(returning, most=most, probe=probe, seed=seed)
    rows = np.arange(returning.person.size)
    if session is not None:
        rows = np.flatnonzero(returning.session == session)
    controls = {
        name: scored.fused(name, weights) for name in (*scored.circumstances, TOGETHER)
    }
    return {
        name: return_cell(scored.fused(name, weights), controls, returning, rows=rows)
        for name in names
    }


def _same_run(scored: _Scored, seed: int) -> ReturnCell | None:
    """Return the control within a run, or None where nobody walks twice in a run."""
    pairs = np.stack([scored.returning.session, scored.returning.person])
    if np.unique(pairs, axis=1).shape[1] == pairs.shape[1]:
        return None
    return _closed(scored, [FUSION], probe="same run", seed=seed)[FUSION]


@dataclass(frozen=True, eq=False, slots=True)
class _Primary:
    """Results of the cell that decides."""

    evidence: ReturnEvidence
    regression: Regression
    opened: OpenSet


def _primary(
    scored: _Scored,
    cell: ReturnCell,
    seed: int,
    n_permutations: int,
    session: int | None,
) -> _Primary:
    """Return the evidence of the primary cell, its test and its open set."""
    nodes = scored.nodes(FUSION)
    person, run = nodes.person, nodes.session
    controls = np.stack([scored.nodes(name).values for name in scored.circumstances])
    counts = run[:, None] != run
    if session is not None:
        counts &= (run == session)[:, None]
    regression = nested_permutation(
        nodes.values,
        (person[:, None] == person).astype(float),
        controls,
        counts=counts,
        block=run,
        rng=stream(seed, "returns", "permutations"),
        n_permutations=n_permutations,
    )
    fused = scored.fused(FUSION, enrolment(scored.returning, seed=seed))
    evidence = ReturnEvidence(cell.gain, regression.p_value)
    return _Primary(evidence, regression, open_set(fused, scored.returning))


def share_passages(
    passages: Passages,
    *,
    error: str,
    seed: int = 0,
    stages: StageSettings = STAGES,
) -> Release:
    """Return the passages as an adversary gets them, without frame or clock.

    `error` is the standard deviation of white errors per axis in m, a number of at
    least 0; or ``raw`` for the suite's own sensing, with its sampling instants.
    SettingsError for anything else.
    """
    t, xy, offsets = passages.t, passages.xy, passages.offsets
    if error == "raw":
        robots_m = [stages.scenes.robot_x_m, stages.scenes.robot_y_m]
        shift_m = robots_m - np.median(xy, axis=0)
        sensed = sense_passages(passages, shift_m=shift_m, stages=stages, seed=seed)
        t, xy, offsets = sensed.t, sensed.xy, sensed.offsets
    else:
        xy = xy + _white(error, passages, seed)
    return hide(t=t, xy=xy, offsets=offsets, sigma=None, seed=seed)


def _white(error: str, passages: Passages, seed: int) -> Floats:
    """Return white errors, (M, 2) m; each passage has a stream of its own."""
    try:
        std_m = float(error)
    except ValueError:
        std_m = -1.0
    if not 0.0 <= std_m < np.inf:
        raise SettingsError(f"an error is a number of metres or raw, got {error!r}")
    sizes = np.diff(passages.offsets).tolist()
    draws = [
        stream(seed, "returns", "white", source).standard_normal((size, 2))
        for source, size in zip(passages.source, sizes, strict=True)
    ]
    return std_m * np.concatenate(draws)


def sense_passages(
    passages: Passages,
    *,
    shift_m: Floats | None = None,
    stages: StageSettings = STAGES,
    seed: int = 0,
) -> Sensed:
    """Return what the network senses of whole passages, at its own instants.

    `shift_m`, (2,), moves all of them first; None: they stay where they are.
    """
    times, places = list[Floats](), list[Floats]()
    for row, source in enumerate(passages.source):
        part = slice(passages.offsets[row], passages.offsets[row + 1])
        instants = sampling_times(
            start_s=float(passages.t[part][0]),
            end_s=float(passages.t[part][-1]),
            settings=stages.resample,
            rng=stream(seed, "returns", "sampling", source),
        )
        times.append(instants)
        places.append(CubicSpline(passages.t[part], passages.xy[part])(instants))
    t, xy = np.concatenate(times), np.concatenate(places)
    if shift_m is not None:
        xy = xy + shift_m
    offsets = np.append(0, np.cumsum([instants.size for instants in times]))
    walks = [recorded_walk(source) for source in passages.source]
    channel = draw_walk_channel(
        walked_m=walked_within(xy, offsets),
        offsets=offsets,
        walks=walks,
        keys=walks,
        settings=stages.sensing,
        seed=seed,
    )
    return sense(t=t, xy=xy, offsets=offsets, channel=channel, settings=stages.sensing)


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
