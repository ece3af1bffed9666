import random

import numpy as np
import pyarrow as pa
import pytest
from helpers import recordings
from helpers.recordings import (
    TEXT,
    THREE,
    TWELVE,
    WALK,
    T,
    kinds,
    packed,
    read_walk,
    same,
    written,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from isac_track.datasets import FORMATS, load, read
from isac_track.errors import DataError


@st.composite
def walks(draw):
    """Rows of walks at 1 m/s in frames of 0.4 s, without gaps."""
    rows = []
    for person in draw(st.sets(st.integers(-5, 10**9), min_size=1, max_size=4)):
        first = draw(st.integers(0, 50))
        x, y = draw(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)))
        n_steps = draw(st.integers(2, 6))
        rows += [
            ((first + n) * 0.4, str(person), x + 0.4 * n, y) for n in range(n_steps)
        ]
    return rows


@pytest.mark.parametrize("format_name", FORMATS)
@settings(max_examples=30, deadline=None)
@given(rows=walks(), seed=st.integers(0, 99))
def test_what_was_written_is_read_whatever_the_order_of_rows(format_name, rows, seed):
    tracks, repairs = read_walk(written(rows, format_name), format_name)
    assert repairs == ()
    start = min(t for t, *_ in rows)
    expected = sorted((int(person), t - start, x, y) for t, person, x, y in rows)
    owner = np.repeat([int(name) for name in tracks.source], np.diff(tracks.offsets))
    np.testing.assert_allclose(
        np.column_stack([owner, tracks.t, tracks.xy]),
        np.array(expected),
        atol=1e-9,
        rtol=1e-12,
    )
    shuffled = random.Random(seed).sample(rows, len(rows))
    again, repairs = read_walk(written(shuffled, format_name), format_name)
    assert kinds(repairs).keys() <= {"unsorted"}
    assert same(again, tracks)


CHANGES = {
    "as it is": lambda data: data,
    "byte-order mark": lambda data: b"\xef\xbb\xbf" + data,
    "CRLF": lambda data: data.replace(b"\n", b"\r\n"),
    "CR": lambda data: data.replace(b"\n", b"\r"),
    "no last line end": lambda data: data.rstrip(b"\n"),
    "empty lines at the end": lambda data: data + b"\n\n",
}


@pytest.mark.parametrize(
    ("format_name", "change"),
    [*((name, change) for name in TEXT for change in CHANGES), ("parquet", "as it is")],
)
def test_every_format_gives_the_same_tracks_in_any_writing(format_name, change):
    tracks, repairs = read_walk(
        CHANGES[change](written(WALK, format_name)), format_name
    )
    assert tracks.source == tracks.group == ("3", "12")  # as numbers, not as text
    np.testing.assert_allclose(tracks.t, T + T, atol=1e-12)
    np.testing.assert_array_equal(tracks.xy, THREE + TWELVE)
    assert repairs == ()


def test_velocities_and_heights_of_obsmat_are_not_used():
    tracks, _ = read_walk(b"1 1 0 nan 5 nan nan 7\n11 1 0.4 inf 5 9 9 9\n", "obsmat")
    np.testing.assert_array_equal(tracks.xy, [[0, 5], [0.4, 5]])


def test_pedpy_in_centimetres_is_converted_and_reported():
    data = (
        b"#framerate: 16\n#id\tframe\tx/cm\ty/cm\tz/cm\n1 0 100 50 170\n1 16 200 50"
        b" 170\n"
    )
    tracks, repairs = read_walk(data, "pedpy")
    np.testing.assert_array_equal(tracks.xy, [[1, 0.5], [2, 0.5]])
    np.testing.assert_array_equal(tracks.t, [0, 1])
    assert kinds(repairs) == {"unit": 2}


def test_trajnet_scenes_count_rows_a_second_while_f_counts_video_frames():
    data = (
        b'{"scene": {"id": 0, "p": 1, "s": 0, "e": 20, "fps": 2.5, "tag": [1, []]}}\n'
    )
    for f in (0, 10, 20):
        data += b'{"track": {"f": %d, "p": 1, "x": %.1f, "y": 2}}\n' % (f, f / 25)
    tracks, repairs = read_walk(data, "trajnet", fps=None)
    np.testing.assert_allclose(tracks.t, T)
    assert kinds(repairs) == {"scene-lines": 1, "frame-clock": 1}
    assert "f, line 1: 2.5 rows a second, 10 frames apart" in repairs[1].detail
    assert same(read_walk(data, "trajnet", fps=25.0)[0], tracks)


def test_csv_columns_in_any_order_with_quotes_spaces_and_others():
    data = b'y, note ,"x", id, t\n1,"a;b", 0," anna ", 1e9\n1,,0.4,anna,1000000000.4\n'
    tracks, repairs = read_walk(data, "csv")
    assert tracks.source == ("anna",)
    np.testing.assert_array_equal(tracks.xy, [[0, 1], [0.4, 1]])
    # The clock counts from 1970.
    np.testing.assert_allclose(tracks.t, [0, 0.4], atol=1e-6)
    assert kinds(repairs) == {"ignored-column": 1}
    assert repairs[0].detail == "f: column(s) note: not used, 2 rows each"


@pytest.mark.parametrize("number", ["7", "7.0", "7.", "+7.0", "7.000000e+00", "0.7e1"])
def test_csv_ids_that_are_numbers_are_whole_numbers(number):
    tracks, _ = read_walk(f"t,id,x,y\n0,{number},0,0\n1,7,1,0\n".encode(), "csv")
    assert tracks.source == ("7",)


def test_csv_groups_join_over_common_members_and_never_take_the_name_of_a_track():
    # 1 and 2 are in a; 2 and 3 in b: one cluster. Group "4" is not person 4.
    data = b"t,id,x,y,group\n" + b"".join(
        b"%d,%d,%d,0,%s\n" % (t, person, t, group)
        for person, group in (
            (1, b"a"),
            (2, b"a"),
            (3, b"b"),
            (4, b""),
            (5, b"4.0"),
            (6, b"4"),
        )
        for t in (0, 1)
    )
    tracks, _ = read_walk(data + b"2,2,2,0,b\n", "csv")
    assert tracks.source == ("1", "2", "3", "4", "5", "6")
    assert tracks.group == ("group:a", "group:a", "group:a", "4", "group:4", "group:4")


TEXTS = pa.array(["8", "8", "11", "11"])


@pytest.mark.parametrize(
    "ids",
    [
        *(
            TEXTS.cast(kind)
            for kind in (pa.int64(), pa.float64(), pa.string(), pa.large_string())
        ),
        TEXTS.dictionary_encode(),
    ],
    ids=lambda ids: str(ids.type),
)
@pytest.mark.parametrize(
    "row_group_size", [None, 1], ids=["one row group", "four row groups"]
)
def test_parquet_ids_of_any_type(ids, row_group_size):
    t, x = pa.array([0, 1, 0, 1], pa.int32()), pa.array([0, 1, 5, 6], pa.float32())
    group = pa.array([None, None, "a", None])
    data = packed(id=ids, t=t, x=x, y=x, group=group, row_group_size=row_group_size)
    tracks, repairs = read_walk(data, "parquet")
    assert (tracks.source, tracks.group, repairs) == (("8", "11"), ("8", "group:a"), ())


@pytest.mark.parametrize(
    ("name", "format_name"),
    [("walk.csv", "csv"), ("walk.parquet", "parquet"), ("walk.NDJSON", "trajnet")],
)
def test_the_extension_names_some_formats(tmp_path, name, format_name):
    path = tmp_path / name
    path.write_bytes(written(WALK, format_name))
    loaded = load(path, fps=recordings.stated_fps(format_name))
    assert (loaded.name, loaded.format, loaded.simulated) == (
        "walk",
        format_name,
        False,
    )
    assert (loaded.path, len(loaded.sha256)) == (str(path), 64)
    # Rows of another recording must never pass for those of a known one.
    path = path.rename(tmp_path / f"students03{path.suffix}")
    assert load(path, fps=recordings.stated_fps(format_name)).name == path.name


# The walks of `WALK` at 25 frames a second: id, frame, x, y in m.
ROWS = [(int(person), round(25 * t), x, y) for t, person, x, y in WALK]


@pytest.mark.parametrize(
    ("header", "row", "unit"),
    [
        (
            "# framerate: 25 fps\n# id frame x/m y/m z/m markerID",
            "{i} {f} {x} {y} 1.7 7{i}",
            None,
        ),
        (
            "# framerate: 25.00\n#ID\tFR\tX\tY\tZ\tANGLE",
            "{i}\t{f}\t{x}\t{y}\t0\t0",
            None,
        ),
        ("# fps = 25\n# PersID Frame X [m] Y [m]", "{i} {f} {x} {y}", None),
        ("# frame rate: 25\n# frame id y/m x/m", "{f} {i} {y} {x}", None),
        ("# framerate: 25\n# id frame x/cm y/cm", "{i} {f} {x}e2 {y}e2", "cm"),
        ("# framerate: 25\n# id frame x/mm y/mm", "{i} {f} {x}e3 {y}e3", "mm"),
        (
            "# framerate: 25\n# id frame x y\n# lengths in mm",
            "{i} {f} {x}e3 {y}e3",
            "mm",
        ),
    ],
)
def test_a_header_names_columns_unit_and_frame_rate(tmp_path, header, row, unit):
    path = tmp_path / "walk.txt"
    rows = [row.format(i=i, f=f, x=x, y=y) for i, f, x, y in ROWS]
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    dataset = load(path)
    assert (dataset.format, dataset.tracks.source) == ("pedpy", ("3", "12"))
    np.testing.assert_allclose(dataset.tracks.xy, THREE + TWELVE, atol=1e-12)
    np.testing.assert_allclose(dataset.tracks.t, T + T, atol=1e-12)
    details = {repair.kind: repair.detail for repair in dataset.repairs}
    expected = {"header"} | ({"unit"} if unit else set())
    assert details.keys() == expected | ({"people"} if "marker" in header else set())
    assert "25 frames a second" in details["header"]
    assert unit is None or f"positions in {unit}, as the header says" in details["unit"]


def test_a_sentence_about_columns_names_none(tmp_path):
    path = tmp_path / "walk.txt"
    path.write_text(
        "# framerate: 25\n# first the id and frame, then x and y\n3 0 0 0\n3 1 0 0\n"
    )
    with pytest.raises(
        DataError, match="no header names id, frame, x and y; give --format"
    ):
        load(path)


@pytest.mark.parametrize(("unit", "factor"), [("m", 1), ("cm", 100), ("mm", 1000)])
@pytest.mark.parametrize("format_name", FORMATS)
def test_lengths_are_in_the_unit_of_the_option(format_name, unit, factor):
    rows = [(t, person, factor * x, factor * y) for t, person, x, y in WALK]
    data = written(rows, format_name).replace(b"/m", f"/{unit}".encode())
    rate = recordings.stated_fps(format_name)
    tracks, repairs = read(data=data, path="f", format=format_name, fps=rate, unit=unit)
    np.testing.assert_allclose(tracks.xy, THREE + TWELVE, rtol=1e-12)
    assert kinds(repairs) == ({} if unit == "m" else {"unit": len(rows)})


def test_another_unit_is_proposed_but_never_used_and_a_contradiction_is_named():
    rows = [(t, person, 1000 * x, 1000 * y) for t, person, x, y in WALK]
    with pytest.raises(DataError, match=r"\(--unit mm makes it 0\.75 m/s\)"):
        read_walk(written(rows, "csv"), "csv")
    contradiction = "--unit cm contradicts the file's header: m"
    for unit, message in (("cm", contradiction), ("furlong", "one of m,")):
        with pytest.raises(DataError, match=message):
            read(data=written(WALK, "pedpy"), path="f", format="pedpy", unit=unit)


def test_no_format_is_guessed_from_the_content(tmp_path):
    path = tmp_path / "walk.txt"
    path.write_bytes(written(WALK, "obsmat"))
    with pytest.raises(
        DataError, match=r"walk\.txt: the format is not known .* --format \(obsmat"
    ):
        load(path, fps=25)
    assert load(str(path), format="obsmat", fps=25).tracks.source == ("3", "12")
    with pytest.raises(
        DataError, match=r"unknown format 'obsmet'; did you mean obsmat\?"
    ):
        load(path, format="obsmet")
