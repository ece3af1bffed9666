"""The cells of a run folder: a parquet file for each unit of work.

A file holds the tables of several consumers, one below the other; a column that a table
does not have is null there. Its metadata say where each consumer's tables begin, and
which code computed them. A consumer that is added later has a further file: no file is
rewritten.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.compute.link_scores import (
    ABOUT,
    ASSIGNED,
    COMPANIONS,
    DERIVED,
    ESTIMATES,
    REPLICATES,
)
from evaluation.compute.link_setup import linkage_weights
from evaluation.compute.sample_tracks import COLUMNS as SAMPLE_COLUMNS
from evaluation.compute.tables import DESCRIPTORS, ON_TRIAL, ROWS, Tables
from evaluation.compute.tables import column as make_column
from evaluation.store.files import (
    FOLDER,
    GALLERY,
    checked_files,
    checksummed_files,
    entry_label,
    read_regular_file,
    write_whole,
)
from evaluation.store.people import read_labels
from isac_track.errors import DataError, check_limits
from isac_track.intervals import Estimate, effective_clusters
from isac_track.linkability.scoring import RANK_METRICS, ProbeRanks
from isac_track.types import Floats, Ints

if TYPE_CHECKING:
    import pandas as pd

_INDEX: Final = b"isac_track.cells"
_SCORES: Final = "scores"
_NAMES: Final = ("source", "group", "search", "side", "assigned", "metric", "about")
_NAMED = ("metric", "group", "assigned")
_COUNTED = ("above", "tied", "chance", *COMPANIONS)
_OUTCOME: Final = (*_NAMED, *_COUNTED, "about", "value", "ci_low", "ci_high", "n")
"""Columns of a linkage cell beside its replicates."""
_PEOPLE: Final = ("source", "group")
_AS_THEY_ARE: Final[Mapping[str, str]] = MappingProxyType({})
_NONE: Final[Floats] = np.zeros(0, dtype=np.float32)
_REPEATED: Final = {
    "plr",
    "plr_wide",
    "plr_gap",
    "plr_attacked",
    "separation_m",
    "speed_mps",
    "tpr_at_fpr_1pct",
    "chance",
}
"""Numbers that recur in other rows or for other consumers: unsplit they compress."""
_SINGLE: Final = {
    *DESCRIPTORS,
    *ON_TRIAL,
    "mse_m2",
    "benchmark_mse_m2",
    "benchmark_plr",
    "plr_ceiling",
    "plr_optimum",
    "plr_gap",
    "plr_wide",
    "median_error_m",
    "duration_s",
    "speed_mps",
    "sigma_m",
}
"""Columns of a track or window in single precision: saves a sixth of a run's disk."""


class ConsumerTables(NamedTuple):
    """The tables of a consumer in a file: its key, its plug-ins' code, their rows."""

    key: str
    code: Mapping[str, str]  # Digest by module.
    tables: Mapping[str, tuple[int, int]]  # First row and number of rows, by table.


class FileIndex(NamedTuple):
    """The content of a file: key and code of the unit of work, consumers by label."""

    unit: str
    code: Mapping[str, str]
    consumers: Mapping[str, ConsumerTables]


@dataclass(frozen=True, eq=False, slots=True)
class _CellFile:
    """A file of cells that was read."""

    path: Path
    table: pa.Table
    index: FileIndex


class ClusterSums(NamedTuple):
    """A metric that is a ratio of sums over people, by cluster."""

    sums: Floats  # (2, U) numerator and denominator within each cluster that has any.
    weights: Floats  # (B, C) how often each cluster is drawn.
    used: Ints | slice = slice(None)  # (U,) places among the C clusters.
    # (C,) names of the clusters; empty: their names are their numbers.
    names: tuple[str, ...] = ()

    @property
    def clusters(self) -> tuple[str, ...]:
        """Names of all clusters, (C,)."""
        return self.names or tuple(map(str, range(self.weights.shape[1])))

    def whole(self) -> Floats:
        """Return the sums of all clusters, (2, C)."""
        sums = np.zeros((2, self.weights.shape[1]))
        sums[:, self.used] = self.sums
        return sums


@dataclass(frozen=True, eq=False, slots=True)
class LinkageOutcome:
    """Estimates of a linkage attack, or of a control, at one level."""

    estimates: Mapping[str, Estimate]  # By metric.
    # All other numbers of the `isac_track.linkability.Scorecard`, by its names.
    numbers: Mapping[str, Any]
    cohorts: Mapping[str, Mapping[str, Any]]
    """Without confounders, by name: rank1, ci_low, ci_high, chance, p_rank1, n_mated,
    n_clusters."""
    sums: Mapping[str, ClusterSums] = field(default_factory=dict)
    """Of an attack's rank metrics, by metric."""


def pack_cells(
    cells: Sequence[tuple[str, str, Mapping[str, str], Tables]],
    *,
    unit: str,
    code: Mapping[str, str],
    names: Mapping[str, str] = _AS_THEY_ARE,
) -> bytes:
    """Return the file of a unit of work, of key `unit`.

    Each of `cells` has a consumer's label, key, code and tables. `names` are the names
    of people in the file, by their ids.
    """
    consumers, start = {}, 0
    for label, key, own_code, tables in cells:
        places = {}
        for name, table in tables.items():
            places[name] = (start, table.num_rows)
            start += table.num_rows
        consumers[label] = {"key": key, "code": dict(own_code), "tables": places}
    parts = [
        rename_people(table, names) for *_, tables in cells for table in tables.values()
    ]
    whole = pa.concat_tables(parts, promote_options="default").combine_chunks()
    whole = _with_precision(whole, pa.float32())
    index = {"unit": unit, "code": dict(code), "consumers": consumers}
    # The leading bytes of similar numbers are equal: split off, they compress.
    floats = {field.name for field in whole.schema if pa.types.is_floating(field.type)}
    elements = ["scores.list.element"] if _SCORES in whole.column_names else []
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(
        sink,
        whole.schema,
        write_statistics=False,
        compression="zstd",
        compression_level=9,
        store_schema=False,
        use_dictionary=[
            name for name in whole.column_names if name not in floats | {_SCORES}
        ],
        column_encoding=dict.fromkeys(
            [*(floats - _REPEATED), *elements], "BYTE_STREAM_SPLIT"
        ),
    ) as writer:
        writer.write_table(whole)
        writer.add_key_value_metadata({_INDEX: json.dumps(index).encode()})
    return bytes(sink.getvalue())


def rename_people(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """Return a table with other names of people, by their ids; without names, as is."""
    if not names:
        return table
    for place, column in enumerate(table.column_names):
        if column in _PEOPLE:
            coded = table[column].combine_chunks().dictionary_encode()
            new_names = make_column(
                [names[person] for person in coded.dictionary.to_pylist()]
            )
            table = table.set_column(place, column, new_names.take(coded.indices))
        elif column == ABOUT:
            texts = [_rename_about(text, names) for text in table[column].to_pylist()]
            table = table.set_column(place, column, make_column(texts))
    return table


def _rename_about(text: str, names: Mapping[str, str]) -> str:
    about = json.loads(text)
    about["clusters"] = [names[cluster] for cluster in about["clusters"]]
    if "gallery" in about:
        about["gallery"] = [
            [names[person] for person in gallery] for gallery in about["gallery"]
        ]
    return json.dumps(about)


def _with_labels(table: pa.Table, labels: Mapping[str, str]) -> pa.Table:
    """Return a table that was read, with people called by the labels of their names."""
    for place, column in enumerate(table.column_names):
        if labels and column in _PEOPLE:
            coded = table[column].combine_chunks()
            # None stands for tables of the file that are not about people.
            names = coded.dictionary.to_pylist()
            new_names = make_column([labels.get(name, name) for name in names])
            relabelled = pa.DictionaryArray.from_arrays(coded.indices, new_names)
            table = table.set_column(place, column, relabelled)
    return table


def _with_precision(table: pa.Table, kind: pa.DataType) -> pa.Table:
    """Return a table with the columns of `_SINGLE` as numbers of another kind."""
    fields = (
        field.with_type(kind) if field.name in _SINGLE else field
        for field in table.schema
    )
    return table.cast(pa.schema(fields))


def read_index(content: bytes | Path) -> FileIndex | None:
    """Return the index of a file of cells, from its bytes or path; None without one."""
    source = (
        pa.BufferReader(content) if isinstance(content, bytes) else content.absolute()
    )
    try:
        return _index(pq.read_metadata(source).metadata)
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError):
        return None


def _index(metadata: Mapping[bytes, bytes]) -> FileIndex:
    content = json.loads(metadata[_INDEX])
    consumers = {
        label: ConsumerTables(**tables)
        for label, tables in content["consumers"].items()
    }
    return FileIndex(unit=content["unit"], code=content["code"], consumers=consumers)


def sound_files(
    out: Path, names: Sequence[str] = ()
) -> tuple[dict[str, FileIndex], list[str]]:
    """Return the indices of sound files by name, and the names of damaged ones.

    They are looked for among `names` and the checksums.
    """
    sound, damaged = {}, []
    candidates = sorted({*names, *checksummed_files(out)})
    for name, content in checked_files(out, candidates):
        if content is None:
            damaged.append(name)
        elif (index := read_index(content)) is not None:
            sound[name] = index
    return sound, damaged


def cell_places(files: Mapping[str, FileIndex]) -> dict[tuple[str, str], str]:
    """Return the file of every cell, by the keys of its unit and of its consumer."""
    return {
        (index.unit, consumer.key): name
        for name, index in files.items()
        for consumer in index.consumers.values()
    }


def read_rows(
    out: Path,
    entry: Mapping[str, Any],
    *,
    columns: Sequence[str],
    beside: Collection[str] = (),
) -> pa.Table:
    """Return the rows of one consumer at one level, an entry of a manifest, by block.

    Columns `beside` are read, too, for the next call that asks for the same files: one
    read for all. Raises DataError if a cell is missing or broken, or has no such
    column; the message names it.
    """
    parts = []
    for file in _open_files(out, entry, {*columns, *beside}):
        rows = file.table.slice(*_consumer_tables(file, entry).tables[ROWS])
        for column in columns:
            is_present = column in rows.column_names
            if not is_present or rows[column].null_count == max(rows.num_rows, 1):
                raise DataError(
                    f"{file.path} has no column {column}: it is no cell of the kind"
                    " that the manifest says; run the matrix again with --fresh"
                )
        parts.append(rows.select(list(columns)))
    return pa.concat_tables(parts).unify_dictionaries()


def read_outcomes(
    out: Path,
    entries: Iterable[Mapping[str, Any]],
    *,
    drawn: Collection[str] | None = None,
) -> list[LinkageOutcome]:
    """Return the outcomes of linkage attacks, or controls, each at one level.

    Entries of one file are read at once if they come one after the other. Replicates
    are in single precision: those of a run would take half a gigabyte in double. Only
    metrics in `drawn` have them, and of attacks alone; without it all have that can.
    DataError names a cell that is broken.
    """
    columns = None if drawn is None else (*_OUTCOME, *drawn)
    outcomes: list[LinkageOutcome] = []
    for _, group in groupby(entries, key=itemgetter("files")):
        file_entries = list(group)
        (file,) = _open_files(out, file_entries[0], columns)
        with _readable(file.path):
            tables = [_consumer_tables(file, entry).tables for entry in file_entries]
            labels = read_labels(out)
            outcomes += _outcomes(file.table, file_entries, tables, drawn, labels)
    _weights.cache_clear()  # the next run has others
    return outcomes


@dataclass(frozen=True, eq=False, slots=True)
class _StoredOutcome:
    """The part of a file that belongs to one linkage consumer."""

    about: dict[str, Any]
    estimates: slice  # Rows of its estimates.
    probes: Ints  # Rows of its probes.
    replicates: dict[str, Floats]  # By metric.
    sums: dict[str, ClusterSums] = field(default_factory=dict)


class _Coded(NamedTuple):
    """A column of names."""

    codes: Ints  # (rows,) place in `names`, -1 for none.
    names: list[str]


def _outcomes(
    table: pa.Table,
    entries: Sequence[Mapping[str, Any]],
    tables: Sequence[Mapping[str, tuple[int, int]]],
    drawn: Collection[str] | None,
    labels: Mapping[str, str],
) -> Iterator[LinkageOutcome]:
    """Yield the outcomes of consumers of a file; `tables` has the places of each."""
    stored = [
        name
        for name in table.column_names
        if name not in _OUTCOME and (drawn is None or name in drawn)
    ]
    outcomes: list[_StoredOutcome] = []
    by_draws: defaultdict[tuple[Any, ...], list[_StoredOutcome]] = defaultdict(list)
    for entry, places in zip(entries, tables, strict=True):
        outcome = _stored_outcome(table, places, stored)
        about = outcome.about
        if drawn is None or (drawn and (entry["knowledge"] or entry.get("world"))):
            task = entry["consumer"].partition("/")[0]
            drawn_as = tuple(about["drawn_as"]), about["n_groups"], task, about["seed"]
            clusters = tuple(labels.get(name, name) for name in about["clusters"])
            by_draws[clusters, drawn_as].append(outcome)
        outcomes.append(outcome)
    wanted = {*(RANK_METRICS if drawn is None else drawn)} - {*DERIVED}
    for (clusters, drawn_as), same_draws in by_draws.items():
        _add_rank_sums(table, same_draws, clusters, _weights(*drawn_as), wanted)
    metrics = _coded(table.column("metric"))
    fields = [table[name].to_numpy() for name in ("value", "ci_low", "ci_high", "n")]
    for outcome in outcomes:
        yield _linkage_outcome(outcome, metrics, fields)


def _stored_outcome(
    table: pa.Table, places: Mapping[str, tuple[int, int]], stored: Sequence[str]
) -> _StoredOutcome:
    """Return one consumer's part of a file, with the replicates that are stored."""
    rows = {name: slice(first, first + n) for name, (first, n) in places.items()}
    replicates = {}
    for name in stored if REPLICATES in rows else ():
        column = table[name].slice(*places[REPLICATES])
        if column.null_count == 0:
            replicates[name] = column.to_numpy()
    return _StoredOutcome(
        about=json.loads(table["about"][rows[ABOUT].start].as_py()),
        estimates=rows[ESTIMATES],
        probes=np.arange(rows[ROWS].start, rows[ROWS].stop),
        replicates=replicates,
    )


def _add_rank_sums(
    table: pa.Table,
    outcomes: Sequence[_StoredOutcome],
    clusters: tuple[str, ...],
    weights: Floats,
    wanted: set[str],
) -> None:
    """Add sums and replicates of rank metrics to outcomes that share their draws.

    All are summed at once: the clusters of one outcome come after those of another.
    """
    groups, assigned = _coded(table.column("group")), _coded(table.column("assigned"))
    above, tied, chance, *companions = (table[name].to_numpy() for name in _COUNTED)
    is_mate = np.array(
        [ASSIGNED.index(name) - 1 for name in assigned.names], dtype=np.int64
    )
    n_outcomes, n_clusters = len(outcomes), weights.shape[1]
    rows = np.concatenate([outcome.probes for outcome in outcomes])
    place_by_name = {name: place for place, name in enumerate(clusters)}
    place = np.array(
        [place_by_name.get(name, -n_clusters * n_outcomes) for name in groups.names]
    )
    n_probes = [outcome.probes.size for outcome in outcomes]
    first = np.repeat(np.arange(n_outcomes), n_probes) * n_clusters
    probes = ProbeRanks(
        above=above[rows].astype(np.int64),
        tied=tied[rows].astype(np.int64),
        chance=chance[rows],
        companions=np.stack(
            [counts[rows].astype(np.int64) for counts in companions], axis=1
        ),
        assigned=is_mate[assigned.codes[rows]],
        cluster=place[groups.codes[rows]] + first,
        n_gallery=max(
            outcome.about["numbers"]["gallery_sizes"][1] for outcome in outcomes
        ),
    )
    first_codes = (assigned.codes[outcome.probes[0]] for outcome in outcomes)
    is_unknown = [assigned.names[code] == "unknown" for code in first_codes]
    for metric, sums in probes.sums(n_outcomes * n_clusters, wanted).items():
        over, under = (part.reshape(n_outcomes, n_clusters) for part in sums)
        if metric in {"rank1_assigned", "false_link_rate"}:
            over[is_unknown] = np.nan
        with np.errstate(invalid="ignore"):  # NaN where no person was drawn
            ratios = (over @ weights.T / (under @ weights.T)).astype(np.float32)
        for number, outcome in enumerate(outcomes):
            own_sums = np.stack([over[number], under[number]])
            outcome.replicates[metric] = ratios[number]
            outcome.sums[metric] = ClusterSums(own_sums, weights, names=clusters)


def _linkage_outcome(
    outcome: _StoredOutcome, metrics: _Coded, fields: Sequence[Floats]
) -> LinkageOutcome:
    """Return an outcome; `fields` are value, ci_low, ci_high and n of every row."""
    rows = outcome.estimates
    names = [metrics.names[code] for code in metrics.codes[rows]]
    numbers = zip(*(values[rows].tolist() for values in fields), strict=True)
    estimates = {}
    for name, (value, low, high, n) in zip(names, numbers, strict=True):
        effective = np.nan
        if name in outcome.sums:
            effective = effective_clusters(outcome.sums[name].sums[1])
        replicates = outcome.replicates.get(name, _NONE)
        estimates[name] = Estimate(
            value, low, high, int(n), replicates, effective=effective
        )
    about = outcome.about
    return LinkageOutcome(estimates, about["numbers"], about["cohorts"], outcome.sums)


def _coded(column: pa.ChunkedArray) -> _Coded:
    whole = column.combine_chunks()
    codes = whole.indices.fill_null(-1).to_numpy()
    return _Coded(codes, whole.dictionary.to_pylist())


# The weights of a task, shared by its hundreds of cells; `read_outcomes` empties it.
@lru_cache(maxsize=16)
def _weights(drawn_as: tuple[int, ...], n_groups: int, task: str, seed: int) -> Floats:
    places: Ints = np.array(drawn_as)
    return linkage_weights(places, n_groups=n_groups, task=task, seed=seed)


def _consumer_tables(file: _CellFile, entry: Mapping[str, Any]) -> ConsumerTables:
    label = entry_label(entry)
    if label not in file.index.consumers:
        raise DataError(
            f"{file.path} has no rows of {label}; delete it and run the matrix again"
        )
    return file.index.consumers[label]


def _open_files(
    out: Path, entry: Mapping[str, Any], columns: Collection[str] | None
) -> list[_CellFile]:
    """Return the files of a cell: some columns, or all but raw scores."""
    stamped = []
    for name in entry["files"]:
        path = out / FOLDER / name
        with _readable(path):
            stat = path.stat()
        stamped.append((path, stat.st_mtime_ns, stat.st_size))
    return _read_files(tuple(stamped), None if columns is None else frozenset(columns))


# The files of the newest cell: their consumers are read one after another.
@lru_cache(maxsize=1)
def _read_files(
    stamped: tuple[tuple[Path, int, int], ...], columns: frozenset[str] | None
) -> list[_CellFile]:
    """Return files whose ages and sizes are as `stamped` says."""
    files = []
    for path, *_ in stamped:
        with _readable(path):
            metadata = pq.read_metadata(path.absolute())
            present = metadata.schema.to_arrow_schema().names
            wanted = columns or {*present} - {_SCORES}
            names = [name for name in present if name in wanted]
            coded = [name for name in names if name in _NAMES]
            # Not pq.read_table: its data set machinery takes longer than the read.
            with pq.ParquetFile(
                path.absolute(), metadata=metadata, read_dictionary=coded
            ) as file:
                table = file.read(columns=names, use_threads=False)
            table = _with_precision(table, pa.float64())
            labels = read_labels(path.parent.parent)
            index = _index(metadata.metadata)
            files.append(_CellFile(path, _with_labels(table, labels), index))
    return files


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise DataError(
            f"{path} is missing; run the matrix again to compute it"
        ) from None
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        check_limits(error)
        raise DataError(
            f"{path} cannot be read ({error}); delete it and run the matrix again"
        ) from None


def write_gallery(parts: Sequence[pa.Table], *, out: Path) -> None:
    """Write sample tracks into a run folder; without parts remove earlier ones."""
    if not parts:
        (out / GALLERY).unlink(missing_ok=True)
        return
    sink = pa.BufferOutputStream()
    pq.write_table(pa.concat_tables(parts), sink, compression="zstd")
    write_whole(out / GALLERY, sink.getvalue().to_pybytes())


def read_gallery(out: Path) -> pd.DataFrame | None:
    """Return the sample tracks of a run folder, None without any.

    Raises DataError if they are broken.
    """
    path = out / GALLERY
    if not path.exists():
        return None
    with _readable(path):
        # Not pq.read_table: where no further thread can start it ends the process.
        file = pq.ParquetFile(io.BytesIO(read_regular_file(path)))
        # A column that is missing is not an error of `read`.
        table = file.read(use_threads=False).select(SAMPLE_COLUMNS)
        tracks: pd.DataFrame = table.to_pandas(use_threads=False)
        return tracks
