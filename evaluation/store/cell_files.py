"""The cells of a run folder: a parquet file for each unit of work.

A file holds the tables of several consumers, one below the other; a column that a table
does not have is null there. Its metadata say which consumer's tables begin where, and
by which code they were computed. A consumer that is added later has a further file:
none is rewritten.
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
from evaluation.compute.tables import column as column_of
from evaluation.store.files import (
    FOLDER,
    GALLERY,
    checked,
    content_of,
    label_of,
    write_whole,
    written_down,
)
from evaluation.store.people import label_of_written
from isac_track.errors import DataError, check_limits
from isac_track.intervals import Estimate, effective_clusters
from isac_track.linkability.scoring import RANK_METRICS, ProbeRanks
from isac_track.types import Floats, Ints

if TYPE_CHECKING:
    import pandas as pd

_INDEX: Final = b"isac_track.cells"
_SCORES: Final = "scores"
_NAMES: Final = ("source", "group", "search", "side", "assigned", "metric", "about")
_NAMED, _COUNTED = (
    ("metric", "group", "assigned"),
    ("above", "tied", "chance", *COMPANIONS),
)
_OUTCOME: Final = (*_NAMED, *_COUNTED, "about", "value", "ci_low", "ci_high", "n")
"""Columns of a linkage cell beside its replicates."""
_PEOPLE: Final = ("source", "group")
_AS_THEY_ARE: Final[Mapping[str, str]] = MappingProxyType({})
_NONE: Final = np.zeros(0, dtype=np.float32)
_ALIKE: Final = {
    "plr",
    "plr_wide",
    "plr_gap",
    "plr_attacked",
    "separation_m",
    "speed_mps",
    "tpr_at_fpr_1pct",
    "chance",
}
"""Numbers that occur again and again, in other rows or for other consumers: whole they compress."""
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
"""What is told of one track or window: seven digits of it are kept, a sixth of a run's disk."""


class Held(NamedTuple):
    """What one consumer has in a file: its key, the code of its plug-ins, and its tables."""

    key: str
    code: Mapping[str, str]  # Digest by module.
    tables: Mapping[str, tuple[int, int]]  # First row and number of rows.


class Index(NamedTuple):
    """What a file of cells holds: key and code of the unit of work, and consumers by label."""

    unit: str
    code: Mapping[str, str]
    consumers: Mapping[str, Held]


class Summed(NamedTuple):
    """A metric that is a ratio of sums over people."""

    sums: Floats  # (2, U) numerator and denominator within each cluster that has any
    weights: Floats  # (B, C) how often each cluster is drawn
    used: Ints | slice = slice(None)  # (U,) which of these it is
    names: tuple[
        str, ...
    ] = ()  # (C,) of the clusters; empty: they are called by their numbers

    @property
    def clusters(self) -> tuple[str, ...]:
        """Names of all clusters, (C,)."""
        return self.names or tuple(map(str, range(self.weights.shape[1])))

    def whole(self) -> Floats:
        """Return the sums of all clusters, (2, C)."""
        whole = np.zeros((2, self.weights.shape[1]))
        whole[:, self.used] = self.sums
        return whole


@dataclass(frozen=True, eq=False, slots=True)
class LinkageOutcome:
    """What a linkage attack, or a control, achieves at one level."""

    estimates: Mapping[str, Estimate]  # By metric.
    numbers: Mapping[
        str, Any
    ]  # The rest of the `isac_track.linkability.Scorecard`, by its names.
    cohorts: Mapping[str, Mapping[str, Any]]
    """Without confounders: rank1, ci_low, ci_high, chance, p_rank1, n_mated, n_clusters."""
    sums: Mapping[str, Summed] = field(
        default_factory=dict
    )  # Of an attack's rank metrics.


def packed(
    found: Sequence[tuple[str, str, Mapping[str, str], Tables]],
    *,
    unit: str,
    code: Mapping[str, str],
    names: Mapping[str, str] = _AS_THEY_ARE,
) -> bytes:
    """Return the file of a unit of work, of key `unit`; found are label, key, code and tables.

    `names` are what people are called in it, by their ids.
    """
    consumers, start = {}, 0
    for label, key, own, tables in found:
        places = {}
        for name, table in tables.items():
            places[name] = (start, table.num_rows)
            start += table.num_rows
        consumers[label] = {"key": key, "code": dict(own), "tables": places}
    every = [renamed(table, names) for *_, tables in found for table in tables.values()]
    whole = pa.concat_tables(every, promote_options="default").combine_chunks()
    whole = _of_precision(whole, pa.float32())
    index = {"unit": unit, "code": dict(code), "consumers": consumers}
    # The leading bytes of like numbers are alike: apart from the others they compress.
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
            [*(floats - _ALIKE), *elements], "BYTE_STREAM_SPLIT"
        ),
    ) as writer:
        writer.write_table(whole)
        writer.add_key_value_metadata({_INDEX: json.dumps(index).encode()})
    return bytes(sink.getvalue())


def renamed(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """Return a table in which people are called by other names, by their ids; without any as is."""
    if not names:
        return table
    for place, name in enumerate(table.column_names):
        if name in _PEOPLE:
            coded = table[name].combine_chunks().dictionary_encode()
            called = column_of([names[one] for one in coded.dictionary.to_pylist()])
            table = table.set_column(place, name, called.take(coded.indices))
        elif name == ABOUT:
            called = [_renamed_about(one, names) for one in table[name].to_pylist()]
            table = table.set_column(place, name, column_of(called))
    return table


def _renamed_about(text: str, names: Mapping[str, str]) -> str:
    about = json.loads(text)
    about["clusters"] = [names[one] for one in about["clusters"]]
    if "gallery" in about:
        about["gallery"] = [[names[one] for one in some] for some in about["gallery"]]
    return json.dumps(about)


def _labelled(table: pa.Table, labels: Mapping[str, str]) -> pa.Table:
    """Return a table that was read, with people called by the labels of their names."""
    for place, name in enumerate(table.column_names):
        if labels and name in _PEOPLE:
            whole = table[name].combine_chunks()
            # None stands for tables of the file that are not about people.
            known = whole.dictionary.to_pylist()
            called = column_of([labels.get(one, one) for one in known])
            coded = pa.DictionaryArray.from_arrays(whole.indices, called)
            table = table.set_column(place, name, coded)
    return table


def _of_precision(whole: pa.Table, kind: pa.DataType) -> pa.Table:
    """Return a table with the columns of `_SINGLE` as numbers of another kind."""
    changed = (
        one.with_type(kind) if one.name in _SINGLE else one for one in whole.schema
    )
    return whole.cast(pa.schema(changed))


def index_of(content: bytes | Path) -> Index | None:
    """Return what a file of cells holds, given its content or where it is; None if it is none."""
    source = (
        pa.BufferReader(content) if isinstance(content, bytes) else content.absolute()
    )
    try:
        return _index(pq.read_metadata(source).metadata)
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError):
        return None


def _index(metadata: Mapping[bytes, bytes]) -> Index:
    told = json.loads(metadata[_INDEX])
    consumers = {label: Held(**held) for label, held in told["consumers"].items()}
    return Index(unit=told["unit"], code=told["code"], consumers=consumers)


def sound_files(
    out: Path, names: Sequence[str] = ()
) -> tuple[dict[str, Index], list[str]]:
    """Return what the sound files of `names` and of the checksums hold, and which ones are not."""
    sound, damaged = {}, []
    for name, content in checked(out, sorted({*names, *written_down(out)})):
        if content is None:
            damaged.append(name)
        elif (index := index_of(content)) is not None:
            sound[name] = index
    return sound, damaged


def places_of(files: Mapping[str, Index]) -> dict[tuple[str, str], str]:
    """Return the file of every cell, by the keys of its unit and of its consumer."""
    return {
        (of.unit, one.key): name
        for name, of in files.items()
        for one in of.consumers.values()
    }


def read_rows(
    out: Path,
    entry: Mapping[str, Any],
    *,
    columns: Sequence[str],
    beside: Collection[str] = (),
) -> pa.Table:
    """Return the rows of one consumer at one level, an entry of a manifest: block by block.

    Columns `beside` are read, too, for whoever is asked for next in the same files:
    once for all. Raises DataError if a cell is missing or broken, or has no such
    column; the message names it.
    """
    found = []
    for path, whole, index in _opened(out, entry, {*columns, *beside}):
        rows = whole.slice(*_held(path, index, entry).tables[ROWS])
        for column in columns:
            is_there = column in rows.column_names
            if not is_there or rows[column].null_count == max(rows.num_rows, 1):
                raise DataError(
                    f"{path} has no column {column}: it is no cell of the kind that the"
                    " manifest says; run the matrix again with --fresh"
                )
        found.append(rows.select(list(columns)))
    return pa.concat_tables(found).unify_dictionaries()


def read_outcomes(
    out: Path,
    entries: Iterable[Mapping[str, Any]],
    *,
    drawn: Collection[str] | None = None,
) -> list[LinkageOutcome]:
    """Return what linkage attacks, or controls, achieve, each at one level.

    Those of one file are read at once if they come one after the other. Replicates are
    in single precision: those of a run would take half a gigabyte in double. Only
    metrics in `drawn` have them, and of attacks alone; without it all have that can.
    DataError names a cell that is broken.
    """
    columns = None if drawn is None else (*_OUTCOME, *drawn)
    found: list[LinkageOutcome] = []
    for _, of in groupby(entries, key=itemgetter("files")):
        mine = list(of)
        ((path, whole, index),) = _opened(out, mine[0], columns)
        with _readable(path):
            asked = [(one, _held(path, index, one).tables) for one in mine]
            labels = label_of_written(out)
            found += _outcomes(whole, asked, drawn, labels)
    _weights.cache_clear()  # the next run has others
    return found


def _outcomes(
    whole: pa.Table,
    entries: Sequence[tuple[Mapping[str, Any], Mapping[str, tuple[int, int]]]],
    drawn: Collection[str] | None,
    labels: Mapping[str, str],
) -> Iterator[LinkageOutcome]:
    """Yield what consumers of a file, each with its tables, achieve."""
    (codes, metrics), groups, assigned = map(_coded, map(whole.column, _NAMED))
    above, tied, chance, *along = (whole[name].to_numpy() for name in _COUNTED)
    fields = [whole[name].to_numpy() for name in ("value", "ci_low", "ci_high", "n")]
    is_mate = np.array(
        [ASSIGNED.index(name) - 1 for name in assigned[1]], dtype=np.int64
    )
    stored = [name for name in whole.column_names if name not in _OUTCOME]
    stored = [name for name in stored if drawn is None or name in drawn]
    wanted, texts = (
        {*(RANK_METRICS if drawn is None else drawn)} - {*DERIVED},
        whole["about"],
    )
    found: list[tuple[Any, slice, dict[str, Any], dict[str, Summed]]] = []
    probed: list[Ints] = []
    alike: defaultdict[tuple[Any, ...], list[int]] = defaultdict(list)
    for entry, tables in entries:
        at = {name: slice(first, first + n) for name, (first, n) in tables.items()}
        about = json.loads(texts[at[ABOUT].start].as_py())
        of = {
            name: whole[name].slice(*tables[REPLICATES])
            for name in stored
            if REPLICATES in at
        }
        replicates = {
            name: one.to_numpy() for name, one in of.items() if one.null_count == 0
        }
        if drawn is None or (drawn and (entry["knowledge"] or entry.get("world"))):
            task = entry["consumer"].partition("/")[0]
            drawn_as = tuple(about["drawn_as"]), about["n_groups"], task, about["seed"]
            called = tuple(labels.get(one, one) for one in about["clusters"])
            alike[called, drawn_as].append(len(found))
        found.append((about, at[ESTIMATES], replicates, {}))
        probed.append(np.arange(at[ROWS].start, at[ROWS].stop))
    for (names, drawn_as), of_draws in alike.items():  # as one, people after people
        weights, n_cells = _weights(*drawn_as), len(of_draws)
        n_clusters = weights.shape[1]
        rows = np.concatenate([probed[place] for place in of_draws])
        place_of = {name: place for place, name in enumerate(names)}
        place = np.array(
            [place_of.get(name, -n_clusters * n_cells) for name in groups[1]]
        )
        first = (
            np.repeat(np.arange(n_cells), [probed[one].size for one in of_draws])
            * n_clusters
        )
        probes = ProbeRanks(
            above=above[rows].astype(np.int64),
            tied=tied[rows].astype(np.int64),
            chance=chance[rows],
            companions=np.stack([one[rows].astype(np.int64) for one in along], axis=1),
            assigned=is_mate[assigned[0][rows]],
            cluster=place[groups[0][rows]] + first,
            n_gallery=max(
                found[one][0]["numbers"]["gallery_sizes"][1] for one in of_draws
            ),
        )
        codes_of = (assigned[0][probed[one][0]] for one in of_draws)
        unknown = [assigned[1][code] == "unknown" for code in codes_of]
        for metric, both in probes.sums(n_cells * n_clusters, wanted).items():
            over, under = (one.reshape(n_cells, n_clusters) for one in both)
            if metric in {"rank1_assigned", "false_link_rate"}:
                over[unknown] = np.nan
            with np.errstate(invalid="ignore"):  # nobody was drawn: NaN
                ratios = (over @ weights.T / (under @ weights.T)).astype(np.float32)
            for one, *sums, ratio in zip(of_draws, over, under, ratios, strict=True):
                _, _, replicates, summed = found[one]
                replicates[metric], summed[metric] = (
                    ratio,
                    Summed(np.stack(sums), weights, names=names),
                )
    for about, mine, replicates, summed in found:
        effective = {
            name: effective_clusters(one.sums[1]) for name, one in summed.items()
        }
        names = [metrics[code] for code in codes[mine]]
        numbers = zip(*(one[mine].tolist() for one in fields), strict=True)
        estimates = {
            name: Estimate(
                value,
                low,
                high,
                int(n),
                replicates.get(name, _NONE),
                effective=effective.get(name, np.nan),
            )
            for name, (value, low, high, n) in zip(names, numbers, strict=True)
        }
        yield LinkageOutcome(estimates, about["numbers"], about["cohorts"], summed)


def _coded(column: pa.ChunkedArray) -> tuple[Ints, list[str]]:
    """Return the code of each name of a column, -1 where there is none, and the names by code."""
    whole = column.combine_chunks()
    return whole.indices.fill_null(-1).to_numpy(), whole.dictionary.to_pylist()


@lru_cache(maxsize=16)  # of every task there are hundreds of cells
def _weights(drawn_as: tuple[int, ...], n_groups: int, task: str, seed: int) -> Floats:
    places: Ints = np.array(drawn_as)
    return linkage_weights(places, n_groups=n_groups, task=task, seed=seed)


def _held(path: Path, index: Index, entry: Mapping[str, Any]) -> Held:
    label = label_of(entry)
    if label not in index.consumers:
        raise DataError(
            f"{path} has no rows of {label}; delete it and run the matrix again"
        )
    return index.consumers[label]


def _opened(
    out: Path, entry: Mapping[str, Any], columns: Collection[str] | None
) -> list[tuple[Path, pa.Table, Index]]:
    """Return the content of the files of a cell: some columns, or all but raw scores."""
    stamped = []
    for name in entry["files"]:
        path = out / FOLDER / name
        with _readable(path):
            stat = path.stat()
        stamped.append((path, stat.st_mtime_ns, stat.st_size))
    return _content(tuple(stamped), None if columns is None else frozenset(columns))


@lru_cache(
    maxsize=1
)  # files are read once for all of their consumers, who come one after another
def _content(
    stamped: tuple[tuple[Path, int, int], ...], columns: frozenset[str] | None
) -> list[tuple[Path, pa.Table, Index]]:
    """Return the content of some files, which is as old and as large as `stamped` says."""
    found = []
    for path, *_ in stamped:
        with _readable(path):
            about = pq.read_metadata(path.absolute())
            every = about.schema.to_arrow_schema().names
            names = [
                name for name in every if name in (columns or {*every} - {_SCORES})
            ]
            coded = [name for name in names if name in _NAMES]
            # Not pq.read_table: its data set machinery costs more than reading such a
            # file.
            with pq.ParquetFile(
                path.absolute(), metadata=about, read_dictionary=coded
            ) as file:
                whole = _of_precision(
                    file.read(columns=names, use_threads=False), pa.float64()
                )
            labels = label_of_written(path.parent.parent)
            found.append((path, _labelled(whole, labels), _index(about.metadata)))
    return found


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
    """Keep sample tracks in a run folder; without parts there are none, nor earlier ones."""
    if not parts:
        (out / GALLERY).unlink(missing_ok=True)
        return
    sink = pa.BufferOutputStream()
    pq.write_table(pa.concat_tables(parts), sink, compression="zstd")
    write_whole(out / GALLERY, sink.getvalue().to_pybytes())


def read_gallery(out: Path) -> pd.DataFrame | None:
    """Return the sample tracks of a run folder, None without any; DataError if they are broken."""
    path = out / GALLERY
    if not path.exists():
        return None
    with _readable(path):
        # Not pq.read_table: a system that has no more threads to give would end the
        # process.
        file = pq.ParquetFile(io.BytesIO(content_of(path)))
        # A column that is missing is not an error of `read`.
        table = file.read(use_threads=False).select(SAMPLE_COLUMNS)
        found: pd.DataFrame = table.to_pandas(use_threads=False)
        return found
