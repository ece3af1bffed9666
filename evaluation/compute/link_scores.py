"""What is read off the scores of a linkage attack, and the tables that a cell keeps of it.

The scorecard takes a bootstrap and a permutation test; it belongs to the cell, so that
a report is drawn without computing either again. Replicates of rank metrics follow from
the probes; those of score metrics visit every pair, and are kept, but not of controls:
each is held against its own permutation test, and nobody pairs two.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.random import Generator

from evaluation.compute.link_setup import Pairing, SensedSessions
from evaluation.compute.tables import ROWS, Tables, column, names_column, table
from isac_track import linkability
from isac_track.intervals import Estimate, cluster_sums, exact_binomial, ratio_estimates
from isac_track.linkability.ranks import expected_hit
from isac_track.linkability.scoring import RANK_METRICS, Drawn, draw, scorecard_of
from isac_track.linkability.significance import People, people_of
from isac_track.rng import stream
from isac_track.types import Floats, Ints

WITHOUT_GROUPS, WITHOUT_FROZEN = "without_groups", "without_frozen"
"""Without people who walk in a group, and move alike; without nearly frozen annotations."""
SHUFFLES, AUDIT_SHUFFLES = (
    999,
    1999,
)  # The audit's can reject at a hundredth over six tests.
ESTIMATES: Final = "estimates"
REPLICATES: Final = "replicates"
ABOUT: Final = "about"
DERIVED: Final = (
    "chance",
    "residual_risk",
    "d_sys_corrected",
)  # Replicates follow from others'.
COMPANIONS: Final = ("companions", "companions_above", "companions_tied")
"""Columns of `ProbeRanks.companions`: who walks along is no candidate of `rank1_g100`."""
ASSIGNED: Final = ("nobody", "other", "mate", "mate if any", "unknown")
"""What is assigned to a probe: `ProbeRanks.assigned`; unknown where scores have no scale."""
NAMED_MATES: Final = frozenset(
    {"mate", "mate if any"}
)  # Of `ASSIGNED`: they count as found.
_NUMBERS = (
    "p_value",
    "p_value_low",
    "p_rank1",
    "n_probes",
    "n_mated",
    "gallery_sizes",
    "n_clusters",
    "realised_fpr_1pct",
    "realised_fpr_01pct",
    "d_sys_bins",
    "is_inverted",
    "minimum_detectable_rank1",
)
_AT_ONCE = 256  # Probes that are compared at a time: of thousands all take 200 MB.
_NOTHING: Final[Mapping[int, Any]] = MappingProxyType({})


@dataclass(frozen=True, eq=False, slots=True)
class Linked:
    """Outcome of one cell: raw scores, and all that is read off them."""

    searches: tuple[linkability.Search, ...]
    calibration: Mapping[int, linkability.Calibration]  # By fold.
    scored: linkability.Scorecard
    cohorts: Mapping[
        str, Mapping[str, float]
    ]  # Rank 1 by who is left out; none for a control.
    is_assigned: bool  # Whether scores have a known scale, or need none.
    losses: Floats | None = None
    """(n,) hits that scoring some candidates alone costs each probe that is searched in full."""


def read_off(
    scores: Mapping[int, Floats],
    *,
    known: SensedSessions,
    drawn_from: Generator | tuple[str, ...],
    calibration: Mapping[int, linkability.Calibration] = _NOTHING,
    matched: Mapping[int, Floats] = _NOTHING,
    is_audit: bool = False,
    losses: Floats | None = None,
) -> Linked:
    """Return the scorecard of an attack or a control, and of an attack without confounders.

    `scores` are those of every search, (P, G) each, by its number, `calibration` those
    by fold that there was somebody for. `matched` are by search the probabilities of
    the pairs of an open gallery (`matched_pairs`): without them there is no assignment
    in one. What the scorecard draws is `drawn_from` a control's own stream, or from
    that of the attack of this name, alike at all levels. With `known.candidates` all is
    read off the ranks, and `losses` says what the attack lost.
    """
    sessions, weights = known.sessions, known.weights
    searches = tuple(
        linkability.Search(
            scores=scores[number],
            mate=pairing.mate,
            probe_cluster=known.cluster[sessions.probe.person[pairing.probe]],
            gallery_cluster=known.cluster[sessions.gallery.person[pairing.gallery]],
            scale=int(sessions.fold[number]),
        )
        for number, pairing in sorted(known.searches.items())
    )
    is_matched = sessions.task.is_open and scores.keys() <= matched.keys()
    probable = [matched[number] for number in sorted(scores)] if is_matched else None
    is_assigned = is_matched or not sessions.task.is_open
    is_assigned &= not known.candidates  # what was not scored has no score to be summed
    is_calibrated = {search.scale for search in searches} <= set(calibration)
    shuffles = AUDIT_SHUFFLES if is_audit else SHUFFLES
    if known.candidates:
        rng = (
            drawn_from
            if isinstance(drawn_from, Generator)
            else _stream(known.seed, *drawn_from)
        )
        scored = linkability.rank_scorecard(
            searches, weights=weights, rng=rng, n_shuffles=shuffles
        )
    else:
        people = tuple(people_of(search) for search in searches)
        if isinstance(drawn_from, Generator):
            draws = draw(people, drawn_from, shuffles)
        else:
            draws = _draws(people, known.seed, *drawn_from)
        scored = scorecard_of(
            searches,
            weights=weights,
            calibration=calibration if is_calibrated else None,
            no_match_score=None,
            draws=draws,
            matched=probable,
        )
    estimates = dict(scored.estimates)
    if not is_assigned:  # nobody knows what leaving somebody alone costs
        for name in estimates.keys() & {"rank1_assigned", "false_link_rate"}:
            unknown = np.full_like(estimates[name].replicates, np.nan)
            estimates[name] = Estimate(np.nan, n=estimates[name].n, replicates=unknown)
    if sessions.task.comes_back:  # one outcome a person, and few
        hits = int(
            estimates["rank1"].value * scored.n_mated + 1e-9
        )  # ties leave fractions
        low, high = exact_binomial(hits=hits, n=scored.n_mated)
        estimates["rank1"] = replace(estimates["rank1"], ci_low=low, ci_high=high)
    return Linked(
        searches=searches,
        calibration=calibration,
        scored=replace(scored, estimates=estimates),
        cohorts={} if isinstance(drawn_from, Generator) else _cohorts(searches, known),
        is_assigned=is_assigned,
        losses=losses,
    )


def _stream(seed: int, *names: str) -> Generator:
    """Return the stream of the scorecard of the attack of this name, at whatever level."""
    return stream(seed, "linkage", "scorecard", *names)


@lru_cache(maxsize=20)  # those of a task; of a thousand people 2 MB each
def _draws(people: tuple[People, ...], seed: int, *names: str) -> tuple[Drawn, ...]:
    return draw(people, _stream(seed, *names), SHUFFLES)


def _cohorts(
    searches: Sequence[linkability.Search], known: SensedSessions
) -> dict[str, dict[str, float]]:
    """Return rank 1 where only some people are probes and candidates, for each set of people."""
    parts, of_set, chance, place, trials = _without(known)
    hits = []
    for search, (mated, mate, gallery, probe, of) in zip(searches, parts, strict=True):
        own, count = (
            search.scores[mated, mate][:, None],
            np.empty((2, mated.size, 2), np.float32),
        )
        for first in range(0, mated.size, _AT_ONCE):
            rows = slice(first, first + _AT_ONCE)
            scores, mine = search.scores[mated[rows]], own[rows]
            # How many of each set stand above the mate and as high: exact in single
            # precision.
            for which, one in enumerate((scores > mine, scores == mine)):
                count[which, rows] = one.astype(np.float32) @ gallery
        above, tied = count[:, probe, of]
        hits.append(expected_hit(above, tied.astype(np.float64)))
    hit = np.concatenate(hits)
    sums = cluster_sums(values=hit, cluster=place, n_clusters=trials.size).reshape(
        trials.shape
    )
    of = {"numerator": sums, "denominator": trials, "weights": known.weights}
    found = ratio_estimates(**of, is_share=[True] * len(trials))
    cohorts = {}
    for number, (name, one) in enumerate(
        zip((WITHOUT_GROUPS, WITHOUT_FROZEN), found, strict=True)
    ):
        mine = of_set == number
        of_mine, is_any = chance[mine], bool(mine.any())
        cohorts[name] = {
            "rank1": one.value,
            "ci_low": one.ci_low,
            "ci_high": one.ci_high,
            "n_clusters": one.n,
            "chance": float(of_mine.mean()) if is_any else np.nan,
            "p_rank1": (
                linkability.rank1_p(hits=hit[mine], chance=of_mine)
                if is_any
                else np.nan
            ),
            "n_mated": int(mine.sum()),
        }
    return cohorts


@lru_cache(maxsize=4)
def _without(
    known: SensedSessions,
) -> tuple[list[tuple[Any, ...]], Ints, Floats, Ints, Floats]:
    """Return who searches for whom without some people, the same at every attack.

    Of each search mated probes, their mates, candidates, (G, sets), and which probe
    counts in which set; of all these trials the set, the chance, the place among sets
    by clusters, and their number at each place.
    """
    among, sessions = (
        np.stack([known.sessions.alone, known.sessions.moving]),
        known.sessions,
    )
    parts, chances, clusters = [], [], []
    for _, pairing in sorted(known.searches.items()):
        mated = np.flatnonzero(pairing.mate >= 0)
        mate, person = pairing.mate[mated], sessions.probe.person[pairing.probe[mated]]
        gallery = among[:, sessions.gallery.person[pairing.gallery]].T
        probe, of = np.nonzero(among[:, person].T & gallery[mate])
        parts.append((mated, mate, gallery.astype(np.float32), probe, of))
        chances.append(1.0 / gallery.sum(axis=0)[of])
        clusters.append(known.cluster[person[probe]])
    of_set = np.concatenate([of for *_, of in parts])
    shape = len(among), known.weights.shape[1]
    place = of_set * shape[1] + np.concatenate(clusters)
    trials = (
        np.bincount(place, minlength=shape[0] * shape[1])
        .astype(np.float64)
        .reshape(shape)
    )
    return parts, of_set, np.concatenate(chances), place, trials


def calibrated(
    found: Sequence[tuple[Floats, Pairing]],
) -> linkability.Calibration | None:
    """Return the calibration on who is neither attacked nor learnt from; None without pairs."""
    mated, non_mated = [np.zeros(0)], [np.zeros(0)]
    for scores, pairing in found:
        is_mate = pairing.mate[:, None] == np.arange(scores.shape[1])
        mated.append(scores[is_mate])
        non_mated.append(scores[~is_mate])
    first, second = np.concatenate(mated), np.concatenate(non_mated)
    if not (first.size and second.size):
        return None
    return linkability.fit_calibration(mated=first, non_mated=second)


def score_scale(found: Sequence[tuple[Floats, Pairing]]) -> float | None:
    """Return by what scores of an open gallery are to be multiplied to be log ratios.

    Fitted on the same people as `calibrated`, within the gallery of each: what parts a
    mate from the candidates nearby counts, not from those at the other end of the
    scene. None without mates.
    """
    if not any((pairing.mate >= 0).any() for _, pairing in found):
        return None
    scores, pairings = zip(*found, strict=True)
    return linkability.fit_scale(scores, [pairing.mate for pairing in pairings])


def matched_pairs(scores: Floats, *, scale: float, mate_rate: float) -> Floats:
    """Return how probable each pair of an open search is if all are matched at once, (P, G).

    As many probes are expected to have a mate as of other people, `mate_rate` of them.
    Whoever seeks the most correct links names the most probable candidate of every
    probe.
    """
    return linkability.open_matches(scale * scores, n_links=mate_rate * len(scores))


def linkage_tables(
    linked: Linked, known: SensedSessions, *, keep_scores: bool
) -> Tables:
    """Return the tables of a linkage attack or control at one level.

    - `rows`, one a probe: `search` (a half, or the instant of a handover), `source`, `group`;
      `above` and `tied`, how many candidates score above its mate and how many as high, the mate
      included (-1 and 0 without a mate); `chance` of rank 1, `assigned` (`ASSIGNED`);
      with the raw scores also `mate` (place in the gallery, or -1) and `scores` against
      the whole gallery; `COMPANIONS`;
    - `estimates`, one a metric: `metric`, `value`, `ci_low`, `ci_high`, `n`;
    - `replicates`, one a bootstrap draw: a column for each score metric, in single precision;
    - `about`: one row with all other numbers as JSON.
    """
    scored, probes, sessions = linked.scored, linked.scored.probes, known.sessions
    assigned = (
        probes.assigned + 1
        if linked.is_assigned
        else np.full_like(probes.assigned, len(ASSIGNED) - 1)
    )
    rows = {
        **_probe_names(known),
        "above": probes.above.astype(np.int32),
        "tied": probes.tied.astype(np.int32),
        "chance": probes.chance,
        "assigned": names_column(assigned, ASSIGNED),
        **dict(zip(COMPANIONS, probes.companions.astype(np.int32).T, strict=True)),
    }
    about: dict[str, Any] = {
        "calibration": {fold: asdict(one) for fold, one in linked.calibration.items()},
        "numbers": {name: getattr(scored, name) for name in _NUMBERS},
        "cohorts": linked.cohorts,
    }
    if linked.losses is not None:
        about["numbers"]["n_checked"] = linked.losses.size
        about["numbers"]["rank1_loss"] = (
            float(linked.losses.mean()) if linked.losses.size else None
        )
    if keep_scores:
        flat = np.concatenate([one.scores.ravel() for one in linked.searches]).astype(
            np.float32
        )
        sizes = [row.size for one in linked.searches for row in one.scores]
        starts = np.cumsum([0, *sizes], dtype=np.int32)
        rows["mate"] = np.concatenate([one.mate for one in linked.searches]).astype(
            np.int32
        )
        rows["scores"] = pa.ListArray.from_arrays(column(starts), column(flat))
        about["gallery"] = [
            [
                sessions.source[person]
                for person in sessions.gallery.person[pairing.gallery]
            ]
            for _, pairing in sorted(known.searches.items())
        ]
    found = scored.estimates
    estimates = {"metric": [*found]} | {
        field: np.array([getattr(one, field) for one in found.values()])
        for field in ("value", "ci_low", "ci_high", "n")
    }
    tables = {
        ROWS: table(rows),
        ESTIMATES: table(estimates),
        ABOUT: table({"about": [_about_task(known) + _json(about)[1:]]}),
    }
    if linked.cohorts:  # of controls nobody pairs two
        follow = {*DERIVED, *RANK_METRICS}
        kept = {
            name: one.replicates for name, one in found.items() if name not in follow
        }
        tables[REPLICATES] = table(
            {name: one.astype(np.float32) for name, one in kept.items()}
        )
    return tables


@lru_cache(maxsize=4)
def _probe_names(known: SensedSessions) -> dict[str, pa.Array]:
    """Return the columns that name the probes: those of every cell of a task."""
    sessions = known.sessions
    probe = np.concatenate([one.probe for _, one in sorted(known.searches.items())])
    person = sessions.probe.person[probe]
    return {
        "search": names_column(sessions.probe.search[probe], sessions.searches),
        "source": names_column(person, sessions.source),
        "group": names_column(person, sessions.group),
    }


@lru_cache(maxsize=4)
def _about_task(known: SensedSessions) -> str:
    """Return what the JSON about every cell of a task begins with."""
    about = {
        "clusters": sorted(set(known.sessions.group)),
        "drawn_as": known.drawn_as.tolist(),
        "n_groups": known.n_groups,
        "seed": known.seed,
    }
    return f"{_json(about)[:-1]}, "


def _json(about: dict[str, Any]) -> str:
    return json.dumps(about, default=lambda number: number.item())
