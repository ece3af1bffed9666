"""People who come back: labels, a column person, and the faults of either."""

import numpy as np
import pandas as pd
import pytest

from isac_track.datasets import load, people
from isac_track.datasets.__main__ import main
from isac_track.errors import DataError

STEPS = 6  # Samples of a passage, at 10 a second.


def labelled(path, labels, passages, *, rate=10, height="1.7"):
    """A file of PedPy whose comments name people.

    `labels` are lines such as ``# 1 M 17``. Passage n begins at a frame of `passages`
    and walks along y = n.
    """
    rows = [
        f"{n} {begin + k} {0.1 * k:.1f} {n} {height}"
        for n, begin in passages.items()
        for k in range(STEPS)
    ]
    lines = [f"# framerate: {rate}", f"# {path.stem}", *labels, "# id frame x y z"]
    path.write_text("\n".join([*lines, *rows]) + "\n")
    return path


def two_runs(folder, letters="MF", height="1.7"):
    """Two runs; the first person comes back within a run and in the other."""
    first, second = letters
    labelled(
        folder / "a.txt",
        [f"#  1 {first} 17", f"# 2 {second} 4", f"# 3 {first}  17"],
        {1: 0, 2: 3, 3: 40},
        height=height,
    )
    labelled(
        folder / "b.txt",
        [f"# 1 {second} 8", f"# 3 {first} 17"],
        {1: 0, 2: 20, 3: 40},
        height=height,
    )
    return load(folder)


def test_a_label_is_the_person_and_the_id_the_passage(tmp_path):
    dataset = two_runs(tmp_path)
    tracks = dataset.tracks
    assert tracks.source == ("a:1", "a:2", "a:3", "b:1", "b:2", "b:3")
    assert tracks.session == ("a", "a", "a", "b", "b", "b")
    assert tracks.person == ("M17", "F4", "M17", "F8", "unlabelled b:2", "M17")
    # One person is one cluster of every interval, in both runs.
    assert len(set(tracks.group)) == 4
    assert tracks.group[0] == tracks.group[2] == tracks.group[5]
    details = {note.kind: note.detail for note in dataset.repairs}
    assert (
        "b.txt: line 12: a passage without a label; of a person"
        in details["unlabelled"]
    )


def test_sex_and_height_never_reach_the_tracks(tmp_path):
    for name in ("as_written", "swapped"):
        (tmp_path / name).mkdir()
    as_written = two_runs(tmp_path / "as_written").tracks
    swapped = two_runs(tmp_path / "swapped", letters="FM", height="2.3").tracks
    for name in ("t", "xy", "offsets"):
        assert np.array_equal(getattr(as_written, name), getattr(swapped, name))
    assert (as_written.source, as_written.session) == (swapped.source, swapped.session)
    # The same people under other names: the letter is but a part of a name.
    renaming = {"M17": "F17", "F4": "M4", "F8": "M8"}
    renamed = tuple(renaming.get(name, name) for name in as_written.person)
    assert renamed == swapped.person


def test_the_people_of_a_run_are_counted(tmp_path, capsys):
    two_runs(tmp_path)
    attendance = people.count_attendance(load(tmp_path).tracks)
    assert attendance == people.Attendance(
        sessions=2, passages=6, people=3, returning=1, unlabelled=1
    )
    text = (
        "2 sessions: 5 passages of 3 labelled people, 1 of them in two sessions or"
        " more; 1 passages without a label"
    )
    assert str(attendance) == text
    assert main(["show", str(tmp_path / "a.txt")]) == 0
    assert "people       3 passages of 2 labelled people\n" in capsys.readouterr().out


def rows(*passages):
    """Rows of a table with a column person, for passages (id, person, first time)."""
    return [
        (begin + 0.1 * k, name, 0.1 * k, begin, person)
        for name, person, begin in passages
        for k in range(STEPS)
    ]


@pytest.mark.parametrize("kind", ["csv", "parquet", "frame"])
def test_a_column_person_keeps_passages_apart_by_their_id(kind, tmp_path):
    columns = ["t", "id", "x", "y", "person"]
    table = pd.DataFrame(
        rows(("p", "anna", 0.0), ("q", "", 1.0), ("r", "anna", 2.0)), columns=columns
    )
    if kind == "csv":
        table.to_csv(tmp_path / "walks.csv", index=False)
    elif kind == "parquet":
        table.to_parquet(tmp_path / "walks.parquet")
    dataset = load(table if kind == "frame" else tmp_path / f"walks.{kind}")
    tracks = dataset.tracks
    assert tracks.source == ("p", "q", "r")
    assert tracks.person == ("anna", "unlabelled q", "anna")
    assert tracks.group == ("group:person anna", "q", "group:person anna")
    renamed = table.rename(columns={"person": "badge"})
    again = load(renamed, columns="person=badge")
    assert again.tracks.person == tracks.person
    # Who walks is part of the recording that a hash names.
    assert again.sha256 != load(renamed).sha256


def test_a_person_of_two_tables_is_one_person(tmp_path):
    columns = ["t", "id", "x", "y", "person"]
    for name, passages in {
        "monday": [("1", "anna", 0.0), ("2", "ben", 0.0)],
        "tuesday": [("1", "ben", 0.0), ("2", "carla", 3.0)],
    }.items():
        table = pd.DataFrame(rows(*passages), columns=columns)
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    tracks = load(tmp_path).tracks
    assert tracks.person == ("anna", "ben", "ben", "carla")
    assert len(set(tracks.group)) == 3


@pytest.mark.parametrize(
    ("labels", "passages", "message"),
    [
        (
            ["# 1 M 17", "# 5 F 2"],
            {1: 0},
            "line 4: person F2 is to be passage 5, which has no rows; correct the",
        ),
        (
            ["# 1 M 17", "# 2 M 17"],
            {1: 0, 2: 3},
            "line 4: person M17 walks passage 2 from 0.3 s on and passage 1 (line 3)",
        ),
        (
            ["# 1 M 17", "# 2 m 017"],
            {1: 0, 2: 30},
            "line 4: person 'm017' is spelt 'M17' in line 3; spell a person in one way",
        ),
        (
            ["# 1 M 17", "# 1 F 2"],
            {1: 0},
            "line 4: passage 1 is of person F2 here, and of M17 in line 3; leave the",
        ),
    ],
)
def test_a_label_that_cannot_be_is_one_line(labels, passages, message, tmp_path):
    path = labelled(tmp_path / "a.txt", labels, passages)
    with pytest.raises(DataError) as error:
        load(path)
    assert str(error.value).startswith(f"{path}, {message}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("passages", "message"),
    [
        (
            [("1", "anna", 0.0), ("2", "anna", 0.2)],
            "line 8: person anna walks passage 2 from 0.2 s on and passage 1 (line 2)",
        ),
        (
            [("1", "anna", 0.0), ("1", "ben", 5.0)],
            "line 8: passage 1 is of person ben here, and of anna in line 2; leave",
        ),
        (
            [("1", "Anna 1", 0.0), ("2", "anna-1", 5.0)],
            "line 8: person 'anna-1' is spelt 'Anna 1' in line 2; spell",
        ),
        (
            [("1", "unlabelled 1", 0.0)],
            "line 2: no person may be called 'unlabelled 1'; leave the name empty",
        ),
    ],
)
def test_a_person_of_a_table_that_cannot_be_is_one_line(passages, message, tmp_path):
    path = tmp_path / "walks.csv"
    table = pd.DataFrame(rows(*passages), columns=["t", "id", "x", "y", "person"])
    table.to_csv(path, index=False)
    with pytest.raises(DataError) as error:
        load(path)
    assert str(error.value).startswith(f"{path}, {message}")


@pytest.mark.parametrize(
    ("label", "rate", "message"),
    [
        ("# 1 m 17", 10, "person 'M17' of the first is spelt 'm17' in the other"),
        ("# 1 M 17", 25, "sessions a and b have a sample every 0.1 and 0.04 s"),
    ],
)
def test_runs_that_do_not_fit_are_one_line(label, rate, message, tmp_path):
    labelled(tmp_path / "a.txt", ["# 1 M 17"], {1: 0})
    labelled(tmp_path / "b.txt", [label], {1: 0}, rate=rate)
    with pytest.raises(DataError, match=message):
        load(tmp_path)


def test_labels_beside_a_marker_are_refused(tmp_path):
    path = labelled(tmp_path / "a.txt", ["# 1 M 17"], {1: 0})
    path.write_text(path.read_text().replace("id frame x y z", "id frame x y markerID"))
    with pytest.raises(DataError, match="line 3: a label, and line 4 names a markerID"):
        load(path)


def test_a_marker_that_changes_within_a_trajectory_names_both_lines(tmp_path):
    path = labelled(tmp_path / "a.txt", [], {1: 0})
    path.write_text(
        "# framerate: 10\n# id frame x y markerID\n1 0 0 0 761\n1 1 0.1 0 -1\n"
        "1 2 0.2 0 762\n"
    )
    with pytest.raises(
        DataError, match="line 5: passage 1 is of person 762 here, and of 761 in line 3"
    ):
        load(path)
    path.write_text(path.read_text().replace("762", "761"))
    assert load(path).tracks.person == ("761",)


def test_returners(returners):
    dataset = load("returners")
    tracks = dataset.tracks
    assert people.count_attendance(tracks) == people.Attendance(
        sessions=3, passages=268, people=39, returning=22, unlabelled=2
    )
    # Neither of the two labels that are wrong is dropped in silence.
    withdrawn = [note.detail for note in dataset.repairs if note.kind == "label"]
    assert ["passage 70 is not taken for M38" in note for note in withdrawn] == [1, 0]
    assert ["passage 77 is not taken for F16" in note for note in withdrawn] == [0, 1]
    rows = {name: row for row, name in enumerate(tracks.source)}
    assert tracks.person[rows["UX_20_1:70"]] == "unlabelled UX_20_1:70"
    assert tracks.person[rows["UX_20_1:73"]] == "F16"
    # The withdrawn label is that of a person in two places at once.
    path = returners / "UX_20_1.txt"
    with pytest.raises(DataError, match="line 85: person F16 walks passage 77 from"):
        load(path)


def test_the_corridors_by_name(hermes, capsys):
    for name, n_tracks in {
        "bot-360-250-250": 304,
        "bot-360-160-160": 306,
        "uo-180-180-070": 148,
        "uo-240-240-130": 247,
    }.items():
        dataset = load(f"hermes-{name}")
        assert len(dataset.tracks) == n_tracks
        step_s = np.diff(dataset.tracks[0].t)
        np.testing.assert_allclose(step_s, 1 / 16, rtol=1e-9)
        assert np.ptp(dataset.tracks.xy, axis=0).max() < 20.0  # In metres.
        assert "never to be passed on" in dataset.licence
        assert dataset.path == str(hermes / f"{name}.txt")
    assert main(["show", "hermes"]) == 0
    assert "4 sessions; nobody is known to be in two" in capsys.readouterr().out


def test_corridors_are_never_downloaded(data_folder, mirror):
    with pytest.raises(DataError, match=r"hermes-uo-180-180-070: its licence is not"):
        load("hermes-uo-180-180-070")
    assert mirror.asked == []
    assert not list(data_folder.iterdir())
