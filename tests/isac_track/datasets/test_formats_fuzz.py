"""Whatever the bytes, a reader gives tracks or a `DataError`, and no warning."""

import io

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from isac_track.datasets.formats import FORMATS, read
from isac_track.errors import DataError


def parquet_bytes(ids):
    buffer = io.BytesIO()
    columns = {"t": [0.0, 0.4] * 2, "id": ids, "x": [0.0, 0.4] * 2, "y": [0.0] * 4}
    parquet.write_table(pa.table(columns | {"group": ["g", None, None, "h"]}), buffer)
    return buffer.getvalue()


VALID = {
    "obsmat": [
        b"1 1 0.0 0 1.0 0 0 0\n11 1 0.4 0 1.0 0 0 0\n21 1 0.8 0 1 0 0 0\n11 2 5 0 5 0 0 0\n"
    ],
    "social-gan": [b"0.0\t1.0\t1.5\t2.5\n10\t1\t1.9\t2.5\n0 2 5 5\n10 2 5.4 5\n"],
    "pedpy": [b"# framerate: 25\n# id frame x/cm y/cm z/cm\n1 0 100 200 0\n1 1 105 200 0\n"],
    "trajnet": [
        (
            b'{"scene": {"id": 0, "p": 1, "s": 0, "e": 20, "fps": 2.5, "tag": 1}}\n'
            b'{"track": {"f": 0, "p": 1, "x": 1.0, "y": 2.0}}\n'
            b'{"track": {"f": 10, "p": 1, "x": 1.4, "y": 2.0}}\n'
        )
    ],
    "csv": [b't,id,x,y,group\n0,a,1,2,g\n0.4,"a",1.4,2,\n0,b,3,3,g\n0.4,b,3.4,3,g\n'],
    "parquet": [parquet_bytes(["a", "a", "b", "b"]), parquet_bytes([1.0, 1.0, 2.0, 2.0])],
}
NUMBERS = b"e nan inf null true 1e999 1e308 -1e308 5e-324 0x1 1,5"
FRAGMENTS = [
    *(bytes([code]) for code in b",;:#\t \n\r\"'{[]}.-+_\0\x1c\xff"),
    *(b"\xef\xbb\xbf", b"\xc2\xa0", b"\xe2\x80\xa8", b"\xd9\xa1", b"\n\n", b'"\n', b"PAR1"),
    *(b"9" * 400, *NUMBERS.split()),
]


@st.composite
def damaged(draw, valid):
    """Give a valid file with up to six edits: inserted, changed, cut or repeated."""
    data = bytearray(draw(st.sampled_from(valid)))
    for _ in range(draw(st.integers(1, 6))):
        first, last = sorted(draw(st.tuples(*[st.integers(0, len(data))] * 2)))
        edit = draw(st.sampled_from(["insert", "change", "cut", "repeat"]))
        if edit == "insert":
            data[first:first] = draw(st.sampled_from(FRAGMENTS))
        elif edit == "change" and first < len(data):
            data[first] = draw(st.integers(0, 255))
        elif edit == "cut":
            del data[first : min(last, first + 8)]
        else:
            data[first:first] = data[first:last]
    return bytes(data)


def check(data, format_name, fps):
    try:
        tracks, repairs = read(data=data, path="f", format=format_name, fps=fps)
    except DataError as error:
        message = str(error)
        assert message.startswith(("f:", "f,", "--fps")), message
        assert "\n" not in message
        message.encode()
    else:
        assert (np.diff(tracks.offsets) > 1).all()
        assert all(repair.count > 0 for repair in repairs)


FPS = st.sampled_from([None, 25.0, 1e-3, 1e6, 0.0])


@pytest.mark.parametrize("format_name", FORMATS)
@settings(max_examples=150, deadline=None)
@given(data=st.data(), fps=FPS)
def test_damaged_files(format_name, data, fps):
    check(data.draw(damaged(VALID[format_name])), format_name, fps)


@pytest.mark.parametrize("format_name", FORMATS)
@settings(max_examples=60, deadline=None)
@given(
    data=st.binary(max_size=200) | st.text(max_size=100).map(lambda text: text.encode()), fps=FPS
)
def test_random_bytes(format_name, data, fps):
    check(data, format_name, fps)
