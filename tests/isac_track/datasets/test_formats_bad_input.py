import io

import pyarrow as pa
import pytest
from pyarrow import parquet

from isac_track.datasets.formats import read
from isac_track.errors import DataError

GAN = b"0 1 0.0 0.0\n10 1 0.4 0.0\n"
CSV = b"t,id,x,y\n0.0,1,0.0,0.0\n0.4,1,0.4,0.0\n"
TRACK = b'{"track": {"f": 0, "p": 1, "x": 0.0, "y": 0.0}}\n'
LATER = b'{"track": {"f": 10, "p": 1, "x": 0.4, "y": 0.0}}\n'


def case(name, format_name, data, message, *, fps="usual"):
    usual = 25.0 if format_name in {"obsmat", "social-gan", "pedpy", "trajnet"} else None
    rate = usual if fps == "usual" else fps
    return pytest.param(format_name, data, rate, message, id=f"{format_name}: {name}")


WHITESPACE = [
    case("empty", "social-gan", b"", "f: the file is empty"),
    case("only comments", "pedpy", b"# framerate: 25\n\n", "f: the file holds no rows", fps=None),
    case("binary", "obsmat", b"\x7fELF\0\0", "f: the file is binary, not text (zero byte at 4)"),
    case("gzip", "obsmat", b"\x1f\x8b\x08 1", "f: the file is compressed (gzip); unpack it first"),
    case(
        "parquet", "obsmat", b"PAR1 1", "f: this is a parquet file; read it with --format parquet"
    ),
    case("UTF-16", "social-gan", "0 1 2 3".encode("utf-16"), "f: the file is UTF-16 text"),
    case("Latin-1", "pedpy", b"# a\n# J\xfclich\n", "f, line 2: byte 0xfc is not UTF-8 text"),
    case("commas", "social-gan", b"0,1,0.0,0.0\n", "f, line 1: commas between the numbers"),
    case("semicolons", "social-gan", b"0;1;0,5;0\n", "f, line 1: semicolons between the numbers"),
    case(
        "decimal comma", "social-gan", GAN + b"20 1 0,8 0\n", "f, line 3: '0,8' has a decimal comma"
    ),
    case("a header", "social-gan", b"frame id x y\n" + GAN, "f, line 1: 'frame' is not a number"),
    case("too few columns", "social-gan", GAN + b"\n20 1 0.8\n", "f, line 4: 3 column(s) where"),
    case("too many columns", "social-gan", b"0 1 0 0 7\n", "has 4 (frame id x y)"),
    case("other format", "obsmat", GAN, "f, line 1: 4 column(s) where obsmat has 8"),
    case("ragged", "pedpy", b"1 0 0 0 1\n1 1 0 0\n", "f, line 2: 4 columns where the rows before"),
    case("nan", "social-gan", GAN + b"20 1 nan 0\n", "f, line 3: x is nan; leave such rows out"),
    case("inf", "obsmat", b"# c\n1 1 0 0 inf 0 0 0\n", "f, line 2: y is inf"),
    case("overflow", "obsmat", b"1 1 0 0 1e999 0 0 0\n", "f, line 1: y is inf"),
    case("out of range", "obsmat", b"1 1 0 0 -1e9 0 0 0\n", "f, line 1: y is -1e+09: out of range"),
    case(
        "id not whole",
        "social-gan",
        GAN + b"0 1.5 0 0\n",
        "f, line 3: id 1.5 is not a whole number",
    ),
    case(
        "frame not whole",
        "social-gan",
        b"0.4 1 0 0\n",
        "f, line 1: frame 0.4 is not a whole number",
    ),
    case(
        "frame too large", "social-gan", b"1e17 1 0 0\n", "f, line 1: frame is 1e+17: out of range"
    ),
    case(
        "underscore", "social-gan", GAN + b"1_0 1 0 0\n", "f, line 3: '1_0' is not a plain number"
    ),
    case("no fps", "social-gan", GAN, "give frames per second with --fps", fps=None),
    case("fps 0", "social-gan", GAN, "--fps: 0 frames per second is not a frame rate", fps=0.0),
    case("fps -1", "social-gan", GAN, "--fps: -1 frames per second is not", fps=-1.0),
    case("fps nan", "social-gan", GAN, "--fps: nan frames per second is not", fps=float("nan")),
    case("fps inf", "social-gan", GAN, "--fps: inf frames per second is not", fps=float("inf")),
    case("no framerate", "pedpy", b"1 0 0 0\n", "the file's header has no framerate", fps=None),
    case(
        "framerate 0", "pedpy", b"# x\n# framerate: 0\n1 0 0 0\n", "f, line 2: 0 frames", fps=None
    ),
    case("framerate -5", "pedpy", b"# framerate: -5\n1 0 0 0\n", "f, line 1: -5 frames", fps=None),
    case("framerate 1.2.3", "pedpy", b"# framerate: 1.2.3\n", "f, line 1: the framerate '1.2.3'"),
    case(
        "other framerate",
        "pedpy",
        b"# framerate: 16\n1 0 0 0\n",
        "contradicts the file's framerate 16",
    ),
    case(
        "millimetres", "pedpy", b"# id frame x/mm y/mm\n1 0 0 0\n", "f, line 1: lengths are in 'mm'"
    ),
    case(
        "two units", "pedpy", b"# x/m\n# x/cm\n1 0 0 0\n", "f: the header names two units of length"
    ),
    case(
        "two places at once",
        "social-gan",
        b"# c\n0 1 0 0\n0 2 0 0\n0 1 1 0\n",
        "f, line 4: id 1 is somewhere else at the same time in line 2",
    ),
    case("one sample each", "social-gan", b"0 1 0 0\n0 2 0 0\n", "f: no track has two samples"),
    case(
        "pixels",
        "social-gan",
        b"0 1 320 200\n10 1 332 200\n20 1 344 200\n",
        "f: the median speed of moving people is 30 m/s, not within 0.01 to 5: pixels",
    ),
    case(
        "id and frame swapped",
        "pedpy",
        b"".join(b"%d %d %d 0\n" % (f, i, 9 * i + f / 25) for f in (0, 1, 2) for i in (1, 2, 3)),
        "frame and id swapped?",
    ),
]
JSON = [
    case("empty", "trajnet", b"", "f: the file is empty"),
    case("no rows", "trajnet", b'{"scene": {"fps": 2.5}}\n', "f: the file holds no track rows"),
    case("not JSON", "trajnet", TRACK + b"0 1 2 3\n", "f, line 2: not JSON"),
    case("cut off", "trajnet", TRACK + LATER[:20], "f, line 2: not JSON"),
    case("a list", "trajnet", TRACK + b"[1]\n", 'f, line 2: neither a {"track": {...}} nor'),
    case("another kind", "trajnet", b'{"foo": {}}\n', "f, line 1: neither a"),
    case("no object", "trajnet", b'{"track": 3}\n', "f, line 1: track holds no object"),
    case(
        "missing y", "trajnet", b'{"track": {"f": 0, "p": 1, "x": 1}}\n', "f, line 1: y is missing"
    ),
    case("text", "trajnet", TRACK.replace(b"1,", b'"a",'), 'f, line 1: p is "a", not a number'),
    case("null", "trajnet", LATER.replace(b"0.4", b"null"), "f, line 1: x is null, not a number"),
    case("true", "trajnet", LATER.replace(b"0.4", b"true"), "f, line 1: x is true, not a number"),
    case("NaN", "trajnet", TRACK + LATER.replace(b"0.4", b"NaN"), "f, line 2: x is nan"),
    case(
        "p not whole", "trajnet", TRACK.replace(b"1,", b"1.5,"), "f, line 1: p 1.5 is not a whole"
    ),
    case(
        "huge", "trajnet", TRACK.replace(b"1,", b"9" * 999 + b","), "f, line 1: p is out of range"
    ),
    case(
        "more digits than Python reads",
        "trajnet",
        TRACK.replace(b"1,", b"9" * 9999 + b","),
        "line 1",
    ),
    case("deep", "trajnet", b"[" * 9_000, "f, line 1: too deeply nested"),
    case("long", "trajnet", b"[" * 100_000, "f, line 1: 100000 characters, over 10000"),
    case(
        "forecast",
        "trajnet",
        TRACK.replace(b"}}", b', "prediction_number": 0}}'),
        "f, line 1: prediction_number marks a forecast",
    ),
    case("no fps", "trajnet", TRACK + LATER, "f: no scene line gives fps", fps=None),
    case(
        "two fps",
        "trajnet",
        b'{"scene": {"fps": 2.5}}\n{"scene": {"fps": 5}}\n' + TRACK,
        "f, line 2: scene fps 5 contradicts the 2.5 of line 1",
    ),
    case(
        "fps of rows taken for that of frames",
        "trajnet",
        b'{"scene": {"fps": 2.5}}\n' + TRACK + LATER,
        "f: --fps 2.5 contradicts the scene lines: 2.5 rows a second, 10 frames apart, are 25",
        fps=2.5,
    ),
    case("fps 0", "trajnet", b'{"scene": {"fps": 0}}\n' + TRACK, "f, line 1: 0 frames", fps=None),
]
TABLES = [
    case("empty", "csv", b"", "f: the file is empty"),
    case("header alone", "csv", b"t,id,x,y\n", "f: the file holds no rows"),
    case("no header", "csv", b"0,1,2,3\n", "f, line 1: no column t, id, x, y"),
    case("missing column", "csv", b"t,person,x,y\n", "f, line 1: no column id"),
    case("upper case", "csv", b"T,id,x,y\n", "did you mean 'T'? Rename it"),
    case("twice", "csv", b"t,id,x,x,y\n", "f, line 1: two columns are called x"),
    case("semicolons", "csv", b"t;id;x;y\n", "f, line 1: semicolons between the columns"),
    case("tabs", "csv", b"t\tid\tx\ty\n", "f, line 1: tabs between the columns"),
    case(
        "decimal comma",
        "csv",
        CSV + b"0,8,1,0,8,0\n",
        "f, line 4: 6 column(s) where the header has 4",
    ),
    case("quoted decimal comma", "csv", CSV + b'"0,8",1,0,0\n', "line 4: t '0,8' is not a number"),
    case("short row", "csv", b"t,id,x,y\n\n0,1,2\n", "f, line 3: 3 column(s)"),
    case("text", "csv", CSV + b"0.8,1,left,0\n", "f, line 4: x 'left' is not a number of metres"),
    case(
        "a date",
        "csv",
        b"t,id,x,y\n2024-01-01,1,0,0\n",
        "line 2: t '2024-01-01' is not a number of s",
    ),
    case("empty cell", "csv", CSV + b"\n0.8,1,,0\n", "f, line 5: x is nan; leave such rows out"),
    case("inf", "csv", CSV + b"0.8,1,0,-inf\n", "f, line 4: y is -inf"),
    case("out of range", "csv", CSV + b"1e13,1,0,0\n", "f, line 4: t is 1e+13: out of range"),
    case("no id", "csv", CSV + b"0.8, ,0,0\n", "f, line 4: the id is missing"),
    case("nan id", "csv", CSV + b"0.8,nan,0,0\n", "f, line 4: the id is missing"),
    case("id not whole", "csv", CSV + b"0.8,1.5,0,0\n", "f, line 4: id 1.5 is not a whole number"),
    case("open quote", "csv", CSV + b'0.8,"1,0,0\n', "f, line 4: unexpected end of data"),
    case("binary", "csv", b"t,id\0", "f: the file is binary"),
    case("Latin-1", "csv", CSV + b"0.8,Zo\xeb,0,0\n", "f, line 4: byte 0xeb is not UTF-8 text"),
    case("fps", "csv", CSV, "leave --fps out", fps=25.0),
    case(
        "milliseconds",
        "csv",
        b"t,id,x,y\n0,1,0,0\n400,1,0.4,0\n800,1,0.8,0\n",
        "f: the median speed of moving people is 0.001 m/s, not within 0.01 to 5: milliseconds",
    ),
    case("text", "parquet", CSV, "f: not a parquet file"),
    case("empty", "parquet", b"", "f: the file is empty"),
    case("fps", "parquet", b"", "leave --fps out", fps=25.0),
]


@pytest.mark.parametrize(("format_name", "data", "fps", "message"), WHITESPACE + JSON + TABLES)
def test_one_clear_error(format_name, data, fps, message):
    with pytest.raises(DataError) as caught:
        read(data=data, path="f", format=format_name, fps=fps)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def table(**changes):
    columns = {"t": [0.0, 0.4], "id": [1, 1], "x": [0.0, 0.4], "y": [0.0, 0.0], **changes}
    buffer = io.BytesIO()
    parquet.write_table(pa.table({k: v for k, v in columns.items() if v is not None}), buffer)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (table(y=None), "f: no column y"),
        (table(x=[0.0, None]), "f, row 2: x is nan"),
        (table(x=["0", "1"]), "f: column x holds string, not numbers of metres"),
        (table(t=pa.array([0, 1], pa.timestamp("ms"))), "t holds timestamp[ms], not numbers of s"),
        (table(id=[1, None]), "f, row 2: the id is missing"),
        (table(id=[1.0, 1.5]), "f, row 2: id 1.5 is not a whole number"),
        (table(id=[[1], [1]]), "f: ids and groups must be numbers or text, not list"),
        (table(id=[1, 2]), "f: no track has two samples"),
        (table(t=[0.4, 0.4]), "f, row 2: id 1 is somewhere else at the same time in row 1"),
        (table(t=[], id=[], x=[], y=[]), "f: "),
        (table()[:-20], "f: not a parquet file"),
        (table()[:40] + bytes(60) + table()[100:], "f: the parquet file is damaged"),
    ],
    ids=["no y", "null", "text", "dates", "no id", "id 1.5", "lists", "single", "twice", "empty",
         "cut off", "damaged"],
)  # fmt: skip
def test_one_clear_error_for_parquet(data, message):
    with pytest.raises(DataError) as caught:
        read(data=data, path="f", format="parquet")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_line_is_that_of_the_file_with_comments_blanks_and_a_mark():
    data = b"\xef\xbb\xbf# one\r\n\r\n  \r\n0 1 0 0 # four\r\n# five\r\n10 1 nan 0\r\n"
    with pytest.raises(DataError, match="f, line 6: x is nan"):
        read(data=data, path="f", format="social-gan", fps=25.0)
