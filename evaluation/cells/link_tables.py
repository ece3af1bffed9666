"""A linkage cell as tables: how every probe fared, and all that is read off the scores.

The scorecard takes a bootstrap and a permutation test; it belongs to the cell, so that a report is
drawn without computing either again. Replicates of rank metrics follow from the probes; those of
score metrics visit every pair, and are kept. Of controls neither these are nor the scores of their
probes: each is held against its own permutation test, and nobody pairs two.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa

from evaluation.cells.tables import ROWS, names_column

if TYPE_CHECKING:
    from evaluation.cells.link_scores import Linked
    from evaluation.cells.link_setup import SensedSessions
    from evaluation.cells.tables import Tables
    from isac_track.linkability import Search
    from isac_track.types import Floats

ESTIMATES: Final = "estimates"
REPLICATES: Final = "replicates"
ABOUT: Final = "about"
DERIVED: Final = ("chance", "residual_risk", "d_sys_corrected")
"""Metrics whose replicates follow from those of others: they are not kept."""
ASSIGNED: Final = ("nobody", "other", "mate", "unknown")
"""What is assigned to a probe; unknown where leaving somebody alone has no cost."""
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


def linkage_tables(
    linked: Linked, whole: SensedSessions, *, seed: int, keep_scores: bool
) -> Tables:
    """Return the tables of a linkage attack or control at one level.

    - `rows`, one a probe: `search` (a half, or the instant of a handover), `source`, `group`;
      `above` and `tied`, how many candidates score above its mate and how many as high, the mate
      included (-1 and 0 without a mate); `mate_score`, `best_other_score` (NaN where there is
      none, and of controls), `chance` of rank 1, `assigned` (`ASSIGNED`); with the raw scores
      also `mate` (place in the gallery, or -1) and `scores` against the whole gallery;
    - `estimates`, one a metric: `metric`, `value`, `ci_low`, `ci_high`, `n`;
    - `replicates`, one a bootstrap draw: a column for each score metric, in single precision;
    - `about`: one row with all other numbers as JSON.
    """
    scored, probes, sessions = linked.scored, linked.scored.probes, whole.sessions
    persons = np.concatenate(linked.probe_person)
    n_probes = [len(search.mate) for search in linked.searches]
    own, best = (
        np.concatenate(columns)
        for columns in zip(*(_own_and_best(one) for one in linked.searches), strict=True)
    )
    if linked.is_control:
        own, best = np.full_like(own, np.nan), np.full_like(best, np.nan)
    assigned = probes.assigned + 1 if linked.is_assigned else np.full(persons.size, 3)
    rows = {
        "search": names_column(np.repeat(np.arange(len(n_probes)), n_probes), sessions.searches),
        "source": names_column(persons, sessions.source),
        "group": names_column(persons, sessions.group),
        "above": probes.above.astype(np.int32),
        "tied": probes.tied.astype(np.int32),
        "mate_score": own.astype(np.float32),
        "best_other_score": best.astype(np.float32),
        "chance": probes.chance,
        "assigned": names_column(assigned, ASSIGNED),
    }
    about = {
        "clusters": sorted(set(sessions.group)),
        "drawn_as": whole.drawn_as.tolist(),
        "n_groups": whole.n_groups,
        "seed": seed,
        "calibration": {fold: asdict(one) for fold, one in linked.calibration.items()},
        "numbers": {name: getattr(scored, name) for name in _NUMBERS},
        "cohorts": {
            name: {
                "rank1": one.rank1.value,
                "ci_low": one.rank1.ci_low,
                "ci_high": one.rank1.ci_high,
                "n_clusters": one.rank1.n,
                "chance": one.chance,
                "p_rank1": one.p_rank1,
                "n_mated": one.n_mated,
            }
            for name, one in linked.cohorts.items()
        },
    }
    if keep_scores:
        rows |= _raw_scores(linked.searches)
        about["gallery"] = [
            [sessions.source[one] for one in people] for people in linked.gallery_person
        ]
    found = scored.estimates
    tables = {
        ROWS: pa.table(rows),
        ESTIMATES: pa.table(
            {
                "metric": [*found],
                **{
                    name: np.array([getattr(one, name) for one in found.values()], dtype=np.float64)
                    for name in ("value", "ci_low", "ci_high")
                },
                "n": np.array([one.n for one in found.values()], dtype=np.int64),
            }
        ),
        ABOUT: pa.table({"about": [json.dumps(about, default=_plain)]}),
    }
    if not linked.is_control:
        score_metrics = [
            name for name in found if name not in DERIVED and name not in probes.values()
        ]
        tables[REPLICATES] = pa.table(
            {name: found[name].replicates.astype(np.float32) for name in score_metrics}
        )
    return tables


def _own_and_best(search: Search) -> tuple[Floats, Floats]:
    """Return the score of each probe's mate and the best of the others, (P,) each; NaN: none."""
    has = np.flatnonzero(search.mate >= 0)
    own = np.full(search.mate.size, np.nan)
    own[has] = search.scores[has, search.mate[has]]
    others = search.scores.copy()
    others[has, search.mate[has]] = -np.inf
    best = others.max(axis=1)
    return own, np.where(np.isfinite(best), best, np.nan)


def _raw_scores(searches: tuple[Search, ...]) -> dict[str, Any]:
    sizes = np.concatenate([np.full(len(one.mate), one.scores.shape[1]) for one in searches])
    scores = np.concatenate([one.scores.ravel() for one in searches]).astype(np.float32)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    return {
        "mate": np.concatenate([one.mate for one in searches]).astype(np.int32),
        "scores": pa.ListArray.from_arrays(pa.array(offsets, type=pa.int32()), pa.array(scores)),
    }


def _plain(value: object) -> Any:  # noqa: ANN401 - numpy's numbers as Python's
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not JSON")
