import numpy as np
import pytest
from helpers.recordings import kinds, read_walk

from isac_track.datasets import load
from isac_track.datasets.repair import walking_groups
from isac_track.errors import DataError


def recording(*rows, step_s=0.4):
    """Rows (step, id, x) as a csv; y is 0."""
    lines = [f"{step * step_s!r},{person},{x},0" for step, person, x in rows]
    return read_walk("\n".join(["t,id,x,y", *lines]).encode(), "csv")


def walk(*steps, person="a", speed=0.4):
    """Rows of one person who walks on at `speed` m a step."""
    return [(step, person, speed * step) for step in steps]


A, B = walk(0, 1), walk(0, 1, person="b")


@pytest.mark.parametrize(
    ("rows", "expected", "detail"),
    [
        ([*walk(2, 0, 1), *B], {"unsorted": 1},
         "f: line 3: earlier than the row before of the same id; sorted"),
        ([*A, *A, A[1]], {"unsorted": 1, "duplicate": 3},
         "f: lines 4, 5, 6: the same id, time and position again; dropped"),
        ([*A, (0, "b", 3.0), (1, "c", 3.0)], {"one-point": 2},
         "f: lines 4, 5: a single sample of an id; dropped"),
        ([*A, *((0, str(person), person) for person in range(9))], {"one-point": 9},
         "f: lines 4, 5, 6, 7, 8 and 4 more: a single sample"),
        (walk(0, 1, 2, 6, 7, 8), {"gap": 1},
         "f: line 5: behind a gap (longest 1.6 s, usual step 0.4 s); to be interpolated"),
        ([(step, "a", x) for step, x in enumerate((0, 0.4, 0.8, 9, 9.4))],
         {"id-reuse": 1}, "f: line 5: at another place, where no walk leads; the id"),
        ([(step, "a", x) for step, x in enumerate((0, 0.4, 9, 9.4, 1.6, 2))],
         {"jump": 2},
         "f: lines 4, 6: from the sample before, further than anybody walks; cut"),
        ([*walk(0, 1, 2, 3, 9, 10, 20, 30, 31), *B], {"split": 3, "one-point": 1},
         "f: lines 6, 8, 9: behind a gap (longest 4 s, usual step 0.4 s); too long"),
        # People who never move, and rows by time or by person, are nothing to repair.
        ([(0, "a", 1), (1, "a", 1)], {}, None),
        ([*walk(0, 1, 2), *walk(0, 1, 2, person="b")], {}, None),
        (sorted([*walk(0, 1, 2), *walk(0, 1, 2, person="b")]), {}, None),
    ],
)  # fmt: skip
def test_what_is_mended_is_counted_and_says_where(rows, expected, detail):
    tracks, repairs = recording(*rows)
    assert kinds(repairs) == expected
    assert detail is None or any(detail in repair.detail for repair in repairs)
    dropped = sum(expected.get(kind, 0) for kind in ("duplicate", "one-point"))
    assert tracks.t.size == len(rows) - dropped
    assert {group.removesuffix("~2") for group in tracks.group} <= {"a", "b"}
    for track in tracks:  # sorted, without copies
        assert (np.diff(track.t) > 0).all()


def test_copies_with_a_contradiction_among_them_are_an_error():
    with pytest.raises(
        DataError, match=r"f, line 4: id a is somewhere else at the same time in"
    ):
        recording((0, "a", 0.0), (0, "a", 0.0), (0, "a", 0.1), (1, "a", 0.4))


def test_a_long_gap_makes_two_tracks_of_one_cluster_with_names_that_nobody_has():
    tracks, _ = recording(*walk(0, 1, 2, 3, 9, 10, 20, 30, 31), *B)
    assert tracks.source == ("a#1", "a#2", "a#3", "b")  # the one at step 20 is alone
    assert tracks.group == ("a", "a", "a", "b")
    np.testing.assert_array_equal(np.diff(tracks.offsets), [4, 2, 2, 2])
    tracks, _ = recording(*walk(0, 1, 2, 3, 9, 10), (0, "a#1", 9), (1, "a#1", 9.4))
    assert tracks.source == ("a##1", "a##2", "a#1")


def test_slow_recordings_may_have_longer_gaps():
    tracks, repairs = recording(*walk(0, 1, 2, 5, 6, speed=1), step_s=1.5)
    # 4.5 s, but only three steps
    assert (tracks.source, kinds(repairs)) == (("a",), {"gap": 1})


def test_groups_are_transitive_whatever_the_order():
    members = [("1", "x"), ("2", "x"), ("3", "y"), ("2", "z"), ("3", "z"), ("4", "w")]
    expected = ("group:x", "group:x", "group:x", "group:w", "5")
    for turn in range(len(members)):
        turned = members[turn:] + members[:turn]
        assert walking_groups(ids=("1", "2", "3", "4", "5"), members=turned) == expected


def test_a_group_is_never_called_like_another_person():
    assert walking_groups(ids=("a", "group:a"), members=[("a", "a")]) == (
        "groupgroup:a",
        "group:a",
    )


def test_students03_is_read_whole(ucy):
    loaded = load("students03")
    tracks = loaded.tracks
    assert (len(tracks), tracks.t.size) == (428, 21846)
    assert np.diff(tracks.offsets)[tracks.source.index("408")] == 2
    assert kinds(loaded.repairs) == {"gap": 1}  # id 207
    gap_line = (
        (ucy / "students03" / "obsmat.txt").read_text().splitlines()[20435 - 1].split()
    )
    assert "line 20435: behind a gap (longest 0.8 s" in loaded.repairs[0].detail
    assert float(gap_line[1]) == 207
    # 421 and 422 are in two lines of groups.txt, 103 walks with 72, 120 and 123 with
    # 121.
    group = dict(zip(tracks.source, tracks.group, strict=True))
    assert len({group[name] for name in ("6", "18", "421", "422", "423", "425")}) == 1
    assert group["103"] == group["72"]
    assert group["120"] == group["121"] == group["123"]
    alone = [name for name in tracks.source if group[name] == name]
    assert len(alone) == 428 - 234
    assert set(group.values()) & set(tracks.source) == set(alone)


def test_zara01_is_read_whole(ucy):
    if not (ucy / "zara01").is_dir():
        pytest.skip("needs zara01")
    loaded = load("zara01")
    assert (len(loaded.tracks), loaded.tracks.t.size) == (148, 5024)
    assert loaded.repairs == ()
