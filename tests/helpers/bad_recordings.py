"""Files that no reader can read, by format: their content and what is said of them."""

from helpers.recordings import CORPUS, SECONDS, packed

GAN = b"0 1 0.0 0.0\n10 1 0.4 0.0\n"
CSV = b"t,id,x,y\n0.0,1,0.0,0.0\n0.4,1,0.4,0.0\n"
TRACK = b'{"track": {"f": 0, "p": 1, "x": 0.0, "y": 0.0}}\n'
LATER = b'{"track": {"f": 10, "p": 1, "x": 0.4, "y": 0.0}}\n'
SWAPPED = b"".join(
    b"%d %d %d 0\n" % (f, i, 9 * i + f / 25) for f in (0, 1, 2) for i in (1, 2, 3)
)
NOTES = b"\xef\xbb\xbf# one\r\n\r\n  \r\n0 1 0 0 # four\r\n# five\r\n10 1 nan 0\r\n"


def table(**changes):
    return packed(
        **{"t": [0.0, 0.4], "id": [1, 1], "x": [0.0, 0.4], "y": [0.0, 0.0], **changes}
    )


# A third member is the frame rate; otherwise it is 25 where frames are counted.
# fmt: off
BAD = {
    "obsmat": [
        (b"\x7fELF\0\0", "f: the file is binary, not text (zero byte at 4)"),
        (b"\x1f\x8b\x08 1", "f: the file is compressed (gzip); unpack it first"),
        (b"PAR1 1", "f: this is a parquet file; read it with --format parquet"),
        (b"# c\n1 1 0 0 inf 0 0 0\n", "f, line 2: y is inf"),
        (b"1 1 0 0 -1e9 0 0 0\n", "f, line 1: y is -1e+09: out of range"),
        (b"0 1 0 0 0 0 0 0\n1000000000000 1 0 0 0 0 0 0\n", "f: the usual step is 4e+10 s, over"),
    ],
    "social-gan": [
        (b"", "f: the file is empty"),
        ("0 1 2 3".encode("utf-16"), "f: the file is UTF-16 text"),
        (b"0,1,0.0,0.0\n", "f, line 1: commas between the numbers"),
        (b"0;1;0,5;0\n", "f, line 1: semicolons between the numbers"),
        (GAN + b"20 1 0,8 0\n", "f, line 3: '0,8' has a decimal comma"),
        (b"frame id x y\n" + GAN, "f, line 1: 'frame' is not a number"),
        (GAN + b"\n20 1 0.8\n", "f, line 4: 3 column(s) where"),
        (GAN + b"20 1 nan 0\n", "f, line 3: x is nan; leave such rows out"),
        (NOTES, "f, line 6: x is nan"),
        (GAN + b"0 1.5 0 0\n", "f, line 3: id 1.5 is not a whole number"),
        (GAN + b"1_0 1 0 0\n", "f: cannot be read as social-gan: could not convert string '1_0'"),
        (GAN, "give frames per second with --fps", None),
        (GAN, "--fps: 0 frames per second is not a frame rate", 0.0),
        (GAN, "--fps: nan frames per second is not", float("nan")),
        (b"# c\n0 1 0 0\n0 2 0 0\n0 1 1 0\n",
         "f, line 4: id 1 is somewhere else at the same time in line 2"),
        (b"0 1 0 0\n0 2 0 0\n", "f: no track has two samples"),
        (b"0 1 320 200\n10 1 332 200\n20 1 344 200\n",
         "f: the median speed of moving people is 30 m/s, not within 0.01 to 5: pixels"),
    ],
    "pedpy": [
        (b"# framerate: 25\n\n", "f: the file holds no rows", None),
        (b"1 0 0 0 1\n1 1 0 0\n", "f, line 2: 4 columns where the rows before"),
        (b"1 0 0 0\n", "the file's header has no framerate", None),
        (b"# x\n# framerate: 0\n1 0 0 0\n", "f, line 2: 0 frames", None),
        (b"# framerate: 1.2.3\n", "f, line 1: the framerate '1.2.3'"),
        (b"# framerate: 16\n1 0 0 0\n", "contradicts the file's framerate 16"),
        # Took 6 s for 45 kB, and four times as long for twice as much.
        (b"# " + b"framerate" * 100_000 + b"\n1 0 0 0\n", "no framerate", None),
        (b"# id frame x/ft y/ft\n1 0 0 0\n", "f, line 1: lengths are in 'ft'; convert them"),
        (b"# frame id x y\n0 1.5 0 0\n", "f, line 2: id 1.5 is not a whole number"),
        (b"# x/m\n# x/cm\n1 0 0 0\n", "f: the header names two units of length"),
        (SWAPPED, "frame and id swapped?"),
    ],
    "trajnet": [
        (b'{"scene": {"fps": 2.5}}\n', "f: the file holds no track rows"),
        (TRACK + b"0 1 2 3\n", "f, line 2: not JSON"),
        (TRACK + b"[1]\n", 'f, line 2: neither a {"track": {...}} nor'),
        (b'{"track": 3}\n', "f, line 1: track holds no object"),
        (b'{"track": {"f": 0, "p": 1, "x": 1}}\n', "f, line 1: y is missing"),
        (TRACK.replace(b"1,", b'"a",'), 'f, line 1: p is "a", not a number'),
        (TRACK.replace(b"1,", b"9" * 999 + b","), "f, line 1: p is out of range"),
        # more digits than Python reads
        (TRACK.replace(b"1,", b"9" * 9999 + b","), "line 1"),
        (b"[" * 100_000, "f, line 1: too deeply nested"),
        (TRACK.replace(b"}}", b', "prediction_number": 0}}'),
         "f, line 1: prediction_number marks a forecast"),
        (TRACK + LATER, "f: no scene line gives fps", None),
        (b'{"scene": {"fps": 2.5}}\n{"scene": {"fps": 5}}\n' + TRACK,
         "f, line 2: scene fps 5 contradicts the 2.5 of line 1"),
        (b'{"scene": {"fps": 2.5}}\n' + TRACK + LATER,
         "f: --fps 2.5 contradicts the scene lines: 2.5 rows a second, 10 frames apart, are 25",
         2.5),
    ],
    "csv": [
        (b"t,id,x,y\n", "f: the file holds no rows"),
        (b"t,person,x,y\n", "f, line 1: no column id"),
        (b"time,id,x,y\n", "f, line 1: no column t (needed"),
        (b"T,t,id,ID,x,y\n0,0,0,0,0,0\n", "f: no track has two samples"),
        (b"T,id,x,X,Y\n", "f: the file holds no rows"),
        (b"T,Id,iD,x,y\n", "f, line 1: two columns are called id"),
        (b"t,id,x,x,y\n", "f, line 1: two columns are called x"),
        (b"t;id;x;y\n", "f, line 1: semicolons between the columns"),
        (CSV + b"0,8,1,0,8,0\n", "f, line 4: 6 column(s) where the header has 4"),
        (CSV + b'"0,8",1,0,0\n', "line 4: t '0,8' is not a number"),
        (CSV + b"0.8,1,left,0\n", "f, line 4: x 'left' is not a number of metres"),
        (CSV + b"0.8,1,1_000,0\n", "f, line 4: x '1_000' is not a number of metres"),
        (CSV + "0.8,1,0,٣\n".encode(), "f, line 4: y '٣' is not a number of metres"),
        (b"# by us\n" + CSV, "f, line 1: a comment; the first line of csv names the columns"),
        (CSV + b"\n0.8,1,,0\n", "f, line 5: x is nan; leave such rows out"),
        (CSV + b"1e13,1,0,0\n", "f, line 4: t is 1e+13: out of range"),
        (CSV + b"0.8, ,0,0\n", "f, line 4: the id is missing"),
        (CSV + b"0.8,1.5,0,0\n", "f, line 4: id 1.5 is not a whole number"),
        (CSV + b"0.8,%b,0,0\n" % (b"a" * 100_000), "has 100000 characters, over 200"),
        (CSV + b"0.8,a\x1b[2Jb,0,0\n", "f, line 4: the name 'a\\x1b[2Jb' has a control character"),
        (CSV + b'0.8,"1,0,0\n', "f, line 4: unexpected end of data"),
        (b't,id,x,y,note\n0,1,0,0,a\n0.4,1,1,0,"one\ntwo"\n0.8,1,2,0,b\n',
         "f, line 3: unexpected end of data; each row must be on one line"),
        (CSV + b"0.8,Zo\xeb,0,0\n", "f, line 4: byte 0xeb is not UTF-8 text"),
        (CSV, "leave --fps out", 25.0),
        (b"t,id,x,y\n0,1,0,0\n400,1,0.4,0\n800,1,0.8,0\n",
         "f: the median speed of moving people is 0.001 m/s, not within 0.01 to 5: milliseconds"),
        # So close that the slope between them would overflow.
        (b"t,id,x,y\n0,1,0,0\n0.4,1,0.4,0\n0.400000000000001,1,0.5,0\n",
         "f, line 4: id 1 is somewhere else at the same time"),
    ],
    "parquet": [
        (CSV, "f: not a parquet file"),
        (table(y=None), "f: no column y"),
        (table(x=[0.0, None]), "f, row 2: x is nan"),
        (table(x=["0", "1"]), "f: column x holds string, not numbers of metres"),
        (table(t=["0.0", "0.4"]), "column t holds string, not numbers of seconds"),
        (table(id=[1, None]), "f, row 2: the id is missing"),
        (table(id=[[1], [1]]), "f: ids and groups must be numbers or text, not list"),
        (table(t=[0.4, 0.4]), "f, row 2: id 1 is somewhere else at the same time in row 1"),
        (table(t=[], id=[], x=[], y=[]), "f: "),
        # An IndexError and a KeyError, found by benchmarks/fuzz_readers.py.
        ((CORPUS / "code-beyond-dictionary.parquet").read_bytes(), "the parquet file is damaged"),
        ((CORPUS / "column-that-is-not-read.parquet").read_bytes(),
         "the parquet file is damaged (ValueError: column t is not in it)"),
        (table()[:40] + bytes(60) + table()[100:], "f: the parquet file is damaged"),
    ],
}
# fmt: on
ROWS = [
    (name, data, message, *(fps or [None if name in SECONDS else 25.0]))
    for name, rows in BAD.items()
    for data, message, *fps in rows
]
"""Format, content, what is said, and frames per second."""
