import io
import json

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from isac_track.datasets import load
from isac_track.datasets.formats import FORMATS, read
from isac_track.errors import DataError

# Two people, 2.5 samples a second: 3 walks at 1 m/s along x, 12 walks at 0.5 m/s along y.
T = [0.0, 0.4, 0.8]
THREE = [(0.0, 1.0), (0.4, 1.0), (0.8, 1.0)]
TWELVE = [(5.0, 0.0), (5.0, 0.2), (5.0, 0.4)]
WALK = [(t, "3", *xy) for t, xy in zip(T, THREE, strict=True)] + [
    (t, "12", *xy) for t, xy in zip(T, TWELVE, strict=True)
]


def write(rows, format_name, *, frame_s=0.04):
    """Return rows of (t, id, x, y) as a file; frames are counted from 100."""
    frames = [100 + round(t / frame_s) for t, *_ in rows]
    framed = [(frame, *rest) for frame, (_, *rest) in zip(frames, rows, strict=True)]
    if format_name == "obsmat":
        lines = [f" {f:.9e} {float(i):.9e} {x:.17e} 0 {y:.17e} 9 9 9" for f, i, x, y in framed]
    elif format_name == "social-gan":
        lines = [f"{float(f)}\t{float(i)}\t{x!r}\t{y!r}" for f, i, x, y in framed]
    elif format_name == "pedpy":
        header = ["# framerate: 25.00 fps", "# id frame x/m y/m z/m", ""]
        lines = header + [f"{i} {f} {x!r} {y!r} 1.70" for f, i, x, y in framed]
    elif format_name == "trajnet":
        lines = [
            json.dumps({"track": {"f": f, "p": int(i), "x": x, "y": y}}) for f, i, x, y in framed
        ]
    elif format_name == "csv":
        lines = ["t,id,x,y"] + [f"{t!r},{i},{x!r},{y!r}" for t, i, x, y in rows]
    else:
        buffer = io.BytesIO()
        columns = dict(zip(("t", "id", "x", "y"), zip(*rows, strict=True), strict=True))
        parquet.write_table(
            pa.table({name: list(values) for name, values in columns.items()}), buffer
        )
        return buffer.getvalue()
    return ("\n".join(lines) + "\n").encode()


def fps_of(format_name):
    return 25.0 if format_name in {"obsmat", "social-gan", "trajnet"} else None


@pytest.mark.parametrize("format_name", FORMATS)
def test_every_format_gives_the_same_tracks(format_name):
    tracks, repairs = read(
        data=write(WALK, format_name), path="walk", format=format_name, fps=fps_of(format_name)
    )
    assert tracks.source == ("3", "12")  # as numbers, not as text
    assert tracks.group == ("3", "12")
    np.testing.assert_allclose(tracks.t, T + T, atol=1e-12)
    np.testing.assert_array_equal(tracks.xy, THREE + TWELVE)
    assert repairs == ()


@st.composite
def walks(draw):
    """Rows of some walks at 1 m/s in frames of 0.4 s, none of them alone or with gaps."""
    rows = []
    for person in draw(st.sets(st.integers(-5, 10**9), min_size=1, max_size=4)):
        first = draw(st.integers(0, 50))
        x, y = draw(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)))
        n_steps = draw(st.integers(2, 6))
        rows += [((first + n) * 0.4, str(person), x + 0.4 * n, y) for n in range(n_steps)]
    return rows


@pytest.mark.parametrize("format_name", FORMATS)
@settings(max_examples=30, deadline=None)
@given(rows=walks(), random=st.randoms(use_true_random=False))
def test_what_was_written_is_read_whatever_the_order_of_rows(format_name, rows, random):
    def tracks_of(some_rows):
        data = write(some_rows, format_name)
        return read(data=data, path="walk", format=format_name, fps=fps_of(format_name))

    tracks, repairs = tracks_of(rows)
    assert repairs == ()
    start = min(t for t, *_ in rows)
    written = sorted((int(person), t - start, x, y) for t, person, x, y in rows)
    owner = np.repeat([int(name) for name in tracks.source], np.diff(tracks.offsets))
    np.testing.assert_allclose(
        np.column_stack([owner, tracks.t, tracks.xy]), np.array(written), atol=1e-9, rtol=1e-12
    )
    shuffled = list(rows)
    random.shuffle(shuffled)
    again, repairs = tracks_of(shuffled)
    assert [repair.kind for repair in repairs] in ([], ["unsorted"])
    assert again.source == tracks.source
    np.testing.assert_array_equal(again.t, tracks.t)
    np.testing.assert_array_equal(again.xy, tracks.xy)


@pytest.mark.parametrize("format_name", ["obsmat", "social-gan", "pedpy", "trajnet", "csv"])
@pytest.mark.parametrize(
    "change",
    [
        lambda data: b"\xef\xbb\xbf" + data,
        lambda data: data.replace(b"\n", b"\r\n"),
        lambda data: data.replace(b"\n", b"\r"),
        lambda data: data.rstrip(b"\n"),
        lambda data: data + b"\n\n",
    ],
    ids=["byte-order mark", "CRLF", "CR", "no last line end", "empty lines at the end"],
)
def test_ways_to_write_the_same_text(format_name, change):
    data = change(write(WALK, format_name))
    tracks, repairs = read(data=data, path="walk", format=format_name, fps=fps_of(format_name))
    assert tracks.source == ("3", "12")
    np.testing.assert_array_equal(tracks.xy, THREE + TWELVE)
    assert repairs == ()


def test_velocities_and_heights_of_obsmat_are_not_used():
    data = b"1 1 0 nan 5 nan nan 7\n11 1 0.4 inf 5 9 9 9\n"
    tracks, _ = read(data=data, path="walk", format="obsmat", fps=25.0)
    np.testing.assert_array_equal(tracks.xy, [[0, 5], [0.4, 5]])


def test_pedpy_in_centimetres_is_converted_and_reported():
    data = b"#framerate: 16\n#id\tframe\tx/cm\ty/cm\tz/cm\n1 0 100 50 170\n1 16 200 50 170\n"
    tracks, repairs = read(data=data, path="walk.txt", format="pedpy")
    np.testing.assert_array_equal(tracks.xy, [[1, 0.5], [2, 0.5]])
    np.testing.assert_array_equal(tracks.t, [0, 1])
    assert [(repair.kind, repair.count) for repair in repairs] == [("unit", 2)]


def test_pedpy_without_a_header_takes_fps():
    tracks, _ = read(data=b"7 0 1 2\n7 5 2 2\n", path="walk.txt", format="pedpy", fps=5)
    np.testing.assert_array_equal(tracks.t, [0, 1])


SCENE = b'{"scene": {"id": 0, "p": 1, "s": 0, "e": 20, "fps": 2.5, "tag": [1, []]}}\n'


def test_trajnet_scenes_count_rows_a_second_while_f_counts_video_frames():
    rows = b"".join(
        b'{"track": {"f": %d, "p": 1, "x": %.1f, "y": 2}}\n' % (f, f / 25) for f in (0, 10, 20)
    )
    tracks, repairs = read(data=SCENE + rows, path="a.ndjson", format="trajnet")
    np.testing.assert_allclose(tracks.t, T)
    assert {repair.kind: repair.count for repair in repairs} == {"scene-lines": 1, "frame-clock": 1}
    assert "a.ndjson: line 1: 2.5 rows a second, 10 frames apart" in repairs[1].detail
    same, _ = read(data=SCENE + rows, path="a.ndjson", format="trajnet", fps=25.0)
    np.testing.assert_array_equal(same.t, tracks.t)


def test_csv_columns_in_any_order_with_quotes_spaces_and_others():
    data = b'y, note ,"x", id, t\n1,"a;b", 0," anna ", 1e9\n1,,0.4,anna,1000000000.4\n'
    tracks, repairs = read(data=data, path="walk.csv", format="csv")
    assert tracks.source == ("anna",)
    np.testing.assert_array_equal(tracks.xy, [[0, 1], [0.4, 1]])
    np.testing.assert_allclose(tracks.t, [0, 0.4], atol=1e-6)  # a clock of 1970 is no trouble
    assert [(repair.kind, repair.count) for repair in repairs] == [("ignored-column", 1)]
    assert repairs[0].detail == "walk.csv: column(s) note: not used, 2 rows each"


@pytest.mark.parametrize("written", ["7", "7.0", "7.", "+7.0", "7.000000e+00", "0.7e1"])
def test_csv_ids_that_are_numbers_are_whole_numbers(written):
    data = f"t,id,x,y\n0,{written},0,0\n1,7,1,0\n".encode()
    tracks, _ = read(data=data, path="walk.csv", format="csv")
    assert tracks.source == ("7",)


def test_csv_groups_join_over_common_members_and_never_take_the_name_of_a_track():
    # 1 and 2 are in a; 2 and 3 in b: one cluster. Group "4" is not person 4.
    data = b"t,id,x,y,group\n" + b"".join(
        b"%d,%d,%d,0,%s\n" % (t, person, t, group)
        for person, group in ((1, b"a"), (2, b"a"), (3, b"b"), (4, b""), (5, b"4.0"), (6, b"4"))
        for t in (0, 1)
    )
    data += b"2,2,2,0,b\n"
    tracks, _ = read(data=data, path="walk.csv", format="csv")
    assert tracks.source == ("1", "2", "3", "4", "5", "6")
    assert tracks.group == ("group:a", "group:a", "group:a", "4", "group:4", "group:4")


@pytest.mark.parametrize(
    "ids",
    [
        pa.array([8, 8, 11, 11]),
        pa.array([8.0, 8.0, 11.0, 11.0]),
        pa.array(["8", "8", "11", "11"]),
        pa.array(["8", "8", "11", "11"], pa.large_string()),
        pa.array(["8", "8", "11", "11"]).dictionary_encode(),
    ],
    ids=["integer", "float", "text", "large text", "categories"],
)
def test_parquet_ids_of_any_type(ids):
    t, x = pa.array([0, 1, 0, 1], pa.int32()), pa.array([0, 1, 5, 6], pa.float32())
    buffer = io.BytesIO()
    group = pa.array([None, None, "a", "a"])
    parquet.write_table(pa.table({"id": ids, "t": t, "x": x, "y": x, "group": group}), buffer)
    tracks, repairs = read(data=buffer.getvalue(), path="walk.parquet", format="parquet")
    assert tracks.source == ("8", "11")
    assert tracks.group == ("8", "group:a")
    assert repairs == ()


def test_the_extension_names_some_formats(tmp_path):
    for extension, format_name in (
        (".csv", "csv"),
        (".parquet", "parquet"),
        (".ndjson", "trajnet"),
    ):
        path = tmp_path / f"walk{extension}"
        path.write_bytes(write(WALK, format_name))
        loaded = load(path, fps=fps_of(format_name))
        assert (loaded.name, loaded.format, loaded.simulated) == ("walk", format_name, False)
        assert loaded.path == str(path)
        assert len(loaded.sha256) == 64


def test_no_format_is_guessed_from_the_content(tmp_path):
    path = tmp_path / "walk.txt"
    path.write_bytes(write(WALK, "obsmat"))
    with pytest.raises(DataError, match=r"walk\.txt: the format is not known .* --format \(obsmat"):
        load(path, fps=25)
    assert load(str(path), format="obsmat", fps=25).tracks.source == ("3", "12")
    with pytest.raises(DataError, match=r"unknown format 'obsmet'; did you mean obsmat\?"):
        load(path, format="obsmet")


def test_a_file_called_like_a_known_data_set_does_not_take_its_name(tmp_path):
    path = tmp_path / "students03.csv"
    path.write_bytes(write(WALK, "csv"))
    assert load(path).name == "students03.csv"
