"""The tables of a cell of linkage.

Replicates of rank metrics follow from the probes. Those of score metrics visit every
pair; the cells of attacks store them. Cells of controls do not: each control has its
own permutation test, and no comparison pairs two.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import lru_cache
from typing import Any, Final

import numpy as np
import pyarrow as pa

from evaluation.compute.link_scores import LinkResult
from evaluation.compute.link_setup import SensedTask
from evaluation.compute.tables import ROWS, Tables, column, names_column, table
from isac_track import linkability
from isac_track.linkability.scoring import RANK_METRICS

ESTIMATES: Final = "estimates"
REPLICATES: Final = "replicates"
ABOUT: Final = "about"
DERIVED: Final = ("chance", "residual_risk", "d_sys_corrected")
"""Metrics whose replicates follow from those of others."""
COMPANIONS: Final = ("companions", "companions_above", "companions_tied")
"""Columns of `ProbeRanks.companions`, which are no candidates of `rank1_g100`."""
ASSIGNED: Final = ("nobody", "other", "mate", "mate if any", "unknown")
"""Names of the values of `ProbeRanks.assigned`, from -1 (nobody) to 2 (mate if any).

The last is for scores without a scale.
"""
NAMED_MATES: Final = frozenset({"mate", "mate if any"})
"""The values of `ASSIGNED` that count as hits."""
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
    result: LinkResult, setup: SensedTask, *, keep_scores: bool
) -> Tables:
    """Return the tables of a linkage attack or control at one level.

    - `rows`, one per probe: `search` (a half, or the instant of a handover), `source`,
      `group`; `above` and `tied`, the numbers of candidates that score above its mate
      and as high, the mate included (-1 and 0 without a mate); `chance` of rank 1,
      `assigned` (`ASSIGNED`); with the raw scores also `mate` (place in the gallery, or
      -1) and `scores` against the whole gallery; `COMPANIONS`;
    - `estimates`, one per metric: `metric`, `value`, `ci_low`, `ci_high`, `n`;
    - `replicates`, one per bootstrap draw: a column for each score metric, in single
      precision;
    - `about`: one row with all other numbers as JSON.
    """
    scorecard, probes = result.scorecard, result.scorecard.probes
    assigned = np.full_like(probes.assigned, len(ASSIGNED) - 1)
    if result.is_assigned:
        assigned = probes.assigned + 1
    rows = {
        **_probe_names(setup),
        "above": probes.above.astype(np.int32),
        "tied": probes.tied.astype(np.int32),
        "chance": probes.chance,
        "assigned": names_column(assigned, ASSIGNED),
    }
    companions = probes.companions.astype(np.int32).T
    rows.update(zip(COMPANIONS, companions, strict=True))
    about = _about_result(result)
    if keep_scores:
        rows |= _score_columns(result.searches)
        about["gallery"] = _gallery_sources(setup)
    estimates = scorecard.estimates
    columns = {"metric": [*estimates]} | {
        field: np.array([getattr(estimate, field) for estimate in estimates.values()])
        for field in ("value", "ci_low", "ci_high", "n")
    }
    tables = {
        ROWS: table(rows),
        ESTIMATES: table(columns),
        ABOUT: table({"about": [_about_task(setup) + _json(about)[1:]]}),
    }
    if result.cohorts:  # no comparison pairs two controls
        stored = estimates.keys() - {*DERIVED, *RANK_METRICS}
        tables[REPLICATES] = table(
            {
                name: estimate.replicates.astype(np.float32)
                for name, estimate in estimates.items()
                if name in stored
            }
        )
    return tables


def _about_result(result: LinkResult) -> dict[str, Any]:
    """Return the numbers of a result that are stored as JSON."""
    numbers = {name: getattr(result.scorecard, name) for name in _NUMBERS}
    if result.losses is not None:
        numbers["n_checked"] = result.losses.size
        numbers["rank1_loss"] = None
        if result.losses.size:
            numbers["rank1_loss"] = float(result.losses.mean())
    return {
        "calibration": {
            fold: asdict(calibration)
            for fold, calibration in result.calibration.items()
        },
        "numbers": numbers,
        "cohorts": result.cohorts,
    }


def _score_columns(searches: Sequence[linkability.Search]) -> dict[str, Any]:
    """Return the columns of raw scores: each probe's mate, and its scores."""
    flat = np.concatenate([search.scores.ravel() for search in searches])
    sizes = [row.size for search in searches for row in search.scores]
    starts = np.cumsum([0, *sizes], dtype=np.int32)
    return {
        "mate": np.concatenate([search.mate for search in searches]).astype(np.int32),
        "scores": pa.ListArray.from_arrays(
            column(starts), column(flat.astype(np.float32))
        ),
    }


def _gallery_sources(setup: SensedTask) -> list[list[str]]:
    """Return the people of the gallery of every search, by the number of the search."""
    task_windows = setup.task_windows
    return [
        [
            task_windows.source[person]
            for person in task_windows.gallery.person[pairing.gallery]
        ]
        for _, pairing in sorted(setup.searches.items())
    ]


# Of the newest four tasks of this process.
@lru_cache(maxsize=4)
def _probe_names(setup: SensedTask) -> dict[str, pa.Array]:
    """Return the columns that name the probes: those of every cell of a task."""
    task_windows = setup.task_windows
    probe = np.concatenate(
        [pairing.probe for _, pairing in sorted(setup.searches.items())]
    )
    person = task_windows.probe.person[probe]
    return {
        "search": names_column(
            task_windows.probe.search[probe], task_windows.search_names
        ),
        "source": names_column(person, task_windows.source),
        "group": names_column(person, task_windows.group),
    }


# Of the newest four tasks of this process.
@lru_cache(maxsize=4)
def _about_task(setup: SensedTask) -> str:
    """Return the beginning of the JSON about every cell of a task."""
    about = {
        "clusters": sorted(set(setup.task_windows.group)),
        "drawn_as": setup.drawn_as.tolist(),
        "n_groups": setup.n_groups,
        "seed": setup.seed,
    }
    return f"{_json(about)[:-1]}, "


def _json(about: dict[str, Any]) -> str:
    return json.dumps(about, default=lambda number: number.item())
