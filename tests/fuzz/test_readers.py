"""For any bytes a reader gives tracks or a `DataError` with the file, and no warning.

``benchmarks/fuzz_readers.py`` searches further, from the same small files.
"""

import tracemalloc
from contextlib import contextmanager
from datetime import timedelta

import numpy as np
import pyarrow as pa
import pytest
from helpers.recordings import (
    CORPUS,
    TEXT,
    assert_message,
    packed,
    read_walk,
    refusal,
    written,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st

from isac_track.datasets import FORMATS
from isac_track.errors import IsacTrackError

VALID = {name: [(CORPUS / f"walks.{name}").read_bytes()] for name in TEXT}
VALID["parquet"] = [
    (CORPUS / f"{name}.parquet").read_bytes() for name in ("text", "number")
]
ALL = [data for files in VALID.values() for data in files]
TEXTS = st.text(max_size=100).map(str.encode)
FPS = st.sampled_from([None, 25.0, 1e-3, 1e6, 0.0, -1.0, float("nan"), float("inf")])
# The examples are the same in every run; over 5 s an example counts as a hang.
steady = settings(derandomize=True, print_blob=True, deadline=timedelta(seconds=5))


def check(data, format_name, fps):
    try:
        tracks, repairs = read_walk(data, format_name, fps)
    except IsacTrackError as error:
        assert_message(str(error))
    else:
        assert (np.diff(tracks.offsets) > 1).all()
        assert all(repair.count > 0 for repair in repairs)
        assert all(len(repair.detail.splitlines()) == 1 for repair in repairs)


FRAGMENTS = [
    *(bytes([code]) for code in b",;:#\t \n\r\"'{[]}.-+_\0\x1c\xff"),
    b"\xef\xbb\xbf",
    b"\xc2\xa0",
    b"\xe2\x80\xa8",
    b"\xd9\xa1",
    b"\n\n",
    b'"\n',
    b"PAR1",
    b"\xf0\x9f\x98\x80",
    b"\xed\xa0\x80",
    b"\x85",
    b"\x1f\x8b",
    b"PK\x03\x04",
]
NUMBERS = [
    *b"nan NaN inf -Infinity null true 1e999 1e308 -1e308 1e300 5e-324 -1 -0.0 0x1"
    b" 1,5 1_0".split(),
    b"",
    b"9" * 19,
    b"9" * 400,
    b"9" * 5000,
    b"-9007199254740993",
    b"1" + b"0" * 12,
    b"0.5",
    b"x" * 100_000,
    b'"' + b"a" * 300 + b'"',
    "\u0661".encode(),
    b"[" * 3000,
]


@st.composite
def edited(draw, valid):
    """Give a valid file with up to six edits that remove, replace or insert bytes."""
    data = draw(st.sampled_from(valid))
    for _ in range(draw(st.integers(1, 6))):
        first, last = sorted(draw(st.tuples(*[st.integers(0, len(data))] * 2)))
        new = (
            st.sampled_from(FRAGMENTS + NUMBERS)
            | st.binary(max_size=1)
            | st.just(data[first:last])
        )
        data = data[:first] + draw(new) + data[first + draw(st.integers(0, 8)) :]
    return data


@st.composite
def rewritten(draw, valid):
    """Give a valid text file with other fields, order of lines, or line ends."""
    lines = draw(st.sampled_from(valid)).splitlines()
    separator = b"," if b"," in lines[0] else b" "
    lines = [
        lines[n] for n in draw(st.lists(st.integers(0, len(lines) - 1), max_size=8))
    ] or lines
    for _ in range(draw(st.integers(0, 4))):
        row = draw(st.integers(0, len(lines) - 1))
        fields = lines[row].split(separator)
        fields[draw(st.integers(0, len(fields) - 1))] = draw(
            st.sampled_from(NUMBERS + FRAGMENTS)
        )
        lines[row] = separator.join(fields)
    if draw(st.integers(0, 9)) == 0:
        lines = [
            separator.join([line] * 2000) for line in lines
        ]  # thousands of columns
    mark = draw(st.sampled_from([b"", b"", b"\xef\xbb\xbf", b"\xff\xfe"]))
    end = draw(st.sampled_from([b"\n", b"\r\n", b"\r", b"\n\n", b" \n"]))
    return mark + end.join(lines) + draw(st.sampled_from([b"", end]))


@pytest.mark.parametrize("format_name", FORMATS)
@settings(steady, max_examples=150)
@given(data=st.data(), fps=FPS)
def test_edited_bytes_or_lines(format_name, data, fps):
    ways = [edited, rewritten] if format_name in TEXT else [edited]
    check(
        data.draw(st.one_of(way(VALID[format_name]) for way in ways)), format_name, fps
    )


@pytest.mark.parametrize("format_name", FORMATS)
@settings(steady, max_examples=60)
@given(data=st.sampled_from(ALL) | st.binary(max_size=200) | TEXTS, fps=FPS)
@example(data=b"\xef\xbb\xbf", fps=None)
@example(data=b"\n" * 5000, fps=25.0)
@example(data=b"[" * 100_000, fps=25.0)
@example(data=b'{"track":' * 100_000, fps=25.0)
@example(data=b"t,id,x,y" + b",c" * 20_000 + b"\n" + b"0" + b",0" * 20_003, fps=None)
def test_any_bytes(format_name, data, fps):
    check(data, format_name, fps)


@pytest.mark.parametrize("name", ["a\x1b[2Jb", "a\x85b"])
def test_the_name_of_a_column_does_not_steer_the_terminal_and_lines_may_be_long(name):
    long = "a" * 600_000  # more than a block of arrow
    _, (note,) = read_walk(
        f"t,id,x,y,{name}\n0,1,0,0,1\n0.4,1,0.4,0,{long}\n".encode(), "csv"
    )
    assert note.detail.isprintable()


class TestMemory:
    """A recording needs about ten times its size, not more."""

    @pytest.mark.parametrize("format_name", TEXT)
    def test_however_it_is_written(self, format_name):
        data = recording(format_name)
        assert peak_bytes(data, format_name) < 10 * len(data)
        data = data.replace(b"\n", b"\r\n")
        assert peak_bytes(data, format_name) < 10 * len(data)

    @pytest.mark.parametrize(
        ("columns", "message"),
        [
            ({name: np.zeros(10_000_000) for name in ("t", "id", "x", "y")},
             "claims 10000000 rows in "),
            ({"t": np.arange(100.0), "id": ["a" * 1_000_000] * 100},
             "has 1000000 characters, over 200"),
            ({"t": ["0" * 1_000_000] * 100, "id": [1] * 100},
             "column t holds string, not numbers of seconds"),
        ],
        ids=["rows", "a long id", "a long text for a number"],
    )  # fmt: skip
    def test_a_small_parquet_file_that_claims_much_is_not_unpacked(
        self, columns, message
    ):
        data = packed(
            **{"x": np.zeros(100), "y": np.zeros(100), **columns}, compression="zstd"
        )
        assert len(data) < 400_000
        with arrow_pool() as pool:
            assert message in refusal(data, "parquet")
        assert pool.max_memory() < 50_000_000


def recording(format_name):
    """A file of MB: people walk 80 m each in 200 samples, one after the other."""
    people = ((person, person % 90 / 7) for person in range(1, 100))
    steps = [round(0.4 * n, 4) for n in range(200)]
    rows = [(t, str(person), t, round(y, 4)) for person, y in people for t in steps]
    return written(rows, format_name)


def peak_bytes(data, format_name, fps=25.0):
    """Peak memory of Python and arrow, without the file itself."""
    # A first read does the imports.
    check(VALID[format_name][0], format_name, None if format_name == "csv" else 25.0)
    tracemalloc.start()
    try:
        with arrow_pool() as pool:
            check(data, format_name, None if format_name == "csv" else fps)
        return tracemalloc.get_traced_memory()[1] + pool.max_memory()
    finally:
        tracemalloc.stop()


POOLS = []  # must outlive what was allocated from them


@contextmanager
def arrow_pool():
    """Let arrow allocate from a new pool, which counts from zero."""
    previous = pa.default_memory_pool()
    POOLS.append(pa.proxy_memory_pool(pa.system_memory_pool()))
    pa.set_memory_pool(POOLS[-1])
    try:
        yield POOLS[-1]
    finally:
        pa.set_memory_pool(previous)
