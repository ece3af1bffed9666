"""The cells of a run folder: one parquet file each, and the checksums of all.

A cell counts as finished when its checksum is written down, in the format of `sha256sum`. What was
cut short, garbled or put there by somebody else does not match, and is computed again.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from evaluation.runs.files import write_whole
from evaluation.cells.columns import names_column
from evaluation.cells.link_file import METADATA
from evaluation.cells.windows import COLUMNS as WINDOW_COLUMNS
from isac_track.errors import DataError
from isac_track.intervals import Estimate

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from evaluation.cells.reconstruction import Rows
    from isac_track.scenes import Cut
    from isac_track.types import Ints

FOLDER: Final = "cells"
CHECKSUMS: Final = "SHA256SUMS"


@dataclass(frozen=True, eq=False, slots=True)
class LinkageOutcome:
    """What a linkage attack, or a control, achieves at one level."""

    estimates: Mapping[str, Estimate]
    """By metric."""
    numbers: Mapping[str, Any]
    """The rest of the `isac_track.linkability.Scorecard`, by its names."""
    cohorts: Mapping[str, Mapping[str, Any]]
    """Without confounders: rank1, ci_low, ci_high, chance, p_rank1, n_mated, n_clusters."""


def write_cell(out: Path, name: str, rows: Rows | bytes, *, tracks: Cut) -> None:
    """Write the rows of a cell, with the source and group of each row's track.

    Parameters
    ----------
    out : Path
        Folder of the run.
    name : str
        Of the file.
    rows : mapping or bytes
        Columns, of which `track` is the row in `tracks`; or the file's content.
    tracks : Cut
    """
    content = rows if isinstance(rows, bytes) else _to_parquet(rows, tracks=tracks)
    # First: a kill in between leaves a line without a cell, not a cell that looks damaged.
    _write_down(out, name, hashlib.sha256(content).hexdigest())
    write_whole(out / FOLDER / name, content)


def sound_cells(out: Path, names: Iterable[str]) -> tuple[set[str], list[str]]:
    """Return the cells that are as they were written, and those that are not.

    Parameters
    ----------
    out : Path
        Folder of the run.
    names : iterable of str
        Files to look at; those that are not there are in neither.
    """
    known = _checksums(out)
    sound, damaged = set(), []
    for name in dict.fromkeys(names):
        try:
            content = (out / FOLDER / name).read_bytes()
        except FileNotFoundError:
            continue
        except OSError:
            damaged.append(name)
            continue
        if hashlib.sha256(content).hexdigest() == known.get(name):
            sound.add(name)
        else:
            damaged.append(name)
    return sound, damaged


def adopt(out: Path, names: Iterable[str], *, sources: Iterable[Path]) -> None:
    """Take over the cells that the folders of other runs have, from the first that is sound."""
    missing = dict.fromkeys(names)
    for source in sources:
        known = _checksums(source)
        for name in [name for name in missing if name in known]:
            try:
                content = (source / FOLDER / name).read_bytes()
            except OSError:  # it is computed anew
                continue
            if hashlib.sha256(content).hexdigest() == known[name]:
                write_whole(out / FOLDER / name, content)
                _write_down(out, name, known[name])
                del missing[name]


def check_sound(out: Path, names: Iterable[str]) -> None:
    """Raise DataError if a cell is not as it was written, or there is none at all."""
    wanted = list(names)
    if not wanted:
        raise DataError(f"{out} holds no finished cell; run the matrix again")
    _, damaged = sound_cells(out, wanted)
    if damaged:
        more = f" and {len(damaged) - 1} more" if len(damaged) > 1 else ""
        raise DataError(
            f"{out / FOLDER / damaged[0]}{more}: not as the run wrote it (its checksum differs); "
            "run the matrix again to compute it anew"
        )


def read_rows(out: Path, entry: Mapping[str, Any], *, columns: Sequence[str]) -> pa.Table:
    """Return the rows of one consumer at one level: of all its blocks, in their order.

    Parameters
    ----------
    out : Path
        Folder of the run.
    entry : mapping
        Of `cells` in its manifest.
    columns : sequence of str

    Raises
    ------
    DataError
        If a cell is missing or broken, or has no such column; the message names it.
    """
    tables = []
    for path in _paths(out, entry):
        with _readable(path):
            # Not pq.read_table: its data set machinery costs more than reading such a file.
            with pq.ParquetFile(path) as cell:
                tables.append(cell.read(columns=list(columns), use_threads=False))
            _refuse_missing(path, tables[-1], columns=columns)
    return pa.concat_tables(tables).unify_dictionaries()


def read_outcome(out: Path, entry: Mapping[str, Any]) -> LinkageOutcome:
    """Return what one linkage attack, or control, achieves at one level.

    Raises
    ------
    DataError
        If the cell is missing or broken; the message names it.
    """
    (path,) = _paths(out, entry)
    with _readable(path):
        about = json.loads(pq.read_metadata(path).metadata[METADATA])
        return LinkageOutcome(
            estimates={name: _unpacked(one) for name, one in about["estimates"].items()},
            numbers=about["numbers"],
            cohorts=about["cohorts"],
        )


def read_windows(out: Path, entry: Mapping[str, Any]) -> pd.DataFrame:
    """Return the windows of a linkage task at one level.

    The columns are those of `evaluation.cells.windows`, names as plain strings.

    Raises
    ------
    DataError
        If the cell is missing or broken; the message names it.
    """
    names = ("side", "search", "source", "group")
    windows: pd.DataFrame = read_rows(out, entry, columns=WINDOW_COLUMNS).to_pandas()
    return windows.astype(dict.fromkeys(names, "object"))


def read_probes(out: Path, entry: Mapping[str, Any]) -> pd.DataFrame:
    """Return how each probe of a linkage attack at one level fared.

    Returns
    -------
    DataFrame
        A row for each probe: `search`, `source`, `group`; `above` and `tied`, how many candidates
        score above its mate and how many as high, the mate included (-1 and 0 without a mate);
        `mate_score`, `best_other_score` (NaN where there is none); `chance` of rank 1.

    Raises
    ------
    DataError
        If the cell is missing or broken; the message names it.
    """
    table = read_rows(out, entry, columns=["search", "source", "group", "mate", "scores"])
    search, mate = np.asarray(table["search"].to_pylist()), table["mate"].to_numpy()
    flat = table["scores"].combine_chunks()
    values, ends = flat.values.to_numpy(), flat.offsets.to_numpy()
    found = {
        name: np.zeros(mate.size) for name in ("mate_score", "best_other_score", "chance")
    } | {name: np.zeros(mate.size, dtype=np.int64) for name in ("above", "tied")}
    for name in dict.fromkeys(search.tolist()):
        rows = np.flatnonzero(search == name)
        n_candidates = int(np.diff(ends)[rows[0]])
        scores = values[ends[rows[0]] : ends[rows[-1] + 1]].reshape(rows.size, n_candidates)
        has = mate[rows] >= 0
        own = np.where(has, scores[np.arange(rows.size), mate[rows]], np.nan)[:, None]
        others = scores.astype(np.float64)
        others[np.flatnonzero(has), mate[rows][has]] = -np.inf
        best = others.max(axis=1)
        found["above"][rows] = np.where(has, (scores > own).sum(axis=1), -1)
        found["tied"][rows] = (scores == own).sum(axis=1)
        found["mate_score"][rows] = own[:, 0]
        found["best_other_score"][rows] = np.where(np.isfinite(best), best, np.nan)
        found["chance"][rows] = 1.0 / n_candidates
    names = {name: table[name].to_pylist() for name in ("search", "source", "group")}
    return pd.DataFrame({**names, **found})


def _unpacked(packed: Mapping[str, Any]) -> Estimate:
    # As they were written: in double precision those of a run would take half a gigabyte.
    replicates: Any = np.frombuffer(base64.b64decode(packed["replicates"]), dtype="<f4")
    return Estimate(
        value=packed["value"],
        ci_low=packed["ci_low"],
        ci_high=packed["ci_high"],
        n=packed["n"],
        replicates=replicates,
    )


def _paths(out: Path, entry: Mapping[str, Any]) -> list[Path]:
    return [out / FOLDER / name for name in entry["files"]]


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise DataError(f"{path} is missing; run the matrix again to compute it") from None
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path} cannot be read ({error}); delete it and run the matrix again"
        ) from None


def _refuse_missing(path: Path, table: pa.Table, *, columns: Iterable[str]) -> None:
    missing = [name for name in columns if name not in table.column_names]
    if missing:
        raise DataError(
            f"{path} has no column {missing[0]}: it is no cell of the kind that the manifest "
            "says; run the matrix again with --fresh"
        )


def _to_parquet(rows: Rows, *, tracks: Cut) -> bytes:
    columns: dict[str, Any] = {}
    for name, values in rows.items():
        if name == "track":
            columns["source"] = names_column(values, tracks.source)
            columns["group"] = names_column(values, tracks.group)
        else:
            columns[name] = values
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns), sink, write_statistics=False)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def _write_down(out: Path, name: str, checksum: str) -> None:
    path = out / CHECKSUMS
    try:
        with path.open("ab+") as file:
            end = file.tell()
            file.seek(max(end - 1, 0))
            # A line that was cut short, by a full disk say, must not spoil the next.
            start = "" if file.read(1) in (b"", b"\n") else "\n"
            file.write(f"{start}{checksum}  {FOLDER}/{name}\n".encode())
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; finished cells are kept") from None


def written_down(out: Path) -> set[str]:
    """Return the cells that are there and whose checksums are written down.

    Whether these are theirs takes longer: see `sound_cells`.

    Raises
    ------
    DataError
        If the checksums cannot be read.
    OSError
        If the folder of the cells cannot be read.
    """
    return _present(out) & _checksums(out).keys()


def forget_missing(out: Path) -> None:
    """Write the checksums anew, if one is of a cell that is not there or was written twice.

    `sha256sum --check` would take it for damage. Lines of cells that are there are kept.

    Raises
    ------
    DataError
        If they cannot be read or written.
    OSError
        If the folder of the cells cannot be read.
    """
    lines, there = _lines(out), _present(out)
    kept = {name: checksum for name, checksum in lines if name in there}
    if set(lines) != set(kept.items()):
        text = "".join(f"{checksum}  {FOLDER}/{name}\n" for name, checksum in kept.items())
        write_whole(out / CHECKSUMS, text.encode())


def _present(out: Path) -> set[str]:
    try:
        return {path.name for path in (out / FOLDER).iterdir()}
    except (FileNotFoundError, NotADirectoryError):
        return set()


def _checksums(out: Path) -> dict[str, str]:
    """Return the checksum by file; the last one of a cell that was written twice."""
    return dict(_lines(out))


def _lines(out: Path) -> list[tuple[str, str]]:
    """Return file and checksum of every whole line."""
    path = out / CHECKSUMS
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return []
    except OSError as error:
        raise DataError(
            f"{path} cannot be read: {error.strerror}; make it readable or delete it"
        ) from None
    pairs = (line.split(f"  {FOLDER}/", 1) for line in text.splitlines())
    return [(pair[1], pair[0]) for pair in pairs if len(pair) > 1]
