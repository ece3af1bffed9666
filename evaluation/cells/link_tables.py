"""A linkage cell as a file: raw scores by probe, and beside them all that is read off them.

The scorecard takes a bootstrap and a permutation test; it belongs to the cell, so that a report
is drawn without computing either again. It lies in the metadata of the parquet file, as JSON.
"""

from __future__ import annotations

import base64
import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.cells.columns import names_column

if TYPE_CHECKING:
    from attacks.tasks.sessions import Sessions
    from evaluation.cells.link_scores import Linked
    from isac_track.intervals import Estimate

METADATA = b"isac_track.linkage"
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
_DERIVED = ("chance", "residual_risk", "d_sys_corrected")
"""Metrics whose replicates follow from those of others: they are not kept."""


def to_parquet(linked: Linked, sessions: Sessions) -> bytes:
    """Return a cell's file: a row for each probe, with its scores against the whole gallery.

    Columns: `search` (a half, or the instant of a handover), `fold`, `source`, `group`, `mate`
    (place in the gallery, or -1) and `scores`. The metadata say who the gallery is.
    """
    rows = [len(search.mate) for search in linked.searches]
    persons = np.concatenate(linked.probe_person)
    sizes = np.repeat([search.scores.shape[1] for search in linked.searches], rows)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    scores = np.concatenate([search.scores.ravel() for search in linked.searches])
    table = pa.table(
        {
            "search": names_column(np.repeat(np.arange(len(rows)), rows), sessions.searches),
            "fold": np.repeat([search.scale for search in linked.searches], rows).astype(np.int8),
            "source": names_column(persons, sessions.source),
            "group": names_column(persons, sessions.group),
            "mate": np.concatenate([search.mate for search in linked.searches]).astype(np.int32),
            "scores": pa.ListArray.from_arrays(
                pa.array(offsets, type=pa.int32()), pa.array(scores.astype(np.float32))
            ),
        }
    )
    about = {
        "gallery": [[sessions.source[one] for one in people] for people in linked.gallery_person],
        "calibration": {fold: asdict(one) for fold, one in linked.calibration.items()},
        "numbers": {name: getattr(linked.card, name) for name in _NUMBERS},
        "estimates": {name: _packed(one, name=name) for name, one in linked.card.estimates.items()},
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
            for name, one in linked.parts.items()
        },
    }
    sink = pa.BufferOutputStream()
    # The leading bytes of like numbers are alike: apart from the others they compress. The schema
    # would hold the metadata once more.
    with pq.ParquetWriter(
        sink,
        table.schema,
        write_statistics=False,
        compression="zstd",
        compression_level=1,
        store_schema=False,
        use_dictionary=["search", "source", "group"],
        column_encoding={"scores.list.element": "BYTE_STREAM_SPLIT"},
    ) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({METADATA: json.dumps(about, default=_plain).encode()})
    content: bytes = sink.getvalue().to_pybytes()
    return content


def _packed(estimate: Estimate, *, name: str) -> dict[str, Any]:
    kept = np.zeros(0) if name in _DERIVED else estimate.replicates
    replicates = np.asarray(kept, dtype="<f4").tobytes()
    return {
        "value": estimate.value,
        "ci_low": estimate.ci_low,
        "ci_high": estimate.ci_high,
        "n": estimate.n,
        "replicates": base64.b64encode(replicates).decode(),
    }


def _plain(value: object) -> Any:  # noqa: ANN401 - numpy's numbers as Python's
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not JSON")
