"""Odd files: each oddity is mended and counted, named, or refused in one line."""

import io
import os
import sqlite3
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from helpers.recordings import kinds, packed, read_walk
from hypothesis import given, settings
from hypothesis import strategies as st

from isac_track.datasets import TOOLS, load, read
from isac_track.datasets.recording import Reading, parse_columns
from isac_track.errors import DataError

N = 100
T = np.arange(N) / 10.0
X, Y = 1.2 * T, 0.5 * np.sin(T)


def table(t=T, x=X, y=Y, ids="0", names="t,id,x,y", second=""):
    """A csv of one walker or of several ids."""
    ids = [ids] * len(t) if isinstance(ids, str) else ids
    rows = [f"{a},{i},{b!s},{c!s}" for a, i, b, c in zip(t, ids, x, y, strict=True)]
    return ("\n".join([names, *filter(None, [second]), *rows]) + "\n").encode()


def loaded(data, tmp_path, name="f.csv", **options):
    path = tmp_path / name
    path.write_bytes(data)
    return load(path, **options)


def micro():
    t, x = np.repeat(T, 2), np.repeat(X, 2)
    t[1::2] += 1e-6
    x[1::2] += 0.02
    return table(t, x, np.repeat(Y, 2))


def clock_back(by_s):
    t = T.copy()
    t[50:] -= by_s
    return table(t)


def reused(gap_s, away_m):
    t, y = T.copy(), Y.copy()
    t[50:] += gap_s
    y[50:] += away_m
    return table(t, y=y)


def strayed(first, last, away_m=8.0):
    """The id is elsewhere for some samples, and then back on its walk."""
    y = Y.copy()
    y[first:last] += away_m
    return table(y=y)


def still(first, last):
    x, y = X.copy(), Y.copy()
    for values in (x, y):  # and walks on from there
        values[last:] -= values[last - 1] - values[first]
        values[first:last] = values[first]
    return table(x=x, y=y)


@pytest.mark.parametrize(
    ("data", "expected", "n_tracks", "n_clusters"),
    [
        (table(), {}, 1, 1),
        (micro(), {"near-duplicate": N}, 1, 1),
        (clock_back(3.0), {"clock": 1}, 2, 1),
        (clock_back(3.03), {"clock": 1}, 2, 1),
        (clock_back(1.05), {"clock": 1}, 2, 1),
        (reused(1.0, 8.0), {"id-reuse": 1}, 2, 2),
        (reused(0.5, 5.0), {"id-reuse": 1}, 2, 2),
        (reused(1.0, 0.5), {"gap": 1}, 1, 1),
        (reused(0.0, 3.0), {"jump": 1}, 2, 1),
        (reused(0.0, 8.0), {"id-reuse": 1}, 2, 2),
        (reused(0.0, -30.0), {"id-reuse": 1}, 2, 2),
        (strayed(50, 51), {"jump": 2, "one-point": 1}, 2, 1),
        (strayed(50, 65), {"jump": 2}, 3, 1),
        (strayed(50, 90), {"id-reuse": 2}, 3, 3),
        (still(20, 60), {"frozen": 1}, 1, 1),
        (still(20, 30), {}, 1, 1),
    ],
)
def test_the_truth_is_cut_not_invented(data, expected, n_tracks, n_clusters):
    tracks, repairs = read_walk(data, "csv")
    assert kinds(repairs) == expected
    assert (len(tracks), len(set(tracks.group))) == (n_tracks, n_clusters)
    assert all((np.diff(track.t) > 0).all() for track in tracks)
    steps = [
        np.hypot(*np.diff(track.xy, axis=0).T) / np.diff(track.t) for track in tracks
    ]
    assert np.concatenate(steps).max() < 4.0


def test_rows_in_any_order_are_sorted_and_no_clock_is_blamed():
    shuffled = np.random.default_rng(0).permutation(N)
    for order in (shuffled, np.arange(N)[::-1], np.roll(np.arange(N), 40)):
        tracks, repairs = read_walk(table(T[order], X[order], Y[order]), "csv")
        assert len(tracks) == 1
        assert kinds(repairs).keys() == {"unsorted"}
        assert np.allclose(tracks.xy[:, 0], X)


def test_frozen_stretches_are_dropped_on_request(tmp_path):
    dataset = loaded(still(20, 61), tmp_path, drop_frozen=3.0)
    assert kinds(dataset.repairs) == {"frozen-dropped": 1}
    assert dataset.tracks.source == ("0#1", "0#2")
    assert np.allclose(dataset.tracks.t, np.concatenate([T[:21], T[60:]]))


@pytest.mark.parametrize(("how", "x"), [("first", X), ("mean", X + 0.05)])
def test_two_places_at_one_time(tmp_path, how, x):
    places = np.column_stack([X, X + 0.1]).ravel()
    data = table(np.repeat(T, 2), places, np.repeat(Y, 2))
    with pytest.raises(
        DataError, match=rf"{N} such rows\); --on-duplicate first or mean"
    ):
        loaded(data, tmp_path)
    dataset = loaded(data, tmp_path, on_duplicate=how)
    assert kinds(dataset.repairs) == {"same-time": N}
    assert np.allclose(dataset.tracks.xy[:, 0], x)


def test_what_are_not_copies_stays_to_the_bit_when_others_are_averaged():
    t, x = np.append(T, T[-1]), np.append(X, X[-1] + 0.1)
    data = table(t, x, np.append(Y, Y[-1]))
    averaged, _ = read(
        data=data, path="f", format="csv", reading=Reading(on_duplicate="mean")
    )
    plain, _ = read_walk(table(), "csv")
    assert np.array_equal(averaged.xy[:-1], plain.xy[:-1])


START = datetime(2026, 1, 1, 11, tzinfo=UTC)
ISO = [
    (START + timedelta(seconds=float(t))).isoformat(timespec="milliseconds") for t in T
]


@pytest.mark.parametrize(
    ("data", "options"),
    [
        (table(ISO), {}),
        (table([text.replace("+00:00", "Z") for text in ISO]), {}),
        (table([text.replace("T", " ").replace("+00:00", "") for text in ISO]), {}),
        (table([1_700_000_000_000 + round(1000 * t) for t in T]),
         {"columns": "t=t[ms]"}),
        (table([1.7e9 + t for t in T]), {}),
        (table(names="T,ID,X,Y"), {}),
        (table(x=100 * X, y=100 * Y, second="s,,cm,cm"), {}),
        (table(t=1000 * T, second="[ms],[-],[m],[m]"), {}),
        (table(names="time,ped_id,pos_x,pos_y"),
         {"columns": "t=time,id=ped_id,x=pos_x,y=pos_y"}),
        (table(1000 * T, 100 * X, 100 * Y, names="time,who,px,py"),
         {"columns": {"t": "TIME[ms]", "id": "who", "x": "px[cm]", "y": "py[cm]"}}),
        (table(1000 * T, 100 * X, 100 * Y, names="T (ms),ID,X [cm],Y(cm)"), {}),
        (table(1000 * T, names="Time [ms],id,x,y"), {"columns": "t=time [ms]"}),
        (table(T / 60), {"columns": "t=t[min]"}),
        (table([text[:-6].replace("-", "").replace(":", "") + "Z" for text in ISO]),
         {}),
        (table([text.replace("+00:00", " UTC") for text in ISO]), {}),
        (table(x=X / 0.3048, y=Y / 0.3048), {"unit": "ft"}),
        (table(x=X / 0.025, y=Y / 0.025), {"unit": "0.025"}),
    ],
)  # fmt: skip
def test_a_file_is_read_as_its_writer_meant_it(tmp_path, data, options):
    dataset = loaded(data, tmp_path, **options)
    assert np.allclose(dataset.tracks.t, T, atol=2e-6)
    assert np.allclose(dataset.tracks.xy, np.column_stack([X, Y]), atol=1e-9)
    assert "doubt" not in kinds(dataset.repairs)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_time_stamps_of_parquet(tmp_path, unit, zone):
    per_s = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    t = np.arange(10)
    stamps = pa.array((1_700_000_000 + t) * per_s, pa.int64()).cast(
        pa.timestamp(unit, zone)
    )
    data = packed(t=stamps, id=["a"] * 10, x=1.0 * t, y=0.0 * t)
    assert np.array_equal(loaded(data, tmp_path, "f.parquet").tracks.t, t)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (table([1_700_000_000_000 + round(1000 * t) for t in T]),
         r"ms since 1970\? --columns"),
        (table([1_700_000_000 * 10**9 + round(1e9 * t) for t in T]), "ns since 1970"),
        (table([float(np.float32(1.7e9 + 128 * t)) for t in T]), "float32"),
        (table([float(np.float32(1.7e12 + 131_072e3 * t)) for t in T]), "float32"),
        (table([f"12:00:{second:07.4f}" for second in T]),
         "line 2: t .* nor a date of ISO 8601"),
        (table([text.partition(".")[0] + "Z" for text in ISO]),
         r"are the times rounded\?"),
        (table(T / 60), r"--columns t=t\[min\] makes it 1.3 m/s"),
        (table(T * 1e6), r"--columns t=t\[us\] makes it 1.3 m/s"),
        (table(x=X / 0.0254, y=Y / 0.0254), "--unit 0.0254 makes it 1.3 m/s"),
        (table().replace(b",", b";"), r"read_csv\('FILE', sep=';'\)"),
        (b"SQLite format 3\0", "--format jupedsim"),
        (b"\x89HDF\r\n\x1a\n", "--format hdf5"),
        (table(x=7 + X / 111e3, y=51 + Y / 111e3), "--crs degrees"),
        (table([*ISO[:-1], "2026-13-01T00:00:00+00:00"]),
         "line 101: t '2026-13-01T00:00:00"),
        (table([*ISO[:-1], "2026-02-30T00:00:00+00:00"]),
         "line 101: t '2026-02-30T00:00:00"),
        (table(np.round(T * 1000)),
         r"milliseconds for seconds \(of a table: --columns t=t\["),
        (table(x=X / 1000, y=Y / 1000), r"kilometres for metres \(--unit 1000\)"),
        (table([*ISO[:-1], ISO[-1].replace("+00:00", "")]), "some times have a zone"),
        (table([*ISO[:-1], "noon"]), "line 101: t 'noon' is no date"),
        (table(names="a,b,c,d"), r"it has a, b, c, d: --columns t=NAME"),
        (table(names="frame,id,x,y"), r"--columns 't=frame\[25 fps\]' counts frames"),
        (table(names="t [frame],id,x,y"),
         r"column t \[frame\]: unknown unit .* a frame as 25 fps"),
        (table(names="t,id,x [px],y [px]"),
         r"column x \[px\]: unknown unit .* metres by --unit"),
        (table(names="t,id,x [deg],y [deg]"), "unknown unit 'deg' .* --crs degrees"),
        (table(names="sep=,"),
         "line 1: a line for Excel; the first line of csv names the columns"),
        (table(names="\n"), "line 1: empty; the first line"),
        (table(names="0.0,0,-1.5e3,0"), "line 1: numbers; the first line"),
        (table(second="# made by hand"),
         "line 2: 1 .* csv has no comments: leave the line out"),
        (table(second="1,2"), r"line 2: 2 column\(s\) where the header has 4$"),
        (table(second="0,0,1,5,0"), "where the header has 4; a decimal comma would"),
        (b"PK\x03\x04rest", "Excel workbook"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_named_with_the_way_out(tmp_path, data, message):
    with pytest.raises(DataError, match=message) as caught:
        loaded(data, tmp_path)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "way"),
    [("f.xlsx", "read_excel"), ("f.json", "read_json"), ("f.geojson", "geopandas")],
)
def test_files_that_are_no_table_say_how_they_become_one(tmp_path, name, way):
    with pytest.raises(DataError, match=way):
        loaded(b"[{}]", tmp_path, name)


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (table(x=X / 0.3048, y=Y / 0.3048), "feet"),
        (table(t=np.arange(N) * 2.5), "frame numbers"),
        (table(x=X / 15, y=Y / 15), "frame numbers"),
        (table(t=T * 20, x=X * 20, y=Y), "a sample every 2 s"),
    ],
)
def test_units_in_doubt_name_their_likely_cause(tmp_path, data, cause):
    (doubt,) = [
        repair for repair in loaded(data, tmp_path).repairs if repair.kind == "doubt"
    ]
    assert cause in doubt.detail


def test_degrees_become_local_metres(tmp_path):
    north, east = 111_257.0, 70_197.0  # metres a degree at 51 N, of WGS 84
    data = table(x=7 + X / east, y=51 + Y / north)
    dataset = loaded(data, tmp_path, crs="degrees")
    assert kinds(dataset.repairs) == {"crs": N}
    xy = dataset.tracks.xy - dataset.tracks.xy[0]
    assert np.allclose(xy, np.column_stack([X, Y]) - [X[0], Y[0]], atol=0.01)
    with pytest.raises(DataError, match="not degrees"):
        loaded(table(x=X + 500), tmp_path, crs="degrees")


@pytest.mark.parametrize(("longitude", "is_read"), [(7, True), (139, False)])
def test_swapped_degrees_say_so_and_how_to_swap_them(tmp_path, longitude, is_read):
    # Ten people on circles, whose speeds are steady in metres alone.
    angle = np.tile(2 * np.pi * T / T[-1], 10)
    ids = np.repeat(np.arange(10), N).astype(str).tolist()
    metres = 2.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    lat, lon = 51 + metres[:, 1] / 111_257.0, longitude + metres[:, 0] / 70_197.0
    data = table(np.tile(T, 10), lat, lon, ids)
    if is_read:
        dataset = loaded(data, tmp_path, crs="degrees")
        (doubt,) = [note.detail for note in dataset.repairs if note.kind == "doubt"]
    else:
        with pytest.raises(DataError, match="not degrees") as caught:
            loaded(data, tmp_path, crs="degrees")
        doubt = str(caught.value)
    assert "--columns x=y,y=x" in doubt
    swapped = loaded(data, tmp_path, crs="degrees", columns="x=y,y=x")
    assert kinds(swapped.repairs) == {"crs": 10 * N}
    way_m = np.hypot(*np.diff(swapped.tracks.xy[:N], axis=0).T).sum()
    assert way_m == pytest.approx(2 * np.pi * 2.0, rel=2e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": "time"}, "--columns takes t=NAME"),
        ({"columns": "when=t"}, "--columns names t, id"),
        ({"columns": "t=t[days]"}, "unknown unit 'days'"),
        ({"columns": "t=t,t=u"}, "names t twice"),
        ({"columns": "x=x,y=X"}, "takes x for x and for another"),
        ({"columns": ["t"]}, r"--columns takes t=NAME.*, got \['t'\]"),
        ({"columns": "t=t[0 fps]"}, "--columns t: 0 fps: 0 frames per second"),
        (
            {"columns": "x=x[0.1]"},
            r"unknown unit '0.1' \(known: m, cm, mm, ft, yd, in, km\)",
        ),
        ({"columns": "group=team"}, "no column team"),
        ({"fps": 10.0}, r"leave --fps out; of frames: --columns 't=frame\[25 fps\]'"),
        ({"fps": [10]}, r"--fps: the framerate '\[10\]' is not a number"),
        ({"format": 5}, "unknown format 5"),
        (
            {"unit": -1},
            "--unit must be one of m, cm, mm, ft, or metres a unit, got '-1'",
        ),
        ({"drop_frozen": "2"}, "--drop-frozen takes seconds above 0, got '2'"),
        ({"on_duplicate": "last"}, "--on-duplicate must be one of"),
        ({"crs": "utm"}, "--crs must be degrees"),
        ({"drop_frozen": 0.0}, "--drop-frozen takes seconds above 0"),
        ({"drop_frozen": float("nan")}, "--drop-frozen takes seconds above 0"),
    ],
)
def test_options_that_mean_nothing(tmp_path, options, message):
    with pytest.raises(DataError, match=message):
        loaded(table(), tmp_path, **options)


UNITS = [
    ("x [cm]", "cm", 0.01),
    ("x(cm)", "centimetre", 0.01),
    ("x/cm", None, 0.01),
    ("x [yd]", None, 0.9144),
    ("x/in", "0.0254", 0.0254),
    ("x", "yards", 0.9144),
    ("x", "m", 1.0),
    ("x [cm]", "m", "--unit m contradicts the file's header: cm"),
    ("x [ft]", "cm", "--unit cm contradicts the file's header: ft"),
]  # fmt: skip


@pytest.mark.parametrize(("header", "unit", "metres"), UNITS)
def test_a_unit_of_the_header_and_the_option_agree_or_are_refused(
    tmp_path, header, unit, metres
):
    scale = 0.01 if isinstance(metres, str) else metres
    data = table(
        x=X / scale, y=Y / scale, names=f"t,id,{header},{header.replace('x', 'y')}"
    )
    if isinstance(metres, str):
        with pytest.raises(DataError, match=metres):
            loaded(data, tmp_path, unit=unit)
        return
    dataset = loaded(data, tmp_path, unit=unit)
    assert np.allclose(dataset.tracks.xy, np.column_stack([X, Y]))
    assert ("unit" in kinds(dataset.repairs)) is (metres != 1.0)


def test_x_and_y_may_have_two_units_and_degrees_have_none_of_a_header(tmp_path):
    dataset = loaded(table(x=X / 0.3048, names="t,id,x/ft,y"), tmp_path)
    assert np.allclose(dataset.tracks.xy, np.column_stack([X, Y]))
    (note,) = [repair for repair in dataset.repairs if repair.kind == "unit"]
    assert "x in ft and y in m; converted to m" in note.detail
    data = table(x=7 + X / 7e4, y=51 + Y / 111e3, names="t,id,x/m,y/m")
    with pytest.raises(
        DataError, match="--crs degrees contradicts the header or --columns"
    ):
        loaded(data, tmp_path, crs="degrees")


@pytest.mark.parametrize(
    ("rate", "columns"), [("25 fps", None), ("12.5fps", "t=t [12.5fps]")]
)
def test_a_table_may_count_frames(tmp_path, rate, columns):
    fps = float(rate.removesuffix("fps"))
    name = "t" if columns else f"t [{rate}]"
    dataset = loaded(
        table(np.arange(N) + 7, names=f"{name},id [-],x,y"), tmp_path, columns=columns
    )
    assert np.allclose(dataset.tracks.t, np.arange(N) / fps)


@pytest.mark.parametrize(
    ("header", "columns"),
    [("group", None), ("GROUP", None), ("Group (name)", None), ("team", "group=team")],
)
def test_a_group_column_is_matched_as_other_columns_are(tmp_path, header, columns):
    walkers = [
        f"{t},{person},{x},{3 * person},a"
        for person in (1, 2)
        for t, x in zip(T, X, strict=True)
    ]
    data = "\n".join([f"t,id,x,y,{header}", *walkers]).encode()
    dataset = loaded(data, tmp_path, columns=columns)
    assert set(dataset.tracks.group) == {"group:a"}
    assert "ignored-column" not in kinds(dataset.repairs)


def test_a_quoted_comma_before_a_date_ends_no_field(tmp_path):
    rows = [f'"Doe, Jo",{t},{x},0' for t, x in zip(ISO, X, strict=True)]
    dataset = loaded("\n".join(["id,t,x,y", *rows]).encode(), tmp_path)
    assert dataset.tracks.source == ("Doe, Jo",)
    assert np.isclose(dataset.tracks.t[-1], T[-1])


def test_rounded_degrees_are_the_cause_that_is_named(tmp_path):
    data = table(x=np.round(7 + X / 7e4, 4), y=np.round(51 + Y / 111e3, 4))
    with pytest.raises(DataError, match="degrees of too few decimals"):
        loaded(data, tmp_path, crs="degrees")


FRAME = pd.DataFrame({"t": T, "id": 1, "x": X, "y": Y})


@pytest.mark.parametrize(
    "changed",
    [
        {"x": pd.Series(X).astype("category"), "t": pd.Series(T).astype("category")},
        {"x": pd.arrays.SparseArray(X), "id": pd.arrays.SparseArray([1] * N)},
        {"x": pd.Series(X).astype("Float64"), "id": pd.Series([1] * N).astype("Int8")},
        {
            "y": pd.Series(Y).astype(object),
            "id": pd.Series([True] * N).astype("UInt64"),
        },
    ],
)
def test_a_frame_of_odd_types_is_read(changed):
    dataset = load(FRAME.assign(**changed))
    assert np.array_equal(dataset.tracks.xy, np.column_stack([X, Y]))
    assert dataset.tracks.source == ("1",)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"id": [1, "1"] * (N // 2)},
            "column id cannot be read .* convert it first, all to",
        ),
        ({"id": [10**30] * N}, "column id cannot be read"),
        ({"x": X + 0j}, "column x cannot be read"),
        ({"x": [str(x) for x in X]}, "column x holds .*string, not numbers of metres"),
        ({"id": [b"a"] * N}, "ids and groups must be numbers or text, not binary"),
    ],
)
def test_a_frame_that_cannot_be_read_names_its_column(changed, message):
    with pytest.raises(DataError, match=message) as caught:
        load(FRAME.assign(**changed))
    assert len(str(caught.value).splitlines()) == 1


def test_a_frame_rate_may_be_a_text(tmp_path):
    data = b"0 1 0 0\n10 1 1 0\n20 1 2 0\n"
    dataset = loaded(data, tmp_path, format="social-gan", fps="10")
    assert dataset.tracks.t.tolist() == [0.0, 1.0, 2.0]


def test_a_frame_is_a_recording_and_its_content_its_hash():
    frame = pd.DataFrame({"t": T, "id": "0", "x": X, "y": Y})
    dataset = load(frame)
    assert (dataset.name, dataset.path, dataset.format) == ("DataFrame",) * 3
    assert np.array_equal(dataset.tracks.xy, np.column_stack([X, Y]))
    assert load(frame.rename(columns=str.upper)).sha256 == dataset.sha256
    assert load(frame.assign(x=2 * X)).sha256 != dataset.sha256
    assert load(Polars(frame)).sha256 == dataset.sha256
    assert load(frame.set_index("id")).sha256 == dataset.sha256
    lasting = load(frame.assign(t=pd.to_timedelta(T, unit="s")))
    assert np.allclose(lasting.tracks.t, T)
    with pytest.raises(DataError, match="not list"):
        load([1, 2])
    with pytest.raises(
        DataError, match="t holds string, not numbers of seconds; convert"
    ):
        load(frame.assign(t="0.1 s"))
    with pytest.raises(DataError, match="no column y"):
        load(frame.drop(columns="y"))


def test_a_frame_of_polars():
    polars = pytest.importorskip("polars")
    frame = polars.DataFrame({"t": T, "id": ["0"] * N, "x": X, "y": Y})
    dataset = load(frame)
    assert dataset.sha256 == load(frame.to_pandas()).sha256
    assert (
        load(frame.with_columns(polars.col("id").cast(polars.Categorical))).sha256
        == dataset.sha256
    )
    with pytest.raises(DataError, match=r"pass frame.collect\(\)"):
        load(frame.lazy())


class Polars:
    """What a frame of another library offers."""

    def __init__(self, frame):
        self.to_pandas = lambda: frame


HEAD = "# id frame x y z\n0 0 0 0 170\n0 1 0.1 0 170\n0 2 0.2 0 170\n"


@pytest.mark.parametrize(
    ("line", "last_s"),
    [
        ("framerate: 12.5", 0.16),
        ("framerate: 25/2", 0.16),
        ("framerate of camera 2: 12.5", 0.16),
        ("framerate: 12,5", "'12,5' is not a single number; write a decimal point"),
        ("framerate: 12 , 5", "is not a single number"),
        ("framerate: 1,000", "decimal point"),
        ("framerate: 30000/1001", 2 * 1001 / 30000),
        ("frame rate = 16 1/s", 0.125),
        ("framerate: 12.5\n# z: body height in cm", 0.16),
        ("framerate: 25-30", "'25-30' is not a"),
        ("fps: 25\u201330", "is not a single"),
        ("fps: 25 to 30", "'25 to 30' is not a"),
        ("framerate: 25 - 30 fps", "is not a single"),
        ("framerate: 25 (video), 12.5 (tracks)",
         r"'25 \(video\), 12.5 \(tracks\)' is not a"),
        ("framerate: 25; 12.5", "is not a single"),
        ("framerate: 25\n# framerate: 12.5",
         r"two framerates: 25 \(line 1\) and 12.5 \(line 2\)"),
        ("framerate: 25\n# fps: 25.0", 0.08),
        ("framerate: 12.5\n# position error in cm", 0.16),
        ("framerate: 12.5\n# distances to walls in cm", 0.16),
        ("framerate: 12.5\n# positions, measured in cm and converted to m", 0.16),
        ("framerate: 25 1/s of 2 cameras", 0.08),
        ("framerate: 25/0", "not a frame rate above 0"),
    ],
)  # fmt: skip
def test_headers_say_the_rate_they_say_or_are_refused(line, last_s):
    data = f"# {line}\n{HEAD}".encode()
    if isinstance(last_s, str):
        with pytest.raises(DataError, match=last_s):
            read_walk(data, "pedpy", None)
        return
    tracks, _ = read_walk(data, "pedpy", None)
    assert tracks.t[-1] == pytest.approx(last_s)
    assert tracks.xy[-1, 0] == 0.2


def jupedsim(tmp_path):
    with sqlite3.connect(tmp_path / "j.sqlite") as database:
        database.execute("CREATE TABLE metadata(key TEXT, value TEXT)")
        database.execute("INSERT INTO metadata VALUES ('fps', '10.0')")
        database.execute(
            "CREATE TABLE trajectory_data(frame INT, id INT, pos_x REAL, pos_y REAL)"
        )
        rows = [(n, 1, X[n], Y[n]) for n in range(N)]
        database.executemany("INSERT INTO trajectory_data VALUES (?, ?, ?, ?)", rows)
    database.close()
    return (tmp_path / "j.sqlite").read_bytes()


def lines(head, row):
    rows = [row.format(n=n, t=T[n], x=X[n], y=Y[n], **boxes(n)) for n in range(N)]
    return ("\n".join([*head, *rows]) + "\n").encode()


def boxes(n):
    """A box around a person, in pixels of 2.5 cm."""
    x, y = X[n] / 0.025, Y[n] / 0.025
    return {"left": x - 5, "right": x + 5, "up": y - 20, "foot": y, "low": y + 20}


VISWALK = ["$VISION", "* about", "$PEDESTRIAN:SIMSEC;NO;COORDCENTX;COORDCENTY"]
VADERE = ["pedestrianId simTime endTime startX-PID1 startY-PID1 endX-PID1 endY-PID1"]
SDD = '1 {left} {up} {right} {low} {n} 0 0 0 "Pedestrian"'
IGNORED = b"5,2,0,0,9,9,0,1,1\n5,3,0,0,9,9,1,3,1\n6,3,0,0,9,9,1,8,1\n"
LOST = '1 0 0 10 10 500 1 0 0 "Pedestrian"\n2 0 0 9 9 5 0 0 0 "Biker"\n'


@pytest.mark.parametrize(
    ("name", "data", "options", "expected"),
    [
        ("jupedsim", jupedsim, {}, {}),
        ("viswalk", lines(VISWALK, "{t};1;{x};{y}"), {}, {}),
        ("viswalk", lines(["$PEDESTRIAN:NO;SIMSEC;COORDCENT"], "1;{t};{x} {y} 0"), {},
         {}),
        ("vadere", lines(VADERE, "1 {t} 0 {x} {y} 0 0"), {}, {}),
        ("mot", lines([], "{n},1,{left},{up},10,20,1,-1,-1,-1"),
         {"fps": 10, "unit": "0.025"}, {"unit": N}),
        ("vadere",
         lines(["#IDXCOL=1,DATACOL=6,SEP=' '", *VADERE], "1 {t} 0 {x} {y} 0 0"),
         {}, {}),
        ("mot", lines([], "{n},1,{left},{up},10,20,1,1,0.9") + IGNORED,
         {"fps": 10, "unit": "0.025"}, {"unit": N, "lost": 1, "other-label": 2}),
        ("sdd", lines([], SDD) + LOST.encode(), {"fps": 10, "unit": "0.025"},
         {"unit": N, "lost": 1, "other-label": 1}),
    ],
)  # fmt: skip
def test_formats_of_the_neighbours(tmp_path, name, data, options, expected):
    data = data(tmp_path) if callable(data) else data
    dataset = loaded(data, tmp_path, "f.xyz", format=name, **options)
    assert np.allclose(dataset.tracks.t, T)
    assert np.allclose(dataset.tracks.xy, np.column_stack([X, Y]))
    assert kinds(dataset.repairs) == expected


@pytest.mark.parametrize("fps", [10.0, None])
def test_hdf5_of_the_archive(tmp_path, fps):
    h5py = pytest.importorskip("h5py")
    fields = [("id", int), ("frame", int), ("x", float), ("y", float), ("z", float)]
    rows = np.array([(1, n, X[n], Y[n], 1.7) for n in range(N)], dtype=fields)
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file["trajectory"] = rows
        file["trajectory"].attrs["fps"] = 10.0
    dataset = loaded(buffer.getvalue(), tmp_path, "f.h5", format="hdf5", fps=fps)
    assert np.allclose(dataset.tracks.xy, np.column_stack([X, Y]))


@pytest.mark.parametrize(
    "name", ["jupedsim", "hdf5", "vadere", "mot", "sdd", "viswalk"]
)
@pytest.mark.parametrize(
    "data", [b"", b"\0\1\2", b"a b c\n1 2 3\n", b'"', b"$PED:\n1;2\n"]
)
def test_no_neighbour_lets_another_error_out(name, data):
    with pytest.raises(DataError):
        read(
            data=data,
            path="f",
            format=name,
            fps=None if name in {"vadere", "viswalk"} else 10,
        )


@settings(derandomize=True, max_examples=40, deadline=timedelta(seconds=5))
@given(
    name=st.sampled_from([*TOOLS]), data=st.binary(max_size=60) | st.text(max_size=60)
)
def test_any_bytes_are_tracks_or_refused_in_one_line(name, data):
    data = data.encode() if isinstance(data, str) else data
    tracks, refusal = None, "f"
    try:
        tracks, _ = read(
            data=data,
            path="f",
            format=name,
            fps=None if name in {"vadere", "viswalk"} else 10,
        )
    except DataError as error:
        refusal = str(error)
    assert refusal.startswith("f")  # the file is named
    assert "\n" not in refusal
    assert tracks is None or (len(tracks) > 0 and np.isfinite(tracks.xy).all())


def test_columns_may_hold_brackets_that_are_no_unit():
    assert parse_columns("id=who[1]")["id"].name == "who[1]"


ODD = Path(os.environ.get("ISAC_TRACK_DATA", "nowhere")) / "odd"


@pytest.mark.skipif(not ODD.is_dir(), reason="needs odd: set ISAC_TRACK_DATA")
@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("base.csv", {}, {}),
        ("microstep.csv", {}, {"near-duplicate": 120}),
        ("clockback.csv", {}, {"clock": 1}),
        ("idreuse.csv", {}, {"id-reuse": 1}),
        ("twosensors.csv", {"on_duplicate": "mean"}, {"same-time": 6000}),
        ("iso.csv", {}, {}),
        ("epoch_ms.csv", {"columns": "t=t[ms]"}, {}),
        ("latlon.csv", {"crs": "degrees", "columns": "x=y,y=x"}, {"crs": 6000}),
        ("latlon.csv", {"crs": "degrees"}, {"crs": 6000, "doubt": 1}),
        ("feet.csv", {}, {"doubt": 1}),
        ("feet.csv", {"unit": "ft"}, {"unit": 6000}),
        ("frames_as_seconds.csv", {}, {"doubt": 1}),
        ("names.csv", {"columns": "t=time,id=ped_id,x=pos_x,y=pos_y"}, {}),
        ("upper.csv", {}, {}),
        ("fps_fraction.txt", {}, {"header": 1}),
        ("height_in_cm.txt", {}, {"header": 1}),
    ],
)
def test_the_odd_files(name, options, expected):
    assert kinds(load(ODD / name, **options).repairs) == expected
