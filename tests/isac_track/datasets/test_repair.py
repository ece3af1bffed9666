import numpy as np
import pytest

from isac_track.datasets import load
from isac_track.datasets.formats import read
from isac_track.datasets.repair import walking_groups
from isac_track.errors import DataError


def recording(*rows, step_s=0.4):
    """Rows (step, id, x) as a csv; y is 0."""
    lines = [f"{step * step_s!r},{person},{x},0" for step, person, x in rows]
    return read(data="\n".join(["t,id,x,y", *lines]).encode(), path="f.csv", format="csv")


def kinds(repairs):
    return {repair.kind: repair.count for repair in repairs}


def test_rows_out_of_order_are_sorted_and_counted():
    tracks, repairs = recording(
        (2, "a", 0.8), (0, "a", 0.0), (1, "a", 0.4), (0, "b", 0), (1, "b", 1)
    )
    np.testing.assert_allclose(tracks.xy[:, 0], [0, 0.4, 0.8, 0, 1])
    assert kinds(repairs) == {"unsorted": 1}
    assert repairs[0].detail == (
        "f.csv: line 3: earlier than the row before of the same id; sorted"
    )


@pytest.mark.parametrize("by", [lambda row: row[:2], lambda row: (row[1], row[0])], ids=["t", "id"])
def test_rows_by_time_or_by_person_are_in_order(by):
    rows = sorted([(step, person, 0.4 * step) for step in range(3) for person in "ab"], key=by)
    tracks, repairs = recording(*rows)
    assert tracks.source == ("a", "b")
    assert repairs == ()


def test_copies_are_dropped_and_counted():
    rows = [(0, "a", 0.0), (1, "a", 0.4), (0, "a", 0.0), (1, "a", 0.4), (1, "a", 0.4)]
    tracks, repairs = recording(*rows)
    assert tracks.t.size == 2
    assert kinds(repairs) == {"unsorted": 1, "duplicate": 3}
    assert (
        "f.csv: lines 4, 5, 6: the same id, time and position again; dropped" in repairs[1].detail
    )


def test_copies_with_a_contradiction_among_them_are_an_error():
    with pytest.raises(
        DataError, match=r"f.csv, line 4: id a is somewhere else at the same time in"
    ):
        recording((0, "a", 0.0), (0, "a", 0.0), (0, "a", 0.1), (1, "a", 0.4))


def test_a_single_sample_is_no_track():
    tracks, repairs = recording((0, "a", 0.0), (1, "a", 0.4), (0, "b", 3.0), (1, "c", 3.0))
    assert tracks.source == ("a",)
    assert kinds(repairs) == {"one-point": 2}
    assert repairs[0].detail == "f.csv: lines 4, 5: a single sample (id b, c); dropped"


def test_a_short_gap_is_kept_and_counted():
    tracks, repairs = recording(*[(step, "a", 0.4 * step) for step in (0, 1, 2, 6, 7, 8)])
    assert tracks.source == ("a",)
    assert tracks.t.size == 6
    assert kinds(repairs) == {"gap": 1}
    assert (
        "f.csv: line 5: behind a gap (longest 1.6 s, usual step 0.4 s); kept" in repairs[0].detail
    )


def test_a_long_gap_makes_two_tracks_of_one_cluster():
    steps = [0, 1, 2, 3, 9, 10, 20, 30, 31]
    tracks, repairs = recording(
        *[(step, "a", 0.4 * step) for step in steps], (0, "b", 9), (1, "b", 9.4)
    )
    assert tracks.source == ("a#1", "a#2", "a#3", "b")  # the one at step 20 is alone
    assert tracks.group == ("a", "a", "a", "b")
    np.testing.assert_array_equal(np.diff(tracks.offsets), [4, 2, 2, 2])
    assert kinds(repairs) == {"split": 3, "one-point": 1}


def test_a_split_never_makes_an_id_that_is_there_already():
    steps = [0, 1, 2, 3, 9, 10]
    rows = [(step, "a", 0.4 * step) for step in steps]
    tracks, _ = recording(*rows, (0, "a#1", 9), (1, "a#1", 9.4))
    assert tracks.source == ("a##1", "a##2", "a#1")


def test_slow_recordings_may_have_longer_gaps():
    tracks, repairs = recording(*[(step, "a", step) for step in (0, 1, 2, 5, 6)], step_s=1.5)
    assert tracks.source == ("a",)
    assert kinds(repairs) == {"gap": 1}  # 4.5 s, but only three steps


def test_a_jump_is_kept_and_counted():
    tracks, repairs = recording(*[(step, "a", x) for step, x in enumerate((0, 0.4, 0.8, 9, 9.4))])
    assert tracks.t.size == 5
    assert kinds(repairs) == {"fast-step": 1}
    assert "f.csv: line 5: over 12 m/s from the sample before; kept" in repairs[0].detail


def test_people_who_never_move_are_no_error():
    tracks, repairs = recording((0, "a", 1), (1, "a", 1))
    assert len(tracks) == 1
    assert repairs == ()


def test_only_the_first_lines_are_named():
    rows = [(0, str(person), person) for person in range(9)]
    _, repairs = recording((0, "a", 0.0), (1, "a", 0.4), *rows)
    assert "f.csv: lines 4, 5, 6, 7, 8 and 4 more: a single sample" in repairs[0].detail


def test_groups_are_transitive_whatever_the_order():
    members = [("1", "x"), ("2", "x"), ("3", "y"), ("2", "z"), ("3", "z"), ("4", "w")]
    expected = ("group:x", "group:x", "group:x", "group:w", "5")
    for turn in range(len(members)):
        turned = members[turn:] + members[:turn]
        assert walking_groups(ids=("1", "2", "3", "4", "5"), members=turned) == expected


def test_a_group_is_never_called_like_another_person():
    assert walking_groups(ids=("a", "group:a"), members=[("a", "a")]) == ("groupgroup:a", "group:a")


def test_students03_is_kept_whole(ucy):
    loaded = load("students03")
    tracks = loaded.tracks
    assert (len(tracks), tracks.t.size) == (428, 21846)
    assert np.diff(tracks.offsets)[tracks.source.index("408")] == 2
    assert kinds(loaded.repairs) == {"gap": 1}  # id 207
    gap_line = (ucy / "students03" / "obsmat.txt").read_text().splitlines()[20435 - 1].split()
    assert "line 20435: behind a gap (longest 0.8 s" in loaded.repairs[0].detail
    assert float(gap_line[1]) == 207
    # 421 and 422 are in two lines of groups.txt, 103 walks with 72, 120 and 123 with 121.
    group = dict(zip(tracks.source, tracks.group, strict=True))
    assert len({group[name] for name in ("6", "18", "421", "422", "423", "425")}) == 1
    assert group["103"] == group["72"]
    assert group["120"] == group["121"] == group["123"]
    alone = [name for name in tracks.source if group[name] == name]
    assert len(alone) == 428 - 234
    assert set(group.values()) & set(tracks.source) == set(alone)


def test_zara01_is_kept_whole(ucy):
    if not (ucy / "zara01").is_dir():
        pytest.skip("needs zara01")
    loaded = load("zara01")
    assert (len(loaded.tracks), loaded.tracks.t.size) == (148, 5024)
    assert loaded.repairs == ()
