"""A machine at its limits is named as such; a good file is not called damaged."""

import errno
import os

import pyarrow as pa
import pytest

from evaluation.store import sample_tracks
from evaluation.store.sample_tracks import read_sample_tracks, save_sample_tracks
from isac_track.command_line import exit_code
from isac_track.errors import DataError

LIMITS = {
    "memory of Python": (MemoryError(), "not enough memory"),
    "memory of Arrow": (
        pa.ArrowMemoryError("malloc of size 9 failed"),
        "not enough memory",
    ),
    "memory of the system": (
        OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)),
        "enough memory",
    ),
    "threads": (
        pa.ArrowException("thread: Resource temporarily unavailable"),
        "ulimit -u and -v",
    ),
    "open files": (OSError(errno.EMFILE, os.strerror(errno.EMFILE)), "ulimit -n"),
}


@pytest.fixture
def out(tmp_path):
    columns = {name: [0.0] for name in sample_tracks.COLUMNS}
    save_sample_tracks([pa.table(columns)], out=tmp_path)
    assert list(read_sample_tracks(tmp_path).columns) == list(sample_tracks.COLUMNS)
    return tmp_path


@pytest.mark.parametrize("limit", LIMITS)
def test_a_limit_of_the_machine_is_not_blamed_on_a_file(
    limit, out, monkeypatch, capsys
):
    fault, says = LIMITS[limit]

    def fails(*_, **__):
        raise fault

    monkeypatch.setattr(sample_tracks.pq, "ParquetFile", fails)
    assert exit_code(lambda: read_sample_tracks(out)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert "delete" not in line


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" * 99])
def test_a_file_that_is_damaged_is_named(content, out):
    (out / sample_tracks.SAMPLE_TRACKS).write_bytes(content)
    with pytest.raises(
        DataError, match=r"gallery.parquet cannot be read .*; delete it"
    ):
        read_sample_tracks(out)
